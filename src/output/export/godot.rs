//! Godot's directional lightmap: a texture array with the slices L0, L1 y, L1 z, L1 x, imported from one tall picture (1 × 4).
//!
//! The engine (4.4 and later): `E/π = L0 + 4 L0 · Σ 2 (t − 0.5) · n` over the axes.

use super::{Kind, Picture, Texel, mean, ratio};

/// Axis of each slice behind the first.
const AXES: [usize; 3] = [1, 2, 0];

/// The four slices.
pub(super) fn picture(texels: &[Texel]) -> Picture {
    let slice = |values: Vec<[f32; 3]>| values.into_flattened();
    let mut slices = vec![slice(texels.iter().map(mean).collect())];
    slices.extend(AXES.map(|axis| {
        let along = texels.iter().map(|texel| ratio(texel, axis));
        slice(along.map(|ratio| ratio.map(|r| 0.5 + 0.25 * r)).collect())
    }));
    Picture {
        name: "godot",
        components: 3,
        slices,
        kind: Kind::Exr,
    }
}

//! Bakery's SH mode: L0 as HDR, and L1 along each axis relative to it.
//!
//! The engine: `L1 = (2 t − 1) · 2 · L0`, then either `E/π = L0 + L1·n` or Geomerics' non-linear formula of (L0, L1).

use super::{Kind, Picture, Texel, mean, ratio};

/// L0 and the three L1, by axis of Unity's world.
pub(super) fn pictures(texels: &[Texel]) -> Vec<Picture> {
    let picture = |name, values: Vec<[f32; 3]>| Picture {
        name,
        components: 3,
        slices: vec![values.into_flattened()],
        kind: Kind::Exr,
    };
    let along = |axis: usize, sign: f32| {
        texels
            .iter()
            .map(|texel| ratio(texel, axis).map(|ratio| 0.5 + 0.5 * sign * ratio))
            .collect()
    };
    vec![
        picture("bakery_L0", texels.iter().map(mean).collect()),
        picture("bakery_L1x", along(0, -1.0)),
        picture("bakery_L1y", along(1, 1.0)),
        picture("bakery_L1z", along(2, 1.0)),
    ]
}

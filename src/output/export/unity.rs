//! Unity's directional mode: a colour, and one direction for all of it.
//!
//! The engine (`DecodeDirectionalLightmap`): `E/π = color · (n·(dir.xyz − ½) + ½) / dir.w`, so that with `dir.w` at the value of the
//! bracket for the baked normal N, that normal shows the colour. With d = 2 dir.xyz − 1 this is `color · (1 + d·n) / (1 + d·N)`:
//! linear spherical harmonics of first order whose L1 is shared, d = 2 G/φ of the luminance, at most of length 1, which is a light from
//! one side.

use std::f32::consts::FRAC_1_PI;

use super::{Kind, Picture, Texel};
use crate::refine::Plane;

/// Luminance of linear Rec. 709 primaries (ITU-R BT.709).
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Colour and direction.
pub(super) fn pictures(texels: &[Texel], irradiance: &Plane) -> Vec<Picture> {
    let color = irradiance.values.iter().map(|e| e * FRAC_1_PI).collect();
    let directions = texels
        .iter()
        .zip(irradiance.values.chunks_exact(3))
        .flat_map(|(texel, e)| direction(texel, luminance(|channel| e[channel])))
        .collect();
    vec![
        Picture {
            name: "unity_color",
            components: 3,
            slices: vec![color],
            kind: Kind::Exr,
        },
        Picture {
            name: "unity_dir",
            components: 4,
            slices: vec![directions],
            kind: Kind::Png,
        },
    ]
}

fn luminance(of: impl Fn(usize) -> f32) -> f32 {
    (0..3).map(|channel| LUMINANCE[channel] * of(channel)).sum()
}

/// `dir` of a texel. `irradiance` is the luminance of E, which is G·N: it gives d·N without N.
fn direction(texel: &Texel, irradiance: f32) -> [f32; 4] {
    let g = [0, 1, 2].map(|axis| luminance(|channel| texel.g[channel][axis]));
    let phi = luminance(|channel| texel.phi[channel]);
    let size = g.iter().map(|x| x * x).sum::<f32>().sqrt();
    if size <= 0.0 {
        return [0.5; 4];
    }
    let length = (2.0 * size / phi).min(1.0);
    let d = g.map(|x| x / size * length);
    let facing = (irradiance / size).clamp(0.0, 1.0) * length;
    // Unity's x points the other way.
    [-d[0], d[1], d[2], facing].map(|x| (0.5 + 0.5 * x).clamp(0.0, 1.0))
}

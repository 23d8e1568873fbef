//! What an engine needs to read the maps: irradiance at any normal from the light vector and the fluence of a texel.
//!
//! Plain functions of one colour channel in f32, as a shader has them. Units: lux in, lux out; normals are unit vectors in the space of
//! the light vector. `g` and `phi` are linear: filter them first, then call these.
//!
//! | function         | reads  | exact                                                             |
//! |------------------|--------|-------------------------------------------------------------------|
//! | [`irradiance`]   | G      | when all light lies above the horizon of the normal               |
//! | [`sky_and_sun`]  | G, φ   | also for one small light, a uniform sky, and both                 |
//! | [`bounds`]       | G, φ   | always holds the irradiance                                       |
//! | [`magnify`]      | G, ∂G  | gives G between texels, where G is smooth; 1 is the texel's size  |
//!
//! The same functions of all three channels at once stand in [`GLSL`] and [`WGSL`], with the same names behind `lumel_`, and the
//! decoding of the files.

use glam::{Vec2, Vec3};

/// The functions of this module for GLSL (ES 3.00 and later, 3.30 and later): a text without `#version`, to put before a shader's own.
pub const GLSL: &str = include_str!("lumel.glsl");

/// The functions of this module for WGSL.
pub const WGSL: &str = include_str!("lumel.wgsl");

/// Irradiance at the unit normal `n` from the light vector `g`: max(0, G·n).
#[must_use]
pub fn irradiance(g: Vec3, n: Vec3) -> f32 {
    g.dot(n).max(0.0)
}

/// Smallest and largest irradiance at the unit normal `n` that a light of vector `g` and fluence `phi` can give:
/// max(0, G·n) ≤ E ≤ (φ + G·n)/2.
///
/// The upper bound follows from E − G·n = ∫ L max(0, −ω·n) dω and φ ≥ ∫ L |ω·n| dω.
#[must_use]
pub fn bounds(g: Vec3, phi: f32, n: Vec3) -> [f32; 2] {
    let along = g.dot(n);
    let low = along.max(0.0);
    [low, (0.5 * (phi + along)).max(low)]
}

/// Irradiance at the unit normal `n` if the light is a uniform sky over the hemisphere of the unit normal `base` plus one small light, split
/// such that both together have the light vector `g` and the fluence `phi` of the texel. `base` is the normal the texel was baked for.
///
/// Never below [`irradiance`]. Exact at `n = base`, for a single small light, for a uniform sky, and for both together.
#[must_use]
pub fn sky_and_sun(g: Vec3, phi: f32, base: Vec3, n: Vec3) -> f32 {
    let sky = sky_fluence(g, phi, base);
    let sun = g - base * (0.5 * sky);
    irradiance(g, n).max(0.25 * sky * (1.0 + n.dot(base)) + irradiance(sun, n))
}

/// Fluence s of the sky: the smaller root of |G − s/2 N| = φ − s, kept between no sky and one that explains all of G·N.
///
/// With g = G·N and b = 2φ − g the root is (b − √(b² − 3(φ² − |G|²))) / 1.5. What is under the root equals
/// (φ − 2g)² + 3|G − gN|², and multiplying through by the conjugate leaves φ − |G| as the only difference of near numbers: a single
/// light has exactly no sky.
fn sky_fluence(g: Vec3, phi: f32, base: Vec3) -> f32 {
    let along = g.dot(base);
    let across = (g - base * along).length();
    let root = (phi - 2.0 * along).hypot(3f32.sqrt() * across);
    let size = g.length();
    let denominator = 2.0 * phi - along + root;
    if denominator <= 0.0 {
        return 0.0;
    }
    let sky = 2.0 * (phi - size) * ((phi + size) / denominator);
    sky.clamp(0.0, 2.0 * along.max(0.0))
}

/// G between four texels from their values and their derivatives per texel step (`_du`, `_dv`), by cubic Hermite interpolation: the
/// tensor product of Ferguson's patch (Ferguson 1964) with mixed derivatives of zero.
///
/// The texels stand left and right in the upper row, then left and right in the lower one; `between` is the place, from (0, 0) at the
/// first to (1, 1) at the last. Values and derivatives are met at the texels, and both are continuous across cells. Exact for a
/// G that is linear; a product u·v is off by at most 0.01 of its change over the cell. A texel of the border that repeats its neighbour
/// has that one's derivatives as well, which makes a wave of at most a tenth of the derivative there.
#[must_use]
pub fn magnify(value: [Vec3; 4], du: [Vec3; 4], dv: [Vec3; 4], between: Vec2) -> Vec3 {
    let s = between;
    let one = s * s * (3.0 - 2.0 * s);
    let leave = s * (1.0 - s) * (1.0 - s);
    let arrive = s * s * (s - 1.0);
    let zero = 1.0 - one;
    let row = |left: usize, right: usize| {
        zero.x * value[left] + one.x * value[right] + leave.x * du[left] + arrive.x * du[right]
    };
    let slope = |left: usize, right: usize| zero.x * dv[left] + one.x * dv[right];
    zero.y * row(0, 1) + one.y * row(2, 3) + leave.y * slope(0, 1) + arrive.y * slope(2, 3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::PI;

    /// Unit vectors in all directions, on a spiral.
    fn directions() -> impl Iterator<Item = Vec3> {
        (0..64u8).map(|index| {
            let z = (f32::from(index) + 0.5) / 32.0 - 1.0;
            let angle = 2.4 * f32::from(index);
            let radius = (1.0 - z * z).sqrt();
            Vec3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
    }

    /// Normals up to 60 degrees from Z.
    fn normals() -> impl Iterator<Item = Vec3> {
        directions().filter(|n| n.z > 0.5)
    }

    /// A few roundings of the terms.
    fn assert_close(got: f32, want: f32, scale: f32) {
        assert!((got - want).abs() < 4e-6 * scale, "got {got}, want {want}");
    }

    #[test]
    fn the_base_normal_gives_back_what_was_baked() {
        for g in directions().filter(|g| g.z > 0.0) {
            for spread in [1.0, 1.2, 3.0] {
                let g = g * 7.0;
                let got = sky_and_sun(g, g.length() * spread, Vec3::Z, Vec3::Z);
                assert_close(got, g.z, 7.0 * spread);
            }
        }
    }

    #[test]
    fn a_single_light_is_exact_at_every_normal() {
        for g in directions().filter(|g| g.z > 0.0) {
            let phi = g.length();
            for n in directions() {
                let want = g.dot(n).max(0.0);
                assert_close(irradiance(g, n), want, 1.0);
                assert_close(sky_and_sun(g, phi, Vec3::Z, n), want, 1.0);
            }
        }
    }

    #[test]
    fn a_uniform_sky_with_a_sun_is_exact() {
        for strength in [0.0, 0.1, 1.0, 30.0] {
            for sun in directions().filter(|sun| sun.z > 0.6) {
                // A sky of unit radiance: fluence 2π, light vector π along the normal.
                let g = Vec3::Z * PI + sun * strength;
                let phi = 2.0 * PI + strength;
                for n in normals() {
                    let want = 0.5 * PI * (1.0 + n.z) + (sun * strength).dot(n).max(0.0);
                    assert_close(sky_and_sun(g, phi, Vec3::Z, n), want, 10.0 * phi);
                }
            }
        }
    }

    #[test]
    fn bounds_hold_the_irradiance_of_two_lights() {
        for first in directions().filter(|light| light.z > 0.0) {
            for second in directions().filter(|light| light.z > 0.0) {
                let g = first + 0.3 * second;
                for n in directions() {
                    let truth = first.dot(n).max(0.0) + 0.3 * second.dot(n).max(0.0);
                    let [low, high] = bounds(g, 1.3, n);
                    assert!(low - 1e-6 <= truth && truth <= high + 1e-6);
                }
            }
        }
    }

    #[test]
    fn darkness_stays_dark() {
        assert_close(sky_and_sun(Vec3::ZERO, 0.0, Vec3::Z, Vec3::X), 0.0, 1.0);
        assert_close(bounds(Vec3::ZERO, 0.0, Vec3::Z)[1], 0.0, 1.0);
    }

    /// Four texels of a smooth function, and it at `between`.
    fn magnified(
        function: impl Fn(Vec2) -> Vec3,
        slopes: impl Fn(Vec2) -> [Vec3; 2],
        at: Vec2,
        between: Vec2,
    ) -> Vec3 {
        let texels = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE].map(|texel| at + texel);
        let [du, dv] = [0, 1].map(|axis| texels.map(|texel| slopes(texel)[axis]));
        magnify(texels.map(&function), du, dv, between)
    }

    #[test]
    fn magnification_is_exact_for_a_linear_light_vector() {
        let [a, b, c] = [
            Vec3::new(1.0, -2.0, 0.5),
            Vec3::new(0.25, 3.0, -1.0),
            Vec3::X,
        ];
        for step in 0..=64u8 {
            let between = Vec2::new(f32::from(step % 8), f32::from(step / 8)) / 8.0;
            let got = magnified(|p| a + b * p.x + c * p.y, |_| [b, c], Vec2::ONE, between);
            let want = a + b * (1.0 + between.x) + c * (1.0 + between.y);
            assert!(got.distance(want) < 4e-6, "{got} for {want} at {between}");
        }
    }

    #[test]
    fn magnification_of_every_second_texel_beats_filtering_all_of_them() {
        // A penumbra eight texels wide, at full and at half resolution.
        let profile = |x: f32| 0.5 - 0.5 * (x * PI / 8.0).cos();
        let slope = |x: f32| PI / 16.0 * (x * PI / 8.0).sin();
        let mut worst = [0.0_f32; 2];
        for step in 0..128u8 {
            let x = f32::from(step) / 16.0;
            let truth = profile(x);
            let left = x.floor();
            let linear = profile(left) * (1.0 - (x - left)) + profile(left + 1.0) * (x - left);
            let left = (x / 2.0).floor();
            let cubic = magnified(
                |p| Vec3::splat(profile(2.0 * p.x)),
                |p| [Vec3::splat(2.0 * slope(2.0 * p.x)), Vec3::ZERO],
                Vec2::new(left, 0.0),
                Vec2::new(x / 2.0 - left, 0.3),
            );
            worst = [
                worst[0].max((linear - truth).abs()),
                worst[1].max((cubic.x - truth).abs()),
            ];
        }
        // A chord of the cosine is off by (π/8)²/16, the cubic over twice the width by (π/4)⁴/768.
        assert!(worst[0] > 8e-3 && worst[1] < 6e-4, "{worst:?}");
    }
}

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

use glam::Vec3;

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
}

//! Round lights as regular polygons.

use std::f64::consts::PI;

use glam::DVec3;

/// Sides of the polygon. With 32 its border is within half a percent of the circle's radius, which no shadow shows; the sums of a contour cost
/// as much as it has sides.
pub const SIDES: usize = 32;

/// Circumradius, at unit distance, of the regular polygon of [`SIDES`] sides that faces the receiver and gives it as much light as a disc of
/// slope `slope` (radius over distance; the tangent of the angle from its middle to its border): π slope² / (1 + slope²) per unit radiance.
///
/// 0 for 0. Finite for every finite slope.
#[must_use]
pub fn circumradius(slope: f64) -> f64 {
    let wanted = PI * slope * slope / (1.0 + slope * slope);
    let sides = SIDES as f64;
    let (sin, cos) = (PI / sides).sin_cos();
    // Equal area, which is right for a small disc.
    let mut radius = slope * (PI / (sides * sin * cos)).sqrt();
    for _ in 0..MAX_STEPS {
        let inradius = radius * cos;
        let distance = 1.0_f64.hypot(inradius);
        let given = sides * (radius * sin / distance).atan() * inradius / distance;
        // Light grows with the square of a small radius and hardly at all with a large one.
        let step = (wanted / given).sqrt();
        if !step.is_finite() || (step - 1.0).abs() < 1e-15 {
            break;
        }
        let growth = 1.0 + inradius * inradius;
        radius *= 1.0 + (step - 1.0) * growth;
    }
    radius
}

/// Unit vectors from the middle to the corners of a disc in the unit direction `towards`, counter-clockwise seen from the receiver.
pub fn directions(towards: DVec3) -> impl Iterator<Item = DVec3> {
    let (u, v) = towards.any_orthonormal_pair();
    let v = if u.cross(v).dot(towards) > 0.0 { -v } else { v };
    (0..SIDES).map(move |side| {
        let (sin, cos) = (side as f64 * 2.0 * PI / SIDES as f64).sin_cos();
        cos * u + sin * v
    })
}

/// Newton's steps double the digits; from 1e-3 three are enough.
const MAX_STEPS: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_polygon_gives_the_light_of_the_disc() {
        for slope in [0.0, 1e-9, 0.0046, 0.1, 1.0, 10.0] {
            let radius = circumradius(slope);
            let sides = SIDES as f64;
            let inradius = radius * (PI / sides).cos();
            let half_side = radius * (PI / sides).sin();
            let distance = 1.0_f64.hypot(inradius);
            let given = sides * (half_side / distance).atan() * inradius / distance;
            let wanted = PI * slope * slope / (1.0 + slope * slope);
            assert!(
                (given - wanted).abs() <= 1e-13 * wanted,
                "{slope}: {given} {wanted}"
            );
        }
    }
}

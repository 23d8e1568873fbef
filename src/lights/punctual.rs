//! Authored lights without a surface: points, spots and suns, hard or with a size of their own.

use std::f64::consts::PI;

use glam::DVec3;

use super::{Options, Polygon, disc};
use crate::scene::AreaLight;
use crate::scene::PunctualKind;
use crate::scene::PunctualLight;

/// A point or spot light: a sphere, or a point when its radius is 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// World metres.
    pub position: DVec3,
    /// Luminous intensity in candela, linear RGB, not negative, not all zero.
    pub intensity: DVec3,
    /// Metres; 0 casts hard shadows.
    pub radius: f64,
    /// Metres at which the light ends; `None` is infinite.
    pub range: Option<f64>,
    /// Only for spots.
    pub cone: Option<Cone>,
}

/// What a spot lights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Unit vector in which it shines.
    pub axis: DVec3,
    /// Half angle up to which it has its full intensity, radians.
    pub inner_angle: f64,
    /// Half angle where it ends, radians.
    pub outer_angle: f64,
}

/// A polygon at infinity of uniform radiance: a sun with a diameter, or a part of the sky.
#[derive(Clone, Debug, PartialEq)]
pub struct Distant {
    /// Unit vector to its middle.
    pub towards: DVec3,
    /// Its vertices as directions v with v · `towards` = 1, counter-clockwise seen from the receiver. Convex; `towards` is inside.
    pub contour: Vec<DVec3>,
    /// Nit, linear RGB, not negative, not all zero.
    pub radiance: DVec3,
    /// Steradians.
    pub solid_angle: f64,
    /// What the light vector of all of it is beyond that of uniform radiance, lux, per channel: as much of it counts as is seen of the
    /// polygon.
    pub excess: [DVec3; 3],
}

/// A sun without a diameter, or a direction of a sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// Unit vector to it.
    pub towards: DVec3,
    /// Illuminance of a surface that faces it, lux, linear RGB, not negative, not all zero.
    pub illuminance: DVec3,
    /// What its light vector is beyond illuminance × direction, lux, per channel.
    pub excess: [DVec3; 3],
    /// It shines on every n-th receiver, from the first number on: `(0, 1)` on all.
    pub set: (u32, u32),
}

/// The least difference of the cosines of a spot's angles, so that an edge without width has one; the extension's own value.
const SHARPEST: f64 = 1e-3;

impl Point {
    /// What of its intensity arrives at `place` (world metres) beside the fall with the square of the distance: 0..=1, and its derivative per
    /// metre. The range's window is max(0, 1 − (d / range)⁴), the cone's falloff the square of a ramp between the cosines of its angles.
    ///
    /// Source: the glTF extension `KHR_lights_punctual`, range property and inner and outer cone angles.
    #[must_use]
    pub fn attenuation(&self, place: DVec3) -> (f64, DVec3) {
        let offset = place - self.position;
        let distance = offset.length();
        let (mut value, mut slope) = (1.0, DVec3::ZERO);
        if distance == 0.0 {
            return (value, slope);
        }
        let outwards = offset / distance;
        if let Some(range) = self.range {
            let cube = (distance / range).powi(3);
            value = (1.0 - cube * distance / range).max(0.0);
            if value > 0.0 {
                slope = -4.0 * cube / range * outwards;
            }
        }
        if let Some(cone) = &self.cone {
            let scale = (cone.inner_angle.cos() - cone.outer_angle.cos())
                .max(SHARPEST)
                .recip();
            let cosine = cone.axis.dot(outwards);
            let ramp = ((cosine - cone.outer_angle.cos()) * scale).clamp(0.0, 1.0);
            slope *= ramp * ramp;
            if 0.0 < ramp && ramp < 1.0 {
                let turn = (cone.axis - cosine * outwards) / distance;
                slope += value * 2.0 * ramp * scale * turn;
            }
            value *= ramp * ramp;
        }
        (value, slope)
    }

    /// Whether none of its light can reach a sphere (world metres).
    #[must_use]
    pub fn misses(&self, centre: DVec3, radius: f64) -> bool {
        let offset = centre - self.position;
        let distance = offset.length();
        if self.range.is_some_and(|range| distance - radius >= range) {
            return true;
        }
        self.cone.is_some_and(|cone| {
            let half_angle = (radius / distance).min(1.0).asin();
            distance > radius && cone.axis.angle_between(offset) - half_angle >= cone.outer_angle
        })
    }
}

/// Sorts authored lights by their nature. Those without intensity are left out.
pub(super) fn collect(
    authored: &[PunctualLight],
    options: &Options,
) -> (Vec<Point>, Vec<Distant>, Vec<Sun>) {
    let (mut points, mut distant, mut suns) = (Vec::new(), Vec::new(), Vec::new());
    for light in authored {
        if light.intensity.max_element() <= 0.0 {
            continue;
        }
        let point = |range, cone| Point {
            position: light.position,
            intensity: light.intensity,
            radius: light.size.unwrap_or(options.light_radius),
            range,
            cone,
        };
        match light.kind {
            PunctualKind::Point { range } => points.push(point(range, None)),
            PunctualKind::Spot {
                range,
                inner_angle,
                outer_angle,
            } => {
                let cone = Cone {
                    axis: light.direction,
                    inner_angle,
                    outer_angle,
                };
                points.push(point(range, Some(cone)));
            }
            PunctualKind::Directional => {
                let towards = -light.direction;
                let diameter = light.size.unwrap_or(options.sun_angle);
                if diameter > 0.0 {
                    distant.push(sun_disc(towards, diameter, light.intensity));
                } else {
                    suns.push(Sun {
                        towards,
                        illuminance: light.intensity,
                        excess: [DVec3::ZERO; 3],
                        set: (0, 1),
                    });
                }
            }
        }
    }
    (points, distant, suns)
}

/// The polygon of an authored area light; a disc becomes a regular polygon of its area. `None` when it gives no light.
pub(super) fn surface_of(light: &AreaLight) -> Option<Polygon> {
    let (u, v) = (light.half_width, light.half_height);
    let normal = v.cross(u).normalize_or_zero();
    if light.radiance.max_element() <= 0.0 || normal == DVec3::ZERO {
        return None;
    }
    let contour: Vec<DVec3> = if light.is_disc {
        let sides = disc::SIDES as f64;
        let (sin, cos) = (PI / sides).sin_cos();
        let radius = u.length() * (PI / (sides * sin * cos)).sqrt();
        // Counter-clockwise seen from where it shines.
        disc::directions(-normal)
            .map(|side| light.centre + radius * side)
            .collect()
    } else {
        let at = |x: f64, y: f64| light.centre + x * u + y * v;
        vec![at(-1.0, -1.0), at(-1.0, 1.0), at(1.0, 1.0), at(1.0, -1.0)]
    };
    let triangles: Vec<[DVec3; 3]> = (2..contour.len())
        .map(|k| [contour[0], contour[k - 1], contour[k]])
        .collect();
    let area = if light.is_disc {
        PI * u.length_squared()
    } else {
        4.0 * u.length() * v.length()
    };
    Some(Polygon {
        contours: vec![contour],
        triangles,
        normal,
        area,
        radiance: light.radiance,
        two_sided: false,
        surface: Vec::new(),
    })
}

/// A sun of the angular diameter `diameter` in 0..π that gives `illuminance` lux to a surface that faces it.
fn sun_disc(towards: DVec3, diameter: f64, illuminance: DVec3) -> Distant {
    let (sin, cos) = (0.5 * diameter).sin_cos();
    let radius = disc::circumradius(sin / cos);
    let contour = disc::directions(towards)
        .map(|side| towards + radius * side)
        .collect();
    Distant {
        towards,
        contour,
        radiance: illuminance / (PI * sin * sin),
        // Of a small disc and its polygon; it only weighs the excess, which there is none of.
        solid_angle: PI * sin * sin,
        excess: [DVec3::ZERO; 3],
    }
}

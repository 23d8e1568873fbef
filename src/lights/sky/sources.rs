//! A picture of the sky as lights of a scene.
//!
//! As *cells*, the parts of the sphere that belong to each direction of a rule become polygons at infinity of uniform radiance: their shadows
//! have penumbrae, and derivatives. As *points*, or *interleaved* points, each direction is a sun without a size. Either way a light carries
//! what its part of the picture gives beyond a uniform or pointlike one, so that where nothing is in the way the light vector is that of the
//! pixels.

use glam::DVec3;

use super::cells::{self, solid_angle};
use super::{Options, Region, Rule};
use crate::error::Warnings;
use crate::lights::{Distant, SkyMode, Sun};
use crate::scene;

/// Cosine of the largest angle between the middle of a polygon and its corners; larger polygons are cut. At 72° a polygon on its tangent plane
/// is three times as wide as far; nearer to 90° it grows without bound.
const NARROW: f64 = 0.3;

/// Steradians below which a part of a polygon is rounding.
const NOTHING: f64 = 1e-12;

/// Times a polygon is halved. A hemisphere needs three; what is not narrow after many has no inside.
const MAX_CUTS: usize = 16;

/// Interleaved sets: a pattern of 3 × 3 texels.
const SETS: usize = 9;

/// The lights of `sky` by a rule of `directions` directions.
pub(in crate::lights) fn sources(
    sky: &scene::Sky,
    directions: usize,
    mode: SkyMode,
    warnings: &mut Warnings,
) -> (Vec<Distant>, Vec<Sun>) {
    let options = Options {
        directions,
        sets: match mode {
            SkyMode::Interleaved => SETS.min(Options::MAX_DIRECTIONS / directions.max(1)).max(1),
            _ => 1,
        },
        split_bright: mode == SkyMode::Cells,
        ..Options::default()
    };
    warnings.extend(sky.image.warnings.clone());
    let stored = sky
        .rule
        .as_ref()
        .and_then(|text| super::load_if_fits(text, sky.image.hash(), &options));
    let made = match stored {
        Some(stored) => Ok(stored),
        None => super::build(&sky.image, &options, &|_| true),
    };
    let made = match made {
        Ok(made) => made,
        Err(error) => {
            warnings.push("the sky could not be used, left out", error.to_string());
            return (Vec::new(), Vec::new());
        }
    };
    let sets: Vec<Rule> = made
        .sets
        .iter()
        .map(|rule| rule.turned(sky.rotation, sky.strength))
        .collect();
    if mode != SkyMode::Cells {
        return (Vec::new(), suns(&sets));
    }
    let regions = made.regions.iter();
    let mut distant: Vec<Distant> = regions
        .flat_map(|region| of_region(&region.turned(sky.rotation, sky.strength)))
        .collect();
    let uniform = uniform_radiance(sky);
    for rule in &sets {
        distant.extend(of_rule(rule, uniform));
    }
    (distant, Vec::new())
}

fn suns(sets: &[Rule]) -> Vec<Sun> {
    let n_sets = sets.len() as u32;
    let of_set = |(set, rule): (u32, &Rule)| -> Vec<Sun> {
        let lit = rule.cells.iter().filter(|cell| cell.norm() > 0.0);
        lit.map(|cell| Sun {
            towards: cell.direction,
            illuminance: cell.fluence,
            excess: [0, 1, 2].map(|c| cell.light_vector[c] - cell.fluence[c] * cell.direction),
            set: (set, n_sets),
        })
        .collect()
    };
    (0..).zip(sets).flat_map(of_set).collect()
}

/// The radiance of a sky without structure: its cells are of it exactly, and not of so many pixels.
fn uniform_radiance(sky: &scene::Sky) -> Option<DVec3> {
    let (first, rest) = sky.image.pixels().split_first()?;
    let is_uniform = rest.iter().all(|pixel| pixel == first);
    is_uniform.then(|| DVec3::from_array(first.map(f64::from)) * sky.strength)
}

fn of_rule(rule: &Rule, uniform: Option<DVec3>) -> Vec<Distant> {
    let outlines = cells::cells(&rule.directions());
    let lit = rule.cells.iter().zip(&outlines);
    lit.filter(|(cell, outline)| cell.norm() > 0.0 && outline.solid_angle > 0.0)
        .flat_map(|(cell, outline)| {
            let polygons = if outline.vertices.is_empty() {
                octants()
            } else {
                vec![outline.vertices.clone()]
            };
            match uniform {
                Some(radiance) => of_polygons(polygons, radiance, None),
                None => {
                    let radiance = cell.fluence / outline.solid_angle;
                    of_polygons(polygons, radiance, Some(cell.light_vector))
                }
            }
        })
        .collect()
}

fn of_region(region: &Region) -> Vec<Distant> {
    let polygon = region.polygon.clone();
    of_polygons(
        vec![polygon],
        region.radiance,
        Some(region.cell.light_vector),
    )
}

/// The whole sphere in eight triangles, counter-clockwise seen from the origin.
fn octants() -> Vec<Vec<DVec3>> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    (0..8)
        .map(|signs: u32| {
            let corner = |axis: usize| {
                if signs >> axis & 1 == 0 {
                    axes[axis]
                } else {
                    -axes[axis]
                }
            };
            if signs.count_ones().is_multiple_of(2) {
                vec![corner(0), corner(2), corner(1)]
            } else {
                vec![corner(0), corner(1), corner(2)]
            }
        })
        .collect()
}

/// Spherical polygons of one radiance that together have the given light vector, if it is another one, cut until each is narrow.
fn of_polygons(
    polygons: Vec<Vec<DVec3>>,
    radiance: DVec3,
    light_vector: Option<[DVec3; 3]>,
) -> Vec<Distant> {
    let mut parts = Vec::new();
    let mut left: Vec<_> = polygons.into_iter().map(|polygon| (polygon, 0)).collect();
    while let Some((polygon, depth)) = left.pop() {
        // What a cut along a border leaves beside it.
        if polygon.len() < 3 || solid_angle(&polygon) < NOTHING {
            continue;
        }
        let middle = middle(&polygon);
        if polygon.iter().all(|corner| corner.dot(middle) > NARROW) {
            parts.push((polygon, middle));
        } else if depth < MAX_CUTS {
            let halves = halves(&polygon, middle);
            left.extend(halves.map(|half| (half, depth + 1)));
        }
    }
    let solid_angles: Vec<f64> = parts.iter().map(|(part, _)| solid_angle(part)).collect();
    let whole: f64 = solid_angles.iter().sum();
    let uniform: DVec3 = parts
        .iter()
        .map(|(part, _)| uniform_light_vector(part))
        .sum();
    let excess = light_vector.map_or([DVec3::ZERO; 3], |vectors| {
        [0, 1, 2].map(|c| vectors[c] - radiance[c] * uniform)
    });
    parts
        .into_iter()
        .zip(solid_angles)
        .filter(|(_, solid_angle)| *solid_angle > 0.0)
        .map(|((part, middle), solid_angle)| Distant {
            towards: middle,
            contour: part
                .iter()
                .map(|corner| *corner / corner.dot(middle))
                .collect(),
            radiance,
            solid_angle,
            excess: excess.map(|vector| vector * (solid_angle / whole)),
        })
        .collect()
}

/// A direction inside a convex polygon: of the light it would give.
fn middle(polygon: &[DVec3]) -> DVec3 {
    let light = uniform_light_vector(polygon);
    let sum: DVec3 = polygon.iter().sum();
    light
        .try_normalize()
        .or(sum.try_normalize())
        .unwrap_or(DVec3::Y)
}

/// ∫ ω dω over a polygon that is counter-clockwise seen from the origin: ½ Σ β n (math: Lambert 1760).
fn uniform_light_vector(polygon: &[DVec3]) -> DVec3 {
    let n = polygon.len();
    (0..n)
        .map(|k| {
            // Seen from the origin counter-clockwise, so its normals look out of the polygon in this order, and in with the other.
            let (a, b) = (polygon[(k + 1) % n], polygon[k]);
            let w = a.cross(b);
            let sine = w.length();
            if sine == 0.0 {
                return DVec3::ZERO;
            }
            w * (0.5 * sine.atan2(a.dot(b)) / sine)
        })
        .sum()
}

/// Cuts a convex polygon along the great circle through its middle, across its longest direction.
fn halves(polygon: &[DVec3], middle: DVec3) -> [Vec<DVec3>; 2] {
    let farthest = polygon
        .iter()
        .copied()
        .min_by(|a, b| a.dot(middle).total_cmp(&b.dot(middle)))
        .unwrap_or(middle);
    let across = farthest
        .reject_from(middle)
        .normalize_or(middle.any_orthonormal_vector());
    [across, -across].map(|side| {
        let mut part = Vec::with_capacity(polygon.len() + 2);
        for (k, &a) in polygon.iter().enumerate() {
            let b = polygon[(k + 1) % polygon.len()];
            let (at_a, at_b) = (a.dot(side), b.dot(side));
            if at_a >= 0.0 {
                part.push(a);
            }
            if (at_a >= 0.0) != (at_b >= 0.0) {
                part.push((a * at_b - b * at_a).normalize() * (at_b - at_a).signum());
                // The cut may be half a circle: its ends alone would not say which.
                if at_b < 0.0 {
                    part.push(middle);
                }
            }
        }
        part
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Environment;
    use glam::Vec3;

    fn sky(radiance: impl Fn(DVec3) -> Vec3) -> scene::Sky {
        scene::Sky {
            image: Environment::from_fn(64, 32, radiance),
            rotation: 0.0,
            strength: 1.0,
            rule: None,
        }
    }

    #[test]
    fn cells_of_any_number_have_the_light_of_the_picture() {
        let sky = sky(|d| Vec3::new(1.0, (1.0 + d.y) as f32, if d.x > 0.9 { 20.0 } else { 0.5 }));
        let want: f64 = 4.0 * std::f64::consts::PI;
        let mut first = None;
        for n in [1, 2, 3, 5, 16, 64] {
            let (distant, _) = sources(&sky, n, SkyMode::Cells, &mut Warnings::default());
            let red: f64 = distant
                .iter()
                .map(|light| light.radiance.x * light.solid_angle)
                .sum();
            assert!((red - want).abs() < 1e-6 * want, "{n}: {red}");
            let vector: DVec3 = distant
                .iter()
                .map(|light| {
                    let corners: Vec<DVec3> = light.contour.iter().map(|v| v.normalize()).collect();
                    light.excess[2] + light.radiance.z * uniform_light_vector(&corners)
                })
                .sum();
            let first = *first.get_or_insert(vector);
            assert!(
                (vector - first).length() < 1e-6 * first.length(),
                "{n}: {vector} {first}"
            );
            for light in &distant {
                assert!(
                    light
                        .contour
                        .iter()
                        .all(|v| (v.dot(light.towards) - 1.0).abs() < 1e-9)
                );
                assert!(light.contour.len() >= 3);
            }
        }
    }
}

//! Directions → the outlines of their cells: the spherical Voronoi diagram as convex polygons.
//!
//! A cell is the part of the sphere where `(ωᵢ − ωⱼ) · x ≥ 0` for every other direction: a hemisphere, cut by one great circle after the
//! other, the nearest direction's first. It is complete when the next direction is more than twice as far as the farthest corner. Unlike a
//! convex hull of the directions this has no cases: any number of directions, on one circle or all in one place, goes the same way.
//!
//! Each cell is cut by itself, and neighbours would disagree by rounding. So in the end every corner between three cells is computed again
//! from their three directions in a fixed order, and is the same to the bit in all of them.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use super::lloyd::angle;

/// The outline of a cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outline {
    /// Corners as unit vectors, counter-clockwise seen from the origin, as a [`crate::lights::Polygon`] is seen from its front:
    /// `vertices[k + 1] × vertices[k]` points into the cell. Sides are arcs of great circles shorter than 120°; long ones have corners in
    /// between. Empty for a cell that is the whole sphere and for one that is nothing.
    pub vertices: Vec<DVec3>,
    /// The direction on the other side of the arc from `vertices[k]` to the next.
    pub neighbours: Vec<u32>,
    /// Steradians.
    pub solid_angle: f64,
}

/// Longest side that is not divided, radians. At π a side no longer says which way it goes.
const LONGEST_SIDE: f64 = 2.0 * PI / 3.0;

/// Corners this near to each other are one, radians: what rounding makes of four or more directions on one circle.
const SAME: f64 = 1e-14;

/// A side that starts at `start` and belongs to the border with direction `other`.
#[derive(Clone, Copy, Debug)]
struct Side {
    start: DVec3,
    other: u32,
}

/// The outlines of the cells of unit `directions`, in their order; the solid angles add up to 4π.
///
/// Of equal directions the first has the cell, the others have nothing. A single direction has the whole sphere. Directions nearer to
/// each other than about 1e-7 rad may lose their cells to rounding.
#[must_use]
pub fn cells(directions: &[DVec3]) -> Vec<Outline> {
    (0..directions.len())
        .into_par_iter()
        .map(|index| cell(directions, index))
        .collect()
}

fn cell(directions: &[DVec3], index: usize) -> Outline {
    let own = directions[index];
    let mut others: Vec<(f64, u32)> = (0..)
        .zip(directions)
        .filter(|&(other, _)| other as usize != index)
        .map(|(other, direction)| (own.distance_squared(*direction), other))
        .collect();
    let is_repeated = others
        .iter()
        .any(|&(distance, other)| distance == 0.0 && (other as usize) < index);
    if is_repeated {
        return Outline::default();
    }
    others.retain(|&(distance, _)| distance > 0.0);
    others.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let Some((&(_, first), rest)) = others.split_first() else {
        return Outline {
            solid_angle: 4.0 * PI,
            ..Outline::default()
        };
    };
    let inwards = |other: u32| (own - directions[other as usize]).normalize();
    let mut sides = hemisphere(inwards(first), first);
    for &(distance, other) in rest {
        let farthest = sides
            .iter()
            .map(|side| own.distance_squared(side.start))
            .fold(0.0, f64::max);
        // Chords, by the triangle inequality. It holds only when all corners are within 60°, where no point of a side is farther than
        // its ends.
        if distance > 4.0 * farthest * (1.0 + 1e-9) {
            break;
        }
        sides = cut(&sides, inwards(other), other, &inwards);
    }
    // Corners in between two sides of one border are not of three cells.
    let n = sides.len();
    let corners: Vec<Side> = (0..n)
        .map(|k| {
            let (before, side) = (sides[(k + n - 1) % n].other, sides[k]);
            Side {
                start: if before == side.other {
                    side.start
                } else {
                    corner(directions, [index as u32, before, side.other], side.start)
                },
                ..side
            }
        })
        .collect();
    outline(&corners)
}

/// The border of the hemisphere around `pole`, counter-clockwise seen from outside, in four sides.
fn hemisphere(pole: DVec3, other: u32) -> Vec<Side> {
    let (a, b) = pole.any_orthonormal_pair();
    // So that a × b = pole.
    let b = if a.cross(b).dot(pole) < 0.0 { -b } else { b };
    [a, b, -a, -b].map(|start| Side { start, other }).to_vec()
}

/// Cuts a convex polygon, counter-clockwise seen from outside, by the great circle with the pole `inwards`, which is the border with
/// `other`.
fn cut(sides: &[Side], inwards: DVec3, other: u32, pole: &impl Fn(u32) -> DVec3) -> Vec<Side> {
    let heights: Vec<f64> = sides.iter().map(|side| inwards.dot(side.start)).collect();
    if heights.iter().all(|&height| height >= 0.0) {
        return sides.to_vec();
    }
    let n = sides.len();
    let crossing = |k: usize| {
        let (low, high) = (heights[k], heights[(k + 1) % n]);
        let (start, end) = (sides[k].start, sides[(k + 1) % n].start);
        let point = start * high.abs() + end * low.abs();
        // On both circles, to rounding, where they meet at a fair angle.
        let exact = pole(sides[k].other).cross(inwards);
        let exact = if exact.dot(point) < 0.0 {
            -exact
        } else {
            exact
        };
        exact
            .try_normalize()
            .filter(|exact| exact.dot(point.normalize_or_zero()) > 0.5)
            .or_else(|| point.try_normalize())
            .unwrap_or(start)
    };
    let mut kept = Vec::with_capacity(n + 3);
    let mut leaves = None;
    let mut enters = None;
    for k in 0..n {
        let (is_in, stays) = (heights[k] >= 0.0, heights[(k + 1) % n] >= 0.0);
        if is_in {
            kept.push(sides[k]);
        }
        if is_in && !stays {
            let point = crossing(k);
            leaves = Some((kept.len(), point));
            kept.push(Side {
                start: point,
                other,
            });
        } else if !is_in && stays {
            let point = crossing(k);
            enters = Some(point);
            kept.push(Side {
                start: point,
                other: sides[k].other,
            });
        }
    }
    let (Some((place, start)), Some(end)) = (leaves, enters) else {
        // Nothing of it is inside.
        return Vec::new();
    };
    // The new side may be half a circle. It runs counter-clockwise around the pole.
    let turn = inwards.dot(start.cross(end)).atan2(start.dot(end));
    let turn = if turn < -0.5 * PI { PI } else { turn };
    if turn > LONGEST_SIDE {
        let (sin, cos) = (0.5 * turn).sin_cos();
        let middle = cos * start + sin * inwards.cross(start);
        kept.insert(
            place + 1,
            Side {
                start: middle.normalize(),
                other,
            },
        );
    }
    kept
}

/// The point that is equally far from three directions, on the side of `near`; the same for any order of the three.
fn corner(directions: &[DVec3], mut indices: [u32; 3], near: DVec3) -> DVec3 {
    indices.sort_unstable();
    let [a, b, c] = indices.map(|index| directions[index as usize]);
    match (b - a).cross(c - a).try_normalize() {
        Some(corner) if corner.dot(near) < 0.0 => -corner,
        Some(corner) => corner,
        None => near,
    }
}

/// Turns the sides around, leaves out those without length, and measures the area.
fn outline(sides: &[Side]) -> Outline {
    let n = sides.len();
    let sides: Vec<Side> = (0..n)
        .filter(|&k| angle(sides[k].start, sides[(k + 1) % n].start) > SAME)
        .map(|k| sides[k])
        .collect();
    if sides.len() < 3 {
        return Outline::default();
    }
    let vertices: Vec<DVec3> = sides.iter().rev().map(|side| side.start).collect();
    let n = sides.len();
    // Turned around, the side that starts at corner k is the one that ended there.
    let neighbours = (0..n).map(|k| sides[(2 * n - 2 - k) % n].other).collect();
    Outline {
        solid_angle: solid_angle(&vertices),
        vertices,
        neighbours,
    }
}

/// Solid angle of a convex polygon of at most a hemisphere, counter-clockwise seen from the origin.
///
/// Source: A. Van Oosterom and J. Strackee, "The solid angle of a plane triangle", 1983, summed over a fan around an inner point.
pub(super) fn solid_angle(vertices: &[DVec3]) -> f64 {
    let sides = || {
        vertices
            .iter()
            .zip(vertices.iter().cycle().skip(1))
            .map(|(&a, &b)| (a, b))
    };
    // Lambert's light vector: it points inwards for a hemisphere too.
    let inner: DVec3 = sides()
        .map(|(a, b)| angle(a, b) * b.cross(a).normalize_or_zero())
        .sum();
    let Some(inner) = inner.try_normalize() else {
        return 0.0;
    };
    sides()
        .map(|(a, b)| {
            // The determinant of differences is that of the corners, without their cancellation in small triangles.
            let volume = inner.dot((b - inner).cross(a - inner));
            let sum = 1.0 + inner.dot(a) + inner.dot(b) + a.dot(b);
            2.0 * volume.atan2(sum)
        })
        .sum()
}

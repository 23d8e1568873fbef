//! Finds the way out for a sample that sits inside other geometry.
//!
//! A wall that stands on a floor hides the floor below it, but the texels at its foot reach out from under it: half of such a texel is
//! seen, and its centre lies inside the wall, where it is dark. From there the first thing along the floor is the inside of the wall,
//! its back. The sample belongs just beyond.

use glam::DVec3;

use super::{Obstacle, Texel};

/// The line tests start off the surface by this part of a texel's step, so that they neither touch the surface itself nor pass below the
/// things that stand on it. Larger ones miss thin things (a rug of 1 mm at 8 texels per metre), smaller ones catch bumps of the
/// surface's own facets.
const LIFT: f64 = 1.0 / 256.0;

/// Rounding of positions: those of occluders may be kept in 32 bits, and each end of a difference is off by half a step of them.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// How often a sample may move: out of a wall and then out of the one that crosses it there, and once more.
const MOVES: usize = 3;

/// Where the sample of `texel` belongs, if not where it is.
pub(super) fn exit(
    texel: &Texel,
    first_hit: &(dyn Fn(DVec3, DVec3, f64) -> Option<Obstacle> + Sync),
) -> Option<DVec3> {
    let mut position = texel.position;
    for _ in 0..MOVES {
        match nearest_exit(texel, position, first_hit) {
            Some(next) => position = next,
            None if position == texel.position => return None,
            None => return Some(position),
        }
    }
    // Still inside of something: there is no free place within the footprint.
    nearest_exit(texel, position, first_hit)
        .is_none()
        .then_some(position)
}

/// The nearest place beyond a back, seen from `position`, that lies within the bilinear footprint of `texel`.
fn nearest_exit(
    texel: &Texel,
    position: DVec3,
    first_hit: &(dyn Fn(DVec3, DVec3, f64) -> Option<Obstacle> + Sync),
) -> Option<DVec3> {
    let step = texel.du.length().min(texel.dv.length());
    let clearance = LIFT * step + ROUNDING * position.abs().max_element();
    let origin = position + texel.geometric_normal * clearance;
    // Lines start a little behind the sample: walls often stand where texels have their centres, and a sample on the side of a wall is
    // half inside. Half the clearance, so that a sample that has stepped off a surface is found free.
    let run_up = 0.5 * clearance;
    let mut best: Option<(f64, DVec3)> = None;
    for (u, v) in [
        (1.0, 0.0),
        (-1.0, 0.0),
        (0.0, 1.0),
        (0.0, -1.0),
        (1.0, 1.0),
        (-1.0, 1.0),
        (1.0, -1.0),
        (-1.0, -1.0),
    ] {
        let way = texel.du * u + texel.dv * v;
        let length = way.length();
        let Some(direction) = way.try_normalize() else {
            continue;
        };
        // From a little behind: walls often stand where texels have their centres, and the side of a wall is no place for a sample either.
        let Some(hit) = first_hit(
            origin - direction * clearance,
            direction,
            length + clearance,
        ) else {
            continue;
        };
        if !hit.back {
            continue;
        }
        // As far from the surface that was passed as from the one it lies on; a grazed one is left at a tenth of that.
        let passed = hit.distance - run_up;
        let beyond = passed + clearance / direction.dot(hit.normal).abs().max(0.1);
        let place = position + direction * beyond;
        if best.is_none_or(|(distance, _)| beyond < distance) && is_within(texel, place) {
            best = Some((beyond, place));
        }
    }
    best.map(|(_, place)| place)
}

/// Whether a place on the texel's plane lies less than one texel from where the texel was.
fn is_within(texel: &Texel, place: DVec3) -> bool {
    let offset = place - texel.position;
    // Solve offset = u du + v dv with the normal equations.
    let (uu, uv, vv) = (
        texel.du.length_squared(),
        texel.du.dot(texel.dv),
        texel.dv.length_squared(),
    );
    let (u, v) = (texel.du.dot(offset), texel.dv.dot(offset));
    let determinant = uu * vv - uv * uv;
    let (column, row) = (u * vv - v * uv, v * uu - u * uv);
    column.abs() <= determinant && row.abs() <= determinant
}

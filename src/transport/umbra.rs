//! Tiles in the full shadow of a single triangle: a wall, a ceiling, the ground.
//!
//! All lines from a convex set to another cross a plane between them in a convex set. So when the lines from the corners of the tile's box to
//! the corners of the light cross one triangle, all lines do, and nothing of the light is seen. Most tiles of a building are in the
//! dark of most lights and most of the sky by a wall alone.

use std::cell::OnceCell;

use glam::DVec3;

use super::source::Source;
use crate::math::Aabb;
use crate::visibility::Occluders;

/// How far inside the triangle lines must pass, as a share of its area: far more than rounding.
const INSIDE: f64 = 1e-9;

/// Whether one of `candidates`, ascending triangles of the scene that are not the light's own, hides all of `source` from all of `places`.
pub(super) fn is_total(
    source: &Source<'_>,
    places: &Aabb,
    occluders: &Occluders<'_>,
    candidates: &[u32],
) -> bool {
    let centre = places.centre();
    let middle = source.seen_middle(centre);
    let edges = occluders.edges();
    let vertices_of = |id: u32| edges.corners[id as usize].map(|v| edges.vertices[v as usize]);
    // One corner and what it sees after the other; needed only where some triangle stands in the middle.
    let lines = OnceCell::new();
    let lines_of = || -> Vec<(DVec3, Vec<DVec3>)> {
        let corners = places.corners();
        corners.map(|from| (from, source.hull(from))).into()
    };
    candidates
        .iter()
        .filter(|&&id| !occluders.is_masked(id))
        .map(|&id| vertices_of(id))
        .filter(|triangle| is_crossed(triangle, centre, middle))
        .any(|triangle| {
            lines
                .get_or_init(lines_of)
                .iter()
                .all(|(from, hull)| hull.iter().all(|to| is_crossed(&triangle, *from, *to)))
        })
}

/// Whether the segment crosses the inside of a triangle, with something to spare.
fn is_crossed([a, b, c]: &[DVec3; 3], from: DVec3, to: DVec3) -> bool {
    let normal = (b - a).cross(c - a);
    let (start, end) = (normal.dot(from - a), normal.dot(to - a));
    let rounding = INSIDE * normal.length() * (to - from).length();
    if start.abs() <= rounding || end.abs() <= rounding || (start > 0.0) == (end > 0.0) {
        return false;
    }
    let place = from + (to - from) * (start / (start - end));
    let least = INSIDE * normal.length_squared();
    [(a, b), (b, c), (c, a)]
        .iter()
        .all(|(p, q)| (**q - **p).cross(place - **p).dot(normal) > least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_cross_the_inside_of_a_triangle_only() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let through = |x: f64, y: f64| {
            let (from, to) = (DVec3::new(x, y, -1.0), DVec3::new(x, y, 2.0));
            is_crossed(&triangle, from, to) && is_crossed(&triangle, to, from)
        };
        assert!(through(0.2, 0.2) && through(0.01, 0.9));
        assert!(!through(0.0, 0.5) && !through(0.6, 0.6) && !through(-0.1, 0.1));
        let touching = DVec3::new(0.2, 0.2, 0.0);
        assert!(!is_crossed(&triangle, touching, touching + DVec3::Z));
    }
}

//! Triangles too thin to show a texel of their own take their light from a neighbour.
//!
//! Levels cut by planes (BSP) are full of needles that close T-junctions. Their normals are noise, which makes xatlas fold the charts
//! they are in, and a chart of their own would spend hundreds of texels on a hairline. So they are kept out of the charts and afterwards
//! get the texture coordinates of the nearest place on a neighbour.

use glam::{DVec2, DVec3};

use super::chart::Surface;
use super::split::Forest;

/// Height below which a triangle is too thin, in texels. Light does not change over a fiftieth of a texel; a larger limit would
/// smear thin trims that are seen from near.
const MAX_HEIGHT: f64 = 0.02;

/// The same relative to the longest edge: small meshes, whose triangles are all below a texel, are no slivers.
const MAX_SLENDERNESS: f64 = 0.02;

/// Which triangles are too thin. A connected surface that has no other triangles keeps them all.
pub(super) fn slivers(surface: &Surface) -> Vec<bool> {
    let thin: Vec<bool> = (0..surface.triangles.len())
        .map(|triangle| {
            let [a, b, c] = surface.corners(triangle);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let doubled = (b - a).cross(c - a).length();
            doubled <= MAX_HEIGHT.min(MAX_SLENDERNESS * longest) * longest
        })
        .collect();
    let mut forest = Forest {
        parents: surface.places.clone(),
    };
    for triangle in &surface.triangles {
        forest.join(triangle[0], triangle[1]);
        forest.join(triangle[0], triangle[2]);
    }
    let mut has_body = vec![false; surface.places.len()];
    for (triangle, &thin) in surface.triangles.iter().zip(&thin) {
        has_body[forest.root(triangle[0]) as usize] |= !thin;
    }
    thin.iter()
        .zip(&surface.triangles)
        .map(|(&thin, triangle)| thin && has_body[forest.root(triangle[0]) as usize])
        .collect()
}

/// Where a triangle lies in the layout.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// Part of the layout.
    pub(super) part: usize,
    /// Texels.
    pub(super) corners: [DVec2; 3],
}

/// Places for the triangles that have none in `spots`, on the neighbours that have; `None` for those without such a neighbour.
///
/// Neighbours share a position; one that shares an edge comes first. Needles beside needles pass the place on.
pub(super) fn borrow(surface: &Surface, spots: &[Option<Spot>]) -> Vec<Option<Spot>> {
    // The triangles at each place that give a home.
    let mut homes: Vec<Vec<u32>> = vec![Vec::new(); surface.places.len()];
    let places = |triangle: usize| {
        surface.triangles[triangle].map(|vertex| surface.places[vertex as usize] as usize)
    };
    let mut waiting = Vec::new();
    for (triangle, spot) in spots.iter().enumerate() {
        if spot.is_none() {
            waiting.push(triangle);
            continue;
        }
        for place in places(triangle) {
            homes[place].push(triangle as u32);
        }
    }
    let mut borrowed = vec![None; spots.len()];
    loop {
        let before = waiting.len();
        waiting.retain(|&triangle| {
            let own = places(triangle);
            let home = own
                .iter()
                .flat_map(|&place| homes[place].iter().copied())
                .min_by_key(|&home| {
                    let theirs = places(home as usize);
                    let shared = own.iter().filter(|place| theirs.contains(place)).count();
                    (std::cmp::Reverse(shared), home)
                });
            let Some((home, spot)) = home.and_then(|home| Some((home, spots[home as usize]?)))
            else {
                return true;
            };
            borrowed[triangle] = Some(Spot {
                corners: surface
                    .corners(triangle)
                    .map(|point| nearest(point, surface.corners(home as usize), spot.corners)),
                ..spot
            });
            for place in own {
                if !homes[place].contains(&home) {
                    homes[place].push(home);
                }
            }
            false
        });
        if waiting.len() == before {
            return borrowed;
        }
    }
}

/// The place in the layout of the point of a triangle near `point`: its foot on the triangle's plane, weights cut off at 0.
fn nearest(point: DVec3, corners: [DVec3; 3], flat: [DVec2; 3]) -> DVec2 {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let weight = |from: DVec3, to: DVec3| (to - from).cross(point - from).dot(normal).max(0.0);
    let weights = [weight(b, c), weight(c, a), weight(a, b)];
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 {
        (flat[0] * weights[0] + flat[1] * weights[1] + flat[2] * weights[2]) / sum
    } else {
        flat[0]
    }
}

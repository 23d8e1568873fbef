//! The edges that occluders share, so that outlines can be told from inner edges.
//!
//! Vertices are welded where their world positions are equal to the bit, over all instances: modular pieces that meet edge to edge cast
//! one shadow, and a box of two triangles per side has twelve edges that matter.

use glam::DVec3;

use crate::scene::Scene;

/// Welded vertices and edges of all triangles of a scene.
#[derive(Clone, Debug, Default)]
pub struct Edges {
    /// World metres, each position once, in ascending order of (x, y, z).
    pub vertices: Vec<DVec3>,
    /// Per edge its two vertices, the smaller index first.
    pub ends: Vec<[u32; 2]>,
    /// Per scene triangle its vertices, fronts counter-clockwise.
    pub corners: Vec<[u32; 3]>,
    /// Per scene triangle its edges; edge k runs from corner k to corner k + 1.
    pub sides: Vec<[u32; 3]>,
}

impl Edges {
    /// Welds all triangles of `scene`; O(n log n).
    #[must_use]
    pub fn build(scene: &Scene) -> Self {
        let (vertices, corners) = weld(scene);
        // Each side once per triangle, sorted so that the sides of one edge lie together.
        let mut uses: Vec<([u32; 2], u32)> = corners
            .iter()
            .enumerate()
            .flat_map(|(triangle, &[a, b, c])| {
                [[a, b], [b, c], [c, a]]
                    .into_iter()
                    .enumerate()
                    .map(move |(side, [from, to])| {
                        ([from.min(to), from.max(to)], (3 * triangle + side) as u32)
                    })
            })
            .collect();
        uses.sort_unstable();
        let mut ends: Vec<[u32; 2]> = Vec::new();
        let mut sides = vec![[0; 3]; corners.len()];
        for (edge, slot) in uses {
            if ends.last() != Some(&edge) {
                ends.push(edge);
            }
            sides[slot as usize / 3][slot as usize % 3] = ends.len() as u32 - 1;
        }
        Self {
            vertices,
            ends,
            corners,
            sides,
        }
    }

    /// +1 when `triangle` runs along its side `side` from the edge's first vertex to its second, else −1.
    #[must_use]
    pub fn direction(&self, triangle: u32, side: usize) -> i32 {
        let corners = self.corners[triangle as usize];
        if corners[side] < corners[(side + 1) % 3] {
            1
        } else {
            -1
        }
    }
}

/// Numbers equal positions alike.
fn weld(scene: &Scene) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    // Adding zero turns −0 into +0, so that both weld.
    let position =
        |slot: u32| scene.triangles[slot as usize / 3].vertices[slot as usize % 3] + DVec3::ZERO;
    let mut order: Vec<u32> = (0..3 * scene.triangles.len() as u32).collect();
    order.sort_unstable_by(|&a, &b| {
        let (p, q) = (position(a), position(b));
        p.x.total_cmp(&q.x)
            .then(p.y.total_cmp(&q.y))
            .then(p.z.total_cmp(&q.z))
            .then(a.cmp(&b))
    });
    let mut vertices: Vec<DVec3> = Vec::new();
    let mut corners = vec![[0; 3]; scene.triangles.len()];
    for slot in order {
        let place = position(slot);
        if vertices.last() != Some(&place) {
            vertices.push(place);
        }
        corners[slot as usize / 3][slot as usize % 3] = vertices.len() as u32 - 1;
    }
    (vertices, corners)
}

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
    /// Which sides of triangles lie on each edge.
    around_edges: Lists,
    /// Which corners of triangles lie on each vertex.
    around_vertices: Lists,
}

/// Lists of slots, one per edge or vertex. A slot is 3 · triangle + side or corner.
#[derive(Clone, Debug, Default)]
struct Lists {
    /// The list of i ends at `ends[i]` and starts where that of i − 1 ends.
    ends: Vec<u32>,
    slots: Vec<u32>,
}

impl Lists {
    fn of(&self, index: u32) -> impl Iterator<Item = (u32, usize)> {
        let index = index as usize;
        let start = index.checked_sub(1).map_or(0, |before| self.ends[before]);
        self.slots[start as usize..self.ends[index] as usize]
            .iter()
            .map(|slot| (slot / 3, *slot as usize % 3))
    }
}

impl Edges {
    /// Welds all triangles of `scene`; O(n log n).
    #[must_use]
    pub fn build(scene: &Scene) -> Self {
        let (vertices, corners, around_vertices) = weld(scene);
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
        let mut around_edges = Lists::default();
        for (edge, slot) in uses {
            if ends.last() != Some(&edge) {
                ends.push(edge);
                around_edges.ends.push(0);
            }
            sides[slot as usize / 3][slot as usize % 3] = ends.len() as u32 - 1;
            around_edges.slots.push(slot);
            around_edges.ends[ends.len() - 1] = around_edges.slots.len() as u32;
        }
        Self {
            vertices,
            ends,
            corners,
            sides,
            around_edges,
            around_vertices,
        }
    }

    /// Triangles that have `edge` and which of their sides it is, ascending.
    pub fn around_edge(&self, edge: u32) -> impl Iterator<Item = (u32, usize)> {
        self.around_edges.of(edge)
    }

    /// Triangles that have `vertex` and which of their corners it is, ascending.
    pub fn around_vertex(&self, vertex: u32) -> impl Iterator<Item = (u32, usize)> {
        self.around_vertices.of(vertex)
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
fn weld(scene: &Scene) -> (Vec<DVec3>, Vec<[u32; 3]>, Lists) {
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
    let mut ends = Vec::new();
    for (count, &slot) in (1..).zip(&order) {
        let place = position(slot);
        if vertices.last() != Some(&place) {
            vertices.push(place);
            ends.push(0);
        }
        corners[slot as usize / 3][slot as usize % 3] = vertices.len() as u32 - 1;
        ends[vertices.len() - 1] = count;
    }
    let slots = order;
    (vertices, corners, Lists { ends, slots })
}

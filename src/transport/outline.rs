//! What a tile's receivers have in common about the occluders before a light: which triangles, which edges, and which way they face.

use glam::DVec3;

use crate::math::Aabb;
use crate::visibility::Edges;

/// Occluders between a group of receivers and a light, reduced to the edges that can be silhouettes.
#[derive(Debug, Default)]
pub(super) struct Outline {
    /// World metres.
    pub(super) vertices: Vec<DVec3>,
    /// Edges that some receiver of the group may see as a silhouette.
    pub(super) edges: Vec<Edge>,
    /// Triangles that some receivers see from the front and others from the back.
    pub(super) varying: Vec<Facet>,
    /// Triangles that may reach behind a receiver or behind the light.
    pub(super) crossing: Vec<Facet>,
}

/// A candidate silhouette edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    /// Indices in [`Outline::vertices`].
    pub(super) ends: [u32; 2],
    /// The same as welded vertices of the scene.
    pub(super) welded: [u32; 2],
    /// Sum over the triangles that face one way for the whole group: +1 for each that the receiver sees wound clockwise along the edge.
    pub(super) fixed: i32,
}

/// A side of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    /// Index in [`Outline::edges`].
    pub(super) edge: u32,
    /// +1 when the front's winding runs from the edge's first end to its second, else −1.
    pub(super) direction: i32,
}

/// A triangle whose facing must be asked per receiver.
#[derive(Clone, Copy, Debug)]
pub(super) struct Facet {
    normal: DVec3,
    point: DVec3,
    rounding: f64,
    pub(super) sides: [Side; 3],
}

impl Facet {
    /// +1 when `receiver` sees the front, −1 for the back, 0 when it lies in the plane within rounding.
    pub(super) fn facing(&self, receiver: DVec3) -> i32 {
        let height = self.normal.dot(receiver - self.point);
        if height > self.rounding {
            1
        } else if height < -self.rounding {
            -1
        } else {
            0
        }
    }

    /// The facing that all of `receivers` agree on.
    fn common_facing(&self, receivers: &Aabb) -> Option<i32> {
        let corners = receivers.corners().map(|corner| self.facing(corner));
        (corners[0] != 0 && corners.iter().all(|facing| *facing == corners[0]))
            .then_some(corners[0])
    }
}

impl Outline {
    /// - `receivers`: box of the receivers' positions.
    /// - `candidates`: the triangles in their shaft to the light, ascending.
    /// - `light`: a point of the light's plane, and the plane's unit normal that points away from the receivers.
    pub(super) fn new(
        edges: &Edges,
        receivers: &Aabb,
        candidates: &[u32],
        (light, away): (DVec3, DVec3),
    ) -> Self {
        let mut outline = Self::default();
        let (vertex_ids, edge_ids) = used(edges, candidates);
        outline.vertices = vertex_ids
            .iter()
            .map(|&vertex| edges.vertices[vertex as usize])
            .collect();
        let local_vertex = |vertex: u32| index_of(&vertex_ids, vertex);
        outline.edges = edge_ids
            .iter()
            .map(|&edge| {
                let welded = edges.ends[edge as usize];
                Edge {
                    ends: welded.map(local_vertex),
                    welded,
                    fixed: 0,
                }
            })
            .collect();
        let nearest = receivers
            .corners()
            .iter()
            .map(|corner| corner.dot(away))
            .fold(f64::NEG_INFINITY, f64::max);
        let farthest = light.dot(away);
        // Edges that no triangle of varying facing touches keep their fixed coefficient.
        let mut open = vec![false; outline.edges.len()];
        for &triangle in candidates {
            let facet = outline.facet(edges, triangle, &edge_ids);
            match facet.common_facing(receivers) {
                Some(facing) => {
                    for side in &facet.sides {
                        // A front is wound counter-clockwise as the receiver sees it, contours are clockwise.
                        outline.edges[side.edge as usize].fixed -= facing * side.direction;
                    }
                }
                None => {
                    for side in &facet.sides {
                        open[side.edge as usize] = true;
                    }
                    outline.varying.push(facet);
                }
            }
            let depths = edges.corners[triangle as usize]
                .map(|corner| edges.vertices[corner as usize].dot(away));
            // The margin covers the nearest depth that is looked at and rounding; a triangle too many costs time only.
            let margin = 1e-6 * (farthest - nearest).abs() + facet.rounding;
            if depths
                .iter()
                .any(|depth| *depth < nearest + margin || *depth > farthest - margin)
            {
                for side in &facet.sides {
                    open[side.edge as usize] = true;
                }
                outline.crossing.push(facet);
            }
        }
        outline.drop_inner_edges(&open);
        outline
    }

    /// How many edges are looked at per receiver.
    pub(super) fn n_edges(&self) -> usize {
        self.edges.len()
    }

    fn facet(&self, edges: &Edges, triangle: u32, edge_ids: &[u32]) -> Facet {
        let [a, b, c] =
            edges.corners[triangle as usize].map(|corner| edges.vertices[corner as usize]);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let size = a.abs().max(b.abs()).max(c.abs()).max_element();
        let mut side = 0;
        Facet {
            normal,
            point: a,
            // Of a vertex, and of the plane through three of them.
            rounding: 8.0 * f64::EPSILON * size,
            sides: edges.sides[triangle as usize].map(|edge| {
                let direction = edges.direction(triangle, side);
                side += 1;
                Side {
                    edge: index_of(edge_ids, edge),
                    direction,
                }
            }),
        }
    }

    /// Removes edges whose coefficient is 0 for every receiver, and vertices that no edge is left of.
    fn drop_inner_edges(&mut self, open: &[bool]) {
        let mut place = vec![u32::MAX; self.edges.len()];
        let mut kept = Vec::new();
        for (index, edge) in self.edges.iter().enumerate() {
            if open[index] || edge.fixed != 0 {
                place[index] = kept.len() as u32;
                kept.push(*edge);
            }
        }
        let mut vertex_place = vec![u32::MAX; self.vertices.len()];
        let mut vertices = Vec::new();
        for edge in &mut kept {
            for end in &mut edge.ends {
                let place = &mut vertex_place[*end as usize];
                if *place == u32::MAX {
                    *place = vertices.len() as u32;
                    vertices.push(self.vertices[*end as usize]);
                }
                *end = *place;
            }
        }
        self.edges = kept;
        self.vertices = vertices;
        for facet in self.varying.iter_mut().chain(&mut self.crossing) {
            for side in &mut facet.sides {
                side.edge = place[side.edge as usize];
            }
        }
    }
}

/// Vertices and edges of some triangles, each once, ascending.
fn used(edges: &Edges, triangles: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let collect = |lists: &[[u32; 3]]| {
        let mut ids: Vec<u32> = triangles
            .iter()
            .flat_map(|&triangle| lists[triangle as usize])
            .collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    };
    (collect(&edges.corners), collect(&edges.sides))
}

/// Position of `id` in the ascending list that holds it.
fn index_of(ids: &[u32], id: u32) -> u32 {
    ids.partition_point(|other| *other < id) as u32
}

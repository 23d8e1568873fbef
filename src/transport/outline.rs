//! What a tile's receivers have in common about the occluders before a light: which triangles, which edges, and which way they face.

use glam::DVec3;

use crate::math::Aabb;
use crate::visibility::Edges;

/// Occluders between a group of receivers and a light, reduced to the edges that can be silhouettes.
#[derive(Debug, Default)]
pub(super) struct Outline {
    /// World metres.
    pub(super) vertices: Vec<DVec3>,
    /// Edges that some receiver of the group may see as a silhouette: their ends, indices in `vertices`.
    pub(super) edges: Vec<[u32; 2]>,
    /// Per edge the sum over its triangles, varying ones as assumed: +1 for each that the receiver sees wound clockwise along it.
    pub(super) coefficients: Vec<i32>,
    /// Triangles that some receivers see from the front and others from the back.
    pub(super) varying: Vec<Varying>,
    /// Triangles that may reach behind a receiver or behind the light.
    pub(super) crossing: Vec<Facet>,
}

/// A triangle whose facing differs, and the facing that the coefficients of its edges take for granted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Varying {
    pub(super) facet: Facet,
    pub(super) assumed: i32,
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
    /// Its sides name edges of the scene.
    fn new(edges: &Edges, triangle: u32, [a, b, c]: [DVec3; 3]) -> Self {
        let size = a.abs().max(b.abs()).max(c.abs()).max_element();
        let names = edges.sides[triangle as usize];
        Self {
            normal: (b - a).cross(c - a).normalize_or_zero(),
            point: a,
            // Of a vertex, and of the plane through three of them.
            rounding: 8.0 * f64::EPSILON * size,
            sides: [0, 1, 2].map(|side| Side {
                edge: names[side],
                direction: edges.direction(triangle, side),
            }),
        }
    }

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

    /// The facing in the middle of a box, and whether it is the same all over it.
    fn facing_over(&self, centre: DVec3, half: DVec3) -> (i32, bool) {
        let height = self.normal.dot(centre - self.point);
        let reach = self.normal.abs().dot(half) + self.rounding;
        (self.facing(centre), height.abs() > reach)
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
        let nearest = receivers
            .corners()
            .iter()
            .map(|corner| corner.dot(away))
            .fold(f64::NEG_INFINITY, f64::max);
        let farthest = light.dot(away);
        let (centre, half) = (receivers.centre(), 0.5 * (receivers.max - receivers.min));
        let mut outline = Self::default();
        let mut facings = Facings::new(candidates);
        let mut kept = Vec::with_capacity(candidates.len());
        for &triangle in candidates {
            let corners =
                edges.corners[triangle as usize].map(|corner| edges.vertices[corner as usize]);
            let facet = Facet::new(edges, triangle, corners);
            let (facing, is_common) = facet.facing_over(centre, half);
            // The margin covers the nearest depth that is looked at and rounding; a triangle too many costs time only.
            let margin = 1e-6 * (farthest - nearest).abs() + facet.rounding;
            let is_crossing = corners.iter().any(|corner| {
                let depth = corner.dot(away);
                depth < nearest + margin || depth > farthest - margin
            });
            let is_open = is_crossing || !is_common;
            facings.set(triangle, if is_open { 0 } else { facing });
            kept.push((facet.sides, facing, is_open));
            if !is_common {
                outline.varying.push(Varying {
                    facet,
                    assumed: facing,
                });
            }
            if is_crossing {
                outline.crossing.push(facet);
            }
        }
        let mut uses = Vec::new();
        for (sides, facing, is_open) in kept {
            for side in sides {
                if is_open || !facings.cancel_at(edges, side.edge) {
                    uses.push(Use {
                        edge: side.edge,
                        // A front is wound counter-clockwise as the receiver sees it, contours are clockwise.
                        coefficient: -facing * side.direction,
                        is_open,
                    });
                }
            }
        }
        outline.keep_silhouettes(edges, uses);
        outline
    }

    /// How many edges are looked at per receiver.
    pub(super) fn n_edges(&self) -> usize {
        self.edges.len()
    }

    /// Adds the edges that are not inner ones for every receiver, and numbers them and their vertices.
    fn keep_silhouettes(&mut self, edges: &Edges, mut uses: Vec<Use>) {
        uses.sort_unstable_by_key(|use_| use_.edge);
        let mut names = Vec::new();
        for group in uses.chunk_by(|a, b| a.edge == b.edge) {
            let coefficient = group.iter().map(|use_| use_.coefficient).sum();
            if coefficient != 0 || group.iter().any(|use_| use_.is_open) {
                names.push(group[0].edge);
                self.coefficients.push(coefficient);
            }
        }
        let ends = |edge: &u32| edges.ends[*edge as usize];
        let mut vertices: Vec<u32> = names.iter().flat_map(ends).collect();
        vertices.sort_unstable();
        vertices.dedup();
        self.edges = names
            .iter()
            .map(|edge| ends(edge).map(|end| index_of(&vertices, end)))
            .collect();
        self.vertices = vertices
            .iter()
            .map(|vertex| edges.vertices[*vertex as usize])
            .collect();
        let varying = self.varying.iter_mut().map(|varying| &mut varying.facet);
        for facet in varying.chain(&mut self.crossing) {
            for side in &mut facet.sides {
                side.edge = index_of(&names, side.edge);
            }
        }
    }
}

/// How candidates face all receivers alike, by their names.
struct Facings {
    /// Name of the first candidate.
    first: u32,
    /// 0 for what is no candidate, is cut, or does not face all receivers alike. Empty where names are spread too far.
    facings: Vec<i8>,
}

impl Facings {
    /// Names per candidate up to which there is a table of all names between: to fill it costs a fraction of an instruction each.
    const SPREAD: usize = 64;

    fn new(candidates: &[u32]) -> Self {
        let (first, last) = (candidates.first(), candidates.last());
        let (first, last) = (first.map_or(0, |id| *id), last.map_or(0, |id| *id));
        let spread = (last - first) as usize + 1;
        let n_names = if spread <= Self::SPREAD * candidates.len() {
            spread
        } else {
            0
        };
        Self {
            first,
            facings: vec![0; n_names],
        }
    }

    fn set(&mut self, triangle: u32, facing: i32) {
        if let Some(slot) = self.facings.get_mut((triangle - self.first) as usize) {
            *slot = facing as i8;
        }
    }

    fn get(&self, triangle: u32) -> i32 {
        let place = triangle.checked_sub(self.first);
        let facing = place.and_then(|place| self.facings.get(place as usize));
        facing.map_or(0, |facing| i32::from(*facing))
    }

    /// Whether an edge surely has no coefficient: just two triangles meet there and say opposite things. Most edges are such, so few
    /// need sorting.
    fn cancel_at(&self, edges: &Edges, edge: u32) -> bool {
        let mut around = edges.around_edge(edge);
        let (Some(a), Some(b), None) = (around.next(), around.next(), around.next()) else {
            return false;
        };
        let [a, b] = [a, b].map(|(triangle, side)| {
            let facing = self.get(triangle);
            facing * edges.direction(triangle, side)
        });
        a != 0 && a + b == 0
    }
}

/// A side of a triangle at an edge.
struct Use {
    /// Name in the scene.
    edge: u32,
    coefficient: i32,
    /// Whether the edge is looked at whatever the coefficients sum up to.
    is_open: bool,
}

/// Position of `id` in the ascending list that holds it.
fn index_of(ids: &[u32], id: u32) -> u32 {
    ids.partition_point(|other| *other < id) as u32
}

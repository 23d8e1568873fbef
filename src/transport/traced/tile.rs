//! The occluders between a tile and a light: which of them hang together, and where.

use glam::DVec3;

use crate::math::Aabb;
use crate::transport::contour::Piece;
use crate::visibility::{Edges, Occluders};

/// Triangles of a connected part up to which all its outlines are looked up, instead of waiting for rays to meet them. That costs as much as a
/// few rays; what a coarse mesh hides, a post or a bar, passes between the rays more easily than what a fine one does.
pub(super) const FEW_TRIANGLES: usize = 256;

/// Growth of boxes, relative to their largest coordinate: far above the rounding of a ray, far below anything that is seen.
const BOX_SLACK: f64 = 1e-12;

/// The occluders between a tile and a light, in connected parts.
#[derive(Debug)]
pub(in crate::transport) struct Tile<'a> {
    pub(super) occluders: &'a Occluders<'a>,
    pub(super) edges: &'a Edges,
    /// Ascending.
    pub(super) candidates: Vec<u32>,
    /// What each of them has at each of its sides.
    pub(super) neighbours: Vec<[Neighbour; 3]>,
    /// The connected part that each of them belongs to.
    pub(super) components: Vec<u32>,
    /// World boxes of the connected parts.
    pub(super) boxes: Vec<Aabb>,
    /// How many triangles each of them has.
    pub(super) sizes: Vec<usize>,
}

/// The other candidates at a side of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Neighbour {
    None,
    /// Its place among the candidates.
    One(u32),
    Several,
}

impl<'a> Tile<'a> {
    /// `candidates` (ascending): what may hide some of the light from some receiver. `light`: a point of the light's plane and its unit
    /// normal towards all receivers.
    ///
    /// `None` when a candidate reaches to the light's plane: its outline would have to be cut there.
    pub(in crate::transport) fn new(
        occluders: &'a Occluders<'a>,
        candidates: Vec<u32>,
        (point, normal): (DVec3, DVec3),
    ) -> Option<Self> {
        let mut tile = Self {
            occluders,
            edges: occluders.edges(),
            candidates,
            neighbours: Vec::new(),
            components: Vec::new(),
            boxes: Vec::new(),
            sizes: Vec::new(),
        };
        let n_triangles = tile.candidates.len();
        let is_before = |vertex: DVec3| {
            let rounding = BOX_SLACK * (vertex.abs().max_element() + point.abs().max_element());
            normal.dot(vertex - point) > rounding
        };
        if !(0..n_triangles).all(|triangle| tile.corners(triangle).into_iter().all(is_before)) {
            return None;
        }
        tile.neighbours = (0..n_triangles)
            .map(|triangle| [0, 1, 2].map(|side| tile.neighbour(triangle, side)))
            .collect();
        tile.find_components();
        Some(tile)
    }

    /// What may hide some of the light from some receiver, ascending.
    pub(in crate::transport) fn candidates(&self) -> &[u32] {
        &self.candidates
    }

    /// Whether outlines may be missed: some connected part is too fine to be looked up.
    pub(in crate::transport) fn is_fine(&self) -> bool {
        self.sizes.iter().any(|size| *size > FEW_TRIANGLES)
    }

    /// The place of a triangle of the scene among the candidates.
    pub(super) fn place(&self, triangle: u32) -> Option<usize> {
        self.candidates.binary_search(&triangle).ok()
    }

    pub(super) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.edges.corners[self.candidates[triangle] as usize]
            .map(|corner| self.edges.vertices[corner as usize])
    }

    pub(super) fn sides(&self, triangle: usize) -> [u32; 3] {
        self.edges.sides[self.candidates[triangle] as usize]
    }

    /// Candidates that have `edge`, and which of their sides it is.
    pub(super) fn around_edge(&self, edge: u32) -> impl Iterator<Item = (usize, usize)> {
        self.edges
            .around_edge(edge)
            .filter_map(|(triangle, side)| Some((self.place(triangle)?, side)))
    }

    fn neighbour(&self, triangle: usize, side: usize) -> Neighbour {
        let edge = self.sides(triangle)[side];
        let mut others = self
            .around_edge(edge)
            .filter(|(other, _)| *other != triangle);
        match (others.next(), others.next()) {
            (None, _) => Neighbour::None,
            (Some((other, _)), None) => Neighbour::One(other as u32),
            _ => Neighbour::Several,
        }
    }

    /// Numbers the parts that hang together by edges, and finds their boxes.
    fn find_components(&mut self) {
        const NONE: u32 = u32::MAX;
        self.components = vec![NONE; self.candidates.len()];
        let mut stack = Vec::new();
        for start in 0..self.candidates.len() {
            if self.components[start] != NONE {
                continue;
            }
            let component = self.boxes.len() as u32;
            let (mut bounds, mut size) = (Aabb::EMPTY, 0);
            self.components[start] = component;
            stack.push(start);
            while let Some(triangle) = stack.pop() {
                size += 1;
                bounds = bounds.union(Aabb::from_points(self.corners(triangle)));
                for edge in self.sides(triangle) {
                    for (other, _) in self.edges.around_edge(edge) {
                        if let Some(other) = self.place(other)
                            && self.components[other] == NONE
                        {
                            self.components[other] = component;
                            stack.push(other);
                        }
                    }
                }
            }
            self.boxes.push(bounds);
            self.sizes.push(size);
        }
    }

    /// Connected parts whose boxes reach into the pyramid from `receiver` to the light.
    pub(super) fn before(&self, receiver: DVec3, borders: &[Piece]) -> Vec<usize> {
        let planes = pyramid(borders);
        (0..self.boxes.len())
            .filter(|&component| {
                let grown = self.relative_box(component, receiver);
                planes.iter().all(|plane| {
                    let highest = (*plane * grown.min).max(*plane * grown.max);
                    highest.element_sum() > 0.0
                })
            })
            .collect()
    }

    /// The box of a connected part relative to the receiver, a little larger.
    pub(super) fn relative_box(&self, component: usize, receiver: DVec3) -> Aabb {
        let bounds = &self.boxes[component];
        let slack = BOX_SLACK * (bounds.largest_coordinate() + receiver.abs().max_element());
        Aabb {
            min: bounds.min - receiver - slack,
            max: bounds.max - receiver + slack,
        }
    }
}

/// Inward normals of the planes through the receiver and the sides of a convex light.
pub(super) fn pyramid(borders: &[Piece]) -> Vec<DVec3> {
    borders
        .iter()
        .map(|border| border.a.cross(border.b - border.a))
        .collect()
}

//! The meshes of a tile's occluders as one receiver sees them: which side of an edge is covered, where a line leaves what hides it, and how
//! an outline goes on.

use std::cell::Cell;

use glam::DVec3;

use super::{Neighbour, Tile};
use crate::visibility::Edges;

/// Triangles that a line may cross on its way to an outline. A sphere of a million triangles has a thousand across; more is a mesh that
/// runs in circles.
const MAX_STEPS: usize = 1 << 14;

/// As in `outline`: of a vertex, and of the plane through three of them, in roundings of the largest coordinate.
const PLANE_ROUNDING: f64 = 8.0 * f64::EPSILON;

/// The meshes of a tile, from one receiver. Triangles go by their places among the candidates.
pub(super) struct Mesh<'a> {
    pub(super) tile: &'a Tile<'a>,
    edges: &'a Edges,
    receiver: DVec3,
    /// Per candidate, once it was asked for; few are.
    facings: Vec<Cell<Option<i32>>>,
}

impl<'a> Mesh<'a> {
    pub(super) fn new(tile: &'a Tile<'a>, receiver: DVec3) -> Self {
        Self {
            tile,
            edges: tile.edges,
            receiver,
            facings: vec![Cell::new(None); tile.candidates.len()],
        }
    }

    /// Position of a welded vertex relative to the receiver.
    fn vertex(&self, vertex: u32) -> DVec3 {
        self.edges.vertices[vertex as usize] - self.receiver
    }

    /// +1 when the receiver sees the front, −1 for the back, 0 when it lies in the plane within rounding.
    fn facing(&self, triangle: usize) -> i32 {
        let facing = self.facings[triangle]
            .get()
            .unwrap_or_else(|| self.side_of_receiver(triangle));
        self.facings[triangle].set(Some(facing));
        facing
    }

    fn side_of_receiver(&self, triangle: usize) -> i32 {
        let [a, b, c] = self.tile.corners(triangle);
        let normal = (b - a).cross(c - a);
        let size = a.abs().max(b.abs()).max(c.abs()).max_element();
        let height = normal.dot(self.receiver - a);
        let rounding = PLANE_ROUNDING * size * normal.length();
        if height > rounding {
            1
        } else if height < -rounding {
            -1
        } else {
            0
        }
    }

    /// Which side of its side `side` a triangle covers: +1 for the left of the edge from its first end to its second, in the plane of the
    /// light, where fronts are wound clockwise; 0 when it is seen edge-on.
    fn covers(&self, triangle: usize, side: usize) -> i32 {
        -self.facing(triangle) * self.edges.direction(self.tile.candidates[triangle], side)
    }

    /// The triangle that goes on covering where `triangle` ends at its side `side`.
    fn across(&self, triangle: usize, side: usize) -> Option<usize> {
        let edge = self.tile.sides(triangle)[side];
        let own = self.covers(triangle, side);
        let goes_on = |other: usize, its_side: usize| self.covers(other, its_side) == -own;
        match self.tile.neighbours[triangle][side] {
            Neighbour::None => None,
            Neighbour::One(other) => {
                let other = other as usize;
                let its_side = self.tile.sides(other).iter().position(|its| *its == edge)?;
                goes_on(other, its_side).then_some(other)
            }
            Neighbour::Several => self
                .tile
                .around_edge(edge)
                .find(|&(other, its_side)| other != triangle && goes_on(other, its_side))
                .map(|(other, _)| other),
        }
    }

    /// +1 or −1 for the covered side when all triangles at `edge` cover the same one.
    fn outline(&self, edge: u32) -> Option<i32> {
        let mut covered = 0;
        for (triangle, side) in self.tile.around_edge(edge) {
            let side = self.covers(triangle, side);
            if side * covered < 0 {
                return None;
            }
            if side != 0 {
                covered = side;
            }
        }
        (covered != 0).then_some(covered)
    }

    /// Ends of `edge` relative to the receiver and as welded vertices, covered side on the left; `None` for edges that are no outline.
    pub(super) fn directed(&self, edge: u32) -> Option<([DVec3; 2], [u32; 2])> {
        let covered = self.outline(edge)?;
        let [a, b] = self.edges.ends[edge as usize];
        let vertices = if covered > 0 { [a, b] } else { [b, a] };
        Some((vertices.map(|vertex| self.vertex(vertex)), vertices))
    }

    /// Calls `visit` for the edges that meet at `vertex`, some of them more than once.
    pub(super) fn for_each_edge_at(&self, vertex: u32, mut visit: impl FnMut(u32)) {
        for (triangle, corner) in self.edges.around_vertex(vertex) {
            if self.tile.place(triangle).is_some() {
                let sides = self.edges.sides[triangle as usize];
                visit(sides[corner]);
                visit(sides[(corner + 2) % 3]);
            }
        }
    }

    /// Where the line from `hidden` to `seen` (relative to the receiver, in the plane of the light) leaves the surface that `triangle` is part of: the
    /// edge, and the parameter on the line; just any edge when it does not before `seen`, with a parameter of at least 1.
    pub(super) fn leave(&self, triangle: u32, hidden: DVec3, seen: DVec3) -> Option<(u32, f64)> {
        let plane = hidden.cross(seen);
        let mut triangle = self.tile.place(triangle)?;
        let mut entered = u32::MAX;
        for _ in 0..MAX_STEPS {
            let (side, s) = self.exit(triangle, entered, [hidden, seen], plane)?;
            if self.covers(triangle, side) == 0 {
                return None;
            }
            entered = self.tile.sides(triangle)[side];
            match self.across(triangle, side) {
                Some(next) if s < 1.0 => triangle = next,
                _ => return Some((entered, s)),
            }
        }
        None
    }

    /// The side through which a line leaves a triangle that it did not enter there, and the parameter.
    fn exit(
        &self,
        triangle: usize,
        entered: u32,
        [hidden, seen]: [DVec3; 2],
        plane: DVec3,
    ) -> Option<(usize, f64)> {
        let corners = self
            .tile
            .corners(triangle)
            .map(|corner| corner - self.receiver);
        let heights = corners.map(|corner| plane.dot(corner));
        let mut farthest: Option<(usize, f64)> = None;
        for side in 0..3 {
            let next = (side + 1) % 3;
            let differ = (heights[side] >= 0.0) != (heights[next] >= 0.0);
            if !differ || self.tile.sides(triangle)[side] == entered {
                continue;
            }
            let tau = heights[side] / (heights[side] - heights[next]);
            let point = corners[side] + tau * (corners[next] - corners[side]);
            // point = α hidden + β seen.
            let alpha = plane.dot(point.cross(seen));
            let beta = plane.dot(hidden.cross(point));
            let s = beta / (alpha + beta);
            if alpha + beta > 0.0 && farthest.is_none_or(|best| s > best.1) {
                farthest = Some((side, s));
            }
        }
        farthest
    }
}

//! The triangles between the points that were evaluated: a Delaunay triangulation that keeps the borders of the domain.

use glam::DVec2;
use spade::handles::{FaceHandle, FixedVertexHandle, InnerTag, VertexHandle};
use spade::{
    CdtEdge, ConstrainedDelaunayTriangulation, HasPosition, Point2, PositionInTriangulation,
    Triangulation,
};

/// A border piece is split by points that lie no farther from it, in cells: points of the border are off their simplified line by as
/// much. Without that such a point would only cut a sliver off the triangle on the outer side.
const ON_BORDER: f64 = 0.3;

/// A point of the domain in the mesh.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    place: Point2<f64>,
    point: u32,
}

impl HasPosition for Vertex {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.place
    }
}

type Inner<'a> = FaceHandle<'a, InnerTag, Vertex, (), CdtEdge<()>, ()>;

/// Names a vertex.
pub(super) type Handle = FixedVertexHandle;

/// A triangle: vertices and the points they stand for, counter-clockwise for columns to the right and rows up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub(super) points: [u32; 3],
    pub(super) vertices: [Handle; 3],
    /// The triangles beyond the sides, side k running from corner k to corner k + 1, as places in the list of all.
    pub(super) beyond: [Option<usize>; 3],
}

#[derive(Debug, Default)]
pub(super) struct Mesh {
    cdt: ConstrainedDelaunayTriangulation<Vertex>,
}

impl Mesh {
    /// Adds a point; `near` is a vertex close to it. `None` when its place is no number.
    pub(super) fn insert(
        &mut self,
        point: usize,
        place: DVec2,
        near: Option<Handle>,
    ) -> Option<Handle> {
        let split = self.border_near(place, near);
        if let Some((from, to)) = split
            && let Some(edge) = self.cdt.get_edge_from_neighbors(from, to)
        {
            let edge = edge.as_undirected().fix();
            self.cdt.remove_constraint_edge(edge);
        }
        let vertex = Vertex {
            place: Point2::new(place.x, place.y),
            point: point as u32,
        };
        let handle = match near {
            Some(near) => self.cdt.insert_with_hint(vertex, near),
            None => self.cdt.insert(vertex),
        }
        .ok()?;
        if let Some((from, to)) = split {
            self.constrain(from, handle);
            self.constrain(handle, to);
        }
        Some(handle)
    }

    /// Keeps the line between two vertices, unless another such line is in the way.
    pub(super) fn constrain(&mut self, from: Handle, to: Handle) {
        if from != to && self.cdt.can_add_constraint(from, to) {
            self.cdt.add_constraint(from, to);
        }
    }

    /// The border piece that a point belongs to without lying on it to the last bit.
    fn border_near(&self, place: DVec2, near: Option<Handle>) -> Option<(Handle, Handle)> {
        let position = Point2::new(place.x, place.y);
        let found = match near {
            Some(near) => self.cdt.locate_with_hint(position, near),
            None => self.cdt.locate(position),
        };
        let edges = match found {
            PositionInTriangulation::OnFace(face) => {
                let edges = self.cdt.face(face).adjacent_edges();
                edges.map(Some)
            }
            PositionInTriangulation::OutsideOfConvexHull(edge) => {
                [Some(self.cdt.directed_edge(edge)), None, None]
            }
            _ => return None,
        };
        edges
            .into_iter()
            .flatten()
            .filter(|edge| edge.is_constraint_edge())
            .find(|edge| {
                let [a, b] = edge.vertices().map(|vertex| place_of(&vertex));
                let side = b - a;
                let share = (place - a).dot(side) / side.length_squared();
                let height = (place - a).perp_dot(side).abs() / side.length();
                height <= ON_BORDER && share > 0.0 && share < 1.0
            })
            .map(|edge| (edge.from().fix(), edge.to().fix()))
    }

    /// All triangles, in an order that depends only on what was done to the mesh.
    pub(super) fn faces(&self) -> impl Iterator<Item = Face> {
        self.cdt.inner_faces().map(|face| face_of(&face))
    }

    /// The triangles around and beside a place.
    pub(super) fn faces_near(&self, place: DVec2) -> Vec<Face> {
        let around = match self.cdt.locate(Point2::new(place.x, place.y)) {
            PositionInTriangulation::OnFace(face) => {
                let face = self.cdt.face(face);
                let mut faces = vec![face_of(&face)];
                faces.extend(
                    face.adjacent_edges()
                        .iter()
                        .filter_map(|edge| edge.rev().face().as_inner())
                        .map(|face| face_of(&face)),
                );
                return faces;
            }
            PositionInTriangulation::OnEdge(edge)
            | PositionInTriangulation::OutsideOfConvexHull(edge) => edge,
            _ => return Vec::new(),
        };
        let edge = self.cdt.directed_edge(around);
        [edge, edge.rev()]
            .iter()
            .filter_map(|edge| edge.face().as_inner())
            .map(|face| face_of(&face))
            .collect()
    }

    /// The points around a vertex, in order of angle.
    pub(super) fn around(&self, vertex: Handle) -> impl Iterator<Item = u32> {
        self.cdt
            .vertex(vertex)
            .out_edges()
            .map(|edge| edge.to().data().point)
    }

    /// All vertices with their points.
    pub(super) fn vertices(&self) -> impl Iterator<Item = (Handle, u32)> {
        self.cdt
            .vertices()
            .map(|vertex| (vertex.fix(), vertex.data().point))
    }
}

fn place_of<DE, UE, F>(vertex: &VertexHandle<'_, Vertex, DE, UE, F>) -> DVec2 {
    let place = vertex.data().place;
    DVec2::new(place.x, place.y)
}

fn face_of(face: &Inner<'_>) -> Face {
    // In the order of the sides, each of which starts at its corner.
    let sides = face.adjacent_edges();
    let vertices = sides.map(|side| side.from());
    Face {
        points: vertices.map(|vertex| vertex.data().point),
        vertices: vertices.map(|vertex| vertex.fix()),
        // Face 0 is what lies outside.
        beyond: sides.map(|side| side.rev().face().as_inner().map(|face| face.index() - 1)),
    }
}

//! How far apart texels may be evaluated at first, so that no shadow falls between them.

use glam::DVec3;

use crate::math::Aabb;
use crate::scene::Scene;
use crate::transport::Shadow;
use crate::visibility::Edges;

/// Largest distance in texels. Twice as much misses what a shadow of 16 texels has in its middle, half as much makes smooth light dearer
/// (both measured for penumbrae of 100 texels).
pub(super) const SPACING: u16 = 16;

/// Distance over width of the narrowest shadow: every disc of that width then holds a point of a square grid.
const REACH: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// How thick the bodies are that a scene's triangles belong to.
pub(super) struct Thickness {
    /// Metres, per scene triangle.
    of: Vec<f32>,
}

/// Sums over the triangles that hang together.
#[derive(Clone, Copy, Default)]
struct Body {
    area: f64,
    volume: f64,
    border: f64,
}

impl Thickness {
    /// A closed body's is twice its volume over its surface: that of a plate, the radius of a rod. An open one's is twice its area over its
    /// border: the width of a strip. Bodies that are thick here and thin there pass for something in between.
    pub(super) fn new(scene: &Scene, edges: &Edges) -> Self {
        let mut roots: Vec<u32> = (0..edges.vertices.len() as u32).collect();
        for &[a, b, c] in &edges.corners {
            let root = find(&mut roots, a);
            for other in [b, c] {
                let other = find(&mut roots, other);
                roots[other as usize] = root;
            }
        }
        let mut bodies = vec![Body::default(); roots.len()];
        for (triangle, &corners) in edges.corners.iter().enumerate() {
            let body = &mut bodies[find(&mut roots, corners[0]) as usize];
            let [a, b, c] = corners.map(|vertex| edges.vertices[vertex as usize]);
            // From a point of its own, so that bodies far from the origin keep their digits.
            let origin = edges.vertices[roots[corners[0] as usize] as usize];
            body.area += 0.5 * scene.triangles[triangle].area_vector().length();
            body.volume += (a - origin).dot((b - origin).cross(c - origin)) / 6.0;
            for &side in &edges.sides[triangle] {
                if edges.around_edge(side).count() == 1 {
                    let [from, to] = edges.ends[side as usize];
                    body.border +=
                        edges.vertices[from as usize].distance(edges.vertices[to as usize]);
                }
            }
        }
        let of = edges
            .corners
            .iter()
            .map(|corners| {
                let body = bodies[find(&mut roots, corners[0]) as usize];
                let thickness = if body.border > 0.0 {
                    2.0 * body.area / body.border
                } else {
                    2.0 * body.volume.abs() / body.area
                };
                if thickness.is_finite() {
                    thickness as f32
                } else {
                    0.0
                }
            })
            .collect();
        Self { of }
    }

    /// The narrowest shadow in metres that `shadow` may cast on receivers in `places`: as wide as its caster, and wider by as much as the
    /// light blurs it.
    pub(super) fn narrowest(&self, scene: &Scene, shadow: &Shadow, places: &Aabb) -> f64 {
        shadow
            .candidates
            .iter()
            .map(|&id| {
                let triangle = &scene.triangles[id as usize];
                let bounds = Aabb::from_points(triangle.vertices);
                let gap = (bounds.min - places.max)
                    .max(places.min - bounds.max)
                    .max(DVec3::ZERO)
                    .length();
                let blur = shadow.width * gap / (shadow.distance - gap).max(0.1 * shadow.distance);
                f64::from(self.of[id as usize]) + blur
            })
            .fold(f64::INFINITY, f64::min)
    }
}

/// The spacing in texels, a power of two, for shadows of this width in metres and texels of this size.
pub(super) fn spacing(width: f64, step: f64) -> u16 {
    let mut spacing = SPACING;
    while spacing > 1 && f64::from(spacing) * step > REACH * width {
        spacing /= 2;
    }
    spacing
}

fn find(roots: &mut [u32], vertex: u32) -> u32 {
    let mut vertex = vertex;
    while roots[vertex as usize] != vertex {
        let next = roots[roots[vertex as usize] as usize];
        roots[vertex as usize] = next;
        vertex = next;
    }
    vertex
}

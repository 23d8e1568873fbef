//! Scene → [`Lights`]: what shines.
//!
//! Emissive triangles that lie in one plane, touch along edges and emit equally become one polygon, so that a light of a thousand
//! triangles costs as much as its outline.

use glam::DVec3;

use crate::error::Warnings;
use crate::scene::Scene;

/// How emission becomes lights.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Largest accepted deviation of textured emission from its mean within one polygon, relative to the brightest channel of that
    /// mean. Range: 1e-3..=1. Default: 0.1. Smaller gives more polygons.
    pub texture_tolerance: f64,
    /// Triangles a textured emitter may be split into, in all. Range: 1..=1e6. Default: 4096. When it is reached, the rest keeps its
    /// mean, and a warning says so.
    pub max_texture_splits: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            texture_tolerance: 0.1,
            max_texture_splits: 4096,
        }
    }
}

/// All lights of a scene.
#[derive(Debug, Default)]
pub struct Lights {
    /// Emissive surfaces, in the order of their first triangle.
    pub polygons: Vec<Polygon>,
    /// What was odd.
    pub warnings: Warnings,
}

/// A plane polygon of uniform radiance, with holes perhaps.
#[derive(Clone, Debug)]
pub struct Polygon {
    /// Closed contours in world metres: outer ones counter-clockwise seen from the front, holes clockwise. Vertices between collinear
    /// edges are left out.
    pub contours: Vec<Vec<DVec3>>,
    /// The same surface in triangles, counter-clockwise seen from the front, for sampling by area.
    pub triangles: Vec<[DVec3; 3]>,
    /// Unit front normal.
    pub normal: DVec3,
    /// Square metres.
    pub area: f64,
    /// Emitted radiance in nit, linear RGB, not negative, not all zero.
    pub radiance: DVec3,
    /// Whether the back shines too.
    pub two_sided: bool,
    /// Indices in [`Scene::triangles`] of the surface it came from, ascending. They do not shadow it.
    pub surface: Vec<u32>,
}

/// Collects every emissive surface of `scene`.
#[must_use]
pub fn collect(_scene: &Scene, _options: &Options) -> Lights {
    unimplemented!()
}

//! Scene → [`Lights`]: what shines.
//!
//! Emissive triangles that lie in one plane, touch along edges and emit equally become one polygon, so that a light of a thousand
//! triangles costs as much as its outline.
//!
//! Textured emission is cut into pieces that are uniform enough first. A piece is halved across its longest edge as long as
//!
//! ```text
//! deviation · √(area / area of the emitter)  >  texture_tolerance · brightest channel of the emitter's mean
//! ```
//!
//! where the deviation is the root mean square over the piece (of the worst channel) and the emitter is everything of one material in
//! one instance; the piece farthest above goes first. The root of the area stands for how much of a detail is left from a distance of
//! about the emitter's size: a sharp edge between black and white is followed down to the tolerance times that size, and no further. A
//! piece shines with its mean, so the flux is kept. Neighbouring pieces of the same radiance become one polygon again, and black ones
//! are left out.
//!
//! Authored lights ([`Point`], [`Sun`]) are hard unless they are given a size: then they are spheres, or polygons at infinity ([`Distant`]),
//! and have penumbrae like any surface.
//!
//! A masked emitter does not shine where it is cut away: that is one more texture. A blended one shines as if it were opaque.

mod contour;
pub mod disc;
mod emission;
mod merge;
mod punctual;
pub mod sky;
mod split;

use glam::DVec3;

pub use self::punctual::{Cone, Distant, Point, Sun};
use crate::error::Warnings;
use crate::math::Aabb;
use crate::scene::Scene;

/// How emission becomes lights.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Largest accepted deviation of textured emission within one polygon as large as its emitter, relative to the brightest channel
    /// of the emitter's mean; smaller polygons may deviate more (see [`crate::lights`]). Range: 1e-3..=1. Default: 0.1. Smaller gives
    /// more polygons.
    pub texture_tolerance: f64,
    /// Times a textured triangle may be halved, in all. Range: 1..=1e6. Default: 4096. When it is reached, the rest keeps its mean, and
    /// a warning says so.
    pub max_texture_splits: usize,
    /// Radius in metres of point and spot lights whose node gives none. Range: 0..=1e3. Default: 0, hard shadows.
    pub light_radius: f64,
    /// Directions of the sky's rule. Range: 1..=4096. Default: 64.
    pub sky_lights: usize,
    /// What the directions of a sky become. Default: [`SkyMode::Cells`].
    pub sky_mode: SkyMode,
    /// Angular diameter in radians of directional lights whose node gives none. Range: 0..=π/2. Default: 0.53°, the sun's; 0 is hard.
    pub sun_angle: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            texture_tolerance: 0.1,
            max_texture_splits: 4096,
            sky_lights: 64,
            sky_mode: SkyMode::Cells,
            light_radius: 0.0,
            sun_angle: 0.53_f64.to_radians(),
        }
    }
}

/// What the directions of a sky's quadrature rule become.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SkyMode {
    /// Suns without a size, the same for every receiver (T. Kollig and A. Keller 2003): a ray each; few show as bands.
    Points,
    /// Nine rules that take turns: as many rays as for one, and noise instead of bands.
    Interleaved,
    /// Polygons at infinity: smooth shadows and derivatives from few of them. Bright compact regions are polygons of their own.
    #[default]
    Cells,
}

/// All lights of a scene.
#[derive(Debug, Default)]
pub struct Lights {
    /// Emissive surfaces, in the order of their first triangle, then authored area lights, which have no triangles of the scene.
    pub polygons: Vec<Polygon>,
    /// Suns with a diameter, then parts of the sky.
    pub distant: Vec<Distant>,
    /// Points and spots, in the order of their nodes.
    pub points: Vec<Point>,
    /// Suns without a diameter, then directions of the sky.
    pub suns: Vec<Sun>,
    /// Middle of a sphere around the scene, world metres, and its radius: what is at infinity lies beyond.
    pub extent: (DVec3, f64),
    /// What was odd.
    pub warnings: Warnings,
}

/// A plane polygon of uniform radiance, with holes perhaps.
#[derive(Clone, Debug)]
pub struct Polygon {
    /// Closed contours in world metres, those around more area first: outer ones counter-clockwise seen from the front, holes clockwise.
    /// Vertices between collinear edges are left out. Contours may touch each other at a vertex.
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
///
/// Emissive triangles that are there twice shine once; a warning counts them. Coplanar ones that overlap otherwise shine twice, as they
/// are modelled. Two that share a place and look away from each other are two lights.
#[must_use]
pub fn collect(scene: &Scene, options: &Options) -> Lights {
    let mut warnings = Warnings::default();
    let emitters = emission::find(scene, &mut warnings);
    let pieces = split::uniform_pieces(scene, &emitters, options, &mut warnings);
    let (points, mut distant, mut suns) = punctual::collect(&scene.punctual_lights, options);
    if let Some(picture) = &scene.sky {
        let (n, mode) = (options.sky_lights, options.sky_mode);
        let (cells, directions) = sky::sources(picture, n, mode, &mut warnings);
        distant.extend(cells);
        suns.extend(directions);
    }
    let bounds = Aabb::from_points(scene.triangles.iter().flat_map(|t| t.vertices));
    let mut polygons = merge::polygons(&pieces);
    polygons.extend(scene.area_lights.iter().filter_map(punctual::surface_of));
    Lights {
        polygons,
        distant,
        points,
        suns,
        extent: if bounds.is_empty() {
            (DVec3::ZERO, 0.0)
        } else {
            (bounds.centre(), 0.5 * bounds.diagonal())
        },
        warnings,
    }
}

impl Lights {
    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.polygons.len() + self.distant.len() + self.points.len() + self.suns.len()
    }

    /// Whether nothing shines.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

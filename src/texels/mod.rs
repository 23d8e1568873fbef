//! Scene + Atlas → [`Texels`]: where in the world each texel of a page lies.
//!
//! A texel is covered when a bilinear lookup anywhere on its chart can read it. A covered texel whose centre lies off the chart takes
//! the nearest point on it.
//!
//! `cover` finds the texels in the plane, `surface` takes them into the world, `push_out` frees those that ended up inside of
//! something.

mod cover;
mod push_out;
mod surface;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::atlas::Atlas;
use crate::error::Warnings;
use crate::scene::Scene;

/// The covered texels of one page, in tiles.
#[derive(Debug)]
pub struct Texels {
    /// Index of the page.
    pub page: usize,
    /// Texels per row of the page.
    pub width: u32,
    /// Rows of the page.
    pub height: u32,
    /// Covered texels, grouped by tile.
    pub texels: Vec<Texel>,
    /// Groups of neighbouring texels: the part of one chart that lies in one 8×8 block of the page. The unit of work.
    pub tiles: Vec<Tile>,
    /// What was odd.
    pub warnings: Warnings,
}

/// One covered texel.
#[derive(Clone, Copy, Debug)]
pub struct Texel {
    /// Column in the page.
    pub x: u16,
    /// Row in the page, 0 on top.
    pub y: u16,
    /// Where in the page it is evaluated, in texels: its centre, or the nearest point of its chart; [`push_out`] moves it along.
    pub place: DVec2,
    /// Index in [`Scene::triangles`] of the triangle it lies on.
    pub triangle: u32,
    /// World metres; where light is evaluated. After [`push_out`] it may lie off the triangle.
    pub position: DVec3,
    /// Unit front normal of the triangle.
    pub geometric_normal: DVec3,
    /// Unit normal of the horizon and of E: the interpolated vertex normal; the geometric normal where there is none, or where the
    /// authored one points away from the front.
    pub normal: DVec3,
    /// ∂x/∂u in metres per texel to the right, on the triangle's plane. Where the triangle has no usable area in the layout: along its
    /// longest edge, as long as that edge is per texel, or as the density says.
    pub du: DVec3,
    /// ∂x/∂v in metres per texel down, on the triangle's plane. Where the triangle has no usable area in the layout: across `du`, as long.
    pub dv: DVec3,
}

impl Texel {
    /// A way in metres in steps of the tangent map, as far as it runs along the surface.
    fn steps(&self, way: DVec3) -> DVec2 {
        let (uu, uv, vv) = (
            self.du.length_squared(),
            self.du.dot(self.dv),
            self.dv.length_squared(),
        );
        let determinant = uu * vv - uv * uv;
        let (u, v) = (self.du.dot(way), self.dv.dot(way));
        let steps = DVec2::new(vv * u - uv * v, uu * v - uv * u) / determinant;
        if steps.is_finite() {
            steps
        } else {
            DVec2::ZERO
        }
    }
}

/// A run of [`Texels::texels`] that belongs together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Range in [`Texels::texels`].
    pub texels: std::ops::Range<usize>,
    /// Chart within its placement's unwrap.
    pub chart: u32,
    /// Index in [`Atlas::placements`].
    pub placement: u32,
}

/// What stands in the way of a straight line, for [`push_out`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// Metres from the start of the line.
    pub distance: f64,
    /// Unit front normal of the surface that was hit.
    pub normal: DVec3,
    /// Whether its back was hit, and light cannot pass from there: false for double-sided surfaces, which have no inside.
    pub back: bool,
}

/// Side of a tile in texels.
pub const TILE: u32 = 8;

/// Finds the covered texels of one page.
///
/// A texel is covered when its bilinear footprint meets a triangle of a chart. It samples its centre if that lies on the chart, else
/// the nearest point of the chart; where charts of an authored layout compete, the nearest one has it, and among equally near triangles
/// the first. Texels of triangles that were dropped in world space are left out.
///
/// Positions of smooth-shaded surfaces are moved onto the curved surface that the vertex normals describe (never inwards), so that
/// facets cast no stripes at the terminator.
///
/// The same scene and atlas give the same texels on any number of threads.
#[must_use]
pub fn cover(scene: &Scene, atlas: &Atlas, page: usize) -> Texels {
    let (texels, tiles) = surface::lift(scene, atlas, page);
    Texels {
        page,
        width: atlas.pages[page].width,
        height: atlas.pages[page].height,
        texels,
        tiles,
        warnings: Warnings::default(),
    }
}

/// Moves samples that sit inside other geometry out of it.
///
/// `first_hit(origin, direction, distance)` gives the nearest obstacle along the unit `direction`, on either side of a surface.
///
/// A sample whose first obstacle along the surface, within the texel's bilinear footprint, is the back of something sits inside of that
/// thing, while part of the texel can be seen beyond it: floor texels below the foot of a wall. It moves to just beyond the nearest such
/// back. A sample with no way out within its footprint stays: nobody sees its texel.
///
/// Returns how many texels were moved.
pub fn push_out(
    texels: &mut Texels,
    first_hit: &(dyn Fn(DVec3, DVec3, f64) -> Option<Obstacle> + Sync),
) -> usize {
    texels
        .texels
        .par_iter_mut()
        .map(|texel| {
            let exit = push_out::exit(texel, first_hit);
            if let Some(position) = exit {
                texel.place += texel.steps(position - texel.position);
                texel.position = position;
            }
            usize::from(exit.is_some())
        })
        .sum()
}

//! Scene → [`Atlas`]: every lit surface gets its own place in the lightmap pages.
//!
//! Each distinct mesh is unwrapped once per world scale (an [`Unwrap`]); each instance then gets its own rectangle of whole texels
//! ([`Placement`]). Two instances of a mesh at the same scale therefore share charts and texture coordinates and differ by an offset
//! only, which is what the glTF output can express per node.

use glam::DVec2;

use crate::error::{Result, Warnings};
use crate::scene::Scene;

/// How surfaces are laid out.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Texels per metre of surface. Range: 1e-3..=1e4. Default: 8, a texel of 12.5 cm.
    pub texels_per_metre: f64,
    /// Largest side of a page in texels. Range: 64..=16384. Default: 2048.
    pub page: u32,
    /// Empty texels between charts. Range: 2..=64. Default: 4, so that two dilated borders and one mip level stay apart.
    pub padding: u32,
    /// Which texture coordinates to use.
    pub uv: Uv,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            texels_per_metre: 8.0,
            page: 2048,
            padding: 4,
            uv: Uv::Auto,
        }
    }
}

/// Which texture coordinates a lightmap uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Uv {
    /// The authored `TEXCOORD_1` where it lies in 0..1 and does not overlap, else an unwrap.
    Auto,
    /// The authored `TEXCOORD_1` wherever there is one in 0..1, even when it overlaps.
    Keep,
    /// Always an unwrap.
    Unwrap,
}

/// Where every surface lies in the lightmap.
#[derive(Debug)]
pub struct Atlas {
    /// Layouts of meshes, in texels of their own rectangle.
    pub unwraps: Vec<Unwrap>,
    /// Rectangles in pages, ordered by page, then row, then column.
    pub placements: Vec<Placement>,
    /// Sizes of the pages.
    pub pages: Vec<Page>,
    /// What was odd.
    pub warnings: Warnings,
}

/// One mesh (or the part of it that fits one page), laid out flat at one world scale.
#[derive(Debug)]
pub struct Unwrap {
    /// Index in [`Scene::meshes`].
    pub mesh: usize,
    /// Width and height of its rectangle in texels, padding included.
    pub size: [u32; 2],
    /// One per primitive of the mesh, in its order; a primitive without a triangle in this part has empty lists.
    pub primitives: Vec<UnwrappedPrimitive>,
    /// Charts are numbered 0..n_charts over all primitives.
    pub n_charts: u32,
    /// Whether it is the authored `TEXCOORD_1`, unchanged but for one scale (`size`).
    pub authored: bool,
}

/// Texture coordinates of a primitive. Vertices on a seam appear once per side.
#[derive(Debug, Default)]
pub struct UnwrappedPrimitive {
    /// For each new vertex, the index of the primitive's vertex it copies.
    pub source_vertices: Vec<u32>,
    /// For each new vertex, its place in texels from the top left corner of the rectangle; texel centres are at halves.
    pub texcoords: Vec<DVec2>,
    /// Triangles of new vertices, in the authored winding. The winding in the plane may be either way.
    pub triangles: Vec<[u32; 3]>,
    /// For each of `triangles`, its index in the primitive's `triangles`. Ascending.
    pub source_triangles: Vec<u32>,
    /// For each of `triangles`, its chart; [`NO_CHART`] when it got no place (no area at this world scale).
    pub charts: Vec<u32>,
}

/// Chart of a triangle that got no place in the lightmap.
pub const NO_CHART: u32 = u32::MAX;

/// Where an instance's rectangle lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placement {
    /// Index in [`Scene::instances`].
    pub instance: usize,
    /// Index in [`Atlas::unwraps`].
    pub unwrap: usize,
    /// Index in [`Atlas::pages`].
    pub page: usize,
    /// Top left texel of the rectangle in the page.
    pub offset: [u32; 2],
}

/// One lightmap texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    /// Texels per row, a multiple of 4.
    pub width: u32,
    /// Rows, a multiple of 4.
    pub height: u32,
}

/// Lays out every instance of `scene` whose density is above zero.
///
/// The same scene and options give the same atlas, always.
///
/// # Errors
/// `TooLarge` when the surfaces at this density need more texels than fit into memory; the message names the density that fits.
/// `Interrupted` when `cancelled` returns true between two meshes.
pub fn build(
    _scene: &Scene,
    _options: &Options,
    _cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Atlas> {
    unimplemented!()
}

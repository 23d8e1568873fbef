//! Scene → [`Atlas`]: every lit surface gets its own place in the lightmap pages.
//!
//! Each distinct mesh is unwrapped once per world scale (an [`Unwrap`]); each instance then gets its own rectangle of whole texels
//! ([`Placement`]). Two instances of a mesh at the same scale therefore share charts and texture coordinates and differ by an offset
//! only, which is what the glTF output can express per node.
//!
//! Order of work: instances that can share a layout are gathered (`group`); a mesh keeps its author's layout (`authored`) or is cut
//! into charts by xatlas (`split` prepares, `unwrap` calls it); the rectangles of all instances are packed into pages (`pack`).

mod authored;
mod chart;
mod footprint;
mod group;
mod limit;
mod pack;
mod place;
mod sliver;
mod split;
mod unwrap;
mod validate;
mod xatlas;

use glam::DVec2;
use rayon::prelude::*;

use crate::error::{Error, Result, Warnings};
use crate::scene::Scene;

use self::group::Group;

pub(crate) use self::footprint::{closest, each_covered, signed_area};

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
    /// The authored `TEXCOORD_1` where it lies in 0..1, does not overlap and uses a tenth of the square, else an unwrap.
    Auto,
    /// The authored `TEXCOORD_1` wherever there is one in 0..1, even when it overlaps.
    Keep,
    /// Always an unwrap.
    Unwrap,
}

impl Options {
    /// Checks the documented ranges.
    ///
    /// # Errors
    /// `InvalidOption` that names the first value out of range.
    pub fn validate(&self) -> Result<()> {
        let check = |within: bool, option: &'static str, range: &str, value: String| {
            if within {
                Ok(())
            } else {
                Err(Error::InvalidOption {
                    option,
                    reason: format!("must be in {range}, is {value}"),
                })
            }
        };
        check(
            (1e-3..=1e4).contains(&self.texels_per_metre),
            "texels-per-metre",
            "0.001..=10000",
            self.texels_per_metre.to_string(),
        )?;
        check(
            (64..=16384).contains(&self.page),
            "page",
            "64..=16384",
            self.page.to_string(),
        )?;
        // Behind the padding a page must keep room for charts: half of it.
        let most = (self.page / 2).min(64);
        check(
            (2..=most).contains(&self.padding),
            "padding",
            &format!("2..={most} for pages of {} texels", self.page),
            self.padding.to_string(),
        )
    }

    /// Empty texels that each rectangle keeps on every side of it: half the padding, so that neighbours are a whole one apart.
    pub(crate) fn margin(&self) -> u32 {
        self.padding.div_ceil(2)
    }

    /// Largest side of a page that pages really get: a multiple of 4.
    fn page_side(&self) -> u32 {
        self.page / 4 * 4
    }

    /// Largest side of a rectangle of charts that fits a page.
    fn room(&self) -> u32 {
        self.page_side() - 2 * self.margin()
    }
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
    /// Width and height of its rectangle in texels. Neighbours and page borders stay half the padding away from it. An authored layout
    /// may be read one texel outside of it, and its neighbours stay one texel farther away.
    pub size: [u32; 2],
    /// One per primitive of the mesh, in its order; a primitive without a triangle in this part has empty lists.
    pub primitives: Vec<UnwrappedPrimitive>,
    /// Charts are numbered `0..n_charts` over all primitives.
    pub n_charts: u32,
    /// Whether it is the authored `TEXCOORD_1`, unchanged but for one scale (`size`).
    pub authored: bool,
    /// Texels per metre that were aimed at, the instances' density included. Charts larger than a page have fewer, and a warning.
    pub texels_per_metre: f64,
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
    /// For each of `triangles`, its chart; [`NO_CHART`] when it got no place of its own, because it has no area or is a hairline at this
    /// world scale. Its texture coordinates then lie on a neighbour, if there is one.
    pub charts: Vec<u32>,
}

/// Chart of a triangle that got no place of its own in the lightmap.
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

/// Lays out every instance of `scene` whose density is above zero and whose mesh has a triangle with area.
///
/// The same scene and options give the same atlas, always.
///
/// # Errors
/// `InvalidOption` when an option is out of range. `TooLarge` when the surfaces at this density need more texels than fit into memory;
/// the message names the density that fits. `Interrupted` when `cancelled` returns true between two meshes (xatlas cannot be stopped
/// inside one: it is then left behind on its own thread).
pub fn build(
    scene: &Scene,
    options: &Options,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Atlas> {
    options.validate()?;
    let groups = group::groups(scene, options);
    limit::check_area(&groups, options)?;
    let kept = authored::meshes_to_keep(scene, &groups, options);

    let mut warnings = Warnings::default();
    let mut unwraps = Vec::new();
    let mut blocks = Vec::new();
    let laid_out = in_lanes(&groups, |group| {
        if cancelled() {
            return Err(Error::Interrupted);
        }
        if kept.contains(&group.mesh) {
            Ok(authored::layout(scene, group, options))
        } else {
            unwrap::layout(scene, group, options, cancelled)
        }
    })?;
    for (group, layout) in groups.iter().zip(laid_out) {
        warnings.extend(layout.warnings);
        for unwrap in layout.unwraps {
            let margin = options.margin() + u32::from(unwrap.authored);
            blocks.extend(group.instances.iter().map(|&instance| pack::Block {
                instance,
                unwrap: unwraps.len(),
                size: unwrap.size,
                margin,
            }));
            unwraps.push(unwrap);
        }
    }
    limit::check_blocks(&blocks, options)?;
    let (placements, pages) = pack::pack(blocks, options.page_side())?;
    Ok(Atlas {
        unwraps,
        placements,
        pages,
        warnings,
    })
}

impl Atlas {
    /// Checks everything that must hold for an atlas of `scene` laid out with `options`: rectangles lie inside their pages; no two
    /// charts come closer than the padding (those of one authored layout excepted); every triangle of a placed mesh appears exactly
    /// once; texture coordinates are finite and inside their rectangle; and vertices copy those of their triangle.
    ///
    /// # Errors
    /// What does not hold, and where.
    pub fn validate(&self, scene: &Scene, options: &Options) -> std::result::Result<(), String> {
        validate::validate(self, scene, options)
    }

    /// Share of the pages' texels that a bilinear lookup on a surface can read, in [0, 1]; 0 without pages.
    #[must_use]
    pub fn utilisation(&self) -> f64 {
        validate::utilisation(self)
    }
}

/// Layout of one group, perhaps in parts.
struct Layout {
    unwraps: Vec<Unwrap>,
    warnings: Warnings,
}

/// Groups that are laid out at once. xatlas starts a thread per core for each; more lanes than this would only queue for the cores,
/// fewer would leave cores idle while meshes of a single chart are laid out.
const LANES: usize = 8;

/// Maps all groups, in their order, on at most [`LANES`] threads.
fn in_lanes<T: Send>(
    groups: &[Group],
    layout: impl Fn(&Group) -> Result<T> + Sync,
) -> Result<Vec<T>> {
    // Largest first, dealt in turns: lanes end at about the same time.
    let mut order: Vec<usize> = (0..groups.len()).collect();
    order.sort_by_key(|&index| (std::cmp::Reverse(groups[index].n_triangles), index));
    let lanes = LANES.min(rayon::current_num_threads()).max(1);
    let mut results: Vec<(usize, T)> = (0..lanes)
        .into_par_iter()
        .map(|lane| {
            order
                .iter()
                .skip(lane)
                .step_by(lanes)
                .map(|&index| Ok((index, layout(&groups[index])?)))
                .collect::<Result<Vec<_>>>()
        })
        .collect::<Result<Vec<_>>>()?
        .into_iter()
        .flatten()
        .collect();
    results.sort_by_key(|&(index, _)| index);
    Ok(results.into_iter().map(|(_, result)| result).collect())
}

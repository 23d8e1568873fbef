//! [`Environment`] → [`Sky`]: a picture of the whole sphere as a few directions with their light.
//!
//! A quadrature rule is a set of directions ωᵢ, each with the light `Bᵢ = ∫ L dω` of its cell, the part of the sphere that is nearer to it
//! than to the others. [`build`] places the directions one by one, each beside the one with the most light, and relaxes all of them
//! (Lloyd) before the next: bright parts get many, dark ones few, and the largest ‖Bᵢ‖ falls almost like 1/N where plain relaxation of
//! random directions, [`plain`], gets caught in local minima.
//!
//! Cells keep more than Bᵢ: the first moment `∫ L ω dω`, with which the unshadowed light vector is exact for every N, and the solid angle.
//! [`cells()`] gives them as spherical polygons.
//!
//! Everything is in the picture's own axes (see [`crate::scene::environment`]); [`Rule::turned`] and [`Region::turned`] bring it into the
//! world. The sphere is the picture's pixels, each with its exact solid angle and moment, given as a whole to the nearest direction.
//! No random samples, and the same bytes on any number of threads.
//!
//! # Degenerate pictures
//!
//! A black picture has a single direction, +Y, without light. One bright pixel is cut into as many pieces as the directions need. A
//! uniform sky has no heaviest cell but the first of equals; its directions spread evenly. Sums are in f64, where the largest f32
//! radiances are far from overflow.
//!
//! Source: T. Kollig and A. Keller, "Efficient Illumination by High Dynamic Range Images", Eurographics Symposium on Rendering 2003.

mod bright;

mod cells;

mod elements;

mod grid;

mod interleave;

mod lloyd;

mod rule;

mod sources;

mod stored;

pub use self::bright::{Region, split_bright};
pub use self::cells::{Outline, cells};
pub use self::interleave::Quality;
pub use self::rule::{Cell, Rule};
pub(super) use self::sources::sources;
pub use self::stored::{load_if_fits, to_json};

use crate::error::{Error, Result};
use crate::math;
use crate::scene::Environment;

use self::elements::{Elements, Pixels, Pyramid};
use self::grid::Grid;
use self::lloyd::Partition;

/// How a rule is made.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Options {
    /// Directions of a rule. Range: 1..=[`Self::MAX_DIRECTIONS`]. Default: 256.
    pub directions: usize,
    /// Interleaved rules, M. Range: 1.., and M times the directions at most [`Self::MAX_DIRECTIONS`]. Default: 1.
    pub sets: usize,
    /// Iterations that interleave the sets, k. Range: 0..=1000. Default: 4, after which the paper finds no more gain.
    pub iterations: usize,
    /// Largest angle in radians by which a direction may miss the centroid of its cell, the paper's threshold. Range: 1e-6..=1. Default: 0.01. Smaller takes more iterations and changes the largest ‖Bᵢ‖ little.
    pub max_decentration: f64,
    /// Whether bright compact regions are taken out first, see [`split_bright`]; the rule is of the rest. Default: false.
    pub split_bright: bool,
}

impl Options {
    /// Most directions, of all sets together.
    pub const MAX_DIRECTIONS: usize = 4096;

    /// Checks the ranges.
    ///
    /// # Errors
    /// `InvalidOption` for the first that is out of range.
    pub fn validate(&self) -> Result<()> {
        let wrong = |option, reason| Err(Error::InvalidOption { option, reason });
        let most = Self::MAX_DIRECTIONS;
        if !(1..=most).contains(&self.directions) {
            return wrong(
                "directions",
                format!("must be in 1..={most}, is {}", self.directions),
            );
        }
        if self.sets == 0 || self.sets.saturating_mul(self.directions) > most {
            return wrong(
                "sets",
                format!(
                    "must be in 1..={} for {} directions (all sets together have at most {most}), is {}",
                    most / self.directions,
                    self.directions,
                    self.sets
                ),
            );
        }
        if self.iterations > 1000 {
            return wrong(
                "iterations",
                format!("must be in 0..=1000, is {}", self.iterations),
            );
        }
        if !(1e-6..=1.0).contains(&self.max_decentration) {
            return wrong(
                "max-decentration",
                format!("must be in 1e-6..=1, is {}", self.max_decentration),
            );
        }
        Ok(())
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            directions: 256,
            sets: 1,
            iterations: 4,
            max_decentration: 0.01,
            split_bright: false,
        }
    }
}

/// A picture as light sources at infinity, in the picture's own axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Sky {
    /// [`Environment::hash`] of the picture.
    pub hash: u64,
    /// How it was made.
    pub options: Options,
    /// Bright compact regions, brightest first; empty unless asked for. The rules do not contain their light.
    pub regions: Vec<Region>,
    /// The rule, or M interleaved ones. Each has all the light of the picture without the regions.
    pub sets: Vec<Rule>,
    /// The rule of all directions of several sets together, set by set; `None` for a single set.
    pub composite: Option<Rule>,
    /// How good the sets were before each interleaving iteration and after the last; empty for a single set.
    pub quality: Vec<Quality>,
}

/// Makes the rule of `image`, or several interleaved ones.
///
/// `keep_going` is called with the number of directions placed so far, from the calling thread; `false` ends the work. Fewer directions
/// than asked are returned for a black picture only.
///
/// # Errors
/// `InvalidOption`; `Interrupted` when `keep_going` said so.
pub fn build(
    image: &Environment,
    options: &Options,
    keep_going: &dyn Fn(usize) -> bool,
) -> Result<Sky> {
    options.validate()?;
    let hash = image.hash();
    if options.split_bright {
        let mut rest = image.clone();
        let regions = split_bright(&mut rest);
        let mut sky = of_rest(&rest, hash, options, keep_going)?;
        sky.regions = regions;
        Ok(sky)
    } else {
        of_rest(image, hash, options, keep_going)
    }
}

fn of_rest(
    image: &Environment,
    hash: u64,
    options: &Options,
    keep_going: &dyn Fn(usize) -> bool,
) -> Result<Sky> {
    let grid = Grid::new(image);
    let n_all = options.directions * options.sets;
    let pixels = Pixels::new(&grid, n_all);
    let first = incremental(&grid, &pixels, options, keep_going)?;
    let mut sky = Sky {
        hash,
        options: options.clone(),
        regions: Vec::new(),
        sets: Vec::new(),
        composite: None,
        quality: Vec::new(),
    };
    if options.sets == 1 || first.sums().iter().all(|sum| sum.weight == 0.0) {
        let rule = rule::of(&pixels, &first);
        sky.sets = vec![rule; options.sets];
    } else {
        interleave::interleave(&pixels, first.into_directions(), &mut sky, keep_going)?;
    }
    Ok(sky)
}

/// The rule of `image` by plain relaxation of random directions, the paper's baseline. `seed` chooses them.
///
/// Directions whose cells are dark stay where they are. Uses `directions` and `max_decentration` of the options.
///
/// # Errors
/// `InvalidOption`.
pub fn plain(image: &Environment, options: &Options, seed: u64) -> Result<Rule> {
    options.validate()?;
    let grid = Grid::new(image);
    let pixels = Pixels::new(&grid, options.directions);
    let directions = (0..options.directions as u64)
        .map(|index| {
            let [u, v] = math::unit_pair(math::hash(seed, index, 0));
            // Equal areas: the height of a random point of the sphere is uniform.
            Environment::direction(
                u,
                (1.0 - 2.0 * v).clamp(-1.0, 1.0).acos() / std::f64::consts::PI,
            )
        })
        .collect();
    let mut partition = Partition::new(&pixels, directions);
    partition.settle(options.max_decentration);
    Ok(rule::of(&pixels, &partition))
}

/// Places the directions one by one, on coarse stand-ins of the picture, and relaxes them in the end on the picture itself.
fn incremental<'p>(
    grid: &Grid<'_>,
    pixels: &'p Pixels<'p>,
    options: &Options,
    keep_going: &dyn Fn(usize) -> bool,
) -> Result<Partition<'p, Pixels<'p>>> {
    let pyramid = Pyramid::new(grid);
    let mut directions = vec![glam::DVec3::Y];
    let is_dark = grid.weight() == 0.0;
    while !is_dark && directions.len() < options.directions {
        // One stand-in until the number of directions has doubled.
        let end = (2 * directions.len()).min(options.directions);
        let cut = pyramid.cut(end);
        directions = grow(&cut, directions, end, options, keep_going)?;
    }
    let mut partition = Partition::new(pixels, directions);
    partition.settle(options.max_decentration);
    if keep_going(partition.directions().len()) {
        Ok(partition)
    } else {
        Err(Error::Interrupted)
    }
}

/// Adds directions until there are `end`, each beside the one with the most light, relaxing before each.
fn grow<E: Elements>(
    elements: &E,
    directions: Vec<glam::DVec3>,
    end: usize,
    options: &Options,
    keep_going: &dyn Fn(usize) -> bool,
) -> Result<Vec<glam::DVec3>> {
    /// How far beside, in radii of the cell. So near that the border between the two halves the light. Much nearer: rounding decides.
    const BESIDE: f64 = 0.01;
    /// Steps of the two directions that share a cell, before all relax. In a sun smaller than the threshold nothing else moves them. None: its cells
    /// are halves of halves. Many: they leave the sun for the wide sky around it, where their distance to the light counts more.
    const PAIR_STEPS: usize = 2;
    let mut partition = Partition::new(elements, directions);
    while partition.directions().len() < end {
        partition.settle(options.max_decentration);
        let n = partition.directions().len();
        if !keep_going(n) {
            return Err(Error::Interrupted);
        }
        let heaviest = partition
            .sums()
            .iter()
            .enumerate()
            .fold(0, |best, (index, sum)| {
                if sum.weight > partition.sums()[best].weight {
                    index
                } else {
                    best
                }
            });
        let distance = BESIDE * partition.sums()[heaviest].radius();
        let [turn, _] = math::unit_pair(math::hash(n as u64, 0, 0));
        partition.push(rule::beside(
            partition.directions()[heaviest],
            distance,
            turn,
        ));
        for _ in 0..PAIR_STEPS {
            partition.step(&[heaviest as u32, n as u32]);
        }
    }
    partition.settle(options.max_decentration);
    Ok(partition.into_directions())
}

//! Closure + domain → values at every point: decides at which points a quantity is evaluated. Knows nothing of light.
//!
//! [`every_tile`] evaluates everywhere. [`sparse()`] evaluates where the quantity bends and interpolates it everywhere else: over a
//! [`Domain`] (`domain`, its borders in `border`) it spans triangles (`mesh`) with cubics on them (`cubic`), and adds points where the
//! triangles' corners do not predict each other.

mod border;
mod cubic;
mod domain;
mod mesh;
mod sparse;

use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

pub use self::domain::{Domain, Point};
pub use self::sparse::{Options, Refined, Sample, sparse};
use crate::error::{Error, Result};

/// Values at the covered texels of one page, one plane per quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Field {
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Column and row of each covered texel.
    pub places: Vec<[u16; 2]>,
    /// The quantities.
    pub planes: Vec<Plane>,
}

/// One quantity at every covered texel.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// Short name, as in file names: `E`, `Gr`, `phi`, `Gr_du`.
    pub name: &'static str,
    /// Numbers per texel, 1 or 3.
    pub components: usize,
    /// `components` numbers per texel, in the order of [`Field::places`]. Finite.
    pub values: Vec<f32>,
}

/// Evaluates every tile on all threads of the current pool and returns the results in the order of `tiles`.
///
/// `evaluate` must depend on its tile only; then the result does not depend on the number of threads. `finished` is told of every tile
/// when it is done, in any order.
///
/// # Errors
/// [`Error::Interrupted`] when `cancelled` returns true; it is asked before each tile.
pub fn every_tile<T: Sync, R: Send>(
    tiles: &[T],
    evaluate: impl Fn(&T) -> R + Sync,
    finished: &(dyn Fn(&T) + Sync),
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<R>> {
    tiles
        .par_iter()
        .map(|tile| {
            if cancelled() {
                return Err(Error::Interrupted);
            }
            let result = evaluate(tile);
            finished(tile);
            Ok(result)
        })
        .collect()
}

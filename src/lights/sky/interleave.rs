//! Interleaved rules: M sets of N directions, each a good rule, and all together one too.
//!
//! Neighbouring texels take different sets, and what is banding with one set becomes fine enough to be filtered away. The sets begin as
//! slightly perturbed copies of one rule. Then relaxation steps of each set alone and of all together take turns: the ones keep each set
//! a rule of its own, the others push corresponding directions of the sets apart.
//!
//! Source: Kollig and Keller 2003, section 4.2.

use glam::DVec3;

use super::Sky;
use super::elements::Pixels;
use super::lloyd::Partition;
use super::rule::{self, Rule, cap_radii, in_cap};
use crate::error::{Error, Result};
use crate::math;

/// Radius in radians of the caps that the copies are perturbed in, the paper's α. Cells that are narrower are perturbed within themselves:
/// otherwise the copies in a small sun would be mixed up.
const PERTURBATION: f64 = 0.01;

/// How good interleaved rules are (figure 5 of the paper).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Quality {
    /// Largest decentration of the sets, radians.
    pub separate_decentration: f64,
    /// Decentration of the composite rule, radians.
    pub composite_decentration: f64,
    /// Largest ‖Bᵢ‖ of the sets.
    pub separate_largest: f64,
    /// Largest ‖Bᵢ‖ of the composite rule.
    pub composite_largest: f64,
}

/// Makes the sets of `sky` from the directions of one rule.
pub(super) fn interleave(
    pixels: &Pixels<'_>,
    first: Vec<DVec3>,
    sky: &mut Sky,
    keep_going: &dyn Fn(usize) -> bool,
) -> Result<()> {
    let (n_sets, n) = (sky.options.sets, first.len());
    let mut sets: Vec<_> = copies(&first, n_sets)
        .into_iter()
        .map(|directions| Partition::new(pixels, directions))
        .collect();
    let mut composite = Partition::new(pixels, together(&sets));
    sky.quality.push(quality(&sets, &composite));
    for _ in 0..sky.options.iterations {
        let stepped = sets.iter().flat_map(Partition::centroids).collect();
        composite.place(stepped);
        let stepped = composite.centroids();
        for (set, directions) in sets.iter_mut().zip(stepped.chunks(n)) {
            set.place(directions.to_vec());
        }
        composite.place(stepped);
        sky.quality.push(quality(&sets, &composite));
        if !keep_going(n * n_sets) {
            return Err(Error::Interrupted);
        }
    }
    sky.sets = sets
        .iter()
        .map(|partition| rule::of(pixels, partition))
        .collect::<Vec<Rule>>();
    sky.composite = Some(rule::of(pixels, &composite));
    Ok(())
}

/// `directions`, and perturbed copies of them.
fn copies(directions: &[DVec3], n_sets: usize) -> Vec<Vec<DVec3>> {
    let radii = cap_radii(directions);
    let copy = |set: usize| {
        (0..)
            .zip(directions.iter().zip(&radii))
            .map(|(index, (&direction, radius))| {
                let uniform = math::unit_pair(math::hash(set as u64, index, 1));
                in_cap(direction, radius.min(PERTURBATION), uniform)
            })
            .collect()
    };
    let mut sets = vec![directions.to_vec()];
    sets.extend((1..n_sets).map(copy));
    sets
}

fn together(sets: &[Partition<'_, Pixels<'_>>]) -> Vec<DVec3> {
    sets.iter()
        .flat_map(|set| set.directions().iter().copied())
        .collect()
}

fn quality(sets: &[Partition<'_, Pixels<'_>>], composite: &Partition<'_, Pixels<'_>>) -> Quality {
    let largest = |partition: &Partition<'_, Pixels<'_>>| {
        partition
            .sums()
            .iter()
            .map(|sum| sum.weight)
            .fold(0.0, f64::max)
    };
    Quality {
        separate_decentration: sets.iter().map(Partition::decentration).fold(0.0, f64::max),
        composite_decentration: composite.decentration(),
        separate_largest: sets.iter().map(largest).fold(0.0, f64::max),
        composite_largest: largest(composite),
    }
}

//! Which lights matter to a tile: those that can hardly be noticed there are left out, and what they could add at most is accounted for.

use super::Receiver;
use super::source::Source;
use crate::math::Aabb;

/// The lights that a tile looks at.
#[derive(Debug)]
pub(super) struct Selection {
    /// Indices of the lights, ascending.
    pub(super) lights: Vec<usize>,
    /// Irradiance in lux that all others together cannot exceed at any receiver of the tile, whatever its normal.
    pub(super) left_out: f64,
}

/// Leaves out the dimmest lights as long as their bounds sum up to at most `negligible` lux. Keeps all when that is 0.
pub(super) fn select(sources: &[Source<'_>], tile: &[Receiver], negligible: f64) -> Selection {
    let mut selection = Selection {
        lights: (0..sources.len()).collect(),
        left_out: 0.0,
    };
    if negligible <= 0.0 {
        return selection;
    }
    let bounds = Aabb::from_points(tile.iter().map(|receiver| receiver.position));
    let (centre, radius) = (bounds.centre(), 0.5 * bounds.diagonal());
    let mut by_bound: Vec<(f64, usize)> = sources
        .iter()
        .enumerate()
        .map(|(index, source)| (source.irradiance_bound(centre, radius), index))
        .collect();
    by_bound.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let n_left_out = by_bound
        .iter()
        .take_while(|(bound, _)| {
            let sum = selection.left_out + bound;
            let fits = sum <= negligible;
            if fits {
                selection.left_out = sum;
            }
            fits
        })
        .count();
    selection.lights = by_bound[n_left_out..]
        .iter()
        .map(|(_, index)| *index)
        .collect();
    selection.lights.sort_unstable();
    selection
}

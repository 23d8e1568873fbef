//! Which lights are minor to a tile.

use glam::DVec3;

use crate::math::Aabb;
use crate::transport::Receiver;
use crate::transport::source::Source;

/// Lights of a tile from which on shadow testing is adaptive; fewer are all integrated, since there is little to choose from.
pub const MANY_LIGHTS: usize = 16;

/// Of so many receivers one is asked which lights are large. A tile of 64 has eight, one in each row.
const WITNESSES: usize = 9;

/// Which lights of a tile are integrated, and which are tested by a ray or not at all.
pub(in crate::transport) struct Split {
    /// Indices of the lights to integrate, ascending.
    pub(in crate::transport) major: Vec<usize>,
    /// The others, in the order of space.
    pub(in crate::transport) minor: Vec<usize>,
}

/// Separates the lights whose penumbrae are worth integrating from the minor ones. `lights` are indices of `sources`, ascending. A light at
/// infinity is never minor.
pub(in crate::transport) fn split(
    sources: &[Source<'_>],
    lights: Vec<usize>,
    tile: &[Receiver],
    threshold: f64,
) -> Split {
    let mut split = Split {
        major: Vec::new(),
        minor: Vec::new(),
    };
    if lights.len() < MANY_LIGHTS || threshold <= 0.0 {
        split.major = lights;
        return split;
    }
    let witnesses = || tile.iter().step_by(WITNESSES);
    let rows: Vec<Vec<f64>> = lights
        .iter()
        .map(|&light| witnesses().map(|at| sources[light].potential(at)).collect())
        .collect();
    let mut totals = vec![0.0; witnesses().count()];
    for row in &rows {
        for (total, potential) in totals.iter_mut().zip(row) {
            *total += potential;
        }
    }
    for (light, row) in lights.into_iter().zip(rows) {
        let is_large = row
            .iter()
            .zip(&totals)
            .any(|(potential, total)| *potential > threshold * total);
        if is_large || !sources[light].has_place() {
            split.major.push(light);
        } else {
            split.minor.push(light);
        }
    }
    let centre = |light: usize| sources[light].bounds().centre();
    let bounds = Aabb::from_points(split.minor.iter().map(|&light| centre(light)));
    split
        .minor
        .sort_by_cached_key(|&light| (along_curve(centre(light), &bounds), light));
    split
}

/// Place of a point of the box along Morton's curve, which keeps neighbours together: the bits of its coordinates in turn.
fn along_curve(point: DVec3, bounds: &Aabb) -> u64 {
    let size = (bounds.max - bounds.min).max(DVec3::splat(f64::MIN_POSITIVE));
    let cell = ((point - bounds.min) / size * 1023.0)
        .to_array()
        .map(|x| x as u64);
    (0..10).fold(0, |key, bit| {
        (0..3).fold(key, |key, axis| {
            key | ((cell[axis] >> bit) & 1) << (3 * bit + axis)
        })
    })
}

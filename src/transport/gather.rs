//! Tiles × lights: looks at each pair in turn and adds up what every receiver sees.

use glam::{DMat3, DVec3};

use super::minor;
use super::pair::{Pair, Part, Scratch};
use super::sampled::Seen;
use super::select::select;
use super::source::Source;
use super::{Counters, Options, Receiver, Sample};
use crate::lights::Lights;
use crate::math::Aabb;
use crate::visibility::Occluders;

/// Evaluates the light of all `lights` at points that lie close together (a tile).
///
/// The result for a tile depends on its own points, the scene and the options only. Samples come in the order of `tile`.
#[must_use]
pub fn gather(
    tile: &[Receiver],
    lights: &Lights,
    occluders: &Occluders<'_>,
    options: &Options,
) -> (Vec<Sample>, Counters) {
    let mut counters = Counters {
        points: tile.len() as u64,
        ..Counters::default()
    };
    let mut totals = vec![Total::default(); tile.len()];
    let mut scratch = Scratch::default();
    let places = Aabb::from_points(tile.iter().map(|receiver| receiver.position));
    let sources = Source::all(lights, &places);
    let selection = select(&sources, tile, options.negligible);
    counters.pairs += sources.len() as u64;
    counters.pairs_negligible += (sources.len() - selection.lights.len()) as u64;
    // What is tested by rays has no derivatives.
    let threshold = if options.gradients {
        0.0
    } else {
        options.direct_threshold
    };
    let split = minor::split(&sources, selection.lights, tile, threshold);
    counters.pairs_minor += split.minor.len() as u64;
    for &index in &split.major {
        let source = &sources[index];
        let lit: Vec<usize> = (0..tile.len())
            .filter(|&place| source.shines_on(&tile[place]))
            .collect();
        if lit.is_empty() {
            counters.pairs_facing_away += 1;
            continue;
        }
        let receivers: Vec<Receiver> = lit.iter().map(|&place| tile[place]).collect();
        let pair = Pair::new(
            source,
            index as u64,
            &receivers,
            occluders,
            options,
            &mut counters,
        );
        for place in lit {
            if let Some(seen) = pair.evaluate(&tile[place], &mut scratch) {
                let total = &mut totals[place];
                let before = total.sample.rays;
                total.add_seen(&seen, source.strength);
                counters.shadow_rays += u64::from(total.sample.rays - before);
            }
        }
    }
    counters.points_fallback = scratch.fallbacks;
    counters.silhouettes = scratch.silhouettes;
    counters.crossings = scratch.crossings;
    minor::add(
        &sources,
        &split,
        tile,
        occluders,
        options,
        &mut totals,
        &mut counters,
    );
    let samples = totals
        .into_iter()
        .map(|total| total.finish(options.gradients, selection.left_out))
        .collect();
    (samples, counters)
}

/// Share of the bound on rounding that is its typical size: roundings have either sign and few are as large as they may be. Measured on
/// the fixtures `slab` and `contact` against extended precision.
const TYPICAL: f64 = 0.015;

/// A sample as it adds up.
#[derive(Clone)]
pub(super) struct Total {
    sample: Sample,
    /// Sum of the squares of the standard errors: the lights' samples are independent.
    variance: f64,
}

impl Default for Total {
    fn default() -> Self {
        Self {
            sample: Sample::DARK,
            variance: 0.0,
        }
    }
}

impl Total {
    /// Adds what is seen of a light of this strength.
    fn add_seen(&mut self, seen: &Seen, strength: DVec3) {
        let parts = match seen {
            Seen::Alike(part) => return self.add(part, strength),
            Seen::Tinted(parts) => parts,
        };
        let (mut error, mut rounding) = (0.0_f64, 0.0_f64);
        for (channel, part) in parts.iter().enumerate() {
            error = error.max(part.error * strength[channel]);
            rounding = rounding.max(part.sums.rounding * strength[channel]);
            let mut alone = *part;
            // Rays and errors are those of all channels.
            (alone.rays, alone.error, alone.sums.rounding) = (0, 0.0, 0.0);
            self.add_tinted(&alone, strength, DVec3::AXES[channel]);
        }
        self.sample.rays += parts[0].rays;
        self.sample.error += rounding;
        self.variance += error * error;
    }

    /// Adds what is seen of a light of this strength, in all channels alike.
    pub(super) fn add(&mut self, part: &Part, strength: DVec3) {
        self.add_tinted(part, strength, DVec3::ONE);
    }

    /// Adds a share, per channel, of what is seen of a light of this strength; its errors are those of the whole.
    pub(super) fn add_tinted(&mut self, part: &Part, strength: DVec3, share: DVec3) {
        let sums = &part.sums;
        let sample = &mut self.sample;
        sample.rays += part.rays;
        for channel in 0..3 {
            let strength = strength[channel] * share[channel];
            sample.g[channel] += sums.g * strength;
            sample.phi[channel] += sums.phi * strength;
            if sums.has_gradient {
                sample.j[channel] += sums.j * strength;
                sample.grad_phi[channel] += sums.grad_phi * strength;
            }
        }
        let brightest = strength.max_element();
        sample.has_gradient &= sums.has_gradient;
        sample.error += TYPICAL * sums.rounding * brightest;
        self.variance += (part.error * brightest).powi(2);
    }

    /// Irradiance in lux, brightest channel, at the receiver's own normal.
    pub(super) fn irradiance(&self, receiver: &Receiver) -> f64 {
        self.sample.irradiance(receiver.normal).max_element()
    }

    /// Adds a bound in lux to the error.
    pub(super) fn widen(&mut self, bound: f64) {
        self.sample.error += bound;
    }

    fn finish(self, gradients: bool, left_out: f64) -> Sample {
        let mut sample = self.sample;
        sample.error += self.variance.sqrt() + left_out;
        sample.has_gradient &= gradients;
        if !sample.has_gradient {
            sample.j = [DMat3::ZERO; 3];
            sample.grad_phi = [DVec3::ZERO; 3];
        }
        sample
    }
}

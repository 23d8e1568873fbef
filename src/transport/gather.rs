//! Tiles × lights: which pairs need a look, which a closed form, which shadow rays.

use glam::{DMat3, DVec3};

use super::contour::Sums;
use super::source::{Source, Surface};
use super::{Counters, Options, Receiver, Sample, sampled};
use crate::lights::Lights;
use crate::visibility::{Occluders, Shaft};

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
    let mut pieces = Vec::new();
    for (index, polygon) in lights.polygons.iter().enumerate() {
        let source = Source::new(polygon);
        counters.pairs += 1;
        let lit: Vec<usize> = (0..tile.len())
            .filter(|&place| source.shines_on(&tile[place]))
            .collect();
        if lit.is_empty() {
            counters.pairs_facing_away += 1;
            continue;
        }
        let occluded = may_be_occluded(&source, lit.iter().map(|&place| &tile[place]), occluders);
        let surface = occluded.then(|| Surface::new(polygon));
        counters.pairs_sampled += u64::from(occluded);
        counters.pairs_unoccluded += u64::from(!occluded);
        for place in lit {
            let receiver = &tile[place];
            let gradients = options.gradients && !occluded;
            let Some(whole) = source.unoccluded(receiver, gradients, &mut pieces) else {
                continue;
            };
            let total = &mut totals[place];
            if let Some(surface) = &surface {
                let part = sampled::estimate(
                    &source,
                    surface,
                    receiver,
                    &whole,
                    index as u64,
                    options.samples,
                    occluders,
                );
                total.add(&part.sums, polygon.radiance, part.error);
                total.sample.rays += part.rays;
                counters.shadow_rays += u64::from(part.rays);
            } else {
                total.add(&whole.sums, polygon.radiance, 0.0);
            }
        }
    }
    let samples = totals
        .into_iter()
        .map(|total| total.finish(options.gradients))
        .collect();
    (samples, counters)
}

/// Whether anything but the light itself may stand between the light and one of the receivers.
fn may_be_occluded<'a>(
    source: &Source<'_>,
    receivers: impl Iterator<Item = &'a Receiver>,
    occluders: &Occluders<'_>,
) -> bool {
    let polygon = source.polygon;
    let receivers: Vec<_> = receivers
        .map(|receiver| (receiver.position, receiver.normal))
        .collect();
    let vertices: Vec<DVec3> = polygon.contours.iter().flatten().copied().collect();
    let shaft = Shaft::new(&receivers, &vertices, polygon.normal);
    let ignore = |triangle: u32| polygon.surface.binary_search(&triangle).is_ok();
    !occluders.in_shaft(&shaft, &ignore).is_empty()
}

/// A sample as it adds up.
#[derive(Clone)]
struct Total {
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
    /// Adds a light of `radiance` nit; `error` is the standard error of its irradiance per unit radiance.
    fn add(&mut self, sums: &Sums, radiance: DVec3, error: f64) {
        let sample = &mut self.sample;
        for channel in 0..3 {
            let radiance = radiance[channel];
            sample.g[channel] += sums.g * radiance;
            sample.phi[channel] += sums.phi * radiance;
            if sums.has_gradient {
                sample.j[channel] += sums.j * radiance;
                sample.grad_phi[channel] += sums.grad_phi * radiance;
            }
        }
        let brightest = radiance.max_element();
        sample.has_gradient &= sums.has_gradient;
        sample.error += sums.rounding * brightest;
        self.variance += (error * brightest).powi(2);
    }

    fn finish(self, gradients: bool) -> Sample {
        let mut sample = self.sample;
        sample.error += self.variance.sqrt();
        sample.has_gradient &= gradients;
        if !sample.has_gradient {
            sample.j = [DMat3::ZERO; 3];
            sample.grad_phi = [DVec3::ZERO; 3];
        }
        sample
    }
}

//! Lights that matter little to a tile: a shadow ray per receiver at most, or none.
//!
//! Adaptive shadow testing (G. Ward, "The RADIANCE lighting simulation and rendering system", SIGGRAPH 1994, section 3.3), on light vectors.
//! What each light could give, with nothing in the way, is estimated first. Lights above the threshold's share are not for this module:
//! their penumbrae are integrated. Of the others each receiver tests the largest first, by a ray to a random place of the light, until what
//! is left to test is below the threshold's share of what is known. The rest is added as it would be unoccluded, times how likely it is seen:
//! the share of the tile's rays that reached this light, times how this receiver fares compared with its tile, at most 1.
//!
//! Where there are very many, small ones that lie together far away count as one, and of those that remain to be tested as many are drawn as a
//! receiver has rays for, in the order of space and in proportion to how much of their light is in doubt.
//!
//! Differences to Radiance: histories are those of the tile, so that neither the order of tiles nor threads change anything; groups of
//! lights between which and the tile nothing stands cast no rays; and the untested part enters the error as the bound it is.

mod split;
mod unit;

use glam::DVec3;

pub use self::split::MANY_LIGHTS;
pub(super) use self::split::{Split, split};
use self::unit::Unit;
use super::contour::Piece;
use super::gather::Total;
use super::pair::Part;
use super::source::Source;
use super::{Counters, Options, Receiver};
use crate::math::{self, Aabb};
use crate::visibility::{Occluders, Shaft, Visibility};

/// Lights whose view of the tile is looked at together. Fewer make more shafts, more make them wider, and fewer of them empty.
const GROUP: usize = 16;

/// Standard deviations of a ray's answer that count as its error: what a threshold leaves out is to be bounded, not guessed.
const SIGMAS: f64 = 3.0;

/// Rays that a receiver has for minor lights; of more lights it draws. On a hall with 10,000 lamps the error is 0.3 % of the light with 800 and
/// 0.6 % with 400.
const MAX_RAYS: usize = 800;

/// Lights above which small ones are taken together: twice as many as there are rays for, since drawing is more exact.
const VERY_MANY: usize = 2 * MAX_RAYS;

/// What the tests of one tile said of one light.
#[derive(Clone, Copy, Default)]
struct History {
    tested: f64,
    seen: f64,
}

/// A minor light as a tile meets it.
struct Minor<'s, 'a> {
    unit: Unit<'s, 'a>,
    /// Whether nothing can stand between it and the tile.
    open: bool,
    /// Whether glass may.
    tinted: bool,
    history: History,
}

/// A light that a receiver looked at: what of it is seen, per channel; `None` when it was not worth a test.
type Answer = (usize, Option<DVec3>);

/// The lights and rays of a tile.
struct Tests<'s, 'a> {
    minors: Vec<Minor<'s, 'a>>,
    /// What the tests said of all of them.
    all: History,
    tile: &'s [Receiver],
    occluders: &'s Occluders<'a>,
    options: &'s Options,
    counters: &'s mut Counters,
    pieces: Vec<Piece>,
}

/// Adds the light of the minor lights to `totals`.
pub(super) fn add(
    sources: &[Source<'_>],
    split: &Split,
    tile: &[Receiver],
    occluders: &Occluders<'_>,
    options: &Options,
    totals: &mut [Total],
    counters: &mut Counters,
) {
    if split.minor.is_empty() {
        return;
    }
    let minors = unit::units(sources, &split.minor, tile, VERY_MANY)
        .into_iter()
        .map(|unit| Minor {
            unit,
            open: false,
            tinted: false,
            history: History::default(),
        })
        .collect();
    let mut tests = Tests {
        minors,
        all: History::default(),
        tile,
        occluders,
        options,
        counters,
        pieces: Vec::new(),
    };
    tests.open_groups();
    let answers: Vec<Vec<Answer>> = totals
        .iter_mut()
        .enumerate()
        .map(|(place, total)| tests.test(place, total))
        .collect();
    for ((place, total), answers) in totals.iter_mut().enumerate().zip(&answers) {
        tests.sum(place, answers, total);
    }
}

impl Tests<'_, '_> {
    /// Finds the groups that nothing stands before.
    fn open_groups(&mut self) {
        let planes: Vec<_> = self
            .tile
            .iter()
            .map(|receiver| (receiver.position, receiver.normal))
            .collect();
        let places = Aabb::from_points(self.tile.iter().map(|receiver| receiver.position));
        for group in self.minors.chunks_mut(GROUP) {
            let bounds = group
                .iter()
                .map(|minor| minor.unit.bounds())
                .fold(Aabb::from_points([]), Aabb::union);
            let away = (bounds.centre() - places.centre()).normalize_or(DVec3::Y);
            let shaft = Shaft::new(&planes, &bounds.corners(), -away);
            let own = |id: u32| group.iter().any(|minor| minor.unit.owns(id));
            let tinted = self.occluders.has_pane_in(&shaft, &own);
            let open = !tinted && self.occluders.in_shaft(&shaft, &own).is_empty();
            for minor in &mut *group {
                (minor.open, minor.tinted) = (open, tinted);
            }
        }
    }

    /// Casts the rays of one receiver, and adds what needs no more than them. Comes back with what is to be added when all have cast theirs.
    fn test(&mut self, place: usize, total: &mut Total) -> Vec<Answer> {
        let receiver = &self.tile[place];
        let mut hidden = Vec::new();
        for (index, minor) in self.minors.iter().enumerate() {
            if minor.open {
                if let Some((sums, strength)) = minor.unit.light(receiver, &mut self.pieces) {
                    let part = Part {
                        sums,
                        error: 0.0,
                        rays: 0,
                    };
                    total.add(&part, strength);
                }
                continue;
            }
            let potential = minor.unit.potential(receiver);
            if potential > 0.0 {
                hidden.push((potential, index));
            }
        }
        if hidden.len() > MAX_RAYS {
            self.add_drawn(place, &hidden, total);
            Vec::new()
        } else {
            self.test_in_turn(place, hidden, total.irradiance(receiver))
        }
    }

    /// The largest first, until the rest is below the threshold's share of what is known.
    fn test_in_turn(
        &mut self,
        place: usize,
        mut lights: Vec<(f64, usize)>,
        mut known: f64,
    ) -> Vec<Answer> {
        lights.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let n_lights = lights.len();
        let mut rest = vec![0.0; n_lights + 1];
        for rank in (0..n_lights).rev() {
            rest[rank] = rest[rank + 1] + lights[rank].0;
        }
        let mut is_done = false;
        let mut answers = Vec::with_capacity(n_lights);
        for (rank, &(potential, index)) in lights.iter().enumerate() {
            let left = (n_lights - rank) as f64;
            let ahead = left.powf(self.options.direct_certainty).ceil() as usize;
            let next = rest[rank] - rest[(rank + ahead).min(n_lights)];
            is_done = is_done || next <= self.options.direct_threshold * known;
            if is_done {
                answers.push((index, None));
                continue;
            }
            let seen = self.ask(place, index);
            known += potential * seen.max_element();
            answers.push((index, Some(seen)));
        }
        answers
    }

    /// As many as there are rays, systematically in the order of space, in proportion to how much of their light is in doubt. What they say
    /// beyond what was expected stands for the others (a difference estimator: W. Cochran, "Sampling techniques", 3rd edition 1977).
    fn add_drawn(&mut self, place: usize, lights: &[(f64, usize)], total: &mut Total) {
        let receiver = &self.tile[place];
        let doubts: Vec<f64> = lights
            .iter()
            .map(|&(potential, index)| potential * self.minors[index].history.deviation())
            .collect();
        let step = doubts.iter().sum::<f64>() / MAX_RAYS as f64;
        let [start, _] = math::unit_pair(math::hash(receiver.seed, u64::MAX, 1));
        let (mut next, mut sum) = (start * step, 0.0);
        for (&(_, index), doubt) in lights.iter().zip(doubts) {
            let expected = self.likelihood(index);
            sum += doubt;
            let (mut share, mut deviation, mut rays) = (DVec3::splat(expected), 0.0, 0);
            if sum > next {
                while next < sum {
                    next += step;
                }
                let probability = (doubt / step).min(1.0);
                let surprise = (self.ask(place, index) - expected) / probability;
                share += surprise;
                deviation = surprise.abs().max_element() * (1.0 - probability).sqrt();
                rays = 1;
            } else {
                self.counters.lights_untested += 1;
            }
            let unit = &self.minors[index].unit;
            if let Some((sums, strength)) = unit.light(receiver, &mut self.pieces) {
                let irradiance = sums.g.dot(receiver.normal).max(0.0);
                let part = Part {
                    sums,
                    error: irradiance * deviation * SIGMAS,
                    rays,
                };
                total.add_tinted(&part, strength, share);
            }
        }
    }

    /// Tests a light by a ray, and remembers.
    fn ask(&mut self, place: usize, index: usize) -> DVec3 {
        let receiver = &self.tile[place];
        let from = receiver.position;
        let minor = &mut self.minors[index];
        let to = minor.unit.target(receiver);
        let own = |id: u32| minor.unit.owns(id);
        let seen = if self.occluders.occluded(from, to, &own) {
            DVec3::ZERO
        } else if minor.tinted {
            self.occluders.transmittance(from, to, &own)
        } else {
            DVec3::ONE
        };
        for history in [&mut minor.history, &mut self.all] {
            history.tested += 1.0;
            history.seen += mean(seen);
        }
        self.counters.shadow_rays += 1;
        seen
    }

    /// How likely a light is seen where nobody looked: as often as the tile saw it, or as it saw the others.
    fn likelihood(&self, index: usize) -> f64 {
        let own = self.minors[index].history.share();
        own.or(self.all.share()).unwrap_or(1.0)
    }

    /// Adds what the answers of one receiver come to.
    fn sum(&mut self, place: usize, answers: &[Answer], total: &mut Total) {
        let receiver = &self.tile[place];
        let (mut seen, mut expected) = (0.0, 0.0);
        for &(index, answer) in answers {
            if let Some(share) = answer {
                seen += mean(share);
                expected += self.likelihood(index);
            }
        }
        let fortune = if expected > 0.0 { seen / expected } else { 1.0 };
        for &(index, answer) in answers {
            let minor = &self.minors[index];
            let Some((sums, strength)) = minor.unit.light(receiver, &mut self.pieces) else {
                continue;
            };
            let irradiance = sums.g.dot(receiver.normal).max(0.0);
            let (share, deviation) = match answer {
                Some(share) if minor.unit.is_hard() => (share, 0.0),
                Some(share) => (share, minor.history.deviation()),
                None => {
                    self.counters.lights_untested += 1;
                    let share = (self.likelihood(index) * fortune).min(1.0);
                    total.widen(irradiance * share.max(1.0 - share) * strength.max_element());
                    (DVec3::splat(share), 0.0)
                }
            };
            let part = Part {
                sums,
                error: irradiance * deviation * SIGMAS,
                rays: u32::from(answer.is_some()),
            };
            total.add_tinted(&part, strength, share);
        }
    }
}

impl History {
    /// Share of the tests that saw it; `None` without any.
    fn share(&self) -> Option<f64> {
        (self.tested > 0.0).then(|| self.seen / self.tested)
    }

    /// Standard deviation of one answer, half an answer at least being in doubt.
    fn deviation(&self) -> f64 {
        let doubt = 0.5 / (self.tested + 1.0);
        let share = ((self.seen + doubt) / (self.tested + 2.0 * doubt)).clamp(0.0, 1.0);
        (share * (1.0 - share)).sqrt()
    }
}

/// Of the channels.
fn mean(share: DVec3) -> f64 {
    share.element_sum() / 3.0
}

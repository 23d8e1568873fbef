//! Lights that matter little to a tile: a shadow ray per receiver at most, or none.
//!
//! Adaptive shadow testing (G. Ward, "The RADIANCE lighting simulation and rendering system", SIGGRAPH 1994, section 3.3), on light vectors.
//! What each light could give, with nothing in the way, is estimated first. Lights above the threshold's share are not for this module:
//! their penumbrae are integrated. Of the others each receiver tests the largest first, by a ray to a random place of the light, until what
//! is left to test is below the threshold's share of what is known. The rest is added as it would be unoccluded, times how likely it is seen:
//! the share of the tile's rays that reached this light, times how this receiver fares compared with its tile, at most 1.
//!
//! Where very many remain to be tested, as many of them are drawn as a receiver has rays for, in the order of space and in proportion to what
//! they could give.
//!
//! Differences to Radiance: histories are those of the tile, so that neither the order of tiles nor threads change anything; groups of
//! lights between which and the tile nothing stands cast no rays; and the untested part enters the error as the bound it is.

mod flock;
mod split;

use std::ops::Range;

use glam::DVec3;

use self::flock::Flock;
pub use self::split::MANY_LIGHTS;
pub(super) use self::split::{Split, split};
use super::contour::Piece;
use super::gather::Total;
use super::pair::Part;
use super::source::{Source, Surface};
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

/// What the tests of one tile said of one light.
#[derive(Clone, Copy, Default)]
struct History {
    tested: f64,
    seen: f64,
}

/// A minor light as a tile meets it.
struct Minor<'s, 'a> {
    source: &'s Source<'a>,
    light: u64,
    surface: Option<Surface<'a>>,
    /// Whether nothing can stand between it and the tile.
    open: bool,
    /// Whether glass may.
    tinted: bool,
    history: History,
}

/// What is known of one minor light at one receiver.
#[derive(Clone, Copy)]
enum Answer {
    /// What of it is seen, per channel.
    Seen(DVec3),
    /// Drawn with this probability, when the light was expected to be seen so often.
    Drawn {
        seen: DVec3,
        expected: f64,
        probability: f64,
    },
    /// Not drawn.
    Expected(f64),
    /// Not worth a test.
    Unknown,
}

impl Answer {
    fn is_tested(self) -> bool {
        matches!(self, Self::Seen(_) | Self::Drawn { .. })
    }
}

/// Lights that lie together.
struct Group {
    /// Places in [`Tests::minors`].
    lights: Range<usize>,
    /// Whether nothing can stand between them and the tile.
    open: bool,
    /// All of them as one, where they look the same way.
    flock: Option<Flock>,
}

/// The lights and rays of a tile.
struct Tests<'s, 'a> {
    minors: Vec<Minor<'s, 'a>>,
    groups: Vec<Group>,
    tile: &'s [Receiver],
    occluders: &'s Occluders<'a>,
    options: &'s Options,
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
    let minors = split
        .minor
        .iter()
        .map(|&light| Minor {
            source: &sources[light],
            light: light as u64,
            surface: None,
            open: false,
            tinted: false,
            history: History::default(),
        })
        .collect();
    let mut tests = Tests {
        minors,
        groups: Vec::new(),
        tile,
        occluders,
        options,
    };
    tests.open_groups();
    let answers: Vec<Vec<(usize, Answer)>> = (0..tile.len())
        .map(|place| {
            tests.add_flocks(place, &mut totals[place]);
            let known = totals[place].irradiance(&tile[place]);
            tests.test(place, known, counters)
        })
        .collect();
    for (place, answers) in answers.iter().enumerate() {
        tests.sum(place, answers, &mut totals[place], counters);
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
        let n_minors = self.minors.len();
        for first in (0..n_minors).step_by(GROUP) {
            let lights = first..(first + GROUP).min(n_minors);
            let group = &mut self.minors[lights.clone()];
            let bounds = group
                .iter()
                .map(|minor| minor.source.bounds())
                .fold(Aabb::from_points([]), Aabb::union);
            let away = (bounds.centre() - places.centre()).normalize_or(DVec3::Y);
            let shaft = Shaft::new(&planes, &bounds.corners(), -away);
            let own = |id: u32| {
                group
                    .iter()
                    .any(|minor| minor.source.own_triangles().binary_search(&id).is_ok())
            };
            let tinted = self.occluders.has_pane_in(&shaft, &own);
            let open = !tinted && self.occluders.in_shaft(&shaft, &own).is_empty();
            for minor in &mut *group {
                (minor.open, minor.tinted) = (open, tinted);
            }
            self.groups.push(Group {
                flock: if open { Flock::of(group) } else { None },
                lights,
                open,
            });
        }
    }

    /// Adds what needs no test and no closer look.
    fn add_flocks(&self, place: usize, total: &mut Total) {
        let receiver = &self.tile[place];
        for flock in self
            .groups
            .iter()
            .filter_map(|group| group.flock_at(receiver))
        {
            let part = Part {
                sums: flock.sums(receiver.position),
                error: 0.0,
                rays: 0,
            };
            total.add(&part, flock.output);
        }
    }

    /// Casts the rays of one receiver. Comes back in the order of the lights, with those that are worth anything.
    fn test(&mut self, place: usize, known: f64, counters: &mut Counters) -> Vec<(usize, Answer)> {
        let receiver = &self.tile[place];
        let mut known = known;
        let mut answers = Vec::new();
        let mut hidden = Vec::new();
        for group in &self.groups {
            if group.flock_at(receiver).is_some() {
                continue;
            }
            for index in group.lights.clone() {
                let potential = self.minors[index].source.potential(receiver);
                if potential <= 0.0 {
                    continue;
                }
                if group.open {
                    known += potential;
                    answers.push((index, Answer::Seen(DVec3::ONE)));
                } else {
                    hidden.push((potential, index));
                }
            }
        }
        if hidden.len() > MAX_RAYS {
            self.test_drawn(place, &hidden, &mut answers, counters);
        } else {
            self.test_in_turn(place, hidden, known, &mut answers, counters);
        }
        answers.sort_unstable_by_key(|(index, _)| *index);
        answers
    }

    /// The largest first, until the rest is below the threshold.
    fn test_in_turn(
        &mut self,
        place: usize,
        mut lights: Vec<(f64, usize)>,
        mut known: f64,
        answers: &mut Vec<(usize, Answer)>,
        counters: &mut Counters,
    ) {
        lights.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let n_lights = lights.len();
        let mut rest = vec![0.0; n_lights + 1];
        for rank in (0..n_lights).rev() {
            rest[rank] = rest[rank + 1] + lights[rank].0;
        }
        let mut is_done = false;
        for (rank, &(potential, index)) in lights.iter().enumerate() {
            let left = (n_lights - rank) as f64;
            let ahead = left.powf(self.options.direct_certainty).ceil() as usize;
            let next = rest[rank] - rest[(rank + ahead).min(n_lights)];
            is_done = is_done || next <= self.options.direct_threshold * known;
            if is_done {
                answers.push((index, Answer::Unknown));
                continue;
            }
            let seen = self.ask(place, index, counters);
            known += potential * seen.max_element();
            answers.push((index, Answer::Seen(seen)));
        }
    }

    /// As many as there are rays, systematically in the order of space, in proportion to how much of their light is in doubt. What they say
    /// beyond what was expected stands for the others (a difference estimator: W. Cochran, "Sampling techniques", 3rd edition 1977).
    fn test_drawn(
        &mut self,
        place: usize,
        lights: &[(f64, usize)],
        answers: &mut Vec<(usize, Answer)>,
        counters: &mut Counters,
    ) {
        let everybody = self.everybody();
        let doubts: Vec<f64> = lights
            .iter()
            .map(|&(potential, index)| potential * self.minors[index].history.deviation())
            .collect();
        let step = doubts.iter().sum::<f64>() / MAX_RAYS as f64;
        let [start, _] = math::unit_pair(math::hash(self.tile[place].seed, u64::MAX, 1));
        let (mut next, mut sum) = (start * step, 0.0);
        for (&(_, index), doubt) in lights.iter().zip(doubts) {
            let expected = self.likelihood(index, everybody);
            sum += doubt;
            if sum <= next {
                answers.push((index, Answer::Expected(expected)));
                continue;
            }
            while next < sum {
                next += step;
            }
            let answer = Answer::Drawn {
                seen: self.ask(place, index, counters),
                expected,
                probability: (doubt / step).min(1.0),
            };
            answers.push((index, answer));
        }
    }

    /// Share of the tile's rays that reached their light.
    fn everybody(&self) -> f64 {
        let (tested, seen) = self
            .minors
            .iter()
            .fold((0.0, 0.0), |(tested, seen), minor| {
                (tested + minor.history.tested, seen + minor.history.seen)
            });
        if tested > 0.0 { seen / tested } else { 1.0 }
    }

    /// Tests a light, and remembers.
    fn ask(&mut self, place: usize, index: usize, counters: &mut Counters) -> DVec3 {
        counters.shadow_rays += 1;
        let seen = self.sees(place, index);
        let history = &mut self.minors[index].history;
        history.tested += 1.0;
        history.seen += mean(seen);
        seen
    }

    /// A ray to a random place of the light.
    fn sees(&mut self, place: usize, index: usize) -> DVec3 {
        let receiver = &self.tile[place];
        let minor = &mut self.minors[index];
        let target = if minor.source.is_hard() {
            minor.source.seen_middle(receiver.position)
        } else {
            let place = math::unit_pair(math::hash(receiver.seed, minor.light, 0));
            if minor.source.is_fixed() {
                let surface = minor
                    .surface
                    .get_or_insert_with(|| minor.source.spread(DVec3::ZERO));
                surface.point(place)
            } else {
                minor.source.spread(receiver.position).point(place)
            }
        };
        let own = minor.source.own_triangles();
        let ignore = |id: u32| own.binary_search(&id).is_ok();
        if self.occluders.occluded(receiver.position, target, &ignore) {
            DVec3::ZERO
        } else if minor.tinted {
            let from = receiver.position;
            self.occluders.transmittance(from, target, &ignore)
        } else {
            DVec3::ONE
        }
    }

    /// How likely a light is seen where nobody looked, and how sure that is.
    fn likelihood(&self, index: usize, everybody: f64) -> f64 {
        let history = self.minors[index].history;
        if history.tested > 0.0 {
            history.seen / history.tested
        } else {
            everybody
        }
    }

    /// Adds what the answers of one receiver come to.
    fn sum(
        &self,
        place: usize,
        answers: &[(usize, Answer)],
        total: &mut Total,
        counters: &mut Counters,
    ) {
        let receiver = &self.tile[place];
        let everybody = self.everybody();
        let (mut seen, mut expected) = (0.0, 0.0);
        for &(index, answer) in answers {
            if let Answer::Seen(is_seen) = answer
                && !self.minors[index].open
            {
                seen += mean(is_seen);
                expected += self.likelihood(index, everybody);
            }
        }
        let fortune = if expected > 0.0 { seen / expected } else { 1.0 };
        let mut pieces: Vec<Piece> = Vec::new();
        for &(index, answer) in answers {
            let minor = &self.minors[index];
            let Some(sums) = minor.source.at_a_glance(receiver, &mut pieces) else {
                continue;
            };
            let irradiance = sums.g.dot(receiver.normal).max(0.0);
            let (weight, deviation, bound) = match answer {
                Answer::Seen(seen) => {
                    let deviation = if minor.open || minor.source.is_hard() {
                        0.0
                    } else {
                        minor.history.deviation()
                    };
                    (seen, deviation, 0.0)
                }
                Answer::Drawn {
                    seen,
                    expected,
                    probability,
                } => {
                    let surprise = (seen - expected) / probability;
                    let deviation = surprise.abs().max_element() * (1.0 - probability).sqrt();
                    (surprise + expected, deviation, 0.0)
                }
                Answer::Expected(expected) => {
                    counters.lights_untested += 1;
                    (DVec3::splat(expected), 0.0, 0.0)
                }
                Answer::Unknown => {
                    counters.lights_untested += 1;
                    let likelihood = self.likelihood(index, everybody);
                    let weight = (likelihood * fortune).min(1.0);
                    (DVec3::splat(weight), 0.0, weight.max(1.0 - weight))
                }
            };
            let part = Part {
                sums: sums.without_gradient(),
                error: irradiance * deviation * SIGMAS,
                rays: u32::from(answer.is_tested() && !minor.open),
            };
            total.add_tinted(&part, minor.source.strength, weight);
            total.widen(irradiance * bound * minor.source.strength.max_element());
        }
    }
}

impl Group {
    /// The group as one, where `receiver` may take it so.
    fn flock_at(&self, receiver: &Receiver) -> Option<&Flock> {
        self.flock
            .as_ref()
            .filter(|flock| flock.is_one_to(receiver))
    }
}

impl History {
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

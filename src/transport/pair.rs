//! One light and one tile: how the visible part of the light is found there.

use std::cell::OnceCell;

use glam::DVec3;

use super::contour::{self, Piece, Sums};
use super::exact;
use super::frame;
use super::outline::Outline;
use super::sampled::{self, Seen, View};
use super::source::{Source, Surface};
use super::traced::{self, Outcome};
use super::vedel;
use super::{Counters, Estimator, Options, Receiver};
use crate::math::Aabb;
use crate::visibility::{Occluders, Visibility};

/// Candidate edges of a tile up to which [`Estimator::Auto`] clips without further ado: that is cheaper than the 64 rays with which
/// sampling begins. Larger would leave what is dearer unweighed; smaller would weigh what is not in doubt.
const FEW_EDGES: usize = 128;

/// Share of a light's irradiance by which Vedel's contour may be off for what lies between its samples, per sample. With 1/2 the
/// claim is the standard deviation of a coin in the part that one sample stands for; 1/3 does not cover the thin quad of the fixture
/// `slab`, more would say too much where nothing is missed.
const UNSEEN: f64 = 0.5;

/// Diameter over distance of the pieces of a light that are sampled first (G. Ward 1994, section 3.3, figure 6), radians. Smaller casts
/// rays at far lights that one would do for; with larger ones the first guess of the error is poorer.
const PIECE: f64 = 0.15;

/// What a receiver sees of a light, per unit of its strength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Light vector, fluence and, where they are known, derivatives; `rounding` bounds the error where nothing is sampled.
    pub(super) sums: Sums,
    /// Standard error of the irradiance at the receiver's own normal, steradians, or what a traced contour may be off; 0 where the contour
    /// is exact.
    pub(super) error: f64,
    /// Rays cast.
    pub(super) rays: u32,
}

/// Memory that evaluations reuse.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    borders: Vec<Piece>,
    visible: Vec<Piece>,
    exact: exact::Scratch,
    vedel: vedel::Scratch,
    /// Evaluations that were to be traced and were clipped instead.
    pub(super) fallbacks: u64,
    /// Silhouette edges before lights that were clipped, over all evaluations, and where those met.
    pub(super) silhouettes: u64,
    pub(super) crossings: u64,
}

/// A light and how it is looked at from one tile.
#[derive(Debug)]
pub(super) struct Pair<'a> {
    source: &'a Source<'a>,
    light: u64,
    way: Way<'a>,
    /// Whether glass may stand in between.
    is_tinted: bool,
    occluders: &'a Occluders<'a>,
    options: &'a Options,
}

#[derive(Debug)]
enum Way<'a> {
    /// Nothing can stand in between.
    Open,
    /// For receivers in front of the light and behind it.
    Exact { front: Outline, back: Outline },
    /// A shadow ray: the light is a point.
    Hard,
    /// Shadow rays to points on the light, which are the same for every receiver or spread for each anew.
    Sampled(Option<Surface<'a>>),
    /// Shadow rays that trace the contour as published.
    Vedel(vedel::Frame),
    /// A few shadow rays, and outlines followed along the meshes.
    Traced(Box<Traced<'a>>),
}

/// What tracing needs, and what it falls back to.
#[derive(Debug)]
struct Traced<'a> {
    tile: traced::Tile<'a>,
    /// Box of the receivers.
    places: Aabb,
    /// Of the receivers' side of the light.
    outline: OnceCell<Outline>,
}

impl<'a> Pair<'a> {
    /// `light` is the index of the source; `receivers` are those that it shines on.
    pub(super) fn new(
        source: &'a Source<'a>,
        light: u64,
        receivers: &[Receiver],
        occluders: &'a Occluders<'a>,
        options: &'a Options,
        counters: &mut Counters,
    ) -> Self {
        let (way, is_tinted) = choose(source, receivers, occluders, options);
        counters.pairs_tinted += u64::from(is_tinted);
        match &way {
            Way::Open => counters.pairs_unoccluded += 1,
            Way::Exact { front, back } => {
                counters.pairs_exact += 1;
                counters.edges += (front.n_edges() + back.n_edges()) as u64;
            }
            Way::Hard => counters.pairs_hard += 1,
            Way::Sampled(_) => counters.pairs_sampled += 1,
            Way::Vedel(_) => counters.pairs_vedel += 1,
            Way::Traced(_) => counters.pairs_traced += 1,
        }
        Self {
            source,
            light,
            way,
            is_tinted,
            occluders,
            options,
        }
    }

    /// What `receiver` sees of the light; `None` when it would see nothing even with nothing in the way.
    pub(super) fn evaluate(&self, receiver: &Receiver, scratch: &mut Scratch) -> Option<Seen> {
        let (share, slope) = self.source.attenuation(receiver.position);
        if share <= 0.0 {
            return None;
        }
        let mut seen = match &self.way {
            Way::Sampled(surface) => self.sample(receiver, surface.as_ref(), scratch)?,
            Way::Hard => self.one_ray(receiver, scratch)?,
            _ => Seen::Alike(self.look(receiver, scratch)?),
        };
        seen.for_each(|part| {
            part.sums.attenuate(share, slope);
            part.error *= share;
        });
        Some(seen)
    }

    /// What arrives along segments to the light, per channel.
    fn arrives(&self, segments: &[[DVec3; 2]]) -> Vec<DVec3> {
        let own = self.source.own_triangles();
        let ignore = |triangle: u32| own.binary_search(&triangle).is_ok();
        let mut hidden = Vec::new();
        self.occluders.occluded_each(segments, &ignore, &mut hidden);
        let share = |(is_hidden, &[from, to]): (bool, &[DVec3; 2])| match is_hidden {
            true => DVec3::ZERO,
            false if self.is_tinted => self.occluders.transmittance(from, to, &ignore),
            false => DVec3::ONE,
        };
        hidden.into_iter().zip(segments).map(share).collect()
    }

    /// A light without a size.
    fn one_ray(&self, receiver: &Receiver, scratch: &mut Scratch) -> Option<Seen> {
        let mut part = self.open(receiver, scratch)?;
        part.rays = 1;
        let middle = self.source.seen_middle(receiver.position);
        let share = self.arrives(&[[receiver.position, middle]])[0];
        let of_channel = |channel: usize| {
            let mut part = part;
            part.sums.attenuate(share[channel], DVec3::ZERO);
            part
        };
        Some(if self.is_tinted {
            Seen::Tinted(Box::new([0, 1, 2].map(of_channel)))
        } else {
            Seen::Alike(of_channel(0))
        })
    }

    fn sample(
        &self,
        receiver: &Receiver,
        surface: Option<&Surface<'_>>,
        scratch: &mut Scratch,
    ) -> Option<Seen> {
        let source = self.source;
        let whole = source.unoccluded(receiver, false, &mut scratch.borders)?;
        let spread;
        let surface = match surface {
            Some(surface) => surface,
            None => {
                spread = source.spread(receiver.position);
                &spread
            }
        };
        let view = View {
            source,
            surface,
            receiver,
            whole: &whole,
            light: self.light,
            arrives: &|segments| self.arrives(segments),
            is_tinted: self.is_tinted,
        };
        let accepted = self.options.accepted_error / source.strength.max_element();
        // A light that is small for its distance needs few rays to begin with; where that is not enough, its error says so.
        let samples = if accepted > 0.0 {
            let pieces = (source.apparent_size(receiver.position) / PIECE).powi(2);
            (pieces.ceil() as u32).clamp(1, self.options.samples)
        } else {
            self.options.samples
        };
        Some(sampled::estimate_to(&view, samples, accepted))
    }

    /// Without sampling.
    fn look(&self, receiver: &Receiver, scratch: &mut Scratch) -> Option<Part> {
        match &self.way {
            Way::Open | Way::Hard | Way::Sampled(_) => self.open(receiver, scratch),
            Way::Traced(traced) => self.trace(receiver, traced, scratch),
            Way::Exact { front, back } => self.clip(receiver, front, back, scratch),
            Way::Vedel(frame) => self.trace_as_vedel(receiver, frame, scratch),
        }
    }

    fn open(&self, receiver: &Receiver, scratch: &mut Scratch) -> Option<Part> {
        let gradients = self.options.gradients;
        let whole = self
            .source
            .unoccluded(receiver, gradients, &mut scratch.borders)?;
        Some(Part {
            sums: whole.sums,
            error: 0.0,
            rays: 0,
        })
    }

    fn trace(
        &self,
        receiver: &Receiver,
        traced: &Traced<'_>,
        scratch: &mut Scratch,
    ) -> Option<Part> {
        let position = receiver.position;
        let borders = &mut scratch.borders;
        if !self.source.outline(receiver, position, borders) {
            return None;
        }
        let away = self.source.away(position);
        let surface = self.source.own_triangles();
        let (outcome, rays) = traced
            .tile
            .contour(position, borders, away, surface, traced::CELLS);
        let part = match outcome {
            Outcome::Open => self.open(receiver, scratch)?,
            Outcome::Contour(pieces) => {
                let normal = receiver.normal;
                let shift = frame::rounding(position, borders);
                let sums = contour::sum_moved(&pieces, normal, self.options.gradients, shift);
                let missed = if traced.tile.is_fine() {
                    traced::MISSED * contour::sum(borders, normal, false).g.dot(normal)
                } else {
                    0.0
                };
                Part {
                    sums,
                    error: missed,
                    rays: 0,
                }
            }
            Outcome::Unclear => {
                scratch.fallbacks += 1;
                let outline = traced.outline.get_or_init(|| {
                    let edges = self.occluders.edges();
                    let front = self.source.plane_distance(position) > 0.0;
                    let plane = self.source.backdrop(&traced.places, front);
                    Outline::new(edges, &traced.places, traced.tile.candidates(), plane)
                });
                self.clip(receiver, outline, outline, scratch)?
            }
        };
        Some(Part { rays, ..part })
    }

    fn clip(
        &self,
        receiver: &Receiver,
        front: &Outline,
        back: &Outline,
        scratch: &mut Scratch,
    ) -> Option<Part> {
        let Scratch {
            borders,
            visible,
            exact,
            silhouettes,
            crossings,
            ..
        } = scratch;
        if !self.source.outline(receiver, receiver.position, borders) {
            return None;
        }
        let away = self.source.away(receiver.position);
        let outline = if self.source.height(receiver.position) > 0.0 {
            front
        } else {
            back
        };
        visible.clear();
        let position = receiver.position;
        let shift = exact::visible_contour(position, borders, away, outline, exact, visible);
        let [n_silhouettes, n_crossings] = exact.counts();
        *silhouettes += n_silhouettes as u64;
        *crossings += n_crossings as u64;
        Some(Part {
            sums: self.sum(visible, receiver, exact::TYPICAL_SHIFT * shift),
            error: 0.0,
            rays: 0,
        })
    }

    fn trace_as_vedel(
        &self,
        receiver: &Receiver,
        frame: &vedel::Frame,
        scratch: &mut Scratch,
    ) -> Option<Part> {
        let Scratch {
            borders,
            visible,
            vedel,
            ..
        } = scratch;
        if !self.source.outline(receiver, receiver.position, borders) {
            return None;
        }
        visible.clear();
        let view = vedel::View {
            source: self.source,
            frame,
            light: self.light,
            options: &self.options.vedel,
            in_depth: self.options.gradients,
            visibility: self.occluders,
        };
        let outcome = view.visible_contour(receiver, borders, vedel, visible);
        let whole = contour::sum(borders, receiver.normal, false).g;
        let unseen = UNSEEN * whole.dot(receiver.normal).max(0.0);
        Some(Part {
            sums: self.sum(visible, receiver, 0.0),
            error: outcome.error + unseen / f64::from(outcome.samples.max(1)),
            rays: outcome.rays,
        })
    }

    /// `shift`: metres by which rounding may have moved the pieces.
    fn sum(&self, visible: &[Piece], receiver: &Receiver, shift: f64) -> Sums {
        let gradients = self.options.gradients;
        let mut sums = contour::sum_moved(visible, receiver.normal, gradients, shift);
        if self.options.appendix_derivative && sums.has_gradient {
            sums.j = vedel::appendix::jacobian(visible);
        }
        sums
    }
}

fn choose<'a>(
    source: &Source<'a>,
    receivers: &[Receiver],
    occluders: &'a Occluders<'a>,
    options: &Options,
) -> (Way<'a>, bool) {
    let places = Aabb::from_points(receivers.iter().map(|receiver| receiver.position));
    let shaft = source.shaft(receivers, &places);
    let own = source.own_triangles();
    let ignore = |triangle: u32| own.binary_search(&triangle).is_ok();
    let candidates = occluders.in_shaft(&shaft, &ignore);
    let is_tinted = occluders.has_pane_in(&shaft, &ignore);
    let way = match (candidates.is_empty(), is_tinted) {
        (true, false) => Way::Open,
        _ if source.is_hard() => Way::Hard,
        // The light behind glass has as many radiances as there are layers.
        (_, true) => sampled_way(source),
        (false, false) => integrate(source, receivers, occluders, candidates, options),
    };
    (way, is_tinted)
}

/// How a light with a size is integrated behind `candidates`.
fn integrate<'a>(
    source: &Source<'a>,
    receivers: &[Receiver],
    occluders: &'a Occluders<'a>,
    candidates: Vec<u32>,
    options: &Options,
) -> Way<'a> {
    if options.estimator == Estimator::Vedel
        && let Some(polygon) = source.polygon()
    {
        return Way::Vedel(vedel::Frame::new(polygon));
    }
    // A contour knows edges of triangles, not of what is painted on them.
    let masked = candidates.iter().any(|id| occluders.is_masked(*id));
    if options.estimator == Estimator::Sampled || masked {
        return sampled_way(source);
    }
    if options.estimator == Estimator::Traced
        && source.is_fixed()
        && let Some(traced) = Traced::new(source, receivers, occluders, candidates.clone())
    {
        return Way::Traced(Box::new(traced));
    }
    let outline = |front: bool| {
        let positions = receivers
            .iter()
            .map(|receiver| receiver.position)
            .filter(|position| (source.height(*position) > 0.0) == front);
        let bounds = Aabb::from_points(positions);
        if bounds.is_empty() {
            return Outline::default();
        }
        let edges = occluders.edges();
        let backdrop = source.backdrop(&bounds, front);
        Outline::new(edges, &bounds, &candidates, backdrop)
    };
    let (front, back) = (outline(true), outline(false));
    let way = Way::Exact { front, back };
    if options.estimator == Estimator::Auto && is_dearer_than_rays(&way, source, receivers, options)
    {
        return sampled_way(source);
    }
    way
}

/// Whether exact contours cost more than samples that meet the accepted error, by what is counted at three receivers of a tile. Tracing is
/// not weighed: it costs a multiple of clipping on every fixture.
fn is_dearer_than_rays(
    way: &Way<'_>,
    source: &Source<'_>,
    receivers: &[Receiver],
    options: &Options,
) -> bool {
    let Way::Exact { front, back } = way else {
        return false;
    };
    if front.n_edges() + back.n_edges() <= FEW_EDGES {
        return false;
    }
    let (mut exact, mut sampled) = (0.0, 0.0);
    let (mut borders, mut scratch) = (Vec::new(), exact::Scratch::default());
    for place in [0, receivers.len() / 2, receivers.len() - 1] {
        let receiver = &receivers[place];
        let position = receiver.position;
        if !source.outline(receiver, position, &mut borders) {
            continue;
        }
        let is_front = source.height(position) > 0.0;
        let outline = if is_front { front } else { back };
        let away = source.away(position);
        let Some(work) = scratch.work(position, &borders, away, outline) else {
            continue;
        };
        let whole = contour::sum(&borders, receiver.normal, false).g;
        let light = whole.dot(receiver.normal) * source.strength.max_element();
        let most = f64::from(sampled::MAX_SAMPLES);
        let pilot = f64::from(options.samples);
        exact += work.exact();
        sampled += work.sampled(options.accepted_error / light, pilot, most);
    }
    exact > sampled
}

fn sampled_way<'a>(source: &Source<'a>) -> Way<'a> {
    Way::Sampled(source.is_fixed().then(|| source.spread(DVec3::ZERO)))
}

impl<'a> Traced<'a> {
    /// `None` where tracing does not go: receivers on both sides of the light, or occluders that reach its plane.
    fn new(
        source: &Source<'_>,
        receivers: &[Receiver],
        occluders: &'a Occluders<'a>,
        candidates: Vec<u32>,
    ) -> Option<Self> {
        let first = receivers.first()?.position;
        let away = source.away(first);
        let all_agree = receivers
            .iter()
            .all(|receiver| source.away(receiver.position) == away);
        let front = source.plane_distance(first) > 0.0;
        let places = Aabb::from_points(receivers.iter().map(|receiver| receiver.position));
        let (point, _) = source.backdrop(&places, front);
        let tile = traced::Tile::new(occluders, candidates, (point, -away))?;
        all_agree.then(|| Self {
            tile,
            places,
            outline: OnceCell::new(),
        })
    }
}

//! Known outlines in the plane of a light, cut up where they cross, and what is known of the parts.
//!
//! All segments have a covered side on their left; the light's own border counts as an outline that covers everything outside. Where two
//! segments cross, the part of either that lies on the covered side of the other bounds nothing that is seen. The two other parts bound
//! the same corner of the plane, so they are seen or hidden together, as are two segments that follow each other at a vertex. Parts joined in
//! this way form closed loops, and one look beside a loop decides for all of it.

use glam::{DVec2, DVec3};

use crate::transport::contour::Piece;
use crate::transport::exact::{self, Inside};

/// A ray that passes this near to a break leaves open which part it speaks of. Less would come near the distance at which rays pass
/// outlines, and where one meets the border the ray may fall on either side; more loses what rays tell for nothing.
const UNDECIDED: f64 = 1e-5;

/// Places within this of each other are the same. Rounding is a thousandth of it, a pixel of a light a thousand times as much.
pub(super) const SAME: f64 = 1e-9;

/// What is known of a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Knowledge {
    /// Lies on the covered side of a known outline, or outside the light.
    pub(super) covered: bool,
    /// Light was seen beside it.
    pub(super) seen: bool,
    /// Something hid the light beside it.
    pub(super) hidden: bool,
}

impl Knowledge {
    fn and(self, other: Self) -> Self {
        Self {
            covered: self.covered || other.covered,
            seen: self.seen || other.seen,
            hidden: self.hidden || other.hidden,
        }
    }

    fn is_none(self) -> bool {
        self == Self::default()
    }

    fn is_contradictory(self) -> bool {
        self.seen && (self.hidden || self.covered)
    }
}

/// A straight piece of an outline or of the light's border.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    /// The covered side lies on its left.
    pub(super) inside: Inside,
    /// `line · (X, Y, 1)` is the distance from the line, positive on the left.
    pub(super) line: DVec3,
    /// Names of the ends; segments that share one do not cross.
    pub(super) vertices: [u32; 2],
    /// Whether it really ends there, not at the rim of the region that is looked at.
    pub(super) ends_there: [bool; 2],
}

impl Segment {
    /// Distance from the line, positive on the covered side.
    pub(super) fn side(&self, place: DVec2) -> f64 {
        self.line.x * place.x + self.line.y * place.y + self.line.z
    }

    /// Parameter of the point that is nearest to `place`, between the ends.
    pub(super) fn parameter(&self, place: DVec2) -> f64 {
        let [p, q] = self.inside.places;
        let along = q - p;
        (along.dot(place - p) / along.length_squared()).clamp(0.0, 1.0)
    }

    /// Where on the plane parameter `t` is.
    pub(super) fn place(&self, t: f64) -> DVec2 {
        let [p, q] = self.inside.places;
        p + t * (q - p)
    }

    /// Parameters at which this one and another cross.
    fn crossing(&self, other: &Self) -> Option<[f64; 2]> {
        let at_first = self.inside.places.map(|place| other.side(place));
        let at_second = other.inside.places.map(|place| self.side(place));
        (exact::differ(at_first) && exact::differ(at_second))
            .then(|| [exact::zero_of(at_first), exact::zero_of(at_second)])
    }

    fn shares_a_vertex_with(&self, other: &Self) -> bool {
        self.vertices
            .iter()
            .any(|vertex| *vertex != u32::MAX && other.vertices.contains(vertex))
    }
}

/// Part of a segment between two breaks.
#[derive(Clone, Copy, Debug)]
struct Part {
    segment: usize,
    from: f64,
    to: f64,
}

/// Segments cut up at their crossings.
#[derive(Debug)]
pub(super) struct Arrangement {
    parts: Vec<Part>,
    /// First part of each segment, and the number of parts.
    starts: Vec<usize>,
    /// Parents of a forest over the parts; each tree is a loop.
    parents: Vec<usize>,
    /// Of roots.
    knowledge: Vec<Knowledge>,
}

/// Segment, parameter on it, and what a ray beside it found.
pub(super) type Note = (usize, f64, Knowledge);

/// Segment, parameter on it, crossing, and whether it starts on the covered side there.
type Break = (usize, f64, usize, bool);

impl Arrangement {
    /// `None` when an outline ends in the open: something about it is not known.
    pub(super) fn new(segments: &[Segment]) -> Option<Self> {
        let mut breaks = crossings(segments);
        breaks.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        let mut arrangement = Self {
            parts: Vec::with_capacity(segments.len() + breaks.len()),
            starts: Vec::with_capacity(segments.len() + 1),
            parents: Vec::new(),
            knowledge: Vec::new(),
        };
        // Per crossing the covered and the free part of either segment.
        let mut sides = vec![Vec::with_capacity(2); breaks.len() / 2];
        let mut rest = &breaks[..];
        for segment in 0..segments.len() {
            let (own, others) = rest.split_at(rest.partition_point(|found| found.0 <= segment));
            rest = others;
            arrangement.starts.push(arrangement.parts.len());
            let mut from = 0.0;
            for &(_, to, crossing, starts_covered) in own {
                let before = arrangement.parts.len();
                arrangement.parts.push(Part { segment, from, to });
                sides[crossing].push(if starts_covered {
                    [before, before + 1]
                } else {
                    [before + 1, before]
                });
                from = to;
            }
            let to = 1.0;
            arrangement.parts.push(Part { segment, from, to });
        }
        let n_parts = arrangement.parts.len();
        arrangement.starts.push(n_parts);
        arrangement.parents = (0..n_parts).collect();
        arrangement.knowledge = vec![Knowledge::default(); n_parts];
        for pair in sides {
            if let [[covered_a, free_a], [covered_b, free_b]] = pair[..] {
                arrangement.knowledge[covered_a].covered = true;
                arrangement.knowledge[covered_b].covered = true;
                arrangement.join(free_a, free_b);
            }
        }
        arrangement.join_at_vertices(segments)?;
        for part in 0..n_parts {
            let root = arrangement.root(part);
            let both = arrangement.knowledge[root].and(arrangement.knowledge[part]);
            arrangement.knowledge[root] = both;
        }
        Some(arrangement)
    }

    fn join_at_vertices(&mut self, segments: &[Segment]) -> Option<()> {
        // Vertex, segment, and which end of it.
        let mut ends: Vec<(u32, usize, usize)> = Vec::with_capacity(2 * segments.len());
        for (index, segment) in segments.iter().enumerate() {
            for end in 0..2 {
                if segment.ends_there[end] {
                    ends.push((segment.vertices[end], index, end));
                }
            }
        }
        ends.sort_unstable();
        let part = |index: usize, end: usize| match end {
            0 => self.starts[index],
            _ => self.starts[index + 1] - 1,
        };
        let ends: Vec<(u32, usize, DVec2)> = ends
            .into_iter()
            .map(|(vertex, index, end)| {
                let place = segments[index].inside.places[end];
                (vertex, part(index, end), place)
            })
            .collect();
        for group in ends.chunk_by(|a, b| a.0 == b.0) {
            match group {
                // Beside the light not all triangles are at hand.
                [(_, _, place)] if is_outside(&segments[..4], *place, SAME) => {}
                [_] => return None,
                [a, b] => self.join(a.1, b.1),
                // Who follows whom is not obvious; every part is looked at by itself.
                _ => {}
            }
        }
        Some(())
    }

    fn root(&mut self, mut part: usize) -> usize {
        while self.parents[part] != part {
            self.parents[part] = self.parents[self.parents[part]];
            part = self.parents[part];
        }
        part
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b)] = a.min(b);
    }

    /// Notes what was found beside a segment at parameter `t`.
    pub(super) fn note(&mut self, segments: &[Segment], (segment, t, found): Note) {
        let range = self.starts[segment]..self.starts[segment + 1];
        let parts = &self.parts[range.clone()];
        let [p, q] = segments[segment].inside.places;
        let near = |part: &Part, at: f64| {
            let limit = (UNDECIDED / p.distance(q)).min(0.25 * (part.to - part.from));
            at != 0.0 && at != 1.0 && (t - at).abs() < limit
        };
        let Some(offset) = parts
            .iter()
            .position(|part| part.from <= t && t <= part.to)
            .filter(|&offset| {
                let part = &parts[offset];
                !near(part, part.from) && !near(part, part.to)
            })
        else {
            return;
        };
        let root = self.root(range.start + offset);
        self.knowledge[root] = self.knowledge[root].and(found);
    }

    /// Per loop of which nothing is known the segment and the parameter in the middle of its longest part.
    pub(super) fn unknown(&mut self, segments: &[Segment]) -> Vec<(usize, f64)> {
        let mut longest: Vec<Option<(f64, usize)>> = vec![None; self.parts.len()];
        for index in 0..self.parts.len() {
            let root = self.root(index);
            let part = self.parts[index];
            let [p, q] = segments[part.segment].inside.places;
            let length = (part.to - part.from) * p.distance(q);
            if self.knowledge[root].is_none() && longest[root].is_none_or(|best| length > best.0) {
                longest[root] = Some((length, index));
            }
        }
        longest
            .into_iter()
            .flatten()
            .map(|(_, index)| {
                let part = self.parts[index];
                (part.segment, 0.5 * (part.from + part.to))
            })
            .collect()
    }

    /// Parts beside which light was seen, with their places, directed so that the visible side is on the left; `None` when what is
    /// known contradicts itself.
    pub(super) fn visible(
        &mut self,
        segments: &[Segment],
    ) -> Option<(Vec<Piece>, Vec<[DVec2; 2]>)> {
        let (mut pieces, mut places) = (Vec::new(), Vec::new());
        for index in 0..self.parts.len() {
            let root = self.root(index);
            let knowledge = self.knowledge[root];
            if knowledge.is_contradictory() {
                return None;
            }
            let part = self.parts[index];
            if knowledge.seen && part.from < part.to {
                let segment = &segments[part.segment];
                pieces.push(Piece {
                    a: segment.inside.point(part.to),
                    b: segment.inside.point(part.from),
                    horizon: false,
                });
                places.push([segment.place(part.to), segment.place(part.from)]);
            }
        }
        is_closed(&places).then_some((pieces, places))
    }
}

/// Whether every place where a piece ends is one where another starts: then sums of differences vanish. Two outlines along the same
/// line, each of them taken for the border of what is seen, are found out here.
fn is_closed(pieces: &[[DVec2; 2]]) -> bool {
    let (mut linear, mut quadratic) = (DVec2::ZERO, DVec2::ZERO);
    for &[p, q] in pieces {
        linear += q - p;
        quadratic += q * q - p * p;
    }
    linear.length().max(quadratic.length()) < SAME
}

/// Whether a place lies outside the light of which `border` are the sides, or nearer to its rim than `slack`.
pub(super) fn is_outside(border: &[Segment], place: DVec2, slack: f64) -> bool {
    border.iter().any(|side| side.side(place) > -slack)
}

/// Both breaks of every crossing; pairs are found by sweeping along x.
fn crossings(segments: &[Segment]) -> Vec<Break> {
    let bounds: Vec<[DVec2; 2]> = segments
        .iter()
        .map(|segment| {
            let [p, q] = segment.inside.places;
            [p.min(q), p.max(q)]
        })
        .collect();
    let mut order: Vec<usize> = (0..segments.len()).collect();
    order.sort_unstable_by(|&a, &b| bounds[a][0].x.total_cmp(&bounds[b][0].x).then(a.cmp(&b)));
    let mut breaks = Vec::new();
    for (rank, &a) in order.iter().enumerate() {
        let [low, high] = bounds[a];
        for &b in &order[rank + 1..] {
            let [other_low, other_high] = bounds[b];
            if other_low.x > high.x {
                break;
            }
            let (first, second) = (&segments[a], &segments[b]);
            if other_low.y > high.y || low.y > other_high.y || first.shares_a_vertex_with(second) {
                continue;
            }
            if let Some([t, u]) = first.crossing(second) {
                let crossing = breaks.len() / 2;
                let starts_covered = second.side(first.inside.places[0]) >= 0.0;
                breaks.push((a, t, crossing, starts_covered));
                let starts_covered = first.side(second.inside.places[0]) >= 0.0;
                breaks.push((b, u, crossing, starts_covered));
            }
        }
    }
    breaks
}

//! How many triangles cover the places beside an edge.
//!
//! A line cast to the right meets all edges that matter (where that would run along the edge, a line cast upwards). That is done once per connected outline; from there coverings are
//! counted on along the edges and from edge to edge, except where rounding decides how edges lie.

use glam::{DVec2, DVec3};

use super::project::{self, Chain, NO_VERTEX, Span};
use super::sweep::{self, Break, Strand};

/// Two edges within rounding of each other must also run within this angle (radians) to be the same line; beyond it they cross.
const PARALLEL: f64 = 1e-6;

/// Lines are cast to the right unless a direction runs along them as nearly as this (slope); then upwards. Larger would do without the
/// strips more often, smaller would leave less between what runs along an edge and what crosses it.
const FLAT: f64 = 1.0 / 64.0;

/// Edges per strip, were they points. More makes queries dearer, fewer makes sorting into strips dearer.
const PER_STRIP: usize = 16;

/// Strips at most: with 64 a strip is narrower than most edges of a soup of a thousand.
const MAX_STRIPS: usize = 64;

/// A chain edge that cast lines may cross.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crosser {
    low: DVec2,
    high: DVec2,
    /// As in [`Chain`].
    line: DVec3,
    /// As in [`Chain`].
    coefficient: i32,
    /// +1 where places on its left have it ahead, for lines cast upwards and to the right.
    turns: [i8; 2],
}

impl Crosser {
    pub(super) fn new(edge: &Chain) -> Self {
        let [a, b] = edge.places;
        Self {
            low: a.min(b),
            high: a.max(b),
            line: edge.line,
            coefficient: edge.coefficient,
            turns: [0, 1].map(|across| project::turn(edge.places, across) as i8),
        }
    }
}

/// Edges sorted into horizontal strips, so that lines to the right look at few of them. Memory that evaluations reuse.
#[derive(Debug, Default)]
pub(super) struct Strips {
    low: f64,
    per_unit: f64,
    /// `items[starts[k]..starts[k + 1]]` are the edges of strip k, ascending.
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Strips {
    /// For lines cast from within the rectangle `low..high`.
    pub(super) fn fill(&mut self, crossers: &[Crosser], low: DVec2, high: DVec2) {
        let n_strips = (crossers.len() / PER_STRIP).clamp(1, MAX_STRIPS);
        self.low = low.y;
        self.per_unit = n_strips as f64 / (high.y - low.y);
        self.starts.clear();
        self.starts.resize(n_strips + 1, 0);
        let may_be_crossed = |edge: &Crosser| {
            edge.low.y < edge.high.y
                && edge.high.y >= low.y
                && edge.low.y <= high.y
                && edge.high.x >= low.x
        };
        for edge in crossers.iter().filter(|edge| may_be_crossed(edge)) {
            for strip in self.strip(edge.low.y)..=self.strip(edge.high.y) {
                self.starts[strip] += 1;
            }
        }
        // Counts become ends; filling from behind turns ends into starts.
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        self.items.resize(end as usize, 0);
        for (index, edge) in crossers.iter().enumerate().rev() {
            if may_be_crossed(edge) {
                for strip in self.strip(edge.low.y)..=self.strip(edge.high.y) {
                    self.starts[strip] -= 1;
                    self.items[self.starts[strip] as usize] = index as u32;
                }
            }
        }
    }

    fn strip(&self, y: f64) -> usize {
        // The cast saturates, so coordinates far outside land in the outer strips.
        (((y - self.low) * self.per_unit) as usize).min(self.starts.len() - 2)
    }

    /// Edges that a line to the right from this height may cross.
    fn at(&self, y: f64) -> &[u32] {
        let strip = self.strip(y);
        &self.items[self.starts[strip] as usize..self.starts[strip + 1] as usize]
    }
}

/// All edges, for lines cast from places over the rectangle around the light.
pub(super) struct Casts<'a> {
    /// Per chain edge.
    pub(super) crossers: &'a [Crosser],
    pub(super) strips: &'a Strips,
    pub(super) beside: &'a [Vec<Span>; 2],
    /// Distance up to which rounding decides.
    pub(super) near: f64,
}

/// A line cast from a place, and the direction of another line through that place, beside which coverings are asked for.
struct Line {
    place: DVec2,
    direction: DVec2,
    /// Whether the cast line starts on the right of `direction`.
    right_is_ahead: bool,
    /// An edge that runs along `direction` by definition.
    own: Option<usize>,
    near: f64,
}

/// What [`Casts::winding`] finds.
pub(super) struct Winding {
    /// Triangles that cover the place beside on the right.
    pub(super) right: i32,
    /// Coverings more on the left of the line than on its right, from the edges that run along it.
    pub(super) across: i32,
    /// The first edge that runs along the line at the place.
    pub(super) first: Option<usize>,
}

impl Winding {
    /// Adds what an edge says that the cast line crosses, or that runs through its start.
    fn add<const ACROSS: usize>(&mut self, edge: &Crosser, index: usize, line: &Line) {
        let turn = i32::from(edge.turns[ACROSS]);
        let coverings = turn * edge.coefficient;
        let side = f64::from(turn) * sweep::side(edge.line, line.place);
        let is_own = line.own == Some(index);
        if side > line.near && !is_own {
            self.right += coverings;
            return;
        }
        let direction = f64::from(turn) * DVec2::new(edge.line.y, -edge.line.x);
        let is_parallel =
            || direction.perp_dot(line.direction).abs() <= PARALLEL * line.direction.length();
        if is_own || (side.abs() <= line.near && is_parallel()) {
            let same_way = direction.dot(line.direction) > 0.0;
            self.across += if same_way { coverings } else { -coverings };
            self.first = Some(self.first.map_or(index, |first| first.min(index)));
            if !line.right_is_ahead {
                self.right += coverings;
            }
        } else if side > 0.0 {
            self.right += coverings;
        }
    }

    /// Triangles that cover the place beside on the left.
    pub(super) fn left(&self) -> i32 {
        self.right + self.across
    }
}

impl Casts<'_> {
    /// How many triangles cover the places just beside `place` on either side of a line along `direction` through it.
    ///
    /// Edges that run along the line through `place` within rounding are told apart from those that the cast line crosses, so that it does
    /// not matter on which side rounding puts them; `own` is one that does so by definition.
    pub(super) fn winding(&self, place: DVec2, direction: DVec2, own: Option<usize>) -> Winding {
        let line = |right_is_ahead| Line {
            place,
            direction,
            right_is_ahead,
            own,
            near: self.near,
        };
        if direction.y.abs() >= FLAT * direction.x.abs() {
            let edges = self.strips.at(place.y).iter().map(|item| *item as usize);
            self.cast::<1>(&line(direction.y > 0.0), edges)
        } else {
            self.cast::<0>(&line(direction.x <= 0.0), 0..self.crossers.len())
        }
    }

    /// Casts a line to the right (`ACROSS` = 1) or upwards (0); `edges` are those that it may cross, ascending.
    fn cast<const ACROSS: usize>(
        &self,
        line: &Line,
        edges: impl Iterator<Item = usize>,
    ) -> Winding {
        let mut winding = Winding {
            right: 0,
            across: 0,
            first: None,
        };
        let (across, along) = (line.place[ACROSS], line.place[1 - ACROSS] - self.near);
        for span in &self.beside[ACROSS] {
            let is_crossed = span.low <= across && across < span.high;
            winding.right += span.coefficient * i32::from(is_crossed);
        }
        for index in edges {
            let edge = &self.crossers[index];
            let may_cross = (edge.low[ACROSS] <= across)
                & (across < edge.high[ACROSS])
                & (along <= edge.high[1 - ACROSS]);
            if may_cross {
                winding.add::<ACROSS>(edge, index, line);
            }
        }
        winding
    }
}

/// Strands at the vertices, and how many edges meet there in all.
pub(super) struct Joints<'a> {
    pub(super) degrees: &'a [u32],
    /// Per vertex the strands that end there, as many as two.
    pub(super) strands: &'a mut Vec<[u32; 2]>,
    /// Strands of the outline at hand.
    pub(super) outline: &'a mut Vec<u32>,
}

const NONE: u32 = u32::MAX;

/// Finds out the coverings beside all strands where rounding does not decide; others are marked.
pub(super) fn follow(
    strands: &mut [Strand],
    (starts, breaks): (&[u32], &[Break]),
    casts: &Casts<'_>,
    joints: &mut Joints<'_>,
) {
    joints.strands.clear();
    joints.strands.resize(joints.degrees.len(), [NONE; 2]);
    for (index, strand) in (0..).zip(&*strands) {
        for vertex in strand.vertices.into_iter().filter(|v| *v != NO_VERTEX) {
            let at_vertex = &mut joints.strands[vertex as usize];
            at_vertex[usize::from(at_vertex[0] != NONE)] = index;
        }
    }
    let mut walk = Walk {
        strands,
        starts,
        breaks,
        casts,
    };
    for index in 0..walk.strands.len() {
        let strand = &walk.strands[index];
        if !strand.is_delicate && strand.right.is_none() {
            walk.outline(index as u32, joints);
        }
    }
}

/// Strands on which coverings are counted.
struct Walk<'a> {
    strands: &'a mut [Strand],
    starts: &'a [u32],
    breaks: &'a [Break],
    casts: &'a Casts<'a>,
}

impl Walk<'_> {
    fn breaks(&self, index: u32) -> &[Break] {
        let index = index as usize;
        &self.breaks[self.starts[index] as usize..self.starts[index + 1] as usize]
    }

    /// Counts coverings along the outline that a strand belongs to. When they do not add up, all its strands are marked.
    fn outline(&mut self, first: u32, joints: &mut Joints<'_>) {
        let Some(right) = self.look_up(first) else {
            self.strands[first as usize].is_delicate = true;
            return;
        };
        self.strands[first as usize].right = Some(right);
        joints.outline.clear();
        joints.outline.push(first);
        let (mut is_right, mut is_open, mut n_crossings) = (true, false, 0);
        let mut next = 0;
        while let Some(&index) = joints.outline.get(next) {
            next += 1;
            n_crossings += self.breaks(index).len();
            is_right &= self.is_never_negative(index);
            for end in 0..2 {
                match self.continuation(index, end, joints) {
                    Some((other, right)) => match self.strands[other as usize].right {
                        Some(known) => is_right &= known == right,
                        None => {
                            self.strands[other as usize].right = Some(right);
                            joints.outline.push(other);
                        }
                    },
                    None => is_open = true,
                }
            }
        }
        // A closed outline was checked where it closed.
        if let [_, .., last] = joints.outline[..]
            && is_open
            && n_crossings > 0
        {
            is_right &= self.look_up(last) == self.strands[last as usize].right;
        }
        if !is_right {
            for &index in &*joints.outline {
                self.strands[index as usize].is_delicate = true;
            }
        }
    }

    /// The coverings on the right of a strand where it starts, from a cast line in its longest interval; `None` when other edges run along
    /// it there.
    fn look_up(&self, index: u32) -> Option<i32> {
        let strand = &self.strands[index as usize];
        let (middle, steps) = sweep::longest_interval(self.breaks(index));
        let [p, q] = strand.places;
        let chain = strand.chain as usize;
        let winding = self.casts.winding(p + middle * (q - p), q - p, Some(chain));
        (winding.first == Some(chain) && winding.across == strand.coefficient)
            .then_some(winding.right - steps)
    }

    fn is_never_negative(&self, index: u32) -> bool {
        let strand = &self.strands[index as usize];
        let mut right = strand.right.unwrap_or_default();
        let mut least = right;
        for cut in self.breaks(index) {
            right += cut.step;
            least = least.min(right);
        }
        least.min(least + strand.coefficient) >= 0
    }

    /// The strand that goes on where this one ends, and the coverings on its right where it starts.
    fn continuation(&self, index: u32, end: usize, joints: &Joints<'_>) -> Option<(u32, i32)> {
        let strand = &self.strands[index as usize];
        let vertex = strand.vertices[end];
        if vertex == NO_VERTEX || joints.degrees[vertex as usize] != 2 {
            return None;
        }
        let [a, b] = joints.strands[vertex as usize];
        let other = if a == index { b } else { a };
        let next = self.strands.get(other as usize)?;
        if next.is_delicate {
            return None;
        }
        let sum = |index: u32| -> i32 { self.breaks(index).iter().map(|cut| cut.step).sum() };
        let mut right = strand.right?;
        if end == 1 {
            right += sum(index);
        }
        // Where both lead to the vertex or both away, the right of this one is the left of the other.
        let same_way = next.vertices[end] != vertex;
        if next.coefficient
            != if same_way {
                strand.coefficient
            } else {
                -strand.coefficient
            }
        {
            return None;
        }
        if !same_way {
            right -= next.coefficient;
        }
        if next.vertices[1] == vertex {
            right -= sum(other);
        }
        Some((other, right))
    }
}

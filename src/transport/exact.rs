//! The visible part of a light, exactly: the outlines of the occluders, clipped against the light and against each other.
//!
//! Seen from the receiver every occluding triangle covers a triangle of the light's plane. Wound counter-clockwise there, the triangles
//! add up to a *winding number*: how many of them cover a direction. Sides shared by two triangles that cover the same side cancel, so
//! what is left are the silhouette edges, each with a coefficient. The contour of the visible part consists of the pieces of those edges
//! that have winding number 0 on one side, and of the pieces of the light's own border with winding number 0. Nothing has to be a valid
//! solid: soups, open meshes and overlaps are right as they are, and an error in one winding number changes one piece only.
//!
//! Every piece keeps its two end points *on the 3D edge that generates it*, which is what the derivative needs.
//!
//! Work in the plane of the light is done in coordinates whose unit is the size of the light and whose origin is its centre. Occluder
//! vertices are homogeneous there, `(X, Y, W)` with W the depth over the depth of the light, so that edges that reach behind the receiver
//! need no special case: side tests are 3×3 determinants of unprojected vertices.
//!
//! Source: the light contour of C. Vedel, "Computing Illumination from Area Light Sources by Approximate Contour Integration", Graphics
//! Interface 1993, found by clipping instead of by rays.

use glam::{DVec2, DVec3};

use super::contour::Piece;
use super::frame::{self, Frame};
use super::outline::{Facet, Outline, Side};

/// Smallest depth of an occluder that is taken into account, relative to the depth of the light.
///
/// Larger, and a triangle that touches the receiver loses a visible strip. Smaller, and coordinates near the receiver's own plane grow
/// until f64 cannot tell them apart: at 1e-9 they reach 1e9 light sizes, which leaves seven digits.
const NEAREST: f64 = 1e-9;

/// Two edges within rounding of each other must also run within this angle (radians) to be the same line; beyond it they cross.
const PARALLEL: f64 = 1e-6;

/// Up to so many edges are not sorted into strips: that costs about as much as looking at 48 edges 48 times.
const FEW: usize = 48;

/// Strips along each axis. More make queries cheaper and sorting dearer; with 64 a strip is narrower than most edges of a soup of 500.
const N_STRIPS: usize = 64;

/// A straight edge of the covered region's boundary, covered side on its left where `coefficient` is positive.
#[derive(Clone, Copy, Debug)]
pub(super) struct Chain {
    /// Ends relative to the receiver, world axes, cut to the depths between receiver and light.
    ends: [DVec3; 2],
    /// The same in homogeneous coordinates.
    images: [DVec3; 2],
    /// The same in the plane; far outside the light for ends near the receiver's depth.
    places: [DVec2; 2],
    /// Welded vertices at the ends; edges that share one do not cross there.
    vertices: [u32; 2],
    /// `line · (X, Y, 1)` is the distance from the edge's line, positive on the left.
    pub(super) line: DVec3,
    /// How many coverings more the left side has than the right side; not 0.
    coefficient: i32,
}

/// The part of a chain edge over the bounding rectangle of the light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inside {
    /// Index in the chain.
    pub(super) chain: usize,
    pub(super) ends: [DVec3; 2],
    pub(super) depths: [f64; 2],
    pub(super) places: [DVec2; 2],
}

impl Inside {
    /// Point on the 3D edge that is seen at parameter `t` of the edge's image.
    pub(super) fn point(&self, t: f64) -> DVec3 {
        let [near, far] = self.depths;
        let tau = t * near / ((1.0 - t) * far + t * near);
        self.ends[0] + tau * (self.ends[1] - self.ends[0])
    }
}

/// Contour of the part of a light that `receiver` sees.
///
/// - `receiver`: world metres.
/// - `borders`: the light's contours above the horizon, relative to the receiver.
/// - `away`: unit normal of the light's plane, pointing away from the receiver.
/// - `outline`: everything that may stand in between.
///
/// Appends to `pieces`, in no particular order; nothing when the light is hidden, or seen edge-on within rounding. Returns by how many
/// metres rounding may have moved them.
pub(super) fn visible_contour(
    receiver: DVec3,
    borders: &[Piece],
    away: DVec3,
    outline: &Outline,
    pieces: &mut Vec<Piece>,
) -> f64 {
    let rounding = frame::rounding(receiver, borders);
    let Some(frame) = Frame::new(borders, away, rounding) else {
        return rounding;
    };
    let chain = chain_edges(receiver, &frame, outline);
    let view = View::new(borders, &frame, chain, rounding * frame.right.length());
    view.occluder_pieces(pieces);
    view.border_pieces(borders, pieces);
    rounding
}

/// Bound on the error of the light vector per unit radiance, steradians, when every piece may be off by `shift` metres: each then sweeps
/// its angle times that distance as seen from the receiver.
pub(super) fn rounding(pieces: &[Piece], shift: f64) -> f64 {
    pieces
        .iter()
        .map(|piece| {
            let nearest = piece.a.length().min(piece.b.length()).max(shift);
            piece.a.angle_between(piece.b) * shift / nearest
        })
        .sum()
}

/// All edges with a coefficient, cut to the depths between receiver and light.
fn chain_edges(receiver: DVec3, frame: &Frame, outline: &Outline) -> Vec<Chain> {
    let images: Vec<DVec3> = outline
        .vertices
        .iter()
        .map(|&vertex| frame.project(vertex - receiver))
        .collect();
    let mut coefficients: Vec<i32> = outline.edges.iter().map(|edge| edge.fixed).collect();
    let mut chain = Vec::new();
    for triangle in &outline.varying {
        let turn = -triangle.facing(receiver);
        for &Side { edge, direction } in &triangle.sides {
            coefficients[edge as usize] += turn * direction;
        }
    }
    for (edge, &coefficient) in outline.edges.iter().zip(&coefficients) {
        if coefficient == 0 {
            continue;
        }
        let [a, b] = edge.ends.map(|end| end as usize);
        let range = depth_range(images[a].z, images[b].z);
        let relative = [
            outline.vertices[a] - receiver,
            outline.vertices[b] - receiver,
        ];
        if let Some(range) = range {
            chain.extend(Chain::new(
                relative,
                [images[a], images[b]],
                range,
                edge.welded,
                coefficient,
            ));
        }
    }
    for triangle in &outline.crossing {
        let turn = -triangle.facing(receiver);
        if turn != 0 {
            cut(
                receiver, triangle, turn, outline, &images, NEAREST, 1.0, &mut chain,
            );
            cut(
                receiver, triangle, turn, outline, &images, 1.0, -1.0, &mut chain,
            );
        }
    }
    chain
}

/// Parameters of the part of an edge between the nearest depth and the light, from the depths of its ends.
pub(super) fn depth_range(a: f64, b: f64) -> Option<[f64; 2]> {
    let mut range = [0.0, 1.0];
    // Distances into the two half-spaces.
    for [inside_a, inside_b] in [[a - NEAREST, b - NEAREST], [1.0 - a, 1.0 - b]] {
        clip_range(&mut range, inside_a, inside_b);
    }
    (range[0] < range[1]).then_some(range)
}

/// The point at parameter `t` of a segment; its ends stay as they are to the bit, so that neighbours go on meeting there.
fn between([a, b]: [DVec3; 2], t: f64) -> DVec3 {
    if t <= 0.0 {
        a
    } else if t >= 1.0 {
        b
    } else {
        a + t * (b - a)
    }
}

/// Narrows the parameters of a segment to where a linear function with these end values is not negative.
fn clip_range(range: &mut [f64; 2], at_start: f64, at_end: f64) {
    if at_start < 0.0 && at_end < 0.0 {
        *range = [1.0, 0.0];
    } else if at_start < 0.0 {
        range[0] = range[0].max(at_start / (at_start - at_end));
    } else if at_end < 0.0 {
        range[1] = range[1].min(at_start / (at_start - at_end));
    }
}

/// Adds the edge along which a triangle is cut by the plane of depth `depth`; what lies on the side of `sign` is kept.
#[expect(
    clippy::too_many_arguments,
    reason = "one caller, which has all of them at hand"
)]
fn cut(
    receiver: DVec3,
    triangle: &Facet,
    turn: i32,
    outline: &Outline,
    images: &[DVec3],
    depth: f64,
    sign: f64,
    chain: &mut Vec<Chain>,
) {
    let mut ends = [None; 2];
    for &Side { edge, direction } in &triangle.sides {
        // Always from the edge's first vertex, so that both neighbours get the same point.
        let [a, b] = outline.edges[edge as usize].ends.map(|end| end as usize);
        let inside = [a, b].map(|vertex| sign * (images[vertex].z - depth));
        if (inside[0] < 0.0) == (inside[1] < 0.0) {
            continue;
        }
        let tau = inside[0] / (inside[0] - inside[1]);
        let relative = [a, b].map(|vertex| outline.vertices[vertex] - receiver);
        let point = (
            relative[0] + tau * (relative[1] - relative[0]),
            images[a] + tau * (images[b] - images[a]),
        );
        // In the direction of the covered triangle the edge leaves the kept side, or enters it.
        let leaves = (inside[0] < 0.0) != (turn * direction > 0);
        ends[usize::from(!leaves)] = Some(point);
    }
    if let [Some(from), Some(to)] = ends {
        chain.extend(Chain::new(
            [from.0, to.0],
            [from.1, to.1],
            [0.0, 1.0],
            [u32::MAX; 2],
            1,
        ));
    }
}

impl Chain {
    /// `None` when its image is a point, which bounds nothing.
    pub(super) fn new(
        ends: [DVec3; 2],
        images: [DVec3; 2],
        range: [f64; 2],
        vertices: [u32; 2],
        coefficient: i32,
    ) -> Option<Self> {
        let cut_ends = range.map(|t| between(ends, t));
        let cut_images = range.map(|t| between(images, t));
        let places = cut_images.map(|image| image.truncate() / image.z);
        // Not a × b, which would lose the digits that the ends of a short edge have in common.
        let line = images[0].cross(images[1] - images[0]);
        let length = line.truncate().length();
        (places[0] != places[1] && length > 0.0).then(|| Self {
            ends: cut_ends,
            images: cut_images,
            places,
            vertices,
            line: line / length,
            coefficient,
        })
    }

    /// Distance from the edge's line, positive on the left.
    fn side(&self, place: DVec2) -> f64 {
        self.line.x * place.x + self.line.y * place.y + self.line.z
    }
}

/// The light's plane with all chain edges, ready for queries.
struct View {
    chain: Vec<Chain>,
    inside: Vec<Inside>,
    /// The light's border in the plane.
    border: Vec<[DVec2; 2]>,
    /// For lines cast upwards and to the right.
    casts: [Cast; 2],
    /// Distance below which two places are the same within rounding.
    rounding: f64,
}

impl View {
    fn new(borders: &[Piece], frame: &Frame, chain: Vec<Chain>, rounding: f64) -> Self {
        let border: Vec<[DVec2; 2]> = borders
            .iter()
            .map(|border| [frame.place(border.a), frame.place(border.b)])
            .collect();
        let margin = DVec2::splat(4.0 * rounding);
        let low = border
            .iter()
            .flatten()
            .fold(DVec2::INFINITY, |low, p| low.min(*p))
            - margin;
        let high = border
            .iter()
            .flatten()
            .fold(DVec2::NEG_INFINITY, |high, p| high.max(*p))
            + margin;
        let inside = chain
            .iter()
            .enumerate()
            .filter_map(|(index, edge)| clip_to_rectangle(index, edge, low, high))
            .collect();
        let casts = [1, 0].map(|across| Cast::new(&chain, across, low, high, 4.0 * rounding));
        Self {
            chain,
            inside,
            border,
            casts,
            rounding,
        }
    }

    /// Pieces of occluder edges: inside the light, with nothing covering one side.
    fn occluder_pieces(&self, pieces: &mut Vec<Piece>) {
        let mut breaks = self.breaks_by_crossings();
        breaks.sort_unstable_by_key(|(index, _)| *index);
        let mut own = Vec::new();
        let mut rest = &breaks[..];
        for (index, inside) in self.inside.iter().enumerate() {
            let (mine, others) = rest.split_at(rest.partition_point(|b| b.0 as usize <= index));
            rest = others;
            own.clear();
            own.extend([0.0, 1.0]);
            own.extend(mine.iter().map(|(_, t)| *t));
            self.breaks_by_border(inside, &mut own);
            for_each_interval(&mut own, |start, end| {
                let [p, q] = inside.places;
                let middle = p + 0.5 * (start + end) * (q - p);
                if let Some(visible_left) = self.visible_side(inside.chain, middle) {
                    let (from, to) = if visible_left {
                        (start, end)
                    } else {
                        (end, start)
                    };
                    pieces.push(Piece {
                        a: inside.point(from),
                        b: inside.point(to),
                        horizon: false,
                    });
                }
            });
        }
    }

    /// Pieces of the light's own border that nothing covers.
    fn border_pieces(&self, borders: &[Piece], pieces: &mut Vec<Piece>) {
        let mut breaks = Vec::new();
        for (border, &[p, q]) in borders.iter().zip(&self.border) {
            if p == q {
                continue;
            }
            breaks.clear();
            breaks.extend([0.0, 1.0]);
            for inside in &self.inside {
                let at_border = [p, q].map(|place| self.chain[inside.chain].side(place));
                if self.is_near(at_border) {
                    overlap([p, q], inside.places, |t| breaks.push(t));
                } else if differ(at_border) && differ(self.across([p, q], inside)) {
                    breaks.push(zero_of(at_border));
                }
            }
            for_each_interval(&mut breaks, |start, end| {
                let middle = p + 0.5 * (start + end) * (q - p);
                // Just inside the light is on the left.
                if self.winding(middle, q - p, None).left() == 0 {
                    let at = |t: f64| border.a + t * (border.b - border.a);
                    pieces.push(Piece {
                        a: at(start),
                        b: at(end),
                        horizon: border.horizon,
                    });
                }
            });
        }
    }

    /// Inside edges and parameters at which they meet others; pairs are found by sweeping along x.
    fn breaks_by_crossings(&self) -> Vec<(u32, f64)> {
        let mut breaks = Vec::new();
        let bounds: Vec<[DVec2; 2]> = self
            .inside
            .iter()
            .map(|inside| {
                let [p, q] = inside.places;
                [p.min(q) - self.rounding, p.max(q) + self.rounding]
            })
            .collect();
        let mut order: Vec<usize> = (0..bounds.len()).collect();
        order.sort_unstable_by(|&a, &b| bounds[a][0].x.total_cmp(&bounds[b][0].x).then(a.cmp(&b)));
        for (rank, &a) in order.iter().enumerate() {
            let [low, high] = bounds[a];
            for &b in &order[rank + 1..] {
                let [other_low, other_high] = bounds[b];
                if other_low.x > high.x {
                    break;
                }
                if other_low.y <= high.y && low.y <= other_high.y {
                    self.cross(a, b, &mut breaks);
                }
            }
        }
        breaks
    }

    /// Adds the crossing of two inside edges to both.
    fn cross(&self, a: usize, b: usize, breaks: &mut Vec<(u32, f64)>) {
        let (first, second) = (&self.inside[a], &self.inside[b]);
        let (edge, other) = (&self.chain[first.chain], &self.chain[second.chain]);
        let at_first = first.places.map(|place| other.side(place));
        let at_second = second.places.map(|place| edge.side(place));
        if self.is_near(at_first) || self.is_near(at_second) {
            overlap(first.places, second.places, |t| breaks.push((a as u32, t)));
            overlap(second.places, first.places, |t| breaks.push((b as u32, t)));
            return;
        }
        // Edges that share a vertex do not cross anywhere else.
        let shared = |vertex: &u32| *vertex != u32::MAX && other.vertices.contains(vertex);
        if differ(at_first) && differ(at_second) && !edge.vertices.iter().any(shared) {
            breaks.push((a as u32, zero_of(at_first)));
            breaks.push((b as u32, zero_of(at_second)));
        }
    }

    /// Whether a segment whose ends have these distances from a line runs along it within rounding.
    fn is_near(&self, distances: [f64; 2]) -> bool {
        distances
            .iter()
            .all(|distance| distance.abs() <= 4.0 * self.rounding)
    }

    /// Adds the places where an inside edge meets the light's border.
    fn breaks_by_border(&self, inside: &Inside, breaks: &mut Vec<f64>) {
        let edge = &self.chain[inside.chain];
        for &side in &self.border {
            let at_border = side.map(|place| edge.side(place));
            if self.is_near(at_border) {
                overlap(inside.places, side, |t| breaks.push(t));
                continue;
            }
            if differ(at_border) && differ(self.across(side, inside)) {
                let along = side[1] - side[0];
                let t = zero_of(inside.places.map(|place| along.perp_dot(place - side[0])));
                if 0.0 < t && t < 1.0 {
                    breaks.push(t);
                }
            }
        }
    }

    /// On which sides of a side of the border the ends of an edge lie, before it was cut to the light's rectangle: the cut lies on the
    /// border itself, where rounding would decide.
    fn across(&self, [from, to]: [DVec2; 2], inside: &Inside) -> [f64; 2] {
        let along = to - from;
        self.chain[inside.chain]
            .images
            .map(|image| along.perp_dot(image.truncate() - image.z * from))
    }

    /// Whether the edge bounds the visible region at `middle`, and if so, whether that lies on its left.
    fn visible_side(&self, index: usize, middle: DVec2) -> Option<bool> {
        if !self.is_inside_light(middle) {
            return None;
        }
        let edge = &self.chain[index];
        let winding = self.winding(middle, edge.places[1] - edge.places[0], Some(index));
        // Of several edges on the same line the first speaks for all.
        if winding.first != Some(index) {
            return None;
        }
        match (winding.left(), winding.right) {
            (0, right) if right != 0 => Some(true),
            (left, 0) if left != 0 => Some(false),
            _ => None,
        }
    }

    /// Whether a place lies inside the light and not on its border within rounding.
    fn is_inside_light(&self, place: DVec2) -> bool {
        let mut winding = 0;
        for &[a, b] in &self.border {
            let along = b - a;
            let length = along.length();
            let across = along.perp_dot(place - a);
            let t = along.dot(place - a);
            if across.abs() <= 4.0 * self.rounding * length && 0.0 <= t && t <= length * length {
                return false;
            }
            if (a.y <= place.y) != (b.y <= place.y) && (across > 0.0) == (b.y > a.y) {
                winding += if b.y > a.y { 1 } else { -1 };
            }
        }
        winding > 0
    }

    /// How many triangles cover the places just beside `place` on either side of a line along `direction` through it.
    ///
    /// Casts a line to the right or upwards, whichever is farther from `direction`. Edges that run along the line through `place` within
    /// rounding are told apart from those that the cast line crosses, so that it does not matter on which side rounding puts them; `own`
    /// is one that does so by definition.
    fn winding(&self, place: DVec2, direction: DVec2, own: Option<usize>) -> Winding {
        let to_the_right = direction.y.abs() >= direction.x.abs();
        // Whether the right of `direction` is the side from which the cast line starts away from `place`.
        let (cast, right_is_ahead) = if to_the_right {
            (&self.casts[0], direction.y > 0.0)
        } else {
            (&self.casts[1], direction.x <= 0.0)
        };
        let mut winding = Winding {
            right: 0,
            across: 0,
            first: None,
        };
        for crosser in cast.near(place) {
            let side = crosser.side(place);
            if side > 4.0 * self.rounding && own != Some(crosser.index as usize) {
                winding.right += crosser.coefficient;
                continue;
            }
            let index = crosser.index as usize;
            if own == Some(index) || self.runs_along(crosser, side, direction) {
                winding.across += if crosser.direction().dot(direction) > 0.0 {
                    crosser.coefficient
                } else {
                    -crosser.coefficient
                };
                winding.first = Some(winding.first.map_or(index, |first| first.min(index)));
                if !right_is_ahead {
                    winding.right += crosser.coefficient;
                }
            } else if side > 0.0 {
                winding.right += crosser.coefficient;
            }
        }
        winding
    }

    /// Whether an edge at the distance `side` from a place runs along `direction` there.
    fn runs_along(&self, crosser: &Crosser, side: f64, direction: DVec2) -> bool {
        side.abs() <= 4.0 * self.rounding
            && crosser.direction().perp_dot(direction).abs() <= PARALLEL * direction.length()
    }
}

/// What [`View::winding`] finds.
struct Winding {
    /// Triangles that cover the place beside on the right.
    right: i32,
    /// Coverings more on the left of the line than on its right, from the edges that run along it.
    across: i32,
    /// The first edge that runs along the line at the place.
    first: Option<usize>,
}

impl Winding {
    /// Triangles that cover the place beside on the left.
    fn left(&self) -> i32 {
        self.right + self.across
    }
}

/// Calls `visit` for each interval between consecutive breaks in 0..1 that has length.
fn for_each_interval(breaks: &mut [f64], mut visit: impl FnMut(f64, f64)) {
    breaks.sort_unstable_by(f64::total_cmp);
    for pair in breaks.windows(2) {
        if pair[0] < pair[1] {
            visit(pair[0], pair[1]);
        }
    }
}

/// Whether places with these distances lie on different sides of a line. Places on the line count as left of it, so that of two edges
/// that meet on it just one crosses.
pub(super) fn differ([a, b]: [f64; 2]) -> bool {
    (a >= 0.0) != (b >= 0.0)
}

/// The parameter at which a linear function with these end values is zero.
pub(super) fn zero_of([a, b]: [f64; 2]) -> f64 {
    a / (a - b)
}

/// Reports the ends of a segment that runs along p → q, as parameters of p → q.
fn overlap([p, q]: [DVec2; 2], other: [DVec2; 2], mut add: impl FnMut(f64)) {
    let along = q - p;
    for place in other {
        let t = along.dot(place - p) / along.length_squared();
        if 0.0 < t && t < 1.0 {
            add(t);
        }
    }
}

/// The part of an edge over the rectangle `low..high`; clipped in homogeneous coordinates, so that far ends cost no digits.
pub(super) fn clip_to_rectangle(
    index: usize,
    edge: &Chain,
    low: DVec2,
    high: DVec2,
) -> Option<Inside> {
    let [a, b] = edge.images;
    let mut range = [0.0, 1.0];
    for axis in 0..2 {
        clip_range(
            &mut range,
            a[axis] - low[axis] * a.z,
            b[axis] - low[axis] * b.z,
        );
        clip_range(
            &mut range,
            high[axis] * a.z - a[axis],
            high[axis] * b.z - b[axis],
        );
    }
    if range[0] >= range[1] {
        return None;
    }
    let images = range.map(|t| between(edge.images, t));
    let places = images.map(|image| image.truncate() / image.z);
    (places[0] != places[1]).then(|| Inside {
        chain: index,
        ends: range.map(|t| between(edge.ends, t)),
        depths: images.map(|image| image.z),
        places,
    })
}

/// A chain edge that cast lines may cross, turned so that places on its left have it ahead.
#[derive(Clone, Copy, Debug)]
struct Crosser {
    /// It spans these coordinates across the cast line, the first included, the second not.
    low: f64,
    high: f64,
    /// Largest coordinate along the cast line, with some slack.
    reach: f64,
    /// As in [`Chain`].
    line: DVec3,
    /// As in [`Chain`].
    coefficient: i32,
    /// Index in the chain.
    index: u32,
}

impl Crosser {
    fn side(&self, place: DVec2) -> f64 {
        self.line.x * place.x + self.line.y * place.y + self.line.z
    }

    fn direction(&self) -> DVec2 {
        DVec2::new(self.line.y, -self.line.x)
    }
}

/// Chain edges sorted by the strips that they cross, for lines cast in one direction.
struct Cast {
    /// Axis across the cast lines: 1 for lines to the right, 0 for lines upwards.
    across: usize,
    low: f64,
    per_unit: f64,
    crossers: Vec<Crosser>,
    /// `items[starts[k]..starts[k + 1]]` are the crossers of strip k.
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Cast {
    /// `low` and `high`: corners of the rectangle in which cast lines start. `slack`: how far behind its start a cast line still meets an
    /// edge, so that one that runs through the start is never overlooked.
    fn new(chain: &[Chain], across: usize, low: DVec2, high: DVec2, slack: f64) -> Self {
        let n_strips = if chain.len() <= FEW { 1 } else { N_STRIPS };
        let mut cast = Self {
            across,
            low: low[across],
            per_unit: n_strips as f64 / (high[across] - low[across]),
            crossers: Vec::with_capacity(chain.len()),
            starts: vec![0; n_strips + 1],
            items: Vec::new(),
        };
        for (index, edge) in chain.iter().enumerate() {
            let crosser = crosser(index, edge, across, slack);
            if crosser.low < crosser.high
                && crosser.high >= low[across]
                && crosser.low <= high[across]
                && crosser.reach >= low[1 - across]
            {
                for strip in cast.strips(&crosser) {
                    cast.starts[strip] += 1;
                }
                cast.crossers.push(crosser);
            }
        }
        // Counts become ends; filling from behind turns ends into starts.
        let mut end = 0;
        for start in &mut cast.starts {
            end += *start;
            *start = end;
        }
        cast.items = vec![0; end as usize];
        for index in (0..cast.crossers.len()).rev() {
            for strip in cast.strips(&cast.crossers[index]) {
                cast.starts[strip] -= 1;
                cast.items[cast.starts[strip] as usize] = index as u32;
            }
        }
        cast
    }

    fn strips(&self, crosser: &Crosser) -> std::ops::RangeInclusive<usize> {
        self.strip(crosser.low)..=self.strip(crosser.high)
    }

    fn strip(&self, coordinate: f64) -> usize {
        // The cast saturates, so coordinates far outside land in the outer strips.
        (((coordinate - self.low) * self.per_unit) as usize).min(self.starts.len() - 2)
    }

    /// Edges that a line cast from `place` may cross, or that run through it.
    fn near(&self, place: DVec2) -> impl Iterator<Item = &Crosser> {
        let (across, along) = (place[self.across], place[1 - self.across]);
        let strip = self.strip(across);
        self.items[self.starts[strip] as usize..self.starts[strip + 1] as usize]
            .iter()
            .map(|item| &self.crossers[*item as usize])
            .filter(move |crosser| {
                crosser.low <= across && across < crosser.high && along <= crosser.reach
            })
    }
}

/// The edge turned upwards for lines cast to the right, leftwards for lines cast upwards.
fn crosser(index: usize, edge: &Chain, across: usize, slack: f64) -> Crosser {
    let [a, b] = edge.places;
    let sign = if (b[across] > a[across]) == (across == 1) {
        1
    } else {
        -1
    };
    Crosser {
        low: a[across].min(b[across]),
        high: a[across].max(b[across]),
        reach: a[1 - across].max(b[1 - across]) + slack,
        line: f64::from(sign) * edge.line,
        coefficient: sign * edge.coefficient,
        index: index as u32,
    }
}

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
use super::outline::{Facet, Outline, Side};

/// Smallest depth of an occluder that is taken into account, relative to the depth of the light.
///
/// Larger, and a triangle that touches the receiver loses a visible strip. Smaller, and coordinates near the receiver's own plane grow
/// until f64 cannot tell them apart: at 1e-9 they reach 1e9 light sizes, which leaves seven digits.
const NEAREST: f64 = 1e-9;

/// Rounding of a position in the plane of the light, in units in the last place of the largest coordinate involved. A position is the
/// result of an affine transform (a few roundings), two subtractions and a projection.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// Two edges within rounding of each other must also run within this angle (radians) to be the same line; beyond it they cross.
const PARALLEL: f64 = 1e-6;

/// Edges beside which a query looks at every edge. Sorting into buckets costs about as much as 48 edges looked at 48 times.
const FEW: usize = 48;

/// Buckets along each axis. More make queries cheaper and building dearer; 64 keeps a few edges per bucket up to some 500 edges.
const N_BUCKETS: usize = 64;

/// The plane of a light in the receiver's eyes.
#[derive(Clone, Copy, Debug)]
struct Frame {
    /// Axes of the plane over the size of the light, the second a quarter turn clockwise from the first as the receiver sees it, so that
    /// contours, which are clockwise, become counter-clockwise; `forward` over the depth of the light.
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    /// Centre of the light relative to the receiver.
    centre: DVec3,
}

impl Frame {
    /// `None` when the receiver lies in the light's plane within rounding: the light is then seen edge-on.
    fn new(borders: &[Piece], away: DVec3, rounding: f64) -> Option<Self> {
        let sum: DVec3 = borders.iter().map(|border| border.a).sum();
        let centre = sum / borders.len() as f64;
        let size = borders
            .iter()
            .map(|border| (border.a - centre).length())
            .fold(0.0, f64::max);
        let depth = centre.dot(away);
        if depth <= rounding || size <= 0.0 {
            return None;
        }
        let (u, v) = away.any_orthonormal_pair();
        let (right, up) = if u.cross(v).dot(away) > 0.0 {
            (u, v)
        } else {
            (v, u)
        };
        Some(Self {
            right: right / size,
            up: up / size,
            forward: away / depth,
            centre,
        })
    }

    /// Homogeneous coordinates of a point relative to the receiver.
    fn project(&self, point: DVec3) -> DVec3 {
        let depth = self.forward.dot(point);
        let offset = point - depth * self.centre;
        DVec3::new(self.right.dot(offset), self.up.dot(offset), depth)
    }
}

/// A straight edge of the covered region's boundary, covered side on its left where `coefficient` is positive.
#[derive(Clone, Copy, Debug)]
struct Chain {
    /// Ends relative to the receiver, world axes, cut to the depths between receiver and light.
    ends: [DVec3; 2],
    /// The same in homogeneous coordinates.
    images: [DVec3; 2],
    /// The same in the plane; far outside the light for ends near the receiver's depth.
    places: [DVec2; 2],
    /// Welded vertices at the ends; edges that share one do not cross there.
    vertices: [u32; 2],
    /// `line · (X, Y, 1) > 0` on the left.
    line: DVec3,
    /// How many coverings more the left side has than the right side; not 0.
    coefficient: i32,
}

/// The part of a chain edge over the bounding rectangle of the light.
#[derive(Clone, Copy, Debug)]
struct Inside {
    /// Index in the chain.
    chain: usize,
    ends: [DVec3; 2],
    depths: [f64; 2],
    places: [DVec2; 2],
}

impl Inside {
    /// Point on the 3D edge that is seen at parameter `t` of the edge's image.
    fn point(&self, t: f64) -> DVec3 {
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
/// Appends to `pieces`, in no particular order; nothing when the light is hidden, or seen edge-on within rounding.
pub(super) fn visible_contour(
    receiver: DVec3,
    borders: &[Piece],
    away: DVec3,
    outline: &Outline,
    pieces: &mut Vec<Piece>,
) {
    if borders.is_empty() {
        return;
    }
    let reach = borders
        .iter()
        .map(|border| border.a.abs().max_element())
        .fold(0.0, f64::max);
    let rounding = ROUNDING * (reach + receiver.abs().max_element());
    let Some(frame) = Frame::new(borders, away, rounding) else {
        return;
    };
    let chain = chain_edges(receiver, &frame, outline);
    let view = View::new(borders, &frame, chain, rounding * frame.right.length());
    view.occluder_pieces(pieces);
    view.border_pieces(borders, pieces);
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
fn depth_range(a: f64, b: f64) -> Option<[f64; 2]> {
    let mut range = [0.0, 1.0];
    // Distances into the two half-spaces.
    for [inside_a, inside_b] in [[a - NEAREST, b - NEAREST], [1.0 - a, 1.0 - b]] {
        clip_range(&mut range, inside_a, inside_b);
    }
    (range[0] < range[1]).then_some(range)
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
    fn new(
        ends: [DVec3; 2],
        images: [DVec3; 2],
        range: [f64; 2],
        vertices: [u32; 2],
        coefficient: i32,
    ) -> Option<Self> {
        let along = |t: f64, [a, b]: [DVec3; 2]| {
            // The ends themselves stay as they are to the bit.
            if t <= 0.0 {
                a
            } else if t >= 1.0 {
                b
            } else {
                a + t * (b - a)
            }
        };
        let cut_ends = range.map(|t| along(t, ends));
        let cut_images = range.map(|t| along(t, images));
        let places = cut_images.map(|image| image.truncate() / image.z);
        // Not a × b, which would lose the digits that the ends of a short edge have in common.
        let line = images[0].cross(images[1] - images[0]);
        (places[0] != places[1] && line != DVec3::ZERO).then_some(Self {
            ends: cut_ends,
            images: cut_images,
            places,
            vertices,
            line,
            coefficient,
        })
    }

    /// Positive on the left.
    fn side(&self, place: DVec2) -> f64 {
        self.line.x * place.x + self.line.y * place.y + self.line.z
    }

    fn distance(&self, place: DVec2) -> f64 {
        self.side(place).abs() / self.line.truncate().length()
    }
}

/// The light's plane with all chain edges, ready for queries.
struct View {
    chain: Vec<Chain>,
    inside: Vec<Inside>,
    /// The light's border in the plane.
    border: Vec<[DVec2; 2]>,
    /// Chain edges by row and by column of the light's bounding rectangle.
    buckets: [Buckets; 2],
    /// Distance below which two places are the same within rounding.
    rounding: f64,
}

impl View {
    fn new(borders: &[Piece], frame: &Frame, chain: Vec<Chain>, rounding: f64) -> Self {
        let place = |point: DVec3| {
            let image = frame.project(point);
            image.truncate() / image.z
        };
        let border: Vec<[DVec2; 2]> = borders
            .iter()
            .map(|border| [place(border.a), place(border.b)])
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
        let buckets = [1, 0].map(|axis| Buckets::new(&chain, axis, low[axis], high[axis]));
        Self {
            chain,
            inside,
            border,
            buckets,
            rounding,
        }
    }

    /// Pieces of occluder edges: inside the light, with nothing covering the right-hand side.
    fn occluder_pieces(&self, pieces: &mut Vec<Piece>) {
        let mut breaks = self.breaks_by_crossings();
        for (inside, breaks) in self.inside.iter().zip(&mut breaks) {
            self.breaks_by_border(inside, breaks);
            for_each_interval(breaks, |start, end| {
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
                let edge = &self.chain[inside.chain];
                crossings(p, q, &inside.places, |place| edge.side(place), &mut breaks);
                self.overlaps(p, q, &inside.places, &mut breaks);
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

    /// Parameters at which each inside edge meets the others; pairs are found by sweeping along x.
    fn breaks_by_crossings(&self) -> Vec<Vec<f64>> {
        let mut breaks = vec![vec![0.0, 1.0]; self.inside.len()];
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
    fn cross(&self, a: usize, b: usize, breaks: &mut [Vec<f64>]) {
        let (first, second) = (&self.inside[a], &self.inside[b]);
        let (edge, other) = (&self.chain[first.chain], &self.chain[second.chain]);
        let [p, q] = first.places;
        let [r, s] = second.places;
        self.overlaps(p, q, &second.places, &mut breaks[a]);
        self.overlaps(r, s, &first.places, &mut breaks[b]);
        // Edges that share a vertex do not cross anywhere else.
        if edge
            .vertices
            .iter()
            .any(|vertex| *vertex != u32::MAX && other.vertices.contains(vertex))
        {
            return;
        }
        crossings(
            p,
            q,
            &second.places,
            |place| other.side(place),
            &mut breaks[a],
        );
        crossings(
            r,
            s,
            &first.places,
            |place| edge.side(place),
            &mut breaks[b],
        );
    }

    /// Adds the ends of an edge that runs along p → q within rounding.
    fn overlaps(&self, p: DVec2, q: DVec2, other: &[DVec2; 2], breaks: &mut Vec<f64>) {
        let along = q - p;
        let length = along.length();
        let far = other
            .iter()
            .map(|place| along.perp_dot(*place - p).abs())
            .fold(0.0, f64::max);
        if far <= 4.0 * self.rounding * length {
            breaks.extend(
                other
                    .iter()
                    .map(|place| along.dot(*place - p) / (length * length))
                    .filter(|t| 0.0 < *t && *t < 1.0),
            );
        }
    }

    /// Adds the places where an inside edge meets the light's border.
    fn breaks_by_border(&self, inside: &Inside, breaks: &mut Vec<f64>) {
        let [p, q] = inside.places;
        let edge = &self.chain[inside.chain];
        for side in &self.border {
            // The border's own line decides on which side p and q lie, the edge's line whether the border reaches it.
            let along = side[1] - side[0];
            let (at_p, at_q) = (along.perp_dot(p - side[0]), along.perp_dot(q - side[0]));
            let reaches = (edge.side(side[0]) >= 0.0) != (edge.side(side[1]) >= 0.0);
            if reaches && (at_p >= 0.0) != (at_q >= 0.0) {
                breaks.push(at_p / (at_p - at_q));
            }
            self.overlaps(p, q, side, breaks);
        }
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
        let horizontal = direction.y.abs() >= direction.x.abs();
        let (buckets, axis) = if horizontal {
            (&self.buckets[0], 1)
        } else {
            (&self.buckets[1], 0)
        };
        // Whether the right of `direction` is the side from which the cast line starts away from `place`.
        let right_is_ahead = if horizontal {
            direction.y > 0.0
        } else {
            direction.x <= 0.0
        };
        let mut winding = Winding {
            right: 0,
            across: 0,
            first: None,
        };
        for &index in buckets.at(place[axis]) {
            let edge = &self.chain[index as usize];
            let [a, b] = edge.places;
            if (a[axis] <= place[axis]) == (b[axis] <= place[axis]) {
                continue;
            }
            if a[1 - axis].max(b[1 - axis]) < place[1 - axis] - 4.0 * self.rounding {
                continue;
            }
            let forward = b[axis] > a[axis];
            // Crossing an edge from its right to its left adds its coefficient. The cast line, followed backwards from infinity, does so
            // for upward edges (cast to the right) and for leftward ones (cast upwards).
            let step = if forward == horizontal {
                edge.coefficient
            } else {
                -edge.coefficient
            };
            if own == Some(index as usize) || self.runs_along(edge, place, direction) {
                // Signed for the direction asked about: coverings more on the left than on the right.
                let same_way = edge.places[1] - edge.places[0];
                winding.across += if same_way.dot(direction) > 0.0 {
                    edge.coefficient
                } else {
                    -edge.coefficient
                };
                winding.first = Some(
                    winding
                        .first
                        .map_or(index as usize, |first| first.min(index as usize)),
                );
                if !right_is_ahead {
                    winding.right += step;
                }
                continue;
            }
            // The edge lies ahead when the place is on its left going up (cast right), on its right going right (cast up).
            let on_left = edge.side(place) > 0.0;
            if on_left == (forward == horizontal) {
                winding.right += step;
            }
        }
        winding
    }

    fn runs_along(&self, edge: &Chain, place: DVec2, direction: DVec2) -> bool {
        let own = edge.line.truncate();
        // `own` is perpendicular to the edge.
        own.dot(direction).abs() <= PARALLEL * own.length() * direction.length()
            && edge.distance(place) <= 4.0 * self.rounding
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

/// Adds the parameter at which p → q crosses the edge between `other`, whose line is `side`.
fn crossings(
    p: DVec2,
    q: DVec2,
    other: &[DVec2; 2],
    side: impl Fn(DVec2) -> f64,
    breaks: &mut Vec<f64>,
) {
    let (at_p, at_q) = (side(p), side(q));
    if (at_p >= 0.0) == (at_q >= 0.0) {
        return;
    }
    let along = q - p;
    let reaches = (along.perp_dot(other[0] - p) >= 0.0) != (along.perp_dot(other[1] - p) >= 0.0);
    if reaches {
        breaks.push(at_p / (at_p - at_q));
    }
}

/// The part of an edge over the rectangle `low..high`; clipped in homogeneous coordinates, so that far ends cost no digits.
fn clip_to_rectangle(index: usize, edge: &Chain, low: DVec2, high: DVec2) -> Option<Inside> {
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
    let at = |t: f64, [from, to]: [DVec3; 2]| from + t * (to - from);
    let images = range.map(|t| at(t, edge.images));
    let places = images.map(|image| image.truncate() / image.z);
    (places[0] != places[1]).then(|| Inside {
        chain: index,
        ends: range.map(|t| at(t, edge.ends)),
        depths: images.map(|image| image.z),
        places,
    })
}

/// Chain edges sorted by the strips they cross.
struct Buckets {
    low: f64,
    per_unit: f64,
    /// `items[starts[k]..starts[k + 1]]` are the edges of strip k.
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Buckets {
    fn new(chain: &[Chain], axis: usize, low: f64, high: f64) -> Self {
        let n_buckets = if chain.len() <= FEW { 1 } else { N_BUCKETS };
        let mut buckets = Self {
            low,
            per_unit: n_buckets as f64 / (high - low),
            starts: vec![0; n_buckets + 1],
            items: Vec::new(),
        };
        let ranges: Vec<Option<[usize; 2]>> = chain
            .iter()
            .map(|edge| {
                let [a, b] = edge.places.map(|place| place[axis]);
                (a.max(b) >= low && a.min(b) <= high)
                    .then(|| [buckets.strip(a.min(b)), buckets.strip(a.max(b))])
            })
            .collect();
        for &[first, last] in ranges.iter().flatten() {
            for strip in first..=last {
                buckets.starts[strip + 1] += 1;
            }
        }
        for strip in 0..n_buckets {
            buckets.starts[strip + 1] += buckets.starts[strip];
        }
        let mut next = buckets.starts.clone();
        buckets.items = vec![0; buckets.starts[n_buckets] as usize];
        for (index, range) in ranges.iter().enumerate() {
            let Some([first, last]) = *range else {
                continue;
            };
            for strip in first..=last {
                buckets.items[next[strip] as usize] = index as u32;
                next[strip] += 1;
            }
        }
        buckets
    }

    fn strip(&self, coordinate: f64) -> usize {
        // The cast saturates, so coordinates far outside land in the outer strips.
        (((coordinate - self.low) * self.per_unit) as usize).min(self.starts.len() - 2)
    }

    fn at(&self, coordinate: f64) -> &[u32] {
        let strip = self.strip(coordinate);
        &self.items[self.starts[strip] as usize..self.starts[strip + 1] as usize]
    }
}

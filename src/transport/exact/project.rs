//! The silhouette edges as one receiver sees them: those that reach before the light in full, the others as far as coverings depend on them.

use glam::{DVec2, DVec3};

use crate::transport::frame::Frame;
use crate::transport::outline::{Facet, Outline, Side};

/// Smallest depth of an occluder that is taken into account, relative to the depth of the light.
///
/// Larger, and a triangle that touches the receiver loses a visible strip. Smaller, and coordinates near the receiver's own plane grow
/// until f64 cannot tell them apart: at 1e-9 they reach 1e9 light sizes, which leaves seven digits.
const NEAREST: f64 = 1e-9;

/// A straight edge of the covered region's boundary, covered side on its left where `coefficient` is positive.
#[derive(Clone, Copy, Debug)]
pub(in crate::transport) struct Chain {
    /// Ends relative to the receiver, world axes, cut to the depths between receiver and light.
    ends: [DVec3; 2],
    /// The same in homogeneous coordinates.
    pub(super) images: [DVec3; 2],
    /// The same in the plane; far outside the light for ends near the receiver's depth.
    pub(super) places: [DVec2; 2],
    /// Vertices at the ends, or [`NO_VERTEX`]; edges that share one do not cross there.
    pub(super) vertices: [u32; 2],
    /// `line · (X, Y, 1)` is the distance from the edge's line, positive on the left.
    pub(in crate::transport) line: DVec3,
    /// How many coverings more the left side has than the right side; not 0.
    pub(super) coefficient: i32,
}

/// The name of ends that are no vertices of a mesh.
pub(super) const NO_VERTEX: u32 = u32::MAX;

/// The part of a chain edge over the bounding rectangle of the light.
#[derive(Clone, Copy, Debug)]
pub(in crate::transport) struct Inside {
    pub(in crate::transport) ends: [DVec3; 2],
    pub(in crate::transport) depths: [f64; 2],
    pub(in crate::transport) places: [DVec2; 2],
}

impl Inside {
    /// Point on the 3D edge that is seen at parameter `t` of the edge's image.
    pub(in crate::transport) fn point(&self, t: f64) -> DVec3 {
        let [near, far] = self.depths;
        let tau = t * near / ((1.0 - t) * far + t * near);
        self.ends[0] + tau * (self.ends[1] - self.ends[0])
    }
}

impl Chain {
    /// `None` when its image is a point, which bounds nothing.
    pub(in crate::transport) fn new(
        ends: [DVec3; 2],
        images: [DVec3; 2],
        range: [f64; 2],
        vertices: [u32; 2],
        coefficient: i32,
    ) -> Option<Self> {
        let cut_images = range.map(|t| between(images, t));
        let places = cut_images.map(|image| image.truncate() / image.z);
        // Not a × b, which would lose the digits that the ends of a short edge have in common.
        let line = images[0].cross(images[1] - images[0]);
        let length = line.truncate().length();
        (places[0] != places[1] && length > 0.0).then(|| Self {
            ends: range.map(|t| between(ends, t)),
            images: cut_images,
            places,
            vertices,
            line: line / length,
            coefficient,
        })
    }

    /// The part over the rectangle `low..high`.
    pub(in crate::transport) fn clipped(&self, low: DVec2, high: DVec2) -> Option<Inside> {
        let range = self.range_over(low, high)?;
        let inside = self.part(range);
        (inside.places[0] != inside.places[1]).then_some(inside)
    }

    /// Parameters of the part over a rectangle; found in homogeneous coordinates, so that far ends cost no digits.
    pub(super) fn range_over(&self, low: DVec2, high: DVec2) -> Option<[f64; 2]> {
        let [a, b] = self.images;
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
        (range[0] < range[1]).then_some(range)
    }

    pub(super) fn part(&self, range: [f64; 2]) -> Inside {
        let images = range.map(|t| between(self.images, t));
        Inside {
            ends: range.map(|t| between(self.ends, t)),
            depths: images.map(|image| image.z),
            places: images.map(|image| image.truncate() / image.z),
        }
    }
}

/// Parameters of the part of an edge between the nearest depth and the light, from the depths of its ends.
pub(in crate::transport) fn depth_range(a: f64, b: f64) -> Option<[f64; 2]> {
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

/// What an edge wholly beside the light covers of the lines cast past it: those whose coordinate lies in `low..high`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) low: f64,
    pub(super) high: f64,
    /// Coverings that a place has more for having the edge ahead.
    pub(super) coefficient: i32,
}

/// Where a vertex is seen.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    relative: DVec3,
    image: DVec3,
    place: DVec2,
    /// Which of the planes around the region of interest it lies beyond; [`UNKNOWN`] until it is looked at.
    beyond: u8,
}

const LEFT: u8 = 1;
const RIGHT: u8 = 2;
const BELOW: u8 = 4;
const ABOVE: u8 = 8;
/// Behind the light, or not ahead of the receiver.
const OUT_OF_DEPTH: u8 = 16;
const UNKNOWN: u8 = 255;

/// The occluders' edges in the eyes of one receiver. Memory that evaluations reuse.
#[derive(Debug, Default)]
pub(super) struct Projection {
    coefficients: Vec<i32>,
    seen: Vec<Seen>,
    /// Per vertex how many edges with a coefficient meet there.
    pub(super) degrees: Vec<u32>,
    /// Edges that may reach over the rectangle.
    pub(super) chain: Vec<Chain>,
    /// Edges above the rectangle, which lines cast upwards may cross, and edges to its right.
    pub(super) beside: [Vec<Span>; 2],
}

/// A receiver and the rectangle around the light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eye<'a> {
    pub(super) receiver: DVec3,
    pub(super) frame: &'a Frame,
    pub(super) low: DVec2,
    pub(super) high: DVec2,
}

impl Eye<'_> {
    fn look(&self, vertex: DVec3) -> Seen {
        let relative = vertex - self.receiver;
        let image = self.frame.project(relative);
        let place = image.truncate() / image.z;
        let beyond = if (NEAREST..=1.0).contains(&image.z) {
            self.beyond(place)
        } else {
            OUT_OF_DEPTH
        };
        Seen {
            relative,
            image,
            place,
            beyond,
        }
    }

    fn beyond(&self, place: DVec2) -> u8 {
        let bit = |is_beyond: bool, bit: u8| if is_beyond { bit } else { 0 };
        bit(place.x < self.low.x, LEFT)
            + bit(place.x > self.high.x, RIGHT)
            + bit(place.y < self.low.y, BELOW)
            + bit(place.y > self.high.y, ABOVE)
    }
}

impl Projection {
    /// Looks at all edges with a coefficient, cut to the depths between receiver and light.
    pub(super) fn fill(&mut self, eye: &Eye<'_>, outline: &Outline) {
        self.chain.clear();
        self.beside.iter_mut().for_each(Vec::clear);
        self.seen.resize(outline.vertices.len(), Seen::default());
        for seen in &mut self.seen {
            seen.beyond = UNKNOWN;
        }
        self.degrees.clear();
        self.degrees.resize(outline.vertices.len(), 0);
        self.coefficients.clone_from(&outline.coefficients);
        for triangle in &outline.varying {
            let turn = triangle.facet.facing(eye.receiver) - triangle.assumed;
            if turn != 0 {
                for &Side { edge, direction } in &triangle.facet.sides {
                    self.coefficients[edge as usize] -= turn * direction;
                }
            }
        }
        for (index, ends) in outline.edges.iter().enumerate() {
            if self.coefficients[index] != 0 {
                self.add(eye, outline, *ends, self.coefficients[index]);
            }
        }
        for triangle in &outline.crossing {
            let turn = -triangle.facing(eye.receiver);
            if turn != 0 {
                self.cut(eye, outline, triangle, turn, (NEAREST, 1.0));
                self.cut(eye, outline, triangle, turn, (1.0, -1.0));
            }
        }
    }

    fn see(&mut self, eye: &Eye<'_>, outline: &Outline, vertex: u32) -> &Seen {
        let seen = &mut self.seen[vertex as usize];
        if seen.beyond == UNKNOWN {
            *seen = eye.look(outline.vertices[vertex as usize]);
        }
        seen
    }

    fn add(&mut self, eye: &Eye<'_>, outline: &Outline, ends: [u32; 2], coefficient: i32) {
        let beyond = ends.map(|end| {
            self.degrees[end as usize] += 1;
            self.see(eye, outline, end).beyond
        });
        let seen = ends.map(|end| &self.seen[end as usize]);
        let edge = |range| {
            let images = seen.map(|end| end.image);
            let relative = seen.map(|end| end.relative);
            Chain::new(relative, images, range, ends, coefficient)
        };
        if (beyond[0] | beyond[1]) & OUT_OF_DEPTH == 0 {
            let places = seen.map(|end| end.place);
            if may_reach_over(&mut self.beside, beyond, places, coefficient) {
                self.chain.extend(edge([0.0, 1.0]));
            }
        } else if let Some(range) = depth_range(seen[0].image.z, seen[1].image.z) {
            let edge = edge(range);
            self.add_cut(eye, edge);
        }
    }

    fn add_cut(&mut self, eye: &Eye<'_>, edge: Option<Chain>) {
        self.chain.extend(edge.filter(|edge| {
            let beyond = edge.places.map(|place| eye.beyond(place));
            may_reach_over(&mut self.beside, beyond, edge.places, edge.coefficient)
        }));
    }

    /// Adds the edge along which a triangle is cut by the plane of some depth; what lies on the side of the sign is kept.
    fn cut(
        &mut self,
        eye: &Eye<'_>,
        outline: &Outline,
        triangle: &Facet,
        turn: i32,
        (depth, sign): (f64, f64),
    ) {
        let mut ends = [None; 2];
        for &Side { edge, direction } in &triangle.sides {
            // Always from the edge's first vertex, so that both neighbours get the same point.
            let [a, b] = outline.edges[edge as usize].map(|end| *self.see(eye, outline, end));
            let inside = [a, b].map(|vertex| sign * (vertex.image.z - depth));
            if (inside[0] < 0.0) == (inside[1] < 0.0) {
                continue;
            }
            let tau = inside[0] / (inside[0] - inside[1]);
            let point = (
                a.relative + tau * (b.relative - a.relative),
                a.image + tau * (b.image - a.image),
            );
            // In the direction of the covered triangle the edge leaves the kept side, or enters it.
            let leaves = (inside[0] < 0.0) != (turn * direction > 0);
            ends[usize::from(!leaves)] = Some(point);
        }
        if let [Some(from), Some(to)] = ends {
            let (points, images) = ([from.0, to.0], [from.1, to.1]);
            let edge = Chain::new(points, images, [0.0, 1.0], [NO_VERTEX; 2], 1);
            self.add_cut(eye, edge);
        }
    }
}

/// Whether an edge may reach over the rectangle; if not, notes for which cast lines it counts.
fn may_reach_over(
    beside: &mut [Vec<Span>; 2],
    beyond: [u8; 2],
    places: [DVec2; 2],
    coefficient: i32,
) -> bool {
    let both = beyond[0] & beyond[1];
    if both == 0 {
        return true;
    }
    // Lines are cast to the right and upwards from within the rectangle.
    let across = match both {
        RIGHT => 1,
        ABOVE => 0,
        _ => return false,
    };
    let [a, b] = places.map(|place| place[across]);
    let coefficient = turn(places, across) * coefficient;
    if a != b {
        beside[across].push(Span {
            low: a.min(b),
            high: a.max(b),
            coefficient,
        });
    }
    false
}

/// +1 for edges upwards (`across` = 1) or leftwards (0): places on the left of those have them ahead; else −1.
pub(super) fn turn([a, b]: [DVec2; 2], across: usize) -> i32 {
    if (b[across] > a[across]) == (across == 1) {
        1
    } else {
        -1
    }
}

//! Where edges meet each other and the light's border.
//!
//! Two segments are either clearly apart, or clearly cross, or rounding decides. Across a clear crossing coverings change by what the
//! other edge says, so they can be counted on along an edge. Segments about which rounding decides are marked: between any two breaks of
//! those coverings are looked up.

use glam::{DVec2, DVec3};

use super::project::{Chain, NO_VERTEX};

/// The part of a chain edge over the bounding rectangle of the light, as it is cut up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strand {
    pub(super) places: [DVec2; 2],
    /// As in [`Chain`].
    pub(super) line: DVec3,
    /// As in [`Chain`], where it ends there and not at the rim of the rectangle.
    pub(super) vertices: [u32; 2],
    /// As in [`Chain`].
    pub(super) coefficient: i32,
    /// Index of the chain edge, and which part of that it is.
    pub(super) chain: u32,
    pub(super) range: [f64; 2],
    /// Whether rounding decides about it somewhere.
    pub(super) is_delicate: bool,
    /// Whether it meets the light's border.
    pub(super) meets_border: bool,
    /// Coverings on its right where it starts, once known.
    pub(super) right: Option<i32>,
}

impl Strand {
    pub(super) fn new(index: usize, edge: &Chain, low: DVec2, high: DVec2) -> Option<Self> {
        let range = edge.range_over(low, high)?;
        let places = if range == [0.0, 1.0] {
            edge.places
        } else {
            edge.part(range).places
        };
        let mut vertices = edge.vertices;
        for end in 0..2 {
            if places[end] != edge.places[end] {
                vertices[end] = NO_VERTEX;
            }
        }
        (places[0] != places[1]).then_some(Self {
            places,
            line: edge.line,
            vertices,
            coefficient: edge.coefficient,
            chain: index as u32,
            range,
            is_delicate: false,
            meets_border: false,
            right: None,
        })
    }

    /// Distance from the edge's line, positive on the left.
    fn side(&self, place: DVec2) -> f64 {
        side(self.line, place)
    }

    fn shares_a_vertex_with(&self, other: &Self) -> bool {
        self.vertices
            .iter()
            .any(|vertex| *vertex != NO_VERTEX && other.vertices.contains(vertex))
    }
}

/// Distance of a place from a line, positive on the left.
pub(super) fn side(line: DVec3, place: DVec2) -> f64 {
    line.x * place.x + line.y * place.y + line.z
}

/// Where a strand, or a side of the border, is cut.
#[derive(Clone, Copy, Debug)]
pub(super) struct Break {
    /// Index of the strand or side.
    pub(super) on: u32,
    /// By how much coverings grow there.
    pub(super) step: i32,
    /// Parameter.
    pub(super) t: f64,
}

/// How two segments lie, given how far the ends of either are from the line of the other.
enum Relation {
    Apart,
    Cross,
    /// Rounding decides.
    Delicate,
}

fn is_beside(a: f64, b: f64, near: f64) -> bool {
    (a > near && b > near) || (a < -near && b < -near)
}

fn relation([a, b]: [f64; 2], [c, d]: [f64; 2], near: f64) -> Relation {
    if is_beside(a, b, near) || is_beside(c, d, near) {
        Relation::Apart
    } else if [a, b, c, d].iter().all(|distance| distance.abs() > near) {
        Relation::Cross
    } else {
        Relation::Delicate
    }
}

/// A side of the light's border, the light on its left.
#[derive(Clone, Copy, Debug)]
pub(super) struct BorderSide {
    pub(super) places: [DVec2; 2],
    /// As in [`Chain`].
    line: DVec3,
    pub(super) is_delicate: bool,
}

impl BorderSide {
    pub(super) fn new(places: [DVec2; 2]) -> Self {
        let [p, q] = places;
        let along = (q - p).normalize_or_zero();
        Self {
            places,
            line: DVec3::new(-along.y, along.x, along.y * p.x - along.x * p.y),
            is_delicate: false,
        }
    }

    /// Whether a place lies on it within `near`.
    pub(super) fn is_near(&self, place: DVec2, near: f64) -> bool {
        let [p, q] = self.places;
        let t = (q - p).dot(place - p);
        side(self.line, place).abs() <= near && 0.0 <= t && t <= (q - p).length_squared()
    }
}

/// Collects the places where segments meet.
pub(super) struct Sweep<'a> {
    pub(super) strands: &'a mut [Strand],
    pub(super) breaks: &'a mut Vec<Break>,
    /// Distance up to which rounding decides.
    pub(super) near: f64,
}

/// A strand's box, a little larger.
#[derive(Clone, Copy, Debug)]
pub(super) struct Boxed {
    low: DVec2,
    high: DVec2,
    /// Its ends along x, as [`ascending`] numbers.
    from: u64,
    to: u64,
    strand: u32,
}

/// A number of 32 bits that does not fall where `x` rises: short keys are sorted in a fraction of the time.
fn ascending(x: f64) -> u64 {
    let bits = (x as f32).to_bits();
    let is_negative = bits >> 31 == 1;
    u64::from(if is_negative { !bits } else { bits | 1 << 31 })
}

impl Sweep<'_> {
    /// Where strands meet each other; pairs are found by sweeping along x.
    pub(super) fn cross_strands(&mut self, order: &mut Vec<u64>, boxes: &mut Vec<Boxed>) {
        order.clear();
        order.extend((0..).zip(&*self.strands).map(|(strand, own)| {
            let [p, q] = own.places;
            ascending(p.x.min(q.x) - self.near) << 32 | strand
        }));
        order.sort_unstable();
        boxes.clear();
        boxes.extend(order.iter().map(|key| {
            let strand = *key as u32;
            let [p, q] = self.strands[strand as usize].places;
            Boxed {
                low: p.min(q) - self.near,
                high: p.max(q) + self.near,
                from: key >> 32,
                to: ascending(p.x.max(q.x) + self.near),
                strand,
            }
        }));
        for (rank, first) in boxes.iter().enumerate() {
            for second in &boxes[rank + 1..] {
                if second.from > first.to {
                    break;
                }
                if second.low.y <= first.high.y && first.low.y <= second.high.y {
                    self.cross(first.strand, second.strand);
                }
            }
        }
    }

    fn cross(&mut self, a: u32, b: u32) {
        let (first, second) = (&self.strands[a as usize], &self.strands[b as usize]);
        let at_first = first.places.map(|place| second.side(place));
        let at_second = second.places.map(|place| first.side(place));
        match relation(at_first, at_second, self.near) {
            Relation::Apart => {}
            Relation::Cross => {
                let step = |from: f64, other: &Strand| {
                    if from > 0.0 {
                        -other.coefficient
                    } else {
                        other.coefficient
                    }
                };
                let steps = [step(at_first[0], second), step(at_second[0], first)];
                self.add(a, steps[0], zero_of(at_first));
                self.add(b, steps[1], zero_of(at_second));
            }
            Relation::Delicate => self.touch([a, b], at_first, at_second),
        }
    }

    fn touch(&mut self, [a, b]: [u32; 2], at_first: [f64; 2], at_second: [f64; 2]) {
        let (first, second) = (self.strands[a as usize], self.strands[b as usize]);
        let is_shared = first.shares_a_vertex_with(&second);
        let along = [at_first, at_second].map(|distances| self.runs_along(distances));
        if along[0] || along[1] {
            if is_shared && leads_on(&first, &second) {
                return;
            }
            overlap(first.places, second.places, |t| self.add(a, 0, t));
            overlap(second.places, first.places, |t| self.add(b, 0, t));
        } else if is_shared {
            // Edges that share a vertex do not cross anywhere else.
            return;
        } else if differ(at_first) && differ(at_second) {
            self.add(a, 0, zero_of(at_first));
            self.add(b, 0, zero_of(at_second));
        }
        self.strands[a as usize].is_delicate = true;
        self.strands[b as usize].is_delicate = true;
    }

    /// Whether a segment whose ends have these distances from a line runs along it within rounding.
    fn runs_along(&self, distances: [f64; 2]) -> bool {
        distances.iter().all(|distance| distance.abs() <= self.near)
    }

    fn add(&mut self, on: u32, step: i32, t: f64) {
        self.breaks.push(Break { on, step, t });
    }

    /// Where strands meet the light's border; adds breaks of that to `border_breaks`.
    pub(super) fn cross_border(
        &mut self,
        border: &mut [BorderSide],
        chain: &[Chain],
        border_breaks: &mut Vec<Break>,
    ) {
        for index in 0..self.strands.len() {
            // Before the edge was cut to the rectangle: the cut lies on the border itself, where rounding would decide.
            let images = chain[self.strands[index].chain as usize].images;
            for (number, side) in (0..).zip(&mut *border) {
                let [a, b] = images.map(|image| side.line.dot(image));
                if !is_beside(a, b, self.near) {
                    self.cross_side(index as u32, (number, side), [a, b], border_breaks);
                }
            }
        }
    }

    fn cross_side(
        &mut self,
        index: u32,
        (number, side): (u32, &mut BorderSide),
        across: [f64; 2],
        border_breaks: &mut Vec<Break>,
    ) {
        let strand = self.strands[index as usize];
        let at_border = side.places.map(|place| strand.side(place));
        let relation = relation(at_border, across, self.near);
        if matches!(relation, Relation::Apart) {
            return;
        }
        self.strands[index as usize].meets_border = true;
        let on_border = |step: i32, t: f64| Break {
            on: number,
            step,
            t,
        };
        if matches!(relation, Relation::Delicate) {
            self.strands[index as usize].is_delicate = true;
            side.is_delicate = true;
            if self.runs_along(at_border) {
                overlap(side.places, strand.places, |t| {
                    border_breaks.push(on_border(0, t));
                });
                overlap(strand.places, side.places, |t| self.add(index, 0, t));
                return;
            }
            if !(differ(at_border) && differ(across)) {
                return;
            }
        }
        let step = if at_border[0] > 0.0 {
            -strand.coefficient
        } else {
            strand.coefficient
        };
        border_breaks.push(on_border(step, zero_of(at_border)));
        let t = zero_of(strand.places.map(|place| self::side(side.line, place)));
        if 0.0 < t && t < 1.0 {
            self.add(index, 0, t);
        }
    }
}

/// Whether two segments on one line that share a vertex lie on different sides of it.
fn leads_on(first: &Strand, second: &Strand) -> bool {
    let direction = |strand: &Strand| strand.places[1] - strand.places[0];
    let is_same_end = (0..2)
        .any(|end| first.vertices[end] != NO_VERTEX && first.vertices[end] == second.vertices[end]);
    (direction(first).dot(direction(second)) < 0.0) == is_same_end
}

/// Sorts breaks by what they are on, then by parameter; `starts[i]..starts[i + 1]` are then those on `i`.
pub(super) fn sort(breaks: &[Break], n: usize, starts: &mut Vec<u32>, sorted: &mut Vec<Break>) {
    starts.clear();
    starts.resize(n + 1, 0);
    for cut in breaks {
        starts[cut.on as usize] += 1;
    }
    // Counts become ends; filling from behind turns ends into starts.
    let mut end = 0;
    for start in &mut *starts {
        end += *start;
        *start = end;
    }
    sorted.clear();
    sorted.extend_from_slice(breaks);
    for cut in breaks.iter().rev() {
        let place = &mut starts[cut.on as usize];
        *place -= 1;
        sorted[*place as usize] = *cut;
    }
    for pair in starts.windows(2) {
        sorted[pair[0] as usize..pair[1] as usize].sort_unstable_by(|a, b| a.t.total_cmp(&b.t));
    }
}

/// Calls `visit` with start, end and coverings for each interval between breaks in 0..1 that has length; `coverings` are those at 0.
pub(super) fn for_each_interval(
    breaks: &[Break],
    coverings: i32,
    mut visit: impl FnMut(f64, f64, i32),
) {
    let (mut from, mut coverings) = (0.0, coverings);
    for cut in breaks {
        if from < cut.t {
            visit(from, cut.t, coverings);
            from = cut.t;
        }
        coverings += cut.step;
    }
    if from < 1.0 {
        visit(from, 1.0, coverings);
    }
}

/// The middle of the longest interval between breaks, and by how much coverings have grown from 0 up to there.
pub(super) fn longest_interval(breaks: &[Break]) -> (f64, i32) {
    let (mut longest, mut middle, mut growth) = (0.0, 0.5, 0);
    for_each_interval(breaks, 0, |from, to, so_far| {
        if to - from > longest {
            (longest, middle, growth) = (to - from, 0.5 * (from + to), so_far);
        }
    });
    (middle, growth)
}

/// Whether places with these distances lie on different sides of a line. Places on the line count as left of it, so that of two edges
/// that meet on it just one crosses.
pub(in crate::transport) fn differ([a, b]: [f64; 2]) -> bool {
    (a >= 0.0) != (b >= 0.0)
}

/// The parameter at which a linear function with these end values is zero.
pub(in crate::transport) fn zero_of([a, b]: [f64; 2]) -> f64 {
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

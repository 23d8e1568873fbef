//! Up to eight segments of like direction through the tree together, each in a lane of its own.
//!
//! Shadow rays from neighbouring texels to one light open the same boxes and meet the same triangles. Together they share what one ray
//! spends on finding its way: a box, or a triangle, is fetched once and held against all of them.
//!
//! Source: I. Wald, P. Slusallek, C. Benthin and M. Wagner, "Interactive rendering with coherent ray tracing", Computer Graphics Forum
//! 20(3), 2001.

use glam::DVec3;

use super::boxes::Boxes;
use super::filter::{Filter, Verdict};
use super::frame::{FAR, Frame, PADDING};
use super::lanes::{LANES, Lanes, Row};
use super::ray::{ORDER, SHALLOW, SMALLEST_COMPONENT};
use super::triangle::ROUNDING;
use super::wide::{PACKET, Packet, Tree};

/// One `f64` for each lane.
type Doubles = [f64; LANES];

/// Segments in the frame of the tree.
pub(super) struct Bundle {
    /// World coordinates of both ends, by axis.
    from: [Doubles; 3],
    to: [Doubles; 3],
    /// The largest of them.
    extent: Doubles,
    pub(super) start: [Row; 3],
    pub(super) inverse: [Row; 3],
    pub(super) length: Row,
    /// Axis along which all are longest, and the two others.
    axes: [usize; 3],
    shear: [Row; 2],
    /// The direction along the longest axis.
    along: Row,
    /// Bit k is set where most run against axis k.
    octant: usize,
    /// One bit for each segment that goes with the others.
    pub(super) together: u32,
}

impl Bundle {
    /// `segments` that are all longest along `axis`. Those that start far outside the scene or have next to no length are not among
    /// those that go together.
    #[inline(always)]
    pub(super) fn new(segments: &[[DVec3; 2]; LANES], axis: usize) -> Self {
        let mut bundle = Self {
            from: [[0.0; LANES]; 3],
            to: [[0.0; LANES]; 3],
            extent: [0.0; LANES],
            start: [[0.0; LANES]; 3],
            inverse: [[0.0; LANES]; 3],
            length: [0.0; LANES],
            axes: [axis, (axis + 1) % 3, (axis + 2) % 3],
            shear: [[0.0; LANES]; 2],
            along: [0.0; LANES],
            octant: 0,
            together: 0,
        };
        for (lane, [from, to]) in segments.iter().enumerate() {
            for axis in 0..3 {
                bundle.from[axis][lane] = from[axis];
                bundle.to[axis][lane] = to[axis];
            }
        }
        bundle
    }

    /// Moves the segments to `frame`.
    #[inline(always)]
    pub(super) fn place(&mut self, frame: &Frame) {
        let fits = self.enter(frame);
        self.together = bits(&fits);
        for (length, fits) in self.length.iter_mut().zip(fits) {
            // Those left out must not stretch the others' hull, nor be no number.
            *length = if fits { *length } else { 0.0 };
        }
        self.shear();
    }

    /// Sets what one ray has in [`Frame::segment`]. Returns for which this holds.
    #[expect(
        clippy::needless_range_loop,
        reason = "one index runs through several arrays"
    )]
    #[inline(always)]
    fn enter(&mut self, frame: &Frame) -> [bool; LANES] {
        let mut fits = [true; LANES];
        let mut square = [0.0f32; LANES];
        let mut direction = [[0.0f32; LANES]; 3];
        for axis in 0..3 {
            let (centre, scale) = (frame.centre[axis], frame.scale);
            for lane in 0..LANES {
                let (from, to) = (self.from[axis][lane], self.to[axis][lane]);
                let start = (from - centre) * scale;
                let along = ((to - from) * scale) as f32;
                fits[lane] &= start.abs() <= FAR;
                self.extent[lane] = self.extent[lane].max(from.abs()).max(to.abs());
                self.start[axis][lane] = start as f32;
                direction[axis][lane] = along;
                square[lane] += along * along;
            }
        }
        for lane in 0..LANES {
            fits[lane] &= square[lane] >= 1e-30 && square[lane] < 1e30;
            square[lane] = square[lane].sqrt();
            self.length[lane] = square[lane] + PADDING as f32;
        }
        for axis in 0..3 {
            for lane in 0..LANES {
                let component = direction[axis][lane] / square[lane];
                let size = component.abs().max(SMALLEST_COMPONENT);
                self.inverse[axis][lane] = 1.0 / size.copysign(component);
            }
        }
        fits
    }

    #[inline(always)]
    fn shear(&mut self) {
        for axis in 0..3 {
            let against = self.inverse[axis].iter().filter(|&&inverse| inverse < 0.0);
            self.octant |= usize::from(2 * against.count() > LANES) << axis;
        }
        let [z, x, y] = self.axes;
        for lane in 0..LANES {
            let along = |axis: usize| self.to[axis][lane] - self.from[axis][lane];
            let depth = along(z);
            self.shear[0][lane] = (along(x) / depth) as f32;
            self.shear[1][lane] = (along(y) / depth) as f32;
            self.along[lane] = 1.0 / self.inverse[z][lane];
        }
    }

    #[inline(always)]
    fn filter<L: Lanes>(&self, lanes: L) -> Filter<L> {
        Filter::eight(lanes, &self.start, (self.axes, &self.shear), &self.along)
    }

    /// Segments whose ends perhaps lie on different sides of `triangle` (no others do), as `triangle::straddles` tells.
    #[inline(always)]
    pub(super) fn straddling(&self, triangle: &[DVec3; 3]) -> u32 {
        let [a, b, c] = *triangle;
        let n = (b - a).cross(c - a);
        let small = 0.25 * ROUNDING * ROUNDING * n.length_squared();
        let mut straddling = [false; LANES];
        for lane in 0..LANES {
            let height = |p: &[Doubles; 3]| {
                n.x * (p[0][lane] - a.x) + n.y * (p[1][lane] - a.y) + n.z * (p[2][lane] - a.z)
            };
            let (start, end) = (height(&self.from), height(&self.to));
            let least = small * (self.extent[lane] * self.extent[lane]);
            straddling[lane] =
                ((start > 0.0) != (end > 0.0)) & (start * start >= least) & (end * end >= least);
        }
        bits(&straddling)
    }

    /// Those among them whose ends certainly do: by twice what `triangle::divides` takes for rounding, with distances no smaller than
    /// its own.
    #[inline(always)]
    pub(super) fn divided(&self, triangle: &[DVec3; 3]) -> u32 {
        let [a, b, c] = *triangle;
        let (ab, ac) = (b - a, c - a);
        let n = ab.cross(ac);
        let area = n.length();
        let spread = (ab.length_squared() * ac.length_squared()).sqrt();
        let extent = a.abs().max(b.abs()).max(c.abs()).max_element();
        let mut divided = [false; LANES];
        for lane in 0..LANES {
            let far = self.extent[lane];
            let far = if far > extent { far } else { extent };
            let clear = |p: &[Doubles; 3]| {
                let (x, y, z) = (p[0][lane] - a.x, p[1][lane] - a.y, p[2][lane] - a.z);
                let distance = x.abs() + y.abs() + z.abs();
                let height = n.x * x + n.y * y + n.z * z;
                height.abs() > 2.0 * ROUNDING * (spread * distance + far * area)
            };
            divided[lane] = clear(&self.from) & clear(&self.to);
        }
        bits(&divided)
    }
}

/// One bit for each lane.
#[inline(always)]
fn bits(lanes: &[bool; LANES]) -> u32 {
    let mut bits = 0;
    for (lane, &bit) in lanes.iter().enumerate() {
        bits |= u32::from(bit) << lane;
    }
    bits
}

impl Tree {
    /// Hands triangles that segments of `bundle` may meet to `test`, by place and with what is known of each segment, until all are
    /// stopped or nothing is left. It returns those that it stops. Returns all that were stopped.
    #[inline(always)]
    pub(super) fn any_of<L: Lanes>(
        &self,
        lanes: L,
        bundle: &Bundle,
        mut test: impl FnMut(usize, Verdict) -> u32,
    ) -> u32 {
        if self.nodes.is_empty() || bundle.together == 0 {
            return 0;
        }
        let mut shallow = [(0, 0, 0); SHALLOW];
        let mut deep;
        let stack: &mut [(u32, u32, u64)] = if self.depth <= SHALLOW {
            &mut shallow
        } else {
            deep = vec![(0, 0, 0); self.depth];
            &mut deep
        };
        let boxes = Boxes::new(lanes, bundle);
        let filter = bundle.filter(lanes);
        let order = &ORDER[bundle.octant];
        let octant = bundle.octant as u32;
        let mut left = bundle.together;
        let mut pending = 0;
        let mut index = 0;
        // The segments that touch each child, a byte each; children that wait, in the order in which they are met.
        let mut touching = boxes.test(lanes, &self.nodes[0], left);
        let mut waiting = u32::from(order[nonzero_bytes(touching) as usize]);
        loop {
            if waiting == 0 {
                if pending == 0 {
                    break;
                }
                pending -= 1;
                (index, waiting, touching) = stack[pending];
            }
            let slot = waiting.trailing_zeros() ^ octant;
            waiting &= waiting - 1;
            let active = (touching >> (8 * slot)) as u32 & left;
            if active == 0 {
                continue;
            }
            let child = self.nodes[index as usize].children[slot as usize];
            if child & PACKET != 0 {
                let packet = &self.packets[(child & !PACKET) as usize];
                left &= !stopped(lanes, &filter, boxes.far, packet, active, &mut test);
                if left == 0 {
                    break;
                }
                continue;
            }
            let inner = boxes.test(lanes, &self.nodes[child as usize], active);
            if inner != 0 {
                stack[pending] = (index, waiting, touching);
                pending += usize::from(waiting != 0);
                index = child;
                touching = inner;
                waiting = u32::from(order[nonzero_bytes(inner) as usize]);
            }
        }
        bundle.together & !left
    }
}

/// Those of the `active` segments that triangles of `packet` stop.
#[inline(always)]
fn stopped<L: Lanes>(
    lanes: L,
    filter: &Filter<L>,
    far: L::Floats,
    packet: &Packet,
    active: u32,
    test: &mut impl FnMut(usize, Verdict) -> u32,
) -> u32 {
    let mut left = active;
    for lane in 0..packet.count as usize & (2 * LANES - 1) {
        let corner = |vertex: usize, axis: usize| lanes.splat(packet.vertices[vertex][axis][lane]);
        let Verdict { possible, inside } = filter.test(lanes, corner, far);
        let possible = possible & left;
        if possible == 0 {
            continue;
        }
        let opaque = 0u32.wrapping_sub(packet.opaque >> lane & 1);
        let inside = inside & possible & opaque;
        left &= !(*test)(packet.first as usize + lane, Verdict { possible, inside });
        if left == 0 {
            break;
        }
    }
    active & !left
}

/// One bit for each byte that is not zero.
#[inline(always)]
fn nonzero_bytes(bytes: u64) -> u32 {
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    let high = (((bytes & LOW) + LOW) | bytes) >> 7 & 0x0101_0101_0101_0101;
    // Moves bit 8 i to 56 + i, without carries.
    (high.wrapping_mul(0x0102_0408_1020_4080) >> 56) as u32
}

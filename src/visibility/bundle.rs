//! Up to eight segments of like direction through the tree together, each in a lane of its own.
//!
//! Shadow rays from neighbouring texels to one light open the same boxes and meet the same triangles. Together they share what one ray
//! spends on finding its way: a box, or a triangle, is fetched once and held against all of them.
//!
//! Source: I. Wald, P. Slusallek, C. Benthin and M. Wagner, "Interactive rendering with coherent ray tracing", Computer Graphics Forum
//! 20(3), 2001.

use glam::DVec3;

use super::filter::{Filter, Verdict};
use super::frame::{FAR, Frame, PADDING};
use super::lanes::{LANES, Lanes, Row};
use super::ray::{ORDER, SHALLOW, SMALLEST_COMPONENT};
use super::triangle::ROUNDING;
use super::wide::{Node, PACKET, Packet, Tree};

/// One `f64` for each lane.
type Doubles = [f64; LANES];

/// Segments in the frame of the tree.
pub(super) struct Bundle {
    /// World coordinates of both ends, by axis.
    from: [Doubles; 3],
    to: [Doubles; 3],
    /// The largest of them.
    extent: Doubles,
    start: [Row; 3],
    inverse: [Row; 3],
    length: Row,
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

/// Segments, one bit each, whose ends lie on different sides of a triangle's plane.
pub(super) struct Sides {
    /// Perhaps: no others do.
    pub(super) straddling: u32,
    /// Certainly: by twice what the exact test takes for rounding, with distances no smaller than its own.
    pub(super) divided: u32,
}

impl Bundle {
    /// `segments` that are all longest along `axis`. Those that start far outside the scene or have next to no length are not among
    /// those that go together.
    #[inline(always)]
    pub(super) fn new(frame: &Frame, segments: &[[DVec3; 2]; LANES], axis: usize) -> Self {
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
        let fits = bundle.place(frame);
        bundle.together = bits(&fits);
        for (length, fits) in bundle.length.iter_mut().zip(fits) {
            // Those left out must not stretch the others' hull, nor be no number.
            *length = if fits { *length } else { 0.0 };
        }
        bundle.shear();
        bundle
    }

    /// Sets what one ray has in [`Frame::segment`]. Returns for which this holds.
    #[inline(always)]
    fn place(&mut self, frame: &Frame) -> [bool; LANES] {
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

    /// On which sides of `triangle` the ends of the segments lie, within the bounds of `triangle::straddles` and `triangle::divides`.
    #[inline(always)]
    pub(super) fn sides(&self, triangle: &[DVec3; 3]) -> Sides {
        let [a, b, c] = *triangle;
        let (ab, ac) = (b - a, c - a);
        let n = ab.cross(ac);
        let square = n.length_squared();
        let small = 0.25 * ROUNDING * ROUNDING * square;
        let area = square.sqrt();
        let spread = (ab.length_squared() * ac.length_squared()).sqrt();
        let extent = a.abs().max(b.abs()).max(c.abs()).max_element();
        let mut straddling = [false; LANES];
        let mut divided = [false; LANES];
        for lane in 0..LANES {
            let height = |p: &[Doubles; 3]| {
                let (x, y, z) = (p[0][lane] - a.x, p[1][lane] - a.y, p[2][lane] - a.z);
                (n.x * x + n.y * y + n.z * z, x.abs() + y.abs() + z.abs())
            };
            let (start, end) = (height(&self.from), height(&self.to));
            let far = self.extent[lane];
            let tolerance = |distance: f64| {
                2.0 * ROUNDING * (spread * distance + extent.max(far) * area)
            };
            let least = small * (far * far);
            let different = (start.0 > 0.0) != (end.0 > 0.0);
            straddling[lane] =
                different & (start.0 * start.0 >= least) & (end.0 * end.0 >= least);
            divided[lane] = different
                & (start.0.abs() > tolerance(start.1))
                & (end.0.abs() > tolerance(end.1));
        }
        Sides {
            straddling: bits(&straddling),
            divided: bits(&divided),
        }
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
        let filter = Filter::eight(
            lanes,
            &bundle.start,
            (bundle.axes, &bundle.shear),
            &bundle.along,
        );
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
    let high = ((bytes & LOW) + LOW | bytes) >> 7 & 0x0101_0101_0101_0101;
    // Moves bit 8 i to 56 + i, without carries.
    (high.wrapping_mul(0x0102_0408_1020_4080) >> 56) as u32
}

/// Segments, ready for boxes.
struct Boxes<L: Lanes> {
    inverse: [L::Floats; 3],
    /// Where the segments start, times `inverse`.
    start: [L::Floats; 3],
    far: L::Floats,
    hull: Hull<L>,
}

impl<L: Lanes> Boxes<L> {
    #[inline(always)]
    fn new(lanes: L, bundle: &Bundle) -> Self {
        let [x, y, z] = &bundle.inverse;
        let inverse = [lanes.load(x), lanes.load(y), lanes.load(z)];
        let [x, y, z] = &bundle.start;
        Self {
            inverse,
            start: [
                lanes.mul(lanes.load(x), inverse[0]),
                lanes.mul(lanes.load(y), inverse[1]),
                lanes.mul(lanes.load(z), inverse[2]),
            ],
            far: lanes.load(&bundle.length),
            hull: Hull::new(lanes, bundle),
        }
    }

    /// The `active` segments that touch each child, a byte each.
    #[inline(always)]
    fn test(&self, lanes: L, node: &Node, active: u32) -> u64 {
        let mut children = self.hull.test(lanes, node);
        let mut touching = 0;
        while children != 0 {
            let child = children.trailing_zeros() as usize;
            children &= children - 1;
            let x = self.within(lanes, node, 0, child);
            let y = self.within(lanes, node, 1, child);
            let z = self.within(lanes, node, 2, child);
            let enters = lanes.max(lanes.max(x.0, y.0), lanes.max(z.0, lanes.splat(0.0)));
            let leaves = lanes.min(lanes.min(x.1, y.1), lanes.min(z.1, self.far));
            touching |= u64::from(lanes.less(enters, leaves) & active) << (8 * child);
        }
        touching & node.present
    }

    /// Where the segments enter and leave the space between two planes of a child.
    #[inline(always)]
    fn within(&self, lanes: L, node: &Node, axis: usize, child: usize) -> (L::Floats, L::Floats) {
        let meets = |plane: usize| {
            lanes.mul_sub(
                lanes.splat(node.planes[plane][child]),
                self.inverse[axis],
                self.start[axis],
            )
        };
        let (a, b) = (meets(axis), meets(axis + 3));
        (lanes.min(a, b), lanes.max(a, b))
    }
}

/// All segments as one, by the ranges of their starts and directions: touches whatever one of them touches.
///
/// The rounding of a difference and a product is no more than that of one segment in `Boxes::within`, for which boxes are padded.
struct Hull<L: Lanes> {
    sides: [Option<Side<L>>; 3],
    far: L::Floats,
}

/// What [`Hull`] knows of an axis along which all segments run the same way.
#[derive(Clone, Copy)]
struct Side<L: Lanes> {
    /// Which plane of a node is met first, and from where the last segment starts.
    near: (usize, L::Floats),
    /// Which is met last, and from where the first starts.
    far: (usize, L::Floats),
    inverse: [L::Floats; 2],
}

impl<L: Lanes> Hull<L> {
    #[inline(always)]
    fn new(lanes: L, bundle: &Bundle) -> Self {
        let (_, far) = range(&bundle.length);
        Self {
            sides: [
                Side::new(lanes, bundle, 0),
                Side::new(lanes, bundle, 1),
                Side::new(lanes, bundle, 2),
            ],
            far: lanes.splat(far),
        }
    }

    /// Children that some segment may touch.
    #[inline(always)]
    fn test(&self, lanes: L, node: &Node) -> u32 {
        let mut enters = lanes.splat(0.0);
        let mut leaves = self.far;
        for side in self.sides.iter().flatten() {
            let [least, most] = side.inverse;
            let (plane, start) = side.near;
            let offset = lanes.sub(lanes.load(&node.planes[plane]), start);
            let meets = lanes.min(lanes.mul(offset, least), lanes.mul(offset, most));
            enters = lanes.max(enters, meets);
            let (plane, start) = side.far;
            let offset = lanes.sub(lanes.load(&node.planes[plane]), start);
            let meets = lanes.max(lanes.mul(offset, least), lanes.mul(offset, most));
            leaves = lanes.min(leaves, meets);
        }
        lanes.less(enters, leaves)
    }
}

impl<L: Lanes> Side<L> {
    #[inline(always)]
    fn new(lanes: L, bundle: &Bundle, axis: usize) -> Option<Self> {
        let (least, most) = range(&bundle.inverse[axis]);
        let (first, last) = range(&bundle.start[axis]);
        let inverse = [lanes.splat(least), lanes.splat(most)];
        let (first, last) = (lanes.splat(first), lanes.splat(last));
        if least > 0.0 {
            Some(Self {
                near: (axis, last),
                far: (axis + 3, first),
                inverse,
            })
        } else if most < 0.0 {
            Some(Self {
                near: (axis + 3, first),
                far: (axis, last),
                inverse,
            })
        } else {
            None
        }
    }
}

/// Smallest and largest.
#[inline(always)]
fn range(row: &Row) -> (f32, f32) {
    let (mut least, mut most) = (row[0], row[0]);
    for &value in row {
        least = if value < least { value } else { least };
        most = if value > most { value } else { most };
    }
    (least, most)
}

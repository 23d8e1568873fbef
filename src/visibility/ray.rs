//! One ray through the tree: eight boxes, or eight triangles, at once.

use glam::Vec3;

use super::filter::{Filter, UNIT};
use super::lanes::{LANES, Lanes};
use super::wide::{Node, PACKET, Packet, Tree};

/// Directions whose components are smaller than this are moved to it: 12 units off within the scene, and no division by zero.
pub(super) const SMALLEST_COMPONENT: f32 = 2.0 * UNIT;

/// Up to this depth no memory is asked for. Levels have ten.
pub(super) const SHALLOW: usize = 48;

/// Triangles of a packet that a ray may cross.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidates {
    /// Place of the packet's first triangle.
    first: u32,
    /// One bit for each triangle that is not clearly missed.
    possible: u32,
    /// Those among them through whose inside it goes, if its ends are on different sides, and which stop light wherever they are crossed.
    solid: u32,
}

/// A ray in the frame of the tree, prepared for boxes and triangles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Bit k is set where the direction runs against axis k.
    octant: usize,
    /// Which plane of a node the ray meets first, for each axis; the other is three away, modulo six.
    nearer: [usize; 3],
    /// Longest axis of the direction, and the two others.
    axes: [usize; 3],
    shear: [f32; 2],
    /// The direction along the longest axis.
    along: f32,
}

impl Ray {
    /// A ray from `origin`, within 2 of the centre, along a unit direction; `axes` and `shear` as for the exact test.
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3, axes: [usize; 3], shear: [f64; 2]) -> Self {
        let inverse = direction.to_array().map(|component| {
            if component.abs() < SMALLEST_COMPONENT {
                1.0 / SMALLEST_COMPONENT.copysign(component)
            } else {
                1.0 / component
            }
        });
        let nearer = |axis: usize| if inverse[axis] < 0.0 { axis + 3 } else { axis };
        Self {
            origin: origin.to_array(),
            inverse,
            octant: (0..3).fold(0, |octant, axis| {
                octant | usize::from(inverse[axis] < 0.0) << axis
            }),
            nearer: [nearer(0), nearer(1), nearer(2)],
            axes,
            shear: shear.map(|factor| factor as f32),
            along: direction[axes[0]],
        }
    }

    #[inline(always)]
    fn filter<L: Lanes>(&self, lanes: L) -> Filter<L> {
        Filter::one(lanes, self.origin, (self.axes, self.shear), self.along)
    }
}

impl Candidates {
    /// Places of the triangles, and whether they are solid there.
    #[inline(always)]
    pub(super) fn each(self) -> impl Iterator<Item = (usize, bool)> {
        let mut left = self.possible;
        std::iter::from_fn(move || {
            (left != 0).then(|| {
                let lane = left.trailing_zeros();
                left &= left - 1;
                (
                    self.first as usize + lane as usize,
                    self.solid >> lane & 1 == 1,
                )
            })
        })
    }
}

impl Tree {
    /// Hands packets that `ray` may touch within `length` to `test`, nearer ones mostly first, until it returns true. Returns whether it
    /// did.
    #[inline(always)]
    pub(super) fn any<L: Lanes>(
        &self,
        lanes: L,
        ray: &Ray,
        length: f32,
        mut test: impl FnMut(Candidates) -> bool,
    ) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let mut shallow = [(0, 0); SHALLOW];
        let mut deep;
        let stack: &mut [(u32, u32)] = if self.depth <= SHALLOW {
            &mut shallow
        } else {
            deep = vec![(0, 0); self.depth];
            &mut deep
        };
        let boxes = Slabs::new(lanes, ray);
        let filter = ray.filter(lanes);
        let far = lanes.splat(length);
        let order = &ORDER[ray.octant];
        let octant = ray.octant as u32;
        let mut pending = 0;
        let mut index = 0;
        let (touched, _) = boxes.test(lanes, &self.nodes[0], far);
        // Children that wait, in the order in which they are met: bit i is slot i ^ octant.
        let mut waiting = u32::from(order[touched as usize]);
        loop {
            if waiting == 0 {
                if pending == 0 {
                    return false;
                }
                pending -= 1;
                (index, waiting) = stack[pending];
            }
            let slot = waiting.trailing_zeros() ^ octant;
            waiting &= waiting - 1;
            let child = self.nodes[index as usize].children[slot as usize];
            if child & PACKET != 0 {
                let packet = &self.packets[(child & !PACKET) as usize];
                let candidates = sort(lanes, &filter, packet, length);
                if candidates.possible != 0 && test(candidates) {
                    return true;
                }
                continue;
            }
            let (touched, _) = boxes.test(lanes, &self.nodes[child as usize], far);
            if touched != 0 {
                stack[pending] = (index, waiting);
                pending += usize::from(waiting != 0);
                index = child;
                waiting = u32::from(order[touched as usize]);
            }
        }
    }

    /// Hands packets that `ray` may touch to `test`, nearer ones first, which returns the length at which the ray may stop from then on.
    #[inline(always)]
    pub(super) fn nearest<L: Lanes>(
        &self,
        lanes: L,
        ray: &Ray,
        mut length: f32,
        mut test: impl FnMut(Candidates) -> f32,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let most = self.depth * (LANES - 1) + 1;
        let mut shallow = [(0, 0.0); 2 * SHALLOW];
        let mut deep;
        let stack: &mut [(u32, f32)] = if most <= 2 * SHALLOW {
            &mut shallow
        } else {
            deep = vec![(0, 0.0); most];
            &mut deep
        };
        let boxes = Slabs::new(lanes, ray);
        let filter = ray.filter(lanes);
        let mut pending = 1;
        while pending > 0 {
            pending -= 1;
            let (child, entry) = stack[pending];
            if entry > length {
                continue;
            }
            if child & PACKET != 0 {
                let packet = &self.packets[(child & !PACKET) as usize];
                let candidates = sort(lanes, &filter, packet, length);
                if candidates.possible != 0 {
                    length = length.min(test(candidates));
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let (mut touched, entries) = boxes.test(lanes, node, lanes.splat(length));
            let entries = lanes.to_row(entries);
            let first = pending;
            while touched != 0 {
                let lane = touched.trailing_zeros() as usize;
                touched &= touched - 1;
                // The nearest ends on top.
                let mut place = pending;
                while place > first && stack[place - 1].1 < entries[lane] {
                    stack[place] = stack[place - 1];
                    place -= 1;
                }
                stack[place] = (node.children[lane], entries[lane]);
                pending += 1;
            }
        }
    }
}

/// Holds one ray against the triangles of a packet.
#[inline(always)]
fn sort<L: Lanes>(lanes: L, filter: &Filter<L>, packet: &Packet, length: f32) -> Candidates {
    let corner = |vertex: usize, axis: usize| lanes.load(&packet.vertices[vertex][axis]);
    let verdict = filter.test(lanes, corner, lanes.splat(length));
    Candidates {
        first: packet.first,
        possible: verdict.possible,
        solid: verdict.inside & packet.opaque,
    }
}

/// A ray, ready for boxes.
struct Slabs<L: Lanes> {
    inverse: [L::Floats; 3],
    /// Where the ray starts, times `inverse`.
    start: [L::Floats; 3],
    nearer: [usize; 3],
}

impl<L: Lanes> Slabs<L> {
    #[inline(always)]
    fn new(lanes: L, ray: &Ray) -> Self {
        let [x, y, z] = ray.inverse;
        let [u, v, w] = ray.origin;
        Self {
            inverse: [lanes.splat(x), lanes.splat(y), lanes.splat(z)],
            start: [lanes.splat(u * x), lanes.splat(v * y), lanes.splat(w * z)],
            nearer: ray.nearer,
        }
    }

    /// Children whose box is touched before `far`, and where the ray enters them.
    #[inline(always)]
    fn test(&self, lanes: L, node: &Node, far: L::Floats) -> (u32, L::Floats) {
        let [x, y, z] = self.nearer;
        let (x_far, y_far, z_far) = ((x + 3) % 6, (y + 3) % 6, (z + 3) % 6);
        let enters = lanes.max(
            lanes.max(self.meets(lanes, node, 0, x), self.meets(lanes, node, 1, y)),
            lanes.max(self.meets(lanes, node, 2, z), lanes.splat(0.0)),
        );
        let leaves = lanes.min(
            lanes.min(
                self.meets(lanes, node, 0, x_far),
                self.meets(lanes, node, 1, y_far),
            ),
            lanes.min(self.meets(lanes, node, 2, z_far), far),
        );
        // "Not larger" and "smaller" differ for boxes without depth only, and padding gives every box some.
        (lanes.less(enters, leaves), enters)
    }

    /// How far along the ray it meets a plane of each child.
    #[inline(always)]
    fn meets(&self, lanes: L, node: &Node, axis: usize, plane: usize) -> L::Floats {
        lanes.mul_sub(
            lanes.load(&node.planes[plane]),
            self.inverse[axis],
            self.start[axis],
        )
    }
}

/// For each octant of directions the bits of a mask, moved from slot `i ^ octant` to `i`.
pub(super) const ORDER: [[u8; 256]; LANES] = {
    let mut order = [[0; 256]; LANES];
    let mut octant = 0;
    while octant < LANES {
        let mut mask = 0;
        while mask < 256 {
            let mut bit = 0;
            while bit < LANES {
                order[octant][mask] |= (((mask >> (bit ^ octant)) & 1) as u8) << bit;
                bit += 1;
            }
            mask += 1;
        }
        octant += 1;
    }
    order
};

//! Eight segments against the boxes of a node: first all of them as one against eight boxes, then each against those that are left.

use super::bundle::Bundle;
use super::lanes::{LANES, Lanes, Row};
use super::wide::Node;

/// Segments, ready for boxes.
pub(super) struct Boxes<L: Lanes> {
    inverse: [L::Floats; 3],
    /// Where the segments start, times `inverse`.
    start: [L::Floats; 3],
    pub(super) far: L::Floats,
    hull: Hull<L>,
}

impl<L: Lanes> Boxes<L> {
    #[inline(always)]
    pub(super) fn new(lanes: L, bundle: &Bundle) -> Self {
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
    pub(super) fn test(&self, lanes: L, node: &Node, active: u32) -> u64 {
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
    let (mut least, mut most) = (*row, *row);
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            let (a, b) = (least[lane], least[lane + half]);
            least[lane] = if a < b { a } else { b };
            let (a, b) = (most[lane], most[lane + half]);
            most[lane] = if a > b { a } else { b };
        }
        half /= 2;
    }
    (least[0], most[0])
}

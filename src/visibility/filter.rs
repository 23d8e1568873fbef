//! Rays against triangles in `f32`, eight pairs at a time: clearly missed, clearly passed inside, or to be asked of the exact test.
//!
//! The test is the exact one's (see `triangle`), with a bound on its rounding. It does not matter which rays meet which triangles: one
//! ray is held against eight triangles, or eight rays against one. Whether products are fused moves a pair at most between "clearly" and
//! "the rest".

use super::lanes::{Lanes, Row};

/// Units of rounding: half the distance from 1 to the next smaller `f32`, twice that to the next larger.
pub(super) const UNIT: f32 = 1.0 / (1 << 24) as f32;

/// How far an edge function may be off, in units of the vertices' distances from the line.
///
/// With vertices within 1 and the start within 2 of the centre, a vertex relative to the start is off by 3.5 [`UNIT`]s (each of the two
/// is rounded, and so is their difference, at most 3), and by 14.5 after shearing (the same again for the longest axis, 1.5 for the
/// shear factor, 2 and 4 for product and difference). An edge function is a difference of products of two such numbers, each at most 6,
/// and is rounded itself: 14.5 + 12. This is 32. Smaller leaks light; larger calls the exact test more often.
const EDGE_DOUBT: f32 = 32.0 * UNIT;

/// The product of two errors, which counts where the vertices lie on the line: 2 · 14.5² units squared.
const POINT_DOUBT: f32 = 1024.0 * UNIT * UNIT;

/// How far a depth along the longest axis may be off: 3.5 units for a vertex, 6 for the end of the ray, as much again for sums.
const DEPTH_DOUBT: f32 = 128.0 * UNIT;

/// How far the height of an end above the plane, times the area, may be off, in units of what an edge function may be: three of them,
/// each times a depth of at most 9, is 27.
const PLANE_DOUBT: f32 = 64.0;

/// No ray is longer than this within the scene.
const LONGEST: f32 = 6.0;

/// What is known about eight pairs of a ray and a triangle, one bit each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Verdict {
    /// Not clearly missed.
    pub(super) possible: u32,
    /// Those among them whose line clearly goes through the inside, wherever the ends of the ray may be.
    pub(super) inside: u32,
}

/// Where a ray starts and how it is sheared so that it becomes its longest axis; one for all lanes or one for each.
pub(super) struct Filter<L: Lanes> {
    axes: [usize; 3],
    /// In the order of `axes`.
    origin: [L::Floats; 3],
    shear: [L::Floats; 2],
    /// The direction along the longest axis.
    along: L::Floats,
}

/// A triangle seen along the ray.
struct Seen<L: Lanes> {
    /// Twice the areas that the ray spans with the edges.
    edges: [L::Floats; 3],
    depths: [L::Floats; 3],
    /// How far `edges` may be off.
    doubt: L::Floats,
    /// How far inside the ray passes, towards either side of the triangle.
    inside: L::Floats,
}

impl<L: Lanes> Filter<L> {
    /// One ray: where it starts, its longest axis and the two others, the factors that shear it onto the first, and its direction along
    /// that.
    #[inline(always)]
    pub(super) fn one(
        lanes: L,
        origin: [f32; 3],
        (axes, shear): ([usize; 3], [f32; 2]),
        along: f32,
    ) -> Self {
        Self {
            axes,
            origin: [
                lanes.splat(origin[axes[0]]),
                lanes.splat(origin[axes[1]]),
                lanes.splat(origin[axes[2]]),
            ],
            shear: [lanes.splat(shear[0]), lanes.splat(shear[1])],
            along: lanes.splat(along),
        }
    }

    /// Eight rays that share their longest axis.
    #[inline(always)]
    pub(super) fn eight(
        lanes: L,
        origin: &[Row; 3],
        (axes, shear): ([usize; 3], &[Row; 2]),
        along: &Row,
    ) -> Self {
        let [z, x, y] = axes;
        Self {
            axes,
            origin: [
                lanes.load(&origin[z]),
                lanes.load(&origin[x]),
                lanes.load(&origin[y]),
            ],
            shear: [lanes.load(&shear[0]), lanes.load(&shear[1])],
            along: lanes.load(along),
        }
    }

    /// Sorts the triangles whose vertex `i` has the coordinate `corner(i, axis)`, for rays of `length`.
    #[inline(always)]
    pub(super) fn test(
        &self,
        lanes: L,
        corner: impl Fn(usize, usize) -> L::Floats,
        length: L::Floats,
    ) -> Verdict {
        let seen = self.see(lanes, corner);
        let near = lanes.less(lanes.sub(lanes.splat(0.0), seen.doubt), seen.inside);
        if near == 0 {
            return Verdict {
                possible: 0,
                inside: 0,
            };
        }
        let possible = near & !self.beyond(lanes, &seen, length);
        Verdict {
            possible,
            inside: possible & lanes.less(lanes.add(seen.doubt, seen.doubt), seen.inside),
        }
    }

    #[inline(always)]
    fn see(&self, lanes: L, corner: impl Fn(usize, usize) -> L::Floats) -> Seen<L> {
        let a = self.vertex(lanes, |axis| corner(0, axis));
        let b = self.vertex(lanes, |axis| corner(1, axis));
        let c = self.vertex(lanes, |axis| corner(2, axis));
        let (u, v, w) = (edge(lanes, c, b), edge(lanes, a, c), edge(lanes, b, a));
        let distances = lanes.add(lanes.add(away(lanes, a), away(lanes, b)), away(lanes, c));
        let lowest = lanes.min(lanes.min(u, v), w);
        let highest = lanes.max(lanes.max(u, v), w);
        Seen {
            edges: [u, v, w],
            depths: [a[2], b[2], c[2]],
            doubt: lanes.mul_add(distances, lanes.splat(EDGE_DOUBT), lanes.splat(POINT_DOUBT)),
            inside: lanes.max(lowest, lanes.sub(lanes.splat(0.0), highest)),
        }
    }

    /// A vertex seen along the ray, and how deep it lies.
    #[inline(always)]
    fn vertex(&self, lanes: L, corner: impl Fn(usize) -> L::Floats) -> [L::Floats; 3] {
        let [z, x, y] = self.axes;
        let depth = lanes.sub(corner(z), self.origin[0]);
        let right = lanes.sub(corner(x), self.origin[1]);
        let up = lanes.sub(corner(y), self.origin[2]);
        [
            lanes.neg_mul_add(self.shear[0], depth, right),
            lanes.neg_mul_add(self.shear[1], depth, up),
            depth,
        ]
    }

    /// Triangles that clearly lie before the start of the rays or behind their end.
    #[inline(always)]
    fn beyond(&self, lanes: L, seen: &Seen<L>, length: L::Floats) -> u32 {
        let zero = lanes.splat(0.0);
        let slack = lanes.splat(DEPTH_DOUBT);
        let [u, v, w] = seen.edges;
        // All depths below grow along the ray.
        let end = lanes.mul(
            lanes.min(length, lanes.splat(LONGEST)),
            lanes.abs(self.along),
        );
        let depths = [
            lanes.signed_by(seen.depths[0], self.along),
            lanes.signed_by(seen.depths[1], self.along),
            lanes.signed_by(seen.depths[2], self.along),
        ];
        let nearest = lanes.min(lanes.min(depths[0], depths[1]), depths[2]);
        let farthest = lanes.max(lanes.max(depths[0], depths[1]), depths[2]);
        // How far, by the vertices.
        let outside = lanes.max(lanes.sub(zero, farthest), lanes.sub(nearest, end));
        // The same, times the area seen along the ray, by the plane.
        let sum = lanes.add(lanes.add(u, v), w);
        let area = lanes.abs(sum);
        let crossed = lanes.mul_add(
            u,
            depths[0],
            lanes.mul_add(v, depths[1], lanes.mul(w, depths[2])),
        );
        let crossed = lanes.signed_by(crossed, sum);
        let outside_by_plane = lanes.max(
            lanes.sub(zero, crossed),
            lanes.neg_mul_add(end, area, crossed),
        );
        let plane_doubt =
            lanes.mul_add(seen.doubt, lanes.splat(PLANE_DOUBT), lanes.mul(area, slack));
        lanes.less(slack, outside)
            | lanes.less(plane_doubt, outside_by_plane)
                & lanes.less(lanes.mul(seen.doubt, lanes.splat(4.0)), area)
    }
}

/// Twice the area spanned by the ray and the edge from `p` to `q`, seen along the ray.
#[inline(always)]
fn edge<L: Lanes>(lanes: L, p: [L::Floats; 3], q: [L::Floats; 3]) -> L::Floats {
    lanes.mul_sub(p[0], q[1], lanes.mul(p[1], q[0]))
}

/// Distance of `p` from the ray, seen along it, as the sum of both coordinates.
#[inline(always)]
fn away<L: Lanes>(lanes: L, p: [L::Floats; 3]) -> L::Floats {
    lanes.add(lanes.abs(p[0]), lanes.abs(p[1]))
}

//! A tree of eight children per node, and triangles in packets of eight.
//!
//! A ray is held against eight boxes, or eight triangles, at once and in `f32`. Boxes are padded, so that no box is skipped that the ray
//! touches. Triangles are sorted into three: those that the ray clearly misses, those that it clearly crosses, and the rest, about
//! which the caller must ask the exact test; whether products are fused moves a triangle at most between "clearly" and "the rest".
//!
//! Source of the collapse: I. Wald, C. Benthin and S. Boulos, "Getting rid of packets: efficient SIMD single-ray traversal using
//! multi-branching BVHs", IEEE Symposium on Interactive Ray Tracing, 2008.

use std::ops::Range;

use glam::{DVec3, Vec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;

use super::lanes::{LANES, Lanes, Row};

/// Units of rounding: half the distance from 1 to the next smaller `f32`, twice that to the next larger.
const UNIT: f32 = 1.0 / (1 << 24) as f32;

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

/// Directions whose components are smaller than this are moved to it: 12 units off within the scene, and no division by zero.
const SMALLEST_COMPONENT: f32 = 2.0 * UNIT;

/// No ray is longer than this within the scene.
const LONGEST: f32 = 6.0;

/// Up to this depth no memory is asked for. Levels have ten.
const SHALLOW: usize = 48;

/// Marks a child that is a packet.
const PACKET: u32 = 1 << 31;

/// Boxes of eight children. Those that are missing are turned inside out: no ray touches them.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
struct Node {
    /// Lower x, y, z, then upper.
    planes: [Row; 6],
    /// Index of a node, or of a packet with [`PACKET`].
    children: [u32; LANES],
}

/// Eight triangles, those that are missing NaN.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
struct Packet {
    /// Vertex, axis, lane.
    vertices: [[Row; 3]; 3],
    /// Place of the first triangle in the order of the leaves.
    first: u32,
}

/// The tree.
#[derive(Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    packets: Vec<Packet>,
    /// Nodes on the longest way from the root to a packet.
    depth: usize,
}

impl std::fmt::Debug for Tree {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "Tree({} nodes, {} packets)",
            self.nodes.len(),
            self.packets.len()
        )
    }
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
    /// Height above a triangle's plane, times the triangle's area, that is clearly more than the exact test allows for rounding.
    height: f32,
}

/// Triangles of a packet that a ray may cross.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidates {
    /// Place of the packet's first triangle.
    pub(super) first: u32,
    /// One bit for each triangle that is not clearly missed.
    pub(super) possible: u32,
    /// Those among them that are clearly crossed, far from both ends of the ray.
    pub(super) certain: u32,
}

impl Candidates {
    /// Places of the triangles, and whether they are certain.
    #[inline(always)]
    pub(super) fn each(self) -> impl Iterator<Item = (usize, bool)> {
        let mut left = self.possible;
        std::iter::from_fn(move || {
            (left != 0).then(|| {
                let lane = left.trailing_zeros();
                left &= left - 1;
                (
                    self.first as usize + lane as usize,
                    self.certain >> lane & 1 == 1,
                )
            })
        })
    }
}

impl Ray {
    /// A ray from `origin`, within 2 of the centre, along a unit direction; `axes` and `shear` as for the exact test.
    #[inline(always)]
    pub(super) fn new(
        origin: Vec3,
        direction: Vec3,
        axes: [usize; 3],
        shear: [f64; 2],
        height: f64,
    ) -> Self {
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
            height: height as f32,
        }
    }
}

impl Tree {
    /// Collapses `bvh`, whose node `i` holds the places `ranges[i]` of `triangles`. `point` moves a vertex to the frame of the tree,
    /// `bounds` is the padded box of a triangle there.
    pub(super) fn collapse(
        bvh: &Bvh2,
        ranges: &[Range<u32>],
        triangles: &[[DVec3; 3]],
        point: impl Fn(DVec3) -> DVec3,
        bounds: impl Fn(&[DVec3; 3]) -> Aabb,
    ) -> Self {
        let bounds = |place: u32| bounds(&triangles[place as usize]);
        let mut tree = Self::default();
        let Some(root) = bvh.nodes.first() else {
            return tree;
        };
        let root = Part {
            bounds: *root.aabb(),
            places: ranges[0].clone(),
            node: Some(0),
        };
        let mut waiting = vec![(root, 0, 0)];
        tree.nodes.push(Node::EMPTY);
        let mut depth = 0;
        while let Some((part, slot, level)) = waiting.pop() {
            depth = depth.max(level + 1);
            let parts = part.spread(bvh, ranges, &bounds);
            let slots = slots(&part, &parts);
            for (lane, part) in slots.into_iter().zip(parts) {
                let child = if part.is_packet() {
                    tree.packets
                        .push(Packet::new(part.places.clone(), triangles, &point));
                    PACKET | (tree.packets.len() - 1) as u32
                } else {
                    tree.nodes.push(Node::EMPTY);
                    let child = tree.nodes.len() - 1;
                    waiting.push((part.clone(), child, level + 1));
                    child as u32
                };
                tree.nodes[slot].set(lane, &part.bounds, child);
            }
        }
        tree.depth = depth;
        tree
    }

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
        let sheared = Sheared::new(lanes, ray);
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
                let candidates = sheared.test(lanes, packet, length);
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
        let sheared = Sheared::new(lanes, ray);
        let mut pending = 1;
        while pending > 0 {
            pending -= 1;
            let (child, entry) = stack[pending];
            if entry > length {
                continue;
            }
            if child & PACKET != 0 {
                let packet = &self.packets[(child & !PACKET) as usize];
                let candidates = sheared.test(lanes, packet, length);
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

/// A ray, ready for triangles: the shear that makes it an axis (see `triangle`).
struct Sheared<L: Lanes> {
    origin: [L::Floats; 3],
    shear: [L::Floats; 2],
    axes: [usize; 3],
    along: f32,
    height: f32,
}

impl<L: Lanes> Sheared<L> {
    #[inline(always)]
    fn new(lanes: L, ray: &Ray) -> Self {
        let [z, x, y] = ray.axes;
        Self {
            origin: [
                lanes.splat(ray.origin[z]),
                lanes.splat(ray.origin[x]),
                lanes.splat(ray.origin[y]),
            ],
            shear: [lanes.splat(ray.shear[0]), lanes.splat(ray.shear[1])],
            axes: ray.axes,
            along: ray.along,
            height: ray.height,
        }
    }

    /// Vertices seen along the ray, and how deep they lie.
    #[inline(always)]
    fn vertex(&self, lanes: L, corner: &[Row; 3]) -> [L::Floats; 3] {
        let [z, x, y] = self.axes;
        let depth = lanes.sub(lanes.load(&corner[z]), self.origin[0]);
        let right = lanes.sub(lanes.load(&corner[x]), self.origin[1]);
        let up = lanes.sub(lanes.load(&corner[y]), self.origin[2]);
        [
            lanes.neg_mul_add(self.shear[0], depth, right),
            lanes.neg_mul_add(self.shear[1], depth, up),
            depth,
        ]
    }

    /// Sorts the triangles of `packet`, for a ray of `length`.
    #[inline(always)]
    fn test(&self, lanes: L, packet: &Packet, length: f32) -> Candidates {
        let a = self.vertex(lanes, &packet.vertices[0]);
        let b = self.vertex(lanes, &packet.vertices[1]);
        let c = self.vertex(lanes, &packet.vertices[2]);
        let (u, v, w) = (edge(lanes, c, b), edge(lanes, a, c), edge(lanes, b, a));
        let distances = lanes.add(lanes.add(away(lanes, a), away(lanes, b)), away(lanes, c));
        let doubt = lanes.mul_add(distances, lanes.splat(EDGE_DOUBT), lanes.splat(POINT_DOUBT));
        let lowest = lanes.min(lanes.min(u, v), w);
        let highest = lanes.max(lanes.max(u, v), w);
        // How far inside, towards either side of the triangle.
        let zero = lanes.splat(0.0);
        let inside = lanes.max(lowest, lanes.sub(zero, highest));
        let near = lanes.less(lanes.sub(zero, doubt), inside);
        if near == 0 {
            return Candidates {
                first: packet.first,
                possible: 0,
                certain: 0,
            };
        }

        // All depths below grow along the ray.
        let forward = lanes.splat(1f32.copysign(self.along));
        let end = lanes.splat(length.min(LONGEST) * self.along.abs());
        let depths = [
            lanes.mul(a[2], forward),
            lanes.mul(b[2], forward),
            lanes.mul(c[2], forward),
        ];
        let nearest = lanes.min(lanes.min(depths[0], depths[1]), depths[2]);
        let farthest = lanes.max(lanes.max(depths[0], depths[1]), depths[2]);
        // How far beyond an end of the ray, by the vertices.
        let outside = lanes.max(lanes.sub(zero, farthest), lanes.sub(nearest, end));
        let margin = lanes.min(nearest, lanes.sub(end, farthest));
        // The same, times the area seen along the ray, by the plane.
        let sum = lanes.add(lanes.add(u, v), w);
        let area = lanes.abs(sum);
        let crossed = lanes.mul_add(
            u,
            depths[0],
            lanes.mul_add(v, depths[1], lanes.mul(w, depths[2])),
        );
        let crossed = lanes.signed_by(crossed, sum);
        let beyond = lanes.neg_mul_add(end, area, crossed);
        let outside_by_plane = lanes.max(lanes.sub(zero, crossed), beyond);
        let plane_doubt = lanes.mul_add(
            doubt,
            lanes.splat(PLANE_DOUBT),
            lanes.mul(area, lanes.splat(DEPTH_DOUBT)),
        );
        let slack = lanes.splat(DEPTH_DOUBT);
        let missed = lanes.less(slack, outside)
            | lanes.less(plane_doubt, outside_by_plane)
                & lanes.less(lanes.mul(doubt, lanes.splat(4.0)), area);
        let possible = near & !missed;

        let high = lanes.splat(self.height);
        let within = lanes.less(lanes.add(doubt, doubt), inside);
        let by_vertices = lanes.less(slack, margin)
            & lanes.less(high, lanes.mul(lanes.mul(area, lanes.splat(0.5)), margin));
        let by_plane = lanes.less(
            lanes.add(plane_doubt, high),
            lanes.sub(zero, outside_by_plane),
        );
        Candidates {
            first: packet.first,
            possible,
            certain: possible & within & (by_vertices | by_plane),
        }
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

/// How far the height of an end above the plane, times the area, may be off, in units of what an edge function may be: three of them,
/// each times a depth of at most 9, is 27.
const PLANE_DOUBT: f32 = 64.0;

impl Node {
    const EMPTY: Self = Self {
        planes: [
            [f32::INFINITY; LANES],
            [f32::INFINITY; LANES],
            [f32::INFINITY; LANES],
            [f32::NEG_INFINITY; LANES],
            [f32::NEG_INFINITY; LANES],
            [f32::NEG_INFINITY; LANES],
        ],
        children: [0; LANES],
    };

    fn set(&mut self, lane: usize, bounds: &Aabb, child: u32) {
        for axis in 0..3 {
            self.planes[axis][lane] = bounds.min[axis];
            self.planes[axis + 3][lane] = bounds.max[axis];
        }
        self.children[lane] = child;
    }
}

impl Packet {
    fn new(places: Range<u32>, triangles: &[[DVec3; 3]], point: &impl Fn(DVec3) -> DVec3) -> Self {
        let mut packet = Self {
            vertices: [[[f32::NAN; LANES]; 3]; 3],
            first: places.start,
        };
        for (lane, place) in places.enumerate() {
            for (corner, vertex) in triangles[place as usize].iter().enumerate() {
                let vertex = point(*vertex).as_vec3();
                for axis in 0..3 {
                    packet.vertices[corner][axis][lane] = vertex[axis];
                }
            }
        }
        packet
    }
}

/// For each octant of directions the bits of a mask, moved from slot `i ^ octant` to `i`.
const ORDER: [[u8; 256]; LANES] = {
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

/// A slot for each of `parts`, which make up `whole`, so that slot 0 lies towards the lower corner, 1, 2 and 4 towards higher x, y and
/// z: slots in the order of `i ^ octant` are met front to back, more or less, by rays of that octant. The part that lies farthest to
/// some corner chooses first.
///
/// Source: H. Ylitie, T. Karras and S. Laine, "Efficient incoherent ray traversal on GPUs through compressed wide BVHs", HPG 2017.
fn slots(whole: &Part, parts: &[Part]) -> Vec<usize> {
    let mut wishes = Vec::with_capacity(parts.len() * LANES);
    for (index, part) in parts.iter().enumerate() {
        let offset = part.bounds.center() - whole.bounds.center();
        for slot in 0..LANES {
            let towards = |axis: usize| if slot >> axis & 1 == 1 { 1.0 } else { -1.0 };
            let corner = Vec3::new(towards(0), towards(1), towards(2));
            wishes.push((Vec3::from(offset).dot(corner), index, slot));
        }
    }
    wishes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen = vec![LANES; parts.len()];
    let mut taken = [false; LANES];
    for (_, index, slot) in wishes {
        if chosen[index] == LANES && !taken[slot] {
            chosen[index] = slot;
            taken[slot] = true;
        }
    }
    chosen
}

/// A part of the scene that will hang on one child.
#[derive(Clone)]
struct Part {
    bounds: Aabb,
    places: Range<u32>,
    /// The binary node that holds these places and no others, if there is one.
    node: Option<u32>,
}

impl Part {
    fn is_packet(&self) -> bool {
        self.places.len() <= LANES
    }

    /// Up to eight parts that make up this one: the largest box is opened, again and again, until there are eight.
    fn spread(
        &self,
        bvh: &Bvh2,
        ranges: &[Range<u32>],
        bounds: &impl Fn(u32) -> Aabb,
    ) -> Vec<Self> {
        let mut parts = vec![self.clone()];
        while parts.len() < LANES {
            let largest = (0..parts.len())
                .filter(|&index| !parts[index].is_packet())
                .max_by(|&a, &b| {
                    let area = |index: usize| parts[index].bounds.half_area();
                    area(a).total_cmp(&area(b))
                });
            let Some(index) = largest else { break };
            let [first, second] = parts[index].halves(bvh, ranges, bounds);
            parts[index] = first;
            parts.insert(index + 1, second);
        }
        parts
    }

    fn halves(
        &self,
        bvh: &Bvh2,
        ranges: &[Range<u32>],
        bounds: &impl Fn(u32) -> Aabb,
    ) -> [Self; 2] {
        if let Some(node) = self.node.map(|node| &bvh.nodes[node as usize])
            && !node.is_leaf()
        {
            return [node.first_index, node.first_index + 1].map(|child| Self {
                bounds: *bvh.nodes[child as usize].aabb(),
                places: ranges[child as usize].clone(),
                node: Some(child),
            });
        }
        // A leaf of more triangles than fit: equal boxes, mostly.
        let Range { start, end } = self.places;
        let half = (end - start).div_ceil(2).next_multiple_of(LANES as u32);
        let middle = (start + half).min(end);
        [start..middle, middle..end].map(|places| Self {
            bounds: places
                .clone()
                .map(bounds)
                .fold(Aabb::empty(), |sum, part| sum.union(&part)),
            places,
            node: None,
        })
    }
}

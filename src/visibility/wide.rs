//! A tree of eight children per node, and triangles in packets of eight.
//!
//! Boxes are padded, so that none is skipped that a ray touches.
//!
//! Source of the collapse: I. Wald, C. Benthin and S. Boulos, "Getting rid of packets: efficient SIMD single-ray traversal using
//! multi-branching BVHs", IEEE Symposium on Interactive Ray Tracing, 2008.

use std::ops::Range;

use glam::{DVec3, Vec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;

use super::lanes::{LANES, Row};

/// Marks a child that is a packet.
pub(super) const PACKET: u32 = 1 << 31;

/// Boxes of eight children. Those that are missing are turned inside out: no ray touches them.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub(super) struct Node {
    /// Lower x, y, z, then upper.
    pub(super) planes: [Row; 6],
    /// Index of a node, or of a packet with [`PACKET`].
    pub(super) children: [u32; LANES],
    /// A byte of ones for each child that is not missing.
    pub(super) present: u64,
}

/// Eight triangles, those that are missing NaN.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub(super) struct Packet {
    /// Vertex, axis, lane.
    pub(super) vertices: [[Row; 3]; 3],
    /// Place of the first triangle in the order of the leaves.
    pub(super) first: u32,
    pub(super) count: u32,
    /// One bit for each triangle that stops light wherever it is crossed.
    pub(super) opaque: u32,
}

/// The tree.
#[derive(Default)]
pub(super) struct Tree {
    pub(super) nodes: Vec<Node>,
    pub(super) packets: Vec<Packet>,
    /// Nodes on the longest way from the root to a packet.
    pub(super) depth: usize,
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

impl Tree {
    /// Collapses `bvh`, whose node `i` holds the places `ranges[i]` of `triangles`. `point` moves a vertex to the frame of the tree,
    /// `bounds` is the padded box of a triangle there; `opaque` tells of a place whether its triangle stops light wherever it is crossed.
    pub(super) fn collapse(
        bvh: &Bvh2,
        ranges: &[Range<u32>],
        triangles: &[[DVec3; 3]],
        point: impl Fn(DVec3) -> DVec3,
        bounds: impl Fn(&[DVec3; 3]) -> Aabb,
        opaque: impl Fn(u32) -> bool,
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
                        .push(Packet::new(part.places.clone(), triangles, &point, &opaque));
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
}

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
        present: 0,
    };

    fn set(&mut self, lane: usize, bounds: &Aabb, child: u32) {
        for axis in 0..3 {
            self.planes[axis][lane] = bounds.min[axis];
            self.planes[axis + 3][lane] = bounds.max[axis];
        }
        self.children[lane] = child;
        self.present |= 0xff << (8 * lane);
    }
}

impl Packet {
    fn new(
        places: Range<u32>,
        triangles: &[[DVec3; 3]],
        point: &impl Fn(DVec3) -> DVec3,
        opaque: &impl Fn(u32) -> bool,
    ) -> Self {
        let mut packet = Self {
            vertices: [[[f32::NAN; LANES]; 3]; 3],
            first: places.start,
            count: places.len() as u32,
            opaque: 0,
        };
        for (lane, place) in places.enumerate() {
            packet.opaque |= u32::from(opaque(place)) << lane;
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

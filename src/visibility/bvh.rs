//! Bounding volume hierarchy over the occluding triangles.
//!
//! `obvhs` builds a binary tree; rays walk it collapsed to eight children per node (see `wide`), in `f32`, and what they do not settle
//! is tested in `f64`. So that the coarse walk never skips what the fine test would hit, it runs in a frame where the scene fills the
//! cube from -1 to 1, whatever its size and place, rays that start outside are moved to the cube first, and every box is larger than
//! its triangles by [`PADDING`].
//!
//! The builder takes quadratic time when thousands of boxes are equal. Triangles with equal boxes (duplicates, the two halves of an
//! axis-parallel rectangle, detail too fine for `f32`) therefore share one leaf entry.
//!
//! Source of the builder: D. Meister and J. Bittner, "Parallel locally-ordered clustering for bounding volume hierarchy construction",
//! IEEE TVCG 24(3), 2018.

use std::ops::Range;
use std::sync::OnceLock;
use std::time::Duration;

use glam::{DVec3, Vec3};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;

use super::lanes::{Kernel, Lanes, Machine};
use super::surface;
use super::triangle::{self, Line};
use super::wide;
use super::{Edges, Hit, Shaft, Visibility};
use crate::math::Aabb;
use crate::scene::Scene;

/// How much larger than its triangles a box is, in units of half the scene.
///
/// A ray starts within 2 of the centre and meets the scene within a distance of 6. In units of 2⁻²⁴, half a step of `f32` at 1, it may
/// be off by 2 (origin) + 12 (direction; components below 2⁻²³ are moved to 2⁻²³) + 9 (slab arithmetic) + 1 (the box): 24.
/// This is 32. Smaller leaks light; larger opens more boxes.
const PADDING: f64 = 1.0 / (1u64 << 19) as f64;

/// Rays that start farther than this from the centre are moved to the cube of [`ENTRY`], both in units of half the scene.
const FAR: f64 = 2.0;

/// Half side of the cube to which far rays are moved: larger than the scene with its padding, smaller than [`FAR`].
const ENTRY: f64 = 1.5;

/// Up to this many triangles in a shaft are examined more closely. It is emptiness that counts: a shaft of many triangles hardly
/// becomes empty, and looking closely costs about as much as finding a triangle.
const FEW: usize = 32;

/// The occluding triangles of a scene.
#[derive(Debug)]
pub struct Occluders<'a> {
    scene: &'a Scene,
    /// Whether a crossed triangle must be asked for its alpha.
    masked: bool,
    frame: Frame,
    /// For shafts.
    bvh: Tree,
    /// Per node of `bvh` the places of its triangles in `vertices`.
    ranges: Vec<Range<u32>>,
    /// For rays.
    wide: wide::Tree,
    machine: Machine,
    /// World vertices in the order of the leaves.
    vertices: Vec<[DVec3; 3]>,
    /// Index in [`Scene::triangles`] for each of `vertices`.
    ids: Vec<u32>,
    edges: OnceLock<Edges>,
}

/// `Bvh2` with a `Debug` that does not print a million nodes.
struct Tree(Bvh2);

impl std::fmt::Debug for Tree {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Bvh2({} nodes)", self.0.nodes.len())
    }
}

/// Maps the scene's box into the cube from -1 to 1.
#[derive(Clone, Copy, Debug)]
struct Frame {
    centre: DVec3,
    /// A power of two, so that scaling rounds nothing.
    scale: f64,
}

/// A ray in the frame of the tree.
struct Walk {
    start: Vec3,
    direction: Vec3,
    /// Distance in the frame by which the start was moved.
    skipped: f64,
    /// How far it goes, from the moved start.
    length: f32,
}

impl<'a> Occluders<'a> {
    /// Builds the hierarchy over everything in `scene` that is not blended. The same scene gives the same tree on any number of threads.
    #[must_use]
    pub fn build(scene: &'a Scene) -> Self {
        let mut occluding = surface::occluding(scene);
        let vertices_of = |id: u32| scene.triangles[id as usize].vertices;
        let bounds = Aabb::from_points(occluding.iter().flat_map(|&id| vertices_of(id)));
        let frame = Frame::new(&bounds);
        occluding.retain(|&id| frame.holds(&vertices_of(id)));
        let leaf_entries = Entries::of(&occluding, |id| frame.bounds(&vertices_of(id)));
        let bvh = if occluding.is_empty() {
            Bvh2::default()
        } else {
            build_bvh2(
                &leaf_entries.boxes,
                BvhBuildParams::medium_build(),
                &mut Duration::default(),
            )
        };
        let (ranges, ids) = in_order(&bvh, &leaf_entries);
        let vertices: Vec<_> = ids.iter().map(|&id| vertices_of(id)).collect();
        let wide = wide::Tree::collapse(
            &bvh,
            &ranges,
            &vertices,
            |point| frame.point(point),
            |triangle| frame.bounds(triangle),
        );
        Self {
            scene,
            masked: surface::has_mask(scene),
            edges: OnceLock::new(),
            frame,
            bvh: Tree(bvh),
            ranges,
            wide,
            machine: Machine::best(),
            vertices,
            ids,
        }
    }

    /// Whether alpha decides where `triangle` (an index in `Scene::triangles`) stops light.
    #[must_use]
    pub fn is_masked(&self, triangle: u32) -> bool {
        self.masked && surface::is_masked(self.scene, triangle)
    }

    /// The welded edges of all triangles of the scene; built when first asked for.
    #[must_use]
    pub fn edges(&self) -> &Edges {
        self.edges.get_or_init(|| Edges::build(self.scene))
    }

    /// Triangles that may stand in `shaft`, those accepted by `ignore` excepted, ascending. Never misses one that does.
    #[must_use]
    pub fn in_shaft(&self, shaft: &Shaft, ignore: &dyn Fn(u32) -> bool) -> Vec<u32> {
        let mut found = Vec::new();
        let nodes = &self.bvh.0.nodes;
        if nodes.is_empty() {
            return found;
        }
        let cull = shaft.in_frame(self.frame.centre, self.frame.scale);
        let mut stack = Vec::with_capacity(64);
        stack.push((0, cull.all_planes()));
        while let Some((index, planes)) = stack.pop() {
            let node: &Bvh2Node = &nodes[index];
            let min = node.aabb().min.as_dvec3();
            let max = node.aabb().max.as_dvec3();
            let Some(planes) = cull.touches(min, max, planes) else {
                continue;
            };
            let first = node.first_index as usize;
            if node.is_leaf() {
                for place in self.ranges[index].clone() {
                    let id = self.ids[place as usize];
                    if shaft.may_be_hidden_by(&self.vertices[place as usize]) && !ignore(id) {
                        found.push(id);
                    }
                }
            } else {
                stack.push((first + 1, planes));
                stack.push((first, planes));
            }
        }
        if found.len() <= FEW {
            found.retain(|&id| shaft.reaches_inside(&self.scene.triangles[id as usize].vertices));
        }
        found.sort_unstable();
        found
    }

    fn stops(&self, id: u32, crossing: &triangle::Crossing) -> bool {
        !self.masked || surface::stops(self.scene, id, crossing)
    }
}

impl Visibility for Occluders<'_> {
    fn occluded(&self, from: DVec3, to: DVec3, ignore: &dyn Fn(u32) -> bool) -> bool {
        self.machine.run(Occluded {
            occluders: self,
            from,
            to,
            ignore,
        })
    }

    fn closest(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_distance: f64,
        ignore: &dyn Fn(u32) -> bool,
    ) -> Option<Hit> {
        self.machine.run(Closest {
            occluders: self,
            origin,
            direction,
            max_distance,
            ignore,
        })
    }
}

/// [`Visibility::occluded`] on eight lanes.
struct Occluded<'a> {
    occluders: &'a Occluders<'a>,
    from: DVec3,
    to: DVec3,
    ignore: &'a dyn Fn(u32) -> bool,
}

impl Kernel for Occluded<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> bool {
        let Self {
            occluders,
            from,
            to,
            ignore,
        } = self;
        let offset = to - from;
        let Some(line) = Line::new(from, offset) else {
            return false;
        };
        let Some(walk) = occluders.frame.segment(from, offset) else {
            return false;
        };
        let ray = walk.ray(&line, occluders.frame.height(from, to));
        occluders.wide.any(lanes, &ray, walk.length, |candidates| {
            for (place, certain) in candidates.each() {
                let id = occluders.ids[place];
                let stopped = if certain && !occluders.masked {
                    !ignore(id)
                } else {
                    triangle::separates(&occluders.vertices[place], &line, from, to)
                        .is_some_and(|crossing| !ignore(id) && occluders.stops(id, &crossing))
                };
                if stopped {
                    return true;
                }
            }
            false
        })
    }
}

/// [`Visibility::closest`] on eight lanes.
struct Closest<'a> {
    occluders: &'a Occluders<'a>,
    origin: DVec3,
    direction: DVec3,
    max_distance: f64,
    ignore: &'a dyn Fn(u32) -> bool,
}

impl Kernel for Closest<'_> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Option<Hit> {
        let Self {
            occluders,
            origin,
            direction,
            max_distance,
            ignore,
        } = self;
        let line = Line::new(origin, direction)?;
        let walk = occluders.frame.walk(origin, direction, max_distance)?;
        let ray = walk.ray(&line, f64::INFINITY);
        let mut best: Option<Hit> = None;
        let mut length = walk.length;
        occluders.wide.nearest(lanes, &ray, length, |candidates| {
            for (place, _) in candidates.each() {
                let Some((distance, front, crossing)) =
                    triangle::meets(&occluders.vertices[place], &line)
                else {
                    continue;
                };
                let id = occluders.ids[place];
                let nearer = distance <= max_distance
                    && best.is_none_or(|hit| (distance, id) < (hit.distance, hit.triangle));
                if nearer && !ignore(id) && occluders.stops(id, &crossing) {
                    best = Some(Hit {
                        distance,
                        triangle: id,
                        front,
                    });
                    length = walk.limit(distance * occluders.frame.scale);
                }
            }
            length
        });
        best
    }
}

impl Frame {
    fn new(bounds: &Aabb) -> Self {
        let centre = bounds.centre();
        let half = 0.5 * (bounds.max - bounds.min).max_element();
        if !(centre.is_finite() && half.is_normal() && half > 0.0) {
            return Self {
                centre: DVec3::ZERO,
                scale: 1.0,
            };
        }
        // Clamped so that neither the power nor its use leaves the range of `f64`.
        let exponent = half.log2().ceil().clamp(-1000.0, 1000.0);
        Self {
            centre,
            scale: (-exponent).exp2(),
        }
    }

    #[inline(always)]
    fn point(&self, point: DVec3) -> DVec3 {
        (point - self.centre) * self.scale
    }

    /// False only for coordinates beyond the range of [`Frame::new`], which no level has.
    fn holds(&self, triangle: &[DVec3; 3]) -> bool {
        triangle
            .iter()
            .all(|&vertex| self.point(vertex).abs().max_element() <= FAR)
    }

    fn bounds(&self, triangle: &[DVec3; 3]) -> obvhs::aabb::Aabb {
        let bounds = Aabb::from_points(triangle.iter().map(|&vertex| self.point(vertex)));
        obvhs::aabb::Aabb::new(
            (bounds.min - PADDING).as_vec3a(),
            (bounds.max + PADDING).as_vec3a(),
        )
    }

    /// The part of the segment from `from` to `from + offset` that can meet the scene; `None` when it misses the scene's cube.
    #[inline(always)]
    fn segment(&self, from: DVec3, offset: DVec3) -> Option<Walk> {
        let start = self.point(from);
        // In `f32` all components are off by one factor of at most 4 · 2⁻²⁴, which changes the length alone, and by 1 each.
        let direction = (offset * self.scale).as_vec3();
        let square = direction.length_squared();
        let near = start.abs().cmple(DVec3::splat(FAR)).all();
        if !near || !(1e-30..1e30).contains(&square) {
            return self.walk(from, offset.try_normalize()?, offset.length());
        }
        let length = square.sqrt();
        Some(Walk {
            start: start.as_vec3(),
            direction: direction / length,
            skipped: 0.0,
            length: length + PADDING as f32,
        })
    }

    /// The part of a ray that can meet the scene; `None` when it misses the scene's cube.
    #[inline(always)]
    fn walk(&self, origin: DVec3, direction: DVec3, length: f64) -> Option<Walk> {
        let mut start = self.point(origin);
        let mut skipped = 0.0;
        if start.abs().max_element() > FAR {
            for axis in 0..3 {
                let towards = -start[axis].signum() * direction[axis];
                let outside = start[axis].abs() - ENTRY;
                if outside > 0.0 {
                    if towards <= 0.0 {
                        return None;
                    }
                    skipped = f64::max(skipped, outside / towards);
                }
            }
            start += skipped * direction;
        }
        // False for what is not finite, too.
        if !start.abs().cmple(DVec3::splat(FAR)).all() {
            return None;
        }
        let mut walk = Walk {
            start: start.as_vec3(),
            direction: direction.as_vec3(),
            skipped,
            length: 0.0,
        };
        walk.length = walk.limit(length * self.scale);
        (walk.length > 0.0).then_some(walk)
    }

    /// More than the exact test allows for the rounding of a height above a plane, times the triangle's area, all in the frame, for a
    /// segment.
    ///
    /// It allows 2⁻⁴⁴ (s d + c a): s, a product of two edges, and a, twice an area, are at most 12 in the frame, d is the distance of an
    /// end from a vertex, c the largest coordinate. This is 10 times that. Smaller would decide what the exact test must; larger leaves it
    /// more to do.
    #[inline(always)]
    fn height(&self, from: DVec3, to: DVec3) -> f64 {
        let ends = (self.point(from).abs() + self.point(to).abs()).element_sum();
        let place = self.centre.abs().max_element() * self.scale;
        120.0 * (ends + place + 4.0) / (1u64 << 44) as f64
    }
}

impl Walk {
    #[inline(always)]
    fn ray(&self, line: &Line, height: f64) -> wide::Ray {
        let (axes, shear) = line.axes();
        wide::Ray::new(self.start, self.direction, axes, shear, height)
    }

    /// Distance in the frame at which the walk may stop, rounded up, so that equally near triangles are still looked at.
    fn limit(&self, distance: f64) -> f32 {
        (distance - self.skipped + PADDING) as f32
    }
}

/// Triangles in the order of the leaves, and for each node of `bvh` where its own lie in that order.
fn in_order(bvh: &Bvh2, entries: &Entries) -> (Vec<Range<u32>>, Vec<u32>) {
    let mut ids = Vec::with_capacity(entries.ids.len());
    let mut ranges = vec![0..0; bvh.nodes.len()];
    let mut stack = Vec::new();
    if !bvh.nodes.is_empty() {
        stack.push((0, false));
    }
    while let Some((index, done)) = stack.pop() {
        let node: &Bvh2Node = &bvh.nodes[index];
        let first = node.first_index as usize;
        if !done {
            ranges[index].start = ids.len() as u32;
            if node.is_leaf() {
                for &entry in &bvh.primitive_indices[first..first + node.prim_count as usize] {
                    ids.extend_from_slice(entries.triangles(entry));
                }
            } else {
                stack.extend([(index, true), (first + 1, false), (first, false)]);
            }
        }
        ranges[index].end = ids.len() as u32;
    }
    (ranges, ids)
}

/// Leaf entries: distinct boxes and, for each, the triangles that have it.
struct Entries {
    boxes: Vec<obvhs::aabb::Aabb>,
    /// Where the triangles of each box begin in `ids`; one more than boxes.
    starts: Vec<usize>,
    ids: Vec<u32>,
}

impl Entries {
    /// Groups `ids` by equal boxes, each group ascending.
    fn of(ids: &[u32], bounds: impl Fn(u32) -> obvhs::aabb::Aabb) -> Self {
        let key = |id: u32| {
            let bounds = bounds(id);
            [bounds.min.to_array(), bounds.max.to_array()].map(|corner| corner.map(f32::to_bits))
        };
        let mut keyed: Vec<_> = ids.iter().map(|&id| (key(id), id)).collect();
        keyed.sort_unstable();
        let mut entries = Self {
            boxes: Vec::new(),
            starts: Vec::new(),
            ids: keyed.iter().map(|&(_, id)| id).collect(),
        };
        for (index, (key, id)) in keyed.iter().enumerate() {
            if index == 0 || *key != keyed[index - 1].0 {
                entries.boxes.push(bounds(*id));
                entries.starts.push(index);
            }
        }
        entries.starts.push(keyed.len());
        entries
    }

    fn triangles(&self, entry: u32) -> &[u32] {
        let entry = entry as usize;
        &self.ids[self.starts[entry]..self.starts[entry + 1]]
    }
}

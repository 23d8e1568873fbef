//! Bounding volume hierarchy over the occluding triangles.
//!
//! `obvhs` builds the tree and walks it in `f32`; the triangles in its leaves are tested in `f64`. So that the coarse walk never skips
//! what the fine test would hit, it runs in a frame where the scene fills the cube from -1 to 1, whatever its size and place, rays that
//! start outside are moved to the cube first, and every box is larger than its triangles by [`PADDING`].
//!
//! The builder takes quadratic time when thousands of boxes are equal. Triangles with equal boxes (duplicates, the two halves of an
//! axis-parallel rectangle, detail too fine for `f32`) therefore share one leaf entry.
//!
//! Source of the builder: D. Meister and J. Bittner, "Parallel locally-ordered clustering for bounding volume hierarchy construction",
//! IEEE TVCG 24(3), 2018.

use std::ops::Range;
use std::sync::OnceLock;
use std::time::Duration;

use glam::DVec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::ray::{Ray, RayHit};

use super::surface;
use super::triangle::{self, Line};
use super::{Edges, Hit, Shaft, Visibility};
use crate::math::Aabb;
use crate::scene::Scene;

/// How much larger than its triangles a box is, in units of half the scene.
///
/// A ray starts within 2 of the centre and meets the scene within a distance of 6. In units of 2⁻²⁴, half a step of `f32` at 1, it may
/// be off by 2 (origin) + 12 (direction; `obvhs` moves components below 2⁻²³ to 2⁻²³) + 9 (slab arithmetic) + 1 (the box): 24.
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
    bvh: Tree,
    /// `entries[i]..entries[i + 1]` are the triangles of leaf entry `i`.
    entries: Vec<u32>,
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
    ray: Ray,
    /// Distance in the frame by which the start was moved.
    skipped: f64,
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
        let mut entries = vec![0];
        let mut ids = Vec::with_capacity(occluding.len());
        for &entry in &bvh.primitive_indices {
            ids.extend_from_slice(leaf_entries.triangles(entry));
            entries.push(ids.len() as u32);
        }
        Self {
            scene,
            masked: surface::has_mask(scene),
            edges: OnceLock::new(),
            frame,
            bvh: Tree(bvh),
            entries,
            vertices: ids.iter().map(|&id| vertices_of(id)).collect(),
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
        while let Some((node, planes)) = stack.pop() {
            let node: &Bvh2Node = &nodes[node];
            let min = node.aabb().min.as_dvec3();
            let max = node.aabb().max.as_dvec3();
            let Some(planes) = cull.touches(min, max, planes) else {
                continue;
            };
            let first = node.first_index as usize;
            if node.is_leaf() {
                for index in self.triangles_of(first..first + node.prim_count as usize) {
                    let id = self.ids[index];
                    if shaft.may_be_hidden_by(&self.vertices[index]) && !ignore(id) {
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

    fn triangles_of(&self, entries: Range<usize>) -> Range<usize> {
        self.entries[entries.start] as usize..self.entries[entries.end] as usize
    }

    fn stops(&self, id: u32, crossing: &triangle::Crossing) -> bool {
        !self.masked || surface::stops(self.scene, id, crossing)
    }
}

impl Visibility for Occluders<'_> {
    fn occluded(&self, from: DVec3, to: DVec3, ignore: &dyn Fn(u32) -> bool) -> bool {
        let Some(line) = Line::new(from, to - from) else {
            return false;
        };
        let length = (to - from).length();
        let Some(walk) = (to - from)
            .try_normalize()
            .and_then(|direction| self.frame.walk(from, direction, length))
        else {
            return false;
        };
        !self.bvh.0.ray_traverse_miss(walk.ray, |_, entry| {
            let hit = self.triangles_of(entry..entry + 1).any(|index| {
                triangle::separates(&self.vertices[index], &line, from, to).is_some_and(
                    |crossing| {
                        let id = self.ids[index];
                        !ignore(id) && self.stops(id, &crossing)
                    },
                )
            });
            if hit {
                f32::NEG_INFINITY
            } else {
                f32::INFINITY
            }
        })
    }

    fn closest(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_distance: f64,
        ignore: &dyn Fn(u32) -> bool,
    ) -> Option<Hit> {
        let line = Line::new(origin, direction)?;
        let walk = self.frame.walk(origin, direction, max_distance)?;
        let mut best: Option<Hit> = None;
        self.bvh
            .0
            .ray_traverse(walk.ray, &mut RayHit::none(), |_, entry| {
                let mut nearest = f32::INFINITY;
                for index in self.triangles_of(entry..entry + 1) {
                    let Some((distance, front, crossing)) =
                        triangle::meets(&self.vertices[index], &line)
                    else {
                        continue;
                    };
                    let id = self.ids[index];
                    let nearer = distance <= max_distance
                        && best.is_none_or(|hit| (distance, id) < (hit.distance, hit.triangle));
                    if nearer && !ignore(id) && self.stops(id, &crossing) {
                        best = Some(Hit {
                            distance,
                            triangle: id,
                            front,
                        });
                        nearest = walk.limit(distance * self.frame.scale);
                    }
                }
                nearest
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

    /// The part of a ray that can meet the scene; `None` when it misses the scene's cube.
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
            ray: Ray::new(start.as_vec3a(), direction.as_vec3a(), 0.0, 0.0),
            skipped,
        };
        walk.ray.tmax = walk.limit(length * self.scale);
        (walk.ray.tmax > 0.0).then_some(walk)
    }
}

impl Walk {
    /// Distance in the frame at which the walk may stop, rounded up, so that equally near triangles are still looked at.
    fn limit(&self, distance: f64) -> f32 {
        (distance - self.skipped + PADDING) as f32
    }
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

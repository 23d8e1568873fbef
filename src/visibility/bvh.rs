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

use glam::DVec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;

use super::bundle::Bundle;
use super::entries::{self, Entries};
use super::frame::Frame;
use super::filter::Verdict;
use super::lanes::{Kernel, LANES, Lanes, Machine};
use super::surface;
use super::triangle::{self, Line};
use super::wide;
use super::{Edges, Hit, Shaft, Visibility};
use crate::math::Aabb;
use crate::scene::Scene;

/// Up to this many triangles in a shaft are examined more closely. It is emptiness that counts: a shaft of many triangles hardly
/// becomes empty, and looking closely costs about as much as finding a triangle.
const FEW: usize = 32;

/// Segments that are sorted at once, so that their answers fit into one number.
const BATCH: usize = 64;

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
        let (ranges, ids) = entries::in_order(&bvh, &leaf_entries);
        let vertices: Vec<_> = ids.iter().map(|&id| vertices_of(id)).collect();
        let masked = surface::has_mask(scene);
        let wide = wide::Tree::collapse(
            &bvh,
            &ranges,
            &vertices,
            |point| frame.point(point),
            |triangle| frame.bounds(triangle),
            |place| !(masked && surface::is_masked(scene, ids[place as usize])),
        );
        Self {
            scene,
            masked,
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

    /// Those of `segments` at the first `count` of `places` that are stopped, all longest along `axis`.
    #[inline(always)]
    fn stopped_of<L: Lanes>(
        &self,
        lanes: L,
        segments: &[[DVec3; 2]],
        places: &[usize],
        count: usize,
        axis: usize,
        ignore: &dyn Fn(u32) -> bool,
    ) -> u64 {
        let mut chosen = [[DVec3::ZERO; 2]; LANES];
        for (lane, &place) in places.iter().enumerate() {
            chosen[lane] = segments[place];
        }
        let mut bundle = Bundle::new(&self.frame, &chosen, axis);
        bundle.together &= (1 << count) - 1;
        let stopped = self.wide.any_of(lanes, &bundle, |place, verdict| {
            self.stopped(place, verdict, &bundle, &chosen, ignore)
        });
        let mut found = 0;
        for (lane, &place) in places[..count].iter().enumerate() {
            let hidden = if bundle.together >> lane & 1 == 1 {
                stopped >> lane & 1 == 1
            } else {
                let [from, to] = chosen[lane];
                self.occluded(from, to, ignore)
            };
            found |= u64::from(hidden) << place;
        }
        found
    }

    /// Those of `segments` that the triangle at `place` stops, given what is known of it.
    #[inline(always)]
    fn stopped(
        &self,
        place: usize,
        verdict: Verdict,
        bundle: &Bundle,
        segments: &[[DVec3; 2]],
        ignore: &dyn Fn(u32) -> bool,
    ) -> u32 {
        let triangle = &self.vertices[place];
        let sides = bundle.sides(triangle);
        let mut stopped = verdict.inside & sides.divided;
        let mut doubtful = verdict.possible & sides.straddling & !stopped;
        while doubtful != 0 {
            let lane = doubtful.trailing_zeros();
            doubtful &= doubtful - 1;
            let [from, to] = segments[lane as usize];
            let hides = Line::new(from, to - from)
                .and_then(|line| triangle::separates(triangle, &line, from, to))
                .is_some_and(|crossing| self.stops(self.ids[place], &crossing));
            stopped |= u32::from(hides) << lane;
        }
        if stopped != 0 && ignore(self.ids[place]) {
            return 0;
        }
        stopped
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

    fn occluded_each(
        &self,
        segments: &[[DVec3; 2]],
        ignore: &dyn Fn(u32) -> bool,
        hidden: &mut Vec<bool>,
    ) {
        hidden.clear();
        self.machine.run(OccludedEach {
            occluders: self,
            segments,
            ignore,
            hidden,
        });
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
        let ray = walk.ray(&line);
        occluders.wide.any(lanes, &ray, walk.length, |candidates| {
            for (place, solid) in candidates.each() {
                let id = occluders.ids[place];
                let triangle = &occluders.vertices[place];
                let stopped = triangle::straddles(triangle, from, to)
                    && if solid {
                        triangle::divides(triangle, from, to)
                    } else {
                        triangle::separates(triangle, &line, from, to)
                            .is_some_and(|crossing| occluders.stops(id, &crossing))
                    };
                if stopped && !ignore(id) {
                    return true;
                }
            }
            false
        })
    }
}

/// [`Visibility::occluded_each`], a segment in each lane.
struct OccludedEach<'a> {
    occluders: &'a Occluders<'a>,
    segments: &'a [[DVec3; 2]],
    ignore: &'a dyn Fn(u32) -> bool,
    hidden: &'a mut Vec<bool>,
}

impl Kernel for OccludedEach<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            occluders,
            segments,
            ignore,
            hidden,
        } = self;
        for segments in segments.chunks(BATCH) {
            let mut stopped = 0u64;
            for (axis, mut waiting) in by_longest_axis(segments).into_iter().enumerate() {
                while waiting != 0 {
                    let mut places = [waiting.trailing_zeros() as usize; LANES];
                    let mut count = 0;
                    while count < LANES && waiting != 0 {
                        places[count] = waiting.trailing_zeros() as usize;
                        waiting &= waiting - 1;
                        count += 1;
                    }
                    stopped |= occluders.stopped_of(lanes, segments, &places[..], count, axis, ignore);
                }
            }
            hidden.extend((0..segments.len()).map(|place| stopped >> place & 1 == 1));
        }
    }
}

/// One bit for each of `segments`, by the axis along which they are longest.
#[inline(always)]
fn by_longest_axis(segments: &[[DVec3; 2]]) -> [u64; 3] {
    let mut sets = [0; 3];
    for (place, [from, to]) in segments.iter().enumerate() {
        let size = (*to - *from).abs();
        let x = size.x >= size.y && size.x >= size.z;
        let y = !x && size.y >= size.z;
        sets[0] |= u64::from(x) << place;
        sets[1] |= u64::from(y) << place;
        sets[2] |= u64::from(!x && !y) << place;
    }
    sets
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
        let ray = walk.ray(&line);
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

#[cfg(test)]
mod tests {
    use glam::{DAffine3, Vec3};

    use super::*;
    use crate::math;
    use crate::scene::{Instance, Material, Mesh, Primitive};
    use crate::visibility::BruteForce;

    fn point(seed: u64, index: u64) -> DVec3 {
        let [x, y] = math::unit_pair(math::hash(seed, 0, index));
        let [z, _] = math::unit_pair(math::hash(seed, 1, index));
        2.0 * DVec3::new(x, y, z) - 1.0
    }

    /// Small triangles in a cube.
    fn soup(count: u64) -> Scene {
        let positions: Vec<Vec3> = (0..3 * count)
            .map(|index| (point(1, index / 3) + 0.2 * point(2, index)).as_vec3())
            .collect();
        let primitive = Primitive {
            source: 0,
            material: 0,
            positions,
            normals: Vec::new(),
            texcoords: Vec::new(),
            vertex_alpha: Vec::new(),
            triangles: (0..count as u32)
                .map(|index| [3 * index, 3 * index + 1, 3 * index + 2])
                .collect(),
        };
        let mesh = Mesh {
            name: "mesh".to_owned(),
            source: 0,
            primitives: vec![primitive],
        };
        let instance = Instance {
            name: "node".to_owned(),
            node: 0,
            copy: None,
            mesh: 0,
            world_from_local: DAffine3::IDENTITY,
            density: 1.0,
        };
        Scene::assemble(
            "soup",
            vec![mesh],
            vec![instance],
            vec![Material::default()],
            Vec::new(),
        )
    }

    #[test]
    fn machines_without_wide_registers_answer_as_brute_force() {
        let scene = soup(300);
        let brute = BruteForce::build(&scene);
        let tree = Occluders {
            machine: Machine::Any,
            ..Occluders::build(&scene)
        };
        let nothing = |_| false;
        let segments: Vec<[DVec3; 2]> = (0..20_000)
            .map(|index| {
                // Eight at a time run alike.
                let towards = 1.5 * point(4, index / 8) + 0.1 * point(5, index);
                [1.5 * point(3, index / 8), towards]
            })
            .collect();
        let mut hidden = Vec::new();
        tree.occluded_each(&segments, &nothing, &mut hidden);
        for (index, &[from, to]) in segments.iter().enumerate() {
            let want = brute.occluded(from, to, &nothing);
            assert_eq!(tree.occluded(from, to, &nothing), want, "segment {index}");
            assert_eq!(hidden[index], want, "segment {index} among others");
            let direction = (to - from).normalize();
            assert_eq!(
                tree.closest(from, direction, 3.0, &nothing),
                brute.closest(from, direction, 3.0, &nothing),
                "ray {index}"
            );
        }
        let share = hidden.iter().filter(|&&hidden| hidden).count();
        assert!((5_000..15_000).contains(&share), "{share} hidden");
    }
}

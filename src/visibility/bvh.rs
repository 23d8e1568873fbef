//! Bounding volume hierarchy over the occluding triangles.
//!
//! `obvhs` builds a binary tree; rays walk it collapsed to eight children per node (see `wide`), in `f32` and in a frame of its own (see
//! `frame`), and what they do not settle is tested in `f64`.
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

use super::entries::{self, Entries};
use super::frame::Frame;
use super::lanes::Machine;
use super::query::{Closest, Occluded, OccludedEach};
use super::surface;
use super::triangle::Crossing;
use super::wide;
use super::{Edges, Hit, Shaft, Visibility};
use crate::math::Aabb;
use crate::scene::Scene;

/// Up to this many triangles in a shaft are examined more closely. It is emptiness that counts: a shaft of many triangles hardly
/// becomes empty, and looking closely costs about as much as finding a triangle.
const FEW: usize = 32;

/// The occluding triangles of a scene.
#[derive(Debug)]
pub struct Occluders<'a> {
    scene: &'a Scene,
    /// Whether a crossed triangle must be asked for its alpha.
    masked: bool,
    pub(super) frame: Frame,
    /// For shafts.
    bvh: Tree,
    /// Per node of `bvh` the places of its triangles in `vertices`.
    ranges: Vec<Range<u32>>,
    /// For rays.
    pub(super) wide: wide::Tree,
    pub(super) machine: Machine,
    /// World vertices in the order of the leaves.
    pub(super) vertices: Vec<[DVec3; 3]>,
    /// Index in [`Scene::triangles`] for each of `vertices`.
    pub(super) ids: Vec<u32>,
    edges: OnceLock<Edges>,
    /// What light passes through; they are not among the others.
    panes: Option<Box<Self>>,
}

/// `Bvh2` with a `Debug` that does not print a million nodes.
struct Tree(Bvh2);

impl std::fmt::Debug for Tree {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Bvh2({} nodes)", self.0.nodes.len())
    }
}

impl<'a> Occluders<'a> {
    /// Builds the hierarchies over everything in `scene` that stops light and over everything that tints it. The same scene gives the same
    /// trees on any number of threads.
    #[must_use]
    pub fn build(scene: &'a Scene) -> Self {
        let (occluding, panes) = surface::occluding(scene);
        let mut occluders = Self::over(scene, occluding);
        occluders.panes = (!panes.is_empty()).then(|| Box::new(Self::over(scene, panes)));
        occluders
    }

    /// The hierarchy over the triangles `occluding`.
    fn over(scene: &'a Scene, mut occluding: Vec<u32>) -> Self {
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
            panes: None,
            frame,
            bvh: Tree(bvh),
            ranges,
            wide,
            machine: Machine::best(),
            vertices,
            ids,
        }
    }

    /// What light passes through and is tinted by.
    pub(super) fn panes(&self) -> Option<&Self> {
        self.panes.as_deref()
    }

    pub(super) fn scene(&self) -> &'a Scene {
        self.scene
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

    /// Whether the triangle stops light where it is crossed.
    pub(super) fn stops(&self, id: u32, crossing: &Crossing) -> bool {
        !self.masked || surface::is_there(self.scene, id, crossing)
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

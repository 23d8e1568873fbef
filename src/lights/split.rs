//! Cuts textured emission into pieces that are uniform enough; the rule is in the module doc of [`crate::lights`].
//!
//! The emission of a piece is sampled at one random point in each of n² equal parts, n its longest side in texels: two or more per
//! texel, as a triangle has less than half the area of the square over its longest side. Random points, because the same place of
//! every part could meet the same place of every repeat of a texture.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::collections::BinaryHeap;

use glam::DVec3;

use super::Options;
use super::emission::{self, Emitter};
use crate::error::Warnings;
use crate::math;
use crate::scene::Scene;

/// Fewest parts per side for sampling a piece: fewer see no detail in a piece of few texels.
const FEWEST_PARTS: f64 = 4.0;

/// Most parts per side of a whole triangle: fewer may miss a small bright spot in a large picture altogether, more cost seconds.
const MOST_PARTS: f64 = 64.0;

/// Most parts per side of a half: what is in it is known to vary, and its own halves are sampled as finely again.
const MOST_PARTS_OF_HALF: f64 = 32.0;

/// A piece smaller than this many texels is not halved any more: within a texel there is no detail.
const SMALLEST: f64 = 1.0;

/// A triangle that shines with one radiance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// Counter-clockwise seen from the front, world metres.
    pub(super) vertices: [DVec3; 3],
    /// Nit.
    pub(super) radiance: DVec3,
    /// Index in [`Scene::materials`]; pieces of different ones stay apart.
    pub(super) material: u32,
    pub(super) two_sided: bool,
    /// Index in [`Scene::triangles`] of the triangle it is, or is part of.
    pub(super) surface: u32,
    /// Metres by which the vertices may be off the plane they were meant to lie in.
    pub(super) uncertainty: f64,
    /// Whether it is one of several parts of its triangle.
    pub(super) part: bool,
}

/// A piece on its way: what is known of its emission.
#[derive(Clone, Copy, Debug)]
struct Draft {
    triangle: u32,
    /// Corners as weights of the triangle's vertices.
    corners: [[f64; 3]; 3],
    vertices: [DVec3; 3],
    area: f64,
    mean: DVec3,
    /// Root mean square deviation from the mean, worst channel.
    deviation: f64,
    texels: f64,
    part: bool,
}

/// All that is needed to say how much a deviation matters.
#[derive(Clone, Copy, Debug, Default)]
struct Total {
    area: f64,
    flux: DVec3,
}

/// Emitters as triangles of one radiance each; black ones are left out.
pub(super) fn uniform_pieces(
    scene: &Scene,
    emitters: &[Emitter],
    options: &Options,
    warnings: &mut Warnings,
) -> Vec<Piece> {
    let uniform = emitters
        .iter()
        .filter(|emitter| !emitter.textured)
        .map(|emitter| {
            let triangle = &scene.triangles[emitter.triangle as usize];
            Draft {
                mean: scene.materials[triangle.material as usize]
                    .emissive
                    .as_dvec3(),
                ..whole(scene, emitter.triangle)
            }
        });
    let textured = emitters
        .iter()
        .filter(|emitter| emitter.textured)
        .map(|emitter| sampled(scene, whole(scene, emitter.triangle)))
        .collect();
    let mut pieces: Vec<Piece> = uniform
        .chain(halved(scene, textured, options, warnings))
        .filter(|draft| draft.mean.max_element() > 0.0)
        .map(|draft| finished(scene, &draft))
        .collect();
    // Stable: the parts of a triangle keep the order in which they were cut.
    pieces.sort_by_key(|piece| piece.surface);
    pieces
}

/// Halves the least uniform drafts until all are uniform enough or the budget is spent.
fn halved(
    scene: &Scene,
    mut drafts: Vec<Draft>,
    options: &Options,
    warnings: &mut Warnings,
) -> Vec<Draft> {
    let mut totals: BTreeMap<(u32, u32), Total> = BTreeMap::new();
    for draft in &drafts {
        let total = totals.entry(emitter_of(scene, draft)).or_default();
        total.area += draft.area;
        total.flux += draft.area * draft.mean;
    }
    let urgency = |draft: &Draft| {
        let total = totals[&emitter_of(scene, draft)];
        let matters = draft.deviation * (draft.area * total.area).sqrt()
            / (options.texture_tolerance * total.flux.max_element());
        (matters > 1.0 && draft.texels > SMALLEST).then_some(matters)
    };
    let mut queue: BinaryHeap<Urgent> = drafts
        .iter()
        .enumerate()
        .filter_map(|(index, draft)| urgency(draft).map(|urgency| Urgent { urgency, index }))
        .collect();
    let mut splits = 0;
    while let Some(Urgent { index, .. }) = queue.pop() {
        if splits == options.max_texture_splits {
            warnings.push_many(
                "textured emission is coarser than the texture tolerance, because --max-texture-splits was reached",
                "",
                queue.len() + 1,
            );
            break;
        }
        splits += 1;
        let [first, second] = halves(scene, &drafts[index]);
        drafts[index] = first;
        drafts.push(second);
        for index in [index, drafts.len() - 1] {
            if let Some(urgency) = urgency(&drafts[index]) {
                queue.push(Urgent { urgency, index });
            }
        }
    }
    drafts
}

/// A draft that has to be halved; the most urgent is the greatest, of equal ones the first.
struct Urgent {
    urgency: f64,
    index: usize,
}

impl Ord for Urgent {
    fn cmp(&self, other: &Self) -> Ordering {
        self.urgency
            .total_cmp(&other.urgency)
            .then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Urgent {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Urgent {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Urgent {}

/// What counts as one emitter: an instance and a material.
fn emitter_of(scene: &Scene, draft: &Draft) -> (u32, u32) {
    let triangle = &scene.triangles[draft.triangle as usize];
    (triangle.instance, triangle.material)
}

fn whole(scene: &Scene, triangle: u32) -> Draft {
    let vertices = scene.triangles[triangle as usize].vertices;
    Draft {
        triangle,
        corners: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        vertices,
        area: area(&vertices),
        mean: DVec3::ZERO,
        deviation: 0.0,
        texels: 0.0,
        part: false,
    }
}

/// The two halves of `draft`, cut from the middle of its longest side to the vertex opposite.
fn halves(scene: &Scene, draft: &Draft) -> [Draft; 2] {
    let [a, b, c] = draft.vertices;
    let sides = [a.distance(b), b.distance(c), c.distance(a)];
    let mut start = 0;
    for side in 1..3 {
        if sides[side] > sides[start] {
            start = side;
        }
    }
    let end = (start + 1) % 3;
    // Symmetric in the two ends, so that the triangle on the other side of the edge has the same middle.
    let middle = 0.5 * (draft.vertices[start] + draft.vertices[end]);
    let weights = [0, 1, 2].map(|k| 0.5 * (draft.corners[start][k] + draft.corners[end][k]));
    [end, start].map(|replaced| {
        let mut half = *draft;
        half.vertices[replaced] = middle;
        half.corners[replaced] = weights;
        half.area = area(&half.vertices);
        half.part = true;
        sampled(scene, half)
    })
}

/// `draft` with its emission measured.
fn sampled(scene: &Scene, mut draft: Draft) -> Draft {
    draft.texels = emission::texels_across(scene, draft.triangle, &draft.corners);
    let most = if draft.part {
        MOST_PARTS_OF_HALF
    } else {
        MOST_PARTS
    };
    let parts = draft.texels.ceil().clamp(FEWEST_PARTS, most) as u32;
    let samples = barycentric_parts(parts, draft.triangle).map(|(index, weights)| {
        let weights = [0, 1, 2].map(|k| (0..3).map(|j| weights[j] * draft.corners[j][k]).sum());
        (index, emission::at(scene, draft.triangle, weights))
    });
    // Relative to the first sample, so that equal samples have their value as mean and no deviation.
    let mut first = DVec3::ZERO;
    let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
    for (index, value) in samples {
        if index == 0 {
            first = value;
        }
        sum += value - first;
        squares += (value - first) * (value - first);
    }
    let count = f64::from(parts * parts);
    let shift = sum / count;
    // In f32, so that what interpolating equal texels rounds differently is one radiance again.
    draft.mean = (first + shift).as_vec3().as_dvec3();
    draft.deviation = (squares / count - shift * shift)
        .max(DVec3::ZERO)
        .max_element()
        .sqrt();
    draft
}

/// A random point in each of `parts`² equal parts of a triangle, with its number; `seed` makes the points others.
fn barycentric_parts(parts: u32, seed: u32) -> impl Iterator<Item = (u32, [f64; 3])> {
    (0..parts).flat_map(move |row| {
        // A row of the cut triangle holds 2 row + 1 parts, every second one upside down.
        (0..=2 * row).map(move |column| {
            let index = row * row + column;
            let [mut u, mut v] = math::unit_pair(math::hash(u64::from(seed), u64::from(index), 0));
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let (i, j) = (f64::from(row), f64::from(column / 2));
            // Coordinates down the rows and along them.
            let (down, along) = if column % 2 == 0 {
                (i + u + v, j + v)
            } else {
                (i + v, j + u + v)
            };
            let scale = 1.0 / f64::from(parts);
            let (down, along) = (down * scale, along * scale);
            (index, [1.0 - down, down - along, along])
        })
    })
}

fn finished(scene: &Scene, draft: &Draft) -> Piece {
    let triangle = &scene.triangles[draft.triangle as usize];
    Piece {
        vertices: draft.vertices,
        radiance: draft.mean,
        material: triangle.material,
        two_sided: scene.materials[triangle.material as usize].double_sided,
        surface: draft.triangle,
        uncertainty: uncertainty(scene, draft.triangle),
        part: draft.part,
    }
}

fn area(vertices: &[DVec3; 3]) -> f64 {
    let [a, b, c] = *vertices;
    0.5 * (b - a).cross(c - a).length()
}

/// Half a step of the document's `f32` coordinates at the vertices of `triangle`, and of the transform to the world, in metres.
fn uncertainty(scene: &Scene, triangle: u32) -> f64 {
    let triangle = &scene.triangles[triangle as usize];
    let instance = &scene.instances[triangle.instance as usize];
    let primitive = &scene.meshes[instance.mesh].primitives[triangle.primitive as usize];
    let local = triangle
        .corners
        .iter()
        .map(|&corner| f64::from(primitive.positions[corner as usize].abs().max_element()))
        .fold(0.0, f64::max);
    let matrix = instance.world_from_local.matrix3;
    let stretch = matrix
        .x_axis
        .length()
        .max(matrix.y_axis.length())
        .max(matrix.z_axis.length());
    let world = triangle
        .vertices
        .iter()
        .map(|vertex| vertex.abs().max_element())
        .fold(0.0, f64::max);
    0.5 * f64::from(f32::EPSILON) * local * stretch + f64::EPSILON * world
}

//! Takes covered texels from the plane into the world: position, normals, tangent map.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::atlas::{Atlas, Placement, signed_area};
use crate::scene::{Instance, Scene, Triangle};

use super::cover::{Covered, OnPage};
use super::{TILE, Texel, Tile};

/// Smallest height of a triangle in the layout that a tangent map is taken from, in texels. Coordinates come in 32 bits, 1.2e-4 texels
/// apart on a page of 2048; below this height that error turns the map by more than 10 %.
const MIN_HEIGHT: f64 = 1e-3;

/// Cosine of the largest angle between a vertex normal that shades and the face: 75°. Beyond it the normal is an error of the author
/// rather than a rounded shape, and light from the face's own front would count as coming from behind.
const MIN_SHADING_COSINE: f64 = 0.258_819;

/// Cosine of the largest angle between a vertex normal and the face up to which the surface counts as round: 37°. A six-sided column
/// (30°) is round, a box with shared corners (45° and more) is a box: bulging its sides would push samples through what stands there.
const MIN_ROUND_COSINE: f64 = 0.8;

/// Longest move onto the round surface relative to the triangle's longest edge. Six-sided columns need 0.13 in the middle.
const MAX_BULGE: f64 = 0.15;

/// The texels of a page in the world, and their tiles. `on_page` is in the order of the tiles.
pub(super) fn lift(
    scene: &Scene,
    atlas: &Atlas,
    page: usize,
    on_page: Vec<OnPage>,
) -> (Vec<Texel>, Vec<Tile>) {
    let worlds = worlds(scene, atlas, page);
    let lifted: Vec<(Option<Texel>, (u32, u32))> = on_page
        .into_par_iter()
        .map(|texel| {
            let owner = (texel.placement, texel.covered.chart);
            let world = worlds[texel.placement as usize].as_ref();
            let texel = world
                .and_then(|world| world.texel(&texel.covered))
                .map(|lifted| Texel {
                    x: texel.texel[0],
                    y: texel.texel[1],
                    ..lifted
                });
            (texel, owner)
        })
        .collect();

    let mut texels = Vec::with_capacity(lifted.len());
    let mut tiles: Vec<Tile> = Vec::new();
    let mut current = None;
    for (texel, (placement, chart)) in lifted {
        let Some(texel) = texel else { continue };
        let tile = TILE as u16;
        let key = (texel.y / tile, texel.x / tile, placement, chart);
        if current != Some(key) {
            current = Some(key);
            tiles.push(Tile {
                texels: texels.len()..texels.len(),
                chart,
                placement,
            });
        }
        texels.push(texel);
        if let Some(last) = tiles.last_mut() {
            last.texels.end = texels.len();
        }
    }
    (texels, tiles)
}

/// What each placement of a page stands for; `None` for placements of other pages.
fn worlds<'a>(scene: &'a Scene, atlas: &'a Atlas, page: usize) -> Vec<Option<World<'a>>> {
    atlas
        .placements
        .par_iter()
        .map(|placement| (placement.page == page).then(|| World::new(scene, atlas, placement)))
        .collect()
}

/// One instance of an unwrap.
struct World<'a> {
    scene: &'a Scene,
    atlas: &'a Atlas,
    unwrap: usize,
    instance: &'a Instance,
    /// Takes normals to the world, up to a positive factor.
    normals: DMat3,
    mirrored: bool,
    /// The instance's part of the scene's triangles.
    triangles: &'a [Triangle],
    /// Index of the first of them.
    first: usize,
}

impl<'a> World<'a> {
    fn new(scene: &'a Scene, atlas: &'a Atlas, placement: &Placement) -> Self {
        let instance = &scene.instances[placement.instance];
        let index = placement.instance as u32;
        let first = scene.triangles.partition_point(|t| t.instance < index);
        let end = scene.triangles.partition_point(|t| t.instance <= index);
        let matrix = instance.world_from_local.matrix3;
        let mirrored = instance.is_mirrored();
        // The cofactor matrix is the inverse transpose times the determinant, and exists for flattening transforms too.
        let cofactor = DMat3::from_cols(
            matrix.y_axis.cross(matrix.z_axis),
            matrix.z_axis.cross(matrix.x_axis),
            matrix.x_axis.cross(matrix.y_axis),
        );
        Self {
            scene,
            atlas,
            unwrap: placement.unwrap,
            instance,
            normals: if mirrored { -cofactor } else { cofactor },
            mirrored,
            triangles: &scene.triangles[first..end],
            first,
        }
    }

    /// The texel at the origin of the page; `None` when its triangle was dropped in world space.
    fn texel(&self, covered: &Covered) -> Option<Texel> {
        let unwrap = &self.atlas.unwraps[self.unwrap];
        let [primitive, local] = covered.triangle;
        let unwrapped = &unwrap.primitives[primitive as usize];
        let source = unwrapped.source_triangles[local as usize];
        let index = self
            .triangles
            .binary_search_by_key(&(primitive, source), |t| (t.primitive, t.triangle))
            .ok()?;
        let triangle = &self.triangles[index];
        // In authored order, as the weights are.
        let vertices = if self.mirrored {
            let [a, c, b] = triangle.vertices;
            [a, b, c]
        } else {
            triangle.vertices
        };
        let flat =
            unwrapped.triangles[local as usize].map(|vertex| unwrapped.texcoords[vertex as usize]);
        let geometric_normal = triangle.area_vector().normalize();
        let facet = weigh(vertices, covered.weights);
        let mesh = &self.scene.meshes[self.instance.mesh];
        let primitive = &mesh.primitives[primitive as usize];
        let corners = primitive.triangles[source as usize];
        let shaded = self.vertex_normals(&primitive.normals, corners);
        let (normal, position) = match shaded {
            Some(normals) => (
                shading_normal(normals, covered.weights, geometric_normal),
                facet + bulge(facet, vertices, normals, covered.weights, geometric_normal),
            ),
            None => (geometric_normal, facet),
        };
        let [du, dv] = tangents(flat, vertices, geometric_normal, unwrap.texels_per_metre);
        Some(Texel {
            x: 0,
            y: 0,
            triangle: (self.first + index) as u32,
            position,
            geometric_normal,
            normal,
            du,
            dv,
        })
    }

    /// Unit vertex normals in the world; `None` when there are none, or one has no direction.
    fn vertex_normals(&self, normals: &[glam::Vec3], corners: [u32; 3]) -> Option<[DVec3; 3]> {
        let mut found = [DVec3::ZERO; 3];
        for (found, corner) in found.iter_mut().zip(corners) {
            let normal = normals.get(corner as usize)?.as_dvec3();
            *found = (self.normals * normal).try_normalize()?;
        }
        Some(found)
    }
}

fn weigh(vectors: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    vectors[0] * weights[0] + vectors[1] * weights[1] + vectors[2] * weights[2]
}

/// The interpolated vertex normal, or the face's where that one points away from it.
fn shading_normal(normals: [DVec3; 3], weights: [f64; 3], geometric_normal: DVec3) -> DVec3 {
    weigh(normals, weights)
        .try_normalize()
        .filter(|normal| normal.dot(geometric_normal) >= MIN_SHADING_COSINE)
        .unwrap_or(geometric_normal)
}

/// From a point of a facet to the round surface that the vertex normals describe; zero where the surface is flat, hollow or edged.
///
/// Each vertex has a tangent plane; a point of a convex facet lies below it by h_i. Moving the point by the mean of `h_i n_i` with its
/// barycentric weights goes to the mean of its projections onto the planes. For a circle of radius r and half angle θ that mean
/// lies 4rθ²t(1−t) above the chord to second order, and the circle 2rθ²t(1−t): so half of it is taken, which stays inside round bodies and
/// above their facets. Edges are shared, because on an edge only the normals of its two ends have weight.
///
/// Source: Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II, 2021, chapter 4; Boubekeur and Alexa, "Phong tessellation",
/// 2008. Deviation: the half.
fn bulge(
    facet: DVec3,
    vertices: [DVec3; 3],
    normals: [DVec3; 3],
    weights: [f64; 3],
    geometric_normal: DVec3,
) -> DVec3 {
    let round = |normal: &DVec3| normal.dot(geometric_normal) >= MIN_ROUND_COSINE;
    if !normals.iter().all(round) {
        return DVec3::ZERO;
    }
    let mut to_planes = DVec3::ZERO;
    for corner in 0..3 {
        let below = (vertices[corner] - facet).dot(normals[corner]).max(0.0);
        to_planes += normals[corner] * (weights[corner] * below);
    }
    let [a, b, c] = vertices;
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    (0.5 * to_planes).clamp_length_max(MAX_BULGE * longest)
}

/// ∂x/∂u and ∂x/∂v of a triangle, in metres per texel.
fn tangents(
    flat: [DVec2; 3],
    vertices: [DVec3; 3],
    geometric_normal: DVec3,
    texels_per_metre: f64,
) -> [DVec3; 2] {
    let [p, q] = [flat[1] - flat[0], flat[2] - flat[0]];
    let [a, b] = [vertices[1] - vertices[0], vertices[2] - vertices[0]];
    let doubled = signed_area(flat);
    let longest = |lengths: [f64; 3]| {
        (0..3).fold(0, |best, edge| {
            if lengths[edge] > lengths[best] {
                edge
            } else {
                best
            }
        })
    };
    let lengths = [p.length(), q.length(), p.distance(q)];
    if doubled.abs() > MIN_HEIGHT * lengths[longest(lengths)] {
        return [(a * q.y - b * p.y) / doubled, (b * p.x - a * q.x) / doubled];
    }
    // No usable area: the longest edge in the world gives direction and, if it has length in the layout, scale.
    let edges = [a, b, b - a];
    let edge = longest(edges.map(DVec3::length));
    let along = edges[edge].normalize();
    let step = if lengths[edge] > MIN_HEIGHT {
        edges[edge].length() / lengths[edge]
    } else {
        1.0 / texels_per_metre
    };
    [along * step, geometric_normal.cross(along) * step]
}

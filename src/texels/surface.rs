//! Takes covered texels from the plane into the world: position, normals, tangent map.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::atlas::{Atlas, Placement, Unwrap, signed_area};
use crate::scene::{Instance, Scene, Triangle};

use super::cover::{Coverage, Covered, OnPage};
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

/// The texels of a page in the world, and their tiles.
pub(super) fn lift(scene: &Scene, atlas: &Atlas, page: usize) -> (Vec<Texel>, Vec<Tile>) {
    let coverage = Coverage::new(atlas, page);
    let worlds: Vec<World<'_>> = atlas
        .placements
        .iter()
        .map(|placement| World::new(scene, atlas, placement))
        .collect();
    // Each with its triangle; those whose triangle was dropped in world space are left out.
    let on_page: Vec<(OnPage, usize)> = coverage
        .in_tiles(atlas, page)
        .into_par_iter()
        .filter_map(|texel| {
            let world = &worlds[texel.placement as usize];
            Some((texel, world.find(coverage.of(atlas, &texel))?))
        })
        .collect();
    let texels = on_page
        .par_iter()
        .map(|(texel, triangle)| {
            let world = &worlds[texel.placement as usize];
            let [x, y] = texel.texel;
            let lifted = world.texel(coverage.of(atlas, texel), *triangle);
            let offset = atlas.placements[texel.placement as usize].offset;
            let place = lifted.place + DVec2::from_array(offset.map(f64::from));
            Texel {
                x,
                y,
                place,
                ..lifted
            }
        })
        .collect();
    (texels, tiles(&on_page))
}

fn tiles(on_page: &[(OnPage, usize)]) -> Vec<Tile> {
    let tile = TILE as u16;
    let key = |(texel, _): &(OnPage, usize)| {
        let [x, y] = texel.texel;
        (y / tile, x / tile, texel.placement, texel.chart)
    };
    let mut first = 0;
    on_page
        .chunk_by(|a, b| key(a) == key(b))
        .map(|members| {
            let texels = first..first + members.len();
            first = texels.end;
            Tile {
                texels,
                chart: members[0].0.chart,
                placement: members[0].0.placement,
            }
        })
        .collect()
}

/// One instance of an unwrap.
struct World<'a> {
    scene: &'a Scene,
    unwrap: &'a Unwrap,
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
            unwrap: &atlas.unwraps[placement.unwrap],
            instance,
            normals: if mirrored { -cofactor } else { cofactor },
            mirrored,
            triangles: &scene.triangles[first..end],
            first,
        }
    }

    /// The triangle in the world, among those of the instance; `None` when it was dropped there.
    fn find(&self, covered: &Covered) -> Option<usize> {
        let [primitive, local] = covered.triangle;
        let unwrapped = &self.unwrap.primitives[primitive as usize];
        let source = unwrapped.source_triangles[local as usize];
        self.triangles
            .binary_search_by_key(&(primitive, source), |t| (t.primitive, t.triangle))
            .ok()
    }

    /// The texel, at column and row 0, its place in the unwrap; `triangle` comes from [`Self::find`].
    fn texel(&self, covered: &Covered, triangle: usize) -> Texel {
        let [primitive, local] = covered.triangle;
        let unwrapped = &self.unwrap.primitives[primitive as usize];
        let index = triangle;
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
        let corners = primitive.triangles[triangle.triangle as usize];
        let shaded = self.vertex_normals(&primitive.normals, corners);
        let (normal, position) = match shaded {
            Some(normals) => (
                shading_normal(normals, covered.weights, geometric_normal),
                facet + bulge(facet, vertices, normals, covered.weights, geometric_normal),
            ),
            None => (geometric_normal, facet),
        };
        let [du, dv] = tangents(
            flat,
            vertices,
            geometric_normal,
            self.unwrap.texels_per_metre,
        );
        Texel {
            x: 0,
            y: 0,
            place: flat[0] * covered.weights[0]
                + flat[1] * covered.weights[1]
                + flat[2] * covered.weights[2],
            triangle: (self.first + index) as u32,
            position,
            geometric_normal,
            normal,
            du,
            dv,
        }
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
/// Each vertex has a tangent plane; a point of a convex facet lies below it by `h_i`. Moving the point by the mean of `h_i n_i` with its
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

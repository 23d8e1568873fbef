//! Settles what is odd about world-space geometry.

use std::path::PathBuf;

use glam::DVec3;

use super::{Image, Instance, Material, Mesh, Scene, Source, Triangle};
use crate::error::Warnings;

/// See [`Scene::assemble`].
pub(super) fn assemble(
    name: String,
    meshes: Vec<Mesh>,
    instances: Vec<Instance>,
    mut materials: Vec<Material>,
    images: Vec<Image>,
) -> Scene {
    if materials.is_empty() {
        materials.push(Material::default());
    }
    let mut warnings = Warnings::default();
    let triangles = world_triangles(&meshes, &instances, &mut warnings);
    Scene {
        name,
        path: PathBuf::new(),
        meshes,
        instances,
        materials,
        images,
        triangles,
        punctual_lights: Vec::new(),
        area_lights: Vec::new(),
        sky: None,
        source: Source {
            json: serde_json::json!({"asset": {"version": "2.0"}}),
            buffers: Vec::new(),
            folder: PathBuf::new(),
        },
        warnings,
    }
}

/// Spells out every triangle of every instance in world space, fronts counter-clockwise.
pub(super) fn world_triangles(
    meshes: &[Mesh],
    instances: &[Instance],
    warnings: &mut Warnings,
) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    for (instance_index, instance) in instances.iter().enumerate() {
        let mirrored = instance.is_mirrored();
        let mut without_area = 0;
        let mut not_finite = 0;
        for (primitive_index, primitive) in meshes[instance.mesh].primitives.iter().enumerate() {
            let world: Vec<DVec3> = primitive
                .positions
                .iter()
                .map(|position| {
                    instance
                        .world_from_local
                        .transform_point3(position.as_dvec3())
                })
                .collect();
            for (triangle_index, &[a, b, c]) in primitive.triangles.iter().enumerate() {
                let corners = if mirrored { [a, c, b] } else { [a, b, c] };
                let vertices = corners.map(|corner| world[corner as usize]);
                if !vertices.iter().all(|vertex| vertex.is_finite()) {
                    not_finite += 1;
                    continue;
                }
                if !has_area(vertices) {
                    without_area += 1;
                    continue;
                }
                triangles.push(Triangle {
                    vertices,
                    corners,
                    instance: instance_index as u32,
                    primitive: primitive_index as u32,
                    triangle: triangle_index as u32,
                    material: primitive.material as u32,
                });
            }
        }
        let place = || format!("nodes[{}]", instance.node);
        warnings.push_many(
            "triangle has no area in world space, dropped",
            place(),
            without_area,
        );
        warnings.push_many(
            "triangle has a vertex that is not finite in world space, dropped",
            place(),
            not_finite,
        );
    }
    triangles
}

/// Whether a triangle spans a plane that survives rounding.
///
/// The area vector of three points with coordinates of size s and sides of length l has a rounding error of about ε·s·l, so a triangle
/// whose height is below a few ε·s has no trustworthy normal. Relative to its own longest side the limit is ε as well: below it the
/// cross product itself is noise. Larger limits would drop slivers that cast real shadows.
pub(super) fn has_area(vertices: [DVec3; 3]) -> bool {
    const ROUNDING: f64 = 8.0 * f64::EPSILON;
    let [a, b, c] = vertices;
    let longest = (b - a)
        .length_squared()
        .max((c - b).length_squared())
        .max((a - c).length_squared())
        .sqrt();
    let size = a.abs().max(b.abs()).max(c.abs()).max_element().max(longest);
    let doubled_area = (b - a).cross(c - a).length();
    doubled_area > ROUNDING * size * longest && doubled_area.is_finite()
}

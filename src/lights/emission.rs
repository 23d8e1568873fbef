//! Which triangles shine, and how their emission varies over them.

use glam::DVec2;
use glam::DVec3;

use crate::error::Warnings;
use crate::scene::Alpha;
use crate::scene::Scene;
use crate::scene::Texture;

/// A triangle that shines somewhere.
#[derive(Clone, Copy, Debug)]
pub(super) struct Emitter {
    /// Index in [`Scene::triangles`].
    pub(super) triangle: u32,
    /// Whether its emission has to be looked up point by point.
    pub(super) textured: bool,
}

/// All triangles with an emissive material, ascending; of equal ones the first, the others are counted in `warnings`.
pub(super) fn find(scene: &Scene, warnings: &mut Warnings) -> Vec<Emitter> {
    let emissive: Vec<Option<bool>> = scene
        .materials
        .iter()
        .map(|material| {
            let shines = material.emissive.max_element() > 0.0;
            let picture = &material.emissive_texture;
            let pictured = picture
                .as_ref()
                .is_some_and(|texture| texture.image.is_some());
            // The base colour matters where its alpha cuts.
            let masked = matches!(material.alpha, Alpha::Mask { .. });
            shines.then_some(pictured || masked)
        })
        .collect();
    let mut emitters: Vec<Emitter> = (0..scene.triangles.len() as u32)
        .filter_map(|triangle| {
            let material = scene.triangles[triangle as usize].material as usize;
            emissive[material].map(|textured| Emitter { triangle, textured })
        })
        .collect();
    drop_duplicates(scene, &mut emitters, warnings);
    emitters
}

/// Emission of a point of `triangle` in nit; zero where a mask cuts the surface away.
pub(super) fn at(scene: &Scene, triangle: u32, weights: [f64; 3]) -> DVec3 {
    let material = &scene.materials[scene.triangles[triangle as usize].material as usize];
    if let Alpha::Mask { cutoff } = material.alpha
        && scene.alpha(triangle, weights) < cutoff
    {
        return DVec3::ZERO;
    }
    scene.emission(triangle, weights).max(DVec3::ZERO)
}

/// Longest side of the part of `triangle` with the given corners (as weights of its vertices) in texels, over all textures that
/// shape its emission.
pub(super) fn texels_across(scene: &Scene, triangle: u32, corners: &[[f64; 3]; 3]) -> f64 {
    let material = &scene.materials[scene.triangles[triangle as usize].material as usize];
    [&material.emissive_texture, &material.base_color_texture]
        .into_iter()
        .flatten()
        .filter_map(|texture| texel_positions(scene, triangle, texture))
        .map(|vertices| {
            let [a, b, c] = corners.map(|weights| {
                vertices[0] * weights[0] + vertices[1] * weights[1] + vertices[2] * weights[2]
            });
            a.distance(b).max(b.distance(c)).max(c.distance(a))
        })
        .fold(0.0, f64::max)
}

/// Where the vertices of `triangle` lie in the picture of `texture`, in texels; `None` without picture or coordinates.
fn texel_positions(scene: &Scene, triangle: u32, texture: &Texture) -> Option<[DVec2; 3]> {
    let image = &scene.images[texture.image?];
    let triangle = &scene.triangles[triangle as usize];
    let mesh = &scene.meshes[scene.instances[triangle.instance as usize].mesh];
    let texcoords = mesh.primitives[triangle.primitive as usize]
        .texcoords
        .get(texture.texcoord)?;
    let size = DVec2::new(f64::from(image.width), f64::from(image.height));
    let mut positions = [DVec2::ZERO; 3];
    for (position, &corner) in positions.iter_mut().zip(&triangle.corners) {
        let authored = texcoords.get(corner as usize)?.as_dvec2();
        *position = texture.transform.transform_point2(authored) * size;
    }
    Some(positions)
}

/// Keeps the first of triangles with the same vertices and the same shining sides.
fn drop_duplicates(scene: &Scene, emitters: &mut Vec<Emitter>, warnings: &mut Warnings) {
    let mut keyed: Vec<_> = emitters
        .iter()
        .map(|emitter| {
            let triangle = &scene.triangles[emitter.triangle as usize];
            let two_sided = scene.materials[triangle.material as usize].double_sided;
            (canonical(&triangle.vertices, two_sided), emitter.triangle)
        })
        .collect();
    keyed.sort_unstable();
    let mut dropped: Vec<u32> = keyed
        .windows(2)
        .filter(|pair| pair[0].0 == pair[1].0)
        .map(|pair| pair[1].1)
        .collect();
    dropped.sort_unstable();
    for &triangle in &dropped {
        let triangle = &scene.triangles[triangle as usize];
        let mesh = &scene.meshes[scene.instances[triangle.instance as usize].mesh];
        let primitive = &mesh.primitives[triangle.primitive as usize];
        warnings.push(
            "emissive triangle is there twice; it shines once",
            format!("meshes[{}].primitives[{}]", mesh.source, primitive.source),
        );
    }
    emitters.retain(|emitter| dropped.binary_search(&emitter.triangle).is_err());
}

/// The same for triangles that shine alike: cyclic order does not matter, and for two-sided ones no order does.
fn canonical(vertices: &[DVec3; 3], two_sided: bool) -> (bool, [[u64; 3]; 3]) {
    let mut key = vertices.map(position_key);
    let first = (0..3).min_by_key(|&corner| key[corner]).unwrap_or(0);
    key.rotate_left(first);
    if two_sided {
        key.sort_unstable();
    }
    (two_sided, key)
}

/// Orders and compares positions; both zeros are one.
pub(super) fn position_key(position: DVec3) -> [u64; 3] {
    (position + DVec3::ZERO).to_array().map(f64::to_bits)
}

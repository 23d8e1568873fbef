//! What is in a scene and what a bake of it would do, without doing it.

use serde_json::{Value, json};

use super::{Execution, Options, plan};
use crate::atlas;
use crate::error::Result;
use crate::lights;
use crate::math::Aabb;
use crate::scene::Scene;

/// What is in `scene`, what is odd about it, what a bake would do and leave out, and what it needs: a JSON object with the keys
/// `scene`, `warnings`, `lights`, `atlas`, `plan`, `memory`.
///
/// # Errors
/// `InvalidOption`, and those of laying out the atlas.
pub fn inspect(scene: &Scene, options: &Options, execution: &Execution<'_>) -> Result<Value> {
    options.validate()?;
    execution.run(|| {
        let atlas = atlas::build(scene, &options.atlas, &|| execution.is_cancelled())?;
        let lights = lights::collect(scene, &options.lights);
        let plan = plan(scene, &lights, options);
        let mut warnings = scene.warnings.clone();
        warnings.extend(atlas.warnings.clone());
        warnings.extend(lights.warnings.clone());
        Ok(json!({
            "scene": scene_json(scene),
            "warnings": warnings,
            "lights": lights_json(scene, &lights),
            "atlas": atlas_json(&atlas),
            "plan": plan,
            "memory": memory_json(scene, &atlas),
        }))
    })?
}

fn scene_json(scene: &Scene) -> Value {
    let bounds = Aabb::from_points(scene.triangles.iter().flat_map(|t| t.vertices));
    let area: f64 = scene
        .triangles
        .iter()
        .map(|triangle| 0.5 * triangle.area_vector().length())
        .sum();
    json!({
        "name": scene.name,
        "meshes": scene.meshes.len(),
        "instances": scene.instances.len(),
        "triangles": scene.triangles.len(),
        "materials": scene.materials.len(),
        "normalMapped": scene.materials.iter().filter(|m| m.normal_mapped).count(),
        "area": area,
        "bounds": if bounds.is_empty() {
            Value::Null
        } else {
            json!({"min": bounds.min.to_array(), "max": bounds.max.to_array()})
        },
    })
}

fn lights_json(scene: &Scene, lights: &lights::Lights) -> Value {
    // Power of a Lambert emitter: π L A per emitting side.
    let flux: f64 = lights
        .polygons
        .iter()
        .map(|light| {
            let sides = if light.two_sided { 2.0 } else { 1.0 };
            let [r, g, b] = light.radiance.to_array();
            let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
            std::f64::consts::PI * luminance * light.area * sides
        })
        .sum();
    json!({
        "polygons": lights.polygons.len(),
        "triangles": lights.polygons.iter().map(|light| light.surface.len()).sum::<usize>(),
        "area": lights.polygons.iter().map(|light| light.area).sum::<f64>(),
        "luminousFlux": flux,
        "punctual": scene.punctual_lights.len(),
    })
}

fn atlas_json(atlas: &atlas::Atlas) -> Value {
    let used: f64 = atlas
        .placements
        .iter()
        .map(|placement| {
            let [width, height] = atlas.unwraps[placement.unwrap].size;
            f64::from(width) * f64::from(height)
        })
        .sum();
    let all: f64 = atlas
        .pages
        .iter()
        .map(|page| f64::from(page.width) * f64::from(page.height))
        .sum();
    json!({
        "unwraps": atlas.unwraps.len(),
        "authored": atlas.unwraps.iter().filter(|unwrap| unwrap.authored).count(),
        "charts": atlas.unwraps.iter().map(|unwrap| u64::from(unwrap.n_charts)).sum::<u64>(),
        "placements": atlas.placements.len(),
        "pages": atlas.pages.iter().map(|page| [page.width, page.height]).collect::<Vec<_>>(),
        "texels": all,
        "rectanglesOverPages": if all > 0.0 { used / all } else { 0.0 },
    })
}

/// Megabytes a bake holds at the same time, estimated from the sizes of what it keeps.
fn memory_json(scene: &Scene, atlas: &atlas::Atlas) -> Value {
    /// A triangle in the scene (128 B), in the hierarchy (vertices, boxes, nodes: 200 B), and in its mesh (about 100 B).
    const PER_TRIANGLE: f64 = 430.0;
    /// A texel with its place in the world (136 B), its values before and after sorting into planes (2 × 60 B), the raw EXR rows of
    /// all maps (40 B) and the error figures (12 B).
    const PER_TEXEL: f64 = 310.0;
    let largest_page = atlas
        .pages
        .iter()
        .map(|page| f64::from(page.width) * f64::from(page.height))
        .fold(0.0, f64::max);
    let source: usize = scene.source.buffers.iter().map(Vec::len).sum();
    let geometry = PER_TRIANGLE * scene.triangles.len() as f64 + 2.0 * source as f64;
    let page = PER_TEXEL * largest_page;
    json!({
        "geometryMegabytes": (geometry / 1e6).ceil(),
        "pageMegabytes": (page / 1e6).ceil(),
        "totalMegabytes": ((geometry + page) / 1e6).ceil(),
    })
}

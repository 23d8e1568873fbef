//! Which parts of which surfaces stand in the way.

use super::triangle::Crossing;
use crate::scene::Alpha;
use crate::scene::Scene;

/// Triangles that stop light somewhere, ascending: all but the blended ones.
pub(super) fn occluding(scene: &Scene) -> Vec<u32> {
    let casts: Vec<bool> = scene
        .materials
        .iter()
        .map(|material| material.alpha != Alpha::Blend)
        .collect();
    (0..scene.triangles.len() as u32)
        .filter(|&index| casts[scene.triangles[index as usize].material as usize])
        .collect()
}

/// Whether some material cuts holes into its surfaces.
pub(super) fn has_mask(scene: &Scene) -> bool {
    scene
        .materials
        .iter()
        .any(|material| matches!(material.alpha, Alpha::Mask { .. }))
}

/// Whether alpha decides where `triangle` stops light.
pub(super) fn is_masked(scene: &Scene, triangle: u32) -> bool {
    let material = scene.triangles[triangle as usize].material;
    matches!(scene.materials[material as usize].alpha, Alpha::Mask { .. })
}

/// Whether `triangle` stops light where a line crosses it.
pub(super) fn stops(scene: &Scene, triangle: u32, crossing: &Crossing) -> bool {
    let material = scene.triangles[triangle as usize].material;
    match scene.materials[material as usize].alpha {
        Alpha::Opaque => true,
        Alpha::Mask { cutoff } => scene.alpha(triangle, crossing.weights) >= cutoff,
        Alpha::Blend => false,
    }
}

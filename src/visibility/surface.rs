//! Which parts of which surfaces stand in the way, and which only tint.

use super::triangle::Crossing;
use crate::scene::Alpha;
use crate::scene::Scene;

/// Triangles that stop light somewhere, and those that let it through tinted; both ascending.
pub(super) fn occluding(scene: &Scene) -> (Vec<u32>, Vec<u32>) {
    (0..scene.triangles.len() as u32).partition(|&index| !is_translucent(scene, index))
}

/// Whether light passes through `triangle`.
pub(super) fn is_translucent(scene: &Scene, triangle: u32) -> bool {
    let material = scene.triangles[triangle as usize].material;
    scene.materials[material as usize].is_translucent()
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

/// Whether there is any of `triangle`'s surface where a line crosses it.
pub(super) fn is_there(scene: &Scene, triangle: u32, crossing: &Crossing) -> bool {
    let material = scene.triangles[triangle as usize].material;
    match scene.materials[material as usize].alpha {
        Alpha::Opaque | Alpha::Blend => true,
        Alpha::Mask { cutoff } => scene.alpha(triangle, crossing.weights) >= cutoff,
    }
}

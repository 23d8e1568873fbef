//! Gathers instances that can share one layout: the same mesh, stretched alike, at the same density.
//!
//! What a layout depends on is how long edges become and which angles they enclose, that is the Gram matrix `MᵀM` of the linear part `M`
//! of the transform; rotation and mirroring leave it alone. The matrix is compared in logarithmic steps, so that a forest of trees of
//! random size needs a few dozen layouts and not one per tree.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};

use crate::scene::{Mesh, Scene};

use super::Options;

/// Instances that share one layout.
#[derive(Debug)]
pub(super) struct Group {
    /// Index in the scene's meshes.
    pub(super) mesh: usize,
    /// Indices in the scene's instances, ascending.
    pub(super) instances: Vec<usize>,
    /// Takes local vectors to texels (of the first instance).
    pub(super) texels_from_local: DMat3,
    /// Texels per metre, the instances' density included.
    pub(super) texels_per_metre: f64,
    /// Texels that the surface of one instance covers, without borders and padding.
    pub(super) area: f64,
    /// Triangles of the mesh.
    pub(super) n_triangles: usize,
}

/// Steps per doubling of a squared length in which transforms are compared: lengths differ by 1.1 % at most within a group. Fewer
/// steps would show as a different density, more would unwrap the same tree again for nothing.
const STEPS_PER_OCTAVE: f64 = 32.0;

/// Steps per unit of the cosine between two axes. Angles matter less than lengths: 1/256 shears a square texel by 0.2°.
const STEPS_PER_COSINE: f64 = 256.0;

/// Mesh, squared lengths of the three axes, cosines between them.
type Key = (usize, [i32; 3], [i32; 3]);

/// All groups, ordered by their first instance.
pub(super) fn groups(scene: &Scene, options: &Options) -> Vec<Group> {
    let mut by_key: BTreeMap<Key, usize> = BTreeMap::new();
    let mut groups: Vec<Group> = Vec::new();
    for (index, instance) in scene.instances.iter().enumerate() {
        let mesh = &scene.meshes[instance.mesh];
        let n_triangles = mesh.primitives.iter().map(|p| p.triangles.len()).sum();
        let texels_per_metre = options.texels_per_metre * instance.density;
        // Also false for a density that is not a number.
        if !(texels_per_metre > 0.0 && n_triangles > 0) {
            continue;
        }
        let texels_from_local = instance.world_from_local.matrix3 * texels_per_metre;
        let group = *by_key
            .entry(key(instance.mesh, texels_from_local))
            .or_insert(groups.len());
        if group == groups.len() {
            groups.push(Group {
                mesh: instance.mesh,
                instances: Vec::new(),
                texels_from_local,
                texels_per_metre,
                area: area(mesh, texels_from_local),
                n_triangles,
            });
        }
        groups[group].instances.push(index);
    }
    groups
}

fn key(mesh: usize, linear: DMat3) -> Key {
    let axes = [linear.x_axis, linear.y_axis, linear.z_axis];
    // An axis of length zero gives the logarithm −∞ and with it i32::MIN, its own key.
    let lengths = axes.map(|axis| (axis.length_squared().log2() * STEPS_PER_OCTAVE).round() as i32);
    let unit = axes.map(DVec3::normalize_or_zero);
    let cosines = [(0, 1), (1, 2), (2, 0)]
        .map(|(a, b)| (unit[a].dot(unit[b]) * STEPS_PER_COSINE).round() as i32);
    (mesh, lengths, cosines)
}

/// Area of all triangles in texels.
fn area(mesh: &Mesh, texels_from_local: DMat3) -> f64 {
    mesh.primitives
        .iter()
        .flat_map(|primitive| {
            primitive.triangles.iter().map(|triangle| {
                let [a, b, c] = triangle.map(|vertex| {
                    texels_from_local * primitive.positions[vertex as usize].as_dvec3()
                });
                0.5 * (b - a).cross(c - a).length()
            })
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_and_mirroring_share_a_layout_and_stretch_does_not() {
        let turned = DMat3::from_rotation_z(0.7) * DMat3::from_rotation_x(-1.3);
        let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        let stretch = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 2.0));
        assert_eq!(key(3, DMat3::IDENTITY), key(3, turned));
        assert_eq!(key(3, DMat3::IDENTITY), key(3, turned * mirror));
        assert_ne!(key(3, DMat3::IDENTITY), key(3, turned * stretch));
        assert_ne!(key(3, DMat3::IDENTITY), key(3, turned * 1.05));
        assert_ne!(key(3, DMat3::IDENTITY), key(4, DMat3::IDENTITY));
        // A thin slab made three times as thick stays small against its other sides; its rim must not share.
        let slab = |thickness| DMat3::from_diagonal(DVec3::new(1000.0, 1000.0, thickness));
        assert_ne!(key(0, slab(1.0)), key(0, slab(3.0)));
    }

    #[test]
    fn rounding_of_authored_rotations_does_not_split_a_group() {
        // glTF stores rotations in 32 bits: lengths come out with relative errors of 1e-7.
        for scale in [1.0, 2.0, 0.5, 3.0, 10.0, 0.01, 0.0254] {
            let linear = DMat3::from_rotation_y(0.3) * scale;
            for error in [-3e-7, 3e-7] {
                assert_eq!(key(0, linear), key(0, linear * (1.0 + error)), "{scale}");
            }
        }
    }

    #[test]
    fn flattened_transforms_have_a_key() {
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 0.0, 1.0));
        assert_eq!(key(0, flat).1, [0, i32::MIN, 0]);
    }
}

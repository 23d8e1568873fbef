//! What the tests share: seeded numbers, scenes in code, places on the disk.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3, Vec3};
use lumel::scene::{Instance, Material, Mesh, Primitive, Scene};

/// A seeded generator (`SplitMix64`): the case number is the seed, so a failure can be run again alone.
pub(crate) struct Rng(u64);

impl Rng {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5bd1_e995)
    }

    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform on the unit sphere.
    pub(crate) fn direction(&mut self) -> DVec3 {
        let z = self.range(-1.0, 1.0);
        let angle = self.range(0.0, std::f64::consts::TAU);
        let radius = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
    }
}

/// A single-instance scene at the origin; each entry is a material and its triangles, counter-clockwise seen from the front.
pub(crate) fn scene_of(parts: &[(Material, Vec<[DVec3; 3]>)]) -> Scene {
    let primitives = parts
        .iter()
        .enumerate()
        .map(|(material, (_, triangles))| Primitive {
            source: material,
            material,
            positions: triangles
                .iter()
                .flatten()
                .map(|vertex| vertex.as_vec3())
                .collect(),
            normals: Vec::new(),
            texcoords: Vec::new(),
            vertex_alpha: Vec::new(),
            triangles: (0..triangles.len() as u32)
                .map(|index| [3 * index, 3 * index + 1, 3 * index + 2])
                .collect(),
        })
        .collect();
    Scene::assemble(
        "test",
        vec![Mesh {
            name: "mesh".to_owned(),
            source: 0,
            primitives,
        }],
        vec![Instance {
            name: "node".to_owned(),
            node: 0,
            copy: None,
            mesh: 0,
            world_from_local: DAffine3::IDENTITY,
            density: 1.0,
        }],
        parts.iter().map(|(material, _)| material.clone()).collect(),
        Vec::new(),
    )
}

/// Two triangles of the parallelogram at `corner` with sides `u` and `v`; its front looks along u × v.
pub(crate) fn quad(corner: DVec3, u: DVec3, v: DVec3) -> Vec<[DVec3; 3]> {
    vec![
        [corner, corner + u, corner + u + v],
        [corner, corner + u + v, corner + v],
    ]
}

/// A white emitter of `radiance` nit.
pub(crate) fn emitter(radiance: f32) -> Material {
    Material {
        emissive: Vec3::splat(radiance),
        ..Material::default()
    }
}

/// The checkout.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A file or folder of the bundled fixtures.
pub(crate) fn fixture(name: &str) -> PathBuf {
    root().join("fixtures").join(name)
}

/// Real scenes by others, which lie beside the checkout on the machines of the project only; `None` elsewhere.
pub(crate) fn shared_scenes() -> Option<PathBuf> {
    let folder = root().parent()?.join("shared/scenes");
    folder.is_dir().then_some(folder)
}

//! File → [`Scene`]: everything the bake needs of a glTF document, in world space, with every oddity settled.
//!
//! Behind this border nobody checks again: positions are finite, indices are in range, triangles have area, front faces are wound
//! counter-clockwise in world space even below mirrored nodes, colours are linear, emission is in nit.

// File → document.
mod container;
mod uri;

mod document;

mod extension;

// Document → scene.
mod gltf;

mod node;

mod instance;

mod accessor;

mod primitive;

mod deform;

mod surface;

mod material;

mod texture;

mod image;

mod light;

// Scene → world.
mod check;

// The light from far away.
pub mod environment;

use std::path::Path;
use std::path::PathBuf;

use glam::{DAffine3, DVec3, Vec2, Vec3};

use crate::error::{Result, Warnings};

pub use self::environment::Environment;
pub use self::gltf::load;
pub use self::image::Image;
pub use self::material::{Alpha, Material};
pub use self::texture::{Texture, Wrap};

/// What [`load`] reads of a document that holds several scenes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Index of the glTF scene. Default: the document's default scene, else the first, else all nodes.
    pub scene: Option<usize>,
}

/// A level, ready to bake.
#[derive(Debug)]
pub struct Scene {
    /// File stem of the document; names the files of the bake.
    pub name: String,
    /// The document.
    pub path: PathBuf,
    /// Distinct geometry, in local space.
    pub meshes: Vec<Mesh>,
    /// Where the meshes stand. Every instance gets its own place in the lightmap.
    pub instances: Vec<Instance>,
    /// Never empty: the last one is glTF's default material.
    pub materials: Vec<Material>,
    /// Decoded pictures; only those that [`Material`]s refer to.
    pub images: Vec<Image>,
    /// Every triangle of every instance in world space, ordered by instance, primitive, triangle. The index in this list names a
    /// triangle in `lights`, `visibility` and `transport`.
    pub triangles: Vec<Triangle>,
    /// Authored lights (`KHR_lights_punctual`), in world space.
    pub punctual_lights: Vec<PunctualLight>,
    /// Authored lights with a surface of their own (the draft `EXT_lights_area`), in world space.
    pub area_lights: Vec<AreaLight>,
    /// Light from all around; documents have none of their own.
    pub sky: Option<Sky>,
    /// The document itself, for the stage that writes it again.
    pub source: Source,
    /// What was odd.
    pub warnings: Warnings,
}

/// Geometry of one glTF mesh, or of one node whose skin or morph targets are frozen in their rest pose.
///
/// A skinned mesh is kept in world space: its instance has the identity, or a reflection along X when its joints mirror.
#[derive(Debug)]
pub struct Mesh {
    /// Authored name, else `mesh<index>`.
    pub name: String,
    /// Index in the document's `meshes`.
    pub source: usize,
    /// Primitives that consist of triangles.
    pub primitives: Vec<Primitive>,
}

/// Indexed triangles of one material, in the local space of its mesh.
#[derive(Debug)]
pub struct Primitive {
    /// Index in the document's `meshes[].primitives`.
    pub source: usize,
    /// Index in [`Scene::materials`].
    pub material: usize,
    /// Local metres, finite. As many as the document's POSITION accessor has, in its order.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals, one per position; empty when the document has none, which means flat shading.
    pub normals: Vec<Vec3>,
    /// Texture coordinates by set, one per position; a set that is absent or unusable is empty. v = 0 at the top.
    pub texcoords: Vec<Vec<Vec2>>,
    /// `COLOR_0` alpha per position; empty means 1.
    pub vertex_alpha: Vec<f32>,
    /// Vertex indices in authored winding; strips and fans are spelled out, triangles without area in local space are left out.
    pub triangles: Vec<[u32; 3]>,
}

/// One mesh at one place.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Name of its node, else `node<index>`.
    pub name: String,
    /// Index in the document's `nodes`.
    pub node: usize,
    /// Index of the copy when the node carries `EXT_mesh_gpu_instancing`.
    pub copy: Option<usize>,
    /// Index in [`Scene::meshes`].
    pub mesh: usize,
    /// Local to world. Finite; may mirror, may flatten one axis.
    pub world_from_local: DAffine3,
    /// Multiplier of the texel density, from the node's `extras.lumel.scale`; 0 means that the instance gets no texels and only
    /// casts shadows. Default 1.
    pub density: f64,
}

impl Instance {
    /// Whether the transform turns front faces around (negative determinant).
    #[must_use]
    pub fn is_mirrored(&self) -> bool {
        self.world_from_local.matrix3.determinant() < 0.0
    }
}

/// A world-space triangle with area.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// Counter-clockwise seen from the front, in metres; already turned around below mirrored instances.
    pub vertices: [DVec3; 3],
    /// Vertex indices in its primitive, in the order of `vertices`.
    pub corners: [u32; 3],
    /// Index in [`Scene::instances`].
    pub instance: u32,
    /// Index in the mesh's `primitives`.
    pub primitive: u32,
    /// Index in the primitive's `triangles`.
    pub triangle: u32,
    /// Index in [`Scene::materials`].
    pub material: u32,
}

impl Triangle {
    /// Twice its area times its unit front normal, in m².
    #[must_use]
    pub fn area_vector(&self) -> DVec3 {
        let [a, b, c] = self.vertices;
        (b - a).cross(c - a)
    }
}

/// A light of `KHR_lights_punctual`, in world space.
#[derive(Clone, Debug, PartialEq)]
pub struct PunctualLight {
    /// Authored name, else `light<index>`.
    pub name: String,
    /// Index in the document's `nodes`.
    pub node: usize,
    /// Point and spot: luminous intensity in candela; directional: illuminance in lux. Linear RGB, colour included.
    pub intensity: DVec3,
    /// World metres.
    pub position: DVec3,
    /// Unit vector in which it shines (the node's −Z).
    pub direction: DVec3,
    /// What shape its light has.
    pub kind: PunctualKind,
    /// Point and spot: radius in metres, directional: angular diameter in radians, where the node's extras give one; 0 is hard.
    pub size: Option<f64>,
}

/// A light of the draft extension `EXT_lights_area`, in world space: a plane surface that nobody sees.
#[derive(Clone, Debug, PartialEq)]
pub struct AreaLight {
    /// Authored name, else `area light<index>`.
    pub name: String,
    /// Index in the document's `nodes`.
    pub node: usize,
    /// Nit, linear RGB, colour included.
    pub radiance: DVec3,
    /// World metres.
    pub centre: DVec3,
    /// From the centre to the middle of a side (of a disc: to its border), world metres; perpendicular to each other. It shines along
    /// `half_height` × `half_width`.
    pub half_width: DVec3,
    /// See `half_width`.
    pub half_height: DVec3,
    /// Whether it is a disc.
    pub is_disc: bool,
}

/// A picture of the light from far away, and how it is hung.
#[derive(Clone, Debug)]
pub struct Sky {
    /// The picture, in its own axes.
    pub image: Environment,
    /// Radians about Y, counter-clockwise seen from above.
    pub rotation: f64,
    /// Multiplies the picture's radiance, nit.
    pub strength: f64,
    /// Text of a rule that was made of it before, see [`environment::read_rule`]; looked at when it fits.
    pub rule: Option<String>,
}

/// Shape of a punctual light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PunctualKind {
    /// Shines everywhere, to `range` metres when given.
    Point {
        /// Metres; `None` is infinite.
        range: Option<f64>,
    },
    /// Shines into a cone.
    Spot {
        /// Metres; `None` is infinite.
        range: Option<f64>,
        /// Half angle where the falloff starts, radians.
        inner_angle: f64,
        /// Half angle where it reaches zero, radians.
        outer_angle: f64,
    },
    /// Parallel light from infinity.
    Directional,
}

/// The document as it was read, so that it can be written again with nothing lost.
#[derive(Debug)]
pub struct Source {
    /// The JSON document, keys in authored order.
    pub json: serde_json::Value,
    /// Bytes of `buffers[i]`, resolved: at least its `byteLength`, with what follows it; empty for a buffer without bytes of its own, which
    /// nothing that was read refers to.
    pub buffers: Vec<Vec<u8>>,
    /// Folder that relative URIs refer to.
    pub folder: PathBuf,
}

impl Scene {
    /// Puts a scene together from parts, for callers that do not come from a file.
    ///
    /// Fills [`Scene::triangles`]: world-space triangles without area and those with a vertex that is not finite are dropped and
    /// counted in the warnings. Appends the default material when `materials` is empty.
    #[must_use]
    pub fn assemble(
        name: impl Into<String>,
        meshes: Vec<Mesh>,
        instances: Vec<Instance>,
        materials: Vec<Material>,
        images: Vec<Image>,
    ) -> Self {
        check::assemble(name.into(), meshes, instances, materials, images)
    }

    /// Whether any primitive has a material that `test` accepts.
    pub fn any_material(&self, test: impl Fn(&Material) -> bool) -> bool {
        self.meshes
            .iter()
            .flat_map(|mesh| &mesh.primitives)
            .any(|primitive| test(&self.materials[primitive.material]))
    }

    /// Alpha of a surface point: base colour factor × texture × vertex colour, in [0, 1].
    ///
    /// `triangle` indexes [`Scene::triangles`]; `weights` are the barycentric weights of its `vertices`.
    #[must_use]
    pub fn alpha(&self, triangle: u32, weights: [f64; 3]) -> f32 {
        material::alpha(self, triangle, weights)
    }

    /// Share of the light that passes through a surface point of a translucent material, per channel in [0, 1]: base colour × (1 − alpha),
    /// or × the transmission factor. All of it where alpha is 0: there is no surface.
    ///
    /// `triangle` indexes [`Scene::triangles`]; `weights` are the barycentric weights of its `vertices`.
    #[must_use]
    pub fn transmittance(&self, triangle: u32, weights: [f64; 3]) -> DVec3 {
        material::transmittance(self, triangle, weights)
    }

    /// Emission of a surface point, in nit: emissive factor × texture × `KHR_materials_emissive_strength`.
    ///
    /// `triangle` indexes [`Scene::triangles`]; `weights` are the barycentric weights of its `vertices`.
    #[must_use]
    pub fn emission(&self, triangle: u32, weights: [f64; 3]) -> DVec3 {
        material::emission(self, triangle, weights)
    }

    /// Reads the document at `path`; see [`load`].
    ///
    /// # Errors
    /// Those of [`load`].
    pub fn open(path: &Path, options: &Options) -> Result<Self> {
        load(path, options)
    }
}

//! Materials: what a surface emits and what it lets through.

use glam::{DAffine2, DVec3, Vec3};

use super::Scene;

/// How a surface emits and blocks light.
#[derive(Clone, Debug)]
pub struct Material {
    /// Authored name, else `material<index>`.
    pub name: String,
    /// Linear RGBA factor of the base colour.
    pub base_color: [f32; 4],
    /// Base colour texture; its image is decoded only for [`Alpha::Mask`].
    pub base_color_texture: Option<Texture>,
    /// Emitted radiance in nit: factor × strength. Zero when it emits nothing.
    pub emissive: Vec3,
    /// Multiplies `emissive`; sRGB image.
    pub emissive_texture: Option<Texture>,
    /// What light passes through.
    pub alpha: Alpha,
    /// Whether the back is a surface too (it emits, and it is lit when seen).
    pub double_sided: bool,
    /// Whether it has a normal texture, so that a direction-free irradiance would lose its relief.
    pub normal_mapped: bool,
    /// `KHR_materials_unlit`.
    pub unlit: bool,
}

/// glTF's `alphaMode`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Alpha {
    /// Blocks all light.
    Opaque,
    /// Blocks light where alpha is at least the cutoff.
    Mask {
        /// Threshold in [0, 1] (glTF allows more: then nothing is left).
        cutoff: f32,
    },
    /// Blended; blocks nothing yet.
    Blend,
}

/// A texture lookup.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Index in [`Scene::images`]; `None` when the picture was not needed or could not be read (it then counts as white).
    pub image: Option<usize>,
    /// Which of the primitive's texture coordinate sets.
    pub texcoord: usize,
    /// `KHR_texture_transform`: authored coordinates to picture coordinates.
    pub transform: DAffine2,
    /// Behaviour outside 0..1 along u and v.
    pub wrap: [Wrap; 2],
}

/// Behaviour of a texture outside 0..1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// Repeats.
    Repeat,
    /// Repeats, every second time mirrored.
    MirroredRepeat,
    /// Continues its border.
    ClampToEdge,
}

/// A decoded picture.
#[derive(Clone, Debug)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// As stored (colour in sRGB, alpha linear), row 0 on top.
    pub rgba: Vec<[u8; 4]>,
}

pub(super) fn alpha(_scene: &Scene, _triangle: u32, _weights: [f64; 3]) -> f32 {
    unimplemented!()
}

pub(super) fn emission(_scene: &Scene, _triangle: u32, _weights: [f64; 3]) -> DVec3 {
    unimplemented!()
}

impl Default for Material {
    /// glTF's default material: white, opaque, single-sided, not emissive.
    fn default() -> Self {
        Self {
            name: "default".to_owned(),
            base_color: [1.0; 4],
            base_color_texture: None,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            alpha: Alpha::Opaque,
            double_sided: false,
            normal_mapped: false,
            unlit: false,
        }
    }
}

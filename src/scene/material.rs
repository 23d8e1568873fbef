//! Materials: what a surface emits and what it lets through.

use glam::{DVec3, Vec3};
use gltf::json;
use gltf::json::material::AlphaMode;
use gltf::json::validation::Checked;
use serde::Deserialize;
use serde_json::{Map, Value};

use super::Primitive;
use super::Scene;
use super::document::Document;
use super::texture;
use super::texture::{Pending, Texture};
use crate::error::{Result, Warnings};

/// How a surface emits and blocks light.
#[derive(Clone, Debug)]
pub struct Material {
    /// Authored name, else `material<index>`.
    pub name: String,
    /// Linear RGBA factor of the base colour, finite.
    pub base_color: [f32; 4],
    /// Base colour texture; its image is decoded only for [`Alpha::Mask`] and where light passes through.
    pub base_color_texture: Option<Texture>,
    /// Emitted radiance in nit: factor × strength, finite and not negative. Zero when it emits nothing.
    pub emissive: Vec3,
    /// Multiplies `emissive`; sRGB image. Its image is decoded only when `emissive` is not zero.
    pub emissive_texture: Option<Texture>,
    /// What light passes through.
    pub alpha: Alpha,
    /// Share of the light that passes through the surface as through glass (`KHR_materials_transmission`; its texture is not looked at),
    /// in [0, 1].
    pub transmission: f32,
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
    /// Lets light through, tinted by what it does not cover.
    Blend,
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
            transmission: 0.0,
            double_sided: false,
            normal_mapped: false,
            unlit: false,
        }
    }
}

impl Material {
    /// Whether light passes through it, as opposed to through its holes.
    #[must_use]
    pub fn is_translucent(&self) -> bool {
        self.alpha == Alpha::Blend || self.transmission > 0.0
    }
}

/// A material of which the pictures are not yet read.
pub(super) struct Draft {
    /// Its textures have no pictures yet.
    pub(super) material: Material,
    /// Indices in the document's `images`.
    pub(super) base_color_source: Option<usize>,
    pub(super) emissive_source: Option<usize>,
}

impl Draft {
    /// Document indices of the pictures that a bake looks at.
    pub(super) fn needed_images(&self) -> impl Iterator<Item = usize> {
        let masked = matches!(self.material.alpha, Alpha::Mask { .. });
        let emits = self.material.emissive != Vec3::ZERO;
        let translucent = self.material.is_translucent();
        let base_color = self.base_color_source.filter(|_| masked || translucent);
        let emissive = self.emissive_source.filter(|_| emits);
        base_color.into_iter().chain(emissive)
    }
}

/// `KHR_materials_pbrSpecularGlossiness`, retired but common; its diffuse colour takes the place of the base colour.
#[derive(Deserialize)]
struct SpecularGlossiness {
    #[serde(rename = "diffuseFactor", default = "white")]
    factor: [f32; 4],
    #[serde(rename = "diffuseTexture")]
    texture: Option<json::texture::Info>,
}

fn white() -> [f32; 4] {
    [1.0; 4]
}

/// Reads all materials of the document, and the default one behind them.
pub(super) fn read(document: &Document<'_>, warnings: &mut Warnings) -> Result<Vec<Draft>> {
    let n_materials = document.list("materials")?.len();
    let mut drafts = (0..n_materials)
        .map(|index| read_one(document, index, warnings))
        .collect::<Result<Vec<_>>>()?;
    drafts.push(Draft {
        material: Material::default(),
        base_color_source: None,
        emissive_source: None,
    });
    Ok(drafts)
}

fn read_one(document: &Document<'_>, index: usize, warnings: &mut Warnings) -> Result<Draft> {
    let place = format!("materials[{index}]");
    let material: json::Material = document.get("materials", index, &place)?;
    let extensions = material.extensions.as_ref().map(|it| &it.others);
    let (base_color, base_color_texture) = base_color(document, &material, extensions, &place)?;
    let mut pending = |info: Option<&json::texture::Info>, name: &str| -> Result<_> {
        let place = format!("{place}.{name}");
        info.map(|info| texture::read(document, info, &place, warnings))
            .transpose()
    };
    let base_color_texture = pending(base_color_texture.as_ref(), "baseColorTexture")?;
    let emissive_texture = pending(material.emissive_texture.as_ref(), "emissiveTexture")?;
    let source = |pending: &Option<Pending>| pending.as_ref().and_then(|pending| pending.source);
    let (base_color_source, emissive_source) =
        (source(&base_color_texture), source(&emissive_texture));
    Ok(Draft {
        material: Material {
            name: material
                .name
                .clone()
                .unwrap_or_else(|| format!("material{index}")),
            base_color: base_color.map(|factor| if factor.is_finite() { factor } else { 1.0 }),
            base_color_texture: base_color_texture.map(|pending| pending.texture),
            emissive: emissive(document, &material, extensions, &place, warnings)?,
            emissive_texture: emissive_texture.map(|pending| pending.texture),
            alpha: alpha_mode(&material, &place, warnings),
            transmission: transmission(document, extensions, &place)?,
            double_sided: material.double_sided,
            normal_mapped: material.normal_texture.is_some(),
            unlit: texture::others(extensions, "KHR_materials_unlit").is_some(),
        },
        base_color_source,
        emissive_source,
    })
}

fn base_color(
    document: &Document<'_>,
    material: &json::Material,
    extensions: Option<&Map<String, Value>>,
    place: &str,
) -> Result<([f32; 4], Option<json::texture::Info>)> {
    const RETIRED: &str = "KHR_materials_pbrSpecularGlossiness";
    if let Some(value) = texture::others(extensions, RETIRED) {
        let retired: SpecularGlossiness =
            document.parse(value, || format!("{place}.extensions.{RETIRED}"))?;
        return Ok((retired.factor, retired.texture));
    }
    let metallic_roughness = &material.pbr_metallic_roughness;
    Ok((
        metallic_roughness.base_color_factor.0,
        metallic_roughness.base_color_texture.clone(),
    ))
}

fn emissive(
    document: &Document<'_>,
    material: &json::Material,
    extensions: Option<&Map<String, Value>>,
    place: &str,
    warnings: &mut Warnings,
) -> Result<Vec3> {
    /// `KHR_materials_emissive_strength`.
    #[derive(Deserialize)]
    struct Strength {
        #[serde(rename = "emissiveStrength", default = "one")]
        strength: f32,
    }
    fn one() -> f32 {
        1.0
    }
    let strength = match texture::others(extensions, "KHR_materials_emissive_strength") {
        Some(value) => {
            let place = || format!("{place}.extensions.KHR_materials_emissive_strength");
            document.parse::<Strength>(value, place)?.strength
        }
        None => 1.0,
    };
    let emissive = Vec3::from_array(material.emissive_factor.0) * strength;
    let settled = emissive.to_array().map(|channel| {
        if channel.is_finite() {
            channel.max(0.0)
        } else {
            0.0
        }
    });
    let settled = Vec3::from_array(settled);
    if settled != emissive {
        warnings.push("emission is negative or not finite, taken as 0", place);
    }
    Ok(settled)
}

fn transmission(
    document: &Document<'_>,
    extensions: Option<&Map<String, Value>>,
    place: &str,
) -> Result<f32> {
    const NAME: &str = "KHR_materials_transmission";
    #[derive(Deserialize)]
    struct Transmission {
        #[serde(rename = "transmissionFactor", default)]
        factor: f32,
    }
    let Some(value) = texture::others(extensions, NAME) else {
        return Ok(0.0);
    };
    let parsed: Transmission = document.parse(value, || format!("{place}.extensions.{NAME}"))?;
    Ok(if parsed.factor > 0.0 {
        parsed.factor.min(1.0)
    } else {
        0.0
    })
}

fn alpha_mode(material: &json::Material, place: &str, warnings: &mut Warnings) -> Alpha {
    match material.alpha_mode {
        Checked::Valid(AlphaMode::Opaque) => Alpha::Opaque,
        Checked::Valid(AlphaMode::Mask) => {
            let cutoff = material.alpha_cutoff.unwrap_or_default().0;
            Alpha::Mask {
                cutoff: cutoff.clamp(0.0, f32::MAX),
            }
        }
        Checked::Valid(AlphaMode::Blend) => Alpha::Blend,
        Checked::Invalid => {
            warnings.push("alpha mode is unknown, taken as opaque", place);
            Alpha::Opaque
        }
    }
}

/// See [`Scene::alpha`].
pub(super) fn alpha(scene: &Scene, triangle: u32, weights: [f64; 3]) -> f32 {
    let triangle = &scene.triangles[triangle as usize];
    let primitive = primitive_of(scene, triangle.instance, triangle.primitive);
    let material = &scene.materials[triangle.material as usize];
    let mut alpha = f64::from(material.base_color[3]);
    if let Some(texture) = &material.base_color_texture {
        alpha *= texture.alpha(&scene.images, primitive, triangle, weights);
    }
    if !primitive.vertex_alpha.is_empty() {
        alpha *= triangle
            .corners
            .iter()
            .zip(weights)
            .map(|(corner, weight)| f64::from(primitive.vertex_alpha[*corner as usize]) * weight)
            .sum::<f64>();
    }
    alpha.clamp(0.0, 1.0) as f32
}

/// See [`Scene::transmittance`].
pub(super) fn transmittance(scene: &Scene, triangle: u32, weights: [f64; 3]) -> DVec3 {
    let at = &scene.triangles[triangle as usize];
    let material = &scene.materials[at.material as usize];
    let alpha = if material.alpha == Alpha::Blend {
        f64::from(alpha(scene, triangle, weights))
    } else {
        1.0
    };
    if alpha == 0.0 {
        return DVec3::ONE;
    }
    let [r, g, b, _] = material.base_color.map(f64::from);
    let mut color = DVec3::new(r, g, b);
    if let Some(texture) = &material.base_color_texture {
        let primitive = primitive_of(scene, at.instance, at.primitive);
        color *= texture.rgb(&scene.images, primitive, at, weights);
    }
    let share = 1.0 - alpha * (1.0 - f64::from(material.transmission));
    (color * share).clamp(DVec3::ZERO, DVec3::ONE)
}

/// See [`Scene::emission`].
pub(super) fn emission(scene: &Scene, triangle: u32, weights: [f64; 3]) -> DVec3 {
    let triangle = &scene.triangles[triangle as usize];
    let material = &scene.materials[triangle.material as usize];
    let emissive = material.emissive.as_dvec3();
    match &material.emissive_texture {
        Some(texture) if emissive != DVec3::ZERO => {
            let primitive = primitive_of(scene, triangle.instance, triangle.primitive);
            emissive * texture.rgb(&scene.images, primitive, triangle, weights)
        }
        _ => emissive,
    }
}

fn primitive_of(scene: &Scene, instance: u32, primitive: u32) -> &Primitive {
    let mesh = scene.instances[instance as usize].mesh;
    &scene.meshes[mesh].primitives[primitive as usize]
}

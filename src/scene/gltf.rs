//! glTF → [`Scene`], step by step.

use std::collections::BTreeSet;
use std::path::Path;

use glam::DVec3;

use super::check;
use super::container;
use super::document::Document;
use super::extension;
use super::image;
use super::image::Image;
use super::instance;
use super::light;
use super::material;
use super::material::{Draft, Material};
use super::node::Hierarchy;
use super::{AreaLight, Instance, Mesh, Options, PunctualLight, Scene};
use crate::error::{Result, Warnings};

/// Distance from the origin, in metres, beyond which f32 coordinates are a decimetre apart and more.
const FAR: f64 = 1e6;

/// Reads a `.gltf` or `.glb`.
///
/// Files that other engines open are opened: what is merely odd is dropped or put right and counted in [`Scene::warnings`]. A document
/// without nodes is an empty scene.
///
/// # Errors
/// - `Io`: the document or a buffer cannot be read.
/// - `InvalidFile`: not glTF 2, truncated, or it refers to what is not there (missing elements, bytes out of range, a node with two parents
///   or above itself). The message names the place.
/// - `Unsupported`: its geometry is compressed (Draco, meshopt).
/// - `InvalidOption`: there is no such scene.
/// - `TooLarge`: more vertices or triangles than fit into memory.
pub fn load(path: &Path, options: &Options) -> Result<Scene> {
    let source = container::read(path)?;
    let mut warnings = Warnings::default();
    let document = Document::new(path, &source);
    let unknown = extension::check(&document, &mut warnings)?;
    let contents = read(&document, options, &mut warnings)
        .map_err(|error| extension::blame(error, &unknown))?;
    let triangles = check::world_triangles(&contents.meshes, &contents.instances, &mut warnings);
    for instance in triangles.chunk_by(|a, b| a.instance == b.instance) {
        let node = contents.instances[instance[0].instance as usize].node;
        let is_far = |vertex: &DVec3| vertex.abs().max_element() > FAR;
        let far = instance.iter().filter(|it| it.vertices.iter().any(is_far));
        warnings.push_many(
            "triangle is more than 1000 km from the origin, where coordinates are coarse",
            format!("nodes[{node}]"),
            far.count(),
        );
    }
    let name = path.file_stem().unwrap_or_default();
    Ok(Scene {
        name: name.to_string_lossy().into_owned(),
        path: path.to_owned(),
        meshes: contents.meshes,
        instances: contents.instances,
        materials: contents.materials,
        images: contents.images,
        triangles,
        punctual_lights: contents.punctual_lights,
        area_lights: contents.area_lights,
        sky: None,
        source,
        warnings,
    })
}

/// Everything of a scene that comes out of the document.
struct Contents {
    meshes: Vec<Mesh>,
    instances: Vec<Instance>,
    materials: Vec<Material>,
    images: Vec<Image>,
    punctual_lights: Vec<PunctualLight>,
    area_lights: Vec<AreaLight>,
}

fn read(document: &Document<'_>, options: &Options, warnings: &mut Warnings) -> Result<Contents> {
    let hierarchy = Hierarchy::read(document, options, warnings)?;
    let (meshes, instances) = instance::place(document, &hierarchy, warnings)?;
    let drafts = material::read(document, warnings)?;
    let (materials, images) = decode_images(document, drafts, &meshes, warnings);
    let punctual_lights = light::collect(document, &hierarchy, warnings)?;
    let area_lights = light::collect_areas(document, &hierarchy, warnings)?;
    Ok(Contents {
        meshes,
        instances,
        materials,
        images,
        punctual_lights,
        area_lights,
    })
}

/// Decodes the pictures that the surfaces of `meshes` need, and finishes the materials.
fn decode_images(
    document: &Document<'_>,
    drafts: Vec<Draft>,
    meshes: &[Mesh],
    warnings: &mut Warnings,
) -> (Vec<Material>, Vec<Image>) {
    let primitives = || meshes.iter().flat_map(|mesh| &mesh.primitives);
    let used: BTreeSet<usize> = primitives().map(|primitive| primitive.material).collect();
    let wanted: BTreeSet<usize> = used
        .iter()
        .flat_map(|material| drafts[*material].needed_images())
        .collect();
    let (images, places) = image::decode(document, wanted, warnings);
    let materials: Vec<Material> = drafts
        .into_iter()
        .map(|draft| {
            let mut material = draft.material;
            for (texture, source) in [
                (&mut material.base_color_texture, draft.base_color_source),
                (&mut material.emissive_texture, draft.emissive_source),
            ] {
                if let Some(texture) = texture {
                    texture.image = source.and_then(|source| places.get(&source).copied());
                }
            }
            material
        })
        .collect();
    for mesh in meshes {
        for primitive in &mesh.primitives {
            let material = &materials[primitive.material];
            let textures = [&material.base_color_texture, &material.emissive_texture];
            let blind =
                |texture: &&super::Texture| texture.image.is_some() && !texture.fits(primitive);
            if textures
                .into_iter()
                .flatten()
                .any(|texture| blind(&texture))
            {
                warnings.push(
                    "primitive lacks the texture coordinates of its material, the picture is treated as white",
                    format!("meshes[{}].primitives[{}]", mesh.source, primitive.source),
                );
            }
        }
    }
    (materials, images)
}

//! Which extensions may be ignored, and which may not.
//!
//! A required extension that only changes how things look, sound or move is no reason to refuse a level. One that hides the geometry is.
//! An extension nobody here has heard of gets the benefit of the doubt: the document is read without it, and a warning says so.

use serde_json::Value;

use super::document::Document;
use crate::error::{Error, Result, Warnings};

/// Extensions that put geometry where only their decoder finds it, each with what removes it.
const COMPRESSED: &[(&str, &str)] = &[
    ("KHR_draco_mesh_compression", DECOMPRESS),
    ("EXT_meshopt_compression", DECOMPRESS),
    ("KHR_meshopt_compression", DECOMPRESS),
    ("WEB3D_quantized_attributes", ""),
];

/// glTF-Transform decodes what it reads and writes plain buffers unless told otherwise.
const DECOMPRESS: &str = "npx @gltf-transform/cli copy in.glb out.glb";

/// Extensions that are read, or that do not touch geometry and emission; a trailing `_` stands for all that begin so.
const HARMLESS: &[&str] = &[
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_animation_pointer",
    "KHR_materials_",
    "KHR_texture_",
    "KHR_xmp",
    "KHR_xmp_",
    "KHR_audio_",
    "KHR_interactivity",
    "EXT_mesh_gpu_instancing",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_",
    "OMI_",
];

/// Looks at `extensionsRequired`. Returns those nobody here has heard of.
pub(super) fn check(document: &Document<'_>, warnings: &mut Warnings) -> Result<Vec<String>> {
    let mut unknown = Vec::new();
    for name in document
        .list("extensionsRequired")?
        .iter()
        .filter_map(Value::as_str)
    {
        if let Some((feature, advice)) = COMPRESSED.iter().find(|(feature, _)| *feature == name) {
            return Err(document.unsupported(feature, advice));
        }
        let harmless = HARMLESS
            .iter()
            .any(|known| *known == name || known.ends_with('_') && name.starts_with(known));
        if !harmless {
            warnings.push("required extension is unknown, read without it", name);
            unknown.push(name.to_owned());
        }
    }
    Ok(unknown)
}

/// Adds to `error` that required extensions were not understood, since that is what may have caused it.
pub(super) fn blame(error: Error, unknown: &[String]) -> Error {
    match error {
        Error::InvalidFile {
            path,
            place,
            reason,
        } if !unknown.is_empty() => Error::InvalidFile {
            path,
            place,
            reason: format!(
                "{reason}; the document requires {}, which lumel does not know",
                unknown.join(", ")
            ),
        },
        _ => error,
    }
}

/// Refuses a primitive whose geometry is compressed without a plain copy.
pub(super) fn refuse_compressed_primitive(
    document: &Document<'_>,
    mesh: usize,
    primitive: usize,
) -> Result<()> {
    let extensions = document
        .list("meshes")?
        .get(mesh)
        .and_then(|mesh| mesh.get("primitives")?.get(primitive)?.get("extensions"));
    refuse_compressed(document, extensions)
}

/// Refuses a buffer view whose bytes are compressed without a plain copy.
pub(super) fn refuse_compressed_view(document: &Document<'_>, view: usize) -> Result<()> {
    let extensions = document
        .list("bufferViews")?
        .get(view)
        .and_then(|view| view.get("extensions"));
    refuse_compressed(document, extensions)
}

fn refuse_compressed(document: &Document<'_>, extensions: Option<&Value>) -> Result<()> {
    let found = COMPRESSED
        .iter()
        .find(|(feature, _)| extensions.is_some_and(|map| map.get(feature).is_some()));
    match found {
        Some((feature, advice)) => Err(document.unsupported(feature, advice)),
        None => Ok(()),
    }
}

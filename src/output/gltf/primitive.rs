//! One primitive with lightmap coordinates.
//!
//! Seams of the unwrap need vertices of their own, so all attributes and morph targets are gathered anew, and triangles are listed
//! by index whatever they were before.

use glam::DVec2;
use serde_json::{Map, Value, json};

use crate::atlas::UnwrappedPrimitive;
use crate::error::Warnings;
use crate::output::gltf::accessor;
use crate::output::gltf::document::{Document, INDICES};
use crate::output::gltf::texcoord;
use crate::scene::Source;

/// The largest 16-bit index; 65535 would restart the primitive.
const MAX_U16_INDEX: usize = 65534;

/// A primitive that was written anew.
#[derive(Debug)]
pub(super) struct Rewritten {
    pub(super) json: Value,
    /// The set that the authored `TEXCOORD_1` moved to, when a material needs it.
    pub(super) moved_to: Option<u64>,
}

/// Writes `authored` with the vertices and triangles of `unwrapped`; `coordinates` turns a place in the unwrap into `TEXCOORD_1`.
///
/// An attribute that cannot be read is dropped with a warning. Gives `None` when the positions are among them.
pub(super) fn rewrite(
    document: &mut Document,
    source: &Source,
    authored: &Value,
    unwrapped: &UnwrappedPrimitive,
    coordinates: impl Fn(DVec2) -> [f32; 2],
    place: &str,
    warnings: &mut Warnings,
) -> Option<Rewritten> {
    let mut primitive = authored.as_object()?.clone();
    let mut attributes = primitive.get("attributes")?.as_object()?.clone();

    // The authored second set goes, unless a picture is placed by it.
    let moved_to = texcoord::is_used(document, &primitive).then(|| texcoord::free_set(&attributes));
    if let Some(authored) = attributes.shift_remove("TEXCOORD_1")
        && let Some(set) = moved_to
    {
        attributes.insert(format!("TEXCOORD_{set}"), authored);
    }
    let vertices = &unwrapped.source_vertices;
    let mut gather = |attributes: &Map<String, Value>| {
        gather_all(document, source, attributes, vertices, place, warnings)
    };
    let mut gathered = gather(&attributes);
    gathered.get("POSITION")?;
    if let Some(Value::Array(targets)) = primitive.get_mut("targets") {
        for target in targets.iter_mut().filter_map(Value::as_object_mut) {
            *target = gather(target);
        }
    }

    let pairs: Vec<[f32; 2]> = unwrapped
        .texcoords
        .iter()
        .map(|&at| coordinates(at))
        .collect();
    let lightmap = accessor::push_pairs(document, &pairs);
    // Sets must be numbered without gaps.
    gathered.entry("TEXCOORD_0").or_insert(lightmap.into());
    gathered.insert("TEXCOORD_1".to_owned(), lightmap.into());

    primitive.insert("attributes".to_owned(), Value::Object(gathered));
    let indices = push_indices(document, &unwrapped.triangles, vertices.len());
    primitive.insert("indices".to_owned(), indices.into());
    primitive.shift_remove("mode");
    Some(Rewritten {
        json: Value::Object(primitive),
        moved_to,
    })
}

/// Gathers every attribute; those that cannot be read are left out.
fn gather_all(
    document: &mut Document,
    source: &Source,
    attributes: &Map<String, Value>,
    vertices: &[u32],
    place: &str,
    warnings: &mut Warnings,
) -> Map<String, Value> {
    let mut gathered = Map::new();
    for (semantic, index) in attributes {
        let bounds = semantic == "POSITION";
        match accessor::gather(document, source, index, vertices, bounds) {
            Ok(index) => {
                gathered.insert(semantic.clone(), index.into());
            }
            Err(fault) => warnings.push(fault, format!("{place}.{semantic}")),
        }
    }
    gathered
}

/// Appends an accessor of vertex indices, as narrow as `n_vertices` allows.
fn push_indices(document: &mut Document, triangles: &[[u32; 3]], n_vertices: usize) -> usize {
    let narrow = n_vertices <= MAX_U16_INDEX + 1;
    let corners = triangles.as_flattened().iter();
    let bytes: Vec<u8> = if narrow {
        corners
            .flat_map(|&corner| (corner as u16).to_le_bytes())
            .collect()
    } else {
        corners.flat_map(|&corner| corner.to_le_bytes()).collect()
    };
    let view = document.push_view(&bytes, Some(INDICES), None);
    document.push(
        "accessors",
        json!({
            "bufferView": view,
            "componentType": if narrow { 5123 } else { 5125 },
            "count": 3 * triangles.len(),
            "type": "SCALAR",
        }),
    )
}

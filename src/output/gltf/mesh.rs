//! Meshes with lightmap coordinates: one per unwrap.
//!
//! A source mesh can have several unwraps: one per world scale, one per page that its surfaces are spread over, one per pose. The
//! first takes the place of the authored mesh unless that is still drawn as it was; the others are appended. A mesh whose authored
//! coordinates are kept is not touched.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec2;
use serde_json::Value;

use crate::error::{Error, Result, Warnings};
use crate::output::gltf::Input;
use crate::output::gltf::document::Document;
use crate::output::gltf::primitive::{self, Rewritten};
use crate::output::gltf::texcoord;

/// Writes the meshes. Gives the index of the document's mesh for each unwrap that has a place.
pub(super) fn write(
    document: &mut Document,
    input: Input<'_>,
    warnings: &mut Warnings,
) -> Result<BTreeMap<usize, usize>> {
    let authored: Vec<Value> = document.list("meshes").to_vec();
    let kept = kept_primitives(input);
    let mut in_use = meshes_in_use(document, input);
    let mut moved = BTreeMap::new();
    let mut indices = BTreeMap::new();
    let placed: BTreeSet<usize> = input
        .atlas
        .placements
        .iter()
        .map(|placement| placement.unwrap)
        .collect();
    for unwrap in placed {
        let source = input.scene.meshes[input.atlas.unwraps[unwrap].mesh].source;
        if input.atlas.unwraps[unwrap].authored {
            indices.insert(unwrap, source);
            continue;
        }
        let mut mesh = authored
            .get(source)
            .and_then(Value::as_object)
            .cloned()
            .ok_or_else(|| {
                invalid(
                    input,
                    format!("meshes[{source}]"),
                    "mesh is not in the document",
                )
            })?;
        let whole = kept.get(&unwrap);
        let primitives = primitives(document, input, unwrap, whole, &authored[source], warnings)?;
        let index = if in_use.insert(source) {
            source
        } else {
            document.push("meshes", Value::Null)
        };
        let sets = primitives.iter().enumerate();
        moved.extend(
            sets.filter_map(|(number, primitive)| Some(((index, number), primitive.moved_to?))),
        );
        let primitives = primitives.into_iter().map(|primitive| primitive.json);
        mesh.insert("primitives".to_owned(), primitives.collect());
        if let Some(slot) = document.json["meshes"].get_mut(index) {
            *slot = Value::Object(mesh);
        }
        indices.insert(unwrap, index);
    }
    texcoord::repoint(document, &moved);
    Ok(indices)
}

/// The primitives of one unwrap in authored order; those whose numbers are in `whole` as they were.
fn primitives(
    document: &mut Document,
    input: Input<'_>,
    unwrap_idx: usize,
    whole: Option<&BTreeSet<usize>>,
    authored: &Value,
    warnings: &mut Warnings,
) -> Result<Vec<Rewritten>> {
    let unwrap = &input.atlas.unwraps[unwrap_idx];
    let mesh = &input.scene.meshes[unwrap.mesh];
    let mut written = BTreeMap::new();
    for (primitive, unwrapped) in mesh.primitives.iter().zip(&unwrap.primitives) {
        if unwrapped.triangles.is_empty() {
            continue;
        }
        let place = format!("meshes[{}].primitives[{}]", mesh.source, primitive.source);
        let rewritten = authored["primitives"]
            .get(primitive.source)
            .and_then(|authored| {
                primitive::rewrite(
                    document,
                    &input.scene.source,
                    authored,
                    unwrapped,
                    coordinates(input, unwrap_idx),
                    &place,
                    warnings,
                )
            });
        let rewritten = rewritten
            .ok_or_else(|| invalid(input, place, "positions of the primitive cannot be copied"))?;
        written.insert(primitive.source, rewritten);
    }
    for &number in whole.into_iter().flatten() {
        if let Some(authored) = authored["primitives"].get(number) {
            written.entry(number).or_insert_with(|| Rewritten {
                json: authored.clone(),
                moved_to: None,
            });
        }
    }
    Ok(written.into_values().collect())
}

/// What turns a place in an unwrap, in texels, into `TEXCOORD_1`.
fn coordinates(input: Input<'_>, unwrap: usize) -> impl Fn(DVec2) -> [f32; 2] {
    let [width, height] = input.atlas.unwraps[unwrap].size;
    let mut size = DVec2::new(width.into(), height.into());
    let mut offset = DVec2::ZERO;
    if let Some(placement) = input.alone[unwrap] {
        let page = input.atlas.pages[placement.page];
        size = DVec2::new(page.width.into(), page.height.into());
        offset = DVec2::new(placement.offset[0].into(), placement.offset[1].into());
    }
    move |texel| ((texel + offset) / size).as_vec2().to_array()
}

/// For each unwrap that is the first part of an instance, the primitives that no part holds: points, lines, triangles without area.
fn kept_primitives(input: Input<'_>) -> BTreeMap<usize, BTreeSet<usize>> {
    let mut parts: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for placement in &input.atlas.placements {
        parts
            .entry(placement.instance)
            .or_default()
            .insert(placement.unwrap);
    }
    let mut kept = BTreeMap::new();
    for unwraps in parts.values() {
        let Some(&first) = unwraps.first() else {
            continue;
        };
        if kept.contains_key(&first) {
            continue;
        }
        let mesh = &input.scene.meshes[input.atlas.unwraps[first].mesh];
        let authored = input.scene.source.json["meshes"][mesh.source]["primitives"].as_array();
        let all = 0..authored.map_or(0, Vec::len);
        let is_unwrapped = |number: &usize| {
            unwraps.iter().any(|&unwrap| {
                let unwrapped = &input.atlas.unwraps[unwrap].primitives;
                let mut pairs = mesh.primitives.iter().zip(unwrapped);
                pairs.any(|(primitive, unwrapped)| {
                    primitive.source == *number && !unwrapped.triangles.is_empty()
                })
            })
        };
        let rest = all.filter(|number| !is_unwrapped(number)).collect();
        kept.insert(first, rest);
    }
    kept
}

/// Authored meshes that some node still draws as they were.
fn meshes_in_use(document: &Document, input: Input<'_>) -> BTreeSet<usize> {
    let nodes = document.list("nodes").iter().enumerate();
    nodes
        .filter(|(node, _)| {
            let draws_authored = |unwrap: Option<usize>| {
                unwrap.is_none_or(|unwrap| input.atlas.unwraps[unwrap].authored)
            };
            input
                .nodes
                .get(node)
                .is_none_or(|groups| groups.iter().any(|group| draws_authored(group.unwrap)))
        })
        .filter_map(|(_, node)| node.get("mesh")?.as_u64())
        .map(|mesh| mesh as usize)
        .collect()
}

fn invalid(input: Input<'_>, place: String, reason: &str) -> Error {
    Error::InvalidFile {
        path: input.scene.path.clone(),
        place,
        reason: reason.to_owned(),
    }
}

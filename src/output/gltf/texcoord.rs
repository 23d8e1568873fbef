//! Frees `TEXCOORD_1` where pictures are placed by it.
//!
//! The lightmap takes the second set, because that is where engines look for it. Where a material reads the authored one, that set
//! moves to the next free number and the material with it. Materials are shared: one that other, unmoved primitives use as well is
//! copied, so that both see their picture where it was.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value};

use crate::output::gltf::document::Document;

/// Where a primitive stands: its mesh and its number in it.
pub(super) type Place = (usize, usize);

/// Whether a material of `primitive` (its own, or one of `KHR_materials_variants`) places a picture by `TEXCOORD_1`, and it has one.
pub(super) fn is_used(document: &Document, primitive: &Map<String, Value>) -> bool {
    let has_set = primitive
        .get("attributes")
        .is_some_and(|attributes| attributes.get("TEXCOORD_1").is_some());
    let materials = document.list("materials");
    has_set
        && references(primitive)
            .filter_map(|material| materials.get(material))
            .any(reads_second_set)
}

/// The first number above those in use.
pub(super) fn free_set(attributes: &Map<String, Value>) -> u64 {
    attributes
        .keys()
        .filter_map(|semantic| semantic.strip_prefix("TEXCOORD_")?.parse::<u64>().ok())
        .max()
        .map_or(2, |last| last.saturating_add(1).max(2))
}

/// Points the materials of moved primitives at their new set; `moved` says which primitives moved where.
pub(super) fn repoint(document: &mut Document, moved: &BTreeMap<Place, u64>) {
    // Who reads which material, and from which set from now on.
    let mut sets: BTreeMap<usize, BTreeSet<Option<u64>>> = BTreeMap::new();
    for (mesh_idx, mesh) in document.list("meshes").iter().enumerate() {
        let primitives = mesh.get("primitives").and_then(Value::as_array);
        for (index, primitive) in primitives.into_iter().flatten().enumerate() {
            let set = moved.get(&(mesh_idx, index)).copied();
            for material in primitive.as_object().into_iter().flat_map(references) {
                sets.entry(material).or_default().insert(set);
            }
        }
    }

    // The first user keeps the material, every other set gets a copy. `None`, the unmoved, sorts first.
    let mut copies: BTreeMap<(usize, u64), usize> = BTreeMap::new();
    for (material, sets) in sets {
        let Some(authored) = document.list("materials").get(material).cloned() else {
            continue;
        };
        if !reads_second_set(&authored) {
            continue;
        }
        for (number, set) in sets.into_iter().enumerate() {
            let Some(set) = set else {
                continue;
            };
            let mut repointed = authored.clone();
            move_second_set(&mut repointed, set);
            let target = if number == 0 {
                if let Some(place) = document.object_mut("materials", material)
                    && let Value::Object(repointed) = repointed
                {
                    *place = repointed;
                }
                material
            } else {
                document.push("materials", repointed)
            };
            copies.insert((material, set), target);
        }
    }

    for (&(mesh, primitive), &set) in moved {
        let primitive = document.object_mut("meshes", mesh).and_then(|mesh| {
            mesh.get_mut("primitives")?
                .get_mut(primitive)?
                .as_object_mut()
        });
        for reference in primitive.into_iter().flat_map(references_mut) {
            let target = reference
                .as_u64()
                .and_then(|material| copies.get(&(material as usize, set)));
            if let Some(&target) = target {
                *reference = target.into();
            }
        }
    }
}

/// Whether any texture of a material is placed by `TEXCOORD_1`, by itself or by its `KHR_texture_transform`.
fn reads_second_set(material: &Value) -> bool {
    let mut found = false;
    each_texture(&mut material.clone(), &mut |texture| {
        found |= sets_of(texture).any(|set| *set == 1);
    });
    found
}

/// Points the textures of a material that are placed by `TEXCOORD_1` at `set`.
fn move_second_set(material: &mut Value, set: u64) {
    each_texture(material, &mut |texture| {
        for reference in sets_of(texture).filter(|reference| **reference == 1) {
            *reference = set.into();
        }
    });
}

/// Calls `visit` for every texture reference of a material, those of extensions included: objects with an integer `index`.
fn each_texture(value: &mut Value, visit: &mut impl FnMut(&mut Map<String, Value>)) {
    match value {
        Value::Object(object) => {
            if object.get("index").is_some_and(Value::is_u64) {
                visit(object);
            }
            for (key, value) in object.iter_mut() {
                if key != "extras" {
                    each_texture(value, visit);
                }
            }
        }
        Value::Array(list) => list.iter_mut().for_each(|value| each_texture(value, visit)),
        _ => {}
    }
}

/// The `texCoord` entries of a texture reference.
fn sets_of(texture: &mut Map<String, Value>) -> impl Iterator<Item = &mut Value> {
    let (mut own, mut transformed) = (None, None);
    for (key, value) in texture {
        match key.as_str() {
            "texCoord" => own = Some(value),
            "extensions" => {
                transformed = value
                    .get_mut("KHR_texture_transform")
                    .and_then(|transform| transform.get_mut("texCoord"));
            }
            _ => {}
        }
    }
    own.into_iter().chain(transformed)
}

/// The materials of a primitive, those of its variants included.
fn references(primitive: &Map<String, Value>) -> impl Iterator<Item = usize> {
    let mappings = primitive.get("extensions").and_then(|extensions| {
        extensions
            .get("KHR_materials_variants")?
            .get("mappings")?
            .as_array()
    });
    let variants = mappings
        .into_iter()
        .flatten()
        .filter_map(|mapping| mapping.get("material"));
    primitive
        .get("material")
        .into_iter()
        .chain(variants)
        .filter_map(|material| material.as_u64().map(|index| index as usize))
}

/// The places where a primitive names its materials.
fn references_mut(primitive: &mut Map<String, Value>) -> Vec<&mut Value> {
    let mut references = Vec::new();
    for (key, value) in primitive {
        match key.as_str() {
            "material" => references.push(value),
            "extensions" => {
                let mappings = value
                    .get_mut("KHR_materials_variants")
                    .and_then(|variants| variants.get_mut("mappings")?.as_array_mut());
                references.extend(
                    mappings
                        .into_iter()
                        .flatten()
                        .filter_map(|mapping| mapping.get_mut("material")),
                );
            }
            _ => {}
        }
    }
    references
}

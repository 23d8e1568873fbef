//! The vendor extension and its mirror in extras; the module above describes the JSON.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use crate::error::Warnings;
use crate::output::PageFiles;
use crate::output::gltf::Input;
use crate::output::gltf::document::{Document, remove_extension};
use crate::output::names;

/// Name of the extension.
const NAME: &str = "LUMEL_light_vector_map";

/// Our key in `extras`, which authors use as well.
pub(super) const EXTRAS: &str = "lumel";

/// Key of the mirror below [`EXTRAS`].
const MIRROR: &str = "lightVectorMap";

/// Version of the extension's JSON.
const VERSION: u32 = 1;

/// Adds `value` to an object's extensions and extras.
pub(super) fn attach(
    object: &mut Map<String, Value>,
    value: Value,
    place: &str,
    warnings: &mut Warnings,
) {
    mirror(object, &value, place, warnings);
    if let Some(extensions) = member(object, "extensions") {
        extensions.insert(NAME.to_owned(), value);
    }
}

/// Removes what an earlier bake of the document left.
pub(super) fn strip(document: &mut Document) {
    strip_object(&mut document.json);
    for key in ["nodes", "scenes"] {
        let list = document.json.get_mut(key).and_then(Value::as_array_mut);
        let objects = list.into_iter().flatten().filter_map(Value::as_object_mut);
        objects.for_each(strip_object);
    }
    document.undeclare(NAME);
}

/// Adds the document's extension, its mirror, and the name to `extensionsUsed`.
pub(super) fn announce(
    document: &mut Document,
    input: Input<'_>,
    pages: &[PageFiles],
    warnings: &mut Warnings,
) {
    let value = json!({
        "version": VERSION,
        "generator": concat!("lumel ", env!("CARGO_PKG_VERSION")),
        "rowOrder": "top-first",
        "texelCenter": [0.5, 0.5],
        "maps": pages.iter().map(map).collect::<Vec<_>>(),
    });
    for scene in lit_scenes(document, input) {
        if let Some(scene_object) = document.object_mut("scenes", scene) {
            mirror(scene_object, &value, &format!("scenes[{scene}]"), warnings);
        }
    }
    if document.list("scenes").is_empty() {
        mirror(&mut document.json, &value, "", warnings);
    }
    if let Some(extensions) = member(&mut document.json, "extensions") {
        extensions.insert(NAME.to_owned(), value);
    }
    document.push("extensionsUsed", NAME.into());
}

/// Adds `value` to an object's extras.
fn mirror(object: &mut Map<String, Value>, value: &Value, place: &str, warnings: &mut Warnings) {
    let lumel = member(object, "extras").and_then(|extras| member(extras, EXTRAS));
    match lumel {
        Some(lumel) => {
            lumel.insert(MIRROR.to_owned(), value.clone());
        }
        None => warnings.push(
            "extras is not an object, the lightmap stands in the extension only",
            place,
        ),
    }
}

/// An entry of `maps`.
fn map(page: &PageFiles) -> Value {
    let mut map = Map::new();
    map.insert("width".to_owned(), page.width.into());
    map.insert("height".to_owned(), page.height.into());
    map.insert("texCoord".to_owned(), 1.into());
    map.insert("space".to_owned(), "world".into());
    map.insert("unit".to_owned(), "lux".into());
    for file in &page.maps {
        let uri = Value::from(names::uri(&file.file));
        let [key, channel] = keys(&file.plane);
        if channel.is_empty() {
            map.insert(key.to_owned(), uri);
        } else if let Some(channels) = member(&mut map, key) {
            channels.insert(channel.to_owned(), uri);
        }
    }
    Value::Object(map)
}

/// Key of a plane in an entry of `maps`, and the colour channel below it; a plane without a word of its own is its own key.
fn keys(plane: &str) -> [&str; 2] {
    match plane {
        "E" => ["irradiance", ""],
        "phi" => ["fluence", ""],
        "err" => ["error", ""],
        "Gr" => ["lightVector", "r"],
        "Gg" => ["lightVector", "g"],
        "Gb" => ["lightVector", "b"],
        "Gr_du" => ["lightVectorDu", "r"],
        "Gg_du" => ["lightVectorDu", "g"],
        "Gb_du" => ["lightVectorDu", "b"],
        "Gr_dv" => ["lightVectorDv", "r"],
        "Gg_dv" => ["lightVectorDv", "g"],
        "Gb_dv" => ["lightVectorDv", "b"],
        other => [other, ""],
    }
}

/// Scenes whose trees hold a lit node.
fn lit_scenes(document: &Document, input: Input<'_>) -> Vec<usize> {
    let nodes = document.list("nodes");
    let indices = |list: Option<&Value>| -> Vec<usize> {
        let list = list.and_then(Value::as_array);
        let numbers = list.into_iter().flatten().filter_map(Value::as_u64);
        numbers.map(|number| number as usize).collect()
    };
    let is_lit = |scene: &Value| {
        let mut open = indices(scene.get("nodes"));
        let mut seen = BTreeSet::new();
        while let Some(node) = open.pop() {
            if input.nodes.contains_key(&node) {
                return true;
            }
            // A forged document may have a cycle.
            if seen.insert(node) {
                open.extend(indices(
                    nodes.get(node).and_then(|node| node.get("children")),
                ));
            }
        }
        false
    };
    let scenes = document.list("scenes").iter().enumerate();
    scenes
        .filter(|(_, scene)| is_lit(scene))
        .map(|(index, _)| index)
        .collect()
}

/// Removes the extension and its mirror, and what becomes empty by that.
fn strip_object(object: &mut Map<String, Value>) {
    remove_extension(object, NAME);
    let Some(Value::Object(extras)) = object.get_mut("extras") else {
        return;
    };
    let Some(Value::Object(lumel)) = extras.get_mut(EXTRAS) else {
        return;
    };
    if lumel.shift_remove(MIRROR).is_none() || !lumel.is_empty() {
        return;
    }
    extras.shift_remove(EXTRAS);
    if extras.is_empty() {
        object.shift_remove("extras");
    }
}

/// A member that is an object, made when it is missing; `None` when it is something else.
fn member<'a>(object: &'a mut Map<String, Value>, key: &str) -> Option<&'a mut Map<String, Value>> {
    object
        .entry(key)
        .or_insert_with(|| Value::Object(Map::new()))
        .as_object_mut()
}

//! The schema of the glTF extension holds for what is written, and says no to what is not.

use std::fs;
use std::path::Path;

use lumel::scene;
use serde_json::{Value, json};

use crate::output::{document, glb};
use crate::support;

const EXTENSION: &str = "LUMEL_light_vector_map";

fn schema() -> Value {
    let path = support::root().join("docs/LUMEL_light_vector_map.schema.json");
    serde_json::from_slice(&fs::read(path).expect("readable")).expect("JSON")
}

/// What `value` does wrong, with its place. Knows the keywords that our schema uses and refuses others.
fn faults(root: &Value, schema: &Value, value: &Value, place: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut fail = |what: String| found.push(format!("{place}: {what}"));
    let size = value.as_array().map(Vec::len);
    for (keyword, wanted) in schema.as_object().expect("a schema is an object") {
        let nested = match keyword.as_str() {
            "$schema" | "$defs" | "title" | "description" => Vec::new(),
            "type" => {
                let is = match wanted.as_str().expect("one type") {
                    "object" => value.is_object(),
                    "array" => value.is_array(),
                    "string" => value.is_string(),
                    "number" => value.is_number(),
                    "integer" => value.is_u64(),
                    other => panic!("type {other}"),
                };
                if !is {
                    fail(format!("{value} is no {wanted}"));
                }
                Vec::new()
            }
            "enum" => {
                if !wanted.as_array().expect("a list").contains(value) {
                    fail(format!("{value} is none of {wanted}"));
                }
                Vec::new()
            }
            "minimum" => {
                if value.as_f64() < wanted.as_f64() {
                    fail(format!("{value} is below {wanted}"));
                }
                Vec::new()
            }
            "minLength" => {
                if value.as_str().map(str::len) < wanted.as_u64().map(|n| n as usize) {
                    fail("is too short".to_owned());
                }
                Vec::new()
            }
            "minItems" | "maxItems" => {
                let limit = wanted.as_u64().map(|n| n as usize);
                if keyword == "minItems" && size < limit || keyword == "maxItems" && size > limit {
                    fail(format!("has {size:?} items"));
                }
                Vec::new()
            }
            "required" => {
                for key in wanted
                    .as_array()
                    .into_iter()
                    .flatten()
                    .filter_map(Value::as_str)
                {
                    if value.get(key).is_none() {
                        fail(format!("lacks {key}"));
                    }
                }
                Vec::new()
            }
            "additionalProperties" => {
                assert_eq!(wanted, false);
                for key in value
                    .as_object()
                    .into_iter()
                    .flat_map(|object| object.keys())
                {
                    if schema["properties"].get(key).is_none() {
                        fail(format!("has {key}"));
                    }
                }
                Vec::new()
            }
            "properties" => wanted
                .as_object()
                .into_iter()
                .flatten()
                .filter_map(|(key, schema)| {
                    let member = value.get(key)?;
                    Some(faults(root, schema, member, &format!("{place}/{key}")))
                })
                .flatten()
                .collect(),
            "items" => value
                .as_array()
                .into_iter()
                .flatten()
                .enumerate()
                .flat_map(|(index, item)| faults(root, wanted, item, &format!("{place}/{index}")))
                .collect(),
            "$ref" => {
                let pointer = wanted.as_str().and_then(|link| link.strip_prefix('#'));
                let target = pointer.and_then(|pointer| root.pointer(pointer));
                faults(root, target.expect("a definition"), value, place)
            }
            "oneOf" => {
                let options = wanted.as_array().expect("a list");
                let fits = |option: &&Value| faults(root, option, value, place).is_empty();
                let n_fitting = options.iter().filter(fits).count();
                if n_fitting != 1 {
                    fail(format!("fits {n_fitting} of {} forms", options.len()));
                }
                Vec::new()
            }
            other => panic!("keyword {other}"),
        };
        nested.into_iter().for_each(&mut fail);
    }
    found
}

/// The JSON of a `.glb`.
fn json_of(path: &Path) -> Value {
    let bytes = fs::read(path).expect("readable");
    let length = u32::from_le_bytes(bytes[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).expect("JSON")
}

/// Checks every object of the extension and its mirror; returns how many nodes had one.
pub(crate) fn check(json: &Value) -> usize {
    let schema = schema();
    let said = &json["extensions"][EXTENSION];
    let document = faults(&schema, &schema, said, "document");
    assert!(document.is_empty(), "{document:?}");
    for scene in json["scenes"].as_array().into_iter().flatten() {
        let mirror = &scene["extras"]["lumel"]["lightVectorMap"];
        assert!(mirror.is_null() || mirror == said);
    }
    let mut n_nodes = 0;
    for node in json["nodes"].as_array().into_iter().flatten() {
        let said = &node["extensions"][EXTENSION];
        if said.is_null() {
            continue;
        }
        n_nodes += 1;
        let node_faults = faults(&schema, &schema["$defs"]["node"], said, "node");
        assert!(node_faults.is_empty(), "{node_faults:?}");
        let extras = &node["extras"];
        // Authors may put anything into extras; what is no object stays as it is.
        if extras.is_object() && extras["lumel"].is_object() {
            assert_eq!(said, &extras["lumel"]["lightVectorMap"]);
        }
    }
    let used = json["extensionsUsed"].as_array().expect("a list");
    assert!(used.contains(&json!(EXTENSION)));
    assert!(!json["extensionsRequired"].to_string().contains(EXTENSION));
    n_nodes
}

#[test]
fn what_is_written_keeps_to_the_schema() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = document::hard(folder.path());
    let scene = scene::load(&path, &scene::Options::default()).unwrap_or_else(|e| panic!("{e}"));
    for (case, n_variants, n_parts) in [(0, 1, 1), (1, 2, 1), (2, 1, 2), (3, 2, 2)] {
        let atlas = document::random_atlas(&scene, case, n_variants, n_parts);
        let target = folder.path().join(case.to_string());
        let (file, _) = glb::write(&scene, &atlas, &target);
        assert!(check(&json_of(&file)) > 0);
    }
}

#[test]
fn the_schema_refuses_what_is_not_ours() {
    let schema = schema();
    let good = json!({
        "version": 1, "generator": "x", "rowOrder": "top-first", "texelCenter": [0.5, 0.5],
        "maps": [{"width": 4, "height": 4, "texCoord": 1, "space": "world", "unit": "lux", "ktx2": "a.ktx2"}],
    });
    assert!(faults(&schema, &schema, &good, "").is_empty());
    for (pointer, bad) in [
        ("/version", json!(2)),
        ("/rowOrder", json!("bottom-first")),
        ("/texelCenter", json!([0.5])),
        ("/maps/0/width", json!(0)),
        ("/maps/0/ktx2", json!("")),
        ("/maps/0/unit", json!("nit")),
        ("/maps/0", json!({"width": 4})),
    ] {
        let mut changed = good.clone();
        *changed.pointer_mut(pointer).expect("a member") = bad;
        assert!(
            !faults(&schema, &schema, &changed, "").is_empty(),
            "{pointer}"
        );
    }
    for bad in [
        json!({"map": 0, "scale": [1.0, 1.0]}),
        json!({"map": 0, "scale": [1.0, 1.0], "offset": [0.0, 0.0], "instances": []}),
        json!({"map": -1, "scale": [1.0, 1.0], "offset": [0.0, 0.0]}),
    ] {
        assert!(
            !faults(&schema, &schema["$defs"]["node"], &bad, "").is_empty(),
            "{bad}"
        );
    }
}

//! Nodes: what they draw now, and where on which map it lies.
//!
//! Most nodes only change the number of their mesh. A node whose copies are drawn with different meshes hands everything that belongs
//! to drawing (mesh, skin, weights, instancing) to children of its own, which inherit its transform and its animation.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::error::{Error, Result, Warnings};
use crate::output::gltf::accessor;
use crate::output::gltf::document::{Document, remove_extension};
use crate::output::gltf::extension;
use crate::output::gltf::{Group, Input};

/// The extension that draws a node's mesh several times.
const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// Points every lit node at its mesh in `meshes` (by unwrap) and says where it lies.
pub(super) fn place(
    document: &mut Document,
    input: Input<'_>,
    meshes: &BTreeMap<usize, usize>,
    warnings: &mut Warnings,
) -> Result<()> {
    let mut parts = BTreeMap::new();
    for (&node_idx, groups) in input.nodes {
        let Some(node) = document.object_mut("nodes", node_idx) else {
            return Err(invalid(input, node_idx, "node is not in the document"));
        };
        match groups.as_slice() {
            [group] if draws_every_copy(group) => {
                if let Some(mesh) = group.unwrap.and_then(|unwrap| meshes.get(&unwrap)) {
                    node.insert("mesh".to_owned(), (*mesh).into());
                }
                let place = format!("nodes[{node_idx}]");
                extension::attach(node, places(input, group), &place, warnings);
            }
            groups => {
                let children = split(document, input, meshes, node_idx, groups, warnings)?;
                parts.insert(node_idx, children);
            }
        }
    }
    retarget_weights(document, &parts);
    Ok(())
}

/// Whether the copies of a group are those of its node, none left out.
fn draws_every_copy(group: &Group) -> bool {
    let mut copies = group.copies.iter().enumerate();
    copies.all(|(index, copy)| copy.number.is_none_or(|number| number == index))
}

/// The extension of a node that draws `group`.
fn places(input: Input<'_>, group: &Group) -> Value {
    let place = |placement: usize| {
        let placement = &input.atlas.placements[placement];
        let [scale, offset] = input.transform(placement);
        json!({"map": placement.page, "scale": scale, "offset": offset})
    };
    let placements = || group.copies.iter().filter_map(|copy| copy.placement);
    if group.copies.iter().any(|copy| copy.number.is_some()) {
        json!({"instances": placements().map(place).collect::<Vec<_>>()})
    } else {
        placements().next().map_or(Value::Null, place)
    }
}

/// Gives a node one child per group, which draws in its stead. Returns the children.
fn split(
    document: &mut Document,
    input: Input<'_>,
    meshes: &BTreeMap<usize, usize>,
    node_idx: usize,
    groups: &[Group],
    warnings: &mut Warnings,
) -> Result<Vec<usize>> {
    let Some(node) = document.object_mut("nodes", node_idx) else {
        return Ok(Vec::new());
    };
    let name = node
        .get("name")
        .and_then(Value::as_str)
        .map_or_else(|| format!("node{node_idx}"), str::to_owned);
    let mut drawing = Map::new();
    for key in ["mesh", "skin", "weights"] {
        if let Some(value) = node.shift_remove(key) {
            drawing.insert(key.to_owned(), value);
        }
    }
    // The author's wishes hold for the parts, should the result be baked again.
    let wishes = node
        .get("extras")
        .and_then(|extras| extras.get(extension::EXTRAS).cloned());
    if let Some(wishes) = wishes {
        drawing.insert("extras".to_owned(), json!({extension::EXTRAS: wishes}));
    }
    let instancing = node
        .get("extensions")
        .and_then(|extensions| extensions.get(INSTANCING).cloned());
    remove_extension(node, INSTANCING);

    let mut children = Vec::new();
    for (number, group) in groups.iter().enumerate() {
        let mut child = Map::new();
        child.insert("name".to_owned(), format!("{name}.part{number}").into());
        child.extend(drawing.clone());
        if let Some(mesh) = group.unwrap.and_then(|unwrap| meshes.get(&unwrap)) {
            child.insert("mesh".to_owned(), (*mesh).into());
        }
        if let Some(instancing) = &instancing {
            let instancing = select_copies(document, input, node_idx, instancing, group)?;
            child.insert("extensions".to_owned(), json!({INSTANCING: instancing}));
        }
        if group.unwrap.is_some() {
            let place = format!("nodes[{node_idx}]");
            extension::attach(&mut child, places(input, group), &place, warnings);
        }
        children.push(document.push("nodes", Value::Object(child)));
    }

    if let Some(node) = document.object_mut("nodes", node_idx) {
        let list = node.entry("children").or_insert_with(|| json!([]));
        if let Value::Array(list) = list {
            list.extend(children.iter().map(|&child| child.into()));
        }
    }
    Ok(children)
}

/// The instancing of a node for the copies of one group.
fn select_copies(
    document: &mut Document,
    input: Input<'_>,
    node_idx: usize,
    instancing: &Value,
    group: &Group,
) -> Result<Value> {
    let numbers: Vec<u32> = group
        .copies
        .iter()
        .filter_map(|copy| copy.number)
        .map(|number| number as u32)
        .collect();
    let mut selected = instancing.clone();
    let attributes = selected
        .get_mut("attributes")
        .and_then(Value::as_object_mut);
    for accessor in attributes.into_iter().flat_map(Map::values_mut) {
        *accessor = accessor::gather(document, &input.scene.source, accessor, &numbers, false)
            .map_err(|_| invalid(input, node_idx, "attributes of the copies cannot be read"))?
            .into();
    }
    Ok(selected)
}

/// Lets animations of morph weights drive the children of a node that was split.
fn retarget_weights(document: &mut Document, parts: &BTreeMap<usize, Vec<usize>>) {
    let animations = document
        .json
        .get_mut("animations")
        .and_then(Value::as_array_mut);
    let channels = animations
        .into_iter()
        .flatten()
        .filter_map(|animation| animation.get_mut("channels")?.as_array_mut());
    for channels in channels {
        let authored = std::mem::take(channels);
        for channel in authored {
            let children = channel
                .get("target")
                .filter(|target| target.get("path").is_some_and(|path| path == "weights"))
                .and_then(|target| parts.get(&(target.get("node")?.as_u64()? as usize)));
            let Some(children) = children else {
                channels.push(channel);
                continue;
            };
            for &child in children {
                let mut copy = channel.clone();
                copy["target"]["node"] = child.into();
                channels.push(copy);
            }
        }
    }
}

fn invalid(input: Input<'_>, node: usize, reason: &str) -> Error {
    Error::InvalidFile {
        path: input.scene.path.clone(),
        place: format!("nodes[{node}]"),
        reason: reason.to_owned(),
    }
}

//! The node hierarchy in world space.
//!
//! Everything here is a loop over lists, never a recursion, so that a chain of a hundred thousand nodes is as good as any other.

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec4};
use serde::Deserialize;
use serde_json::Value;

use super::Options;
use super::document::Document;
use crate::error::{Error, Result, Warnings};

/// A node as it is authored. Own type, because the one of the `gltf` crate rounds transforms to f32.
#[derive(Debug, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub(super) name: Option<String>,
    pub(super) mesh: Option<usize>,
    pub(super) skin: Option<usize>,
    pub(super) weights: Vec<f64>,
    pub(super) extensions: Extensions,
    pub(super) extras: Value,
    children: Vec<usize>,
    matrix: Option<[f64; 16]>,
    translation: [f64; 3],
    rotation: [f64; 4],
    scale: [f64; 3],
}

/// The extensions of nodes that are read.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Extensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<Instancing>,
    #[serde(rename = "KHR_lights_punctual")]
    pub(super) light: Option<LightReference>,
    #[serde(rename = "EXT_lights_area")]
    pub(super) area_light: Option<LightReference>,
    #[serde(rename = "KHR_node_visibility")]
    visibility: Option<Visibility>,
}

/// Accessors of the copies' transforms.
#[derive(Debug, Deserialize)]
pub(super) struct Instancing {
    /// `TRANSLATION`, `ROTATION`, `SCALE` and what else an exporter likes.
    #[serde(default)]
    pub(super) attributes: BTreeMap<String, usize>,
}

/// Which light stands at a node.
#[derive(Debug, Deserialize)]
pub(super) struct LightReference {
    pub(super) light: usize,
}

#[derive(Debug, Deserialize)]
struct Visibility {
    #[serde(default = "yes")]
    visible: bool,
}

fn yes() -> bool {
    true
}

impl Default for Node {
    fn default() -> Self {
        Self {
            name: None,
            mesh: None,
            skin: None,
            weights: Vec::new(),
            extensions: Extensions::default(),
            extras: Value::Null,
            children: Vec::new(),
            matrix: None,
            translation: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
            scale: [1.0; 3],
        }
    }
}

impl Node {
    /// Authored name, else `node<index>`.
    pub(super) fn name(&self, index: usize) -> String {
        self.name.clone().unwrap_or_else(|| format!("node{index}"))
    }

    fn parent_from_local(&self, place: &str, warnings: &mut Warnings) -> DAffine3 {
        let Some(matrix) = &self.matrix else {
            let rotation = rotation(self.rotation, place, warnings);
            return DAffine3::from_scale_rotation_translation(
                self.scale.into(),
                rotation,
                self.translation.into(),
            );
        };
        let matrix = DMat4::from_cols_array(matrix);
        if matrix.row(3) != DVec4::W {
            warnings.push("matrix is not affine, its last row is ignored", place);
        }
        DAffine3 {
            matrix3: DMat3::from_mat4(matrix),
            translation: matrix.w_axis.truncate(),
        }
    }
}

/// A unit quaternion. One that is far from unit length is normalised with a warning, a zero one is no rotation.
pub(super) fn rotation(rotation: [f64; 4], place: &str, warnings: &mut Warnings) -> DQuat {
    // Quaternions in normalised bytes are off by up to a step of 127.
    const EXPECTED: f64 = 0.02;
    let rotation = DQuat::from_array(rotation);
    let length = rotation.length();
    if (length - 1.0).abs() <= EXPECTED {
        return rotation.normalize();
    }
    warnings.push("rotation is not a unit quaternion, normalised", place);
    let normalized = DQuat::from_vec4(DVec4::from(rotation).normalize_or_zero());
    if normalized.length_squared() > 0.0 {
        normalized
    } else {
        DQuat::IDENTITY
    }
}

/// All nodes, and which of them are in the scene.
pub(super) struct Hierarchy {
    /// In the document's order.
    pub(super) nodes: Vec<Node>,
    /// Local to world, for every node.
    pub(super) world: Vec<DAffine3>,
    /// Nodes of the chosen scene, parents first, in authored order.
    pub(super) order: Vec<usize>,
}

impl Hierarchy {
    /// Reads all nodes and walks through the scene that `options` choose.
    ///
    /// A node with two parents and a node above itself are errors: a tree is the one thing every reader relies on.
    pub(super) fn read(
        document: &Document<'_>,
        options: &Options,
        warnings: &mut Warnings,
    ) -> Result<Self> {
        let nodes = (0..document.list("nodes")?.len())
            .map(|index| document.get("nodes", index, "nodes"))
            .collect::<Result<Vec<Node>>>()?;
        let parents = parents(document, &nodes)?;
        let world = world(document, &nodes, &parents, warnings)?;
        let roots = match scene_roots(document, options)? {
            Some((place, roots)) => check_roots(document, &place, roots, &parents, warnings)?,
            None => (0..nodes.len())
                .filter(|node| parents[*node].is_none())
                .collect(),
        };
        let order = walk(&nodes, &roots, warnings);
        Ok(Self {
            nodes,
            world,
            order,
        })
    }
}

fn parents(document: &Document<'_>, nodes: &[Node]) -> Result<Vec<Option<usize>>> {
    let mut parents = vec![None; nodes.len()];
    for (parent, node) in nodes.iter().enumerate() {
        for &child in &node.children {
            let place = || format!("nodes[{parent}].children");
            let slot: &mut Option<usize> = parents.get_mut(child).ok_or_else(|| {
                document.invalid(
                    place(),
                    format!("refers to nodes[{child}], but there are {}", nodes.len()),
                )
            })?;
            if let Some(other) = slot {
                return Err(document.invalid(
                    place(),
                    format!("nodes[{child}] is already a child of nodes[{other}]"),
                ));
            }
            *slot = Some(parent);
        }
    }
    Ok(parents)
}

/// World transforms of all nodes. Since no node has two parents, those that are not below a root are in a cycle.
fn world(
    document: &Document<'_>,
    nodes: &[Node],
    parents: &[Option<usize>],
    warnings: &mut Warnings,
) -> Result<Vec<DAffine3>> {
    let mut world = vec![None; nodes.len()];
    let mut ready: Vec<usize> = (0..nodes.len())
        .rev()
        .filter(|node| parents[*node].is_none())
        .collect();
    while let Some(node) = ready.pop() {
        let above = parents[node]
            .and_then(|parent| world[parent])
            .unwrap_or(DAffine3::IDENTITY);
        let local = nodes[node].parent_from_local(&format!("nodes[{node}]"), warnings);
        world[node] = Some(above * local);
        ready.extend(nodes[node].children.iter().rev());
    }
    world
        .into_iter()
        .enumerate()
        .map(|(node, world)| {
            world.ok_or_else(|| document.invalid(format!("nodes[{node}]"), "is its own ancestor"))
        })
        .collect()
}

/// Place and roots of the scene to read; `None` when the document has no scenes.
fn scene_roots(document: &Document<'_>, options: &Options) -> Result<Option<(String, Vec<usize>)>> {
    /// The part of a scene that is read.
    #[derive(Deserialize)]
    struct Roots {
        #[serde(default)]
        nodes: Vec<usize>,
    }
    let n_scenes = document.list("scenes")?.len();
    let scene = match (options.scene, document.json.get("scene")) {
        (Some(scene), _) if scene >= n_scenes => {
            return Err(Error::InvalidOption {
                option: "scene",
                reason: match n_scenes {
                    0 => format!("the document has no scenes, scene {scene} was asked for"),
                    _ => format!("must be in 0..={}, is {scene}", n_scenes - 1),
                },
            });
        }
        (Some(scene), _) => scene,
        (None, Some(scene)) => document.parse(scene, || "scene".to_owned())?,
        (None, None) if n_scenes == 0 => return Ok(None),
        (None, None) => 0,
    };
    let roots: Roots = document.get("scenes", scene, "scene")?;
    Ok(Some((format!("scenes[{scene}].nodes"), roots.nodes)))
}

fn check_roots(
    document: &Document<'_>,
    place: &str,
    roots: Vec<usize>,
    parents: &[Option<usize>],
    warnings: &mut Warnings,
) -> Result<Vec<usize>> {
    for &root in &roots {
        document.value("nodes", root, place)?;
        if parents[root].is_some() {
            warnings.push(
                "scene lists a node that is a child, it stays below its parent",
                format!("nodes[{root}]"),
            );
        }
    }
    Ok(roots)
}

/// Nodes below `roots`, parents first, without hidden ones.
fn walk(nodes: &[Node], roots: &[usize], warnings: &mut Warnings) -> Vec<usize> {
    let mut order = Vec::new();
    let mut seen = vec![false; nodes.len()];
    let mut stack: Vec<usize> = roots.iter().rev().copied().collect();
    while let Some(node) = stack.pop() {
        let place = || format!("nodes[{node}]");
        if std::mem::replace(&mut seen[node], true) {
            warnings.push("scene lists a node twice, it counts once", place());
            continue;
        }
        let visibility = &nodes[node].extensions.visibility;
        if visibility.as_ref().is_some_and(|it| !it.visible) {
            warnings.push("node is hidden and left out, with all below it", place());
            continue;
        }
        order.push(node);
        stack.extend(nodes[node].children.iter().rev());
    }
    order
}

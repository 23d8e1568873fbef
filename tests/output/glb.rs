//! The glTF file draws what was authored and says where it lies on the maps.

use std::fs;
use std::path::{Path, PathBuf};

use lumel::atlas::{Atlas, Unwrap};
use lumel::error::Warnings;
use lumel::output::{Options, Writer};
use lumel::scene::{self, Scene};
use serde_json::{Value, json};

use crate::output::document;
use crate::support;

const NAME: &str = "LUMEL_light_vector_map";

/// A glTF document with its buffers.
pub(crate) struct Document {
    pub(crate) json: Value,
    buffers: Vec<Vec<u8>>,
}

impl Document {
    /// Reads a `.glb` by the letter of the container.
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = fs::read(path).expect("readable");
        let number = |at: usize| {
            let number = bytes[at..at + 4].try_into().expect("four bytes");
            u32::from_le_bytes(number) as usize
        };
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!(number(4), 2);
        assert_eq!(number(8), bytes.len());
        let text_end = 20 + number(12);
        assert_eq!(&bytes[16..20], b"JSON");
        assert_eq!(text_end % 4, 0);
        let json: Value = serde_json::from_slice(&bytes[20..text_end]).expect("JSON");
        let mut buffers = Vec::new();
        if text_end < bytes.len() {
            assert_eq!(&bytes[text_end + 4..text_end + 8], b"BIN\0");
            assert_eq!(number(text_end), bytes.len() - text_end - 8);
            buffers.push(bytes[text_end + 8..].to_vec());
            assert_eq!(json["buffers"][0]["byteLength"], buffers[0].len());
            assert!(json["buffers"][0].get("uri").is_none());
        }
        Self { json, buffers }
    }

    fn of(scene: &Scene) -> Self {
        Self {
            json: scene.source.json.clone(),
            buffers: scene.source.buffers.clone(),
        }
    }

    /// Components of all elements of an accessor, decoded the slow way.
    pub(crate) fn elements(&self, index: usize) -> Vec<Vec<f64>> {
        let accessor = &self.json["accessors"][index];
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        let n = match accessor["type"].as_str().expect("a type") {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => panic!("{other}"),
        };
        let size = |kind: u64| match kind {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let kind = accessor["componentType"]
            .as_u64()
            .expect("a component type");
        let at =
            |part: &Value, offset: usize, kind: u64, stride: Option<usize>, i: usize, c: usize| {
                let view = &self.json["bufferViews"][number(&part["bufferView"])];
                let stride = stride.unwrap_or_else(|| match number(&view["byteStride"]) {
                    0 => n * size(kind),
                    stride => stride,
                });
                let start = number(&view["byteOffset"]) + offset + i * stride + c * size(kind);
                component(&self.buffers[number(&view["buffer"])][start..], kind)
            };
        let count = number(&accessor["count"]);
        let offset = number(&accessor["byteOffset"]);
        let mut elements: Vec<Vec<f64>> = (0..count)
            .map(|i| {
                (0..n)
                    .map(|c| match accessor.get("bufferView") {
                        Some(_) => at(accessor, offset, kind, None, i, c),
                        None => 0.0,
                    })
                    .collect()
            })
            .collect();
        let sparse = &accessor["sparse"];
        for entry in 0..number(&sparse["count"]) {
            let [indices, values] = [&sparse["indices"], &sparse["values"]];
            let index_kind = indices["componentType"].as_u64().expect("a component type");
            let offset = number(&indices["byteOffset"]);
            let index = at(
                indices,
                offset,
                index_kind,
                Some(size(index_kind)),
                entry,
                0,
            );
            let offset = number(&values["byteOffset"]);
            elements[index as usize] = (0..n)
                .map(|c| at(values, offset, kind, Some(n * size(kind)), entry, c))
                .collect();
        }
        elements
    }

    /// All attributes of a primitive but `TEXCOORD_1`, those of morph targets included, by name.
    fn attributes(&self, primitive: &Value) -> Vec<(String, Vec<Vec<f64>>)> {
        let mut attributes = Vec::new();
        let targets = primitive["targets"].as_array().into_iter().flatten();
        for (number, object) in std::iter::once(&primitive["attributes"])
            .chain(targets)
            .enumerate()
        {
            for (name, accessor) in object.as_object().expect("attributes") {
                if name != "TEXCOORD_1" {
                    let accessor = accessor.as_u64().expect("an index") as usize;
                    attributes.push((format!("{number} {name}"), self.elements(accessor)));
                }
            }
        }
        attributes.sort_by(|a, b| a.0.cmp(&b.0));
        attributes
    }
}

fn component(bytes: &[u8], kind: u64) -> f64 {
    match kind {
        5120 => f64::from(bytes[0] as i8),
        5121 => f64::from(bytes[0]),
        5122 => f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
        5123 => f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        5125 => f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        _ => f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
    }
}

/// Writes `scene` laid out as `atlas` into `folder`. Returns the path and the warnings.
pub(crate) fn write(scene: &Scene, atlas: &Atlas, folder: &Path) -> (PathBuf, Warnings) {
    let mut writer = Writer::create(folder, "out", &Options::default()).expect("writable");
    let warnings = writer
        .glb(scene, atlas, &document::pages(atlas))
        .unwrap_or_else(|error| panic!("{error}"));
    writer.commit().expect("committed");
    (folder.join("out.glb"), warnings)
}

/// A triangle corner: every attribute but the lightmap coordinates, and the place on the page.
type Corner = (Vec<Vec<f64>>, [f64; 2]);

/// What a node draws: for each mesh and copy, the map and all corners.
type Drawing = Vec<(u64, Vec<Corner>)>;

/// The authored second set under its new name, when a material of the primitive reads it.
fn moved_set(authored: &Document, primitive: &Value) -> Option<(String, Vec<Vec<f64>>)> {
    let second = primitive["attributes"]["TEXCOORD_1"].as_u64()?;
    let mut material = authored.json["materials"][primitive["material"].as_u64()? as usize].clone();
    material.as_object_mut()?.remove("extras");
    let names = primitive["attributes"].as_object()?.keys();
    let n_sets = names.filter(|name| name.starts_with("TEXCOORD_")).count();
    let is_read = material.to_string().contains("\"texCoord\":1");
    is_read.then(|| {
        (
            format!("0 TEXCOORD_{n_sets}"),
            authored.elements(second as usize),
        )
    })
}

/// What node `node` must draw, from the authored document and the layout.
fn wanted(scene: &Scene, atlas: &Atlas, authored: &Document, node: usize) -> Drawing {
    let mut placements: Vec<_> = atlas
        .placements
        .iter()
        .filter(|placement| scene.instances[placement.instance].node == node)
        .collect();
    placements.sort_by_key(|placement| (placement.unwrap, placement.instance));
    let mut drawing = Vec::new();
    for placement in placements {
        let unwrap = &atlas.unwraps[placement.unwrap];
        let mesh = &scene.meshes[unwrap.mesh];
        let page = atlas.pages[placement.page];
        let mut corners = Vec::new();
        for (primitive, unwrapped) in mesh.primitives.iter().zip(&unwrap.primitives) {
            if unwrapped.triangles.is_empty() {
                continue;
            }
            let json = &authored.json["meshes"][mesh.source]["primitives"][primitive.source];
            let mut attributes = authored.attributes(json);
            attributes.extend(moved_set(authored, json));
            attributes.sort_by(|a, b| a.0.cmp(&b.0));
            for &corner in unwrapped.triangles.as_flattened() {
                let vertex = unwrapped.source_vertices[corner as usize] as usize;
                let texel = unwrapped.texcoords[corner as usize];
                let [x, y] = placement.offset.map(f64::from);
                corners.push((
                    attributes
                        .iter()
                        .map(|(_, all)| all[vertex].clone())
                        .collect(),
                    [
                        (texel.x + x) / f64::from(page.width),
                        (texel.y + y) / f64::from(page.height),
                    ],
                ));
            }
        }
        drawing.push((placement.page as u64, corners));
    }
    drawing
}

/// What node `node` of the written document draws; also counts the primitives that have no lightmap coordinates.
fn drawn(written: &Document, node: usize, authored: &Value, n_plain: &mut usize) -> Drawing {
    let nodes = written.json["nodes"].as_array().expect("nodes");
    let n_authored = authored["nodes"].as_array().expect("nodes").len();
    let mut drawers = vec![node];
    if nodes[node].get("mesh").is_none() {
        let children = nodes[node]["children"].as_array().expect("children");
        let children = children
            .iter()
            .map(|child| child.as_u64().expect("an index") as usize);
        drawers = children.filter(|&child| child >= n_authored).collect();
    }
    let mut drawing = Vec::new();
    for drawer in drawers {
        let extension = &nodes[drawer]["extensions"][NAME];
        let extras = &nodes[drawer]["extras"];
        if extras.is_object() {
            assert_eq!(extras["lumel"]["lightVectorMap"], *extension, "mirror");
        }
        let places = match extension.get("instances") {
            Some(instances) => instances.as_array().expect("a list").clone(),
            None => vec![extension.clone()],
        };
        let mesh = nodes[drawer]["mesh"].as_u64().expect("a mesh") as usize;
        for place in places.iter().filter(|place| !place.is_null()) {
            let number = |key: &str, axis: usize| place[key][axis].as_f64().expect("a number");
            let mut corners = Vec::new();
            for primitive in written.json["meshes"][mesh]["primitives"]
                .as_array()
                .expect("list")
            {
                if primitive["mode"].as_u64().unwrap_or(4) != 4 {
                    *n_plain += 1;
                    continue;
                }
                let lightmap = primitive["attributes"]["TEXCOORD_1"].as_u64();
                let lightmap = written.elements(lightmap.expect("an index") as usize);
                let mut attributes = written.attributes(primitive);
                // A first set may have been made up, because sets are numbered without gaps.
                if primitive["attributes"]["TEXCOORD_0"] == primitive["attributes"]["TEXCOORD_1"] {
                    attributes.retain(|(name, _)| name != "0 TEXCOORD_0");
                }
                let indices = primitive["indices"].as_u64().expect("an index") as usize;
                for corner in written.elements(indices) {
                    let vertex = corner[0] as usize;
                    let at = [0, 1].map(|axis| {
                        lightmap[vertex][axis] * number("scale", axis) + number("offset", axis)
                    });
                    let values = attributes.iter().map(|(_, all)| all[vertex].clone());
                    corners.push((values.collect(), at));
                }
            }
            drawing.push((place["map"].as_u64().expect("an index"), corners));
        }
    }
    drawing
}

/// Compares what every lit node draws.
fn check(scene: &Scene, atlas: &Atlas, written: &Document, what: &str) {
    let authored = Document::of(scene);
    let mut nodes: Vec<usize> = atlas
        .placements
        .iter()
        .map(|placement| scene.instances[placement.instance].node)
        .collect();
    nodes.sort_unstable();
    nodes.dedup();
    let mut n_plain = 0;
    for node in nodes {
        let want = wanted(scene, atlas, &authored, node);
        let got = drawn(written, node, &scene.source.json, &mut n_plain);
        assert_eq!(got.len(), want.len(), "{what}: drawings of node {node}");
        for ((got_map, got), (want_map, want)) in got.iter().zip(&want) {
            assert_eq!(got_map, want_map, "{what}: map of node {node}");
            assert_eq!(got.len(), want.len(), "{what}: corners of node {node}");
            for (got, want) in got.iter().zip(want) {
                assert_eq!(got.0, want.0, "{what}: node {node}");
                for axis in 0..2 {
                    // f32 coordinates up to 1, times scale up to 1.
                    let error = (got.1[axis] - want.1[axis]).abs();
                    assert!(error < 2e-7, "{what}: node {node} is off by {error:e}");
                }
            }
        }
    }
}

fn hard() -> (tempfile::TempDir, Scene) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = document::hard(folder.path());
    let scene = scene::load(&path, &scene::Options::default()).unwrap_or_else(|e| panic!("{e}"));
    (folder, scene)
}

#[test]
fn every_node_draws_what_it_drew_and_lies_where_the_atlas_says() {
    let (folder, scene) = hard();
    for (n_variants, n_parts) in [(1, 1), (2, 1), (1, 2), (2, 2), (3, 1)] {
        let what = format!("{n_variants} variants, {n_parts} parts");
        let atlas = document::random_atlas(&scene, 1, n_variants, n_parts);
        let (path, _) = write(&scene, &atlas, &folder.path().join(&what));
        check(&scene, &atlas, &Document::read(&path), &what);
        // It is a document that we read, and the same level.
        let again = scene::load(&path, &scene::Options::default()).expect("readable");
        assert_eq!(again.triangles.len(), scene.triangles.len(), "{what}");
        assert_eq!(
            again.instances.len(),
            if n_parts == 2 {
                2 * scene.instances.len()
            } else {
                scene.instances.len()
            }
        );
    }
}

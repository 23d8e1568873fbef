//! Documents and layouts to write again.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec2;
use lumel::atlas::{Atlas, Page, Placement, Unwrap, UnwrappedPrimitive};
use lumel::error::Warnings;
use lumel::output::{MapFile, PageFiles};
use lumel::scene::{Mesh, Scene};
use serde_json::{Value, json};

use crate::support::Rng;

/// A layout without regard to geometry: random charts, random coordinates, random places.
///
/// Instances of a mesh take turns among `n_variants` unwraps, as if their world scales differed; the triangles of each are dealt out
/// to `n_parts` pages.
pub(crate) fn random_atlas(scene: &Scene, seed: u64, n_variants: usize, n_parts: usize) -> Atlas {
    let mut rng = Rng::new(seed);
    let mut atlas = Atlas {
        unwraps: Vec::new(),
        placements: Vec::new(),
        pages: vec![
            Page {
                width: 512,
                height: 256,
            };
            n_parts
        ],
        warnings: Warnings::default(),
    };
    let mut known: BTreeMap<[usize; 3], Option<usize>> = BTreeMap::new();
    let mut n_instances = vec![0; scene.meshes.len()];
    for (index, instance) in scene.instances.iter().enumerate() {
        if instance.density == 0.0 {
            continue;
        }
        let variant = n_instances[instance.mesh] % n_variants;
        n_instances[instance.mesh] += 1;
        for part in 0..n_parts {
            let unwrap = *known
                .entry([instance.mesh, variant, part])
                .or_insert_with(|| {
                    let mesh = &scene.meshes[instance.mesh];
                    let unwrap = random_unwrap(mesh, instance.mesh, &mut rng, [part, n_parts])?;
                    atlas.unwraps.push(unwrap);
                    Some(atlas.unwraps.len() - 1)
                });
            if let Some(unwrap) = unwrap {
                atlas.placements.push(Placement {
                    instance: index,
                    unwrap,
                    page: part,
                    offset: [8 * (rng.bits() % 40) as u32, 4 * (rng.bits() % 40) as u32],
                });
            }
        }
    }
    atlas.placements.sort_by_key(|placement| placement.page);
    atlas
}

/// Every `part[1]`-th triangle from the `part[0]`-th on, in up to four charts; `None` when there is none.
fn random_unwrap(mesh: &Mesh, index: usize, rng: &mut Rng, part: [usize; 2]) -> Option<Unwrap> {
    let size = [64 + (rng.bits() % 64) as u32, 32 + (rng.bits() % 64) as u32];
    let mut primitives = Vec::new();
    for primitive in &mesh.primitives {
        let mut unwrapped = UnwrappedPrimitive::default();
        let mut vertices = BTreeMap::new();
        for (number, corners) in primitive.triangles.iter().enumerate() {
            if number % part[1] != part[0] {
                continue;
            }
            let chart = (rng.bits() % 4) as u32;
            let corners = corners.map(|corner| {
                *vertices.entry((corner, chart)).or_insert_with(|| {
                    unwrapped.source_vertices.push(corner);
                    let texel = [rng.unit(), rng.unit()];
                    let texel = DVec2::from(texel) * DVec2::new(size[0].into(), size[1].into());
                    unwrapped.texcoords.push(texel);
                    unwrapped.source_vertices.len() as u32 - 1
                })
            });
            unwrapped.triangles.push(corners);
            unwrapped.source_triangles.push(number as u32);
            unwrapped.charts.push(chart);
        }
        primitives.push(unwrapped);
    }
    let any = primitives.iter().any(|it| !it.triangles.is_empty());
    any.then_some(Unwrap {
        mesh: index,
        size,
        primitives,
        n_charts: 4,
        authored: false,
        texels_per_metre: 8.0,
    })
}

/// Pages as a bake of all planes describes them.
pub(crate) fn pages(atlas: &Atlas) -> Vec<PageFiles> {
    let pages = atlas.pages.iter().enumerate();
    pages
        .map(|(index, page)| PageFiles {
            width: page.width,
            height: page.height,
            maps: ["E", "Gr", "Gg", "Gb", "phi", "err", "preview"]
                .map(|plane| MapFile {
                    plane: plane.to_owned(),
                    file: match plane {
                        "preview" => format!("a b_lm{index}_{plane}.png"),
                        _ => format!("a b_lm{index}_{plane}.exr"),
                    },
                    precision: "half",
                    min: 0.0,
                    max: 1.0,
                })
                .to_vec(),
            exports: Vec::new(),
        })
        .collect()
}

/// A document under construction, with several buffers.
pub(crate) struct Builder {
    pub(crate) json: Value,
    pub(crate) buffers: Vec<Vec<u8>>,
}

impl Builder {
    pub(crate) fn new() -> Self {
        Self {
            json: json!({
                "asset": {"version": "2.0"},
                "bufferViews": [], "accessors": [], "buffers": [],
            }),
            buffers: Vec::new(),
        }
    }

    /// Opens a new buffer; the next views lie in it.
    pub(crate) fn buffer(&mut self, name: &str) {
        self.buffers.push(Vec::new());
        self.push("buffers", json!({"name": name}));
    }

    pub(crate) fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().expect("a list");
        list.push(value);
        list.len() - 1
    }

    /// A view of `bytes` with further members.
    pub(crate) fn view(&mut self, bytes: &[u8], members: Value) -> usize {
        let index = self.buffers.len() - 1;
        let buffer = &mut self.buffers[index];
        buffer.resize(buffer.len().next_multiple_of(4), 0);
        let mut view = json!({
            "buffer": index, "byteOffset": buffer.len(), "byteLength": bytes.len(),
        });
        buffer.extend_from_slice(bytes);
        extend(&mut view, members);
        self.push("bufferViews", view)
    }

    /// An accessor with a view of its own.
    pub(crate) fn accessor(&mut self, bytes: &[u8], kind: (u32, &str), count: usize) -> usize {
        let size = bytes.len() / count;
        let target = if kind.1 == "SCALAR" && size < 4 {
            json!({})
        } else {
            json!({"target": 34962})
        };
        let view = self.view(bytes, target);
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": kind.0, "type": kind.1, "count": count}),
        )
    }

    /// `POSITION`-like floats with bounds.
    pub(crate) fn positions(&mut self, points: &[[f32; 3]]) -> usize {
        let index = self.accessor(bytemuck::cast_slice(points), (5126, "VEC3"), points.len());
        let bound = |pick: fn(f32, f32) -> f32| {
            points
                .iter()
                .copied()
                .reduce(|a, b| [0, 1, 2].map(|axis| pick(a[axis], b[axis])))
                .expect("not empty")
        };
        self.json["accessors"][index]["min"] = json!(bound(f32::min));
        self.json["accessors"][index]["max"] = json!(bound(f32::max));
        index
    }

    /// Writes the document with its buffers beside it; the first one as a data URI.
    pub(crate) fn save(&mut self, folder: &Path, name: &str) -> PathBuf {
        use base64::Engine;

        for (index, bytes) in self.buffers.iter().enumerate() {
            let uri = if index == 0 {
                let text = base64::engine::general_purpose::STANDARD.encode(bytes);
                format!("data:application/octet-stream;base64,{text}")
            } else {
                fs::write(folder.join(format!("buffer {index}.bin")), bytes).expect("written");
                format!("buffer%20{index}.bin")
            };
            self.json["buffers"][index]["uri"] = uri.into();
            self.json["buffers"][index]["byteLength"] = bytes.len().into();
        }
        let path = folder.join(name);
        fs::write(&path, self.json.to_string()).expect("written");
        path
    }
}

/// Copies the members of `other` into `object`.
pub(crate) fn extend(object: &mut Value, other: Value) {
    let (Value::Object(object), Value::Object(other)) = (object, other) else {
        return;
    };
    object.extend(other);
}

const QUAD: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [2.0, 0.0, 0.0],
    [2.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
];

/// A document with one of everything that is hard to write again; see the numbers of its nodes.
pub(crate) fn hard(folder: &Path) -> PathBuf {
    let mut builder = Builder::new();
    builder.buffer("first");
    let quad = interleaved_quad(&mut builder);
    builder.buffer("second");
    let hidden = morphing_quad(&mut builder, &quad);
    let strip = {
        let positions = builder.positions(&[QUAD[0], QUAD[1], QUAD[3], QUAD[2]]);
        json!({"attributes": {"POSITION": positions}, "mode": 5, "material": 1})
    };
    let mut points = hidden.clone();
    points["mode"] = 0.into();
    points.as_object_mut().expect("object").remove("indices");
    let skinned = skinned_quad(&mut builder);
    let copies = copies(&mut builder);
    let times = builder.accessor(bytemuck::cast_slice(&[0.0_f32, 1.0]), (5126, "SCALAR"), 2);
    builder.json["accessors"][times]["min"] = json!([0.0]);
    builder.json["accessors"][times]["max"] = json!([1.0]);
    let weights = builder.accessor(bytemuck::cast_slice(&[0.0_f32, 1.0]), (5126, "SCALAR"), 2);
    for accessor in [times, weights] {
        let view = &mut builder.json["accessors"][accessor]["bufferView"]
            .as_u64()
            .expect("view");
        let view = &mut builder.json["bufferViews"][*view as usize];
        view.as_object_mut().expect("object").remove("target");
    }
    picture(folder);
    let inverse = glam::Mat4::IDENTITY.to_cols_array();
    let inverse = builder.accessor(bytemuck::cast_slice(&inverse), (5126, "MAT4"), 1);
    let view = builder.json["accessors"][inverse]["bufferView"]
        .as_u64()
        .expect("view") as usize;
    builder.json["bufferViews"][view]
        .as_object_mut()
        .expect("object")
        .remove("target");

    extend(
        &mut builder.json,
        json!({
            "extensionsUsed": [
                "KHR_texture_transform", "EXT_mesh_gpu_instancing", "KHR_mesh_quantization",
                "KHR_materials_emissive_strength", "VENDOR_unknown",
                "KHR_materials_variants",
            ],
            "extensionsRequired": ["KHR_mesh_quantization"],
            "extensions": {
                "VENDOR_unknown": {"z": 1, "a": [1.5, null]},
                "KHR_materials_variants": {"variants": [{"name": "other"}]},
            },
            "scene": 0,
            "scenes": [
                {"name": "first", "nodes": [0, 6], "extras": {"lumel": {"mood": "dark"}, "keep": true}},
                {"name": "second", "nodes": [5]},
            ],
            "nodes": [
                {"name": "root", "children": [1, 2, 3, 4, 7, 8], "scale": [1, 1, -1]},
                {"name": "moving", "mesh": 0, "weights": [0.25], "extras": {"lumel": {"scale": 2}, "keep": [1]}},
                {"mesh": 0, "translation": [3, 0, 0], "extras": "words"},
                {"name": "strip", "mesh": 1, "translation": [0, 3, 0]},
                {"name": "many", "mesh": 1, "translation": [0, 6, 0],
                    "extensions": {"EXT_mesh_gpu_instancing": copies, "VENDOR_unknown": {"keep": 1}}},
                {"name": "elsewhere", "mesh": 0},
                {"name": "eye", "camera": 0},
                {"name": "bent", "mesh": 2, "skin": 0},
                {"name": "bone"},
            ],
            "meshes": [
                {"name": "quad", "weights": [0.5], "primitives": [hidden, points], "extras": {"keep": 2}},
                {"primitives": [strip]},
                {"primitives": [skinned]},
            ],
            "materials": [
                {"name": "second set", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 1}},
                    "emissiveTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1, "offset": [0.5, 0]}}},
                    "emissiveFactor": [1, 1, 1], "extras": {"index": 1, "texCoord": 1}},
                {"emissiveFactor": [1, 1, 1], "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}}},
                {"name": "variant", "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0, "texCoord": 1}}},
            ],
            "textures": [{"source": 0}],
            "images": [{"uri": "a%20picture.png", "name": "picture"}],
            "skins": [{"joints": [8], "inverseBindMatrices": inverse}],
            "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
            "animations": [{
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "weights"}}],
                "samplers": [{"input": times, "output": weights}],
            }],
        }),
    );
    builder.save(folder, "hard ones.gltf")
}

/// Position, normal and first set in one view, besides tight, quantised, normalised and custom attributes.
fn interleaved_quad(builder: &mut Builder) -> Value {
    let vertices: Vec<[f32; 8]> = QUAD
        .iter()
        .map(|&[x, y, z]| [x, y, z, 0.0, 0.0, 1.0, x / 2.0, y])
        .collect();
    let view = builder.view(
        bytemuck::cast_slice(&vertices),
        json!({"byteStride": 32, "target": 34962}),
    );
    let mut part = |offset: usize, kind: &str| {
        builder.push(
            "accessors",
            json!({"bufferView": view, "byteOffset": offset, "componentType": 5126, "type": kind, "count": 4}),
        )
    };
    let [position, normal, first] = [part(0, "VEC3"), part(12, "VEC3"), part(24, "VEC2")];
    builder.json["accessors"][position]["min"] = json!([0.0, 0.0, 0.0]);
    builder.json["accessors"][position]["max"] = json!([2.0, 1.0, 0.0]);

    let second: [u16; 8] = [0, 0, 65535, 0, 65535, 65535, 0, 65535];
    let second = builder.accessor(bytemuck::cast_slice(&second), (5123, "VEC2"), 4);
    builder.json["accessors"][second]["normalized"] = true.into();
    // Elements of three bytes start at multiples of four.
    let view = builder.view(
        &[9, 8, 7, 0, 90, 80, 70, 0, 200, 210, 220, 0, 1, 2, 3, 0],
        json!({"byteStride": 4, "target": 34962}),
    );
    let color = builder.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5121, "type": "VEC3", "count": 4, "normalized": true}),
    );
    let view = builder.view(
        bytemuck::cast_slice(&[10_u16, 0, 11, 0, 12, 0, 13, 0]),
        json!({"byteStride": 4, "target": 34962}),
    );
    let custom = builder.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5123, "type": "SCALAR", "count": 4, "name": "ids"}),
    );
    let tangents = [[1.0_f32, 0.0, 0.0, 1.0]; 4];
    let tangent = builder.accessor(bytemuck::cast_slice(&tangents), (5126, "VEC4"), 4);
    let indices: [u8; 6] = [0, 1, 2, 0, 2, 3];
    let view = builder.view(&indices, json!({"target": 34963}));
    let indices = builder.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5121, "type": "SCALAR", "count": 6}),
    );
    json!({
        "attributes": {
            "POSITION": position, "NORMAL": normal, "TANGENT": tangent, "TEXCOORD_0": first,
            "TEXCOORD_1": second, "COLOR_0": color, "_ID": custom,
        },
        "indices": indices, "material": 0, "extras": {"keep": 3},
        "extensions": {"KHR_materials_variants": {"mappings": [{"material": 2, "variants": [0]}]}},
    })
}

/// `quad` with a sparse morph target on nothing.
fn morphing_quad(builder: &mut Builder, quad: &Value) -> Value {
    let indices = builder.view(&[1, 3], json!({}));
    let values = builder.view(
        bytemuck::cast_slice(&[[0.0_f32, 0.0, 1.0], [0.5, 0.0, 0.0]]),
        json!({}),
    );
    let target = builder.push(
        "accessors",
        json!({
            "componentType": 5126, "type": "VEC3", "count": 4,
            "min": [0.0, 0.0, 0.0], "max": [0.5, 0.0, 1.0],
            "sparse": {
                "count": 2,
                "indices": {"bufferView": indices, "componentType": 5121},
                "values": {"bufferView": values},
            },
        }),
    );
    let mut quad = quad.clone();
    quad["targets"] = json!([{"POSITION": target}]);
    quad
}

/// A quad of 16-bit positions that hangs on one bone.
fn skinned_quad(builder: &mut Builder) -> Value {
    let positions: Vec<[i16; 4]> = QUAD
        .iter()
        .map(|point| [point[0] as i16, point[1] as i16, point[2] as i16, 0])
        .collect();
    let view = builder.view(
        bytemuck::cast_slice(&positions),
        json!({"byteStride": 8, "target": 34962}),
    );
    let positions = builder.push(
        "accessors",
        json!({
            "bufferView": view, "componentType": 5122, "type": "VEC3", "count": 4,
            "min": [0, 0, 0], "max": [2, 1, 0],
        }),
    );
    let joints = builder.accessor(&[0; 16], (5121, "VEC4"), 4);
    let weights = [[1.0_f32, 0.0, 0.0, 0.0]; 4];
    let weights = builder.accessor(bytemuck::cast_slice(&weights), (5126, "VEC4"), 4);
    let view = builder.view(
        bytemuck::cast_slice(&[0_u16, 1, 2, 0, 2, 3]),
        json!({"target": 34963}),
    );
    let indices = builder.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5123, "type": "SCALAR", "count": 6}),
    );
    json!({
        "attributes": {"POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights},
        "indices": indices,
    })
}

/// Three copies, with a number of their own each.
fn copies(builder: &mut Builder) -> Value {
    let shifts = [[0.0_f32, 0.0, 0.0], [4.0, 0.0, 0.0], [8.0, 0.0, 0.0]];
    let translation = builder.accessor(bytemuck::cast_slice(&shifts), (5126, "VEC3"), 3);
    let number = builder.accessor(
        bytemuck::cast_slice(&[5.0_f32, 6.0, 7.0]),
        (5126, "SCALAR"),
        3,
    );
    json!({"attributes": {"TRANSLATION": translation, "_NUMBER": number}})
}

/// A picture in a file of its own.
fn picture(folder: &Path) {
    image::RgbImage::from_pixel(2, 2, image::Rgb([200, 100, 50]))
        .save(folder.join("a picture.png"))
        .expect("written");
}

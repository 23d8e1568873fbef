//! Documents built in code, one per oddity, with answers that are known.

use std::fs;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DVec3, Vec2, Vec3};
use lumel::scene::{Alpha, Options, PunctualKind, Scene};
use lumel::{Error, Result};
use serde_json::{Value, json};

use crate::support::Rng;

const BYTE: u32 = 5120;
const UNSIGNED_BYTE: u32 = 5121;
const SHORT: u32 = 5122;
const UNSIGNED_SHORT: u32 = 5123;
const FLOAT: u32 = 5126;

/// A triangle in the plane z = 0 whose front looks along +Z.
const CORNERS: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// A document that grows, with one buffer.
struct Document {
    json: Value,
    bytes: Vec<u8>,
}

impl Document {
    fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "materials": [{}],
            "meshes": [],
            "nodes": []
        });
        Self {
            json,
            bytes: Vec::new(),
        }
    }

    /// One node that shows [`CORNERS`].
    fn triangle() -> Self {
        let mut document = Self::new();
        let positions = document.floats("VEC3", CORNERS.as_flattened());
        document.mesh(json!({"attributes": {"POSITION": positions}}));
        document.node(json!({"mesh": 0}));
        document
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().expect("a list");
        list.push(value);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        let view = json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()});
        self.push("bufferViews", view)
    }

    fn accessor(&mut self, component: u32, shape: &str, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessor =
            json!({"bufferView": view, "componentType": component, "type": shape, "count": count});
        self.push("accessors", accessor)
    }

    fn floats(&mut self, shape: &str, values: &[f32]) -> usize {
        let n_components = match shape {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        self.accessor(FLOAT, shape, values.len() / n_components, &bytes)
    }

    fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        self.accessor(UNSIGNED_SHORT, "SCALAR", values.len(), &bytes)
    }

    fn mesh(&mut self, primitive: Value) -> usize {
        self.push("meshes", json!({"primitives": [primitive]}))
    }

    fn node(&mut self, node: Value) -> usize {
        self.push("nodes", node)
    }

    /// As text, with the buffer in a data URI.
    fn text(&self) -> String {
        let mut json = self.json.clone();
        let uri = format!(
            "data:application/octet-stream;base64,{}",
            STANDARD.encode(&self.bytes)
        );
        json["buffers"] = json!([{"byteLength": self.bytes.len(), "uri": uri}]);
        json.to_string()
    }

    /// As GLB.
    fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut binary = self.bytes.clone();
        binary.resize(binary.len().next_multiple_of(4), 0);
        let length = (12 + 8 + text.len() + 8 + binary.len()) as u32;
        let mut file = b"glTF".to_vec();
        for number in [2, length, text.len() as u32] {
            file.extend(number.to_le_bytes());
        }
        file.extend(b"JSON");
        file.extend(text);
        file.extend((binary.len() as u32).to_le_bytes());
        file.extend(b"BIN\0");
        file.extend(binary);
        file
    }

    fn open(&self) -> Result<Scene> {
        open(self.text().as_bytes(), &Options::default())
    }

    /// Loads what must load.
    fn scene(&self) -> Scene {
        match self.open() {
            Ok(scene) => scene,
            Err(error) => panic!("{error}"),
        }
    }

    /// What loading complains of.
    fn error(&self) -> String {
        match self.open() {
            Ok(_) => panic!("loads"),
            Err(error) => error.to_string(),
        }
    }
}

fn open(bytes: &[u8], options: &Options) -> Result<Scene> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("level.gltf");
    fs::write(&path, bytes).expect("writable folder");
    Scene::open(&path, options)
}

#[track_caller]
fn assert_warns(scene: &Scene, words: &str, count: usize) {
    let found = scene
        .warnings
        .iter()
        .find(|warning| warning.what.contains(words));
    assert_eq!(
        found.map(|warning| warning.count),
        Some(count),
        "{words}: {:?}",
        scene.warnings
    );
}

#[track_caller]
fn assert_close(got: DVec3, want: DVec3) {
    // Everything here is small numbers in f32 at worst.
    assert!(got.distance(want) < 1e-6, "got {got}, want {want}");
}

// Places.

#[test]
fn fronts_below_mirrored_nodes_look_where_the_normals_look() {
    for scale in [
        [-1.0, 1.0, 1.0],
        [1.0, -2.0, 1.0],
        [1.0, 1.0, -1.0],
        [-1.0, -3.0, -1.0],
    ] {
        let mut document = Document::triangle();
        document.json["nodes"][0]["scale"] = json!(scale);
        let scene = document.scene();
        // The front is where the authored normal +Z goes: only the sign of the z scale turns it.
        let front = scene.triangles[0].area_vector().normalize();
        assert_close(front, DVec3::Z * f64::signum(scale[2]));
        let mirrored = scale.iter().product::<f64>() < 0.0;
        assert_eq!(scene.instances[0].is_mirrored(), mirrored, "{scale:?}");
    }
}

#[test]
fn transforms_multiply_down_the_hierarchy() {
    let mut document = Document::triangle();
    // A quarter turn around Z, then two metres along X of the parent, which is scaled by three.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    document.json["nodes"][0]["rotation"] = json!([0.0, 0.0, half, half]);
    document.json["nodes"][0]["translation"] = json!([2, 0, 0]);
    document.node(json!({
        "children": [0], "name": "above",
        "matrix": [3, 0, 0, 0, 0, 3, 0, 0, 0, 0, 3, 0, 0, 0, 10, 1]
    }));
    let vertices = document.scene().triangles[0].vertices;
    assert_close(vertices[0], DVec3::new(6.0, 0.0, 10.0));
    assert_close(vertices[1], DVec3::new(6.0, 3.0, 10.0));
    assert_close(vertices[2], DVec3::new(3.0, 0.0, 10.0));
}

#[test]
fn a_chain_of_a_hundred_thousand_nodes_is_walked() {
    const LENGTH: usize = 100_000;
    let mut document = Document::triangle();
    let nodes = document.json["nodes"].as_array_mut().expect("a list");
    for node in 0..LENGTH {
        nodes.push(json!({"children": [node], "translation": [0, 0, 1]}));
    }
    let scene = document.scene();
    assert_close(scene.triangles[0].vertices[0], DVec3::Z * LENGTH as f64);
}

#[test]
fn nodes_are_a_tree_or_an_error() {
    let mut document = Document::triangle();
    document.node(json!({"children": [0]}));
    document.node(json!({"children": [0]}));
    let error = document.error();
    assert!(
        error.contains("nodes[2].children: nodes[0] is already a child of nodes[1]"),
        "{error}"
    );

    let mut document = Document::triangle();
    document.json["nodes"][0]["children"] = json!([1]);
    document.node(json!({"children": [0]}));
    let error = document.error();
    assert!(error.contains("nodes[0]: is its own ancestor"), "{error}");
}

#[test]
fn the_scene_is_the_one_asked_for() {
    let mut document = Document::triangle();
    document.node(json!({"mesh": 0, "translation": [0, 0, 1]}));
    document.node(json!({"mesh": 0, "translation": [0, 0, 2]}));
    let all = document.scene();
    assert_eq!(all.instances.len(), 3, "without scenes, all roots");
    document.json["scenes"] = json!([{"nodes": [0]}, {"nodes": [1]}, {"nodes": [2, 1]}]);
    let nodes = |scene: Option<usize>, document: &Document| -> Vec<usize> {
        let scene = open(document.text().as_bytes(), &Options { scene }).expect("loads");
        scene.instances.iter().map(|it| it.node).collect()
    };
    assert_eq!(nodes(None, &document), [0], "the first");
    document.json["scene"] = json!(1);
    assert_eq!(nodes(None, &document), [1], "the default");
    assert_eq!(
        nodes(Some(2), &document),
        [2, 1],
        "the chosen, in its order"
    );
    let error = open(document.text().as_bytes(), &Options { scene: Some(3) });
    match error {
        Err(Error::InvalidOption { option, reason }) => {
            assert_eq!(
                (option, reason.as_str()),
                ("scene", "must be in 0..=2, is 3")
            );
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn instancing_places_one_copy_per_element() {
    let mut document = Document::triangle();
    let translations = document.floats("VEC3", &[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    // Half a turn around Y in normalised bytes, then no rotation.
    let rotations = document.accessor(BYTE, "VEC4", 2, &[0, 127, 0, 0, 0, 0, 0, 127]);
    document.json["accessors"][rotations]["normalized"] = json!(true);
    let scales = document.floats("VEC3", &[2.0, 2.0, 2.0, 1.0, 1.0, 1.0]);
    document.json["nodes"][0]["translation"] = json!([0, 1, 0]);
    document.json["nodes"][0]["extras"] = json!({"lumel": {"scale": 0.5}});
    document.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {
        "attributes": {"TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales}
    }});
    let scene = document.scene();
    let copies: Vec<_> = scene
        .instances
        .iter()
        .map(|it| (it.copy, it.mesh, it.density))
        .collect();
    assert_eq!(copies, [(Some(0), 0, 0.5), (Some(1), 0, 0.5)]);
    assert_close(scene.triangles[0].vertices[1], DVec3::new(-2.0, 1.0, 0.0));
    assert_close(scene.triangles[1].vertices[1], DVec3::new(6.0, 1.0, 0.0));
}

#[test]
fn a_density_that_makes_no_sense_is_one() {
    for (scale, density, n_warnings) in [
        (json!(0), 0.0, 0),
        (json!(-1), 1.0, 1),
        (json!("2"), 1.0, 1),
    ] {
        let mut document = Document::triangle();
        document.json["nodes"][0]["extras"] = json!({"lumel": {"scale": scale}});
        let scene = document.scene();
        assert_eq!(scene.instances[0].density, density, "{scale}");
        assert_eq!(scene.warnings.iter().count(), n_warnings, "{scale}");
    }
}

#[test]
fn hidden_nodes_are_left_out_with_all_below() {
    let mut document = Document::triangle();
    document.node(json!({
        "children": [0], "extensions": {"KHR_node_visibility": {"visible": false}}
    }));
    let scene = document.scene();
    assert!(scene.instances.is_empty());
    assert_warns(&scene, "hidden", 1);
}

// Geometry.

#[test]
fn strips_and_fans_keep_the_winding_of_the_specification() {
    let strip = [[0, 1, 2], [1, 3, 2], [2, 3, 4]];
    let fan = [[1, 2, 0], [2, 3, 0], [3, 4, 0]];
    for (mode, want) in [(5, strip), (6, fan)] {
        let mut document = Document::new();
        // Five points of a zigzag, none on a line with its neighbours.
        let positions = document.floats(
            "VEC3",
            &[
                0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.3, 1.0, 0.0, 1.5, 1.2, 0.0, 0.2, 2.0, 0.0,
            ],
        );
        document.mesh(json!({"attributes": {"POSITION": positions}, "mode": mode}));
        document.node(json!({"mesh": 0}));
        let scene = document.scene();
        assert_eq!(scene.meshes[0].primitives[0].triangles, want, "mode {mode}");
    }
}

#[test]
fn points_and_lines_are_left_out() {
    let mut document = Document::triangle();
    document.json["meshes"][0]["primitives"][0]["mode"] = json!(1);
    let scene = document.scene();
    assert!(scene.instances.is_empty());
    assert_warns(&scene, "points and lines", 1);
    assert_warns(&scene, "no triangles", 1);
}

#[test]
fn indices_out_of_range_cost_their_triangle() {
    let mut document = Document::triangle();
    let indices = document.indices(&[0, 1, 2, 0, 1, 3, 2, 1]);
    document.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let scene = document.scene();
    assert_eq!(scene.triangles.len(), 1);
    assert_warns(&scene, "index that is out of range", 1);
    assert_warns(&scene, "no multiple of 3", 1);
}

#[test]
fn sparse_elements_replace_zeros_and_others() {
    let mut document = Document::triangle();
    let indices = document.view(&[2]);
    let values = document.view(&7f32.to_le_bytes().repeat(3));
    let sparse = json!({
        "count": 1,
        "indices": {"bufferView": indices, "componentType": UNSIGNED_BYTE},
        "values": {"bufferView": values}
    });
    document.json["accessors"][0]["sparse"] = sparse.clone();
    let positions =
        |document: &Document| document.scene().meshes[0].primitives[0].positions.clone();
    assert_eq!(
        positions(&document),
        [Vec3::ZERO, Vec3::X, Vec3::splat(7.0)]
    );

    // Without a view the rest is zero, and a triangle with two corners in one place has no area.
    let accessor = document.json["accessors"][0]
        .as_object_mut()
        .expect("an object");
    accessor.remove("bufferView");
    assert!(document.scene().triangles.is_empty());

    document.bytes[36] = 3;
    let error = document.error();
    assert!(
        error.contains("accessors[0].sparse.indices: index 3 is out of range (3 elements)"),
        "{error}"
    );
}

#[test]
fn quantised_interleaved_attributes_are_read() {
    let mut document = Document::new();
    // Per vertex: position i16 ×3, pad, normal i8 ×3, pad, texcoord u16 ×2.
    let mut bytes = Vec::new();
    for [x, y] in [[0i16, 0], [i16::MAX, 0], [0, i16::MIN]] {
        for number in [x, y, 0, 0] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend([0, 0, 0x81, 0]);
        for number in [u16::MAX, 0] {
            bytes.extend(number.to_le_bytes());
        }
    }
    let view = document.view(&bytes);
    document.json["bufferViews"][view]["byteStride"] = json!(16);
    let mut attribute = |offset: usize, component: u32, shape: &str| {
        document.push(
            "accessors",
            json!({
                "bufferView": view, "byteOffset": offset, "componentType": component,
                "normalized": true, "type": shape, "count": 3
            }),
        )
    };
    let attributes = json!({
        "POSITION": attribute(0, SHORT, "VEC3"),
        "NORMAL": attribute(8, BYTE, "VEC3"),
        "TEXCOORD_0": attribute(12, UNSIGNED_SHORT, "VEC2"),
        "TEXCOORD_1": attribute(0, SHORT, "VEC2")
    });
    document.mesh(json!({"attributes": attributes}));
    document.node(json!({"mesh": 0}));
    document.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let scene = document.scene();
    let primitive = &scene.meshes[0].primitives[0];
    assert_eq!(primitive.positions, [Vec3::ZERO, Vec3::X, Vec3::NEG_Y]);
    assert_eq!(primitive.normals, [Vec3::NEG_Z; 3]);
    assert_eq!(primitive.texcoords[0], [Vec2::X; 3]);
    assert_eq!(primitive.texcoords[1], [Vec2::ZERO, Vec2::X, Vec2::NEG_Y]);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
}

#[test]
fn broken_numbers_are_settled_and_counted() {
    let mut document = Document::new();
    let nan = f32::NAN;
    let positions = document.floats(
        "VEC3",
        &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, nan, 0.0, 0.0],
    );
    let normals = document.floats(
        "VEC3",
        &[0.0, 0.0, 2.0, 0.0, 0.0, 0.0, nan, 0.0, 1.0, 1e-30, 0.0, 0.0],
    );
    let texcoords = document.floats("VEC2", &[0.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let indices = document.indices(&[0, 1, 2, 0, 1, 3, 1, 1, 2]);
    document.mesh(json!({
        "attributes": {"POSITION": positions, "NORMAL": normals, "TEXCOORD_0": texcoords},
        "indices": indices
    }));
    document.node(json!({"mesh": 0}));
    let scene = document.scene();
    let primitive = &scene.meshes[0].primitives[0];
    assert_eq!(primitive.triangles, [[0, 1, 2]]);
    assert_eq!(primitive.positions[3], Vec3::ZERO);
    assert_eq!(primitive.normals, [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::X]);
    assert_eq!(primitive.texcoords[0], [Vec2::ZERO; 4]);
    assert_warns(&scene, "position that is not finite", 1);
    assert_warns(&scene, "no area", 1);
    assert_warns(&scene, "normal has no length", 2);
    assert_warns(&scene, "texture coordinate is not finite", 1);
}

#[test]
fn unusable_attributes_are_left_out() {
    let mut document = Document::triangle();
    let short = document.floats("VEC3", &[0.0, 0.0, 1.0]);
    let wide = document.floats("VEC3", CORNERS.as_flattened());
    document.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(short);
    document.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(wide);
    document.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_4294967295"] = json!(wide);
    let scene = document.scene();
    let primitive = &scene.meshes[0].primitives[0];
    assert!(primitive.normals.is_empty());
    assert_eq!(primitive.texcoords, [Vec::new()]);
    assert_warns(&scene, "wrong type", 2);
}

#[test]
fn surfaces_far_away_are_told() {
    let mut document = Document::triangle();
    document.json["nodes"][0]["translation"] = json!([2e6, 0, 0]);
    assert_warns(&document.scene(), "1000 km", 1);
}

// Deformation.

#[test]
fn morph_targets_take_their_default_weights() {
    let mut document = Document::triangle();
    let offsets = document.floats("VEC3", &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    document.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": offsets}]);
    document.json["meshes"][0]["weights"] = json!([0.5]);
    document.node(json!({"mesh": 0, "weights": [0.25]}));
    document.node(json!({"mesh": 0, "weights": [0.0]}));
    let scene = document.scene();
    let reach: Vec<f64> = scene.triangles.iter().map(|it| it.vertices[1].x).collect();
    assert_eq!(reach, [3.0, 2.0, 1.0], "of the mesh, of the node, none");
    assert_warns(&scene, "default weights", 3);
}

/// A triangle of which each corner hangs on one of two joints, half and half, and on nothing.
fn skinned() -> Document {
    let mut document = Document::triangle();
    let joints = document.accessor(
        UNSIGNED_BYTE,
        "VEC4",
        3,
        &[0, 0, 0, 0, 0, 1, 0, 0, 0, 9, 0, 0],
    );
    let weights = document.floats(
        "VEC4",
        &[1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
    );
    let mut bind = Vec::new();
    for x in [0.0, -10.0] {
        bind.extend([
            1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, 0.0, 0.0, 1.0,
        ]);
    }
    let bind = document.floats("MAT4", &bind);
    let normals = document.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    let attributes = &mut document.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
    attributes["NORMAL"] = json!(normals);
    document.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": bind}]);
    document.json["nodes"][0] = json!({"mesh": 0, "skin": 0, "translation": [0, 100, 0]});
    document.node(json!({"translation": [0, 0, 5], "children": [2]}));
    document.node(json!({"translation": [14, 0, 0]}));
    document
}

#[test]
fn skins_stand_where_their_joints_are() {
    let scene = skinned().scene();
    let vertices = scene.triangles[0].vertices;
    assert_close(vertices[0], DVec3::new(0.0, 0.0, 5.0));
    // Half of the first joint, half of the second, which is four metres off its bind pose.
    assert_close(vertices[1], DVec3::new(3.0, 0.0, 5.0));
    // The joint is out of range: moved with the node.
    assert_close(vertices[2], DVec3::new(0.0, 101.0, 0.0));
    assert_warns(&scene, "rest pose", 1);
    assert_warns(&scene, "no joints", 1);
}

#[test]
fn mirrored_skins_keep_their_fronts() {
    let mut document = skinned();
    document.json["nodes"][1]["scale"] = json!([-1, 1, 1]);
    document.json["nodes"][2]["translation"] = json!([10, 0, 0]);
    document.json["nodes"][0]["translation"] = json!([0, 0, 5]);
    let scene = document.scene();
    let triangle = &scene.triangles[0];
    assert_close(triangle.area_vector().normalize(), DVec3::Z);
    let vertices: Vec<DVec3> = (0..3)
        .map(|corner| {
            let slot = triangle.corners.iter().position(|it| *it == corner);
            triangle.vertices[slot.expect("every corner")]
        })
        .collect();
    assert_close(vertices[1], DVec3::new(-1.0, 0.0, 5.0));
    assert_eq!(scene.meshes[0].primitives[0].normals, [Vec3::Z; 3]);
}

// Materials and pictures.

/// A PNG in a data URI.
fn picture(width: u32, pixels: &[[u8; 4]]) -> String {
    let height = pixels.len() as u32 / width;
    let buffer = image::RgbaImage::from_raw(width, height, pixels.as_flattened().to_vec());
    let mut png = std::io::Cursor::new(Vec::new());
    buffer
        .expect("enough pixels")
        .write_to(&mut png, image::ImageFormat::Png)
        .expect("a vector takes all");
    format!(
        "data:image/png;base64,{}",
        STANDARD.encode(png.into_inner())
    )
}

/// The triangle with texture coordinates equal to its x and y, and texture 0 of two pixels: black with alpha 0, white with alpha 1.
fn textured() -> Document {
    let mut document = Document::triangle();
    let texcoords = document.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    document.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(texcoords);
    document.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    document.json["images"] = json!([{"uri": picture(2, &[[0, 0, 0, 0], [255; 4]])}]);
    document.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33071}]);
    document.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    document
}

/// Weights of the point (x, y) of [`CORNERS`].
fn at(x: f64, y: f64) -> [f64; 3] {
    [1.0 - x - y, x, y]
}

#[test]
fn emission_is_factor_times_strength_times_linear_texture() {
    let mut document = textured();
    document.json["materials"][0] = json!({
        "emissiveFactor": [1.0, 0.5, 0.0],
        "emissiveTexture": {"index": 0},
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}}
    });
    let scene = document.scene();
    // Pixel centres are at ¼ and ¾; between them linear light, not sRGB bytes, is interpolated.
    for (x, share) in [
        (0.1, 0.0),
        (0.25, 0.0),
        (0.5, 0.5),
        (0.625, 0.75),
        (0.9, 1.0),
    ] {
        assert_close(
            scene.emission(0, at(x, 0.0)),
            DVec3::new(8.0, 4.0, 0.0) * share,
        );
    }
}

#[test]
fn grey_pixels_emit_what_srgb_says() {
    let mut document = textured();
    document.json["images"][0]["uri"] = json!(picture(1, &[[188, 10, 0, 255]]));
    document.json["materials"][0] =
        json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}});
    let emission = document.scene().emission(0, at(0.3, 0.3));
    // IEC 61966-2-1: ((188/255 + 0.055) / 1.055)^2.4 and, on the straight part, 10/255/12.92.
    assert_close(emission, DVec3::new(0.502_886_5, 0.003_035_27, 0.0));
}

#[test]
fn texture_transforms_turn_scale_and_shift() {
    let mut document = textured();
    let second = document.floats("VEC2", &[0.5; 6]);
    document.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = json!(second);
    let transform = |transform: Value| {
        json!({
            "emissiveFactor": [1, 1, 1],
            "emissiveTexture": {
                "index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": transform}
            }
        })
    };
    // A quarter turn of π/2 takes v to u; the point (0, ¾) sees the white pixel.
    let quarter = std::f64::consts::FRAC_PI_2;
    for (extension, point, want) in [
        (json!({"offset": [0.5, 0.0]}), at(0.25, 0.0), 1.0),
        (json!({"scale": [0.5, 1.0]}), at(0.5, 0.0), 0.0),
        (json!({"rotation": quarter}), at(0.0, 0.75), 1.0),
        (
            json!({"rotation": quarter, "scale": [1.0, 0.5]}),
            at(0.0, 0.5),
            0.0,
        ),
        (
            json!({"rotation": quarter, "scale": [1.0, 0.5], "offset": [0.5, 0.0]}),
            at(0.0, 0.5),
            1.0,
        ),
        (json!({"texCoord": 1}), at(0.1, 0.0), 0.5),
    ] {
        document.json["materials"][0] = transform(extension.clone());
        let emission = document.scene().emission(0, point);
        assert!(
            (emission.x - want).abs() < 1e-6,
            "{extension}: {emission}, not {want}"
        );
    }
}

#[test]
fn alpha_is_factor_times_texture_times_vertex_colour() {
    let mut document = textured();
    let colors = document.floats(
        "VEC4",
        &[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 1.0, 1.0, 1.0, 1.0],
    );
    document.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colors);
    document.json["materials"][0] = json!({
        "alphaMode": "MASK", "alphaCutoff": 0.25,
        "pbrMetallicRoughness": {
            "baseColorFactor": [1, 1, 1, 0.5], "baseColorTexture": {"index": 0}
        }
    });
    let scene = document.scene();
    assert_eq!(scene.materials[0].alpha, Alpha::Mask { cutoff: 0.25 });
    assert_eq!(scene.materials.len(), 2, "the default one stands behind");
    for (x, texture, vertex) in [(0.0, 0.0, 1.0), (0.5, 0.5, 0.75), (1.0, 1.0, 0.5)] {
        let alpha = f64::from(scene.alpha(0, at(x, 0.0)));
        assert!(
            (alpha - 0.5 * texture * vertex).abs() < 1e-6,
            "at {x}: {alpha}"
        );
    }
}

#[test]
fn pictures_are_decoded_only_where_light_depends_on_them() {
    let mut document = textured();
    document.json["materials"][0] = json!({
        "emissiveTexture": {"index": 0},
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
        "normalTexture": {"index": 0}, "doubleSided": true,
        "extensions": {"KHR_materials_unlit": {}}
    });
    let scene = document.scene();
    assert!(scene.images.is_empty());
    let material = &scene.materials[0];
    assert!(material.normal_mapped && material.double_sided && material.unlit);
    let (bytes, mime) = scene.source.image_bytes(0).expect("bytes all the same");
    assert_eq!(
        (&bytes[1..4], mime.as_str()),
        (b"PNG".as_slice(), "image/png")
    );
    assert!(scene.source.image_bytes(1).is_err());
}

#[test]
fn pictures_that_cannot_be_read_are_white() {
    // The header of a PNG of 60000 × 60000 pixels, which would take 14 GB.
    let mut bomb = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    bomb.extend([0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60, 8, 6, 0, 0, 0]);
    for uri in [
        "missing.png".to_owned(),
        "data:image/png;base64,AAAA".to_owned(),
        "https://example.com/a.png".to_owned(),
        format!("data:image/png;base64,{}", STANDARD.encode(bomb)),
    ] {
        let mut document = textured();
        document.json["images"][0]["uri"] = json!(uri);
        document.json["materials"][0] =
            json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}});
        let scene = document.scene();
        assert_close(scene.emission(0, at(0.1, 0.1)), DVec3::ONE);
        assert_warns(&scene, "picture cannot be read", 1);
    }
}

#[test]
fn emission_that_makes_no_sense_is_none() {
    for (factor, strength, want) in [
        (json!([-1.0, 2.0, 0.0]), 1.0, [0.0, 2.0, 0.0]),
        (json!([1.0, 1.0, 1.0]), -3.0, [0.0; 3]),
        (json!([1e30, 1.0, 1.0]), 1e30, [0.0, 1e30, 1e30]),
    ] {
        let mut document = Document::triangle();
        document.json["materials"][0] = json!({
            "emissiveFactor": factor,
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        });
        let scene = document.scene();
        assert_eq!(scene.materials[0].emissive, Vec3::from_array(want));
        assert_warns(&scene, "emission is negative", 1);
    }
}

// Lights.

#[test]
fn lights_stand_and_look_as_their_nodes() {
    let mut document = Document::triangle();
    document.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "spot", "color": [1, 0.5, 0], "intensity": 10, "range": 7, "spot": {"outerConeAngle": 1}},
        {"type": "directional", "name": "sun"},
        {"type": "spot", "spot": {"innerConeAngle": 1, "outerConeAngle": 0.5}},
        {"type": "laser"}
    ]}});
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // Looks down after a quarter turn around X; scale changes nothing of it.
    let below = json!([-half, 0, 0, half]);
    for light in 0..4 {
        document.node(json!({
            "rotation": below, "scale": [3, 3, 3], "translation": [1, 2, 3],
            "extensions": {"KHR_lights_punctual": {"light": light}}
        }));
    }
    let scene = document.scene();
    assert_eq!(scene.punctual_lights.len(), 2);
    let spot = &scene.punctual_lights[0];
    assert_eq!(spot.intensity, DVec3::new(10.0, 5.0, 0.0));
    assert_close(spot.position, DVec3::new(1.0, 2.0, 3.0));
    assert_close(spot.direction, DVec3::NEG_Y);
    let kind = PunctualKind::Spot {
        range: Some(7.0),
        inner_angle: 0.0,
        outer_angle: 1.0,
    };
    assert_eq!(
        (spot.kind, spot.node, spot.name.as_str()),
        (kind, 1, "light0")
    );
    assert_eq!(scene.punctual_lights[1].name, "sun");
    assert_warns(&scene, "light makes no sense", 2);
}

#[test]
fn area_lights_of_the_draft_shine_along_minus_z() {
    let mut document = Document::triangle();
    document.json["extensions"] = json!({"EXT_lights_area": {"lights": [
        {"type": "rect", "intensity": 20, "size": 0.5, "rect": {"aspect": 3}},
        {"type": "disk", "color": [1, 0.5, 0]},
        {"type": "rect", "size": 0},
        {"type": "tube"}
    ]}});
    for light in 0..4 {
        document.node(json!({
            "scale": [2, 1, 1], "translation": [1, 2, 3],
            "extensions": {"EXT_lights_area": {"light": light}}
        }));
    }
    let scene = document.scene();
    assert_eq!(scene.area_lights.len(), 2);
    assert_warns(&scene, "light makes no sense", 2);
    let rectangle = &scene.area_lights[0];
    assert_close(rectangle.centre, DVec3::new(1.0, 2.0, 3.0));
    assert_close(rectangle.half_width, DVec3::X * 1.5);
    assert_close(rectangle.half_height, DVec3::Y * 0.5);
    let lights = lumel::lights::collect(&scene, &lumel::lights::Options::default());
    let [square, disc] = lights.polygons.as_slice() else {
        panic!("{} polygons", lights.polygons.len());
    };
    assert_close(square.normal, DVec3::NEG_Z);
    assert_eq!((square.area, square.radiance), (3.0, DVec3::splat(20.0)));
    assert!((disc.area - std::f64::consts::PI).abs() < 1e-12);
    assert_eq!(disc.radiance, DVec3::new(1000.0, 500.0, 0.0));
    // Both are wound counter-clockwise seen from where they shine, and are as large as they say.
    for polygon in &lights.polygons {
        let contour = &polygon.contours[0];
        let doubled: DVec3 = (0..contour.len())
            .map(|k| contour[k].cross(contour[(k + 1) % contour.len()]))
            .sum();
        assert_close(0.5 * doubled / polygon.area, DVec3::NEG_Z);
    }
}

// Files.

#[test]
fn glb_and_text_give_the_same_scene() {
    let document = textured();
    let text = document.scene();
    let mut glb = document.glb();
    // A chunk nobody knows belongs to the file, bytes behind the end do not.
    glb.extend(b"\x04\0\0\0WHAT1234");
    let length = (glb.len() as u32).to_le_bytes();
    glb[8..12].copy_from_slice(&length);
    glb.extend(b"behind");
    let binary = open(&glb, &Options::default()).expect("loads");
    assert_eq!(binary.name, "level");
    assert_eq!(
        format!("{:?}", binary.triangles),
        format!("{:?}", text.triangles)
    );
    assert_eq!(
        binary.source.buffers[0][..document.bytes.len()],
        document.bytes
    );
}

#[test]
fn buffers_are_found_under_encoded_plain_and_foreign_names() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let document = Document::triangle();
    fs::create_dir_all(folder.path().join("sub/deep")).expect("writable");
    for name in ["größe 1.bin", "100%25.bin", "sub/deep/a.bin"] {
        fs::write(folder.path().join(name), &document.bytes).expect("writable");
    }
    for (uri, found) in [
        ("größe 1.bin", true),
        ("gr%C3%B6%C3%9Fe%201.bin", true),
        ("./gr%c3%b6%c3%9fe 1.bin", true),
        ("100%25.bin", true),
        ("100%2525.bin", true),
        ("sub/../sub/deep/a.bin", true),
        ("sub\\deep\\a.bin", true),
        ("sub", false),
        ("", false),
        ("other.bin", false),
        ("/etc/hostname", false),
        ("file:///etc/hostname", false),
    ] {
        let mut json = document.json.clone();
        json["buffers"] = json!([{"byteLength": document.bytes.len(), "uri": uri}]);
        let path = folder.path().join("ein Level ❤.gltf");
        fs::write(&path, json.to_string()).expect("writable");
        match Scene::open(&path, &Options::default()) {
            Ok(scene) => assert!(found && scene.triangles.len() == 1, "{uri}"),
            Err(error) => assert!(!found && error.to_string().contains(uri), "{uri}: {error}"),
        }
    }
}

#[test]
fn forged_sizes_are_errors_and_no_allocations() {
    let forge = |change: &dyn Fn(&mut Value), words: &str| {
        let mut document = Document::triangle();
        change(&mut document.json);
        let error = document.error();
        assert!(error.contains(words), "{error}");
    };
    let huge = 1u64 << 62;
    forge(
        &|json| json["accessors"][0]["count"] = json!(4_000_000_000u64),
        "accessors[0]: 4000000000 elements",
    );
    forge(
        &|json| json["accessors"][0]["count"] = json!(u64::MAX),
        "do not fit into the 36 bytes",
    );
    forge(
        &|json| json["accessors"][0]["byteOffset"] = json!(huge),
        "do not fit into the 36 bytes",
    );
    forge(
        &|json| json["accessors"][0]["byteOffset"] = json!(1),
        "do not fit into the 36 bytes",
    );
    forge(
        &|json| json["bufferViews"][0]["byteOffset"] = json!(u64::MAX),
        "bufferViews[0]: 36 bytes from byte",
    );
    forge(
        &|json| json["bufferViews"][0]["byteStride"] = json!(huge),
        "do not fit into the 36 bytes",
    );
    forge(
        &|json| json["bufferViews"][0]["byteStride"] = json!(8),
        "bufferViews[0].byteStride: must be at least the 12",
    );
    forge(
        &|json| {
            json["accessors"][0] =
                json!({"componentType": FLOAT, "type": "VEC3", "count": 4_000_000_000u64});
        },
        "accessors[0].count: must be at most",
    );
    forge(
        &|json| json["accessors"][0]["count"] = json!(-1),
        "accessors[0].count: invalid value",
    );
    forge(
        &|json| json["accessors"][0]["type"] = json!("VEC5"),
        "accessors[0].type",
    );
    forge(
        &|json| json["nodes"][0]["mesh"] = json!(7),
        "nodes[0].mesh: refers to meshes[7], but there are 1",
    );
    forge(
        &|json| json["meshes"][0]["primitives"][0]["material"] = json!(7),
        "meshes[0].primitives[0].material",
    );
}

#[test]
fn copies_beyond_all_memory_are_refused() {
    let mut document = Document::triangle();
    // 12,000 copies each of a mesh of 3,000 triangles: 36 million.
    let indices = document.indices(&[0, 1, 2].repeat(3000));
    document.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let translations = document.floats("VEC3", &[0.0; 3 * 12_000]);
    document.json["nodes"][0]["extensions"] =
        json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": translations}}});
    assert!(matches!(document.open(), Err(Error::TooLarge { .. })));
}

#[test]
fn whole_numbers_may_be_written_as_floats() {
    let mut document = Document::triangle();
    document.json["accessors"][0]["count"] = json!(3.0);
    document.json["accessors"][0]["componentType"] = json!(5126.0);
    assert_eq!(document.scene().triangles.len(), 1);
}

#[test]
fn compressed_geometry_is_refused_by_name_unless_there_is_a_plain_copy() {
    let draco = json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}});
    let mut document = Document::triangle();
    document.json["meshes"][0]["primitives"][0]["extensions"] = draco;
    document.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    assert_eq!(document.scene().triangles.len(), 1, "a plain copy");

    let mut bare = Document::triangle();
    bare.json = document.json.clone();
    bare.json["accessors"][0] = json!({"componentType": FLOAT, "type": "VEC3", "count": 3});
    document.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    for document in [document, bare] {
        let error = document.error();
        assert!(error.contains("KHR_draco_mesh_compression"), "{error}");
        assert!(error.contains("gltf-transform"), "{error}");
    }
}

#[test]
fn unknown_required_extensions_are_told_and_blamed() {
    let mut document = Document::triangle();
    document.json["extensionsRequired"] = json!(["ACME_rockets", "KHR_materials_ior"]);
    assert_warns(&document.scene(), "unknown", 1);
    document.json["accessors"][0]["count"] = json!(9);
    let error = document.error();
    assert!(error.contains("requires ACME_rockets"), "{error}");
}

#[test]
fn only_gltf_two_is_read() {
    for (text, words) in [
        ("", "the file is empty"),
        ("[]", "not an object"),
        ("{}", "asset: missing"),
        ("{\"asset\": {}}", "asset: missing field `version`"),
        ("{\"asset\": {\"version\": \"1.0\"}}", "must be 2.x"),
        (
            "{\"asset\": {\"version\": \"2.0\", \"minVersion\": \"2.1\"}}",
            "asset.minVersion",
        ),
        (
            "{\"asset\": {\"version\": \"2.0\"}, \"nodes\": 1}",
            "nodes: must be an array",
        ),
        ("glTF", "truncated: a GLB header has 12 bytes"),
        ("solid ascii", "not a glTF document"),
    ] {
        match open(text.as_bytes(), &Options::default()) {
            Ok(_) => panic!("{text} loads"),
            Err(error) => assert!(error.to_string().contains(words), "{text}: {error}"),
        }
    }
    let empty = open(
        b"\xef\xbb\xbf{\"asset\": {\"version\": \"2.1\"}}\n",
        &Options::default(),
    );
    let empty = empty.expect("an empty document is an empty scene");
    assert!(empty.instances.is_empty() && empty.materials.len() == 1);
}

#[test]
fn mutated_documents_never_panic() {
    let mut instanced = textured();
    let translations = instanced.floats("VEC3", &[0.0; 6]);
    instanced.json["nodes"][0]["extensions"] =
        json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": translations}}});
    instanced.json["materials"][0] =
        json!({"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 0}, "alphaMode": "MASK"});
    let seeds = [
        instanced.text().into_bytes(),
        skinned().text().into_bytes(),
        textured().glb(),
        skinned().glb(),
    ];
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("level.glb");
    let mut offenders = Vec::new();
    let mut n_loaded = 0;
    for case in 0..4000 {
        let mut rng = Rng::new(case);
        let mut bytes = seeds[case as usize % seeds.len()].clone();
        for _ in 0..1 + rng.bits() % 4 {
            mutate(&mut bytes, &mut rng);
        }
        fs::write(&path, &bytes).expect("writable folder");
        match std::panic::catch_unwind(|| Scene::open(&path, &Options::default())) {
            Ok(Ok(scene)) => {
                n_loaded += 1;
                for triangle in 0..scene.triangles.len().min(4) as u32 {
                    assert!(
                        scene.emission(triangle, at(0.3, 0.3)).is_finite(),
                        "case {case}"
                    );
                    assert!(
                        scene.alpha(triangle, at(0.3, 0.3)).is_finite(),
                        "case {case}"
                    );
                }
            }
            Ok(Err(_)) => {}
            Err(_) => offenders.push(case),
        }
    }
    assert!(offenders.is_empty(), "panics in cases {offenders:?}");
    // Mutations that always break the syntax would try nothing.
    assert!((400..3900).contains(&n_loaded), "{n_loaded} of 4000 load");
}

/// Changes a byte, a digit, or cuts the end off.
fn mutate(bytes: &mut Vec<u8>, rng: &mut Rng) {
    if bytes.is_empty() {
        return;
    }
    let at = (rng.bits() % bytes.len() as u64) as usize;
    match rng.bits() % 16 {
        0 => bytes.truncate(at),
        1..=4 => bytes[at] = rng.bits() as u8,
        _ => {
            // Digits are what counts, offsets and indices are made of.
            let digit = (0..bytes.len())
                .map(|step| (at + step) % bytes.len())
                .find(|place| bytes[*place].is_ascii_digit());
            if let Some(place) = digit {
                bytes[place] = b'0' + (rng.bits() % 10) as u8;
            }
        }
    }
}

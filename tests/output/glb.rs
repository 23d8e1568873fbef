//! The glTF file draws what was authored and says where it lies on the maps.

#![expect(clippy::print_stdout, reason = "a test that cannot run here says why")]

use std::fs;
use std::path::{Path, PathBuf};

use lumel::atlas::Atlas;
use lumel::error::Warnings;
use lumel::output::{Options, Writer};
use lumel::scene::{self, Scene};
use serde_json::{Value, json};

use crate::output::container::Document;
use crate::output::document;
use crate::support;

const NAME: &str = "LUMEL_light_vector_map";

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
            n_parts * scene.instances.len(),
            "{what}"
        );
    }
}

#[test]
fn nothing_of_the_document_is_lost() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 2, 1, 1);
    let (path, warnings) = write(&scene, &atlas, folder.path());
    let (before, after) = (&scene.source.json, Document::read(&path).json);
    for key in [
        "asset",
        "cameras",
        "skins",
        "animations",
        "textures",
        "scene",
    ] {
        assert_eq!(after[key], before[key], "{key}");
    }
    assert_eq!(
        after["extensionsRequired"],
        json!(["KHR_mesh_quantization"]),
        "programs that do not know us must open the file"
    );
    let used = after["extensionsUsed"].as_array().expect("a list");
    assert_eq!(used.iter().filter(|name| *name == NAME).count(), 1);
    assert_eq!(
        after["extensions"]["VENDOR_unknown"],
        before["extensions"]["VENDOR_unknown"]
    );
    let many = &after["nodes"][4]["extensions"];
    assert_eq!(many["VENDOR_unknown"], json!({"keep": 1}));
    assert_eq!(
        many["EXT_mesh_gpu_instancing"],
        before["nodes"][4]["extensions"]["EXT_mesh_gpu_instancing"]
    );
    // Keys keep their order, new ones come behind.
    let keys = |json: &Value| -> Vec<String> {
        json.as_object().expect("object").keys().cloned().collect()
    };
    let authored = keys(before);
    assert_eq!(keys(&after)[..authored.len()], authored);

    // Extras of others stay; those that are no object are left alone and told of.
    let moving = &after["nodes"][1]["extras"];
    assert_eq!(
        [&moving["lumel"]["scale"], &moving["keep"]],
        [&json!(2), &json!([1])]
    );
    assert_eq!(after["nodes"][2]["extras"], "words");
    assert_eq!(warnings.iter().count(), 1);
    assert_eq!(after["scenes"][0]["extras"]["lumel"]["mood"], "dark");
    assert_eq!(
        after["scenes"][0]["extras"]["lumel"]["lightVectorMap"],
        after["extensions"][NAME]
    );
    assert_eq!(after["scenes"][1], before["scenes"][1], "holds no lit node");

    // The picture is in the file now, byte for byte.
    let image = &after["images"][0];
    assert!(image.get("uri").is_none());
    assert_eq!(image["mimeType"], "image/png");
    assert_eq!(image["name"], "picture");
    let again = scene::load(&path, &scene::Options::default()).expect("readable");
    let picture = fs::read(folder.path().join("a picture.png")).expect("readable");
    assert!(again.source.image_bytes(0).expect("there").0 == picture);
}

#[test]
fn maps_are_named_by_uris_and_described() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 3, 1, 2);
    let (path, _) = write(&scene, &atlas, folder.path());
    let extension = &Document::read(&path).json["extensions"][NAME];
    assert_eq!(extension["version"], 1);
    assert_eq!(extension["rowOrder"], "top-first");
    let uri = |name: &str| format!("a%20b_lm1_{name}");
    assert_eq!(
        extension["maps"][1],
        json!({
            "width": 512, "height": 256, "texCoord": 1, "space": "world", "unit": "lux",
            "irradiance": uri("E.exr"),
            "lightVector": {"r": uri("Gr.exr"), "g": uri("Gg.exr"), "b": uri("Gb.exr")},
            "fluence": uri("phi.exr"),
            "error": uri("err.exr"),
            "preview": uri("preview.png"),
        })
    );
}

#[test]
fn a_picture_on_the_second_set_keeps_its_place() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 4, 1, 1);
    let (path, _) = write(&scene, &atlas, folder.path());
    let after = Document::read(&path).json;
    let materials = after["materials"].as_array().expect("a list");
    assert_eq!(materials.len(), 5, "two copies, for the moved set");
    // The node in the other scene and the points draw the authored materials.
    assert_eq!(
        materials[..3],
        scene.source.json["materials"].as_array().expect("a list")[..]
    );
    let moved = &materials[3];
    assert_eq!(
        moved["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"],
        2
    );
    let transform = &moved["emissiveTexture"]["extensions"]["KHR_texture_transform"];
    assert_eq!(*transform, json!({"texCoord": 2, "offset": [0.5, 0]}));
    assert_eq!(
        moved["extras"], materials[0]["extras"],
        "extras are not ours"
    );

    let elsewhere = after["nodes"][5]["mesh"].as_u64().expect("an index") as usize;
    assert_eq!(after["meshes"][elsewhere], scene.source.json["meshes"][0]);
    let lit = after["nodes"][1]["mesh"].as_u64().expect("an index") as usize;
    assert_ne!(lit, elsewhere);
    let primitive = &after["meshes"][lit]["primitives"][0];
    assert_eq!(primitive["material"], 3);
    let variants = &primitive["extensions"]["KHR_materials_variants"];
    assert_eq!(variants["mappings"][0]["material"], 4);
    assert_eq!(
        materials[4]["pbrMetallicRoughness"]["metallicRoughnessTexture"]["texCoord"],
        2
    );
    assert_eq!(
        after["meshes"][lit]["primitives"][1], scene.source.json["meshes"][0]["primitives"][1],
        "points are nobody's business"
    );

    // Without other users nothing is copied.
    let mut scene = scene;
    scene.source.json["nodes"][5] = json!({});
    scene.source.json["meshes"][0]["primitives"][1] = json!({"attributes": {}, "mode": 0});
    let (path, _) = write(&scene, &atlas, &folder.path().join("alone"));
    let after = Document::read(&path).json;
    assert_eq!(after["materials"].as_array().expect("a list").len(), 3);
    assert_eq!(
        after["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"],
        2
    );
}

#[test]
fn a_mesh_that_stands_once_has_page_coordinates() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 5, 1, 1);
    let (path, _) = write(&scene, &atlas, folder.path());
    let after = Document::read(&path).json;
    let place = |node: usize| &after["nodes"][node]["extensions"][NAME];
    let plain = json!({"map": 0, "scale": [1.0, 1.0], "offset": [0.0, 0.0]});
    assert_eq!(*place(7), plain, "bent stands once");
    for shared in [3, 4] {
        assert_ne!(*place(shared), plain, "{shared}");
    }
    let copies = place(4)["instances"].as_array().expect("a list");
    assert_eq!(copies.len(), 3);
}

#[test]
fn kept_coordinates_are_not_touched() {
    let (folder, scene) = hard();
    let mut atlas = document::random_atlas(&scene, 6, 1, 1);
    let mut kept = Vec::new();
    for (index, unwrap) in atlas.unwraps.iter_mut().enumerate() {
        if scene.meshes[unwrap.mesh].source == 0 {
            unwrap.authored = true;
            kept.push(index);
        }
    }
    let (path, _) = write(&scene, &atlas, folder.path());
    let after = Document::read(&path).json;
    assert_eq!(after["meshes"][0], scene.source.json["meshes"][0]);
    assert_eq!(after["materials"], scene.source.json["materials"]);
    let placements = atlas.placements.iter();
    for placement in placements.filter(|placement| kept.contains(&placement.unwrap)) {
        let node = &after["nodes"][scene.instances[placement.instance].node];
        assert_eq!(node["mesh"], 0);
        let [width, height] = atlas.unwraps[placement.unwrap].size.map(f64::from);
        let [x, y] = placement.offset.map(f64::from);
        assert_eq!(
            node["extensions"][NAME],
            json!({
                "map": 0,
                "scale": [width / 512.0, height / 256.0],
                "offset": [x / 512.0, y / 256.0],
            })
        );
    }
}

#[test]
fn parts_take_skin_weights_and_copies_along() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 7, 1, 2);
    let (path, _) = write(&scene, &atlas, folder.path());
    let before = &scene.source.json;
    let after = Document::read(&path).json;
    for (node, key) in [(1, "weights"), (4, "mesh"), (7, "skin")] {
        let parent = &after["nodes"][node];
        let children = parent["children"].as_array().expect("children");
        assert_eq!(children.len(), 2);
        for (number, child) in children.iter().enumerate() {
            let child = &after["nodes"][child.as_u64().expect("an index") as usize];
            let name = before["nodes"][node]["name"].as_str().expect("named");
            assert_eq!(child["name"], format!("{name}.part{number}"));
            if key != "mesh" {
                assert_eq!(child[key], before["nodes"][node][key]);
            }
        }
        for key in ["mesh", "skin", "weights"] {
            assert!(parent.get(key).is_none(), "{key} stays at node {node}");
        }
    }
    let part = &after["nodes"][1]["children"][0];
    let part = &after["nodes"][part.as_u64().expect("an index") as usize];
    assert_eq!(part["extras"]["lumel"]["scale"], 2, "the author's density");

    // The animation of weights drives both parts of the node.
    let channels = after["animations"][0]["channels"]
        .as_array()
        .expect("a list");
    let driven: Vec<&Value> = channels.iter().map(|it| &it["target"]["node"]).collect();
    let children = after["nodes"][1]["children"].as_array().expect("a list");
    assert_eq!(driven, children.iter().collect::<Vec<_>>());
}

#[test]
fn copies_with_different_layouts_are_told_apart() {
    let (folder, scene) = hard();
    // Mesh 1 stands at node 3 and three times at node 4; its four instances take turns among two unwraps.
    let atlas = document::random_atlas(&scene, 8, 2, 1);
    let (path, _) = write(&scene, &atlas, folder.path());
    let written = Document::read(&path);
    let parent = &written.json["nodes"][4];
    assert_eq!(parent["extensions"], json!({"VENDOR_unknown": {"keep": 1}}));
    let mut copies = Vec::new();
    for child in parent["children"].as_array().expect("children") {
        let child = &written.json["nodes"][child.as_u64().expect("an index") as usize];
        let attributes = &child["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
        let values = |name: &str| -> Vec<f64> {
            let accessor = attributes[name].as_u64().expect("an index") as usize;
            let elements = written.elements(accessor);
            elements.iter().map(|element| element[0]).collect()
        };
        let instances = &child["extensions"][NAME]["instances"];
        let n_instances = instances.as_array().expect("a list").len();
        copies.push((values("TRANSLATION"), values("_NUMBER"), n_instances));
    }
    copies.sort_by_key(|copies| copies.2);
    assert_eq!(
        copies,
        [
            (vec![4.0], vec![6.0], 1),
            (vec![0.0, 8.0], vec![5.0, 7.0], 2)
        ]
    );
}

#[test]
fn a_baked_document_can_be_baked_again() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 9, 1, 1);
    let (path, _) = write(&scene, &atlas, &folder.path().join("once"));
    let once = Document::read(&path).json;
    let again = scene::load(&path, &scene::Options::default()).expect("readable");
    let mut atlas = document::random_atlas(&again, 10, 1, 1);
    let (path, _) = write(&again, &atlas, &folder.path().join("twice"));
    let twice = Document::read(&path);
    check(&again, &atlas, &twice, "twice");
    assert_eq!(twice.json["extensionsUsed"], once["extensionsUsed"]);
    assert_eq!(twice.json["nodes"][1]["extras"]["lumel"]["scale"], 2);

    // A bake of nothing leaves no trace of the one before.
    atlas.placements.clear();
    let (path, _) = write(&again, &atlas, &folder.path().join("none"));
    let none = Document::read(&path).json;
    for node in none["nodes"].as_array().expect("a list") {
        let text = node.to_string();
        assert!(!text.contains(NAME) && !text.contains("lightVectorMap"));
    }
}

#[test]
fn same_input_gives_the_same_file() {
    let (folder, scene) = hard();
    let atlas = document::random_atlas(&scene, 11, 2, 2);
    let files = ["one", "two"].map(|name| {
        let (path, _) = write(&scene, &atlas, &folder.path().join(name));
        fs::read(path).expect("readable")
    });
    assert!(files[0] == files[1], "bytes differ");
}

#[test]
fn a_scene_without_a_document_is_an_error() {
    let triangles = support::quad(glam::DVec3::ZERO, glam::DVec3::X, glam::DVec3::Y);
    let scene = support::scene_of(&[(scene::Material::default(), triangles)]);
    let atlas = document::random_atlas(&scene, 0, 1, 1);
    let folder = tempfile::tempdir().expect("temporary folder");
    let mut writer = Writer::create(folder.path(), "out", &Options::default()).expect("writable");
    match writer.glb(&scene, &atlas, &[]) {
        Err(lumel::Error::InvalidFile { place, .. }) => assert_eq!(place, "meshes[0]"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn real_scenes_draw_what_they_drew() {
    let Some(folder) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let target = tempfile::tempdir().expect("temporary folder");
    for (case, name) in REAL.into_iter().enumerate() {
        let scene = scene::load(&folder.join(name), &scene::Options::default())
            .unwrap_or_else(|error| panic!("{error}"));
        let atlas = document::random_atlas(&scene, case as u64, 1 + case % 2, 1 + case / 2 % 2);
        let (path, _) = write(&scene, &atlas, &target.path().join(case.to_string()));
        check(&scene, &atlas, &Document::read(&path), name);
        let again = scene::load(&path, &scene::Options::default()).expect("readable");
        assert_eq!(again.triangles.len(), scene.triangles.len(), "{name}");
    }
}

#[test]
fn broken_documents_are_written_or_refused() {
    let Some(folder) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let target = tempfile::tempdir().expect("temporary folder");
    let mut folders = vec![folder.join("malformed")];
    let mut n_written = 0;
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(folder).expect("readable folder");
        let mut paths: Vec<PathBuf> = entries.map(|it| it.expect("readable").path()).collect();
        paths.sort();
        for path in paths {
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let is_document = path
                .extension()
                .is_some_and(|it| it == "gltf" || it == "glb");
            if !is_document {
                continue;
            }
            let Ok(scene) = scene::load(&path, &scene::Options::default()) else {
                continue;
            };
            let atlas = document::random_atlas(&scene, n_written, 1, 2);
            let mut writer =
                Writer::create(target.path(), "out", &Options::default()).expect("writable");
            if writer.glb(&scene, &atlas, &document::pages(&atlas)).is_ok() {
                n_written += 1;
            }
        }
    }
    assert!(n_written > 100, "only {n_written} were written");
}

#[test]
fn real_layouts_draw_what_was_authored() {
    let Some(folder) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let target = tempfile::tempdir().expect("temporary folder");
    let options = lumel::atlas::Options {
        texels_per_metre: 4.0,
        page: 256,
        uv: lumel::atlas::Uv::Unwrap,
        ..lumel::atlas::Options::default()
    };
    for name in [
        "levels/bevy_volumetric_fog/VolumetricFogExample.glb",
        REAL[11],
        REAL[13],
    ] {
        let scene = scene::load(&folder.join(name), &scene::Options::default())
            .unwrap_or_else(|error| panic!("{error}"));
        let atlas = lumel::atlas::build(&scene, &options, &|| false)
            .unwrap_or_else(|error| panic!("{error}"));
        let (path, _) = write(&scene, &atlas, &target.path().join(&scene.name));
        check(&scene, &atlas, &Document::read(&path), name);
    }
}

/// Scenes by others, one or two for each thing that is hard to write again.
pub(crate) const REAL: [&str; 24] = [
    "levels/bevyjam2_level1/level1.glb",
    "levels/foxtrot2023_level/level.glb",
    "levels/dive_arena/level.glb",
    "levels/webxr_garage/garage.gltf",
    "levels/godot_living_room/living_room.glb",
    "levels/librequake/lq_e0m1.glb",
    "models/dutch_ship/dutch_ship_medium_1k.gltf",
    "cornell/bevy_cornell/CornellBox.glb",
    "cornell/babylon_cornell/cornellBox.glb",
    "khronos/LightsPunctualLamp/glTF/LightsPunctualLamp.gltf",
    "khronos/NormalTangentMirrorTest/glTF-Binary/NormalTangentMirrorTest.glb",
    "khronos/MultiUVTest/glTF-Binary/MultiUVTest.glb",
    "khronos/TextureTransformTest/glTF/TextureTransformTest.gltf",
    "khronos/SimpleInstancing/glTF-Binary/SimpleInstancing.glb",
    "khronos/SimpleSparseAccessor/glTF/SimpleSparseAccessor.gltf",
    "khronos/MeshPrimitiveModes/glTF/MeshPrimitiveModes.gltf",
    "khronos/VertexColorTest/glTF-Binary/VertexColorTest.glb",
    "khronos/MorphPrimitivesTest/glTF-Binary/MorphPrimitivesTest.glb",
    "khronos/MultipleScenes/glTF/MultipleScenes.gltf",
    "khronos/Duck/glTF-Quantized/Duck.gltf",
    "khronos/Box With Spaces/glTF/Box With Spaces.gltf",
    "khronos/Unicode❤♻Test/glTF/Unicode❤♻Test.gltf",
    "khronos/BoxInterleaved/glTF-Binary/BoxInterleaved.glb",
    "khronos/TriangleWithoutIndices/glTF-Embedded/TriangleWithoutIndices.gltf",
];

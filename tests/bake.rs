//! The whole pipeline: what a texture says about a place is what the light meter says there, and every real level goes through.

#![expect(clippy::print_stdout, reason = "says what was skipped")]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use glam::DVec3;
use lumel::bake::{self, Execution, Options, Output};
use lumel::scene::{Alpha, Material, Scene};
use lumel::transport::Receiver;
use serde_json::Value;

use crate::support::{emitter, fixture, quad, root, scene_of, shared_scenes};

/// Runs `work` with an execution that nobody watches.
fn alone<R>(work: impl FnOnce(&Execution<'_>) -> R) -> R {
    let cancelled = AtomicBool::new(false);
    work(&Execution {
        threads: None,
        cancelled: &cancelled,
        progress: &|_| {},
    })
}

fn temporary() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Rows of RGB from the top.
struct Map {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Map {
    fn read(path: &Path) -> Self {
        let image = exr::prelude::read_first_rgba_layer_from_file(
            path,
            |size, _| Self {
                width: size.width(),
                height: size.height(),
                pixels: vec![[0.0; 3]; size.area()],
            },
            |map: &mut Self, place, (r, g, b, _): (f32, f32, f32, f32)| {
                let index = place.y() * map.width + place.x();
                map.pixels[index] = [r, g, b];
            },
        )
        .expect("an EXR with R, G, B");
        image.layer_data.channel_data.pixels
    }

    /// As an engine samples it: bilinear, v = 0 at the top.
    fn lookup(&self, [u, v]: [f64; 2]) -> DVec3 {
        let (x, y) = (u * self.width as f64 - 0.5, v * self.height as f64 - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let mut sum = DVec3::ZERO;
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let weight = (1.0 - (x - left - dx).abs()) * (1.0 - (y - top - dy).abs());
            let column = (left + dx).clamp(0.0, self.width as f64 - 1.0) as usize;
            let row = (top + dy).clamp(0.0, self.height as f64 - 1.0) as usize;
            let pixel = self.pixels[row * self.width + column].map(f64::from);
            sum += weight * DVec3::from_array(pixel);
        }
        sum
    }
}

/// Points of the surfaces of a baked glTF file: world position, normal and lightmap coordinates, three on each triangle.
fn surface_points(glb: &Path) -> Vec<(DVec3, DVec3, [f64; 2])> {
    let scene = Scene::open(glb, &lumel::scene::Options::default()).expect("the baked file opens");
    let node_maps: Vec<Value> = scene.source.json["nodes"]
        .as_array()
        .expect("nodes")
        .iter()
        .map(|node| node["extensions"]["LUMEL_light_vector_map"].clone())
        .collect();
    let mut points = Vec::new();
    for triangle in &scene.triangles {
        let instance = &scene.instances[triangle.instance as usize];
        let primitive = &scene.meshes[instance.mesh].primitives[triangle.primitive as usize];
        let map = &node_maps[instance.node];
        let number = |key: &str, axis: usize| map[key][axis].as_f64().expect("a number");
        for weights in [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6]] {
            let mut position = DVec3::ZERO;
            let mut texcoord = [0.0; 2];
            for (corner, weight) in weights.into_iter().enumerate() {
                position += weight * triangle.vertices[corner];
                let own = primitive.texcoords[1][triangle.corners[corner] as usize];
                for axis in 0..2 {
                    texcoord[axis] += weight * f64::from(own[axis]);
                }
            }
            let uv = [0, 1].map(|k| texcoord[k] * number("scale", k) + number("offset", k));
            points.push((position, triangle.area_vector().normalize(), uv));
        }
    }
    points
}

#[test]
fn the_map_says_what_the_light_meter_says() {
    // Flat-shaded scenes, so that the normal of a triangle is the normal of its texels.
    for name in ["slab", "contact", "cornell"] {
        let folder = temporary();
        let path = fixture(name).join(format!("{name}.gltf"));
        let scene = Scene::open(&path, &lumel::scene::Options::default()).expect("a fixture");
        let options = Options {
            outputs: Some(vec![Output::E, Output::Glb]),
            float: true,
            ..Options::default()
        };
        alone(|execution| bake::bake(&scene, folder.path(), &options, execution)).expect("a bake");
        let map = Map::read(&folder.path().join(format!("{name}_lm0_E.exr")));
        let points = surface_points(&folder.path().join(format!("{name}.glb")));
        let receivers: Vec<Receiver> = points
            .iter()
            .map(|&(position, normal, _)| Receiver {
                position,
                normal,
                seed: 0,
            })
            .collect();
        let (samples, _) = alone(|execution| bake::probe(&scene, &receivers, &options, execution))
            .expect("a probe");
        let brightest = samples
            .iter()
            .zip(&points)
            .map(|(sample, point)| sample.irradiance(point.1).max_element())
            .fold(0.0, f64::max);
        let mut errors: Vec<f64> = samples
            .iter()
            .zip(&points)
            .map(|(sample, &(_, normal, uv))| {
                let error = map.lookup(uv) - sample.irradiance(normal);
                error.abs().max_element() / brightest
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        // Between texels the map interpolates: a wrong axis, row order, offset or normal shows at most points, curvature of the light
        // within a texel of 12.5 cm and shadow borders at few.
        let median = errors[errors.len() / 2];
        let most = errors[errors.len() * 9 / 10];
        assert!(median < 0.005, "{name}: median {median}");
        assert!(most < 0.05, "{name}: nine in ten within {most}");
    }
}

fn counters(scene: &Scene, options: &Options) -> (Value, Vec<String>) {
    let folder = temporary();
    let report =
        alone(|execution| bake::bake(scene, folder.path(), options, execution)).expect("a bake");
    (report.manifest, report.files)
}

/// A floor under a light.
fn floor_and_light(floor: Material, light: Material) -> Scene {
    let down = quad(DVec3::new(1.0, 3.0, 1.0), DVec3::X, DVec3::Z);
    scene_of(&[
        (floor, quad(DVec3::ZERO, 3.0 * DVec3::Z, 3.0 * DVec3::X)),
        (light, down),
    ])
}

#[test]
fn a_scene_without_lights_casts_no_ray_and_is_dark() {
    let scene = floor_and_light(Material::default(), Material::default());
    let (manifest, files) = counters(&scene, &Options::default());
    assert_eq!(manifest["counters"]["light"]["pairs"], 0);
    assert_eq!(manifest["counters"]["light"]["shadow_rays"], 0);
    assert!(manifest["counters"]["texels"].as_u64() > Some(0));
    let decision = |what: &str| {
        manifest["plan"]
            .as_array()
            .expect("a plan")
            .iter()
            .find(|decision| decision["what"] == what)
            .expect("decided")
            .clone()
    };
    assert_eq!(decision("area lights")["done"], false);
    assert_eq!(
        files.iter().filter(|file| file.ends_with("_E.exr")).count(),
        1
    );
}

#[test]
fn an_empty_scene_is_no_error() {
    let scene = scene_of(&[]);
    let (manifest, files) = counters(&scene, &Options::default());
    assert_eq!(manifest["counters"]["texels"], 0);
    assert!(
        files.iter().all(|file| !file.ends_with(".exr")),
        "{files:?}"
    );
}

#[test]
fn the_light_vector_is_stored_only_where_a_normal_texture_needs_it() {
    let relief = Material {
        normal_mapped: true,
        ..Material::default()
    };
    let (_, flat) = counters(
        &floor_and_light(Material::default(), emitter(10.0)),
        &Options::default(),
    );
    let (_, bumpy) = counters(&floor_and_light(relief, emitter(10.0)), &Options::default());
    let has = |files: &[String], plane: &str| {
        files
            .iter()
            .any(|file| file.ends_with(&format!("_{plane}.exr")))
    };
    for plane in ["Gr", "Gg", "Gb", "phi"] {
        assert!(!has(&flat, plane), "{plane} without need");
        assert!(has(&bumpy, plane), "{plane} missing");
    }
    let asked = Options {
        directional: true,
        ..Options::default()
    };
    let (_, asked) = counters(&floor_and_light(Material::default(), emitter(10.0)), &asked);
    assert!(has(&asked, "Gr"));
}

#[test]
fn only_masked_surfaces_make_the_bake_cast_rays() {
    let screen = |alpha| {
        let mut parts = vec![
            (
                Material::default(),
                quad(DVec3::ZERO, 3.0 * DVec3::Z, 3.0 * DVec3::X),
            ),
            (
                emitter(10.0),
                quad(DVec3::new(1.0, 3.0, 1.0), DVec3::X, DVec3::Z),
            ),
        ];
        let material = Material {
            alpha,
            ..Material::default()
        };
        parts.push((
            material,
            quad(DVec3::new(1.2, 1.5, 1.2), 0.5 * DVec3::X, 0.5 * DVec3::Z),
        ));
        counters(&scene_of(&parts), &Options::default()).0["counters"]["light"].clone()
    };
    let opaque = screen(Alpha::Opaque);
    let masked = screen(Alpha::Mask { cutoff: 0.5 });
    assert_eq!(opaque["shadow_rays"], 0);
    assert_eq!(opaque["pairs_sampled"], 0);
    assert!(opaque["pairs_exact"].as_u64() > Some(0));
    assert!(masked["shadow_rays"].as_u64() > Some(0));
    assert_eq!(masked["pairs_exact"], 0);
}

#[test]
fn brightness_over_sixty_orders_stays_finite() {
    for radiance in [1e-30_f32, 1e30] {
        let scene = floor_and_light(Material::default(), emitter(radiance));
        let folder = temporary();
        let options = Options {
            directional: true,
            ..Options::default()
        };
        alone(|execution| bake::bake(&scene, folder.path(), &options, execution)).expect("a bake");
        let map = Map::read(&folder.path().join("test_lm0_E.exr"));
        let brightest = map.pixels.iter().flatten().copied().fold(0.0, f32::max);
        assert!(map.pixels.iter().flatten().all(|value| value.is_finite()));
        // Under the middle of a light of 1 m² at 3 m a tenth of its radiance arrives, roughly.
        let share = brightest / radiance;
        assert!((0.05..0.2).contains(&share), "{radiance:e}: {brightest:e}");
    }
}

/// Documents below `folder`, sorted.
fn documents(folder: &Path) -> Vec<PathBuf> {
    let mut folders = vec![folder.to_owned()];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path
                .extension()
                .is_some_and(|extension| extension == "gltf" || extension == "glb")
            {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Exit code and messages of `lumel bake`; `None` when it did not end in time.
fn run(document: &Path, target: &Path, options: &[&str], limit: Duration) -> Option<(i32, String)> {
    let messages = target.with_extension("messages");
    let file = std::fs::File::create(&messages).expect("a file");
    let mut child = Command::new(env!("CARGO_BIN_EXE_lumel"))
        .args(["bake", "--quiet"])
        .args(options)
        .arg("-o")
        .arg(target)
        .arg(document)
        .stdout(Stdio::null())
        .stderr(file)
        .spawn()
        .expect("the command starts");
    let status = wait(&mut child, limit)?;
    let messages = std::fs::read_to_string(&messages).expect("messages");
    Some((status, messages))
}

fn wait(child: &mut Child, limit: Duration) -> Option<i32> {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().expect("a child") {
            // A death by signal has no code.
            return Some(status.code().unwrap_or(-1));
        }
        if start.elapsed() > limit {
            child.kill().expect("a running child");
            child.wait().expect("an ended child");
            return None;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn every_real_scene_bakes_or_names_the_extension_it_requires() {
    let Some(scenes) = shared_scenes() else {
        println!(
            "skipped: no folder of real scenes beside {}",
            root().display()
        );
        return;
    };
    let folder = temporary();
    let mut bad = Vec::new();
    let mut n_baked = 0;
    for part in ["levels", "models", "cornell", "lights", "khronos"] {
        for document in documents(&scenes.join(part)) {
            let target = folder.path().join("baked");
            // Half an hour: only a hang takes that long, however busy the machine is. The tolerance leaves most of hundreds of dim lights
            // out: the question is whether a level goes through, not how well.
            let limit = Duration::from_secs(1800);
            let options = ["--texels-per-metre", "0.02", "--tolerance", "0.5"];
            let result = run(&document, &target, &options, limit);
            let left_behind = target.exists();
            match result {
                Some((0 | 3, _)) if left_behind => n_baked += 1,
                Some((1, messages))
                    if messages.contains("requires KHR_draco_mesh_compression")
                        && messages.lines().count() == 1
                        && !left_behind => {}
                other => bad.push(format!("{}: {other:?}", document.display())),
            }
            let _ = std::fs::remove_dir_all(&target);
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
    assert!(n_baked >= 40, "only {n_baked} scenes");
}

#[test]
fn every_broken_file_ends_soon_with_a_word_about_its_fault() {
    let Some(scenes) = shared_scenes() else {
        println!(
            "skipped: no folder of broken files beside {}",
            root().display()
        );
        return;
    };
    let folder = temporary();
    let mut bad = Vec::new();
    for document in documents(&scenes.join("malformed")) {
        let target = folder.path().join("baked");
        let result = run(&document, &target, &[], Duration::from_secs(60));
        // The fault may lie in a file that the document refers to.
        let beside = document.parent().expect("a folder").to_string_lossy();
        match result {
            Some((0, _)) => {}
            Some((1, messages))
                if messages.starts_with("error: ")
                    && messages.contains(&*beside)
                    && !messages.contains("panic")
                    && !messages.contains("internal")
                    && !target.exists() => {}
            other => bad.push(format!("{}: {other:?}", document.display())),
        }
        let _ = std::fs::remove_dir_all(&target);
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

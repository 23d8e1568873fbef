//! Readers by others agree: the reference library of `OpenEXR`, three's `EXRLoader`, the Khronos glTF validator.
//!
//! They are installed by `.ci/install` below `target/readers`. Where they are missing these tests say so and pass, unless
//! `LUMEL_REQUIRE_READERS=1`.

#![expect(clippy::print_stdout, reason = "a test that cannot run here says why")]

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use half::f16;
use lumel::atlas;
use lumel::output::{Options, PageFiles};
use lumel::refine::Field;
use lumel::scene;
use serde_json::Value;

use crate::output::{document, glb, maps};
use crate::support;

/// A program by others, and where its modules are.
struct Reader {
    program: PathBuf,
    script: PathBuf,
    modules: Option<PathBuf>,
}

impl Reader {
    /// `script` of this folder, run by the virtual environment's Python or by Node; `None` when they are not installed.
    fn find(script: &str) -> Option<Self> {
        let tools = support::root().join("target/readers");
        let is_python = script.ends_with(".py");
        let [program, modules] = if is_python {
            ["venv/bin/python", "venv/lib"]
        } else {
            ["node", "node_modules"]
        };
        let modules = tools.join(modules);
        let program = if is_python {
            tools.join(program)
        } else {
            program.into()
        };
        let runs = Command::new(&program).arg("--version").output();
        if !modules.is_dir() || !runs.is_ok_and(|output| output.status.success()) {
            let missing = format!("{script} has no readers in target/readers; run .ci/install");
            assert!(
                std::env::var("LUMEL_REQUIRE_READERS").as_deref() != Ok("1"),
                "{missing}"
            );
            println!("skipped: {missing}");
            return None;
        }
        Some(Self {
            program,
            script: support::root().join("tests/readers").join(script),
            modules: (!is_python).then_some(modules),
        })
    }

    /// Runs the script on `arguments`; one JSON object per line of its output.
    fn run(&self, arguments: &[OsString]) -> Vec<Value> {
        let output = Command::new(&self.program)
            .arg(&self.script)
            .args(&self.modules)
            .args(arguments)
            .output()
            .expect("the reader runs");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success(),
            "{}: {}{text}",
            self.script.display(),
            String::from_utf8_lossy(&output.stderr)
        );
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}")))
            .collect()
    }
}

/// Values that a reader could get wrong: signs, zeros, both ends of the range, subnormal numbers, all mixed with ordinary ones.
fn extreme_field(float: bool) -> Field {
    let mut field = maps::field(11, 30, 37, 60000.0);
    let edges: [f32; 12] = if float {
        [
            0.0,
            -0.0,
            1e-45,
            -1e-45,
            1.175e-38,
            1e-20,
            f32::MAX,
            f32::MIN,
            1e30,
            3.3,
            0.1,
            -7.7,
        ]
    } else {
        [
            0.0, -0.0, 5.96e-8, -5.96e-8, 6.1e-5, 1e-3, 65504.0, -65504.0, 2048.5, 3.3, 0.1, -7.7,
        ]
    };
    for plane in &mut field.planes {
        for (value, edge) in plane.values.iter_mut().zip(edges.iter().cycle()).step_by(3) {
            *value = *edge;
        }
    }
    field
}

/// The bytes that a dump of a map must have: planar, from the top row down, in the file's own type.
fn expected_bytes(field: &Field, plane: usize, precision: &str) -> Vec<u8> {
    let plane = &field.planes[plane];
    let mut bytes = Vec::new();
    for component in 0..plane.components {
        for y in 0..field.height {
            for x in 0..field.width {
                let value = maps::expected(field, plane, x, y, 4)[component];
                match precision {
                    "half" => bytes.extend(f16::from_f32(value).to_bits().to_le_bytes()),
                    _ => bytes.extend(value.to_le_bytes()),
                }
            }
        }
    }
    bytes
}

/// Maps of every kind in both precisions: the folder, the fields, what was said of them, the files.
fn written_maps(folder: &Path) -> Vec<(Field, PageFiles, Vec<PathBuf>)> {
    [false, true]
        .map(|float| {
            let field = extreme_field(float);
            let target = folder.join(float.to_string());
            let page = maps::write(&target, &field, &Options::default());
            let maps = page.maps.iter().take(field.planes.len());
            let files = maps.map(|map| target.join(&map.file)).collect();
            let want = if float { "float" } else { "half" };
            assert!(
                page.maps[..field.planes.len()]
                    .iter()
                    .all(|map| map.precision == want)
            );
            (field, page, files)
        })
        .into()
}

fn check_dump(file: &Path, reader: &str, field: &Field, plane: usize, precision: &str) {
    let mut dump = file.as_os_str().to_owned();
    dump.push(format!(".{reader}.raw"));
    let got = fs::read(dump).expect("the reader left a dump");
    let want = expected_bytes(field, plane, precision);
    assert!(got == want, "{reader} reads {} differently", file.display());
}

#[test]
fn openexr_reads_what_was_written() {
    let Some(reader) = Reader::find("read_exr.py") else {
        return;
    };
    let folder = tempfile::tempdir().expect("temporary folder");
    for (field, page, files) in written_maps(folder.path()) {
        let arguments: Vec<OsString> = files.iter().map(Into::into).collect();
        let said = reader.run(&arguments);
        assert_eq!(said.len(), files.len());
        for (plane, (said, file)) in said.iter().zip(&files).enumerate() {
            let map = &page.maps[plane];
            assert_eq!(said["parts"], 1);
            assert_eq!(said["compression"], "Compression.ZIP_COMPRESSION");
            let names = if field.planes[plane].components == 1 {
                "[\"Y\"]"
            } else {
                "[\"B\",\"G\",\"R\"]"
            };
            assert_eq!(said["channels"].to_string(), names);
            let about: Value = said["lumel"]
                .as_str()
                .and_then(|text| serde_json::from_str(text).ok())
                .expect("our attribute is JSON");
            assert_eq!(about["plane"], map.plane);
            assert_eq!(about["unit"], "lux");
            check_dump(file, "openexr", &field, plane, map.precision);
        }
    }
}

#[test]
fn three_reads_what_was_written() {
    let Some(reader) = Reader::find("read_exr.mjs") else {
        return;
    };
    let folder = tempfile::tempdir().expect("temporary folder");
    for (field, page, files) in written_maps(folder.path()) {
        let arguments: Vec<OsString> = page
            .maps
            .iter()
            .zip(&field.planes)
            .zip(&files)
            .flat_map(|((map, plane), file)| {
                let n_channels = plane.components.to_string();
                [map.precision.into(), n_channels.into(), file.into()]
            })
            .collect();
        let said = reader.run(&arguments);
        assert_eq!(said.len(), files.len());
        for (plane, file) in files.iter().enumerate() {
            assert_eq!(said[plane]["width"], field.width);
            assert_eq!(said[plane]["height"], field.height);
            check_dump(file, "three", &field, plane, page.maps[plane].precision);
        }
    }
}

#[test]
fn the_validator_finds_no_fault_in_a_hard_document() {
    let Some(reader) = Reader::find("validate.mjs") else {
        return;
    };
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = document::hard(folder.path());
    let scene = scene::load(&path, &scene::Options::default()).unwrap_or_else(|e| panic!("{e}"));
    let mut files = vec![path];
    for (n_variants, n_parts) in [(1, 1), (2, 1), (1, 2), (2, 2)] {
        let atlas = document::random_atlas(&scene, 1, n_variants, n_parts);
        let target = folder.path().join(format!("{n_variants} {n_parts}"));
        files.push(glb::write(&scene, &atlas, &target).0);
    }
    let reports = validate(&reader, &files);
    assert_eq!(reports[0]["errors"], serde_json::json!({}), "as authored");
    for (file, report) in files.iter().zip(&reports) {
        let faults = new_faults(&reports[0], report);
        assert!(faults.is_empty(), "{}: {faults:?}", file.display());
    }
}

#[test]
fn the_validator_finds_no_new_fault_in_real_scenes() {
    let Some(reader) = Reader::find("validate.mjs") else {
        return;
    };
    let Some(scenes) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let folder = tempfile::tempdir().expect("temporary folder");
    let mut files = Vec::new();
    for (case, name) in glb::REAL.into_iter().enumerate() {
        let path = scenes.join(name);
        let scene =
            scene::load(&path, &scene::Options::default()).unwrap_or_else(|e| panic!("{e}"));
        let atlas = document::random_atlas(&scene, case as u64, 1 + case % 2, 1 + case / 2 % 2);
        let (written, _) = glb::write(&scene, &atlas, &folder.path().join(case.to_string()));
        files.extend([path, written]);
    }
    let reports = validate(&reader, &files);
    for (name, reports) in glb::REAL.iter().zip(reports.chunks(2)) {
        let faults = new_faults(&reports[0], &reports[1]);
        assert!(faults.is_empty(), "{name}: {faults:?}");
    }
}

#[test]
fn the_validator_finds_no_new_fault_in_real_layouts() {
    let Some(reader) = Reader::find("validate.mjs") else {
        return;
    };
    let Some(scenes) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let folder = tempfile::tempdir().expect("temporary folder");
    // Small pages, so that large meshes are spread over several.
    let options = atlas::Options {
        texels_per_metre: 4.0,
        page: 512,
        ..atlas::Options::default()
    };
    let mut files = Vec::new();
    for (case, name) in LAID_OUT.into_iter().enumerate() {
        let path = scenes.join(name);
        let scene =
            scene::load(&path, &scene::Options::default()).unwrap_or_else(|e| panic!("{e}"));
        let atlas = atlas::build(&scene, &options, &|| false).unwrap_or_else(|e| panic!("{e}"));
        let (written, _) = glb::write(&scene, &atlas, &folder.path().join(case.to_string()));
        files.extend([path, written]);
    }
    let reports = validate(&reader, &files);
    for (name, reports) in LAID_OUT.iter().zip(reports.chunks(2)) {
        let faults = new_faults(&reports[0], &reports[1]);
        assert!(faults.is_empty(), "{name}: {faults:?}");
    }
}

/// Scenes that are laid out in a few seconds: one with kept coordinates, one with copies, one with several pages.
const LAID_OUT: [&str; 5] = [
    "cornell/babylon_cornell/cornellBox.glb",
    "khronos/SimpleInstancing/glTF-Binary/SimpleInstancing.glb",
    "khronos/MultiUVTest/glTF-Binary/MultiUVTest.glb",
    "levels/bevy_volumetric_fog/VolumetricFogExample.glb",
    "levels/dive_arena/level.glb",
];

/// One report per file.
fn validate(reader: &Reader, files: &[PathBuf]) -> Vec<Value> {
    let arguments: Vec<OsString> = files.iter().map(Into::into).collect();
    let reports = reader.run(&arguments);
    assert_eq!(reports.len(), files.len());
    reports
}

/// Errors and warnings of kinds that the authored document does not have. How often each occurs may change, because meshes are
/// written once per layout and vertices once per side of a seam.
fn new_faults(before: &Value, after: &Value) -> Vec<String> {
    let mut faults = Vec::new();
    for kind in ["errors", "warnings"] {
        for (code, found) in after[kind].as_object().expect("an object") {
            if before[kind].get(code).is_none() {
                faults.push(format!("{code}: {}", found["first"]));
            }
        }
    }
    faults
}

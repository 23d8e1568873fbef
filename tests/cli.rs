//! The command: what it says, what it returns, what it writes; and that the bundled scenes are what their program writes.

use std::fs;
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::process::Child;
use std::process::{Command, Output, Stdio};
#[cfg(unix)]
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

use crate::support;

#[path = "../examples/make_fixtures/fixtures/mod.rs"]
mod make_fixtures;

/// A bake of a fixture that takes a moment only.
const QUICK: [&str; 4] = ["--texels-per-metre", "2", "--samples", "4"];

const COLUMNS: &str = "e_r,e_g,e_b,gr_x,gr_y,gr_z,gg_x,gg_y,gg_z,gb_x,gb_y,gb_z,phi_r,phi_g,phi_b,\
jr_xx,jr_xy,jr_xz,jr_yx,jr_yy,jr_yz,jr_zx,jr_zy,jr_zz,\
jg_xx,jg_xy,jg_xz,jg_yx,jg_yy,jg_yz,jg_zx,jg_zy,jg_zz,\
jb_xx,jb_xy,jb_xz,jb_yx,jb_yy,jb_yz,jb_zx,jb_zy,jb_zz,error,rays";

#[test]
fn bundled_scenes_are_what_their_program_writes() {
    for file in make_fixtures::all() {
        let path = support::fixture(&file.path);
        let committed = fs::read(&path).expect("a bundled file");
        let same = if file.path.ends_with(".png") {
            // Another version of the encoder may pack the same picture differently.
            pixels(&committed) == pixels(&file.bytes)
        } else {
            committed == file.bytes
        };
        assert!(
            same,
            "{} differs; write it again with `cargo run --release --example make_fixtures`",
            path.display()
        );
    }
}

#[test]
fn every_bundled_folder_is_written_by_the_program() {
    let written = make_fixtures::all();
    for entry in fs::read_dir(support::fixture("")).expect("fixtures") {
        let entry = entry.expect("a readable entry");
        let prefix = format!("{}/", entry.file_name().to_string_lossy());
        assert!(
            entry.path().is_file() || written.iter().any(|file| file.path.starts_with(&prefix)),
            "{prefix} is written by nobody"
        );
    }
}

#[test]
fn help_names_every_subcommand_and_exit_code() {
    let help = stdout(&lumel(&["--help"]));
    for word in ["bake", "probe", "inspect", "130", "lux", "Examples"] {
        assert!(help.contains(word), "{word} is missing from:\n{help}");
    }
    let help = stdout(&lumel(&["bake", "--help"]));
    for option in [
        "--scene",
        "--threads",
        "--json",
        "--quiet",
        "--verbose",
        "-o <DIR>",
        "--preset",
        "--texels-per-metre",
        "--page",
        "--padding",
        "--uv",
        "--tolerance",
        "--refine",
        "--estimator",
        "--samples",
        "--directional",
        "--outputs",
        "--float",
        "lumel.json",
    ] {
        assert!(help.contains(option), "{option} is missing from:\n{help}");
    }
    let help = stdout(&lumel(&["probe", "--help"]));
    for word in ["--points", "x,y,z,nx,ny,nz", "jr_xy", "44"] {
        assert!(help.contains(word), "{word} is missing from:\n{help}");
    }
}

#[test]
fn wrong_use_is_exit_code_2() {
    for arguments in [
        &[] as &[&str],
        &["fry", "a.glb"],
        &["bake"],
        &["bake", "a.glb", "--sky-color", "1,2"],
        &["bake", "a.glb", "--outputs", "e,everything"],
        &["bake", "a.glb", "--refine", "everywhere"],
        &["bake", "a.glb", "--quiet", "--verbose"],
        &["probe", "a.glb"],
        &["probe", "a.glb", "--points", "a.csv", "--json"],
        &["probe", "a.glb", "--points", "a.txt"],
        &["probe", "a.glb", "--points", "a.csv", "-o", "a.txt"],
    ] {
        let output = lumel(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {output:?}");
        assert!(!output.stderr.is_empty(), "{arguments:?} says nothing");
    }
}

#[test]
fn values_out_of_range_name_option_range_and_value() {
    for (option, value, range) in [
        ("--texels-per-metre", "0", "0.001..=10000"),
        ("--texels-per-metre", "NaN", "0.001..=10000"),
        ("--texels-per-metre", "-1", "0.001..=10000"),
        ("--texels-per-metre", "inf", "0.001..=10000"),
        ("--tolerance", "2", "0.000001..=1"),
        ("--page", "63", "64..=16384"),
        ("--padding", "1.5", "2..=64"),
        ("--samples", "65537", "1..=65536"),
        ("--samples", "99999999999999999999", "1..=65536"),
        ("--threads", "0", "1..=1024"),
    ] {
        let output = lumel(&["bake", "a.glb", option, value]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{option} {value}: {message}");
        for part in [option, value, range] {
            assert!(message.contains(part), "{part} is missing from: {message}");
        }
    }
}

#[test]
fn a_missing_scene_is_exit_code_1_and_named() {
    for subcommand in ["bake", "inspect"] {
        let output = lumel(&[subcommand, "no/such/level.glb"]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(
            message.starts_with("error: ") && message.contains("level.glb"),
            "{message}"
        );
    }
    assert!(!Path::new("no").exists(), "a directory was made");
}

#[test]
fn mistakes_in_csv_points_name_their_line() {
    let header = "x,y,z,nx,ny,nz\n";
    for (text, place) in [
        (String::new(), "x,y,z,nx,ny,nz"),
        ("x,y,z\n0,0,0\n".to_owned(), "line 1"),
        ("# from Blender\n\n1,2,3,0,1,0\n".to_owned(), "line 3"),
        (format!("{header}0,0,0,0,1\n"), "line 2"),
        (format!("{header}0,0,0,0,1,0\n0,0,0,0,1,0,7\n"), "line 3"),
        (format!("{header}0,zero,0,0,1,0\n"), "y must be a number"),
        (format!("{header}\r\n0,0,0,0,1,\r\n"), "line 3"),
        (format!("{header}0,0,inf,0,1,0\n"), "line 2"),
        (format!("{header}0,0,0,0,NaN,0\n"), "line 2"),
        (format!("{header}0,0,0,0,0,-0\n"), "normal"),
        (format!("{header}0,0,0,0,1,0\n\u{e9}\n"), "line 3"),
    ] {
        refused("points.csv", text.as_bytes(), place);
    }
    refused("points.csv", b"x,y,z,nx,ny,nz\n0,\xff", "line 2");
}

#[test]
fn mistakes_in_npy_points_are_named_and_cost_nothing() {
    let zeros = |count: usize| vec![0_u8; count];
    let good = npy("<f8", false, "(2, 6)", &zeros(96));
    // Two points with zero normals: the shape is right, the normals are not.
    refused("points.npy", &good, "row 0");
    refused("points.npy", b"x,y,z,nx,ny,nz", "not a NumPy");
    refused("points.npy", &good[..7], "not a NumPy");
    refused("points.npy", &good[..40], "ends within its header");
    refused("points.npy", &good[..good.len() - 1], "95 bytes");
    for (dtype, shape, what) in [
        ("<f8", "(12,)", "(N, 6)"),
        ("<f8", "(6, 2)", "(N, 6)"),
        ("<f8", "(1, 2, 6)", "(N, 6)"),
        ("<i8", "(2, 6)", "f32 or f64"),
        ("<c16", "(1, 6)", "f32 or f64"),
        // More than any memory, more than 64 bits, and a product that wraps around to the true size.
        ("<f8", "(1000000000000000, 6)", "promises"),
        ("<f8", "(99999999999999999999999, 6)", "u64"),
        ("<f8", "(6148914691236517207, 6)", "promises"),
    ] {
        refused("points.npy", &npy(dtype, false, shape, &zeros(96)), what);
    }
    // A header of 4 GB, and brackets that would take its parser for ever.
    let mut forged = b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec();
    forged.extend(zeros(96));
    refused("points.npy", &forged, "4294967295 bytes");
    let nested = format!("{}6{}", "(".repeat(200), ")".repeat(200));
    refused(
        "points.npy",
        &npy("<f8", false, &nested, &zeros(96)),
        "plain array",
    );
}

#[test]
fn probe_gives_44_columns_and_a_row_per_point() {
    let folder = temporary();
    let points = folder.path().join("points.csv");
    fs::write(
        &points,
        "\u{feff}# light meter\r\nx, y, z, nx, ny, nz\r\n\r\n1.5,0,1.5,0,2,0\r\n 0 , 1 , 0 , 0 , 1e-200 , 0 \r\n1,1e-3,-1,0,-1,0\r\n",
    )
    .expect("a written file");
    let scene = support::fixture("contact/contact.gltf");
    let (scene, points) = (text(&scene), text(&points));

    let output = lumel(&["probe", &scene, "--points", &points, "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let printed = stdout(&output);
    assert_eq!(printed.lines().next(), Some(COLUMNS));
    let rows = numbers(&printed);
    assert_eq!(rows.len(), 3);
    assert!(rows.iter().all(|row| row.len() == 44));
    // The second point lies on the box, where nothing hides the light; the third one looks away from it.
    assert!(rows[1][0] > 0.0, "no light on the box");
    assert!(rows[2][0] == 0.0, "light from below the horizon");
    // E is G along the normal, and here the normal is Y.
    assert_eq!(rows[1][0].to_bits(), rows[1][4].to_bits());

    // The same numbers as a file, as text and as an array.
    let csv = folder.path().join("light.csv");
    let npy = folder.path().join("light.npy");
    for path in [&csv, &npy] {
        let output = lumel(&["probe", &scene, "--points", &points, "-o", &text(path)]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(output.stdout.is_empty());
    }
    assert_eq!(fs::read_to_string(csv).expect("a result"), printed);
    let npy_bytes = fs::read(npy).expect("a result");
    let array = npyz::NpyFile::new(&npy_bytes[..]).expect("an array");
    assert_eq!(array.shape(), [3, 44]);
    let stored: Vec<f64> = array.into_vec().expect("numbers");
    let bits = |numbers: &[f64]| numbers.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
    for (stored, read) in stored.chunks(44).zip(&rows) {
        // NaN has many bit patterns and one meaning.
        let known = |numbers: &[f64]| {
            bits(
                &numbers
                    .iter()
                    .map(|n| if n.is_nan() { f64::NAN } else { *n })
                    .collect::<Vec<_>>(),
            )
        };
        assert_eq!(known(stored), known(read));
    }
}

#[test]
fn column_jr_xy_is_the_change_of_gr_x_along_y() {
    const STEP: f64 = 1e-3;
    // Below the light and beside the box, where nothing hides the light: first the point, then a step to and fro along each axis.
    let centre = [1.5, 2.0, 1.2];
    let mut points = vec![centre];
    for axis in 0..3 {
        for step in [-STEP, STEP] {
            let mut point = centre;
            point[axis] += step;
            points.push(point);
        }
    }
    let rows: Vec<String> = points
        .iter()
        .map(|[x, y, z]| format!("{x},{y},{z},0,1,0"))
        .collect();
    let rows = rows.join("\n");
    let folder = temporary();
    let file = folder.path().join("points.csv");
    fs::write(&file, format!("x,y,z,nx,ny,nz\n{rows}\n")).expect("a written file");
    let scene = text(&support::fixture("contact/contact.gltf"));
    let output = lumel(&["probe", &scene, "--points", &text(&file), "--quiet"]);
    let rows = numbers(&stdout(&output));

    let column = |name: &str| {
        COLUMNS
            .split(',')
            .position(|column| column == name)
            .expect("a column")
    };
    for (i, component) in ["x", "y", "z"].into_iter().enumerate() {
        for (k, along) in ["x", "y", "z"].into_iter().enumerate() {
            let stored = rows[0][column(&format!("jr_{component}{along}"))];
            let g = column("gr_x") + i;
            let difference = (rows[2 + 2 * k][g] - rows[1 + 2 * k][g]) / (2.0 * STEP);
            // G is 36 lux and falls with the square of about a metre, so its third derivative is about 24 · 36 lux/m³, and the
            // difference is off by h²/6 of that, 1.4e-4. Entries that could be mistaken for each other differ by 16.
            assert!(
                (stored - difference).abs() < 1e-3,
                "jr_{component}{along} is {stored}, the light changes by {difference}"
            );
        }
    }
}

#[test]
fn points_mean_the_same_in_every_layout() {
    let folder = temporary();
    let scene = text(&support::fixture("contact/contact.gltf"));
    // Numbers that f32 holds exactly.
    let rows = [
        [1.5, 0.0, 1.25, 0.0, 1.0, 0.0],
        [-0.75, 0.5, 0.25, -1.0, 0.0, 0.0],
    ];
    let by_rows: Vec<f64> = rows.iter().flatten().copied().collect();
    let by_columns: Vec<f64> = (0..6)
        .flat_map(|column| rows.map(|row| row[column]))
        .collect();
    let little = |numbers: &[f64]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
    let big = |numbers: &[f64]| numbers.iter().flat_map(|n| n.to_be_bytes()).collect();
    let single = |numbers: &[f64]| {
        let bytes = numbers.iter().flat_map(|n| (*n as f32).to_be_bytes());
        bytes.collect::<Vec<u8>>()
    };
    let csv: String = rows
        .map(|row| row.map(|number| number.to_string()).join(",") + "\n")
        .concat();
    let layouts: [(&str, Vec<u8>); 5] = [
        ("a.csv", format!("x,y,z,nx,ny,nz\n{csv}").into_bytes()),
        (
            "b.npy",
            npy("<f8", false, "(2, 6)", &little(&by_rows) as &Vec<u8>),
        ),
        (
            "c.npy",
            npy("<f8", true, "(2, 6)", &little(&by_columns) as &Vec<u8>),
        ),
        (
            "d.npy",
            npy(">f8", false, "(2, 6)", &big(&by_rows) as &Vec<u8>),
        ),
        ("e.npy", npy(">f4", true, "(2, 6)", &single(&by_columns))),
    ];
    let mut results = layouts.iter().map(|(name, bytes)| {
        let points = folder.path().join(name);
        fs::write(&points, bytes).expect("a written file");
        let output = lumel(&["probe", &scene, "--points", &text(&points), "--quiet"]);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        stdout(&output)
    });
    let first = results.next().expect("five layouts");
    for (result, (name, _)) in results.zip(&layouts[1..]) {
        assert_eq!(result, first, "{name}");
    }
}

#[test]
fn a_bake_goes_beside_the_scene_unless_told_otherwise() {
    let folder = temporary();
    let scene = folder.path().join("box of light.gltf");
    fs::copy(support::fixture("contact/contact.gltf"), &scene).expect("a copy");
    let output = lumel(&[&["bake", &text(&scene), "--json"], &QUICK[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let report: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let directory = folder.path().join("box of light.lumel");
    assert_eq!(report["directory"], text(&directory));
    let listed: Vec<&str> = report["files"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(Value::as_str)
        .collect();
    assert_eq!(listed, names(&directory));
    for file in [
        "box of light.glb",
        "box of light.lumel.json",
        "box of light_lm0_E.exr",
        "box of light_lm0_preview.png",
    ] {
        assert!(listed.contains(&file), "{file} is not among {listed:?}");
    }
    assert_eq!(names(folder.path()).len(), 2, "something else was left");
}

#[test]
fn explicit_options_win_over_the_preset() {
    let folder = temporary();
    let scene = text(&support::fixture("contact/contact.gltf"));
    let manifest = |arguments: &[&str]| {
        let directory = text(&folder.path().join("out"));
        let fixed = ["bake", &scene, "-o", &directory, "--outputs", "e", "--json"];
        let output = lumel(&[&fixed[..], arguments].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let mut report: Value = serde_json::from_slice(&output.stdout).expect("a JSON object");
        report["manifest"]["options"].take()
    };
    let options = manifest(&["--preset", "draft"]);
    assert_eq!(options["texels-per-metre"], 4.0);
    assert_eq!(options["samples"], 16);
    assert_eq!(options["tolerance"], 0.016);
    let options = manifest(&["--samples", "2", "--preset", "draft"]);
    assert_eq!(options["texels-per-metre"], 4.0);
    assert_eq!(options["samples"], 2);
}

#[test]
fn threads_do_not_change_a_byte() {
    let folder = temporary();
    let scene = text(&support::fixture("room/room.gltf"));
    let bake = |name: &str, threads: &str| {
        let directory = folder.path().join(name);
        let arguments = [
            "bake",
            &scene,
            "-o",
            &text(&directory),
            "--threads",
            threads,
        ];
        let output = lumel(&[&arguments[..], &QUICK].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        contents(&directory)
    };
    let one = bake("one", "1");
    let two = bake("two", "2");
    assert!(one.len() > 5, "too few files: {}", one.len());
    for (first, second) in one.iter().zip(&two) {
        assert_eq!(first.0, second.0);
        assert!(first.1 == second.1, "{} differs", first.0);
    }
    assert_eq!(one.len(), two.len());
}

#[test]
fn quiet_says_nothing_and_json_one_object() {
    let folder = temporary();
    let scene = text(&support::fixture("contact/contact.gltf"));
    let directory = text(&folder.path().join("out"));
    let output = lumel(&[&["bake", &scene, "-o", &directory, "--quiet"], &QUICK[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(
        output.stdout.is_empty() && output.stderr.is_empty(),
        "{output:?}"
    );

    let output = lumel(&["inspect", &scene, "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let inspection: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    for key in ["scene", "warnings", "lights", "atlas", "plan", "memory"] {
        assert!(!inspection[key].is_null(), "{key} is missing");
    }
    let told = stdout(&lumel(&["inspect", &scene]));
    for word in ["triangles", "lights", "page", "leaves out", "MB"] {
        assert!(told.contains(word), "{word} is missing from:\n{told}");
    }
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let scene = text(&support::fixture("contact/contact.gltf"));
    let mut child = Command::new(env!("CARGO_BIN_EXE_lumel"))
        .args(["inspect", &scene])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("the command ends");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_the_last_good_bake() {
    let folder = temporary();
    let directory = folder.path().join("out");
    let target = text(&directory);
    let scene = text(&support::fixture("penumbra/penumbra.gltf"));
    let output = lumel(&[&["bake", &scene, "-o", &target], &QUICK[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let good = contents(&directory);

    // Hours of rays.
    let mut child = Command::new(env!("CARGO_BIN_EXE_lumel"))
        .args(["bake", &scene, "-o", &target])
        .args(["--texels-per-metre", "16", "--samples", "65536"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command starts");
    // The bake has come to the light when its temporary folder is there, in or beside the directory.
    wait(&mut child, |child| {
        assert!(
            child.try_wait().expect("a child").is_none(),
            "the bake ended before it could be interrupted"
        );
        names(folder.path()).len() + names(&directory).len() > 1 + good.len()
    });
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .expect("kill runs");
    assert!(killed.success());
    wait(&mut child, |child| {
        child.try_wait().expect("a child").is_some()
    });
    let output = child.wait_with_output().expect("the command ends");
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("interrupted; the previous bake is untouched"),
        "{}",
        stderr(&output)
    );
    assert!(contents(&directory) == good, "the last good bake changed");
    assert_eq!(names(folder.path()), ["out"], "something was left behind");
}

/// Waits until `reached`; ends the child and fails when that is not within minutes, so that a hang does not outlive the test.
#[cfg(unix)]
fn wait(child: &mut Child, mut reached: impl FnMut(&mut Child) -> bool) {
    for _ in 0..15_000 {
        if reached(child) {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().expect("a child");
    panic!("nothing happened for five minutes");
}

/// Runs the command to its end.
fn lumel(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumel"))
        .args(arguments)
        .output()
        .expect("the command starts")
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(path: &Path) -> String {
    path.to_str().expect("a path in UTF-8").to_owned()
}

/// The rows of a result in CSV.
fn numbers(csv: &str) -> Vec<Vec<f64>> {
    let rows = csv.lines().skip(1).map(|line| line.split(','));
    rows.map(|row| {
        row.map(|number| number.parse().expect("a number"))
            .collect()
    })
    .collect()
}

fn temporary() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Probes with a points file of that content; it must be refused with exit code 1 and a message that names the file and `what`.
fn refused(name: &str, content: &[u8], what: &str) {
    let folder = temporary();
    let points: PathBuf = folder.path().join(name);
    fs::write(&points, content).expect("a written file");
    let result = folder.path().join("result.csv");
    let output = lumel(&[
        "probe",
        &text(&support::fixture("contact/contact.gltf")),
        "--points",
        &text(&points),
        "-o",
        &text(&result),
    ]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{what}: {message}");
    assert!(
        message.starts_with("error: ") && message.contains(name) && message.contains(what),
        "'{what}' is missing from: {message}"
    );
    assert_eq!(names(folder.path()), [name], "something was left behind");
}

/// A `NumPy` file, version 1, with a header as `NumPy` writes it.
fn npy(dtype: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let mut header =
        format!("{{'descr': '{dtype}', 'fortran_order': {order}, 'shape': {shape}, }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .expect("a folder")
        .map(|entry| entry.expect("a readable entry"))
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// Names and bytes of the files in a folder, sorted by name.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    names(folder)
        .into_iter()
        .map(|name| {
            let bytes = fs::read(folder.join(&name)).expect("a file");
            (name, bytes)
        })
        .collect()
}

fn pixels(png: &[u8]) -> image::RgbImage {
    image::load_from_memory(png).expect("a picture").to_rgb8()
}

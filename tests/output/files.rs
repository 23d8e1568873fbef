//! When files appear, stay and go.

use std::fs;
use std::path::Path;

use lumel::output::{Options, Writer};
use lumel::{Error, refine::Field};
use serde_json::{Value, json};

use crate::output::maps;

fn writer(directory: &Path) -> Writer {
    Writer::create(directory, "level", &Options::default()).expect("writable")
}

/// A field with the plane E alone, or with all planes.
fn field(all: bool) -> Field {
    let mut field = maps::field(1, 24, 16, 10.0);
    if !all {
        field.planes.truncate(1);
    }
    field
}

/// Bakes `pages` pages into `directory`.
fn bake(directory: &Path, pages: usize, all: bool) -> Vec<String> {
    let mut writer = writer(directory);
    for index in 0..pages {
        writer.page(index, &field(all)).expect("written");
    }
    writer.manifest(&json!({"version": 1})).expect("written");
    writer.commit().expect("committed")
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .expect("readable folder")
        .map(|entry| {
            entry
                .expect("readable entry")
                .file_name()
                .into_string()
                .expect("UTF-8")
        })
        .collect();
    names.sort();
    names
}

fn manifest(directory: &Path) -> Value {
    let text = fs::read(directory.join("level.lumel.json")).expect("readable");
    serde_json::from_slice(&text).expect("JSON")
}

#[test]
fn nothing_appears_before_the_commit() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let target = folder.path().join("new/deep/out");
    let mut writer = writer(&target);
    writer.page(0, &field(true)).expect("written");
    writer.manifest(&json!({})).expect("written");
    assert!(!folder.path().join("new").exists());
    let files = writer.commit().expect("committed");
    assert_eq!(names(&target), files);
    assert_eq!(names(folder.path()), ["new"], "no temporary folder is left");
}

#[test]
fn a_dropped_bake_leaves_the_last_one() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let files = bake(folder.path(), 2, true);
    let before: Vec<Vec<u8>> = files
        .iter()
        .map(|file| fs::read(folder.path().join(file)).expect("readable"))
        .collect();
    let mut writer = writer(folder.path());
    let other = maps::field(99, 24, 16, 50.0);
    writer.page(0, &other).expect("written");
    writer.manifest(&json!({})).expect("written");
    drop(writer);
    assert_eq!(names(folder.path()), files);
    for (file, before) in files.iter().zip(before) {
        let after = fs::read(folder.path().join(file)).expect("readable");
        assert!(after == before, "{file} has changed");
    }
}

#[test]
fn a_bake_removes_what_the_last_one_left_and_nothing_else() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let first = bake(folder.path(), 3, true);
    assert_eq!(first.len(), 3 * 7 + 1);
    for other in [
        "notes.txt",
        "other_lm0_E.exr",
        "level_lm7_E.exr",
        "level.gltf",
    ] {
        fs::write(folder.path().join(other), "mine").expect("written");
    }
    let second = bake(folder.path(), 1, false);
    assert_eq!(
        second,
        [
            "level.lumel.json",
            "level_lm0_E.exr",
            "level_lm0_preview.png"
        ]
    );
    let mut want = second.clone();
    let others = [
        "notes.txt",
        "other_lm0_E.exr",
        "level_lm7_E.exr",
        "level.gltf",
    ];
    want.extend(others.map(str::to_owned));
    want.sort();
    assert_eq!(names(folder.path()), want);
    assert_eq!(manifest(folder.path())["files"], json!(second));
    assert_eq!(manifest(folder.path())["version"], 1);
}

#[test]
fn a_forged_manifest_removes_nothing_of_others() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let target = folder.path().join("out");
    fs::create_dir_all(target.join("level_lm1_E.exr")).expect("a folder with the name of a map");
    let outside = folder.path().join("level_lm0_E.exr");
    fs::write(&outside, "mine").expect("written");
    fs::write(target.join("letter.txt"), "mine").expect("written");
    fs::write(target.join("stranger_lm0_E.exr"), "mine").expect("written");
    let forged = json!({"files": [
        "../level_lm0_E.exr",
        outside.to_str(),
        "level_lm0_../../level_lm0_E.exr",
        "letter.txt",
        "stranger_lm0_E.exr",
        "level_lm1_E.exr",
        "..", "", ".", 7, null, {"a": []},
    ]});
    fs::write(target.join("level.lumel.json"), forged.to_string()).expect("written");
    bake(&target, 1, false);
    assert!(outside.is_file());
    assert!(target.join("letter.txt").is_file());
    assert!(target.join("stranger_lm0_E.exr").is_file());
    assert!(target.join("level_lm1_E.exr").is_dir());

    for broken in ["", "[]", "{\"files\": 3}", "\u{0}"] {
        fs::write(target.join("level.lumel.json"), broken).expect("written");
        bake(&target, 1, false);
    }
}

#[test]
fn a_file_in_the_way_is_an_error_with_its_path() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("file");
    fs::write(&file, "mine").expect("written");
    for target in [file.clone(), file.join("below"), file.join("below/that")] {
        match Writer::create(&target, "level", &Options::default()) {
            Err(Error::Io { path, .. }) => assert!(path.starts_with(&file), "{}", path.display()),
            other => panic!("{}: {other:?}", target.display()),
        }
    }

    // A folder under the name of a map is noticed before anything is replaced.
    let target = folder.path().join("out");
    bake(&target, 1, false);
    let before = fs::read(target.join("level_lm0_E.exr")).expect("readable");
    fs::create_dir(target.join("level_lm0_phi.exr")).expect("made");
    let mut writer = writer(&target);
    writer
        .page(0, &maps::field(7, 24, 16, 10.0))
        .expect("written");
    match writer.commit() {
        Err(Error::Io { path, .. }) => assert_eq!(path, target.join("level_lm0_phi.exr")),
        other => panic!("{other:?}"),
    }
    let after = fs::read(target.join("level_lm0_E.exr")).expect("readable");
    assert!(before == after, "half a bake was committed");
}

#[test]
fn a_page_is_written_once() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let mut writer = writer(folder.path());
    writer.page(0, &field(false)).expect("written");
    assert!(matches!(
        writer.page(0, &field(false)),
        Err(Error::Io { .. })
    ));
}

#[test]
fn any_scene_name_becomes_a_file_name() {
    for name in ["a/b", "..", "", "Unicode❤♻Test", "with space", "C:\\level"] {
        let folder = tempfile::tempdir().expect("temporary folder");
        let target = folder.path().join("out");
        let mut writer = Writer::create(&target, name, &Options::default()).expect("writable");
        writer.page(0, &field(false)).expect("written");
        writer.manifest(&json!({})).expect("written");
        let files = writer.commit().expect("committed");
        assert_eq!(names(&target), files, "{name}");
        assert_eq!(files.len(), 3, "{name}");
    }
}

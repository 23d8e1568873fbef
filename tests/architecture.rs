//! The shape of the source tree: who may name whom, and what must be absent.
//!
//! Read as text, not as syntax: a path built by a macro would escape. That is enough among people who mean well.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support;

/// A folder or file directly below `src`, and the stages it may name. Light flows down this table.
const STAGES: &[(&str, &[&str])] = &[
    ("scene", &[]),
    ("atlas", &["scene"]),
    ("texels", &["scene", "atlas"]),
    ("lights", &["scene"]),
    ("visibility", &["scene"]),
    ("transport", &["texels", "lights", "visibility"]),
    // Its samples come from a closure.
    ("refine", &[]),
    ("output", &["scene", "atlas", "texels", "refine"]),
    ("runtime", &[]),
];

/// What everyone may name, and what names no stage itself.
const GROUND: &[&str] = &["math", "error"];

/// Where the stages meet.
const JOINTS: &[&str] = &["lib", "bake", "bin"];

/// Dependencies that are hidden behind a stage, so that replacing one is one stage's work.
const HIDDEN_CRATES: &[(&str, &[&str])] = &[
    ("gltf", &["scene", "output"]),
    ("xatlas_rs", &["atlas"]),
    ("guillotiere", &["atlas"]),
    ("obvhs", &["visibility"]),
    ("spade", &["refine"]),
    ("exr", &["scene", "output"]),
    ("image", &["scene", "output"]),
    ("tempfile", &["output", "bin"]),
    ("npyz", &["bin"]),
    ("clap", &["bin"]),
    ("indicatif", &["bin"]),
    ("ctrlc", &["bin"]),
    ("tiny_http", &["bin"]),
];

#[test]
fn every_module_is_in_the_table() {
    for source in sources() {
        let known = STAGES.iter().map(|(stage, _)| *stage);
        assert!(
            known
                .chain(GROUND.iter().copied())
                .chain(JOINTS.iter().copied())
                .any(|module| module == source.module),
            "{} belongs to no stage; is there a folder whose purpose nobody could name?",
            source.path.display()
        );
    }
}

#[test]
fn stages_name_only_what_lies_before_them() {
    for source in sources() {
        // Unit tests in a file of their own put whole scenes together.
        let is_test = source.path.ends_with("tests.rs");
        if JOINTS.contains(&source.module.as_str()) || is_test {
            continue;
        }
        let allowed = STAGES
            .iter()
            .find(|(stage, _)| *stage == source.module)
            .map_or(&[] as &[&str], |(_, allowed)| allowed);
        for named in segments_after(&source.code, "crate") {
            assert!(
                named == source.module
                    || allowed.contains(&named)
                    || GROUND.contains(&named) && !GROUND.contains(&source.module.as_str())
                    || named == "Error"
                    || named == "Result",
                "{}: `{}` must not name `crate::{named}`",
                source.path.display(),
                source.module
            );
        }
        for detour in ["super::super", "crate::{"] {
            assert!(
                !source.code.contains(detour),
                "{}: `{detour}` hides who is named",
                source.path.display()
            );
        }
    }
}

#[test]
fn dependencies_stay_behind_their_stage() {
    for source in sources() {
        for (dependency, stages) in HIDDEN_CRATES {
            assert!(
                stages.contains(&source.module.as_str())
                    || segments_after(&source.code, dependency).next().is_none(),
                "{}: only {stages:?} may know `{dependency}`",
                source.path.display()
            );
        }
    }
}

#[test]
fn only_scene_output_and_the_command_touch_the_disk() {
    for source in sources() {
        if ["scene", "output", "bin"].contains(&source.module.as_str()) {
            continue;
        }
        for word in ["std::fs", "fs::", "File::", "std::env::", "env::var"] {
            assert!(
                !source.code.contains(word),
                "{}: `{word}` in a stage that should be a function of its arguments",
                source.path.display()
            );
        }
    }
}

#[test]
fn the_library_never_prints_and_never_gives_up() {
    for source in sources() {
        if source.module == "bin" {
            continue;
        }
        for word in [
            "println!",
            "print!",
            "dbg!",
            "stdout()",
            "stderr()",
            "panic!",
            "todo!",
            "unimplemented!",
            ".unwrap()",
            "process::exit",
        ] {
            assert!(
                !source.code.contains(word),
                "{}: `{word}`",
                source.path.display()
            );
        }
    }
}

#[test]
fn every_file_opens_with_its_purpose() {
    let folders = ["src", "tests", "examples", "benches"];
    for path in folders.iter().flat_map(|folder| rust_files(folder)) {
        let text = fs::read_to_string(&path).expect("a source file");
        let purpose = text.lines().next().unwrap_or_default();
        assert!(
            purpose.starts_with("//! ") && purpose.len() > "//! stub".len(),
            "{} does not open with what it is for",
            path.display()
        );
    }
}

#[test]
fn the_reader_of_sources_sees_paths_and_no_comments() {
    let code = code_of(
        "//! use crate::a;\nuse crate::b::c; // crate::d\n    crate::e::f();\nlet g = mycrate::h();\nmod tests {\n crate::i",
    );
    let named: Vec<&str> = segments_after(&code, "crate").collect();
    assert_eq!(named, ["b", "e"]);
}

/// A file below `src`.
struct Source {
    path: PathBuf,
    /// First name below `src`: `src/transport/contour.rs` belongs to `transport`, `src/error.rs` to `error`.
    module: String,
    /// Its text without comments and unit tests.
    code: String,
}

fn sources() -> Vec<Source> {
    let root = support::root().join("src");
    let sources: Vec<Source> = rust_files("src")
        .into_iter()
        .map(|path| {
            let below = path.strip_prefix(&root).expect("a path below src");
            let first = below.iter().next().expect("a name");
            Source {
                module: Path::new(first)
                    .file_stem()
                    .expect("a name")
                    .to_string_lossy()
                    .into_owned(),
                code: code_of(&fs::read_to_string(&path).expect("a source file")),
                path,
            }
        })
        .collect();
    assert!(sources.len() > 20, "only {} files found", sources.len());
    sources
}

fn rust_files(folder: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![support::root().join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// `text` up to its unit tests, without comments. A comment behind code is one after a space, which spares `https://`.
fn code_of(text: &str) -> String {
    text.lines()
        .take_while(|line| !line.starts_with("mod tests {"))
        .filter(|line| !line.trim_start().starts_with("//"))
        .map(|line| line.split(" //").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// The names that follow `root::` where `root` is a whole path segment at the beginning of a path.
fn segments_after<'a>(code: &'a str, root: &'a str) -> impl Iterator<Item = &'a str> {
    let in_name = |c: char| c.is_alphanumeric() || c == '_';
    code.match_indices(root)
        .filter(move |(start, _)| !code[..*start].ends_with(|c: char| in_name(c) || c == ':'))
        .filter_map(move |(start, _)| code[start + root.len()..].strip_prefix("::"))
        .map(move |rest| rest.split(|c: char| !in_name(c)).next().unwrap_or_default())
}

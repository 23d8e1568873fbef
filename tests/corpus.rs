//! Scenes by others: levels, models, conformance files, broken files. Skipped where they are not at hand.

/// Reading them.
#[expect(
    clippy::print_stdout,
    reason = "says what was skipped and how much was read"
)]
mod loading {
    use std::fs;
    use std::panic;
    use std::path::{Path, PathBuf};

    use lumel::Error;
    use lumel::scene::{Options, Scene};

    use crate::support;

    /// Folders of scenes that are whole.
    const WHOLE: &[&str] = &["levels", "models", "cornell", "lights", "khronos"];

    #[test]
    fn whole_scenes_load_with_the_triangles_their_table_says() {
        let Some(folder) = support::shared_scenes() else {
            println!("skipped: no shared scenes");
            return;
        };
        let table = fs::read_to_string(folder.join("README.md")).expect("readable table");
        let mut faults = Vec::new();
        for kind in WHOLE {
            let mut n_loaded = 0;
            let mut n_unsupported = 0;
            for file in documents(&folder.join(kind)) {
                let name = file.strip_prefix(&folder).expect("below").to_owned();
                match open(&file) {
                    Ok(Ok(scene)) => {
                        n_loaded += 1;
                        faults.extend(
                            broken_promises(&scene)
                                .iter()
                                .map(|it| format!("{}: {it}", file.display())),
                        );
                        faults.extend(miscount(&scene, &table, &name));
                    }
                    Ok(Err(Error::Unsupported { feature, .. }))
                        if feature == "KHR_draco_mesh_compression" =>
                    {
                        n_unsupported += 1;
                    }
                    Ok(Err(error)) => faults.push(error.to_string()),
                    Err(_) => faults.push(format!("{}: panic", name.display())),
                }
            }
            println!("{kind}: {n_loaded} loaded, {n_unsupported} compressed");
            assert!(n_loaded > 0, "nothing in {kind}");
        }
        assert!(faults.is_empty(), "{}", faults.join("\n"));
    }

    #[test]
    fn broken_files_load_or_say_what_is_wrong() {
        let Some(folder) = support::shared_scenes() else {
            println!("skipped: no shared scenes");
            return;
        };
        let (mut n_loaded, mut n_warned, mut n_refused) = (0, 0, 0);
        let mut faults = Vec::new();
        for file in documents(&folder.join("malformed")) {
            match open(&file) {
                Ok(Ok(scene)) if scene.warnings.is_empty() => n_loaded += 1,
                Ok(Ok(scene)) => {
                    n_warned += 1;
                    faults.extend(
                        broken_promises(&scene)
                            .iter()
                            .map(|it| format!("{}: {it}", file.display())),
                    );
                }
                Ok(Err(error)) => {
                    n_refused += 1;
                    let excused = REFUSED_THOUGH_VALID.iter().any(|name| file.ends_with(name));
                    if is_clean(&file) && !excused {
                        faults.push(format!("refused though valid: {error}"));
                    }
                }
                Err(_) => faults.push(format!("{}: panic", file.display())),
            }
        }
        println!("{n_loaded} loaded, {n_warned} with warnings, {n_refused} refused");
        assert!(faults.is_empty(), "{}", faults.join("\n"));
    }

    /// Files without errors in the eyes of the validator that cannot be read all the same: two have a buffer without bytes, one has it on the
    /// net, one asks for a later glTF.
    const REFUSED_THOUGH_VALID: &[&str] = &[
        "root/named_objects.gltf",
        "root/unused_objects.gltf",
        "buffer/non_relative_uri.gltf",
        "asset/min_version_valid.gltf",
    ];

    /// Whether the report beside `file` counts no errors.
    fn is_clean(file: &Path) -> bool {
        let report = PathBuf::from(format!("{}.report.json", file.display()));
        fs::read(report).is_ok_and(|bytes| {
            let report: serde_json::Value = serde_json::from_slice(&bytes).expect("a report");
            report["issues"]["numErrors"] == 0
        })
    }

    fn open(file: &Path) -> std::thread::Result<lumel::Result<Scene>> {
        panic::catch_unwind(|| Scene::open(file, &Options::default()))
    }

    /// Promises of [`Scene`] that `scene` breaks.
    fn broken_promises(scene: &Scene) -> Vec<String> {
        let mut doubts = Vec::new();
        for (index, triangle) in scene.triangles.iter().enumerate() {
            let primitive = &scene.meshes[scene.instances[triangle.instance as usize].mesh]
                .primitives[triangle.primitive as usize];
            let finite = triangle.vertices.iter().all(|vertex| vertex.is_finite());
            let in_range = triangle
                .corners
                .iter()
                .all(|corner| (*corner as usize) < primitive.positions.len());
            let area = triangle.area_vector().length();
            if !finite || !in_range || area.is_nan() || area <= 0.0 {
                doubts.push(format!("triangle {index}: {triangle:?}"));
            }
        }
        for mesh in &scene.meshes {
            for primitive in &mesh.primitives {
                let n_vertices = primitive.positions.len();
                let fits = |n_values: usize| n_values == 0 || n_values == n_vertices;
                let sizes = fits(primitive.normals.len())
                    && fits(primitive.vertex_alpha.len())
                    && primitive.texcoords.iter().all(|set| fits(set.len()));
                let finite = primitive.positions.iter().all(|it| it.is_finite())
                    && primitive.normals.iter().all(|it| it.is_normalized())
                    && primitive
                        .texcoords
                        .iter()
                        .flatten()
                        .all(|it| it.is_finite());
                if !sizes || !finite {
                    doubts.push(format!("{} primitive {}", mesh.name, primitive.source));
                }
            }
        }
        for index in (0..scene.triangles.len()).step_by(1 + scene.triangles.len() / 100) {
            let weights = [0.25, 0.25, 0.5];
            let emission = scene.emission(index as u32, weights);
            let alpha = scene.alpha(index as u32, weights);
            if !emission.is_finite()
                || emission.min_element() < 0.0
                || !(0.0..=1.0).contains(&alpha)
            {
                doubts.push(format!(
                    "triangle {index}: emission {emission}, alpha {alpha}"
                ));
            }
        }
        doubts
    }

    /// Complains when the triangles are fewer than the table's without its zero-area ones, or more than all of them. Copies of
    /// `EXT_mesh_gpu_instancing` count once in the table.
    fn miscount(scene: &Scene, table: &str, name: &Path) -> Option<String> {
        let row = table
            .lines()
            .find(|line| line.starts_with(&format!("| `{}`", name.display())))?;
        let column: Vec<&str> = row.split(" | ").collect();
        let n_all: usize = column[3].replace(',', "").parse().expect("a number");
        let n_flat: usize = column[6]
            .split('/')
            .next()
            .and_then(|flat| flat.trim().parse().ok())
            .unwrap_or(0);
        let n_loaded = scene
            .triangles
            .iter()
            .filter(|triangle| {
                scene.instances[triangle.instance as usize]
                    .copy
                    .unwrap_or(0)
                    == 0
            })
            .count();
        (n_loaded > n_all || n_loaded + n_flat < n_all).then(|| {
            format!(
                "{}: {n_loaded} triangles, the table says {n_all} of which {n_flat} without area",
                name.display()
            )
        })
    }

    /// All documents below `folder`, sorted.
    fn documents(folder: &Path) -> Vec<PathBuf> {
        let mut folders = vec![folder.to_owned()];
        let mut files = Vec::new();
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("readable folder") {
                let path = entry.expect("readable entry").path();
                if path.is_dir() {
                    folders.push(path);
                } else if path
                    .extension()
                    .is_some_and(|extension| extension == "gltf" || extension == "glb")
                {
                    files.push(path);
                }
            }
        }
        files.sort();
        files
    }
}

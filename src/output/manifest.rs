//! The list of files that a bake leaves, kept in its manifest under the key `files`, and what it says about the bake before.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::output::names;

/// Key of the manifest that lists every file of the bake, the manifest included.
pub(super) const FILES: &str = "files";

/// Files in `directory` that the previous bake of `scene` lists and that could be its work, sorted.
///
/// The list is somebody's text file by now: a name counts only when it is a plain name of our own pattern and belongs to a regular
/// file. A manifest that is missing or broken lists nothing.
pub(super) fn previous(directory: &Path, scene: &str) -> BTreeSet<String> {
    let Ok(text) = fs::read(directory.join(names::manifest(scene))) else {
        return BTreeSet::new();
    };
    let Ok(manifest) = serde_json::from_slice::<Value>(&text) else {
        return BTreeSet::new();
    };
    let listed = manifest.get(FILES).and_then(Value::as_array);
    listed
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .filter(|file| names::is_ours(file, scene))
        .filter(|file| {
            fs::symlink_metadata(directory.join(file)).is_ok_and(|found| found.is_file())
        })
        .map(str::to_owned)
        .collect()
}

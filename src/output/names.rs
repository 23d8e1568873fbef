//! What the files of a bake are called.
//!
//! `<scene>_lm<page>_<plane>.exr`, `<scene>_lm<page>_light.ktx2`, `<scene>_lm<page>_preview.png`, `<scene>.glb`, `<scene>.lumel.json`. The scene's part is made safe
//! for every common file system, so that a bake can be moved between machines; everything else is plain ASCII.

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};

/// Longest scene part in bytes. File systems allow 255 bytes per name; the longest suffix (`_lm9999999999_Gr_du.exr`) and the
/// temporary names of other programs must fit behind it. Shorter would cut authored names for no gain.
const MAX_BYTES: usize = 200;

/// Characters that some file system forbids, besides control characters.
const FORBIDDEN: &str = "/\\:*?\"<>|";

/// Names of devices that Windows does not let a file have, whatever its extension.
const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];

/// What a URI segment may hold unescaped (RFC 3986 §2.3).
const SEGMENT: &AsciiSet = &NON_ALPHANUMERIC
    .remove(b'-')
    .remove(b'.')
    .remove(b'_')
    .remove(b'~');

/// The scene's part of file names: `name` with forbidden characters replaced by `_`, never empty, never hidden, at most 200 bytes.
/// Letters of any script are kept.
pub(super) fn safe(name: &str) -> String {
    let mut safe: String = name
        .chars()
        .map(|c| {
            if c.is_control() || FORBIDDEN.contains(c) {
                '_'
            } else {
                c
            }
        })
        .collect();
    while safe.len() > MAX_BYTES {
        safe.pop();
    }
    // Windows drops trailing dots and spaces, which would make two names one.
    let kept = safe.trim_end_matches(['.', ' ']).len();
    safe.truncate(kept);
    if safe.is_empty() {
        "scene".to_owned()
    } else if safe.starts_with('.') || is_device(&safe) {
        format!("_{safe}")
    } else {
        safe
    }
}

/// Name of the map of `plane` on `page`.
pub(super) fn map(scene: &str, page: usize, plane: &str) -> String {
    format!("{scene}_lm{page}_{plane}.exr")
}

/// Name of the texture of `page`.
pub(super) fn texture(scene: &str, page: usize) -> String {
    format!("{scene}_lm{page}_light.ktx2")
}

/// Name of the picture `name` of `page`.
pub(super) fn picture(scene: &str, page: usize, name: &str) -> String {
    format!("{scene}_lm{page}_{name}.png")
}

/// Name of the preview of `page`.
pub(super) fn preview(scene: &str, page: usize) -> String {
    picture(scene, page, "preview")
}

/// Name of the glTF file.
pub(super) fn glb(scene: &str) -> String {
    format!("{scene}.glb")
}

/// Name of the manifest.
pub(super) fn manifest(scene: &str) -> String {
    format!("{scene}.lumel.json")
}

/// Whether `file` could be a map, a preview or the glTF file of a bake of `scene`. Such a name is always a plain file name.
pub(super) fn is_ours(file: &str, scene: &str) -> bool {
    let Some(rest) = file.strip_prefix(scene) else {
        return false;
    };
    if rest == ".glb" {
        return true;
    }
    let Some((page, plane)) = rest
        .strip_prefix("_lm")
        .and_then(|rest| rest.split_once('_'))
    else {
        return false;
    };
    let plane = plane
        .strip_suffix(".exr")
        .or_else(|| plane.strip_suffix(".png"))
        .or_else(|| plane.strip_suffix(".ktx2"));
    let word = |text: &str| {
        !text.is_empty()
            && text
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    !page.is_empty() && page.bytes().all(|byte| byte.is_ascii_digit()) && plane.is_some_and(word)
}

/// `file` as a relative URI reference.
pub(super) fn uri(file: &str) -> String {
    utf8_percent_encode(file, SEGMENT).to_string()
}

/// Whether Windows takes `name`, extension aside, for a device.
fn is_device(name: &str) -> bool {
    let stem = name.split('.').next().unwrap_or(name).to_ascii_lowercase();
    let numbered = ["com", "lpt"].iter().any(|port| {
        stem.strip_prefix(port)
            .is_some_and(|digit| digit.len() == 1 && digit.as_bytes()[0].is_ascii_digit())
    });
    numbered || DEVICES.contains(&stem.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_becomes_a_plain_file_name() {
        for (name, want) in [
            ("level", "level"),
            ("Gruft ❤ 2.1", "Gruft ❤ 2.1"),
            ("a/b\\c:d*e?f\"g<h>i|j\n", "a_b_c_d_e_f_g_h_i_j_"),
            ("", "scene"),
            ("..", "scene"),
            (".hidden", "_.hidden"),
            ("end. ", "end"),
            ("con", "_con"),
            ("LPT1.old", "_LPT1.old"),
            ("console", "console"),
        ] {
            assert_eq!(safe(name), want, "of {name:?}");
        }
        let long = safe(&"ü".repeat(300));
        assert!(long.len() <= MAX_BYTES && !long.is_empty());
    }

    #[test]
    fn only_files_of_the_same_scene_are_ours() {
        for file in [
            map("a", 0, "E"),
            map("a", 12, "Gr_du"),
            preview("a", 3),
            texture("a", 0),
            glb("a"),
        ] {
            assert!(is_ours(&file, "a"), "{file}");
        }
        for file in [
            "b_lm0_E.exr",
            "a_lm0_../../x.exr",
            "a_lm_E.exr",
            "a_lm0_.exr",
            "a_lm0_E.txt",
            "a_lm0/E.exr",
            "a.gltf",
            "../a.glb",
            "ab.glb",
            "a",
        ] {
            assert!(!is_ours(file, "a"), "{file}");
        }
    }

    #[test]
    fn uris_are_escaped() {
        assert_eq!(uri("a b_lm0_E.exr"), "a%20b_lm0_E.exr");
        assert_eq!(uri("ü#?.glb"), "%C3%BC%23%3F.glb");
    }
}

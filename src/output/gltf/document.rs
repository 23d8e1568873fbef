//! The document while it grows: JSON plus the one binary chunk of a `.glb`.
//!
//! Everything of the source stays: its buffers become the beginning of the chunk, byte for byte, so that every view, accessor and
//! unknown extension that refers to them stays valid; what is new is appended behind. Pictures that lie in files of their own move
//! into the chunk too, which makes the result self-contained.

use serde_json::{Map, Value, json};

use crate::error::{Error, Result, Warnings};
use crate::scene::{Scene, Source};

/// Compression that the source could be read without. The data it stands for is in the buffers, and new vertices do not fit it.
const COMPRESSION: [&str; 3] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
];

/// `bufferView.target` of vertex attributes.
pub(super) const VERTICES: u64 = 34962;

/// `bufferView.target` of vertex indices.
pub(super) const INDICES: u64 = 34963;

/// A document that can be appended to.
#[derive(Debug)]
pub(super) struct Document {
    pub(super) json: Map<String, Value>,
    binary: Vec<u8>,
}

impl Document {
    /// The source of `scene` with one buffer, embedded pictures and no compression.
    pub(super) fn new(scene: &Scene, warnings: &mut Warnings) -> Result<Self> {
        let Value::Object(json) = scene.source.json.clone() else {
            return Err(Error::InvalidFile {
                path: scene.path.clone(),
                place: String::new(),
                reason: "document is not a JSON object".to_owned(),
            });
        };
        let mut document = Self {
            json,
            binary: Vec::new(),
        };
        document.join_buffers(&scene.source);
        document.embed_pictures(&scene.source, warnings);
        document.drop_compression();
        Ok(document)
    }

    /// The objects of a top-level array; empty when it is missing or something else.
    pub(super) fn list(&self, key: &str) -> &[Value] {
        self.json
            .get(key)
            .and_then(Value::as_array)
            .map_or(&[], Vec::as_slice)
    }

    /// One object of a top-level array.
    pub(super) fn object_mut(
        &mut self,
        key: &str,
        index: usize,
    ) -> Option<&mut Map<String, Value>> {
        self.json.get_mut(key)?.get_mut(index)?.as_object_mut()
    }

    /// Appends to a top-level array, which is made when it is missing. Returns the index.
    pub(super) fn push(&mut self, key: &str, value: Value) -> usize {
        let list = self
            .json
            .entry(key)
            .or_insert_with(|| Value::Array(Vec::new()));
        if !list.is_array() {
            *list = Value::Array(Vec::new());
        }
        match list {
            Value::Array(list) => {
                list.push(value);
                list.len() - 1
            }
            _ => 0,
        }
    }

    /// Appends bytes to the chunk, at a multiple of four, and the view of them.
    pub(super) fn push_view(
        &mut self,
        bytes: &[u8],
        target: Option<u64>,
        stride: Option<usize>,
    ) -> usize {
        let offset = self.append(bytes);
        let mut view = json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()});
        if let Some(stride) = stride {
            view["byteStride"] = stride.into();
        }
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.push("bufferViews", view)
    }

    /// The bytes of the `.glb` in two pieces, because the second one, the buffer, can be large.
    pub(super) fn into_container(mut self) -> Result<[Vec<u8>; 2]> {
        self.append(&[]);
        if self.binary.is_empty() {
            self.json.shift_remove("buffers");
        } else {
            // The first buffer keeps its place and what it carries besides its bytes.
            let first = self.list("buffers").first().and_then(Value::as_object);
            let mut buffer = first.cloned().unwrap_or_default();
            buffer.shift_remove("uri");
            for extension in COMPRESSION {
                remove_extension(&mut buffer, extension);
            }
            buffer.insert("byteLength".to_owned(), self.binary.len().into());
            self.json.insert("buffers".to_owned(), json!([buffer]));
        }
        let mut text = Value::Object(self.json).to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');

        let chunks = if self.binary.is_empty() { 1 } else { 2 };
        let length = 12 + 8 * chunks + text.len() + self.binary.len();
        let Ok(length) = u32::try_from(length) else {
            return Err(Error::TooLarge {
                reason: format!(
                    "the glTF file would have {length} bytes, the limit of .glb is 4294967295; leave glb out of --outputs"
                ),
            });
        };
        // No chunk is longer than the whole.
        let word = |length: usize| (length as u32).to_le_bytes();
        let mut head = Vec::with_capacity(text.len() + 28);
        head.extend(*b"glTF");
        head.extend(2_u32.to_le_bytes());
        head.extend(length.to_le_bytes());
        head.extend(word(text.len()));
        head.extend(*b"JSON");
        head.append(&mut text);
        if !self.binary.is_empty() {
            head.extend(word(self.binary.len()));
            head.extend(*b"BIN\0");
        }
        Ok([head, self.binary])
    }

    /// Appends bytes to the chunk at a multiple of four, as components of up to four bytes need it; returns their offset.
    fn append(&mut self, bytes: &[u8]) -> usize {
        let offset = self.binary.len().next_multiple_of(4);
        self.binary.resize(offset, 0);
        self.binary.extend_from_slice(bytes);
        offset
    }

    /// Puts all buffers one behind the other and points their views there.
    fn join_buffers(&mut self, source: &Source) {
        let offsets: Vec<u64> = source
            .buffers
            .iter()
            .map(|bytes| self.append(bytes) as u64)
            .collect();
        let views = self
            .json
            .get_mut("bufferViews")
            .and_then(Value::as_array_mut);
        for view in views.into_iter().flatten().filter_map(Value::as_object_mut) {
            let buffer = view.get("buffer").and_then(Value::as_u64).unwrap_or(0);
            let Some(&base) = offsets.get(buffer as usize) else {
                continue;
            };
            let offset = view.get("byteOffset").and_then(Value::as_u64).unwrap_or(0);
            if base > 0 {
                view.insert("buffer".to_owned(), 0.into());
                view.insert("byteOffset".to_owned(), offset.saturating_add(base).into());
            }
        }
    }

    /// Moves pictures from their URIs into the chunk.
    fn embed_pictures(&mut self, source: &Source, warnings: &mut Warnings) {
        for index in 0..self.list("images").len() {
            if self.list("images")[index].get("uri").is_none() {
                continue;
            }
            let Ok((bytes, mime_type)) = source.image_bytes(index) else {
                warnings.push(
                    "image cannot be read, its URI is kept",
                    format!("images[{index}]"),
                );
                continue;
            };
            let view = self.push_view(&bytes, None, None);
            if let Some(image) = self.object_mut("images", index) {
                image.shift_remove("uri");
                image.insert("bufferView".to_owned(), view.into());
                image.insert("mimeType".to_owned(), mime_type.into());
            }
        }
    }

    /// Removes every trace of [`COMPRESSION`].
    fn drop_compression(&mut self) {
        let strip = |object: &mut Value| {
            let Some(object) = object.as_object_mut() else {
                return;
            };
            for extension in COMPRESSION {
                remove_extension(object, extension);
            }
        };
        let views = self.json.get_mut("bufferViews");
        let views = views.and_then(Value::as_array_mut);
        views.into_iter().flatten().for_each(strip);
        let meshes = self.json.get_mut("meshes").and_then(Value::as_array_mut);
        meshes
            .into_iter()
            .flatten()
            .filter_map(|mesh| mesh.get_mut("primitives")?.as_array_mut())
            .flatten()
            .for_each(strip);
        for extension in COMPRESSION {
            self.undeclare(extension);
        }
    }

    /// Takes an extension out of `extensionsUsed` and `extensionsRequired`, which must not be empty lists.
    pub(super) fn undeclare(&mut self, extension: &str) {
        for key in ["extensionsUsed", "extensionsRequired"] {
            if let Some(Value::Array(names)) = self.json.get_mut(key) {
                names.retain(|name| name != extension);
                if names.is_empty() {
                    self.json.shift_remove(key);
                }
            }
        }
    }
}

/// Takes an extension out of an object's `extensions`, which go when they become empty. Returns whether it was there.
pub(super) fn remove_extension(object: &mut Map<String, Value>, extension: &str) -> bool {
    let Some(Value::Object(extensions)) = object.get_mut("extensions") else {
        return false;
    };
    let found = extensions.shift_remove(extension).is_some();
    if extensions.is_empty() {
        object.shift_remove("extensions");
    }
    found
}

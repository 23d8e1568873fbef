//! A second reader of glTF, slow and plain, that shares nothing with the library.

use std::fs;
use std::path::Path;

use lumel::scene::Scene;
use serde_json::Value;

/// A glTF document with its buffers.
pub(crate) struct Document {
    pub(crate) json: Value,
    buffers: Vec<Vec<u8>>,
}

impl Document {
    /// Reads a `.glb` by the letter of the container.
    pub(crate) fn read(path: &Path) -> Self {
        let bytes = fs::read(path).expect("readable");
        let number = |at: usize| {
            let number = bytes[at..at + 4].try_into().expect("four bytes");
            u32::from_le_bytes(number) as usize
        };
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!(number(4), 2);
        assert_eq!(number(8), bytes.len());
        let text_end = 20 + number(12);
        assert_eq!(&bytes[16..20], b"JSON");
        assert_eq!(text_end % 4, 0);
        let json: Value = serde_json::from_slice(&bytes[20..text_end]).expect("JSON");
        let mut buffers = Vec::new();
        if text_end < bytes.len() {
            assert_eq!(&bytes[text_end + 4..text_end + 8], b"BIN\0");
            assert_eq!(number(text_end), bytes.len() - text_end - 8);
            buffers.push(bytes[text_end + 8..].to_vec());
            assert_eq!(json["buffers"][0]["byteLength"], buffers[0].len());
            assert!(json["buffers"][0].get("uri").is_none());
        }
        Self { json, buffers }
    }

    /// The document of `scene` as it was read.
    pub(crate) fn of(scene: &Scene) -> Self {
        Self {
            json: scene.source.json.clone(),
            buffers: scene.source.buffers.clone(),
        }
    }

    /// Components of all elements of an accessor, decoded the slow way.
    pub(crate) fn elements(&self, index: usize) -> Vec<Vec<f64>> {
        let accessor = &self.json["accessors"][index];
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        let n = match accessor["type"].as_str().expect("a type") {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => panic!("{other}"),
        };
        let size = |kind: u64| match kind {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let kind = accessor["componentType"]
            .as_u64()
            .expect("a component type");
        let at =
            |part: &Value, offset: usize, kind: u64, stride: Option<usize>, i: usize, c: usize| {
                let view = &self.json["bufferViews"][number(&part["bufferView"])];
                let stride = stride.unwrap_or_else(|| match number(&view["byteStride"]) {
                    0 => n * size(kind),
                    stride => stride,
                });
                let start = number(&view["byteOffset"]) + offset + i * stride + c * size(kind);
                component(&self.buffers[number(&view["buffer"])][start..], kind)
            };
        let count = number(&accessor["count"]);
        let offset = number(&accessor["byteOffset"]);
        let mut elements: Vec<Vec<f64>> = (0..count)
            .map(|i| {
                (0..n)
                    .map(|c| match accessor.get("bufferView") {
                        Some(_) => at(accessor, offset, kind, None, i, c),
                        None => 0.0,
                    })
                    .collect()
            })
            .collect();
        let sparse = &accessor["sparse"];
        for entry in 0..number(&sparse["count"]) {
            let [indices, values] = [&sparse["indices"], &sparse["values"]];
            let index_kind = indices["componentType"].as_u64().expect("a component type");
            let offset = number(&indices["byteOffset"]);
            let index = at(
                indices,
                offset,
                index_kind,
                Some(size(index_kind)),
                entry,
                0,
            );
            let offset = number(&values["byteOffset"]);
            elements[index as usize] = (0..n)
                .map(|c| at(values, offset, kind, Some(n * size(kind)), entry, c))
                .collect();
        }
        elements
    }

    /// All attributes of a primitive but `TEXCOORD_1`, those of morph targets included, by name.
    pub(crate) fn attributes(&self, primitive: &Value) -> Vec<(String, Vec<Vec<f64>>)> {
        let mut attributes = Vec::new();
        let targets = primitive["targets"].as_array().into_iter().flatten();
        for (number, object) in std::iter::once(&primitive["attributes"])
            .chain(targets)
            .enumerate()
        {
            for (name, accessor) in object.as_object().expect("attributes") {
                if name != "TEXCOORD_1" {
                    let accessor = accessor.as_u64().expect("an index") as usize;
                    attributes.push((format!("{number} {name}"), self.elements(accessor)));
                }
            }
        }
        attributes.sort_by(|a, b| a.0.cmp(&b.0));
        attributes
    }
}

fn component(bytes: &[u8], kind: u64) -> f64 {
    match kind {
        5120 => f64::from(bytes[0] as i8),
        5121 => f64::from(bytes[0]),
        5122 => f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
        5123 => f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        5125 => f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        _ => f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
    }
}

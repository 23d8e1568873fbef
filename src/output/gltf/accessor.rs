//! Elements of accessors as raw bytes, whatever their type.
//!
//! A vertex on a seam is copied, not computed: quantised, normalised, sparse or custom attributes come out bit for bit. Nothing here
//! trusts a count or an offset of the file.

use std::collections::BTreeMap;

use serde_json::{Map, Number, Value, json};

use crate::output::gltf::document::{Document, VERTICES};
use crate::scene::Source;

/// Why an accessor cannot be copied; the words of a warning.
pub(super) type Fault = &'static str;

/// How an element lies in memory (glTF 2.0, section 3.6.2.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Layout {
    component_type: u64,
    component_size: usize,
    columns: usize,
    rows: usize,
    /// Bytes of an element; columns of matrices start at multiples of four.
    size: usize,
}

impl Layout {
    fn of(accessor: &Value) -> Option<Self> {
        let component_type = accessor.get("componentType")?.as_u64()?;
        let component_size: usize = match component_type {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            _ => return None,
        };
        let (columns, rows) = match accessor.get("type")?.as_str()? {
            "SCALAR" => (1, 1),
            "VEC2" => (1, 2),
            "VEC3" => (1, 3),
            "VEC4" => (1, 4),
            "MAT2" => (2, 2),
            "MAT3" => (3, 3),
            "MAT4" => (4, 4),
            _ => return None,
        };
        let column = rows * component_size;
        let size = match columns {
            1 => column,
            _ => columns * column.next_multiple_of(4),
        };
        Some(Self {
            component_type,
            component_size,
            columns,
            rows,
            size,
        })
    }
}

/// Where the elements of an accessor are.
struct Elements<'a> {
    layout: Layout,
    count: usize,
    /// Bytes from the first element on, and the distance between elements; `None` stands for zeros.
    dense: Option<(&'a [u8], usize)>,
    /// Replaced elements: index to byte offset in `values`.
    sparse: BTreeMap<usize, usize>,
    values: &'a [u8],
}

impl<'a> Elements<'a> {
    fn of(source: &'a Source, accessor: &Value) -> Result<Self, Fault> {
        let layout = Layout::of(accessor).ok_or("attribute has an unknown type, dropped")?;
        let outside = "attribute lies outside of its buffer, dropped";
        let count = integer(accessor, "count").ok_or(outside)?;
        let dense = match accessor.get("bufferView") {
            None => None,
            Some(_) => {
                let (bytes, stride) = view(source, accessor).ok_or(outside)?;
                Some((bytes, stride.unwrap_or(layout.size)))
            }
        };
        let mut elements = Self {
            layout,
            count,
            dense,
            sparse: BTreeMap::new(),
            values: &[],
        };
        if let Some(sparse) = accessor.get("sparse") {
            elements.overlay(source, sparse).ok_or(outside)?;
        }
        Ok(elements)
    }

    /// Reads which elements are replaced.
    fn overlay(&mut self, source: &'a Source, sparse: &Value) -> Option<()> {
        let count = integer(sparse, "count")?;
        let indices = sparse.get("indices")?;
        let size = match indices.get("componentType")?.as_u64()? {
            5121 => 1,
            5123 => 2,
            5125 => 4,
            _ => return None,
        };
        let (bytes, _) = view(source, indices)?;
        let bytes = bytes.get(..count.checked_mul(size)?)?;
        let (values, _) = view(source, sparse.get("values")?)?;
        self.values = values.get(..count.checked_mul(self.layout.size)?)?;
        for (entry, index) in bytes.chunks_exact(size).enumerate() {
            let mut wide = [0; 8];
            wide[..size].copy_from_slice(index);
            self.sparse
                .insert(u64::from_le_bytes(wide) as usize, entry * self.layout.size);
        }
        Some(())
    }

    /// Appends element `index`.
    fn append(&self, index: usize, bytes: &mut Vec<u8>) -> Result<(), Fault> {
        let size = self.layout.size;
        if index >= self.count {
            return Err("attribute has fewer elements than the positions, dropped");
        }
        let element = if let Some(&offset) = self.sparse.get(&index) {
            self.values.get(offset..offset + size)
        } else if let Some((dense, stride)) = self.dense {
            index
                .checked_mul(stride)
                .and_then(|start| dense.get(start..start.checked_add(size)?))
        } else {
            bytes.resize(bytes.len() + size, 0);
            return Ok(());
        };
        bytes.extend_from_slice(element.ok_or("attribute lies outside of its buffer, dropped")?);
        Ok(())
    }
}

/// Copies the elements `indices` of accessor `index` into a new accessor, which keeps everything else the old one says.
///
/// Returns the index of the new accessor; the old one when every element keeps its place. `bounds` asks for `min` and `max`.
pub(super) fn gather(
    document: &mut Document,
    source: &Source,
    index: &Value,
    indices: &[u32],
    bounds: bool,
) -> Result<usize, Fault> {
    let missing = "attribute refers to no accessor, dropped";
    let accessor_idx = index.as_u64().ok_or(missing)? as usize;
    let accessor = source
        .json
        .get("accessors")
        .and_then(|accessors| accessors.get(accessor_idx))
        .filter(|accessor| accessor.is_object())
        .ok_or(missing)?;
    let elements = Elements::of(source, accessor)?;
    let in_place = indices
        .iter()
        .enumerate()
        .all(|(at, &from)| at == from as usize);
    if in_place && indices.len() == elements.count {
        return Ok(accessor_idx);
    }

    // Elements of vertex attributes start at multiples of four.
    let stride = elements.layout.size.next_multiple_of(4);
    let mut bytes = Vec::with_capacity(indices.len() * stride);
    for &from in indices {
        elements.append(from as usize, &mut bytes)?;
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    let padded = (stride != elements.layout.size).then_some(stride);
    let view = document.push_view(&bytes, Some(VERTICES), padded);

    let mut copy: Map<String, Value> = accessor.as_object().cloned().unwrap_or_default();
    let had_bounds = copy.contains_key("min") || copy.contains_key("max");
    for key in ["byteOffset", "sparse", "min", "max"] {
        copy.shift_remove(key);
    }
    copy.insert("bufferView".to_owned(), view.into());
    copy.insert("count".to_owned(), indices.len().into());
    if (bounds || had_bounds) && elements.layout.columns == 1 {
        let [min, max] = bounds_of(&bytes, stride, elements.layout);
        copy.insert("min".to_owned(), min.into());
        copy.insert("max".to_owned(), max.into());
    }
    Ok(document.push("accessors", Value::Object(copy)))
}

/// Appends an accessor of `f32` pairs.
pub(super) fn push_pairs(document: &mut Document, pairs: &[[f32; 2]]) -> usize {
    let bytes: Vec<u8> = pairs
        .as_flattened()
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    let view = document.push_view(&bytes, Some(VERTICES), None);
    document.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5126, "count": pairs.len(), "type": "VEC2"}),
    )
}

/// Smallest and largest value of each component. What is not finite does not count.
fn bounds_of(bytes: &[u8], stride: usize, layout: Layout) -> [Vec<Value>; 2] {
    let mut min = vec![f64::INFINITY; layout.rows];
    let mut max = vec![f64::NEG_INFINITY; layout.rows];
    for element in bytes.chunks_exact(stride) {
        let components = element[..layout.size].chunks_exact(layout.component_size);
        for (row, component) in components.enumerate() {
            let value = number(component, layout.component_type);
            if value.is_finite() {
                min[row] = min[row].min(value);
                max[row] = max[row].max(value);
            }
        }
    }
    [min, max].map(|bounds| {
        let is_float = layout.component_type == 5126;
        bounds
            .into_iter()
            .map(|value| spell(value, is_float))
            .collect()
    })
}

/// A bound as a JSON number; integers without a fraction. 0 when there was nothing to bound.
fn spell(value: f64, is_float: bool) -> Value {
    if is_float {
        Number::from_f64(value).map_or_else(|| 0.into(), Value::Number)
    } else {
        (value as i64).into()
    }
}

/// The value of a little-endian component.
fn number(bytes: &[u8], component_type: u64) -> f64 {
    let mut wide = [0; 4];
    wide[..bytes.len()].copy_from_slice(bytes);
    match component_type {
        5120 => f64::from(wide[0] as i8),
        5122 => f64::from(i16::from_le_bytes([wide[0], wide[1]])),
        5126 => f64::from(f32::from_le_bytes(wide)),
        _ => f64::from(u32::from_le_bytes(wide)),
    }
}

/// Bytes from `byteOffset` of an accessor (or of a part of a sparse one) to the end of its view, and the view's stride.
fn view<'a>(source: &'a Source, accessor: &Value) -> Option<(&'a [u8], Option<usize>)> {
    let index = integer(accessor, "bufferView")?;
    let view = source.json.get("bufferViews")?.get(index)?;
    let buffer = source.buffers.get(integer(view, "buffer")?)?;
    let start = optional(view, "byteOffset")?;
    let length = integer(view, "byteLength")?;
    let bytes = buffer.get(start..start.checked_add(length)?)?;
    let bytes = bytes.get(optional(accessor, "byteOffset")?..)?;
    let stride = view
        .get("byteStride")
        .and_then(Value::as_u64)
        .map(|stride| stride as usize);
    Some((bytes, stride))
}

fn integer(object: &Value, key: &str) -> Option<usize> {
    object.get(key)?.as_u64().map(|value| value as usize)
}

/// An integer that is 0 when it is not given.
fn optional(object: &Value, key: &str) -> Option<usize> {
    match object.get(key) {
        None => Some(0),
        Some(value) => value.as_u64().map(|value| value as usize),
    }
}

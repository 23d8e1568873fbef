//! Accessors: typed elements in buffers.
//!
//! Every range is checked with checked arithmetic before anything is allocated, so that a forged count is an error and not an
//! allocation. Quantised and normalised components become floats here, sparse elements are put in place.

use gltf::json;
use gltf::json::accessor::ComponentType;
use gltf::json::validation::Checked;

use super::document::Document;
use super::extension;
use crate::error::Result;

/// Most elements an accessor may have that has no bytes of its own (all zeros but for sparse ones).
///
/// Nothing in the file backs such a count, so it has to be bounded. Larger: a forged count allocates gigabytes. Smaller: morph targets
/// of real meshes, which are the one honest use, would be refused.
const MAX_WITHOUT_BYTES: usize = 1 << 22;

/// An accessor whose bytes are known to be there.
pub(super) struct Accessor<'a> {
    /// How many elements.
    pub(super) count: usize,
    /// Numbers per element: 3 for VEC3.
    pub(super) n_components: usize,
    /// Type of a number.
    pub(super) component: ComponentType,
    /// Whether integers stand for 0..1 or −1..1.
    pub(super) normalized: bool,
    elements: Option<Elements<'a>>,
    sparse: Option<Sparse<'a>>,
    /// `accessors[3]`.
    place: String,
}

/// Equal elements at equal distances.
#[derive(Clone, Copy)]
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

/// Elements that replace others.
struct Sparse<'a> {
    count: usize,
    indices: Elements<'a>,
    values: Elements<'a>,
}

impl<'a> Accessor<'a> {
    /// Opens `accessors[index]`, which `from` refers to.
    pub(super) fn open(document: &Document<'a>, index: usize, from: &str) -> Result<Self> {
        let accessor: json::Accessor = document.get("accessors", index, from)?;
        let place = format!("accessors[{index}]");
        let Checked::Valid(component) = accessor.component_type else {
            return Err(document.invalid(
                format!("{place}.componentType"),
                "must be one of 5120, 5121, 5122, 5123, 5125, 5126",
            ));
        };
        let Checked::Valid(shape) = accessor.type_ else {
            return Err(document.invalid(
                format!("{place}.type"),
                "must be one of SCALAR, VEC2, VEC3, VEC4, MAT2, MAT3, MAT4",
            ));
        };
        let (component, n_components) = (component.0, shape.multiplicity());
        let size = component.size() * n_components;
        let backed = accessor.buffer_view.is_some();
        let count = count_within(
            document,
            accessor.count.0,
            backed,
            &format!("{place}.count"),
        )?;
        let elements = match accessor.buffer_view {
            Some(view) => Some(Elements::open(
                document,
                view.value(),
                accessor.byte_offset.unwrap_or_default().0,
                size,
                count,
                &place,
            )?),
            None => None,
        };
        let sparse = match accessor.sparse {
            Some(sparse) => Some(Sparse::open(document, &sparse, size, count, &place)?),
            None => None,
        };
        Ok(Self {
            count,
            n_components,
            component,
            normalized: accessor.normalized,
            elements,
            sparse,
            place,
        })
    }

    /// Whether it has no bytes at all, which compressed primitives leave for their decoder to fill.
    pub(super) fn is_empty_shell(&self) -> bool {
        self.elements.is_none() && self.sparse.is_none()
    }

    /// All elements as floats. `N` must be [`Accessor::n_components`].
    pub(super) fn floats<const N: usize>(&self, document: &Document<'_>) -> Result<Vec<[f32; N]>> {
        debug_assert_eq!(N, self.n_components, "the caller checks the shape");
        let size = self.component.size();
        self.decode(document, [0.0; N], |bytes| {
            let mut element = [0.0; N];
            for (number, bytes) in element.iter_mut().zip(bytes.chunks_exact(size)) {
                *number = float(self.component, self.normalized, bytes);
            }
            element
        })
    }

    /// All elements as whole numbers: what `indices` hold.
    pub(super) fn indices(&self, document: &Document<'_>) -> Result<Vec<u32>> {
        use ComponentType::{U8, U16, U32};
        if self.n_components != 1 || !matches!(self.component, U8 | U16 | U32) {
            return Err(document.invalid(
                self.place.clone(),
                "indices must be unsigned scalars (componentType 5121, 5123 or 5125)",
            ));
        }
        self.decode(document, 0, whole)
    }

    /// Decodes every element, sparse ones last.
    fn decode<T: Copy>(
        &self,
        document: &Document<'_>,
        zero: T,
        decode: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>> {
        let mut list = match self.elements {
            Some(elements) => (0..self.count)
                .map(|index| decode(elements.get(index)))
                .collect(),
            None => vec![zero; self.count],
        };
        if let Some(sparse) = &self.sparse {
            for number in 0..sparse.count {
                let index = whole(sparse.indices.get(number)) as usize;
                let slot = list.get_mut(index).ok_or_else(|| {
                    document.invalid(
                        format!("{}.sparse.indices", self.place),
                        format!("index {index} is out of range ({} elements)", self.count),
                    )
                })?;
                *slot = decode(sparse.values.get(number));
            }
        }
        Ok(list)
    }
}

impl<'a> Elements<'a> {
    /// `count` elements of `size` bytes each, from byte `offset` of a buffer view.
    fn open(
        document: &Document<'a>,
        view: usize,
        offset: u64,
        size: usize,
        count: usize,
        place: &str,
    ) -> Result<Self> {
        let (bytes, stride) = view_bytes(document, view, place)?;
        let stride = stride.unwrap_or(size);
        if stride < size {
            return Err(document.invalid(
                format!("bufferViews[{view}].byteStride"),
                format!("must be at least the {size} bytes of an element, is {stride}"),
            ));
        }
        let needed = match count {
            0 => Some(0),
            _ => (stride as u64)
                .checked_mul(count as u64 - 1)
                .and_then(|last| last.checked_add(size as u64))
                .and_then(|length| length.checked_add(offset)),
        };
        match needed {
            Some(needed) if needed <= bytes.len() as u64 => Ok(Self {
                // In range unless there are no elements, which may begin anywhere.
                bytes: bytes.get(offset as usize..).unwrap_or_default(),
                stride,
                size,
            }),
            _ => Err(document.invalid(
                place,
                format!(
                    "{count} elements from byte {offset} do not fit into the {} bytes of bufferViews[{view}]",
                    bytes.len()
                ),
            )),
        }
    }

    /// Bytes of element `index`.
    fn get(&self, index: usize) -> &'a [u8] {
        let start = index * self.stride;
        &self.bytes[start..start + self.size]
    }
}

impl<'a> Sparse<'a> {
    fn open(
        document: &Document<'a>,
        sparse: &json::accessor::sparse::Sparse,
        size: usize,
        accessor_count: usize,
        place: &str,
    ) -> Result<Self> {
        if sparse.count.0 > accessor_count as u64 {
            return Err(document.invalid(
                format!("{place}.sparse.count"),
                format!(
                    "must be at most the {accessor_count} elements there are, is {}",
                    sparse.count.0
                ),
            ));
        }
        let count = sparse.count.0 as usize;
        let Checked::Valid(index_component) = sparse.indices.component_type else {
            return Err(document.invalid(
                format!("{place}.sparse.indices.componentType"),
                "must be one of 5121, 5123, 5125",
            ));
        };
        Ok(Self {
            count,
            indices: Elements::open(
                document,
                sparse.indices.buffer_view.value(),
                sparse.indices.byte_offset.0,
                index_component.0.size(),
                count,
                &format!("{place}.sparse.indices"),
            )?,
            values: Elements::open(
                document,
                sparse.values.buffer_view.value(),
                sparse.values.byte_offset.0,
                size,
                count,
                &format!("{place}.sparse.values"),
            )?,
        })
    }
}

/// The bytes of `bufferViews[index]`, which `from` refers to, and its stride when it has one.
pub(super) fn view_bytes<'a>(
    document: &Document<'a>,
    index: usize,
    from: &str,
) -> Result<(&'a [u8], Option<usize>)> {
    let place = format!("bufferViews[{index}]");
    let view: json::buffer::View = document.get("bufferViews", index, from)?;
    let buffer = view.buffer.value();
    let bytes = document.buffers.get(buffer).ok_or_else(|| {
        let n_buffers = document.buffers.len();
        document.invalid(
            format!("{place}.buffer"),
            format!("refers to buffers[{buffer}], but there are {n_buffers}"),
        )
    })?;
    let offset = view.byte_offset.unwrap_or_default().0;
    let end = offset.checked_add(view.byte_length.0);
    match end {
        Some(end) if end <= bytes.len() as u64 => {
            let stride = view.byte_stride.map(|stride| stride.0);
            Ok((
                &bytes[offset as usize..end as usize],
                stride.filter(|stride| *stride > 0),
            ))
        }
        // The bytes of a compressed view lie elsewhere.
        _ if bytes.is_empty() => {
            extension::refuse_compressed_view(document, index)?;
            Err(document.invalid(
                format!("buffers[{buffer}]"),
                format!("has no bytes, but {place} needs some"),
            ))
        }
        _ => Err(document.invalid(
            place,
            format!(
                "{} bytes from byte {offset} do not fit into the {} bytes of buffers[{buffer}]",
                view.byte_length.0,
                bytes.len()
            ),
        )),
    }
}

/// `count` as a size, unless nothing backs it and it is huge.
fn count_within(document: &Document<'_>, count: u64, backed: bool, place: &str) -> Result<usize> {
    match usize::try_from(count) {
        Ok(count) if backed || count <= MAX_WITHOUT_BYTES => Ok(count),
        _ => Err(document.invalid(
            place,
            format!("must be at most {MAX_WITHOUT_BYTES} without a bufferView, is {count}"),
        )),
    }
}

/// One number. Normalised integers follow the equations of glTF 2.0 §3.11.
fn float(component: ComponentType, normalized: bool, bytes: &[u8]) -> f32 {
    let (value, one) = match (component, bytes) {
        (ComponentType::I8, &[a]) => (f64::from(a as i8), f64::from(i8::MAX)),
        (ComponentType::U8, &[a]) => (f64::from(a), f64::from(u8::MAX)),
        (ComponentType::I16, &[a, b]) => {
            (f64::from(i16::from_le_bytes([a, b])), f64::from(i16::MAX))
        }
        (ComponentType::U16, &[a, b]) => {
            (f64::from(u16::from_le_bytes([a, b])), f64::from(u16::MAX))
        }
        (ComponentType::U32, &[a, b, c, d]) => (
            f64::from(u32::from_le_bytes([a, b, c, d])),
            f64::from(u32::MAX),
        ),
        (_, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
        _ => return 0.0,
    };
    if normalized {
        (value / one).max(-1.0) as f32
    } else {
        value as f32
    }
}

/// A little-endian number of one, two or four bytes.
fn whole(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .rev()
        .fold(0, |number, byte| number << 8 | u32::from(*byte))
}

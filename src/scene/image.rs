//! Pictures: bytes of images, and decoding of the few that are needed.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic;

use gltf::json;
use image::{ImageReader, Limits};
use rayon::prelude::*;

use super::Source;
use super::accessor;
use super::document::Document;
use super::uri;
use crate::error::{Result, Warnings};

/// A decoded picture.
#[derive(Clone, Debug)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// As stored (colour in sRGB, alpha linear), row 0 on top.
    pub rgba: Vec<[u8; 4]>,
}

/// Longest side that is decoded, the limit of common graphics hardware.
const MAX_SIDE: u32 = 16384;

/// Most pixels that are decoded in all: one picture of the longest side, 1 GiB. Larger: a few forged headers take all memory. Smaller:
/// levels with many emissive textures lose some.
const MAX_PIXELS: u64 = MAX_SIDE as u64 * MAX_SIDE as u64;

/// Most bytes a decoder may allocate for one picture: 16 bits per channel, before it becomes 8.
const MAX_ALLOCATION: u64 = 8 * MAX_PIXELS;

/// The bytes of `images[index]` and their media type; see [`Source::image_bytes`].
pub(super) fn bytes(document: &Document<'_>, index: usize) -> Result<(Vec<u8>, String)> {
    let place = format!("images[{index}]");
    let image: json::Image = document.get("images", index, &place)?;
    let declared = image.mime_type.map(|mime| mime.0);
    let (bytes, mime) = match (image.buffer_view, image.uri) {
        (Some(view), _) => {
            let (bytes, _) = accessor::view_bytes(document, view.value(), &place)?;
            (bytes.to_vec(), None)
        }
        (None, Some(uri)) => uri::fetch(document, &uri, &format!("{place}.uri"))?,
        (None, None) => {
            return Err(document.invalid(place, "has neither bufferView nor uri"));
        }
    };
    let mime = sniff(&bytes)
        .map(str::to_owned)
        .or(declared)
        .or(mime)
        .unwrap_or_else(|| "application/octet-stream".to_owned());
    Ok((bytes, mime))
}

/// Media type by the first bytes. Names and declarations are wrong more often.
fn sniff(bytes: &[u8]) -> Option<&'static str> {
    let known: &[(&[u8], &str)] = &[
        (b"\x89PNG\r\n\x1a\n", "image/png"),
        (b"\xff\xd8\xff", "image/jpeg"),
        (b"\xabKTX 20\xbb", "image/ktx2"),
        (b"DDS ", "image/vnd-ms.dds"),
    ];
    if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP") {
        return Some("image/webp");
    }
    known
        .iter()
        .find(|(magic, _)| bytes.starts_with(magic))
        .map(|(_, mime)| *mime)
}

/// Decodes the document's images `wanted` (ascending). Returns the pictures, and for each document index where its picture is. One that
/// cannot be read is missing from the map and counted in `warnings`.
pub(super) fn decode(
    document: &Document<'_>,
    wanted: impl IntoIterator<Item = usize>,
    warnings: &mut Warnings,
) -> (Vec<Image>, BTreeMap<usize, usize>) {
    let mut encoded = Vec::new();
    let mut n_pixels = 0;
    for index in wanted {
        match open(document, index, n_pixels) {
            Ok((bytes, pixels)) => {
                n_pixels += pixels;
                encoded.push((index, bytes));
            }
            Err(reason) => warnings.push(UNREADABLE, format!("images[{index}] ({reason})")),
        }
    }
    let decoded: Vec<_> = encoded
        .par_iter()
        .map(|(index, bytes)| (*index, decode_one(bytes)))
        .collect();
    let mut images = Vec::new();
    let mut places = BTreeMap::new();
    for (index, image) in decoded {
        match image {
            Ok(image) => {
                places.insert(index, images.len());
                images.push(image);
            }
            Err(reason) => warnings.push(UNREADABLE, format!("images[{index}] ({reason})")),
        }
    }
    (images, places)
}

const UNREADABLE: &str = "picture cannot be read, treated as white";

/// The bytes of an image and how many pixels they make, if those still fit.
fn open(
    document: &Document<'_>,
    index: usize,
    n_before: u64,
) -> std::result::Result<(Vec<u8>, u64), String> {
    let (bytes, _) = bytes(document, index).map_err(|error| error.to_string())?;
    let (width, height) = reader(&bytes)?
        .into_dimensions()
        .map_err(|error| error.to_string())?;
    let n_pixels = u64::from(width) * u64::from(height);
    if n_before + n_pixels > MAX_PIXELS {
        return Err(format!(
            "{width} × {height}, more than {MAX_PIXELS} pixels in all"
        ));
    }
    Ok((bytes, n_pixels))
}

fn reader(bytes: &[u8]) -> std::result::Result<ImageReader<Cursor<&[u8]>>, String> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_ALLOCATION);
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|error| error.to_string())?;
    reader.limits(limits);
    Ok(reader)
}

fn decode_one(bytes: &[u8]) -> std::result::Result<Image, String> {
    // Decoders see bytes from anywhere. A bug in one of them costs a picture, not the bake.
    let decoded =
        panic::catch_unwind(|| reader(bytes)?.decode().map_err(|error| error.to_string()));
    let pixels = decoded
        .map_err(|_| "decoder failed".to_owned())??
        .into_rgba8();
    let (width, height) = pixels.dimensions();
    if width == 0 || height == 0 {
        return Err("no pixels".to_owned());
    }
    Ok(Image {
        width,
        height,
        rgba: pixels
            .into_raw()
            .chunks_exact(4)
            .map(|pixel| [pixel[0], pixel[1], pixel[2], pixel[3]])
            .collect(),
    })
}

impl Source {
    /// The bytes of `images[index]` as they are in the buffer view, data URI or file, and their media type (by the first bytes, else as
    /// declared, else `application/octet-stream`).
    ///
    /// # Errors
    /// `Io` when the file cannot be read; `InvalidFile`, naming the document's folder, when there is no such image or its bytes are not there.
    pub fn image_bytes(&self, index: usize) -> Result<(Vec<u8>, String)> {
        bytes(&Document::new(&self.folder, self), index)
    }
}

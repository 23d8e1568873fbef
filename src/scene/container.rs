//! File → [`Source`]: the GLB container, the JSON text and the buffers.

use std::fs;
use std::path::Path;

use gltf::json;
use serde_json::Value;

use super::Source;
use super::document::Document;
use super::uri;
use crate::error::{Error, Result};

const MAGIC: &[u8] = b"glTF";
const JSON: &[u8] = b"JSON";
const BIN: &[u8] = b"BIN\0";
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;

/// Reads the document at `path` and all its buffers. GLB is told from text by its first bytes, not by the name.
pub(super) fn read(path: &Path) -> Result<Source> {
    let invalid = |reason: String| Error::InvalidFile {
        path: path.to_owned(),
        place: String::new(),
        reason,
    };
    let bytes = fs::read(path).map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })?;
    if bytes.is_empty() {
        return Err(invalid("the file is empty".to_owned()));
    }
    let (text, chunk) = if bytes.starts_with(MAGIC) {
        let (text, chunk) = split(&bytes).map_err(invalid)?;
        (text, chunk.map(<[u8]>::to_vec))
    } else {
        (bytes.as_slice(), None)
    };
    // Some editors put a byte order mark before the text, some exporters pad it with zeros.
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let text = text.trim_ascii_end();
    let padding = text.iter().rev().take_while(|byte| **byte == 0).count();
    let json: Value = serde_json::from_slice(&text[..text.len() - padding])
        .map_err(|error| invalid(format!("not a glTF document: {error}")))?;
    let mut source = Source {
        json,
        buffers: Vec::new(),
        folder: path.parent().unwrap_or(Path::new("")).to_owned(),
    };
    let document = Document::new(path, &source);
    check_version(&document)?;
    source.buffers = read_buffers(&document, chunk)?;
    Ok(source)
}

/// The JSON text and the first binary chunk of a GLB file. Chunks of unknown types are skipped, bytes behind the end are ignored.
fn split(bytes: &[u8]) -> std::result::Result<(&[u8], Option<&[u8]>), String> {
    if bytes.len() < HEADER {
        return Err(format!(
            "truncated: a GLB header has {HEADER} bytes, the file {}",
            bytes.len()
        ));
    }
    let version = number_at(bytes, 4);
    if version != 2 {
        return Err(format!(
            "GLB version must be 2, is {version}; convert it to glTF 2.0"
        ));
    }
    let length = number_at(bytes, 8);
    if length > bytes.len() {
        return Err(format!(
            "truncated: the GLB header says {length} bytes, the file has {}",
            bytes.len()
        ));
    }
    let mut rest = &bytes[HEADER.min(length)..length];
    let mut text = None;
    let mut binary = None;
    while rest.len() >= CHUNK_HEADER {
        let length = number_at(rest, 0);
        let kind = &rest[4..CHUNK_HEADER];
        let body = &rest[CHUNK_HEADER..];
        if length > body.len() {
            return Err(format!(
                "GLB chunk {} says {length} bytes, but {} are left",
                String::from_utf8_lossy(kind)
                    .trim_end_matches('\0')
                    .escape_debug(),
                body.len()
            ));
        }
        let (chunk, after) = body.split_at(length);
        if kind == JSON && text.is_none() {
            text = Some(chunk);
        } else if kind == BIN && binary.is_none() {
            binary = Some(chunk);
        }
        rest = after;
    }
    match text {
        Some(text) => Ok((text, binary)),
        None if rest.is_empty() => Err("GLB file has no JSON chunk".to_owned()),
        None => Err(format!(
            "truncated: a GLB chunk header has {CHUNK_HEADER} bytes, {} are left",
            rest.len()
        )),
    }
}

/// Little-endian number at `offset`, which must be in range.
fn number_at(bytes: &[u8], offset: usize) -> usize {
    let mut number = [0; 4];
    number.copy_from_slice(&bytes[offset..offset + 4]);
    u32::from_le_bytes(number) as usize
}

/// Refuses what is not glTF 2.x, or says that readers of 2.0 cannot read it.
fn check_version(document: &Document<'_>) -> Result<()> {
    if !document.json.is_object() {
        return Err(document.invalid("", "not a glTF document: the top level is not an object"));
    }
    let asset = document
        .json
        .get("asset")
        .ok_or_else(|| document.invalid("asset", "missing; not a glTF document"))?;
    let asset: json::Asset = document.parse(asset, || "asset".to_owned())?;
    let (major, _) = version(&asset.version).ok_or_else(|| {
        document.invalid(
            "asset.version",
            format!("must be a version like \"2.0\", is {:?}", asset.version),
        )
    })?;
    if major != 2 {
        return Err(document.invalid(
            "asset.version",
            format!(
                "must be 2.x, is {:?}; convert it to glTF 2.0",
                asset.version
            ),
        ));
    }
    if let Some(least) = &asset.min_version
        && version(least).is_none_or(|least| least > (2, 0))
    {
        return Err(document.invalid(
            "asset.minVersion",
            format!("must be at most \"2.0\", is {least:?}"),
        ));
    }
    Ok(())
}

fn version(text: &str) -> Option<(u32, u32)> {
    let (major, minor) = text.split_once('.')?;
    Some((major.parse().ok()?, minor.parse().ok()?))
}

/// The bytes of all buffers. `chunk` belongs to the first one when that has no URI. A buffer without bytes is left empty: whether that
/// is a fault depends on who reads it.
fn read_buffers(document: &Document<'_>, mut chunk: Option<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
    let n_buffers = document.list("buffers")?.len();
    let mut buffers = Vec::with_capacity(n_buffers);
    for index in 0..n_buffers {
        let place = format!("buffers[{index}]");
        let buffer: json::Buffer = document.get("buffers", index, &place)?;
        let bytes = match buffer.uri {
            Some(uri) => uri::fetch(document, &uri, &format!("{place}.uri"))?.0,
            None if index == 0 && chunk.is_some() => chunk.take().unwrap_or_default(),
            None => {
                buffers.push(Vec::new());
                continue;
            }
        };
        if (bytes.len() as u64) < buffer.byte_length.0 {
            return Err(document.invalid(
                format!("{place}.byteLength"),
                format!(
                    "must be at most the {} bytes there are, is {}",
                    bytes.len(),
                    buffer.byte_length.0
                ),
            ));
        }
        buffers.push(bytes);
    }
    Ok(buffers)
}

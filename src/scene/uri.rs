//! Bytes behind a URI: `data:` URIs and files beside the document.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;

use super::document::Document;
use crate::error::{Error, Result};

/// Missing padding and stray bits harm nobody.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// The bytes `uri` stands for, and its media type when it says one. `place` is where it stands in the document.
///
/// # Errors
/// `Io` for a file that cannot be read, `InvalidFile` for a URI that is broken or leaves the disk.
pub(super) fn fetch(
    document: &Document<'_>,
    uri: &str,
    place: &str,
) -> Result<(Vec<u8>, Option<String>)> {
    if let Some(data) = strip_scheme(uri, "data") {
        return decode_data(data).map_err(|reason| document.invalid(place, reason));
    }
    if has_scheme(uri) || uri.starts_with(['/', '\\']) {
        let reason = format!(
            "refers to {}; only data URIs and paths relative to the document are read",
            shortened(uri)
        );
        return Err(document.invalid(place, reason));
    }
    let path = find(document.folder, uri);
    read_file(&path)
        .map(|bytes| (bytes, None))
        .map_err(|source| Error::Io { path, source })
}

/// Reads a regular file. Anything else (a folder, a pipe) is refused, because reading it might never end.
fn read_file(path: &Path) -> io::Result<Vec<u8>> {
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::other("not a file"));
    }
    fs::read(path)
}

/// The file a relative URI names.
///
/// The percent-decoded name comes first, as the specification wants. Exporters that forget to encode a `%`, or that write the
/// separators of Windows, are served by the other readings.
fn find(folder: &Path, uri: &str) -> PathBuf {
    let decoded = percent_decode_str(uri).decode_utf8_lossy();
    let first = folder.join(decoded.as_ref());
    [uri.to_owned(), decoded.replace('\\', "/")]
        .into_iter()
        .map(|name| folder.join(name))
        .find(|path| !first.is_file() && path.is_file())
        .unwrap_or(first)
}

/// Decodes what follows `data:`.
fn decode_data(data: &str) -> std::result::Result<(Vec<u8>, Option<String>), String> {
    let (head, body) = data
        .split_once(',')
        .ok_or("data URI has no comma before its data")?;
    let body: Vec<u8> = percent_decode_str(body).collect();
    let (mime, base64) = match head.strip_suffix(";base64") {
        Some(mime) => (mime, true),
        None => (head, false),
    };
    let bytes = if base64 {
        BASE64.decode(&body).map_err(|_| "data URI is not base64")?
    } else {
        body
    };
    let mime = mime.split(';').next().unwrap_or_default();
    Ok((bytes, (!mime.is_empty()).then(|| mime.to_lowercase())))
}

/// What follows `scheme:`; schemes do not mind case.
fn strip_scheme<'u>(uri: &'u str, scheme: &str) -> Option<&'u str> {
    let (head, rest) = uri.split_once(':')?;
    head.eq_ignore_ascii_case(scheme).then_some(rest)
}

/// Whether `uri` is absolute (RFC 3986 §3.1): `http:…`, `file:…`, also `C:\…`.
fn has_scheme(uri: &str) -> bool {
    uri.split_once(':').is_some_and(|(scheme, _)| {
        scheme.starts_with(|first: char| first.is_ascii_alphabetic())
            && scheme
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || "+-.".contains(c))
    })
}

/// A URI that fits into a message.
fn shortened(uri: &str) -> String {
    const LONGEST: usize = 60;
    match uri.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("\"{}…\"", &uri[..end]),
        None => format!("\"{uri}\""),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris_decode_with_and_without_base64_and_padding() {
        let text =
            |data| decode_data(data).map(|(bytes, _)| String::from_utf8_lossy(&bytes).into_owned());
        assert_eq!(text("text/plain;base64,aGk="), Ok("hi".to_owned()));
        assert_eq!(text("text/plain;base64,aGk"), Ok("hi".to_owned()));
        assert_eq!(text(",h%69"), Ok("hi".to_owned()));
        assert!(text("text/plain;base64,a*k=").is_err());
        assert!(text("text/plain").is_err());
    }

    #[test]
    fn names_with_colons_deep_inside_are_no_schemes() {
        assert!(has_scheme("https://example.com/a.bin"));
        assert!(has_scheme("C:\\a.bin"));
        assert!(!has_scheme("a/b:c.bin"));
        assert!(!has_scheme("ä:b.bin"));
        assert!(!has_scheme("a b.bin"));
    }
}

//! Typed looks into a document, and errors that name the place.
//!
//! Objects are parsed one at a time, when they are needed, with the types of the `gltf` crate: a broken animation or camera then stands in
//! nobody's way, and a fault is told by its place (`accessors[3].count`) instead of a column of a minified line.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

use super::Source;
use crate::error::{Error, Result};

/// A document and its buffers.
#[derive(Clone, Copy)]
pub(super) struct Document<'a> {
    /// File named in errors.
    pub(super) path: &'a Path,
    /// Folder that relative URIs refer to.
    pub(super) folder: &'a Path,
    /// The JSON document.
    pub(super) json: &'a Value,
    /// Bytes of `buffers[i]`; empty for a buffer that has none.
    pub(super) buffers: &'a [Vec<u8>],
}

impl<'a> Document<'a> {
    /// The document in `source`, called `path` in errors.
    pub(super) fn new(path: &'a Path, source: &'a Source) -> Self {
        Self {
            path,
            folder: &source.folder,
            json: &source.json,
            buffers: &source.buffers,
        }
    }

    /// An error about this document.
    pub(super) fn invalid(&self, place: impl Into<String>, reason: impl Into<String>) -> Error {
        Error::InvalidFile {
            path: self.path.to_owned(),
            place: place.into(),
            reason: reason.into(),
        }
    }

    /// An error about an extension that this document cannot be read without.
    pub(super) fn unsupported(&self, feature: &str, advice: &str) -> Error {
        Error::Unsupported {
            path: self.path.to_owned(),
            feature: feature.to_owned(),
            advice: advice.to_owned(),
        }
    }

    /// The top-level array `name`; empty when it is absent.
    pub(super) fn list(&self, name: &str) -> Result<&'a [Value]> {
        match self.json.get(name) {
            None => Ok(&[]),
            Some(Value::Array(list)) => Ok(list),
            Some(_) => Err(self.invalid(name, "must be an array")),
        }
    }

    /// Element `index` of the top-level array `name`; `from` is the place that refers to it.
    pub(super) fn value(&self, name: &str, index: usize, from: &str) -> Result<&'a Value> {
        let list = self.list(name)?;
        list.get(index).ok_or_else(|| {
            self.invalid(
                from,
                format!("refers to {name}[{index}], but there are {}", list.len()),
            )
        })
    }

    /// Like [`Document::value`], parsed.
    pub(super) fn get<T: DeserializeOwned>(
        &self,
        name: &str,
        index: usize,
        from: &str,
    ) -> Result<T> {
        let value = self.value(name, index, from)?;
        self.parse(value, || format!("{name}[{index}]"))
    }

    /// Parses `value`, which stands at `place`.
    pub(super) fn parse<T: DeserializeOwned>(
        &self,
        value: &Value,
        place: impl Fn() -> String,
    ) -> Result<T> {
        T::deserialize(value)
            .or_else(|_| T::deserialize(whole_numbers(value)))
            .map_err(|error| {
                let reason = error.to_string();
                let place = match culprit::<T>(value, &reason) {
                    Some(key) => format!("{}.{key}", place()),
                    None => place(),
                };
                self.invalid(place, reason)
            })
    }
}

/// The same value with `24.0` written as `24`: some exporters write every number as a float, and most engines do not mind.
fn whole_numbers(value: &Value) -> Value {
    match value {
        Value::Array(list) => list.iter().map(whole_numbers).collect(),
        Value::Object(map) => map
            .iter()
            .map(|(key, value)| (key.clone(), whole_numbers(value)))
            .collect::<serde_json::Map<_, _>>()
            .into(),
        Value::Number(number) => match number.as_f64() {
            // Above 2^53 floats are no longer exact counts.
            Some(float) if float.fract() == 0.0 && (0.0..9e15).contains(&float) => {
                Value::from(float as u64)
            }
            _ => value.clone(),
        },
        _ => value.clone(),
    }
}

/// The key of an object that cannot be parsed as `T`: the one without which the complaint changes.
fn culprit<'v, T: DeserializeOwned>(value: &'v Value, reason: &str) -> Option<&'v str> {
    let map = value.as_object()?;
    map.keys().map(String::as_str).find(|key| {
        let mut rest = map.clone();
        rest.remove(*key);
        match T::deserialize(whole_numbers(&Value::Object(rest))) {
            Ok(_) => true,
            Err(error) => error.to_string() != reason,
        }
    })
}

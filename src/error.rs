//! Why a bake did not happen, and what was odd about one that did.

use std::fmt;
use std::path::PathBuf;

/// Why a bake did not happen.
///
/// One variant per party that has to act: the disk, the author of the scene, the author of the options, or nobody (the user stopped
/// it). Degenerate geometry is not an error: it is dropped and counted in [`Warnings`].
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written.
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file contradicts itself or its specification.
    InvalidFile {
        /// The file.
        path: PathBuf,
        /// Where in it, as a path through the document (`meshes[3].primitives[0]`); empty for the whole file.
        place: String,
        /// What is wrong and what the limit is, lower case, without a full stop.
        reason: String,
    },
    /// A file is valid and needs something lumel does not read.
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The feature by its registered name (`KHR_draco_mesh_compression`).
        feature: String,
        /// What removes it (`gltf-transform copy in.glb out.glb`); empty when nothing does.
        advice: String,
    },
    /// An option is out of its documented range.
    InvalidOption {
        /// The option as the command spells it, without dashes: `texels-per-metre`.
        option: &'static str,
        /// The allowed range and the value given.
        reason: String,
    },
    /// The bake needs more than its limits allow.
    TooLarge {
        /// What is too large, how large it is, the limit, and which option lowers it.
        reason: String,
    },
    /// The caller set the cancel flag.
    Interrupted,
}

/// Result with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io { path, source } => write!(f, "{}: {source}", path.display()),
            Self::InvalidFile {
                path,
                place,
                reason,
            } if place.is_empty() => write!(f, "{}: {reason}", path.display()),
            Self::InvalidFile {
                path,
                place,
                reason,
            } => write!(f, "{}: {place}: {reason}", path.display()),
            Self::Unsupported {
                path,
                feature,
                advice,
            } if advice.is_empty() => {
                write!(
                    f,
                    "{}: requires {feature}, which lumel does not read",
                    path.display()
                )
            }
            Self::Unsupported {
                path,
                feature,
                advice,
            } => write!(
                f,
                "{}: requires {feature}, which lumel does not read; remove it with: {advice}",
                path.display()
            ),
            Self::InvalidOption { option, reason } => write!(f, "--{option}: {reason}"),
            Self::TooLarge { reason } => f.write_str(reason),
            Self::Interrupted => f.write_str("interrupted"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io { source, .. } => Some(source),
            _ => None,
        }
    }
}

/// One kind of oddity that was met, how often, and where first.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Warning {
    /// What is odd and what was done about it, lower case, without a full stop. The same words for every occurrence.
    pub what: String,
    /// How often it was met.
    pub count: usize,
    /// The first places, at most [`Warnings::MAX_PLACES`].
    pub places: Vec<String>,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)?;
        if self.count > 1 {
            write!(f, " ({} times)", self.count)?;
        }
        for (index, place) in self.places.iter().enumerate() {
            f.write_str(if index == 0 { ": " } else { ", " })?;
            f.write_str(place)?;
        }
        if self.count > self.places.len() && !self.places.is_empty() {
            f.write_str(", …")?;
        }
        Ok(())
    }
}

/// Oddities collected by a stage, one entry per kind, in the order they were first met.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(transparent)]
pub struct Warnings {
    list: Vec<Warning>,
}

impl Warnings {
    /// Places kept per kind. More would bury the message; the count says how many there are.
    pub const MAX_PLACES: usize = 3;

    /// Counts one occurrence of `what` at `place` (a path through the document, may be empty).
    pub fn push(&mut self, what: &str, place: impl Into<String>) {
        self.push_many(what, place, 1);
    }

    /// Counts `count` occurrences of `what` at `place`; does nothing when `count` is 0.
    pub fn push_many(&mut self, what: &str, place: impl Into<String>, count: usize) {
        if count == 0 {
            return;
        }
        let index = self
            .list
            .iter()
            .position(|warning| warning.what == what)
            .unwrap_or_else(|| {
                self.list.push(Warning {
                    what: what.to_owned(),
                    count: 0,
                    places: Vec::new(),
                });
                self.list.len() - 1
            });
        let warning = &mut self.list[index];
        warning.count += count;
        let place = place.into();
        if !place.is_empty() && warning.places.len() < Self::MAX_PLACES {
            warning.places.push(place);
        }
    }

    /// Appends everything `other` collected.
    pub fn extend(&mut self, other: Self) {
        for warning in other.list {
            let mut places = warning.places.into_iter();
            self.push_many(
                &warning.what,
                places.next().unwrap_or_default(),
                warning.count,
            );
            for place in places {
                if let Some(kept) = self.list.iter_mut().find(|kept| kept.what == warning.what)
                    && kept.places.len() < Self::MAX_PLACES
                {
                    kept.places.push(place);
                }
            }
        }
    }

    /// All kinds, in the order they were first met.
    pub fn iter(&self) -> std::slice::Iter<'_, Warning> {
        self.list.iter()
    }

    /// Whether nothing odd was met.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }
}

impl<'a> IntoIterator for &'a Warnings {
    type Item = &'a Warning;
    type IntoIter = std::slice::Iter<'a, Warning>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

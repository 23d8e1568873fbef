//! The light of a page in the layouts that engines already read.
//!
//! Each is a pure repacking, texel by texel, of what the maps hold; `tests/engine.rs` evaluates every one with its engine's own formula.
//! All are less than the light vector and the fluence: two numbers per colour channel for a direction are shared or quantised, or the
//! engine's formula is a low-order one. The loss is the engine's, not the bake's.
//!
//! | layout              | files                              | at the normal n the engine shows E/π =                     |
//! |---------------------|------------------------------------|------------------------------------------------------------|
//! | `bakery-sh`         | L0, L1x, L1y, L1z                  | φ/4π + G·n/2π, or its own non-linear formula of the same    |
//! | `godot-sh`          | one, 4 slices from the top down    | φ/4π + G·n/2π                                              |
//! | `unity-directional` | color, dir                         | E(N)/π · (1 + d·n) / (1 + d·N)                             |
//! | `bevy`              | one                                | E(N)/π                                                     |
//!
//! N is the normal that was baked and d one direction for all colours. Unity is left-handed: its importers of glTF mirror x, so do the
//! vectors of its two layouts. The others keep glTF's axes. Pictures are upright as in glTF: their top row is v = 0 there.

mod bakery;

mod bevy;

mod godot;

mod unity;

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use crate::error::{Error, Result};
use crate::output::dilate::EMPTY;
use crate::output::ktx2;
use crate::refine::{Field, Plane};

/// A layout of light that an engine reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Export {
    /// Bakery's SH maps for Unity.
    BakerySh,
    /// Godot's directional `LightmapGI`.
    GodotSh,
    /// Unity's own directional mode.
    UnityDirectional,
    /// Bevy's `Lightmap`.
    Bevy,
}

impl Export {
    /// Whether it is made of the light vector and the fluence.
    #[must_use]
    pub fn needs_light_vector(self) -> bool {
        self != Self::Bevy
    }

    /// Whether it is made of the irradiance.
    #[must_use]
    pub fn needs_irradiance(self) -> bool {
        matches!(self, Self::UnityDirectional | Self::Bevy)
    }
}

/// One picture of an export.
#[derive(Debug)]
pub(super) struct Picture {
    /// Ending of the file name, as the name of a plane.
    pub(super) name: &'static str,
    /// Numbers per pixel.
    pub(super) components: usize,
    /// One above the other, each with the numbers of every covered texel in the order of [`Field::places`].
    pub(super) slices: Vec<Vec<f32>>,
    pub(super) kind: Kind,
}

/// How a picture is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// `.exr`, numbers of any size.
    Exr,
    /// `.png` with 16 bits, numbers in 0..=1, straight alpha.
    Png,
}

/// The light of one texel.
struct Texel {
    /// By colour channel.
    g: [[f32; 3]; 3],
    phi: [f32; 3],
}

/// The pictures of `export`; `None` when the field lacks a plane.
pub(super) fn pictures(export: Export, field: &Field) -> Option<Vec<Picture>> {
    let irradiance = field.planes.iter().find(|plane| plane.name == "E");
    Some(match export {
        Export::Bevy => vec![bevy::picture(irradiance?)],
        Export::BakerySh => bakery::pictures(&texels(field)?),
        Export::GodotSh => vec![godot::picture(&texels(field)?)],
        Export::UnityDirectional => unity::pictures(&texels(field)?, irradiance?),
    })
}

fn texels(field: &Field) -> Option<Vec<Texel>> {
    let light = ktx2::Light::of(field)?;
    let at = |plane: &Plane, texel: usize| [0, 1, 2].map(|k| plane.values[3 * texel + k]);
    Some(
        (0..field.places.len())
            .map(|texel| Texel {
                g: light.vectors.map(|plane| at(plane, texel)),
                phi: at(light.fluence, texel),
            })
            .collect(),
    )
}

/// L0 of a texel in E/π: the mean over all normals of what linear spherical harmonics of first order show.
fn mean(texel: &Texel) -> [f32; 3] {
    texel
        .phi
        .map(|phi| phi * (0.25 * std::f32::consts::FRAC_1_PI))
}

/// G/φ along an axis, by colour channel: in −1..=1. 0 in the dark.
fn ratio(texel: &Texel, axis: usize) -> [f32; 3] {
    [0, 1, 2].map(|channel| {
        let phi = texel.phi[channel];
        if phi > 0.0 {
            (texel.g[channel][axis] / phi).clamp(-1.0, 1.0)
        } else {
            0.0
        }
    })
}

/// Writes `plane`, four numbers in 0..=1 per texel, to the file at `path`, which must not exist. Texels without a source are 0.
pub(super) fn write_png(path: &Path, page: &Field, plane: &Plane, sources: &[u32]) -> Result<()> {
    let mut bytes = Vec::with_capacity(8 * sources.len());
    for &source in sources {
        for component in 0..4 {
            let value = match source {
                EMPTY => 0.0,
                source => plane.values[4 * source as usize + component],
            };
            let stored = (value.clamp(0.0, 1.0) * 65535.0).round() as u16;
            // The encoder takes samples as they lie in memory and turns them around itself.
            bytes.extend(stored.to_ne_bytes());
        }
    }
    let written = File::create_new(path).and_then(|file| {
        let mut file = BufWriter::new(file);
        PngEncoder::new(&mut file)
            .write_image(&bytes, page.width, page.height, ExtendedColorType::Rgba16)
            .map_err(|error| match error {
                image::ImageError::IoError(source) => source,
                other => io::Error::other(other),
            })?;
        file.flush()
    });
    written.map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })
}

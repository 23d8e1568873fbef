//! One plane → one `OpenEXR` file. The only place that knows the `exr` crate.
//!
//! Single part, scan lines from the top row down, ZIP over 16 lines, channels literally `R`, `G`, `B` (or `Y`): every reader we know
//! understands that, three's `EXRLoader` no more than that. ZIP is lossless and reads fastest; DWA is read wrongly by some.
//!
//! The same values give the same bytes: there is no date, and exactly one attribute of our own, because the crate writes several in
//! a random order. It is called `lumel` and holds a JSON object with `version`, `plane`, `unit`, `space` and `rows`.

use std::fs::File;
use std::io;
use std::io::{BufWriter, Write};
use std::path::Path;

use exr::compression::Compression;
use exr::error::UnitResult;
use exr::image::write::WritableImage;
use exr::image::{Blocks, Encoding, Image, IntoSample, Layer, SpecificChannels};
use exr::math::Vec2;
use exr::meta::attribute::{AttributeValue, LineOrder, Text};
use exr::meta::header::LayerAttributes;
use half::f16;

use crate::error::{Error, Result};
use crate::output::dilate::EMPTY;
use crate::refine::{Field, Plane};

/// What every reader understands, without loss.
const ENCODING: Encoding = Encoding {
    compression: Compression::ZIP16,
    blocks: Blocks::ScanLines,
    line_order: LineOrder::Increasing,
};

/// Name of the attribute that says what the numbers are.
const ATTRIBUTE: &str = "lumel";

/// How the numbers of a file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Precision {
    /// 16 bits.
    Half,
    /// 32 bits.
    Float,
}

impl Precision {
    /// Half when every value fits and is rounded by at most `tolerance` times the largest magnitude, else float.
    pub(super) fn sufficient_for(values: &[f32], tolerance: f64) -> Self {
        let largest = values
            .iter()
            .fold(0.0_f32, |max, value| max.max(value.abs()));
        if largest > f16::MAX.to_f32() {
            return Self::Float;
        }
        // A half has 11 significant bits, and steps of 2⁻²⁴ below 2⁻¹⁴: nothing is rounded by more than 2⁻¹¹ of the largest value
        // unless that is tiny too, so with ordinary tolerances no value has to be looked at.
        let bound = 0.5_f64.powi(11);
        if tolerance >= bound && f64::from(largest) >= 0.5_f64.powi(14) {
            return Self::Half;
        }
        let accepted = tolerance * f64::from(largest);
        let fits = values
            .iter()
            .all(|&value| f64::from((f16::from_f32(value).to_f32() - value).abs()) <= accepted);
        if fits { Self::Half } else { Self::Float }
    }

    /// As the manifest spells it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Half => "half",
            Self::Float => "float",
        }
    }

    /// What is read back where `value` was written.
    pub(super) fn stored(self, value: f32) -> f32 {
        match self {
            Self::Half => f16::from_f32(value).to_f32(),
            Self::Float => value,
        }
    }
}

/// Writes `plane` of `field` to the file at `path`, which must not exist. Texels without a source are 0.
///
/// `sources` has one index into [`Field::places`] per texel of the page, row by row.
pub(super) fn write(
    path: &Path,
    field: &Field,
    plane: &Plane,
    sources: &[u32],
    precision: Precision,
) -> Result<()> {
    debug_assert!(
        plane.values.iter().all(|value| value.is_finite()),
        "plane {} has a value that is not finite",
        plane.name
    );
    let image = Page {
        size: Vec2(field.width as usize, field.height as usize),
        plane,
        sources,
    };
    let written = match (precision, plane.components) {
        (Precision::Half, 1) => image.write_grey(path, f16::from_f32),
        (Precision::Half, _) => image.write_color(path, f16::from_f32),
        (Precision::Float, 1) => image.write_grey(path, |value| value),
        (Precision::Float, _) => image.write_color(path, |value| value),
    };
    written.map_err(|source| Error::Io {
        path: path.to_owned(),
        source: to_io(source),
    })
}

/// Reads width, height and the `R`, `G`, `B` channels of a file that [`write`] made, row by row.
pub(super) fn read_color(path: &Path) -> Result<(u32, u32, Vec<[f32; 3]>)> {
    use exr::image::read::image::ReadLayers;
    use exr::image::read::layers::ReadChannels;
    use exr::image::read::specific_channels::ReadSpecificChannel;

    exr::image::read::read()
        .no_deep_data()
        .largest_resolution_level()
        .specific_channels()
        .required::<f32>("R")
        .required::<f32>("G")
        .required::<f32>("B")
        .collect_pixels(
            |size, _| (size.0, vec![[0.0; 3]; size.area()]),
            |(width, pixels), place, (r, g, b)| pixels[place.1 * *width + place.0] = [r, g, b],
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_file(path)
        .map(|image| {
            let size = image.layer_data.size;
            (
                size.0 as u32,
                size.1 as u32,
                image.layer_data.channel_data.pixels.1,
            )
        })
        .map_err(|source| Error::Io {
            path: path.to_owned(),
            source: to_io(source),
        })
}

/// A plane seen as a picture.
struct Page<'a> {
    size: Vec2<usize>,
    plane: &'a Plane,
    sources: &'a [u32],
}

impl Page<'_> {
    fn value(&self, place: Vec2<usize>, component: usize) -> f32 {
        match self.sources[place.1 * self.size.0 + place.0] {
            EMPTY => 0.0,
            source => self.plane.values[source as usize * self.plane.components + component],
        }
    }

    fn write_grey<S: IntoSample>(&self, path: &Path, convert: fn(f32) -> S) -> UnitResult {
        let channels = SpecificChannels::build()
            .with_channel::<S>("Y")
            .with_pixel_fn(|place| (convert(self.value(place, 0)),));
        let layer = Layer::new(self.size, self.attributes(), ENCODING, channels);
        let image = Image::from_layer(layer);
        save(path, |file| image.write().non_parallel().to_buffered(file))
    }

    fn write_color<S: IntoSample>(&self, path: &Path, convert: fn(f32) -> S) -> UnitResult {
        let channels = SpecificChannels::build()
            .with_channel::<S>("R")
            .with_channel::<S>("G")
            .with_channel::<S>("B")
            .with_pixel_fn(|place| {
                let [r, g, b] = [0, 1, 2].map(|component| convert(self.value(place, component)));
                (r, g, b)
            });
        let layer = Layer::new(self.size, self.attributes(), ENCODING, channels);
        let image = Image::from_layer(layer);
        // The planes of a page are written side by side on the threads of the bake; the crate's own threads would be too many.
        save(path, |file| image.write().non_parallel().to_buffered(file))
    }

    fn attributes(&self) -> LayerAttributes {
        let mut attributes = LayerAttributes::default();
        attributes.other.insert(
            Text::from(ATTRIBUTE),
            AttributeValue::Text(Text::from(self.description().as_str())),
        );
        attributes
    }

    /// ASCII only, as the attribute requires.
    fn description(&self) -> String {
        let name = self.plane.name;
        let is_vector = name.starts_with('G');
        let is_derivative = name.ends_with("_du") || name.ends_with("_dv");
        serde_json::json!({
            "version": 1,
            "plane": name,
            "unit": if is_derivative { "lux per texel" } else { "lux" },
            "space": if is_vector { "world" } else { "none" },
            "rows": "top first",
        })
        .to_string()
    }
}

/// Makes the file at `path` and lets `write` fill it.
fn save(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> UnitResult) -> UnitResult {
    let mut file = BufWriter::new(File::create_new(path)?);
    write(&mut file)?;
    file.flush()?;
    Ok(())
}

fn to_io(error: exr::error::Error) -> io::Error {
    match error {
        exr::error::Error::Io(source) => source,
        other => io::Error::other(other.to_string()),
    }
}

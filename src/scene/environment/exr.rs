//! `OpenEXR` pictures: file → pixels.
//!
//! The crate allocates what a header promises, and a promise of terabytes ends the process. So the headers are read and bounded first.

use std::fs::File;
use std::io::BufReader;
use std::panic;
use std::path::Path;

use exr::error::Error as ExrError;
use exr::image::FlatSamples;
use exr::image::read::image::ReadLayers as _;
use exr::image::read::layers::ReadChannels as _;
use exr::meta::MetaData;
use exr::meta::attribute::EnvironmentMap;
use exr::meta::header::Header;

use super::{Decoded, MAX_BYTES, Mistake, check_size, invalid, unsupported};
use crate::error::{Error, Result, Warnings};

/// The first bytes of every such file.
pub(super) const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Where the colours are: a layer, and its channels for red, green and blue.
struct Choice {
    layer: usize,
    channels: [usize; 3],
}

/// Decodes the file at `path`.
pub(super) fn decode(path: &Path, warnings: &mut Warnings) -> Result<Decoded> {
    // A bug in a decoder must not end the bake. Nothing is shared with it, so nothing can be left half done.
    let guarded = panic::catch_unwind(|| {
        let headers = MetaData::read_from_buffered(open(path)?, false)
            .map_err(|error| foreign(path, "header", error))?
            .headers;
        let choice = choose(path, &headers)?;
        let pixels = pixels(path, &choice)?;
        Ok((headers, choice, pixels))
    });
    let (headers, choice, pixels) = guarded
        .unwrap_or_else(|_| Err(invalid(path, Mistake::new("", "makes the decoder fail"))))?;
    let header = &headers[choice.layer];
    if headers.len() > 1 {
        let name = header.own_attributes.layer_name.as_ref();
        warnings.push(
            "picture has several layers, one is taken",
            name.map_or_else(|| format!("layer {}", choice.layer), ToString::to_string),
        );
    }
    if header.shared_attributes.display_window.size != header.layer_size {
        warnings.push(
            "picture has a data window of its own, stretched over the whole sphere",
            "",
        );
    }
    Ok(pixels)
}

fn open(path: &Path) -> Result<BufReader<File>> {
    File::open(path)
        .map(BufReader::new)
        .map_err(|source| Error::Io {
            path: path.to_owned(),
            source,
        })
}

/// Bounds what `headers` promise and finds the colours.
fn choose(path: &Path, headers: &[Header]) -> Result<Choice> {
    let mut n_bytes = 0_u64;
    for header in headers {
        if header.deep {
            return Err(unsupported(path, "deep data", "exrflatten"));
        }
        if header.own_attributes.environment_map == Some(EnvironmentMap::Cube) {
            return Err(unsupported(path, "a cube map", "exrenvmap -latlong"));
        }
        let size = header.layer_size;
        let (width, height) = check_size(path, size.0 as u64, size.1 as u64)?;
        n_bytes = u64::from(width)
            .saturating_mul(u64::from(height))
            .saturating_mul(header.channels.bytes_per_pixel as u64)
            .saturating_add(n_bytes);
    }
    if n_bytes > MAX_BYTES {
        return Err(Error::TooLarge {
            reason: format!(
                "{}: header: all channels have {n_bytes} bytes, the limit is {MAX_BYTES}",
                path.display()
            ),
        });
    }
    let choices = || headers.iter().enumerate();
    let found = choices()
        .find_map(|(layer, header)| channels(header, "").map(|channels| Choice { layer, channels }))
        .or_else(|| {
            choices().find_map(|(layer, header)| {
                header.channels.list.iter().find_map(|channel| {
                    let name = channel.name.to_string();
                    let prefix = &name[..=name.rfind('.')?];
                    channels(header, prefix).map(|channels| Choice { layer, channels })
                })
            })
        })
        .or_else(|| {
            choices()
                .find_map(|(layer, header)| grey(header).map(|channels| Choice { layer, channels }))
        });
    let choice = found.ok_or_else(|| {
        let names: Vec<String> = headers
            .iter()
            .flat_map(|header| &header.channels.list)
            .take(8)
            .map(|channel| channel.name.to_string())
            .collect();
        invalid(
            path,
            Mistake::new(
                "channels",
                format!("must be R, G, B or Y, are {}", names.join(", ")),
            ),
        )
    })?;
    for channel in choice.channels {
        let channel = &headers[choice.layer].channels.list[channel];
        if channel.sampling != exr::math::Vec2(1, 1) {
            return Err(invalid(
                path,
                Mistake::new(
                    format!("channel {}", channel.name),
                    "has fewer samples than pixels",
                ),
            ));
        }
    }
    Ok(choice)
}

/// Indices of `<prefix>R`, `<prefix>G`, `<prefix>B`, whatever their case.
fn channels(header: &Header, prefix: &str) -> Option<[usize; 3]> {
    let find = |letter: &str| {
        let wanted = format!("{prefix}{letter}");
        header
            .channels
            .list
            .iter()
            .position(|channel| channel.name.to_string().eq_ignore_ascii_case(&wanted))
    };
    Some([find("R")?, find("G")?, find("B")?])
}

/// Index of the channel `Y`, three times.
fn grey(header: &Header) -> Option<[usize; 3]> {
    let index = header.channels.list.iter().position(|channel| {
        let name = channel.name.to_string();
        let name = name.rsplit('.').next().unwrap_or_default();
        name.eq_ignore_ascii_case("Y")
    })?;
    Some([index; 3])
}

fn pixels(path: &Path, choice: &Choice) -> Result<Decoded> {
    let image = exr::image::read::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(open(path)?)
        .map_err(|error| foreign(path, "pixels", error))?;
    let lost = || invalid(path, Mistake::new("pixels", "do not fit the header"));
    let layer = image.layer_data.get(choice.layer).ok_or_else(lost)?;
    let planes = choice.channels.map(|index| {
        layer
            .channel_data
            .list
            .get(index)
            .map(|channel| &channel.sample_data)
    });
    let [Some(red), Some(green), Some(blue)] = planes else {
        return Err(lost());
    };
    let n_pixels = layer.size.area();
    if [red, green, blue]
        .iter()
        .any(|plane| plane.len() != n_pixels)
    {
        return Err(lost());
    }
    Ok(Decoded {
        width: layer.size.0 as u32,
        height: layer.size.1 as u32,
        pixels: (0..n_pixels)
            .map(|index| [red, green, blue].map(|plane| value(plane, index)))
            .collect(),
    })
}

fn value(plane: &FlatSamples, index: usize) -> f32 {
    match plane {
        FlatSamples::F16(values) => values[index].to_f32(),
        FlatSamples::F32(values) => values[index],
        FlatSamples::U32(values) => values[index] as f32,
    }
}

fn foreign(path: &Path, place: &str, error: ExrError) -> Error {
    match error {
        ExrError::Io(source) if source.kind() != std::io::ErrorKind::UnexpectedEof => Error::Io {
            path: path.to_owned(),
            source,
        },
        ExrError::Io(_) => invalid(path, Mistake::new(place, "end early")),
        other => invalid(path, Mistake::new(place, other.to_string())),
    }
}

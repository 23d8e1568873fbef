//! Tone-mapped irradiance as PNG, for people.
//!
//! All pages of a bake share one exposure, so that they can be compared: `value = 1 − exp(−k·E)` per channel, stored as sRGB, with k
//! such that the 99th percentile of the luminance of lit texels becomes 0.9. The curve keeps order, has no limit above and no
//! parameter besides k. The percentile comes from a histogram, so no page is held in memory: once the whole bake is known, each map
//! of E is read back from the disk.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rayon::iter::{IndexedParallelIterator, ParallelIterator};
use rayon::slice::{ParallelSlice, ParallelSliceMut};

use crate::error::{Error, Result};

/// Luminance of linear Rec. 709 primaries (ITU-R BT.709).
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The share of lit texels that stays below [`BRIGHT`]. With a larger one a few texels right beside a lamp darken the whole picture,
/// with a smaller one whole surfaces burn out.
const PERCENTILE: f64 = 0.99;

/// What the percentile becomes. Nearer to 1 flattens the bright end, farther away leaves the top of the range to very few texels.
const BRIGHT: f64 = 0.9;

/// Bits of a float's mantissa that tell bins apart: 16 bins per doubling, 4 % wide, below what an eye sees in brightness.
const MANTISSA_BITS: u32 = 4;

/// How often each luminance occurs over all pages of a bake. Counts are whole numbers: the order of pages does not matter.
#[derive(Debug)]
pub(super) struct Histogram {
    counts: Vec<u64>,
}

impl Histogram {
    pub(super) fn new() -> Self {
        Self {
            counts: vec![0; 1 << (8 + MANTISSA_BITS)],
        }
    }

    /// Counts the lit texels of one page; `irradiance` has three numbers per texel.
    pub(super) fn add(&mut self, irradiance: &[f32]) {
        for texel in irradiance.chunks_exact(3) {
            let luminance: f64 = texel
                .iter()
                .zip(LUMINANCE)
                .map(|(&value, weight)| f64::from(value) * weight)
                .sum();
            let luminance = luminance as f32;
            if luminance > 0.0 {
                // The bits of a positive float, read as a number, ascend with it.
                self.counts[(luminance.to_bits() >> (23 - MANTISSA_BITS)) as usize] += 1;
            }
        }
    }

    /// k of the tone curve, per lux. 1 when nothing is lit.
    pub(super) fn exposure(&self) -> f64 {
        let lit: u64 = self.counts.iter().sum();
        let rank = (lit as f64 * PERCENTILE) as u64;
        let mut below = 0;
        for (bin, &count) in self.counts.iter().enumerate() {
            below += count;
            if below > rank {
                let upper = f32::from_bits((bin as u32 + 1) << (23 - MANTISSA_BITS));
                return -(1.0 - BRIGHT).ln() / f64::from(upper.min(f32::MAX));
            }
        }
        1.0
    }
}

/// Writes the preview of a page: `pixels` are irradiances row by row, `exposure` is that of the bake.
pub(super) fn write(path: &Path, size: [u32; 2], pixels: &[[f32; 3]], exposure: f64) -> Result<()> {
    /// Pixels per job; anything from a row upwards keeps the overhead out of sight.
    const RUN: usize = 1 << 14;
    let mut bytes = vec![0; 3 * pixels.len()];
    bytes
        .par_chunks_mut(3 * RUN)
        .zip(pixels.par_chunks(RUN))
        .for_each(|(bytes, pixels)| {
            for (byte, &value) in bytes.iter_mut().zip(pixels.as_flattened()) {
                *byte = tone(f64::from(value) * exposure);
            }
        });
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let mut file = BufWriter::new(File::create_new(path).map_err(io)?);
    PngEncoder::new(&mut file)
        .write_image(&bytes, size[0], size[1], ExtendedColorType::Rgb8)
        .map_err(|error| match error {
            image::ImageError::IoError(source) => io(source),
            other => io(std::io::Error::other(other)),
        })?;
    file.flush().map_err(io)
}

/// sRGB byte (IEC 61966-2-1) of an exposed value.
fn tone(exposed: f64) -> u8 {
    let linear = 1.0 - (-exposed.max(0.0)).exp();
    let encoded = if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    (255.0 * encoded).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_glaring_texels_do_not_set_the_exposure() {
        let mut histogram = Histogram::new();
        let mut page = vec![2.0; 3 * 1000];
        page[..9].fill(1e6);
        histogram.add(&page);
        histogram.add(&vec![0.0; 3 * 5000]);
        let bright = 1.0 - (-2.0 * histogram.exposure()).exp();
        // The bin that holds 2 is 2/16 wide.
        assert!((0.88..=0.9).contains(&bright), "2 lux becomes {bright}");
    }

    #[test]
    fn darkness_is_black_at_any_exposure() {
        let mut histogram = Histogram::new();
        histogram.add(&[0.0; 30]);
        assert_eq!(histogram.exposure().to_bits(), 1.0_f64.to_bits());
        assert_eq!(tone(0.0), 0);
        assert_eq!(tone(f64::INFINITY), 255);
    }
}

//! Radiance pictures: bytes → pixels.
//!
//! A pixel is three mantissas and one exponent: `value = mantissa · 2^(exponent − 136)`. Radiance's own reader adds half a step to the
//! mantissa; the viewers do not, and neither do we. A file is a text header, a line with the size, and scan lines: flat, with old run
//! lengths (a pixel `1 1 1 n` repeats the one before it), or with new ones (channel by channel, `n > 128` is a run of `n − 128`).
//!
//! Flat pixels may look like old run lengths. A file with exactly four bytes per pixel is flat.
//!
//! Source: G. Ward, "The RADIANCE Picture File Format" and "Real Pixels", Graphics Gems II, 1991.

use std::path::Path;

use super::{Decoded, Mistake, check_size, invalid, unsupported};
use crate::error::{Result, Warnings};

/// Longest header, in bytes. Real ones have some hundred; without a limit a file of blanks is searched to its end.
const MAX_HEADER: usize = 1 << 16;

/// Widths of scan lines that may have new run lengths.
const NEW_WIDTHS: std::ops::RangeInclusive<usize> = 8..=32767;

struct Header {
    /// What stored values are divided by, per channel.
    divisor: [f64; 3],
    order: Order,
}

/// How pixels follow each other.
struct Order {
    width: u32,
    height: u32,
    /// Scan lines are columns.
    by_columns: bool,
    /// The first row is the bottom one.
    from_bottom: bool,
    /// The first column is the right one.
    from_right: bool,
}

/// Decodes the file `bytes`, which starts with `#?`.
pub(super) fn decode(bytes: &[u8], path: &Path, warnings: &mut Warnings) -> Result<Decoded> {
    let (header, data) = header(bytes, path, warnings)?;
    let order = header.order;
    let (width, height) = (order.width as usize, order.height as usize);
    let (n_scans, length) = if order.by_columns {
        (width, height)
    } else {
        (height, width)
    };
    let packed = scans(data, n_scans, length).map_err(|mistake| invalid(path, mistake))?;
    let steps: Vec<f64> = (0..256)
        .map(|exponent| {
            if exponent == 0 {
                0.0
            } else {
                f64::powi(2.0, exponent - 136)
            }
        })
        .collect();
    let pixel = |scan: usize, along: usize| {
        let [r, g, b, exponent] = packed[scan * length + along];
        let step = steps[usize::from(exponent)];
        let [x, y, z] = header.divisor;
        [
            (f64::from(r) * step / x) as f32,
            (f64::from(g) * step / y) as f32,
            (f64::from(b) * step / z) as f32,
        ]
    };
    let mut pixels = Vec::with_capacity(width * height);
    for row in 0..height {
        let row = if order.from_bottom {
            height - 1 - row
        } else {
            row
        };
        pixels.extend((0..width).map(|column| {
            let column = if order.from_right {
                width - 1 - column
            } else {
                column
            };
            if order.by_columns {
                pixel(column, row)
            } else {
                pixel(row, column)
            }
        }));
    }
    Ok(Decoded {
        width: order.width,
        height: order.height,
        pixels,
    })
}

/// Reads the header; returns it and the bytes behind it.
fn header<'a>(bytes: &'a [u8], path: &Path, warnings: &mut Warnings) -> Result<(Header, &'a [u8])> {
    let wrong = |place: &str, reason: String| invalid(path, Mistake::new(place, reason));
    let mut rest = bytes;
    let mut divisor = [1.0; 3];
    loop {
        let before = bytes.len() - rest.len();
        let line =
            line(&mut rest, before).ok_or_else(|| wrong("header", "has no end".to_owned()))?;
        if line.is_empty() {
            break;
        }
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let numbers: Vec<f64> = value
            .split_whitespace()
            .map_while(|number| number.parse().ok())
            .collect();
        let are_factors = numbers
            .iter()
            .all(|number: &f64| number.is_finite() && *number > 0.0);
        match (key.trim(), numbers.as_slice()) {
            ("FORMAT", _) if value.trim() == "32-bit_rle_xyze" => {
                return Err(unsupported(path, "FORMAT=32-bit_rle_xyze", "ra_xyze -r"));
            }
            ("FORMAT", _) if value.trim() != "32-bit_rle_rgbe" => {
                return Err(wrong(
                    "header",
                    format!(
                        "FORMAT must be 32-bit_rle_rgbe, is {:.40}",
                        value.trim().escape_debug()
                    ),
                ));
            }
            ("EXPOSURE", &[exposure]) if are_factors => {
                divisor = divisor.map(|factor| factor * exposure);
                warnings.push("EXPOSURE of the header is divided out", value.trim());
            }
            ("COLORCORR", &[r, g, b]) if are_factors => {
                divisor = [divisor[0] * r, divisor[1] * g, divisor[2] * b];
                warnings.push("COLORCORR of the header is divided out", value.trim());
            }
            ("EXPOSURE" | "COLORCORR", _) => {
                warnings.push("line of the header makes no sense, left out", key.trim());
            }
            ("GAMMA", &[gamma]) if gamma != 1.0 => {
                warnings.push(
                    "GAMMA of the header is not 1; values are taken as linear",
                    value.trim(),
                );
            }
            // Zeros are what a common picture editor writes.
            ("PRIMARIES", numbers) if !is_rec_709(numbers) => {
                warnings.push(
                    "PRIMARIES of the header are not those of Rec. 709; not converted",
                    value.trim(),
                );
            }
            _ => {}
        }
    }
    let size = line(&mut rest, 0).ok_or_else(|| wrong("size", "is missing".to_owned()))?;
    let order = order(&size, path)?;
    Ok((Header { divisor, order }, rest))
}

fn is_rec_709(primaries: &[f64]) -> bool {
    const REC_709: [f64; 8] = [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329];
    // Radiance's own default white is (1/3, 1/3), and its primaries are rounded otherwise; all that is one display.
    primaries.iter().all(|&number| number == 0.0)
        || primaries.len() == 8
            && primaries
                .iter()
                .zip(REC_709)
                .all(|(number, standard)| (number - standard).abs() < 0.021)
}

/// Takes the next line off `rest`, without its end; `None` when there is none, or when it ends more than [`MAX_HEADER`] after `before`
/// bytes.
fn line(rest: &mut &[u8], before: usize) -> Option<String> {
    let searched = rest.len().min(MAX_HEADER.saturating_sub(before));
    let end = rest[..searched].iter().position(|&byte| byte == b'\n')?;
    let line = String::from_utf8_lossy(&rest[..end])
        .trim_end_matches('\r')
        .to_owned();
    *rest = &rest[end + 1..];
    Some(line)
}

/// Reads a size line such as `-Y 512 +X 1024`.
fn order(line: &str, path: &Path) -> Result<Order> {
    let wrong = || {
        invalid(
            path,
            Mistake::new(
                "size",
                format!(
                    "must be like -Y 512 +X 1024, is {:.60}",
                    line.escape_debug()
                ),
            ),
        )
    };
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[major, n_scans, minor, length] = words.as_slice() else {
        return Err(wrong());
    };
    let number = |word: &str| word.parse::<u64>().map_err(|_| wrong());
    let (n_scans, length) = (number(n_scans)?, number(length)?);
    let (by_columns, x, y, width, height) = match (major.get(1..), minor.get(1..)) {
        (Some("Y"), Some("X")) => (false, minor, major, length, n_scans),
        (Some("X"), Some("Y")) => (true, major, minor, n_scans, length),
        _ => return Err(wrong()),
    };
    let is_plus = |word: &str| match word.as_bytes()[0] {
        b'+' => Ok(true),
        b'-' => Ok(false),
        _ => Err(wrong()),
    };
    let (width, height) = check_size(path, width, height)?;
    Ok(Order {
        width,
        height,
        by_columns,
        from_bottom: is_plus(y)?,
        from_right: !is_plus(x)?,
    })
}

/// All scan lines, one behind the other. Memory grows with what the file really holds.
fn scans(data: &[u8], n_scans: usize, length: usize) -> std::result::Result<Vec<[u8; 4]>, Mistake> {
    if data.len() == 4 * n_scans * length && !starts_new(data, length) {
        return Ok(data.as_chunks().0.to_vec());
    }
    let mut rest = data;
    let mut pixels = Vec::new();
    for scan in 0..n_scans {
        let result = if starts_new(rest, length) {
            rest = &rest[4..];
            new_scan(&mut rest, length, &mut pixels)
        } else {
            old_scan(&mut rest, length, &mut pixels)
        };
        result.map_err(|reason| {
            Mistake::new(
                format!("scan line {scan}"),
                format!("{reason} (of {n_scans} scan lines of {length} pixels)"),
            )
        })?;
    }
    Ok(pixels)
}

fn starts_new(data: &[u8], length: usize) -> bool {
    NEW_WIDTHS.contains(&length)
        && data.starts_with(&[2, 2, (length >> 8) as u8, (length & 255) as u8])
}

const ENDS: &str = "ends early";

/// One scan line, channel by channel.
fn new_scan(
    rest: &mut &[u8],
    length: usize,
    pixels: &mut Vec<[u8; 4]>,
) -> std::result::Result<(), &'static str> {
    let start = pixels.len();
    pixels.resize(start + length, [0; 4]);
    for channel in 0..4 {
        let mut done = 0;
        while done < length {
            let (&count, tail) = rest.split_first().ok_or(ENDS)?;
            let is_run = count > 128;
            let count = usize::from(if is_run { count - 128 } else { count });
            if count == 0 {
                return Err("has a run of no length");
            }
            if count > length - done {
                return Err("has a run beyond its end");
            }
            let n_bytes = if is_run { 1 } else { count };
            let values = tail.get(..n_bytes).ok_or(ENDS)?;
            for (index, pixel) in pixels[start + done..][..count].iter_mut().enumerate() {
                pixel[channel] = values[if is_run { 0 } else { index }];
            }
            done += count;
            *rest = &tail[n_bytes..];
        }
    }
    Ok(())
}

/// One scan line of whole pixels, with old run lengths perhaps.
fn old_scan(
    rest: &mut &[u8],
    length: usize,
    pixels: &mut Vec<[u8; 4]>,
) -> std::result::Result<(), &'static str> {
    let start = pixels.len();
    // Runs that follow each other are the digits of one length, the lowest first.
    let mut shift = 0;
    while pixels.len() < start + length {
        let (&pixel, tail) = rest.split_first_chunk::<4>().ok_or(ENDS)?;
        *rest = tail;
        if let [1, 1, 1, count] = pixel {
            let count = usize::from(count).checked_shl(shift).unwrap_or(usize::MAX);
            if pixels.len() == start {
                return Err("repeats a pixel before the first");
            }
            if shift > 16 || count > start + length - pixels.len() {
                return Err("has a run beyond its end");
            }
            let last = pixels[pixels.len() - 1];
            pixels.extend(std::iter::repeat_n(last, count));
            shift += 8;
        } else {
            pixels.push(pixel);
            shift = 0;
        }
    }
    Ok(())
}

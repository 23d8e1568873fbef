//! Points and normals for `probe`, from CSV or `NumPy` files.

use std::path::PathBuf;

use glam::DVec3;
use lumel::transport::Receiver;
use lumel::{Error, Result};
use npyz::{DType, NpyHeader, Order, TypeChar};

const HEADER: [&str; 6] = ["x", "y", "z", "nx", "ny", "nz"];

/// Bytes of a `NumPy` header that are looked at. One of N rows and 6 columns takes 118; a longer one is no such array, and deeply nested
/// ones take its parser long.
const MAX_NPY_HEADER: usize = 1024;

/// The formats of tables, by file extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Csv,
    Npy,
}

/// A file whose extension says how it is written.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    pub(crate) path: PathBuf,
    pub(crate) format: Format,
}

impl Table {
    /// By the extension of `path`, in any case; for clap, which adds the option and the value to the message.
    pub(crate) fn new(path: PathBuf) -> std::result::Result<Self, &'static str> {
        let extension = path.extension().unwrap_or_default();
        let format = if extension.eq_ignore_ascii_case("csv") {
            Format::Csv
        } else if extension.eq_ignore_ascii_case("npy") {
            Format::Npy
        } else {
            return Err("must end in .csv or .npy");
        };
        Ok(Self { path, format })
    }
}

/// Reads the points of `table`; normals are brought to length 1.
///
/// Line or row of the first mistake is in the message.
pub(crate) fn read(Table { path, format }: &Table) -> Result<Vec<Receiver>> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io {
        path: path.clone(),
        source,
    })?;
    let parsed = match format {
        Format::Csv => parse_csv(&bytes),
        Format::Npy => parse_npy(&bytes),
    };
    parsed.map_err(|mistake| Error::InvalidFile {
        path: path.clone(),
        place: mistake.place,
        reason: mistake.reason,
    })
}

/// What is wrong with a table, and in which line or row.
#[derive(Debug)]
struct Mistake {
    place: String,
    reason: String,
}

impl Mistake {
    fn new(place: impl Into<String>, reason: impl Into<String>) -> Self {
        Self {
            place: place.into(),
            reason: reason.into(),
        }
    }
}

fn parse_csv(bytes: &[u8]) -> std::result::Result<Vec<Receiver>, Mistake> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()]
            .iter()
            .filter(|&&byte| byte == b'\n')
            .count();
        Mistake::new(format!("line {line}"), "is not UTF-8 text")
    })?;
    // Spreadsheets put a byte order mark in front.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut rows = text
        .lines()
        .map(str::trim)
        .zip(1_usize..)
        .filter(|(line, _)| !line.is_empty() && !line.starts_with('#'));

    let expected = HEADER.join(",");
    let Some((header, number)) = rows.next() else {
        return Err(Mistake::new(
            "",
            format!("is empty; the first line must be {expected}"),
        ));
    };
    if !fields(header).eq(HEADER.iter().copied()) {
        return Err(Mistake::new(
            format!("line {number}"),
            format!("the header must be {expected}, is {}", shortened(header)),
        ));
    }

    let mut points = Vec::new();
    for (line, number) in rows {
        let place = || format!("line {number}");
        let count = fields(line).count();
        if count != HEADER.len() {
            return Err(Mistake::new(
                place(),
                format!("must have {} numbers, has {count}", HEADER.len()),
            ));
        }
        let mut row = [0.0; 6];
        for ((number, field), name) in row.iter_mut().zip(fields(line)).zip(HEADER) {
            *number = field.parse().map_err(|_| {
                Mistake::new(
                    place(),
                    format!("{name} must be a number, is '{}'", shortened(field)),
                )
            })?;
        }
        points.push(receiver(row, points.len(), place)?);
    }
    Ok(points)
}

fn fields(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(str::trim)
}

/// Enough of a foreign text to recognise it by.
fn shortened(text: &str) -> String {
    const LENGTH: usize = 60;
    if text.chars().count() <= LENGTH {
        text.to_owned()
    } else {
        text.chars().take(LENGTH).chain("…".chars()).collect()
    }
}

fn parse_npy(bytes: &[u8]) -> std::result::Result<Vec<Receiver>, Mistake> {
    let whole = |reason: String| Mistake::new("", reason);
    let (header, data) = npy_header(bytes).map_err(whole)?;
    let n_rows = match *header.shape() {
        [n_rows, 6] => n_rows,
        ref shape => {
            return Err(whole(format!(
                "the array must have the shape (N, 6), has {shape:?}"
            )));
        }
    };
    let (width, swapped) = float_type(&header.dtype()).map_err(whole)?;
    // The data is in memory already, so a forged shape costs nothing.
    let n_rows = usize::try_from(n_rows)
        .ok()
        .filter(|n_rows| n_rows.checked_mul(6 * width) == Some(data.len()))
        .ok_or_else(|| {
            whole(format!(
                "the header promises {n_rows} rows of {} bytes, the file holds {} bytes of data",
                6 * width,
                data.len()
            ))
        })?;
    let number = |index: usize| {
        let mut raw = [0; 8];
        raw[..width].copy_from_slice(&data[index * width..][..width]);
        if swapped {
            raw[..width].reverse();
        }
        if width == 8 {
            f64::from_le_bytes(raw)
        } else {
            f64::from(f32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]))
        }
    };
    (0..n_rows)
        .map(|row| {
            let numbers = std::array::from_fn(|column| match header.order() {
                Order::C => number(6 * row + column),
                Order::Fortran => number(n_rows * column + row),
            });
            receiver(numbers, row, || format!("row {row}"))
        })
        .collect()
}

/// The parsed header and the bytes behind it.
fn npy_header(bytes: &[u8]) -> std::result::Result<(NpyHeader, &[u8]), String> {
    // Magic, version, then the length of the header in 2 bytes (version 1) or 4.
    let not_npy = || "is not a NumPy array file".to_owned();
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err(not_npy());
    }
    let (length, start) = match *bytes.get(6..).ok_or_else(not_npy)? {
        [1, _, a, b, ..] => (u32::from(u16::from_le_bytes([a, b])), 10),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]), 12),
        _ => return Err(not_npy()),
    };
    let length = length as usize;
    if length > MAX_NPY_HEADER {
        return Err(format!(
            "its header has {length} bytes, the limit is {MAX_NPY_HEADER}"
        ));
    }
    let text = bytes
        .get(start..start + length)
        .ok_or_else(|| "ends within its header".to_owned())?;
    // The one bracket of a plain array's header is its shape's.
    if text.iter().filter(|byte| b"([{".contains(byte)).count() > 2 {
        return Err("must be a plain array of numbers".to_owned());
    }
    let header = NpyHeader::from_reader(bytes).map_err(|error| error.to_string())?;
    Ok((header, &bytes[start + length..]))
}

/// Bytes per number, and whether they are big-endian.
fn float_type(dtype: &DType) -> std::result::Result<(usize, bool), String> {
    if let DType::Plain(plain) = dtype
        && plain.type_char() == TypeChar::Float
        && matches!(plain.size_field(), 4 | 8)
    {
        let width = if plain.size_field() == 4 { 4 } else { 8 };
        return Ok((width, plain.endianness() == npyz::Endianness::Big));
    }
    Err(format!(
        "the numbers must be f32 or f64, are {}",
        shortened(&dtype.descr())
    ))
}

/// A point from its six numbers; its row is its name in random numbers.
fn receiver(
    numbers: [f64; 6],
    row: usize,
    place: impl Fn() -> String,
) -> std::result::Result<Receiver, Mistake> {
    let [x, y, z, nx, ny, nz] = numbers;
    if let Some((name, number)) = HEADER
        .iter()
        .zip(numbers)
        .find(|(_, number)| !number.is_finite())
    {
        return Err(Mistake::new(
            place(),
            format!("{name} must be finite, is {number}"),
        ));
    }
    let normal = DVec3::new(nx, ny, nz);
    // Scaled first: squares of very small or large components would underflow or overflow.
    let largest = normal.abs().max_element();
    if largest == 0.0 {
        return Err(Mistake::new(place(), "the normal must not be zero"));
    }
    Ok(Receiver {
        position: DVec3::new(x, y, z),
        normal: (normal / largest).normalize(),
        seed: row as u64,
    })
}

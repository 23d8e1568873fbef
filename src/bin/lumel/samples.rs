//! The result of `probe`: 44 numbers per point, as CSV or as a `NumPy` array.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use lumel::transport::{Receiver, Sample};
use lumel::{Error, Result};
use npyz::WriterBuilder as _;
use tempfile::NamedTempFile;

use super::points::{Format, Table};

/// Names of the columns: E at the point's own normal, light vector, fluence, derivatives (`jr_xy` = ∂`gr_x`/∂y), error, rays.
pub(crate) const COLUMNS: [&str; 44] = [
    "e_r", "e_g", "e_b", //
    "gr_x", "gr_y", "gr_z", "gg_x", "gg_y", "gg_z", "gb_x", "gb_y", "gb_z", //
    "phi_r", "phi_g", "phi_b", //
    "jr_xx", "jr_xy", "jr_xz", "jr_yx", "jr_yy", "jr_yz", "jr_zx", "jr_zy", "jr_zz", //
    "jg_xx", "jg_xy", "jg_xz", "jg_yx", "jg_yy", "jg_yz", "jg_zx", "jg_zy", "jg_zz", //
    "jb_xx", "jb_xy", "jb_xz", "jb_yx", "jb_yy", "jb_yz", "jb_zx", "jb_zy", "jb_zz", //
    "error", "rays",
];

/// A file that appears when it is complete.
#[derive(Debug)]
pub(crate) struct Destination {
    table: Table,
    file: NamedTempFile,
}

impl Destination {
    /// Opens a temporary file beside `table`.
    pub(crate) fn create(table: &Table) -> Result<Self> {
        let folder = match table.path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let mut builder = tempfile::Builder::new();
        // As any new file, not as a private one; the system still takes the umask away.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let file = builder
            .prefix(".lumel-")
            .tempfile_in(folder)
            .map_err(|source| io_error(&table.path, source))?;
        Ok(Self {
            table: table.clone(),
            file,
        })
    }

    /// Writes one row per point and gives the file its name.
    pub(crate) fn write(mut self, receivers: &[Receiver], samples: &[Sample]) -> Result<()> {
        let bytes = match self.table.format {
            Format::Csv => Ok(to_csv(receivers, samples).into_bytes()),
            Format::Npy => to_npy(receivers, samples),
        };
        bytes
            .and_then(|bytes| self.file.write_all(&bytes))
            .and_then(|()| {
                self.file
                    .persist(&self.table.path)
                    .map_err(|error| error.error)
            })
            .map(drop)
            .map_err(|source| io_error(&self.table.path, source))
    }
}

fn io_error(path: &Path, source: std::io::Error) -> Error {
    Error::Io {
        path: path.to_owned(),
        source,
    }
}

/// Every number so that reading it gives the same f64.
pub(crate) fn to_csv(receivers: &[Receiver], samples: &[Sample]) -> String {
    let mut text = COLUMNS.join(",");
    text.push('\n');
    for (receiver, sample) in receivers.iter().zip(samples) {
        for (index, number) in row(receiver, sample).into_iter().enumerate() {
            if index > 0 {
                text.push(',');
            }
            // The shortest digits that give the number back, with an exponent where that is shorter.
            write!(text, "{number:?}").expect("a string takes any text");
        }
        text.push('\n');
    }
    text
}

fn to_npy(receivers: &[Receiver], samples: &[Sample]) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut writer = npyz::WriteOptions::new()
        .dtype(npyz::DType::Plain(
            "<f8".parse().expect("a type of `NumPy`"),
        ))
        .shape(&[samples.len() as u64, COLUMNS.len() as u64])
        .writer(&mut bytes)
        .begin_nd()?;
    for (receiver, sample) in receivers.iter().zip(samples) {
        writer.extend(row(receiver, sample))?;
    }
    writer.finish()?;
    Ok(bytes)
}

/// The numbers of a point in the order of [`COLUMNS`]. Derivatives that the estimator did not give are zero.
fn row(receiver: &Receiver, sample: &Sample) -> [f64; COLUMNS.len()] {
    let mut numbers = Vec::with_capacity(COLUMNS.len());
    numbers.extend(sample.irradiance(receiver.normal).to_array());
    numbers.extend(sample.g.iter().flat_map(|g| g.to_array()));
    numbers.extend(sample.phi);
    for j in &sample.j {
        for row in 0..3 {
            numbers.extend(j.row(row).to_array());
        }
    }
    numbers.push(sample.error);
    numbers.push(f64::from(sample.rays));
    numbers.try_into().expect("3 + 9 + 3 + 27 + 2 numbers")
}

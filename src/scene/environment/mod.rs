//! A picture of the light from far away: latitude–longitude, `.hdr` or `.exr` → [`Environment`].
//!
//! # Orientation
//!
//! glTF's own image-based lights are cube maps, so for this projection the viewers of glTF are the standard: three.js (and with it
//! model-viewer and Babylon.js' equirectangular textures) and Blender with the axes of its glTF export agree on
//!
//! ```text
//! u = atan2(z, x) / 2π + ½        v = ½ − asin(y) / π         (u to the right, v down, direction (x, y, z), Y up)
//! ```
//!
//! The centre of the picture is +X, the left and right borders are −X, +Z is a quarter of the width to the right of the centre, the top
//! row is +Y. Seen from within, looking at the centre, the picture is not mirrored. `OpenEXR`'s attribute `envmap` has the same handedness
//! and +Z in the centre; the viewers ignore it, and so do we: turning by −90° about Y shows such a file as it is labelled.

mod exr;

mod rgbe;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::error::{Error, Result, Warnings};
use crate::math;

/// Light from all directions, as a latitude–longitude picture of radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
    /// What was odd about the file.
    pub warnings: Warnings,
}

/// Most pixels of a picture: 8192 × 4096, 400 MB. Larger: forged headers take more memory. Smaller: the largest skies in use are refused.
pub const MAX_PIXELS: u64 = 8192 * 4096;

/// Most bytes of a file, and of its decoded channels: eight channels of 32 bits at the largest size.
const MAX_BYTES: u64 = 32 * MAX_PIXELS;

/// What is wrong with the contents of a file, and where.
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

/// A picture as it was stored.
struct Decoded {
    width: u32,
    height: u32,
    /// Row 0 on top.
    pixels: Vec<[f32; 3]>,
}

impl Environment {
    /// Reads the picture at `path`. The format is known by the first bytes.
    ///
    /// `.hdr`: Radiance RGBE, flat or with either kind of run lengths, in any of the eight pixel orders; `EXPOSURE` and `COLORCORR` are
    /// divided out, and a warning says so. `.exr`: the first layer with channels `R`, `G`, `B` (whatever stands before the last dot of
    /// their names), else with `Y`; halves, floats or whole numbers; the largest resolution level.
    ///
    /// Pixels that are NaN, infinite or negative have that channel set to 0 and are counted in the warnings, as is a width that is not
    /// twice the height.
    ///
    /// # Errors
    /// `Io` when the file cannot be read; `TooLarge` above [`MAX_PIXELS`]; `InvalidFile` when it is neither format, ends early or
    /// contradicts itself; `Unsupported` for what this reader does not know (XYZ colours, deep data, cube maps).
    pub fn open(path: &Path) -> Result<Self> {
        let io = |source| Error::Io {
            path: path.to_owned(),
            source,
        };
        let mut file = File::open(path).map_err(io)?;
        let n_bytes = file.metadata().map_err(io)?.len();
        if n_bytes > MAX_BYTES {
            return Err(Error::TooLarge {
                reason: format!(
                    "{}: has {n_bytes} bytes, the limit is {MAX_BYTES}",
                    path.display()
                ),
            });
        }
        let mut magic = Vec::new();
        (&mut file).take(4).read_to_end(&mut magic).map_err(io)?;
        let mut warnings = Warnings::default();
        let decoded = if magic.starts_with(b"#?") {
            let mut bytes = magic;
            file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(io)?;
            rgbe::decode(&bytes, path, &mut warnings)?
        } else if magic == exr::MAGIC {
            exr::decode(path, &mut warnings)?
        } else {
            return Err(invalid(
                path,
                Mistake::new(
                    "",
                    "is neither a Radiance picture (.hdr) nor an OpenEXR one (.exr)",
                ),
            ));
        };
        let mut environment = Self {
            width: decoded.width,
            height: decoded.height,
            pixels: decoded.pixels,
            warnings,
        };
        environment.settle();
        Ok(environment)
    }

    /// A picture in code: `radiance` of the centre of each pixel, in nit. `width` and `height` are at least 1; values that are no radiance
    /// are treated and counted as in [`Self::open`].
    #[must_use]
    pub fn from_fn(width: u32, height: u32, radiance: impl Fn(DVec3) -> Vec3) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let pixels = (0..height)
            .flat_map(|row| (0..width).map(move |column| (row, column)))
            .map(|(row, column)| {
                let u = (f64::from(column) + 0.5) / f64::from(width);
                let v = (f64::from(row) + 0.5) / f64::from(height);
                radiance(Self::direction(u, v)).to_array()
            })
            .collect();
        let mut environment = Self {
            width,
            height,
            pixels,
            warnings: Warnings::default(),
        };
        environment.settle();
        environment
    }

    /// The same radiance from everywhere, in nit: a sky without a picture.
    #[must_use]
    pub fn constant(radiance: Vec3) -> Self {
        Self::from_fn(2, 1, |_| radiance)
    }

    /// Pixels per row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Radiance in nit, linear RGB, finite and not negative; row by row, the top one first.
    #[must_use]
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// The pixels of a row, `row < height`.
    #[must_use]
    pub fn row(&self, row: u32) -> &[[f32; 3]] {
        let width = self.width as usize;
        &self.pixels[row as usize * width..][..width]
    }

    /// Replaces the radiance of a pixel, which must be in the picture; anything that is no radiance becomes 0.
    pub fn set(&mut self, column: u32, row: u32, radiance: [f32; 3]) {
        let index = row as usize * self.width as usize + column as usize;
        self.pixels[index] = radiance.map(|value| {
            if value.is_finite() {
                value.max(0.0)
            } else {
                0.0
            }
        });
    }

    /// Unit direction of a place in the picture; `u` to the right and `v` down in 0..=1, see [the module](self).
    #[must_use]
    pub fn direction(u: f64, v: f64) -> DVec3 {
        let (sin_phi, cos_phi) = (std::f64::consts::TAU * (u - 0.5)).sin_cos();
        let (sin_theta, cos_theta) = (std::f64::consts::PI * v).sin_cos();
        DVec3::new(sin_theta * cos_phi, cos_theta, sin_theta * sin_phi)
    }

    /// Place `(u, v)` in the picture of a direction of any length, both in 0..=1; see [the module](self).
    #[must_use]
    pub fn place(direction: DVec3) -> (f64, f64) {
        let u = direction.z.atan2(direction.x) / std::f64::consts::TAU + 0.5;
        // Equal to asin(y), and exact near the poles.
        let elevation = direction.y.atan2(direction.x.hypot(direction.z));
        (u, 0.5 - elevation / std::f64::consts::PI)
    }

    /// Radiance of the pixel that a direction of any length falls into.
    #[must_use]
    pub fn radiance(&self, direction: DVec3) -> [f32; 3] {
        let (u, v) = Self::place(direction);
        let column = (u * f64::from(self.width)) as u32;
        let row = (v * f64::from(self.height)) as u32;
        self.row(row.min(self.height - 1))[column.min(self.width - 1) as usize]
    }

    /// 64 bits that differ for different pictures: of the size and of every pixel as it is used, so that the same picture in another file
    /// has the same hash.
    #[must_use]
    pub fn hash(&self) -> u64 {
        let rows: Vec<u64> = self
            .pixels
            .par_chunks(self.width as usize)
            .map(|row| {
                row.iter().fold(0, |hash, pixel| {
                    let [r, g, b] = pixel.map(|value| u64::from(value.to_bits()));
                    math::hash(hash, r | g << 32, b)
                })
            })
            .collect();
        let size = u64::from(self.width) | u64::from(self.height) << 32;
        rows.into_iter()
            .fold(size, |hash, row| math::hash(hash, row, 0))
    }

    /// Sets to 0 what is no radiance, and counts it and a wrong aspect.
    fn settle(&mut self) {
        if u64::from(self.width) != 2 * u64::from(self.height) {
            self.warnings.push(
                "picture is not twice as wide as high, stretched over the whole sphere",
                format!("{} × {}", self.width, self.height),
            );
        }
        for (what, is_bad) in [
            (
                "pixel is not a number, set to 0",
                f32::is_nan as fn(f32) -> bool,
            ),
            ("pixel is infinite, set to 0", f32::is_infinite),
            ("pixel is negative, set to 0", |value| value < 0.0),
        ] {
            let mut first = None;
            let mut count = 0;
            for (index, pixel) in self.pixels.iter_mut().enumerate() {
                if pixel.iter().any(|&value| is_bad(value)) {
                    first.get_or_insert(index);
                    count += 1;
                    for value in pixel.iter_mut().filter(|value| is_bad(**value)) {
                        *value = 0.0;
                    }
                }
            }
            if let Some(first) = first {
                let width = self.width as usize;
                let place = format!("column {}, row {}", first % width, first / width);
                self.warnings.push_many(what, place, count);
            }
        }
    }
}

/// Where the rule that `lumel sky` makes of the picture at `path` is stored: beside it, as `<file>.sky.json`.
#[must_use]
pub fn rule_path(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".sky.json");
    path.with_file_name(name)
}

/// The text that is stored beside the picture at `path`; `None` when there is none that could be read. See [`rule_path`].
#[must_use]
pub fn read_rule(path: &Path) -> Option<String> {
    /// 1 kB per direction, far more directions than a rule has.
    const LIMIT: u64 = 1 << 26;
    let mut text = String::new();
    let file = File::open(rule_path(path)).ok()?;
    file.take(LIMIT).read_to_string(&mut text).ok()?;
    Some(text)
}

/// Checks a size from a header, before anything is allocated for it.
fn check_size(path: &Path, width: u64, height: u64) -> Result<(u32, u32)> {
    if width == 0 || height == 0 {
        return Err(invalid(
            path,
            Mistake::new("header", format!("has {width} × {height} pixels")),
        ));
    }
    let fits = width
        .checked_mul(height)
        .is_some_and(|n_pixels| n_pixels <= MAX_PIXELS);
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) if fits => Ok((width, height)),
        _ => Err(Error::TooLarge {
            reason: format!(
                "{}: header: {width} × {height}, the limit is {MAX_PIXELS} pixels (8192 × 4096)",
                path.display()
            ),
        }),
    }
}

fn invalid(path: &Path, mistake: Mistake) -> Error {
    Error::InvalidFile {
        path: path.to_owned(),
        place: mistake.place,
        reason: mistake.reason,
    }
}

fn unsupported(path: &Path, feature: &str, advice: &str) -> Error {
    Error::Unsupported {
        path: path.to_owned(),
        feature: feature.to_owned(),
        advice: advice.to_owned(),
    }
}

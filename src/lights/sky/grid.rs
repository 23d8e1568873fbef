//! The pixel grid on the sphere: solid angles and first moments in closed form.
//!
//! A pixel is the rectangle of its polar angles θ and azimuths φ, and its radiance is the same all over it. Nothing is sampled: with
//! ω = (sin θ cos φ, cos θ, sin θ sin φ) both `∫ dω` and `∫ ω dω` are products of a factor of the row and one of the column.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rayon::prelude::*;

use crate::scene::Environment;

/// A rectangle of polar angle and azimuth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Unit vector of its centre.
    pub(super) direction: DVec3,
    /// Steradians.
    pub(super) solid_angle: f64,
    /// ∫ ω dω over it; a little shorter than its solid angle.
    pub(super) moment: DVec3,
}

/// What the patches of a row have in common.
#[derive(Clone, Copy, Debug)]
struct Band {
    sin: f64,
    cos: f64,
    solid_angle: f64,
    /// Length of the horizontal part of the moment.
    horizontal: f64,
    /// The moment's y.
    vertical: f64,
}

impl Band {
    /// Polar angles `size` around `theta`, azimuths `width` wide.
    fn new(theta: f64, size: f64, width: f64) -> Self {
        let (sin, cos) = theta.sin_cos();
        // ∫ sin²θ dθ, written so that nothing cancels beside the poles.
        let squares = 0.5 * (size - size.sin()) + size.sin() * sin * sin;
        Self {
            sin,
            cos,
            solid_angle: 2.0 * width * sin * (0.5 * size).sin(),
            horizontal: 2.0 * (0.5 * width).sin() * squares,
            vertical: width * sin * cos * size.sin(),
        }
    }

    fn patch(&self, azimuth: [f64; 2]) -> Patch {
        let [cos, sin] = azimuth;
        Patch {
            direction: DVec3::new(self.sin * cos, self.cos, self.sin * sin),
            solid_angle: self.solid_angle,
            moment: DVec3::new(self.horizontal * cos, self.vertical, self.horizontal * sin),
        }
    }
}

/// The patches of a picture.
#[derive(Debug)]
pub(super) struct Grid<'a> {
    pub(super) image: &'a Environment,
    bands: Vec<Band>,
    /// Cosine and sine of the azimuth of each column's centre.
    azimuths: Vec<[f64; 2]>,
}

impl<'a> Grid<'a> {
    pub(super) fn new(image: &'a Environment) -> Self {
        let (size, width) = steps(image);
        Self {
            image,
            bands: (0..image.height())
                .map(|row| Band::new((f64::from(row) + 0.5) * size, size, width))
                .collect(),
            azimuths: (0..image.width())
                .map(|column| azimuth((f64::from(column) + 0.5) * width))
                .collect(),
        }
    }

    /// The patch of a pixel.
    pub(super) fn patch(&self, column: u32, row: u32) -> Patch {
        self.bands[row as usize].patch(self.azimuths[column as usize])
    }

    /// A pixel's patch, cut into `n` × `n`, a power of two; along a Z-shaped curve, so that every 64 in a row are a square.
    pub(super) fn pieces(&self, column: u32, row: u32, n: u32) -> impl Iterator<Item = Patch> {
        let (size, width) = steps(self.image);
        let (size, width) = (size / f64::from(n), width / f64::from(n));
        let left = f64::from(column) * f64::from(n) + 0.5;
        let top = f64::from(row) * f64::from(n) + 0.5;
        (0..n * n).map(move |index| {
            let [x, y] = [index, index >> 1].map(every_other_bit);
            let band = Band::new((top + f64::from(y)) * size, size, width);
            band.patch(azimuth((left + f64::from(x)) * width))
        })
    }

    /// A cap that holds the patches of `columns` × `rows`: unit centre and radius. Along a meridian and then along a parallel is no
    /// shorter than the way between two points.
    pub(super) fn cap(&self, columns: [u32; 2], rows: [u32; 2]) -> (DVec3, f64) {
        let (size, width) = steps(self.image);
        let edges = rows.map(|row| f64::from(row) * size);
        let phi = 0.5 * (f64::from(columns[0]) + f64::from(columns[1])) * width;
        let theta = 0.5 * (edges[0] + edges[1]);
        let widest = if edges[0] <= 0.5 * PI && edges[1] >= 0.5 * PI {
            1.0
        } else {
            edges[0].sin().max(edges[1].sin())
        };
        let radius =
            0.5 * (edges[1] - edges[0]) + 0.5 * f64::from(columns[1] - columns[0]) * width * widest;
        let [cos, sin] = azimuth(phi);
        let centre = DVec3::new(theta.sin() * cos, theta.cos(), theta.sin() * sin);
        (centre, radius.min(PI))
    }

    /// ∫ ‖L‖ dω over the sphere. See [`norm`].
    pub(super) fn weight(&self) -> f64 {
        let rows: Vec<f64> = (0..self.image.height())
            .into_par_iter()
            .map(|row| {
                let sum: f64 = self.image.row(row).iter().map(norm).sum();
                sum * self.bands[row as usize].solid_angle
            })
            .collect();
        rows.iter().sum()
    }
}

/// ‖L‖ = R + G + B. A norm of radiance that is additive, so that ‖Bᵢ‖ is the integral of ‖L‖.
pub(super) fn norm(radiance: &[f32; 3]) -> f64 {
    radiance.iter().map(|&value| f64::from(value)).sum()
}

/// Polar angle and azimuth of a pixel's sides.
fn steps(image: &Environment) -> (f64, f64) {
    (
        PI / f64::from(image.height()),
        TAU / f64::from(image.width()),
    )
}

/// Bits 0, 2, 4 … of `bits`, side by side.
fn every_other_bit(bits: u32) -> u32 {
    (0..16).fold(0, |sum, bit| sum | (bits >> (2 * bit) & 1) << bit)
}

/// Cosine and sine at `phi` from the left border, which is −X.
fn azimuth(phi: f64) -> [f64; 2] {
    let (sin, cos) = phi.sin_cos();
    [-cos, -sin]
}

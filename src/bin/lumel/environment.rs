//! The options that hang a sky over a scene.

use std::path::PathBuf;

use clap::ValueEnum;
use glam::Vec3;
use lumel::bake::Options;
use lumel::error::Result;
use lumel::lights::SkyMode;
use lumel::scene::{self, Environment, environment};

use super::args::{real, whole};

/// What shines from all around.
#[derive(Debug, clap::Args)]
pub(crate) struct Environmental {
    /// Picture of the sky, .hdr or .exr, latitude-longitude; `lumel sky --help` says how it is oriented
    #[arg(long, value_name = "FILE")]
    sky: Option<PathBuf>,

    /// A sky of one colour instead: radiance in nit, linear red,green,blue
    #[arg(long, value_name = "R,G,B", value_parser = color, conflicts_with = "sky")]
    sky_color: Option<Vec3>,

    /// Turns the sky about Y, in degrees, counter-clockwise seen from above [default: 0]
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, value_parser = real(-3600.0..=3600.0))]
    sky_rotation: Option<f64>,

    /// Multiplies the sky's radiance [default: 1]
    #[arg(long, value_name = "X", allow_negative_numbers = true, value_parser = real(0.0..=1e30))]
    sky_strength: Option<f64>,

    /// Directions that stand for the sky [default: 64]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = whole(1..=4096))]
    sky_lights: Option<u32>,

    /// What they become
    #[arg(long, value_name = "MODE", default_value = "cells")]
    sky_mode: Mode,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Mode {
    /// Suns without a size: a shadow ray each; few of them show as bands
    Points,
    /// Nine sets of suns that take turns from texel to texel: noise instead of bands
    Interleaved,
    /// Polygons at infinity: smooth shadows, no rays; the sun is a polygon of its own
    Cells,
}

impl Environmental {
    /// Reads the picture, if there is one, and the rule beside it.
    pub(crate) fn sky(&self) -> Result<Option<scene::Sky>> {
        let (image, rule) = match (&self.sky, self.sky_color) {
            (Some(path), _) => (Environment::open(path)?, environment::read_rule(path)),
            (None, Some(color)) => (Environment::constant(color), None),
            (None, None) => return Ok(None),
        };
        Ok(Some(scene::Sky {
            image,
            rotation: self.sky_rotation.unwrap_or(0.0).to_radians(),
            strength: self.sky_strength.unwrap_or(1.0),
            rule,
        }))
    }

    pub(crate) fn apply(&self, options: &mut Options) {
        if let Some(count) = self.sky_lights {
            options.lights.sky_lights = count as usize;
        }
        options.lights.sky_mode = match self.sky_mode {
            Mode::Points => SkyMode::Points,
            Mode::Interleaved => SkyMode::Interleaved,
            Mode::Cells => SkyMode::Cells,
        };
    }
}

/// Reads three numbers from 0 on, separated by commas.
fn color(text: &str) -> std::result::Result<Vec3, String> {
    let parsed: Vec<f32> = text
        .split(',')
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    match parsed[..] {
        [r, g, b] if [r, g, b].iter().all(|c| c.is_finite() && *c >= 0.0) => Ok(Vec3::new(r, g, b)),
        _ => Err("must be three numbers from 0 on, as in 1,1,1.2".to_owned()),
    }
}

//! Texels in, light out: evaluates one page and sorts the samples into planes.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering;

use glam::DVec3;

use super::account::Account;
use super::{Execution, Options, Output, Plan, Stage};
use crate::atlas::Atlas;
use crate::error::Result;
use crate::lights::Lights;
use crate::math;
use crate::refine::{self, Field, Plane};
use crate::scene::Scene;
use crate::texels::{Obstacle, Texel, Texels, Tile};
use crate::transport::{self, Counters, Receiver, Sample};
use crate::visibility::{Occluders, Visibility};

/// Everything that the light of a texel depends on.
pub(super) struct Evaluation<'a> {
    lights: &'a Lights,
    occluders: &'a Occluders<'a>,
    options: transport::Options,
    tolerance: f64,
    channels: Vec<Channel>,
}

/// Share of the error asked for that may come from lights that are left out. Half would leave too little for everything else, a tenth
/// would keep lights that nobody sees.
const SHARE_OF_LEFT_OUT: f64 = 0.25;

/// Texels that are looked at to know how bright a page is.
const PROBES: usize = 256;

/// Share of them that is no brighter than the page is taken to be.
const BRIGHT: f64 = 0.98;

/// A quantity of a texel that is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Irradiance,
    LightVector(usize),
    AlongU(usize),
    AlongV(usize),
    Fluence,
    Error,
}

impl Channel {
    fn name(self) -> &'static str {
        match self {
            Self::Irradiance => "E",
            Self::LightVector(channel) => ["Gr", "Gg", "Gb"][channel],
            Self::AlongU(channel) => ["Gr_du", "Gg_du", "Gb_du"][channel],
            Self::AlongV(channel) => ["Gr_dv", "Gg_dv", "Gb_dv"][channel],
            Self::Fluence => "phi",
            Self::Error => "err",
        }
    }

    fn components(self) -> usize {
        if self == Self::Error { 1 } else { 3 }
    }

    fn write(self, sample: &Sample, texel: &Texel, values: &mut Vec<f32>) {
        let vector = match self {
            Self::Irradiance => sample.irradiance(texel.normal),
            Self::LightVector(channel) => sample.g[channel],
            Self::AlongU(channel) => sample.j[channel] * texel.du,
            Self::AlongV(channel) => sample.j[channel] * texel.dv,
            Self::Fluence => DVec3::from_array(sample.phi),
            Self::Error => {
                values.push(storable(sample.error));
                return;
            }
        };
        values.extend(vector.to_array().map(storable));
    }
}

/// The nearest finite f32: light brighter than f32 holds (3e38 lux) is stored as its largest number.
fn storable(value: f64) -> f32 {
    value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

/// What one tile gives.
struct TileLight {
    /// All channels of a texel, texel after texel.
    values: Vec<f32>,
    counters: Counters,
    /// Per texel: E of the brightest channel, and the estimated error of E.
    figures: Vec<[f32; 2]>,
}

impl<'a> Evaluation<'a> {
    pub(super) fn new(
        lights: &'a Lights,
        occluders: &'a Occluders<'a>,
        plan: &Plan,
        options: &Options,
    ) -> Self {
        let mut channels = Vec::new();
        // The preview is made of E.
        if plan.writes(Output::E) || plan.writes(Output::Preview) || plan.exports_irradiance() {
            channels.push(Channel::Irradiance);
        }
        if plan.writes(Output::G) || plan.packs_light() {
            channels.extend((0..3).map(Channel::LightVector));
        }
        if plan.writes(Output::Phi) || plan.packs_light() {
            channels.push(Channel::Fluence);
        }
        if plan.writes(Output::Gradient) {
            channels.extend((0..3).flat_map(|c| [Channel::AlongU(c), Channel::AlongV(c)]));
        }
        if plan.writes(Output::Error) {
            channels.push(Channel::Error);
        }
        Self {
            lights,
            occluders,
            options: plan.transport(options),
            tolerance: options.tolerance,
            channels,
        }
    }

    /// Evaluates every texel of a page.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`].
    pub(super) fn page(
        &self,
        texels: &Texels,
        account: &mut Account,
        progress: &PageProgress,
        execution: &Execution<'_>,
    ) -> Result<Field> {
        let accepted_error = self.tolerance * self.brightness(texels);
        let options = transport::Options {
            accepted_error,
            negligible: SHARE_OF_LEFT_OUT * accepted_error,
            ..self.options.clone()
        };
        let tiles = refine::every_tile(
            &texels.tiles,
            |tile| self.tile(texels, tile, &options),
            &|tile| progress.finished(tile.texels.len(), execution),
            &|| execution.is_cancelled(),
        )?;
        account.page(
            texels,
            tiles.iter().map(|tile| (&tile.counters, &tile.figures[..])),
        );
        Ok(self.field(texels, &tiles))
    }

    /// About the largest irradiance of a page in lux: what [`BRIGHT`] of a few hundred texels stay below with nothing in the way of any
    /// light. Not the very largest: one texel a hand's breadth from a point light would make every other error small.
    fn brightness(&self, texels: &Texels) -> f64 {
        let step = texels.texels.len().div_ceil(PROBES).max(1);
        let mut found: Vec<f64> = texels
            .texels
            .iter()
            .step_by(step)
            .map(|texel| {
                let receiver = receiver(texels.page, texel);
                transport::unoccluded_irradiance(self.lights, &receiver).max_element()
            })
            .collect();
        found.sort_by(f64::total_cmp);
        let place = (BRIGHT * found.len() as f64) as usize;
        found
            .get(place)
            .or(found.last())
            .copied()
            .unwrap_or_default()
    }

    fn tile(&self, texels: &Texels, tile: &Tile, options: &transport::Options) -> TileLight {
        let members = &texels.texels[tile.texels.clone()];
        let receivers: Vec<Receiver> = members
            .iter()
            .map(|texel| receiver(texels.page, texel))
            .collect();
        let (samples, counters) =
            transport::gather(&receivers, self.lights, self.occluders, options);
        let mut values = Vec::with_capacity(members.len() * self.stride());
        let mut figures = Vec::with_capacity(members.len());
        for (sample, texel) in samples.iter().zip(members) {
            for channel in &self.channels {
                channel.write(sample, texel, &mut values);
            }
            let brightest = sample.irradiance(texel.normal).max_element();
            figures.push([storable(brightest), storable(sample.error)]);
        }
        TileLight {
            values,
            counters,
            figures,
        }
    }

    fn stride(&self) -> usize {
        self.channels.iter().map(|c| c.components()).sum()
    }

    /// Sorts texel-wise values into planes.
    fn field(&self, texels: &Texels, tiles: &[TileLight]) -> Field {
        let mut first = 0;
        let planes = self
            .channels
            .iter()
            .map(|channel| {
                let range = first..first + channel.components();
                first = range.end;
                Plane {
                    name: channel.name(),
                    components: channel.components(),
                    values: tiles
                        .iter()
                        .flat_map(|tile| tile.values.chunks_exact(self.stride()))
                        .flat_map(|texel| &texel[range.clone()])
                        .copied()
                        .collect(),
                }
            })
            .collect();
        let places = texels
            .tiles
            .iter()
            .flat_map(|tile| &texels.texels[tile.texels.clone()])
            .map(|texel| [texel.x, texel.y])
            .collect();
        Field {
            width: texels.width,
            height: texels.height,
            places,
            planes,
        }
    }
}

fn receiver(page: usize, texel: &Texel) -> Receiver {
    Receiver {
        position: texel.position,
        normal: texel.normal,
        seed: math::hash(page as u64, u64::from(texel.y), u64::from(texel.x)),
    }
}

/// The nearest surface along a line, as `texels` wants to know it.
pub(super) fn first_obstacle(
    scene: &Scene,
    occluders: &Occluders<'_>,
    origin: DVec3,
    direction: DVec3,
    distance: f64,
) -> Option<Obstacle> {
    occluders
        .closest(origin, direction, distance, &|_| false)
        .map(|hit| {
            let triangle = &scene.triangles[hit.triangle as usize];
            let double_sided = scene.materials[triangle.material as usize].double_sided;
            Obstacle {
                distance: hit.distance,
                normal: triangle.area_vector().normalize_or_zero(),
                // A curtain has no inside to be pushed out of.
                back: !hit.front && !double_sided,
            }
        })
}

/// Progress of a page within all pages.
pub(super) struct PageProgress {
    done: AtomicU64,
    total: u64,
}

impl PageProgress {
    /// `done`: texels of earlier pages; `covered`: texels of this one. Pages to come are taken to be as full as those so far.
    pub(super) fn new(atlas: &Atlas, page: usize, done: u64, covered: usize) -> Self {
        let area = |pages: &[crate::atlas::Page]| -> f64 {
            pages
                .iter()
                .map(|page| f64::from(page.width) * f64::from(page.height))
                .sum()
        };
        let (seen, to_come) = atlas.pages.split_at(page + 1);
        let known = done + covered as u64;
        let fullness = known as f64 / area(seen).max(1.0);
        Self {
            done: AtomicU64::new(done),
            total: known + (fullness * area(to_come)) as u64,
        }
    }

    fn finished(&self, n_texels: usize, execution: &Execution<'_>) {
        let done = self.done.fetch_add(n_texels as u64, Ordering::Relaxed) + n_texels as u64;
        execution.report(Stage::Light, done, self.total);
    }
}

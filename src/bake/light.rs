//! Texels in, light out: evaluates one page and sorts the samples into planes.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::OnceLock;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering;

use glam::DVec3;
use rayon::prelude::*;

use super::account::Account;
use super::chart::Chart;
use super::spacing::{SPACING, Thickness, spacing};
use super::{Execution, Options, Output, Plan, Stage};
use crate::atlas::Atlas;
use crate::error::Result;
use crate::lights::Lights;
use crate::math::{self, Aabb};
use crate::refine::{self, Field, Plane, Refined};
use crate::scene::Scene;
use crate::texels::{Obstacle, TILE, Texel, Texels, Tile};
use crate::transport::{self, Counters, Receiver, Sample};
use crate::visibility::{Occluders, Visibility};

/// Everything that the light of a texel depends on.
pub(super) struct Evaluation<'a> {
    scene: &'a Scene,
    /// Of the occluders, once somebody asks.
    thickness: OnceLock<Thickness>,
    lights: &'a Lights,
    occluders: &'a Occluders<'a>,
    options: transport::Options,
    tolerance: f64,
    interpolates: bool,
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

    /// Whether E says all that it needs.
    fn is_of_irradiance(self) -> bool {
        matches!(self, Self::Irradiance | Self::Error)
    }

    fn components(self) -> usize {
        if self == Self::Error { 1 } else { 3 }
    }

    fn write(self, light: &Light, values: &mut Vec<f32>) {
        let vector = match self {
            Self::Irradiance => light.e,
            Self::LightVector(channel) => light.g[channel],
            Self::AlongU(channel) => light.slopes[0][channel],
            Self::AlongV(channel) => light.slopes[1][channel],
            Self::Fluence => light.phi,
            Self::Error => {
                values.push(storable(light.error));
                return;
            }
        };
        values.extend(vector.to_array().map(storable));
    }
}

/// The light of a texel.
#[derive(Clone, Copy, Debug, Default)]
struct Light {
    /// Irradiance.
    e: DVec3,
    /// Light vector per colour channel.
    g: [DVec3; 3],
    phi: DVec3,
    /// Change of the light vectors per texel to the right and down.
    slopes: [[DVec3; 3]; 2],
    /// Of E.
    error: f64,
}

impl Light {
    fn of(sample: &Sample, texel: &Texel) -> Self {
        Self {
            e: sample.irradiance(texel.normal),
            g: sample.g,
            phi: DVec3::from_array(sample.phi),
            slopes: [texel.du, texel.dv].map(|step| sample.j.map(|j| j * step)),
            error: sample.error,
        }
    }
}

/// The nearest finite f32: light brighter than f32 holds (3e38 lux) is stored as its largest number.
fn storable(value: f64) -> f32 {
    value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

/// The light of a page.
struct PageLight {
    /// All channels of a texel, texel after texel.
    values: Vec<f32>,
    /// Per texel: E of the brightest channel, and the estimated error of E.
    figures: Vec<[f32; 2]>,
    counters: Counters,
}

/// The light of some of a page's texels.
struct Part {
    /// Indices in the page.
    texels: Vec<u32>,
    /// All channels of a texel, texel after texel.
    values: Vec<f32>,
    /// Per texel: E of the brightest channel, and the estimated error of E.
    figures: Vec<[f32; 2]>,
    counters: Counters,
}

impl<'a> Evaluation<'a> {
    pub(super) fn new(
        scene: &'a Scene,
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
            scene,
            thickness: OnceLock::new(),
            lights,
            occluders,
            options: plan.transport(options),
            tolerance: options.tolerance,
            interpolates: plan.interpolates,
            channels,
        }
    }

    /// The light at every texel of a page.
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
        let light = if self.interpolates {
            self.interpolated(texels, &options, progress, execution)?
        } else {
            self.evaluated(texels, &options, progress, execution)?
        };
        account.page(texels, &light.counters, &light.figures);
        Ok(self.field(texels, &light.values))
    }

    /// Every texel evaluated, tile by tile.
    fn evaluated(
        &self,
        texels: &Texels,
        options: &transport::Options,
        progress: &PageProgress,
        execution: &Execution<'_>,
    ) -> Result<PageLight> {
        let tiles = refine::every_tile(
            &texels.tiles,
            |tile| self.tile(texels, tile, options),
            &|tile| progress.finished(tile.texels.len(), execution),
            &|| execution.is_cancelled(),
        )?;
        Ok(self.together(texels, tiles))
    }

    /// Texels evaluated where light bends, chart by chart.
    fn interpolated(
        &self,
        texels: &Texels,
        options: &transport::Options,
        progress: &PageProgress,
        execution: &Execution<'_>,
    ) -> Result<PageLight> {
        let thickness = self
            .thickness
            .get_or_init(|| Thickness::new(self.scene, self.occluders.edges()));
        let charts = Chart::all(texels, &|square, spread| {
            self.spacing(texels.page, (square, spread), thickness, options)
        })?;
        let on_charts = OnCharts {
            evaluation: self,
            page: texels.page,
            options,
            progress,
            execution,
        };
        let parts: Vec<Part> = charts
            .par_iter()
            .map(|chart| {
                if self
                    .channels
                    .iter()
                    .all(|channel| channel.is_of_irradiance())
                {
                    on_charts.refine::<3>(chart)
                } else {
                    on_charts.refine::<12>(chart)
                }
            })
            .collect::<Result<_>>()?;
        Ok(self.together(texels, parts))
    }

    /// How far apart the texels of a square may be evaluated at first; some of them say what may cast shadows on all.
    fn spacing(
        &self,
        page: usize,
        (square, spread): (&[&Texel], &[&Texel]),
        thickness: &Thickness,
        options: &transport::Options,
    ) -> Vec<u16> {
        let receivers: Vec<Receiver> = spread.iter().map(|texel| receiver(page, texel)).collect();
        let shadows =
            transport::shadows(&receivers, self.lights, self.occluders, options.negligible);
        let among = |texels: &[&Texel]| {
            let places = Aabb::from_points(texels.iter().map(|texel| texel.position));
            let step = texels
                .iter()
                .map(|texel| texel.du.length().max(texel.dv.length()))
                .fold(0.0, f64::max);
            shadows
                .iter()
                .map(|shadow| spacing(thickness.narrowest(self.scene, shadow, &places), step))
                .min()
                .unwrap_or(SPACING)
        };
        let everywhere = among(square);
        if everywhere == SPACING {
            return vec![SPACING; square.len()];
        }
        // What comes near to one corner does not make all of the square dense.
        let mut blocks: BTreeMap<[u16; 2], (Vec<&Texel>, u16)> = BTreeMap::new();
        let block = |texel: &Texel| [texel.x, texel.y].map(|place| place / TILE as u16);
        for texel in square {
            blocks.entry(block(texel)).or_default().0.push(texel);
        }
        for (texels, spacing) in blocks.values_mut() {
            *spacing = among(texels);
        }
        square
            .iter()
            .map(|texel| {
                blocks
                    .get(&block(texel))
                    .map_or(everywhere, |(_, spacing)| *spacing)
            })
            .collect()
    }

    fn together(&self, texels: &Texels, parts: Vec<Part>) -> PageLight {
        let stride = self.stride();
        let mut page = PageLight {
            values: vec![0.0; texels.texels.len() * stride],
            figures: vec![[0.0; 2]; texels.texels.len()],
            counters: Counters::default(),
        };
        for part in parts {
            page.counters.add(&part.counters);
            for (place, &texel) in part.texels.iter().enumerate() {
                let texel = texel as usize;
                let values = &part.values[place * stride..][..stride];
                page.values[texel * stride..][..stride].copy_from_slice(values);
                page.figures[texel] = part.figures[place];
            }
        }
        page
    }

    /// A part of a page from its texels' light.
    fn part(
        &self,
        texels: Vec<u32>,
        light: impl Iterator<Item = Light>,
        counters: Counters,
    ) -> Part {
        let mut part = Part {
            values: Vec::with_capacity(texels.len() * self.stride()),
            figures: Vec::with_capacity(texels.len()),
            texels,
            counters,
        };
        for light in light {
            for channel in &self.channels {
                channel.write(&light, &mut part.values);
            }
            part.figures
                .push([storable(light.e.max_element()), storable(light.error)]);
        }
        part
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

    fn tile(&self, texels: &Texels, tile: &Tile, options: &transport::Options) -> Part {
        let members = &texels.texels[tile.texels.clone()];
        let receivers: Vec<Receiver> = members
            .iter()
            .map(|texel| receiver(texels.page, texel))
            .collect();
        let (samples, counters) =
            transport::gather(&receivers, self.lights, self.occluders, options);
        let light = samples
            .iter()
            .zip(members)
            .map(|(sample, texel)| Light::of(sample, texel));
        let indices = tile.texels.start as u32..tile.texels.end as u32;
        self.part(indices.collect(), light, counters)
    }

    fn wants_slopes(&self) -> bool {
        self.channels
            .iter()
            .any(|channel| matches!(channel, Channel::AlongU(_) | Channel::AlongV(_)))
    }

    fn stride(&self) -> usize {
        self.channels.iter().map(|c| c.components()).sum()
    }

    /// Sorts texel-wise values into planes.
    fn field(&self, texels: &Texels, values: &[f32]) -> Field {
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
                    values: values
                        .chunks_exact(self.stride())
                        .flat_map(|texel| &texel[range.clone()])
                        .copied()
                        .collect(),
                }
            })
            .collect();
        Field {
            width: texels.width,
            height: texels.height,
            places: texels
                .texels
                .iter()
                .map(|texel| [texel.x, texel.y])
                .collect(),
            planes,
        }
    }
}

/// What evaluating the charts of a page needs.
struct OnCharts<'s, 'a> {
    evaluation: &'s Evaluation<'a>,
    page: usize,
    options: &'s transport::Options,
    progress: &'s PageProgress,
    execution: &'s Execution<'s>,
}

impl OnCharts<'_, '_> {
    /// Receivers that are too far apart to be clipped together.
    fn one_by_one(&self, receivers: &[Receiver]) -> (Vec<Sample>, Counters) {
        let Evaluation {
            lights, occluders, ..
        } = self.evaluation;
        let mut counters = Counters::default();
        let samples = receivers
            .iter()
            .flat_map(|receiver| {
                let receiver = std::slice::from_ref(receiver);
                let (samples, own) = transport::gather(receiver, lights, occluders, self.options);
                counters.add(&own);
                samples
            })
            .collect();
        (samples, counters)
    }

    /// `K` says what is interpolated: 3 the irradiance, 12 light vectors and fluence.
    fn refine<const K: usize>(&self, chart: &Chart<'_>) -> Result<Part> {
        let counters = Mutex::new(Counters::default());
        let n_points = chart.domain.points().len();
        let evaluate = |points: &[u32]| {
            let receivers: Vec<Receiver> = points
                .iter()
                .map(|&point| receiver(self.page, chart.texel(point as usize)))
                .collect();
            let Evaluation {
                lights, occluders, ..
            } = self.evaluation;
            let (mut samples, mut batch) =
                transport::gather(&receivers, lights, occluders, self.options);
            if batch.pairs_sampled > 0 && points.len() > 1 {
                // Too many edges for so large a batch, perhaps, which smaller ones would not have: samples have no derivatives.
                (samples, batch) = self.one_by_one(&receivers);
            }
            if let Ok(mut counters) = counters.lock() {
                counters.add(&batch);
            }
            points
                .iter()
                .zip(&samples)
                .map(|(&point, sample)| packed(sample, chart, point as usize))
                .collect()
        };
        let options = refine::Options {
            tolerance: self.options.accepted_error,
            budget: usize::MAX,
            slopes: self.evaluation.wants_slopes(),
        };
        let refined = refine::sparse::<K>(&chart.domain, &evaluate, &options, &|| {
            self.execution.is_cancelled()
        })?;
        self.progress.finished(n_points, self.execution);
        let light = (0..n_points).map(|point| unpacked(&refined, point, chart.texel(point)));
        let counters = counters.into_inner().unwrap_or_default();
        Ok(self.evaluation.part(chart.members.clone(), light, counters))
    }
}

/// A sample as numbers: the irradiance and its derivatives per texel, or, if there is room, those of light vectors and fluence.
fn packed<const K: usize>(sample: &Sample, chart: &Chart<'_>, point: usize) -> refine::Sample<K> {
    let texel = chart.texel(point);
    let steps = [texel.du, texel.dv];
    let turns = chart.normal_slopes(point);
    let n = texel.normal;
    let mut packed = refine::Sample {
        value: [0.0; K],
        slopes: [[0.0; K]; 2],
        has_slopes: sample.has_gradient,
        error: sample.error,
    };
    if K < VECTORS {
        let e = sample.irradiance(n);
        for channel in 0..3 {
            packed.value[channel] = e[channel];
            for axis in 0..2 {
                packed.slopes[axis][channel] =
                    n.dot(sample.j[channel] * steps[axis]) + sample.g[channel].dot(turns[axis]);
            }
        }
        return packed;
    }
    for channel in 0..3 {
        let vector = 3 * channel..3 * channel + 3;
        packed.value[vector.clone()].copy_from_slice(&sample.g[channel].to_array());
        packed.value[9 + channel] = sample.phi[channel];
        for (slopes, step) in packed.slopes.iter_mut().zip(steps) {
            let slope = sample.j[channel] * step;
            slopes[vector.clone()].copy_from_slice(&slope.to_array());
            slopes[9 + channel] = sample.grad_phi[channel].dot(step);
        }
    }
    packed
}

/// Numbers that light vectors and fluence take.
const VECTORS: usize = 12;

/// The light that [`packed`] numbers stand for.
fn unpacked<const K: usize>(refined: &Refined<K>, point: usize, texel: &Texel) -> Light {
    let value = refined.values[point].map(f64::from);
    let mut light = Light {
        error: f64::from(refined.errors[point]),
        ..Light::default()
    };
    if K < VECTORS {
        light.e = DVec3::from_slice(&value).max(DVec3::ZERO);
        return light;
    }
    light.g = [0, 1, 2].map(|channel| DVec3::from_slice(&value[3 * channel..]));
    light.e = DVec3::from_array(light.g.map(|g| g.dot(texel.normal).max(0.0)));
    light.phi = DVec3::from_slice(&value[9..]).max(DVec3::ZERO);
    if let Some(slopes) = refined.slopes.get(point) {
        light.slopes = slopes.map(|along| {
            [0, 1, 2].map(|channel| {
                DVec3::from_array([0, 1, 2].map(|k| f64::from(along[3 * channel + k])))
            })
        });
    }
    light
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

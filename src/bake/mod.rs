//! Joins the stages: decides what a scene needs ([`plan`]) and does it ([`bake`]). No loop over texels here.

mod account;
mod chart;
mod inspect;
mod light;
mod plan;
mod spacing;

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crate::atlas;
use crate::error::{Error, Result};
use crate::lights;
use crate::output;
use crate::refine;
use crate::scene::Scene;
use crate::texels;
use crate::transport;
use crate::visibility::Occluders;

pub use self::inspect::inspect;
pub use self::plan::{Decision, Plan, plan};

/// Everything that changes the result of a bake.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// How surfaces are laid out.
    pub atlas: atlas::Options,
    /// How emission becomes lights.
    pub lights: lights::Options,
    /// How light is evaluated. Whether gradients are is decided by `outputs`.
    pub transport: transport::Options,
    /// Target error of E relative to the page's maximum. Range: 1e-6..=1. Default: 0.004, one step of 255.
    pub tolerance: f64,
    /// Share of a receiver's light below which a light is tested by one shadow ray at most, see [`transport::Options::direct_threshold`].
    /// Range: 0..=1. Default: `None`, the tolerance. Bakes with derivatives, and those that interpolate, integrate every light.
    pub direct_threshold: Option<f64>,
    /// Where light is evaluated. Default: [`Refine::Off`], every texel.
    pub refine: Refine,
    /// Stores the light vector even when no material has a normal texture. Default: false.
    pub directional: bool,
    /// Stores 32-bit floats instead of halves everywhere. Default: false.
    pub float: bool,
    /// Which files to write; `None` lets the plan decide. The manifest is always written.
    pub outputs: Option<Vec<Output>>,
    /// Layouts of engines to write beside them. Default: none.
    pub exports: Vec<output::Export>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            atlas: atlas::Options::default(),
            lights: lights::Options::default(),
            transport: transport::Options::default(),
            tolerance: 0.004,
            direct_threshold: None,
            refine: Refine::Off,
            directional: false,
            float: false,
            outputs: None,
            exports: Vec::new(),
        }
    }
}

/// Where light is evaluated, as `--refine` spells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Refine {
    /// As [`Self::Texels`] where that is cheaper, else as [`Self::Off`]; the plan says which and why.
    Auto,
    /// At those texels between which it bends; at the others it is interpolated.
    Texels,
    /// At every texel: the reference.
    Off,
}

/// A kind of file of a bake, as `--outputs` spells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Output {
    /// Irradiance at the flat normal.
    E,
    /// Light vector.
    G,
    /// Fluence.
    Phi,
    /// Derivatives of G per texel step.
    Gradient,
    /// Estimated error of E.
    Error,
    /// Tone-mapped picture.
    Preview,
    /// The scene with its lightmap coordinates.
    Glb,
    /// Light vector and fluence as one texture.
    Ktx2,
}

impl Options {
    /// Checks every range.
    ///
    /// # Errors
    /// `InvalidOption` that names the first option out of its range, the range and the value.
    pub fn validate(&self) -> Result<()> {
        let density = self.atlas.texels_per_metre;
        check_range("texels-per-metre", density, (1e-3, 1e4))?;
        check_range("tolerance", self.tolerance, (1e-6, 1.0))?;
        check_range("page", f64::from(self.atlas.page), (64.0, 16384.0))?;
        check_range("padding", f64::from(self.atlas.padding), (2.0, 64.0))?;
        let samples = f64::from(self.transport.samples);
        check_range("samples", samples, (1.0, 65536.0))?;
        let threshold = self.direct_threshold.unwrap_or(0.0);
        check_range("direct-threshold", threshold, (0.0, 1.0))?;
        let certainty = self.transport.direct_certainty;
        check_range("direct-certainty", certainty, (0.0, 1.0))?;
        check_range("sky-lights", self.lights.sky_lights as f64, (1.0, 4096.0))?;
        check_range("light-radius", self.lights.light_radius, (0.0, 1e3))?;
        let sun_angle = self.lights.sun_angle.to_degrees();
        check_range("sun-angle", sun_angle, (0.0, 90.0))
    }
}

impl Options {
    fn asks_for(&self, output: Output) -> bool {
        self.outputs
            .as_ref()
            .is_some_and(|outputs| outputs.contains(&output))
    }
}

/// Refuses a value outside `low..=high` (NaN included).
fn check_range(option: &'static str, value: f64, (low, high): (f64, f64)) -> Result<()> {
    if low <= value && value <= high {
        return Ok(());
    }
    Err(Error::InvalidOption {
        option,
        reason: format!("must be in {low}..={high}, is {value}"),
    })
}

/// What does not change the result.
#[derive(Clone, Copy)]
pub struct Execution<'a> {
    /// Worker threads; `None` takes one per core.
    pub threads: Option<usize>,
    /// Set it to stop; the bake then ends with [`Error::Interrupted`] and leaves the previous files as they were.
    pub cancelled: &'a AtomicBool,
    /// Told of every step, from any thread.
    pub progress: &'a (dyn Fn(Progress) + Sync),
}

impl std::fmt::Debug for Execution<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Execution")
            .field("threads", &self.threads)
            .finish_non_exhaustive()
    }
}

impl Execution<'_> {
    /// Runs `work` on this execution's threads.
    fn run<R: Send>(&self, work: impl FnOnce() -> R + Send) -> Result<R> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads.unwrap_or(0))
            .build()
            .map_err(|error| Error::InvalidOption {
                option: "threads",
                reason: error.to_string(),
            })?;
        Ok(pool.install(work))
    }

    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// [`Error::Interrupted`] when the caller asked to stop.
    fn check(&self) -> Result<()> {
        if self.is_cancelled() {
            return Err(Error::Interrupted);
        }
        Ok(())
    }

    fn report(&self, stage: Stage, done: u64, total: u64) {
        (self.progress)(Progress { stage, done, total });
    }
}

/// How far a bake has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done.
    pub stage: Stage,
    /// Units of it that are done (texels for [`Stage::Light`], pages for [`Stage::Write`]).
    pub done: u64,
    /// Units in all; 0 when unknown. An estimate while pages are still to come.
    pub total: u64,
}

/// Steps of a bake, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Laying out surfaces.
    Atlas,
    /// Building lights and occluders.
    Prepare,
    /// Evaluating light, in texels; pages are written in between.
    Light,
    /// Writing the scene, the manifest and the final names.
    Write,
}

/// What a finished bake says of itself.
#[derive(Clone, Debug)]
pub struct Report {
    /// The manifest as it was written.
    pub manifest: serde_json::Value,
    /// Names of the files in the bake's directory, sorted.
    pub files: Vec<String>,
    /// Wall seconds of each step. Not part of the manifest, so that the same input gives the same bytes.
    pub seconds: Vec<(Stage, f64)>,
    /// What the bake fell short of, if anything (exit code 3).
    pub shortfalls: Vec<String>,
}

/// Bakes `scene` into `directory`.
///
/// The same scene and options give the same files, whatever the execution.
///
/// # Errors
/// `InvalidOption`, `TooLarge`, `InvalidFile`, `Io`, `Interrupted`; in each case the directory keeps what it had.
pub fn bake(
    scene: &Scene,
    directory: &Path,
    options: &Options,
    execution: &Execution<'_>,
) -> Result<Report> {
    options.validate()?;
    execution.run(|| bake_here(scene, directory, options, execution))?
}

fn bake_here(
    scene: &Scene,
    directory: &Path,
    options: &Options,
    execution: &Execution<'_>,
) -> Result<Report> {
    let mut clock = Clock::start();
    let mut warnings = scene.warnings.clone();

    execution.report(Stage::Atlas, 0, 0);
    let atlas = atlas::build(scene, &options.atlas, &|| execution.is_cancelled())?;
    warnings.extend(atlas.warnings.clone());
    clock.lap(Stage::Atlas);

    execution.report(Stage::Prepare, 0, 0);
    let lights = lights::collect(scene, &options.lights);
    warnings.extend(lights.warnings.clone());
    let occluders = Occluders::build(scene);
    let plan = plan(scene, &lights, options);
    let mut writer = output::Writer::create(directory, &scene.name, &plan.output(options))?;
    execution.check()?;
    clock.lap(Stage::Prepare);

    let evaluation = light::Evaluation::new(scene, &lights, &occluders, &plan, options);
    let mut account = account::Account::new(options.tolerance);
    let mut pages = Vec::new();
    for page in 0..atlas.pages.len() {
        let mut texels = texels::cover(scene, &atlas, page);
        account.pushed_out += texels::push_out(&mut texels, &|origin, direction, distance| {
            light::first_obstacle(scene, &occluders, origin, direction, distance)
        });
        let progress = light::PageProgress::new(&atlas, page, account.texels, texels.texels.len());
        let field = evaluation.page(&texels, &mut account, &progress, execution)?;
        warnings.extend(texels.warnings);
        pages.push(writer.page(page, &field)?);
    }
    clock.lap(Stage::Light);

    execution.report(Stage::Write, 0, 0);
    if plan.writes(Output::Glb) {
        writer.glb(scene, &atlas, &pages)?;
    }
    let baked = account::Baked {
        scene,
        options,
        plan: &plan,
        atlas: &atlas,
        lights: &lights,
        pages: &pages,
        warnings: &warnings,
    };
    let manifest = account.manifest(&baked);
    writer.manifest(&manifest)?;
    execution.check()?;
    let files = writer.commit()?;
    clock.lap(Stage::Write);

    Ok(Report {
        manifest,
        files,
        seconds: clock.laps,
        shortfalls: account.shortfalls(&baked),
    })
}

/// Evaluates the light at single points: a light meter. Samples come in the order of `points`, which need not lie close together; each
/// point's own `seed` names it in random numbers.
///
/// # Errors
/// `InvalidOption`, `Interrupted`.
pub fn probe(
    scene: &Scene,
    points: &[transport::Receiver],
    options: &Options,
    execution: &Execution<'_>,
) -> Result<(Vec<transport::Sample>, transport::Counters)> {
    options.validate()?;
    execution.run(|| {
        execution.report(Stage::Prepare, 0, 0);
        let lights = lights::collect(scene, &options.lights);
        let occluders = Occluders::build(scene);
        let transport_options = transport::Options {
            gradients: options.direct_threshold.is_none(),
            direct_threshold: options.direct_threshold.unwrap_or(0.0),
            ..options.transport.clone()
        };
        let done = AtomicU64::new(0);
        let total = points.len() as u64;
        execution.report(Stage::Light, 0, total);
        let results = refine::every_tile(
            points,
            |point| {
                transport::gather(
                    std::slice::from_ref(point),
                    &lights,
                    &occluders,
                    &transport_options,
                )
            },
            &|_| {
                // A report per point would cost more than many points do.
                let count = done.fetch_add(1, Ordering::Relaxed) + 1;
                if count.is_multiple_of(256) || count == total {
                    execution.report(Stage::Light, count, total);
                }
            },
            &|| execution.is_cancelled(),
        )?;
        let mut counters = transport::Counters::default();
        let samples = results
            .into_iter()
            .flat_map(|(samples, point_counters)| {
                counters.add(&point_counters);
                samples
            })
            .collect();
        Ok((samples, counters))
    })?
}

/// Wall time of the steps.
struct Clock {
    last: Instant,
    laps: Vec<(Stage, f64)>,
}

impl Clock {
    fn start() -> Self {
        Self {
            last: Instant::now(),
            laps: Vec::new(),
        }
    }

    fn lap(&mut self, stage: Stage) {
        let now = Instant::now();
        self.laps.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }
}

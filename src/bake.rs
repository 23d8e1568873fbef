//! Joins the stages: what to do for a scene, and doing it. No loop over texels here.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use crate::atlas;
use crate::error::Result;
use crate::lights;
use crate::output;
use crate::scene::Scene;
use crate::transport;

/// Everything that changes the result of a bake.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// How surfaces are laid out.
    pub atlas: atlas::Options,
    /// How emission becomes lights.
    pub lights: lights::Options,
    /// How light is evaluated.
    pub transport: transport::Options,
    /// How files are written.
    pub output: output::Options,
    /// Target error of E relative to the page's maximum. Range: 1e-6..=1. Default: 0.004, one step of 255.
    pub tolerance: f64,
    /// Stores the light vector even when no material has a normal texture.
    pub directional: bool,
    /// Which files to write; `None` lets the plan decide.
    pub outputs: Option<Vec<Output>>,
}

/// A kind of file of a bake, as `--outputs` spells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
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
}

impl Default for Options {
    fn default() -> Self {
        Self {
            atlas: atlas::Options::default(),
            lights: lights::Options::default(),
            transport: transport::Options::default(),
            output: output::Options::default(),
            tolerance: 0.004,
            directional: false,
            outputs: None,
        }
    }
}

/// What does not change the result.
#[derive(Clone, Copy)]
pub struct Execution<'a> {
    /// Worker threads; `None` takes one per core.
    pub threads: Option<usize>,
    /// Set it to stop; the bake then ends with [`crate::Error::Interrupted`] and leaves the previous files as they were.
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

/// How far a bake has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done.
    pub stage: Stage,
    /// Units of it that are done (texels for [`Stage::Light`]).
    pub done: u64,
    /// Units in all; 0 when unknown.
    pub total: u64,
}

/// Steps of a bake, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Laying out surfaces.
    Atlas,
    /// Building lights and occluders.
    Prepare,
    /// Evaluating light, in texels.
    Light,
    /// Writing files.
    Write,
}

/// Decisions about a bake, each with its reason.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Plan {
    /// In the order of the stages.
    pub decisions: Vec<Decision>,
}

/// One thing that is done or left out.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Decision {
    /// The stage, channel, ray or file: `light vector`, `alpha test`, `sky`.
    pub what: &'static str,
    /// Whether it is done.
    pub done: bool,
    /// Why.
    pub reason: String,
}

/// What a finished bake says of itself.
#[derive(Clone, Debug)]
pub struct Report {
    /// The manifest as it was written.
    pub manifest: serde_json::Value,
    /// Names of the files in the bake's directory, sorted.
    pub files: Vec<String>,
    /// Whether the bake fell short of what was asked, and in what (exit code 3).
    pub shortfalls: Vec<String>,
}

/// Decides what a bake of `scene` does and leaves out.
#[must_use]
pub fn plan(_scene: &Scene, _lights: &lights::Lights, _options: &Options) -> Plan {
    unimplemented!()
}

/// Bakes `scene` into `directory`.
///
/// # Errors
/// `InvalidOption`, `TooLarge`, `Io`, `Interrupted`; in each case the directory keeps what it had.
pub fn bake(
    _scene: &Scene,
    _directory: &Path,
    _options: &Options,
    _execution: &Execution<'_>,
) -> Result<Report> {
    unimplemented!()
}

/// Evaluates the light at single points: a light meter. Samples come in the order of `points`, which need not be close together.
///
/// # Errors
/// `InvalidOption`, `Interrupted`.
pub fn probe(
    _scene: &Scene,
    _points: &[transport::Receiver],
    _options: &Options,
    _execution: &Execution<'_>,
) -> Result<(Vec<transport::Sample>, transport::Counters)> {
    unimplemented!()
}

/// What is in `scene`, what is odd about it, what a bake would do and leave out, and what it needs: a JSON object with the keys
/// `scene`, `warnings`, `lights`, `atlas`, `plan`, `memory`.
///
/// # Errors
/// Those of laying out the atlas.
pub fn inspect(
    _scene: &Scene,
    _options: &Options,
    _execution: &Execution<'_>,
) -> Result<serde_json::Value> {
    unimplemented!()
}

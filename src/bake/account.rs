//! A bake's own account: counters, error figures, and the manifest that carries them.

use serde_json::{Value, json};

use super::{Options, Plan};
use crate::atlas::Atlas;
use crate::error::Warnings;
use crate::lights::Lights;
use crate::output::PageFiles;
use crate::scene::Scene;
use crate::texels::Texels;
use crate::transport::Counters;

/// Sums over the pages of a bake.
pub(super) struct Account {
    tolerance: f64,
    /// Texels of all pages.
    pub(super) texels: u64,
    /// Texels that were interpolated.
    interpolated: u64,
    /// Texels moved out of other geometry.
    pub(super) pushed_out: usize,
    tiles: u64,
    counters: Counters,
    /// Estimated error of E relative to the page's maximum, per texel.
    errors: Vec<f32>,
}

/// What a manifest is about.
pub(super) struct Baked<'a> {
    pub(super) scene: &'a Scene,
    pub(super) options: &'a Options,
    pub(super) plan: &'a Plan,
    pub(super) atlas: &'a Atlas,
    pub(super) lights: &'a Lights,
    pub(super) pages: &'a [PageFiles],
    pub(super) warnings: &'a Warnings,
}

impl Account {
    pub(super) fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            texels: 0,
            interpolated: 0,
            pushed_out: 0,
            tiles: 0,
            counters: Counters::default(),
            errors: Vec::new(),
        }
    }

    /// Adds a page. `figures` gives, per texel, (E, error of E).
    pub(super) fn page(&mut self, texels: &Texels, counters: &Counters, figures: &[[f32; 2]]) {
        let first = self.errors.len();
        let mut largest = 0.0_f32;
        self.counters.add(counters);
        self.tiles += texels.tiles.len() as u64;
        self.interpolated += (texels.texels.len() as u64).saturating_sub(counters.points);
        for &[irradiance, error] in figures {
            largest = largest.max(irradiance);
            self.errors.push(error);
        }
        self.texels += texels.texels.len() as u64;
        for error in &mut self.errors[first..] {
            // A page without light has no error either.
            *error = if largest > 0.0 { *error / largest } else { 0.0 };
        }
    }

    fn share_over_tolerance(&self) -> f64 {
        let n_over = self
            .errors
            .iter()
            .filter(|&&error| f64::from(error) > self.tolerance)
            .count();
        n_over as f64 / self.errors.len().max(1) as f64
    }

    /// What the bake fell short of.
    pub(super) fn shortfalls(&self, baked: &Baked<'_>) -> Vec<String> {
        let mut shortfalls = Vec::new();
        if !baked.scene.instances.is_empty() && self.texels == 0 {
            shortfalls.push("no surface got a texel".to_owned());
        }
        shortfalls
    }

    /// Estimated errors of E, relative to the page's maximum.
    fn error_figures(&self) -> Value {
        let mut sorted = self.errors.clone();
        sorted.sort_by(f32::total_cmp);
        let quantile = |share: f64| {
            let index = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
            sorted.get(index).copied().unwrap_or(0.0)
        };
        let sum: f64 = sorted.iter().map(|&error| f64::from(error)).sum();
        json!({
            "relativeTo": "largest irradiance of the page",
            "mean": sum / sorted.len().max(1) as f64,
            "p99": quantile(0.99),
            "max": quantile(1.0),
            "tolerance": self.tolerance,
            "shareOverTolerance": self.share_over_tolerance(),
        })
    }

    pub(super) fn manifest(&self, baked: &Baked<'_>) -> Value {
        let &Baked {
            scene,
            options,
            plan,
            atlas,
            lights,
            pages,
            warnings,
        } = baked;
        let nodes: Vec<Value> = atlas
            .placements
            .iter()
            .map(|placement| placement_json(scene, atlas, placement))
            .collect();
        json!({
            "lumel": env!("CARGO_PKG_VERSION"),
            "scene": scene.name,
            "units": {
                "length": "metre",
                "irradiance": "lux",
                "fluence": "lux",
                "lightVector": "lux",
                "gradient": "lux per texel",
            },
            "axes": "right-handed, Y up, world space",
            "rows": "row 0 is the top row, v = 0 at the top, texel centres at halves",
            "pages": pages,
            "nodes": nodes,
            "options": options_json(options),
            "plan": plan.decisions,
            "counters": {
                "texels": self.texels,
                "evaluatedTexels": self.texels - self.interpolated,
                "interpolatedTexels": self.interpolated,
                "tiles": self.tiles,
                "pushedOut": self.pushed_out,
                "lights": lights.len(),
                "light": self.counters,
            },
            "error": self.error_figures(),
            "warnings": warnings,
        })
    }
}

fn placement_json(scene: &Scene, atlas: &Atlas, placement: &crate::atlas::Placement) -> Value {
    let instance = &scene.instances[placement.instance];
    let unwrap = &atlas.unwraps[placement.unwrap];
    let page = atlas.pages[placement.page];
    let sides = [f64::from(page.width), f64::from(page.height)];
    let scale: Vec<f64> = (0..2)
        .map(|k| f64::from(unwrap.size[k]) / sides[k])
        .collect();
    let offset: Vec<f64> = (0..2)
        .map(|k| f64::from(placement.offset[k]) / sides[k])
        .collect();
    let mut node = json!({
        "node": instance.node,
        "name": instance.name,
        "page": placement.page,
        "scale": scale,
        "offset": offset,
        "charts": unwrap.n_charts,
        "authored": unwrap.authored,
    });
    if let Some(copy) = instance.copy {
        node["copy"] = json!(copy);
    }
    node
}

/// The options as the command spells them, so that a bake can be repeated.
fn options_json(options: &Options) -> Value {
    json!({
        "texels-per-metre": options.atlas.texels_per_metre,
        "page": options.atlas.page,
        "padding": options.atlas.padding,
        "uv": format!("{:?}", options.atlas.uv).to_lowercase(),
        "tolerance": options.tolerance,
        "estimator": options.transport.estimator,
        "samples": options.transport.samples,
        "direct-threshold": options.direct_threshold.unwrap_or(options.tolerance),
        "direct-certainty": options.transport.direct_certainty,
        "sky-lights": options.lights.sky_lights,
        "sky-mode": options.lights.sky_mode,
        "light-radius": options.lights.light_radius,
        "sun-angle": options.lights.sun_angle.to_degrees(),
        "refine": options.refine,
        "directional": options.directional,
        "float": options.float,
        "outputs": options.outputs,
        "export": options.exports,
    })
}

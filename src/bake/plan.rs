//! What a scene needs, and what it gives no reason for.

use super::{Options, Output, Refine};
use crate::lights::Lights;
use crate::output;
use crate::scene::Alpha;
use crate::scene::Scene;
use crate::transport::{self, Estimator};

/// Decisions about a bake, each with its reason.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Plan {
    /// In the order of the stages.
    pub decisions: Vec<Decision>,
    /// Whether light is evaluated only where it bends.
    pub interpolates: bool,
    /// The files to write.
    pub outputs: Vec<Output>,
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

impl Plan {
    /// Whether the bake writes this kind of file.
    #[must_use]
    pub fn writes(&self, output: Output) -> bool {
        self.outputs.contains(&output)
    }

    pub(super) fn output(&self, options: &Options) -> output::Options {
        output::Options {
            float: options.float,
            tolerance: options.tolerance,
            dilation: options.atlas.padding,
            preview: self.writes(Output::Preview),
            glb: self.writes(Output::Glb),
        }
    }

    pub(super) fn transport(&self, options: &Options) -> transport::Options {
        transport::Options {
            gradients: self.writes(Output::Gradient) || self.interpolates,
            direct_threshold: options.direct_threshold.unwrap_or(options.tolerance),
            ..options.transport.clone()
        }
    }

    fn decide(&mut self, what: &'static str, done: bool, reason: impl Into<String>) {
        self.decisions.push(Decision {
            what,
            done,
            reason: reason.into(),
        });
    }

    fn decide_file(&mut self, what: &'static str, file: Output, done: bool, reason: &str) {
        self.decide(what, done, reason);
        if done {
            self.outputs.push(file);
        }
    }
}

/// Decides what a bake of `scene` does and leaves out.
#[must_use]
pub fn plan(scene: &Scene, lights: &Lights, options: &Options) -> Plan {
    let mut plan = Plan {
        decisions: Vec::new(),
        interpolates: false,
        outputs: Vec::new(),
    };
    decide_light(&mut plan, scene, lights, options);
    decide_files(&mut plan, scene, lights, options);
    plan
}

fn decide_light(plan: &mut Plan, scene: &Scene, lights: &Lights, options: &Options) {
    let n_polygons = lights.polygons.len();
    plan.decide(
        "area lights",
        n_polygons > 0,
        if n_polygons > 0 {
            let n_triangles: usize = lights.polygons.iter().map(|p| p.surface.len()).sum();
            format!("{n_triangles} emissive triangles make {n_polygons} polygons")
        } else {
            "no material emits".to_owned()
        },
    );
    decide_punctual(plan, scene, lights);
    if lights.len() > 1 {
        plan.decide(
            "dim lights",
            false,
            "where lights together can add no more than a quarter of the tolerance to a tile, they are left out there and counted as error",
        );
    }
    let (interpolates, reason) = decide_refine(lights, options);
    plan.interpolates = interpolates;
    plan.decide("interpolation", interpolates, reason);
    if lights.len() >= transport::MANY_LIGHTS {
        let threshold = options.direct_threshold.unwrap_or(options.tolerance);
        let gradients = options.asks_for(Output::Gradient);
        plan.decide(
            "adaptive shadow testing",
            threshold > 0.0 && !gradients && !interpolates,
            if gradients {
                "derivatives were asked for, so every light is integrated".to_owned()
            } else if interpolates {
                "light is interpolated, which needs derivatives, so every light is integrated".to_owned()
            } else if threshold > 0.0 {
                format!(
                    "of {} lights those that could give a tile less than {threshold} of its light are tested by one ray at most",
                    lights.len()
                )
            } else {
                "--direct-threshold 0: every light is integrated".to_owned()
            },
        );
    }
    plan.decide("sky", false, "this version does not bake skies yet");

    let n_masked = count_triangles(scene, |alpha| matches!(alpha, Alpha::Mask { .. }));
    plan.decide(
        "alpha test",
        n_masked > 0,
        if n_masked > 0 {
            format!("{n_masked} triangles have alphaMode MASK")
        } else {
            "no material has alphaMode MASK".to_owned()
        },
    );
    let n_blended = count_triangles(scene, |alpha| alpha == Alpha::Blend);
    if n_blended > 0 {
        plan.decide(
            "tinted shadows",
            false,
            format!(
                "{n_blended} triangles have alphaMode BLEND; in this version they cast no shadow"
            ),
        );
    }
}

/// Whether to interpolate, and why.
fn decide_refine(lights: &Lights, options: &Options) -> (bool, &'static str) {
    let threshold = options.direct_threshold.unwrap_or(options.tolerance);
    let tests_adaptively = lights.len() >= transport::MANY_LIGHTS
        && threshold > 0.0
        && !options.asks_for(Output::Gradient);
    let has_derivatives = !matches!(
        options.transport.estimator,
        Estimator::Sampled | Estimator::Vedel
    );
    match options.refine {
        Refine::Off => (false, "--refine off: every texel is evaluated"),
        Refine::Texels => (true, "as asked with --refine texels"),
        Refine::Auto if lights.is_empty() => (false, "no light"),
        Refine::Auto if tests_adaptively => (
            false,
            "many lights: testing them adaptively at every texel is cheaper than integrating all of them for their derivatives",
        ),
        Refine::Auto if !has_derivatives => (
            false,
            "the estimator asked for has no derivatives that could be relied on",
        ),
        Refine::Auto => (
            true,
            "texels are evaluated where light bends, by its derivatives; the others are interpolated",
        ),
    }
}

fn decide_punctual(plan: &mut Plan, scene: &Scene, lights: &Lights) {
    let n_authored = scene.punctual_lights.len();
    let soft = lights.points.iter().filter(|point| point.radius > 0.0);
    let n_soft = soft.count() + lights.distant.len();
    let n_hard = lights.points.len() + lights.distant.len() + lights.suns.len() - n_soft;
    plan.decide(
        "penumbrae of punctual lights",
        n_soft > 0,
        if n_soft > 0 {
            format!("{n_soft} have a size (--sun-angle, --light-radius, extras)")
        } else if n_authored > 0 {
            "none has a size (--sun-angle, --light-radius, extras)".to_owned()
        } else {
            "no punctual light in the scene".to_owned()
        },
    );
    plan.decide(
        "hard shadows",
        n_hard > 0,
        if n_hard > 0 {
            format!("{n_hard} punctual lights have no size: one ray per texel where something may stand in the way")
        } else {
            "no light is a point".to_owned()
        },
    );
    let n_dark = n_authored - n_soft - n_hard;
    if n_dark > 0 {
        plan.decide(
            "punctual lights without intensity",
            false,
            format!("{n_dark} of them give no light"),
        );
    }
}

fn decide_files(plan: &mut Plan, scene: &Scene, lights: &Lights, options: &Options) {
    if let Some(outputs) = &options.outputs {
        plan.outputs = outputs.clone();
        plan.outputs.sort();
        plan.outputs.dedup();
        plan.decide("files", true, "as asked with --outputs");
        return;
    }
    let normal_mapped = scene.any_material(|material| material.normal_mapped);
    let directional = normal_mapped || options.directional;
    plan.decide_file("irradiance", Output::E, true, "every engine reads it");
    plan.decide_file(
        "light vector",
        Output::G,
        directional,
        if normal_mapped {
            "a material has a normal texture"
        } else if options.directional {
            "asked with --directional"
        } else {
            "no material has a normal texture, so the irradiance alone says everything"
        },
    );
    plan.decide_file(
        "fluence",
        Output::Phi,
        directional && !lights.is_empty(),
        if !directional {
            "no light vector to complete"
        } else if lights.is_empty() {
            "no light"
        } else {
            "light from several sides or a wide one: the light vector alone underestimates tilted normals"
        },
    );
    plan.decide_file(
        "gradients",
        Output::Gradient,
        false,
        "nobody asked (--outputs gradient)",
    );
    plan.decide_file(
        "error map",
        Output::Error,
        false,
        "nobody asked (--outputs error); its figures are in the manifest",
    );
    plan.decide_file("preview", Output::Preview, true, "to look at");
    let from_document = !scene.path.as_os_str().is_empty();
    plan.decide_file(
        "glb",
        Output::Glb,
        from_document,
        if from_document {
            "carries the lightmap coordinates"
        } else {
            "the scene was not read from a document"
        },
    );
}

fn count_triangles(scene: &Scene, test: impl Fn(Alpha) -> bool) -> usize {
    scene
        .triangles
        .iter()
        .filter(|triangle| test(scene.materials[triangle.material as usize].alpha))
        .count()
}

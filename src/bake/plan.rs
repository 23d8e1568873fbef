//! What a scene needs, and what it gives no reason for.

use super::{Options, Output, Refine};
use crate::lights::Lights;
use crate::lights::SkyMode;
use crate::output;
use crate::scene::Alpha;
use crate::scene::Material;
use crate::scene::PunctualKind;
use crate::scene::PunctualLight;
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
    /// Layouts of engines to write beside them.
    pub exports: Vec<output::Export>,
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

    /// Whether a file is made of light vector and fluence together.
    pub(super) fn packs_light(&self) -> bool {
        let needed = |export: &output::Export| export.needs_light_vector();
        self.writes(Output::Ktx2) || self.exports.iter().any(needed)
    }

    /// Whether a layout of an engine is made of E.
    pub(super) fn exports_irradiance(&self) -> bool {
        self.exports.iter().any(|export| export.needs_irradiance())
    }

    pub(super) fn output(&self, options: &Options) -> output::Options {
        let mut without_map = Vec::new();
        // The preview is read back from the map of E.
        if !self.writes(Output::E) && !self.writes(Output::Preview) {
            without_map.push("E");
        }
        if !self.writes(Output::G) {
            without_map.extend(["Gr", "Gg", "Gb"]);
        }
        if !self.writes(Output::Phi) {
            without_map.push("phi");
        }
        output::Options {
            float: options.float,
            tolerance: options.tolerance,
            dilation: options.atlas.padding,
            preview: self.writes(Output::Preview),
            glb: self.writes(Output::Glb),
            ktx2: self.writes(Output::Ktx2),
            exports: self.exports.clone(),
            without_map,
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
        exports: options.exports.clone(),
    };
    plan.exports.sort();
    plan.exports.dedup();
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
            let n_authored = scene.area_lights.len();
            let n_own = n_polygons - n_authored.min(n_polygons);
            match n_authored {
                0 => format!("{n_triangles} emissive triangles make {n_polygons} polygons"),
                _ => format!("{n_triangles} emissive triangles make {n_own} polygons; {n_authored} are authored (EXT_lights_area)"),
            }
        } else {
            "no material emits".to_owned()
        },
    );
    decide_punctual(plan, scene, lights, options);
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
    decide_sky(plan, scene, lights, options);

    let n_masked = count_triangles(scene, |material| {
        matches!(material.alpha, Alpha::Mask { .. })
    });
    plan.decide(
        "alpha test",
        n_masked > 0,
        if n_masked > 0 {
            format!("{n_masked} triangles have alphaMode MASK")
        } else {
            "no material has alphaMode MASK".to_owned()
        },
    );
    let n_translucent = count_triangles(scene, Material::is_translucent);
    plan.decide(
        "tinted shadows",
        n_translucent > 0,
        if n_translucent > 0 {
            format!("light passes through {n_translucent} triangles (BLEND, transmission); lights behind them are sampled")
        } else {
            "no material lets light through".to_owned()
        },
    );
}

fn decide_sky(plan: &mut Plan, scene: &Scene, lights: &Lights, options: &Options) {
    let Some(sky) = &scene.sky else {
        plan.decide("sky", false, "no sky was given (--sky, --sky-color)");
        return;
    };
    let n_parts = lights.distant.len() + lights.suns.len() - n_directional(scene);
    let size = format!("{} × {} pixels", sky.image.width(), sky.image.height());
    let reason = match options.lights.sky_mode {
        _ if n_parts == 0 => "it is black".to_owned(),
        SkyMode::Cells => {
            format!("{size} as {n_parts} polygons at infinity: smooth shadows without rays")
        }
        SkyMode::Points => format!("{size} as {n_parts} directions, as asked; a ray each"),
        SkyMode::Interleaved => format!(
            "{size} as {n_parts} directions, as asked; a texel casts rays to a ninth of them"
        ),
    };
    plan.decide("sky", n_parts > 0, reason);
}

/// Authored suns that shine.
fn n_directional(scene: &Scene) -> usize {
    let is_sun = |light: &&PunctualLight| {
        light.kind == PunctualKind::Directional && light.intensity.max_element() > 0.0
    };
    scene.punctual_lights.iter().filter(is_sun).count()
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
        Refine::Off => (
            false,
            "every texel is evaluated (--refine auto would interpolate)",
        ),
        Refine::Texels => (true, "as asked with --refine texels"),
        Refine::Auto if lights.is_empty() => (false, "no light"),
        Refine::Auto if tests_adaptively => (
            false,
            "many lights: testing them adaptively at every texel is cheaper than integrating all of them for their derivatives",
        ),
        Refine::Auto if !lights.suns.is_empty() => (
            false,
            "suns or sky directions without a size have shadows without derivatives",
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

fn decide_punctual(plan: &mut Plan, scene: &Scene, lights: &Lights, options: &Options) {
    let n_authored = scene.punctual_lights.len();
    let soft = lights.points.iter().filter(|point| point.radius > 0.0);
    let n_points = lights.points.len();
    let soft_suns = scene.punctual_lights.iter().filter(|light| {
        light.kind == PunctualKind::Directional
            && light.intensity.max_element() > 0.0
            && light.size.unwrap_or(options.lights.sun_angle) > 0.0
    });
    let n_soft = soft.count() + soft_suns.count();
    let n_hard = n_points + n_directional(scene) - n_soft;
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
    plan.decide_file(
        "texture",
        Output::Ktx2,
        false,
        "nobody asked (--outputs ktx2); engines that read KTX 2.0 load it as it is",
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

fn count_triangles(scene: &Scene, test: impl Fn(&Material) -> bool) -> usize {
    scene
        .triangles
        .iter()
        .filter(|triangle| test(&scene.materials[triangle.material as usize]))
        .count()
}

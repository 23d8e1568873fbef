//! `KHR_lights_punctual`.

use glam::{DAffine3, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::document::Document;
use super::node::Hierarchy;
use super::{PunctualKind, PunctualLight};
use crate::error::{Result, Warnings};

/// A light as it is authored.
#[derive(Deserialize)]
struct Light {
    name: Option<String>,
    #[serde(rename = "type")]
    kind: String,
    #[serde(default = "white")]
    color: [f64; 3],
    #[serde(default = "one")]
    intensity: f64,
    range: Option<f64>,
    #[serde(default)]
    spot: Spot,
}

#[derive(Deserialize)]
#[serde(default)]
struct Spot {
    #[serde(rename = "innerConeAngle")]
    inner: f64,
    #[serde(rename = "outerConeAngle")]
    outer: f64,
}

impl Default for Spot {
    fn default() -> Self {
        Self {
            inner: 0.0,
            outer: std::f64::consts::FRAC_PI_4,
        }
    }
}

fn white() -> [f64; 3] {
    [1.0; 3]
}

fn one() -> f64 {
    1.0
}

/// The lights at the nodes of the scene, in the order of the nodes. One that makes no sense is left out with a warning.
pub(super) fn collect(
    document: &Document<'_>,
    hierarchy: &Hierarchy,
    warnings: &mut Warnings,
) -> Result<Vec<PunctualLight>> {
    const PLACE: &str = "extensions.KHR_lights_punctual.lights";
    let list: &[Value] = document
        .json
        .get("extensions")
        .and_then(|extensions| {
            extensions
                .get("KHR_lights_punctual")?
                .get("lights")?
                .as_array()
        })
        .map_or(&[], Vec::as_slice);
    let mut lights = Vec::new();
    for &node in &hierarchy.order {
        let Some(reference) = &hierarchy.nodes[node].extensions.light else {
            continue;
        };
        let index = reference.light;
        let value = list.get(index).ok_or_else(|| {
            document.invalid(
                format!("nodes[{node}].extensions.KHR_lights_punctual.light"),
                format!("refers to light {index}, but there are {}", list.len()),
            )
        })?;
        let light: Light = document.parse(value, || format!("{PLACE}[{index}]"))?;
        match place(&light, &hierarchy.world[node]) {
            Ok((position, direction, kind)) => lights.push(PunctualLight {
                name: light.name.unwrap_or_else(|| format!("light{index}")),
                node,
                intensity: DVec3::from_array(light.color) * light.intensity,
                position,
                direction,
                kind,
                size: size(
                    kind,
                    &hierarchy.nodes[node].extras,
                    &format!("nodes[{node}]"),
                    warnings,
                ),
            }),
            Err(reason) => warnings.push(
                "light makes no sense, left out",
                format!("{PLACE}[{index}] at nodes[{node}] ({reason})"),
            ),
        }
    }
    Ok(lights)
}

/// Position, direction and kind of a light; else what is wrong with it.
fn place(
    light: &Light,
    world: &DAffine3,
) -> std::result::Result<(DVec3, DVec3, PunctualKind), &'static str> {
    if light.intensity < 0.0 || light.color.iter().any(|channel| *channel < 0.0) {
        return Err("intensity or colour is negative");
    }
    if !(DVec3::from_array(light.color) * light.intensity).is_finite() {
        return Err("intensity is not finite");
    }
    if light.range.is_some_and(|range| range <= 0.0) {
        return Err("range is not positive");
    }
    let position = world.translation;
    if !position.is_finite() {
        return Err("position is not finite");
    }
    let range = light.range;
    let kind = match light.kind.as_str() {
        "point" => PunctualKind::Point { range },
        "spot" => {
            let Spot { inner, outer } = light.spot;
            if !(0.0 <= inner && inner < outer && outer <= std::f64::consts::FRAC_PI_2 + ROUNDING) {
                return Err("angles must keep 0 ≤ inner < outer ≤ π/2");
            }
            PunctualKind::Spot {
                range,
                inner_angle: inner,
                outer_angle: outer.min(std::f64::consts::FRAC_PI_2),
            }
        }
        "directional" => PunctualKind::Directional,
        _ => return Err("type is unknown"),
    };
    let direction = world.transform_vector3(DVec3::NEG_Z).try_normalize();
    match (direction, kind) {
        (Some(direction), _) => Ok((position, direction, kind)),
        // A point light has no direction to lose.
        (None, PunctualKind::Point { .. }) => Ok((position, DVec3::NEG_Z, kind)),
        (None, _) => Err("its node flattens its direction"),
    }
}

/// `extras.lumel.radius` of a node with a point or spot light, `extras.lumel.angular_diameter` of one with a directional light.
fn size(kind: PunctualKind, extras: &Value, place: &str, warnings: &mut Warnings) -> Option<f64> {
    let (key, largest, message) = match kind {
        PunctualKind::Point { .. } | PunctualKind::Spot { .. } => (
            "radius",
            f64::MAX,
            "extras.lumel.radius must be metres from 0 on, not looked at",
        ),
        PunctualKind::Directional => (
            "angular_diameter",
            std::f64::consts::FRAC_PI_2,
            "extras.lumel.angular_diameter must be radians in 0..=π/2, not looked at",
        ),
    };
    let value = extras.get("lumel")?.get(key)?;
    let size = value.as_f64().filter(|size| (0.0..=largest).contains(size));
    if size.is_none() {
        warnings.push(message, place);
    }
    size
}

/// Exporters write angles in f32; π/2 in f32 is above π/2.
const ROUNDING: f64 = 1e-6;

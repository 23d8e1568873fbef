//! `KHR_lights_punctual`, and the draft `EXT_lights_area`.

use glam::{DAffine3, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::document::Document;
use super::node::Hierarchy;
use super::{AreaLight, PunctualKind, PunctualLight};
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
    let list = list_of(document, "KHR_lights_punctual");
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

/// `lights` of an extension of the document.
fn list_of<'a>(document: &'a Document<'_>, extension: &str) -> &'a [Value] {
    document
        .json
        .get("extensions")
        .and_then(|extensions| extensions.get(extension)?.get("lights")?.as_array())
        .map_or(&[], Vec::as_slice)
}

/// An area light as it is authored.
#[derive(Deserialize)]
struct Area {
    name: Option<String>,
    #[serde(rename = "type", default = "rectangle")]
    kind: String,
    #[serde(default = "white")]
    color: [f64; 3],
    #[serde(default = "thousand")]
    intensity: f64,
    #[serde(default = "one")]
    size: f64,
    #[serde(default)]
    rect: Rectangle,
}

#[derive(Deserialize)]
#[serde(default)]
struct Rectangle {
    aspect: f64,
}

impl Default for Rectangle {
    fn default() -> Self {
        Self { aspect: 1.0 }
    }
}

fn rectangle() -> String {
    "rect".to_owned()
}

fn thousand() -> f64 {
    1000.0
}

/// The lights of `EXT_lights_area` at the nodes of the scene, in the order of the nodes. One that makes no sense is left out with a warning.
///
/// Source: the draft of the extension (glTF pull request 2525, state of September 2025).
pub(super) fn collect_areas(
    document: &Document<'_>,
    hierarchy: &Hierarchy,
    warnings: &mut Warnings,
) -> Result<Vec<AreaLight>> {
    const PLACE: &str = "extensions.EXT_lights_area.lights";
    let list = list_of(document, "EXT_lights_area");
    let mut lights = Vec::new();
    for &node in &hierarchy.order {
        let Some(reference) = &hierarchy.nodes[node].extensions.area_light else {
            continue;
        };
        let index = reference.light;
        let value = list.get(index).ok_or_else(|| {
            document.invalid(
                format!("nodes[{node}].extensions.EXT_lights_area.light"),
                format!("refers to light {index}, but there are {}", list.len()),
            )
        })?;
        let light: Area = document.parse(value, || format!("{PLACE}[{index}]"))?;
        match area(&light, &hierarchy.world[node]) {
            Ok((half_width, half_height)) => lights.push(AreaLight {
                name: light.name.unwrap_or_else(|| format!("area light{index}")),
                node,
                radiance: DVec3::from_array(light.color) * light.intensity,
                centre: hierarchy.world[node].translation,
                half_width,
                half_height,
                is_disc: light.kind == "disk",
            }),
            Err(reason) => warnings.push(
                "light makes no sense, left out",
                format!("{PLACE}[{index}] at nodes[{node}] ({reason})"),
            ),
        }
    }
    Ok(lights)
}

/// Half width and half height of an area light; else what is wrong with it.
fn area(light: &Area, world: &DAffine3) -> std::result::Result<(DVec3, DVec3), &'static str> {
    let radiance = DVec3::from_array(light.color) * light.intensity;
    if light.intensity < 0.0 || light.color.iter().any(|channel| *channel < 0.0) {
        return Err("intensity or colour is negative");
    }
    if !radiance.is_finite() || !world.translation.is_finite() {
        return Err("intensity or position is not finite");
    }
    if light.kind != "rect" && light.kind != "disk" {
        return Err("type is unknown");
    }
    let axes = world.matrix3;
    let scale = [axes.x_axis, axes.y_axis, axes.z_axis]
        .iter()
        .map(|axis| axis.length())
        .fold(0.0, f64::max);
    let backwards = axes.z_axis.try_normalize();
    let up = backwards.and_then(|back| axes.y_axis.reject_from_normalized(back).try_normalize());
    let (Some(backwards), Some(up)) = (backwards, up) else {
        return Err("its node flattens its direction");
    };
    let aspect = if light.kind == "rect" {
        light.rect.aspect
    } else {
        1.0
    };
    let height = 0.5 * scale * light.size;
    let width = height * aspect;
    if !(height > 0.0 && width > 0.0 && height.is_finite() && width.is_finite()) {
        return Err("size is not positive");
    }
    Ok((up.cross(backwards) * width, up * height))
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

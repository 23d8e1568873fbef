//! A sky ↔ JSON, so that it is made once per picture. Every number comes back to the bit.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::bright::Region;
use super::interleave::Quality;
use super::rule::{Cell, Rule};
use super::{Options, Sky};

/// Raised whenever the same picture and options give another rule, or the format changes.
const VERSION: u32 = 1;

const FORMAT: &str = "lumel sky";

/// How far from 1 the length of a direction may be. Ours are within rounding; somebody may have edited the file.
const LENGTH_TOLERANCE: f64 = 1e-9;

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    format: String,
    version: u32,
    /// 16 hexadecimal digits: more than a JSON number holds.
    image_hash: String,
    options: Options,
    units: Units,
    regions: Vec<StoredRegion>,
    sets: Vec<StoredRule>,
    composite: Option<StoredRule>,
    quality: Vec<Quality>,
}

/// For people and other programs.
#[derive(Default, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Units {
    fluence: String,
    light_vector: String,
    solid_angle: String,
    axes: String,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct StoredRule {
    decentration: f64,
    cells: Vec<StoredCell>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct StoredCell {
    direction: [f64; 3],
    fluence: [f64; 3],
    light_vector: [[f64; 3]; 3],
    solid_angle: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct StoredRegion {
    #[serde(flatten)]
    cell: StoredCell,
    polygon: Vec<[f64; 3]>,
    radiance: [f64; 3],
}

/// The text of the file that keeps `sky`.
#[must_use]
pub fn to_json(sky: &Sky) -> String {
    let file = File {
        format: FORMAT.to_owned(),
        version: VERSION,
        image_hash: hex(sky.hash),
        options: sky.options.clone(),
        units: Units {
            fluence: "lux, linear RGB: integral of radiance over the cell".to_owned(),
            light_vector: "lux, x y z per colour channel: integral of radiance times direction"
                .to_owned(),
            solid_angle: "steradians".to_owned(),
            axes: "of the picture: +X its centre, +Y its top row, +Z right of the centre"
                .to_owned(),
        },
        regions: sky
            .regions
            .iter()
            .map(|region| StoredRegion {
                cell: stored_cell(&region.cell),
                polygon: region.polygon.iter().map(DVec3::to_array).collect(),
                radiance: region.radiance.to_array(),
            })
            .collect(),
        sets: sky.sets.iter().map(stored_rule).collect(),
        composite: sky.composite.as_ref().map(stored_rule),
        quality: sky.quality.clone(),
    };
    format!("{:#}\n", serde_json::json!(file))
}

/// The sky in `text`, which [`to_json`] made, if it is of the picture with this `hash` and made with these `options`.
///
/// `None` for anything else: another version, a file that somebody broke, numbers that are no light.
#[must_use]
pub fn load_if_fits(text: &str, hash: u64, options: &Options) -> Option<Sky> {
    let file: File = serde_json::from_str(text).ok()?;
    let fits = file.format == FORMAT
        && file.version == VERSION
        && file.image_hash == hex(hash)
        && file.options == *options;
    if !fits || file.sets.len() != options.sets {
        return None;
    }
    let sky = Sky {
        hash,
        options: file.options,
        regions: file
            .regions
            .into_iter()
            .map(region)
            .collect::<Option<_>>()?,
        sets: file.sets.into_iter().map(rule).collect::<Option<_>>()?,
        composite: match file.composite {
            Some(stored) => Some(rule(stored)?),
            None => None,
        },
        quality: file.quality,
    };
    let n = sky.sets[0].cells.len();
    let all = sky
        .composite
        .as_ref()
        .map_or(n * options.sets, |rule| rule.cells.len());
    let are_complete = sky.sets.iter().all(|rule| rule.cells.len() == n)
        && (n == options.directions || n == 1)
        && (all == n * options.sets);
    are_complete.then_some(sky)
}

fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

fn stored_rule(rule: &Rule) -> StoredRule {
    StoredRule {
        decentration: rule.decentration,
        cells: rule.cells.iter().map(stored_cell).collect(),
    }
}

fn stored_cell(cell: &Cell) -> StoredCell {
    StoredCell {
        direction: cell.direction.to_array(),
        fluence: cell.fluence.to_array(),
        light_vector: cell.light_vector.map(|vector| vector.to_array()),
        solid_angle: cell.solid_angle,
    }
}

fn rule(stored: StoredRule) -> Option<Rule> {
    let cells: Vec<Cell> = stored.cells.into_iter().map(cell).collect::<Option<_>>()?;
    let is_sound = !cells.is_empty() && stored.decentration.is_finite();
    is_sound.then_some(Rule {
        cells,
        decentration: stored.decentration,
    })
}

fn cell(stored: StoredCell) -> Option<Cell> {
    let fluence = light(stored.fluence)?;
    let is_sound = stored
        .light_vector
        .iter()
        .all(|vector| DVec3::from_array(*vector).is_finite())
        && (0.0..=13.0).contains(&stored.solid_angle);
    is_sound.then_some(Cell {
        direction: unit(stored.direction)?,
        fluence,
        light_vector: stored.light_vector.map(DVec3::from_array),
        solid_angle: stored.solid_angle,
    })
}

fn region(stored: StoredRegion) -> Option<Region> {
    let polygon: Vec<DVec3> = stored
        .polygon
        .into_iter()
        .map(unit)
        .collect::<Option<_>>()?;
    let cell = cell(stored.cell)?;
    (polygon.len() >= 3).then_some(Region {
        cell,
        polygon,
        radiance: light(stored.radiance)?,
    })
}

fn unit(vector: [f64; 3]) -> Option<DVec3> {
    let vector = DVec3::from_array(vector);
    ((vector.length() - 1.0).abs() <= LENGTH_TOLERANCE).then_some(vector)
}

fn light(rgb: [f64; 3]) -> Option<DVec3> {
    rgb.iter()
        .all(|value| value.is_finite() && *value >= 0.0)
        .then(|| DVec3::from_array(rgb))
}

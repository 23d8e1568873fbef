//! What may cast shadows on a neighbourhood, before any light is evaluated there.

use super::Receiver;
use super::select::select;
use super::source::Source;
use crate::lights::Lights;
use crate::math::Aabb;
use crate::visibility::Occluders;

/// A light and what may stand between it and a group of receivers.
#[derive(Clone, Debug)]
pub struct Shadow {
    /// Triangles of the scene, in no particular order. Not empty.
    pub candidates: Vec<u32>,
    /// Narrowest width of the light in metres; 0 for points and suns without a size.
    pub width: f64,
    /// Metres from the middle of the receivers to that of the light.
    pub distance: f64,
}

/// The lights that something may hide, in part or in whole, from some of `receivers`. Lights that together cannot give them more than
/// `negligible` lux are left out.
#[must_use]
pub fn shadows(
    receivers: &[Receiver],
    lights: &Lights,
    occluders: &Occluders<'_>,
    negligible: f64,
) -> Vec<Shadow> {
    let places = Aabb::from_points(receivers.iter().map(|receiver| receiver.position));
    let sources = Source::all(lights, &places);
    let mut shadows = Vec::new();
    for index in select(&sources, receivers, negligible).lights {
        let source = &sources[index];
        let lit: Vec<Receiver> = receivers
            .iter()
            .filter(|receiver| source.shines_on(receiver))
            .copied()
            .collect();
        if lit.is_empty() {
            continue;
        }
        let own = source.own_triangles();
        let candidates = occluders.in_shaft(&source.shaft(&lit, &places), &|id| {
            own.binary_search(&id).is_ok()
        });
        if candidates.is_empty() {
            continue;
        }
        let bounds = source.bounds();
        let diameter = (bounds.max - bounds.min).max_element();
        shadows.push(Shadow {
            candidates,
            width: match source.polygon() {
                Some(polygon) if diameter > 0.0 => polygon.area / diameter,
                _ => diameter,
            },
            distance: bounds.centre().distance(places.centre()),
        });
    }
    shadows
}

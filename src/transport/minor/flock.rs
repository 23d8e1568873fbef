//! A group of small lights that is far away as one light.

use glam::DVec3;

use super::Minor;
use crate::transport::Receiver;
use crate::transport::contour::Sums;

/// Distance in its radii from which an open group of lights that look the same way counts as one, at its middle: it then gives
/// some 0.2 % more or less.
const AS_ONE: f64 = 15.0;

/// Cosine between normals that count as one: a thousandth of what a light gives edge-on.
const SAME_WAY: f64 = 1.0 - 1e-6;

/// Polygons of one direction as a speck.
pub(super) struct Flock {
    /// Weighted by what they give, world metres.
    centre: DVec3,
    /// Radius of a sphere around the centre that holds all.
    radius: f64,
    normal: DVec3,
    /// Sum of radiance × area, per channel.
    pub(super) output: DVec3,
}

impl Flock {
    /// Whether `receiver` is far enough away, before all of its lights, and all are above the horizon.
    pub(super) fn is_one_to(&self, receiver: &Receiver) -> bool {
        let offset = self.centre - receiver.position;
        offset.length_squared() > (AS_ONE * self.radius).powi(2)
            && offset.dot(receiver.normal) > self.radius
            && -offset.dot(self.normal) > self.radius
    }

    /// `None` when they do not look the same way, or one is not a polygon.
    pub(super) fn of(lights: &[Minor<'_, '_>]) -> Option<Self> {
        let first = lights.first()?.source.polygon()?.normal;
        let mut weight = 0.0;
        let mut flock = Self {
            centre: DVec3::ZERO,
            radius: 0.0,
            normal: first,
            output: DVec3::ZERO,
        };
        for minor in lights {
            let polygon = minor.source.polygon()?;
            if polygon.two_sided || polygon.normal.dot(first) < SAME_WAY {
                return None;
            }
            let output = polygon.radiance * polygon.area;
            let share = output.element_sum();
            flock.output += output;
            flock.centre += share * minor.source.bounds().centre();
            weight += share;
        }
        flock.centre /= weight;
        for minor in lights {
            let bounds = minor.source.bounds();
            let reach = bounds.centre().distance(flock.centre) + 0.5 * bounds.diagonal();
            flock.radius = flock.radius.max(reach);
        }
        flock.centre.is_finite().then_some(flock)
    }

    /// Light of a square metre at the centre.
    pub(super) fn sums(&self, position: DVec3) -> Sums {
        let offset = self.centre - position;
        let square = offset.length_squared();
        let distance = square.sqrt();
        let phi = -offset.dot(self.normal) / (distance * square);
        Sums {
            g: offset * (phi / distance),
            phi,
            rounding: phi / (AS_ONE * AS_ONE),
            ..Sums::DARK
        }
    }
}

//! Coordinates in the plane of a light as one receiver sees it.
//!
//! Their unit is the size of the light and their origin its centre. Occluder vertices are homogeneous there, `(X, Y, W)` with W the depth
//! over the depth of the light.

use glam::{DVec2, DVec3};

use super::contour::Piece;

/// Rounding of a position in the plane of the light, in units in the last place of the largest coordinate involved. A position is the
/// result of an affine transform (a few roundings), two subtractions and a projection.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// Metres by which rounding may have moved a position in the plane of the light with these contours, which are relative to `receiver`.
pub(super) fn rounding(receiver: DVec3, borders: &[Piece]) -> f64 {
    let reach = borders
        .iter()
        .map(|border| border.a.abs().max_element())
        .fold(0.0, f64::max);
    ROUNDING * (reach + receiver.abs().max_element())
}

/// The plane of a light in the receiver's eyes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    /// Axes of the plane over the size of the light, the second a quarter turn clockwise from the first as the receiver sees it, so that
    /// contours, which are clockwise, become counter-clockwise; `forward` over the depth of the light.
    pub(super) right: DVec3,
    up: DVec3,
    forward: DVec3,
    /// Centre of the light relative to the receiver.
    centre: DVec3,
}

impl Frame {
    /// `None` when the receiver lies in the light's plane within rounding: the light is then seen edge-on.
    pub(super) fn new(borders: &[Piece], away: DVec3, rounding: f64) -> Option<Self> {
        let sum: DVec3 = borders.iter().map(|border| border.a).sum();
        let centre = sum / borders.len() as f64;
        let size = borders
            .iter()
            .map(|border| (border.a - centre).length())
            .fold(0.0, f64::max);
        let depth = centre.dot(away);
        if depth <= rounding || size <= 0.0 {
            return None;
        }
        let (u, v) = away.any_orthonormal_pair();
        let (right, up) = if u.cross(v).dot(away) > 0.0 {
            (u, v)
        } else {
            (v, u)
        };
        Some(Self {
            right: right / size,
            up: up / size,
            forward: away / depth,
            centre,
        })
    }

    /// Homogeneous coordinates of a point relative to the receiver.
    pub(super) fn project(&self, point: DVec3) -> DVec3 {
        let depth = self.forward.dot(point);
        let offset = point - depth * self.centre;
        DVec3::new(self.right.dot(offset), self.up.dot(offset), depth)
    }

    /// Where a point ahead of the receiver is seen.
    pub(super) fn place(&self, point: DVec3) -> DVec2 {
        let image = self.project(point);
        image.truncate() / image.z
    }

    /// The point of the light's plane at a place.
    pub(super) fn point(&self, place: DVec2) -> DVec3 {
        let size_squared = self.right.length_squared().recip();
        self.centre + size_squared * (place.x * self.right + place.y * self.up)
    }
}

/// How often closed loops of segments go round a place, counter-clockwise.
pub(super) fn turns_around(place: DVec2, segments: impl Iterator<Item = [DVec2; 2]>) -> i32 {
    segments
        .map(|[p, q]| {
            let upwards = q.y > p.y;
            let is_passed = (p.y <= place.y) != (q.y <= place.y);
            if is_passed && ((q - p).perp_dot(place - p) > 0.0) == upwards {
                if upwards { 1 } else { -1 }
            } else {
                0
            }
        })
        .sum()
}

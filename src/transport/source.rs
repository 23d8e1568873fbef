//! A light as a group of receivers meets it: what does not depend on the receiver is computed once.

use glam::DVec3;

use super::Receiver;
use super::clip::{self, Direction, Plane};
use super::contour::{self, Piece, Sums};
use super::distant;
use crate::lights::Polygon;
use crate::math::Aabb;

/// A receiver counts as lying in the light's plane when its distance from it is below the rounding of coordinates, this much
/// relative to the largest of them. Larger would darken receivers that see the light; smaller would let a surface flush with a light
/// catch light that is rounding only.
const COPLANAR: f64 = 8.0 * f64::EPSILON;

/// A light and its measures.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source<'a> {
    pub(super) polygon: &'a Polygon,
    plane: Plane,
    /// Middle of its box, and a radius around it that holds it.
    centre: DVec3,
    radius: f64,
    largest_coordinate: f64,
}

/// What a receiver could see of a light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unoccluded {
    /// Light per unit radiance if nothing stands in the way.
    pub(super) sums: Sums,
    /// A place, world metres, in the middle of the outline above the horizon.
    pub(super) middle: DVec3,
}

impl<'a> Source<'a> {
    pub(super) fn new(polygon: &'a Polygon) -> Self {
        let vertices = || polygon.contours.iter().flatten().copied();
        let bounds = Aabb::from_points(vertices());
        let centre = bounds.centre();
        Self {
            polygon,
            plane: Plane {
                point: vertices().next().unwrap_or_default(),
                normal: polygon.normal,
            },
            centre,
            radius: vertices()
                .map(|vertex| vertex.distance(centre))
                .fold(0.0, f64::max),
            largest_coordinate: bounds.largest_coordinate(),
        }
    }

    /// A point of the light's plane, world metres.
    pub(super) fn point(&self) -> DVec3 {
        self.plane.point
    }

    /// Centre and radius of a sphere that holds the light, world metres.
    pub(super) fn sphere(&self) -> (DVec3, f64) {
        (self.centre, self.radius)
    }

    /// Metres of `position` in front of the light's plane, negative behind it.
    pub(super) fn plane_distance(&self, position: DVec3) -> f64 {
        self.plane.normal.dot(position - self.plane.point)
    }

    /// Whether `receiver` sees any of the light when nothing stands in the way.
    pub(super) fn shines_on(&self, receiver: &Receiver) -> bool {
        let horizon = horizon_of(receiver);
        self.height(receiver.position) != 0.0
            && self
                .polygon
                .contours
                .iter()
                .flatten()
                .any(|&vertex| horizon.is_above(vertex))
    }

    /// Metres of `position` in front of the plane, as far as light goes that way: behind a two-sided light as well, 0 where there is none.
    pub(super) fn height(&self, position: DVec3) -> f64 {
        let height = self.plane_distance(position);
        let scale = self.largest_coordinate + position.distance(self.plane.point);
        let dark = height.abs() <= COPLANAR * scale || (height < 0.0 && !self.polygon.two_sided);
        if dark { 0.0 } else { height }
    }

    /// Unit normal of the light's plane that points away from `position`.
    pub(super) fn away(&self, position: DVec3) -> DVec3 {
        if self.height(position) > 0.0 {
            -self.plane.normal
        } else {
            self.plane.normal
        }
    }

    /// The light at `receiver` when nothing stands in the way; `None` when it is below the horizon, or the receiver behind it or in its
    /// plane. `pieces` is scratch memory.
    pub(super) fn unoccluded(
        &self,
        receiver: &Receiver,
        gradients: bool,
        pieces: &mut Vec<Piece>,
    ) -> Option<Unoccluded> {
        let centre = self.centre - receiver.position;
        let is_distant = centre.length() > distant::MIN_RADII * self.radius;
        // Differences of nearby positions are exact; those of positions far apart are not.
        let origin = if is_distant {
            self.centre
        } else {
            receiver.position
        };
        if !self.outline(receiver, origin, pieces) {
            return None;
        }
        let sums = if is_distant {
            distant::sum(centre, pieces, gradients)
        } else {
            contour::sum(pieces, receiver.normal, gradients)
        };
        let starts: DVec3 = pieces.iter().map(|piece| piece.a).sum();
        Some(Unoccluded {
            sums,
            middle: origin + starts / pieces.len() as f64,
        })
    }

    /// Replaces `pieces` by the light's outline above the receiver's horizon, relative to `origin`; false when nothing of it shines there.
    pub(super) fn outline(
        &self,
        receiver: &Receiver,
        origin: DVec3,
        pieces: &mut Vec<Piece>,
    ) -> bool {
        pieces.clear();
        let height = self.height(receiver.position);
        if height == 0.0 {
            return false;
        }
        let direction = if height > 0.0 {
            Direction::Reversed
        } else {
            Direction::Stored
        };
        clip::outline(
            &self.polygon.contours,
            direction,
            &horizon_of(receiver),
            origin,
            pieces,
        );
        !pieces.is_empty()
    }
}

/// The surface of a light, to spread points on.
#[derive(Debug)]
pub(super) struct Surface<'a> {
    polygon: &'a Polygon,
    /// Area of the triangles up to each, square metres.
    cumulative_area: Vec<f64>,
}

impl<'a> Surface<'a> {
    pub(super) fn new(polygon: &'a Polygon) -> Self {
        let mut area = 0.0;
        Self {
            polygon,
            cumulative_area: polygon
                .triangles
                .iter()
                .map(|[a, b, c]| {
                    area += 0.5 * (b - a).cross(c - a).length();
                    area
                })
                .collect(),
        }
    }

    /// The point of the light at the place (u, v) of the unit square, world metres; equal areas of the square give equal areas of the light. The
    /// origin for a light without triangles.
    ///
    /// Source of the map from square to triangle: E. Heitz, "A low-distortion map between triangle and square", 2019.
    pub(super) fn point(&self, [u, v]: [f64; 2]) -> DVec3 {
        let total = self.cumulative_area.last().copied().unwrap_or_default();
        let area = u * total;
        let index = self
            .cumulative_area
            .partition_point(|&up_to| up_to <= area)
            .min(self.cumulative_area.len().saturating_sub(1));
        let Some(&[a, b, c]) = self.polygon.triangles.get(index) else {
            return DVec3::ZERO;
        };
        let before = if index == 0 {
            0.0
        } else {
            self.cumulative_area[index - 1]
        };
        let own = self.cumulative_area[index] - before;
        let along = if own > 0.0 {
            ((area - before) / own).clamp(0.0, 1.0)
        } else {
            0.5
        };
        let (x, y) = if v > along {
            (0.5 * along, v - 0.5 * along)
        } else {
            (along - 0.5 * v, 0.5 * v)
        };
        a + (b - a) * x + (c - a) * y
    }
}

fn horizon_of(receiver: &Receiver) -> Plane {
    Plane {
        point: receiver.position,
        normal: receiver.normal,
    }
}

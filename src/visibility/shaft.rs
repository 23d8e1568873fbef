//! The region between a group of receivers and a light.
//!
//! What can hide any part of the light from any of the receivers meets the convex hull of both. Planes that bound the hull reject
//! whole branches of the hierarchy and most triangles (E. Haines and J. Wallace, "Shaft culling for efficient ray-traced radiosity",
//! Eurographics Workshop on Rendering 1991); the plane of the triangle itself then rejects those that have the whole hull on one side:
//! the floor that the receivers lie on, the walls of a convex room.
//!
//! Every decision errs towards keeping a triangle. A plane is placed so that all receivers and all of the light lie within it, whatever
//! rounding did to its direction, and a hull lies within a half-space as soon as its vertices do.

use glam::DVec3;

use super::outline;
use super::triangle::{Plane, Side};
use crate::math::Aabb;

/// Rounding that moves a plane outwards, relative to the largest coordinate. Four times that of a point on a surface (see
/// `triangle::ROUNDING`): smaller could drop what the ray test hits; larger keeps triangles that only touch.
const SLACK: f64 = 1024.0 * f64::EPSILON;

/// Planes with a larger product of unit normals than this count as one: the second would cut off nothing worth its cost.
const SAME: f64 = 1.0 - 1e-6;

/// Convex region that holds every segment from a receiver to a light polygon, as far as it matters: above the horizons of the
/// receivers and in front of the light.
#[derive(Clone, Debug)]
pub struct Shaft {
    receivers: Vec<(DVec3, DVec3)>,
    light: Vec<DVec3>,
    /// Half-spaces that hold receivers and light.
    planes: Vec<HalfSpace>,
    bounds: Aabb,
    /// Box of the receivers.
    places: Aabb,
    /// Box of the receivers' normals.
    normals: Aabb,
    /// Whether one of `planes` is the horizon of all receivers.
    flat: bool,
    /// Metres by which anything may be off.
    slack: f64,
}

/// Points with `normal · x ≤ offset`.
#[derive(Clone, Copy, Debug)]
struct HalfSpace {
    normal: DVec3,
    offset: f64,
}

/// A [`Shaft`] in the frame of the hierarchy.
pub(super) struct Cull {
    planes: Vec<HalfSpace>,
    bounds: Aabb,
    /// Boxes of positions and normals of receivers that are not flat.
    horizons: Option<(Aabb, Aabb)>,
}

impl Shaft {
    /// `receivers`: positions and unit normals. `light`: its vertices (any contour order) and its unit plane normal.
    ///
    /// The side of the light from which it is seen is the one the receivers are on; when they are on both, nothing is cut off at its
    /// plane. Without receivers or light the shaft holds nothing.
    #[must_use]
    pub fn new(receivers: &[(DVec3, DVec3)], light: &[DVec3], light_normal: DVec3) -> Self {
        let places = Aabb::from_points(receivers.iter().map(|receiver| receiver.0));
        let bounds = places.union(Aabb::from_points(light.iter().copied()));
        let slack = SLACK * (bounds.largest_coordinate() + bounds.diagonal());
        let mut shaft = Self {
            receivers: receivers.to_vec(),
            light: light.to_vec(),
            planes: Vec::with_capacity(24),
            bounds: grown(bounds, slack),
            places,
            normals: Aabb::from_points(receivers.iter().map(|receiver| receiver.1)),
            flat: false,
            slack,
        };
        if receivers.is_empty() || light.is_empty() {
            return shaft;
        }
        shaft.bound_by_horizon();
        shaft.bound_by_light(light_normal);
        shaft.bound_by_receivers();
        shaft
    }

    /// Whether some part of the light may be hidden from some receiver by `triangle`.
    pub(super) fn may_be_hidden_by(&self, triangle: &[DVec3; 3]) -> bool {
        let outside = |plane: &HalfSpace| {
            triangle
                .iter()
                .all(|&vertex| plane.normal.dot(vertex) > plane.offset)
        };
        let box_of = Aabb::from_points(*triangle);
        overlap(&box_of, &self.bounds)
            && !self.planes.iter().any(outside)
            && (self.flat || self.rises_over_a_horizon(triangle))
            && self.is_cut_by(&Plane::new(triangle))
    }

    /// Whether some part of `triangle` lies within all planes, by cutting off what does not (I. Sutherland and G. Hodgman, "Reentrant
    /// polygon clipping", CACM 17(1), 1974). Rejects triangles that pass by a corner, which no plane alone does; slower.
    pub(super) fn reaches_inside(&self, triangle: &[DVec3; 3]) -> bool {
        let mut polygon = triangle.to_vec();
        for plane in &self.planes {
            let height = |vertex: DVec3| plane.normal.dot(vertex) - plane.offset;
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (index, &b) in polygon.iter().enumerate() {
                let a = polygon[(index + polygon.len() - 1) % polygon.len()];
                let (from, to) = (height(a), height(b));
                if (from > 0.0) != (to > 0.0) {
                    kept.push(a + from / (from - to) * (b - a));
                }
                if to <= 0.0 {
                    kept.push(b);
                }
            }
            polygon = kept;
            if polygon.is_empty() {
                return false;
            }
        }
        overlap(&Aabb::from_points(polygon), &self.bounds)
    }

    /// The shaft in coordinates (x − `centre`) · `scale`.
    pub(super) fn in_frame(&self, centre: DVec3, scale: f64) -> Cull {
        let moved = |bounds: &Aabb| Aabb {
            min: (bounds.min - centre) * scale,
            max: (bounds.max - centre) * scale,
        };
        Cull {
            planes: self
                .planes
                .iter()
                .map(|plane| HalfSpace {
                    normal: plane.normal,
                    offset: (plane.offset - plane.normal.dot(centre)) * scale,
                })
                .collect(),
            bounds: moved(&self.bounds),
            horizons: (!self.flat).then(|| (moved(&self.places), self.normals)),
        }
    }

    /// Whether receivers and light lie on both sides of `plane`.
    fn is_cut_by(&self, plane: &Plane) -> bool {
        let extent = self.bounds.largest_coordinate();
        let (mut front, mut back) = (false, false);
        // The light first: most planes that cut at all run between it and the receivers.
        for point in self.light.iter().copied().chain(self.positions()) {
            match plane.side_strictly(point, extent) {
                Side::Front => front = true,
                Side::Back => back = true,
                Side::On => {}
            }
            if front && back {
                return true;
            }
        }
        false
    }

    /// Whether some vertex lies above some receiver's tangent plane.
    fn rises_over_a_horizon(&self, triangle: &[DVec3; 3]) -> bool {
        self.receivers.iter().any(|&(position, normal)| {
            triangle
                .iter()
                .any(|&vertex| normal.dot(vertex - position) > self.slack)
        })
    }

    /// Adds the half-space of all points with `normal · x` at most that of receivers and light, for any `normal` but zero.
    fn bound(&mut self, normal: DVec3) {
        let Some(normal) = normal.try_normalize() else {
            return;
        };
        if self
            .planes
            .iter()
            .any(|plane| plane.normal.dot(normal) > SAME)
        {
            return;
        }
        let farthest = self
            .positions()
            .chain(self.light.iter().copied())
            .map(|point| normal.dot(point))
            .fold(f64::NEG_INFINITY, f64::max);
        self.planes.push(HalfSpace {
            normal,
            offset: farthest + self.slack,
        });
    }

    /// On and below the lowest of parallel horizons nothing matters, even if the light reaches there.
    fn bound_by_horizon(&mut self) {
        let normal = self.receivers[0].1;
        let heights = Span::of(self.positions().map(|position| normal.dot(position)));
        if self.receivers.iter().all(|receiver| receiver.1 == normal) {
            self.planes.push(HalfSpace {
                normal: -normal,
                offset: -heights.low - self.slack,
            });
            self.flat = heights.high - heights.low <= self.slack;
        }
    }

    fn positions(&self) -> impl Iterator<Item = DVec3> {
        self.receivers.iter().map(|receiver| receiver.0)
    }

    /// The light's plane, and planes through its edges that lean on the receivers.
    fn bound_by_light(&mut self, light_normal: DVec3) {
        let corner = self.light[0];
        let heights = Span::of(
            self.positions()
                .map(|position| light_normal.dot(position - corner)),
        );
        let normal = if heights.low > self.slack {
            light_normal
        } else if heights.high < -self.slack {
            -light_normal
        } else {
            return;
        };
        self.bound(-normal);
        let closeness: Vec<f64> = self
            .positions()
            .map(|position| normal.dot(position - corner).recip())
            .collect();
        for (point, outwards) in outline::edges(&self.light, normal) {
            // Steepest line of sight over this edge: u is the distance beyond it, w the height above the light.
            let slope = self
                .positions()
                .zip(&closeness)
                .map(|(position, closeness)| outwards.dot(position - point) * closeness)
                .fold(f64::NEG_INFINITY, f64::max);
            self.bound(outwards - slope * normal);
        }
    }

    /// Planes through edges of the receivers' box that lean on the light, each parallel to one axis.
    fn bound_by_receivers(&mut self) {
        let box_of = self.places;
        let light = if self.light.len() <= outline::MAX_EDGES {
            self.light.clone()
        } else {
            Aabb::from_points(self.light.iter().copied())
                .corners()
                .to_vec()
        };
        for axis in 0..3 {
            let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
            let corners = [
                [box_of.min[x], box_of.min[y]],
                [box_of.max[x], box_of.min[y]],
                [box_of.max[x], box_of.max[y]],
                [box_of.min[x], box_of.max[y]],
            ];
            let shadow: Vec<_> = light.iter().map(|point| [point[x], point[y]]).collect();
            for tangent in outline::tangents(&corners, &shadow) {
                let mut normal = DVec3::ZERO;
                normal[x] = tangent[0];
                normal[y] = tangent[1];
                self.bound(normal);
            }
        }
    }
}

impl Cull {
    /// The set of all planes, for the root.
    pub(super) fn all_planes(&self) -> u32 {
        ((1u64 << self.planes.len().min(32)) - 1) as u32
    }

    /// Whether the box from `min` to `max` may reach into the shaft, and which of `planes` still cut it.
    pub(super) fn touches(&self, min: DVec3, max: DVec3, planes: u32) -> Option<u32> {
        let node = Aabb { min, max };
        if !overlap(&node, &self.bounds) || self.below_all_horizons(&node) {
            return None;
        }
        let centre = 0.5 * (min + max);
        let half = 0.5 * (max - min);
        let mut cutting = planes;
        for (index, plane) in self.planes.iter().enumerate().take(32) {
            if planes & (1 << index) == 0 {
                continue;
            }
            let middle = plane.normal.dot(centre) - plane.offset;
            let reach = plane.normal.abs().dot(half);
            if middle > reach {
                return None;
            }
            if middle < -reach {
                cutting &= !(1 << index);
            }
        }
        Some(cutting)
    }

    /// Whether normal · (x − position) ≤ 0 for every x in the node and every receiver, by interval arithmetic.
    fn below_all_horizons(&self, node: &Aabb) -> bool {
        let Some((places, normals)) = &self.horizons else {
            return false;
        };
        let low = node.min - places.max;
        let high = node.max - places.min;
        let highest = (normals.min * low)
            .max(normals.min * high)
            .max(normals.max * low)
            .max(normals.max * high);
        highest.element_sum() <= 0.0
    }
}

/// Smallest and largest of some numbers.
struct Span {
    low: f64,
    high: f64,
}

impl Span {
    fn of(numbers: impl Iterator<Item = f64>) -> Self {
        numbers.fold(
            Self {
                low: f64::INFINITY,
                high: f64::NEG_INFINITY,
            },
            |span, number| Self {
                low: span.low.min(number),
                high: span.high.max(number),
            },
        )
    }
}

fn grown(bounds: Aabb, by: f64) -> Aabb {
    Aabb {
        min: bounds.min - by,
        max: bounds.max + by,
    }
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

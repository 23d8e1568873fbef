//! A light as a group of receivers meets it: what does not depend on the receiver is computed once.

use std::borrow::Cow;
use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use super::Receiver;
use super::clip::{self, Direction, Plane};
use super::contour::{self, Piece, Sums};
use super::distant;
use crate::lights::{Lights, Point, Polygon, disc};
use crate::math::Aabb;
use crate::visibility::Shaft;

/// A receiver counts as lying in the light's plane when its distance from it is below the rounding of coordinates, this much
/// relative to the largest of them. Larger would darken receivers that see the light; smaller would let a surface flush with a light
/// catch light that is rounding only.
const COPLANAR: f64 = 8.0 * f64::EPSILON;

/// Distance of what is at infinity, in radii of scene and tile together. It must lie beyond all of them; farther off would cost digits.
const INFINITY: f64 = 4.0;

/// Distance in radii from which a light is a speck to [`Source::at_a_glance`]: 1e-3 of it may be wrong.
const SPECK: f64 = 30.0;

/// A light and its measures.
#[derive(Clone, Debug)]
pub(super) struct Source<'a> {
    shape: Shape<'a>,
    /// What the light per unit is to be multiplied by: radiance in nit, intensity in candela for a point, illuminance in lux for a hard sun.
    pub(super) strength: DVec3,
    /// Middle of its box, and a radius around it that holds it, world metres.
    centre: DVec3,
    radius: f64,
    largest_coordinate: f64,
}

#[derive(Clone, Debug)]
enum Shape<'a> {
    /// A polygon of the scene.
    Surface { polygon: &'a Polygon, plane: Plane },
    /// A sphere, which is a disc to every receiver, or a point.
    Ball(&'a Point),
    /// A polygon at infinity: it keeps its place relative to every receiver.
    Distant {
        towards: DVec3,
        /// Metres.
        distance: f64,
        /// Relative to the receiver, metres; empty for a hard sun.
        contours: Vec<Vec<DVec3>>,
    },
}

/// What a receiver could see of a light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unoccluded {
    /// Light per unit strength if nothing stands in the way.
    pub(super) sums: Sums,
    /// A place, world metres, in the middle of the outline above the horizon.
    pub(super) middle: DVec3,
}

impl<'a> Source<'a> {
    /// All lights as the receivers in `places` meet them.
    pub(super) fn all(lights: &'a Lights, places: &Aabb) -> Vec<Self> {
        let (middle, extent) = lights.extent;
        let reach = extent + places.diagonal() + places.centre().distance(middle);
        let distance = if reach > 0.0 && reach.is_finite() {
            INFINITY * reach
        } else {
            1.0
        };
        let distant = lights.distant.iter().map(|light| {
            let contour = light.contour.iter().map(|v| *v * distance).collect();
            let place = (light.towards, places.centre(), distance);
            Self::at_infinity(place, light.radiance, vec![contour])
        });
        let suns = lights.suns.iter().map(|sun| {
            let place = (sun.towards, places.centre(), distance);
            Self::at_infinity(place, sun.illuminance, Vec::new())
        });
        let polygons = lights.polygons.iter().map(Self::new);
        let points = lights.points.iter().map(Self::ball);
        polygons.chain(distant).chain(points).chain(suns).collect()
    }

    /// A polygon of the scene.
    pub(super) fn new(polygon: &'a Polygon) -> Self {
        let vertices = || polygon.contours.iter().flatten().copied();
        let bounds = Aabb::from_points(vertices());
        let centre = bounds.centre();
        Self {
            shape: Shape::Surface {
                polygon,
                plane: Plane {
                    point: vertices().next().unwrap_or_default(),
                    normal: polygon.normal,
                },
            },
            strength: polygon.radiance,
            centre,
            radius: vertices()
                .map(|vertex| vertex.distance(centre))
                .fold(0.0, f64::max),
            largest_coordinate: bounds.largest_coordinate(),
        }
    }

    fn ball(light: &'a Point) -> Self {
        Self {
            shape: Shape::Ball(light),
            strength: if light.radius > 0.0 {
                light.intensity / (PI * light.radius * light.radius)
            } else {
                light.intensity
            },
            centre: light.position,
            radius: light.radius,
            largest_coordinate: light.position.abs().max_element(),
        }
    }

    fn at_infinity(
        (towards, place, distance): (DVec3, DVec3, f64),
        strength: DVec3,
        contours: Vec<Vec<DVec3>>,
    ) -> Self {
        let centre = place + distance * towards;
        let radius = contours
            .iter()
            .flatten()
            .map(|vertex| vertex.distance(distance * towards))
            .fold(0.0, f64::max);
        Self {
            shape: Shape::Distant {
                towards,
                distance,
                contours,
            },
            strength,
            centre,
            radius,
            largest_coordinate: centre.abs().max_element(),
        }
    }

    /// The polygon, for what works on polygons of the scene alone.
    pub(super) fn polygon(&self) -> Option<&'a Polygon> {
        match self.shape {
            Shape::Surface { polygon, .. } => Some(polygon),
            _ => None,
        }
    }

    /// Triangles of the scene that are the light, ascending.
    pub(super) fn own_triangles(&self) -> &'a [u32] {
        self.polygon().map_or(&[], |polygon| &polygon.surface)
    }

    /// Whether it has no size: its shadows have no penumbra.
    pub(super) fn is_hard(&self) -> bool {
        !matches!(self.shape, Shape::Surface { .. }) && self.radius == 0.0
    }

    /// What can stand between the light and `receivers`, whose positions lie in `places`.
    pub(super) fn shaft(&self, receivers: &[Receiver], places: &Aabb) -> Shaft {
        let planes: Vec<_> = receivers
            .iter()
            .map(|receiver| (receiver.position, receiver.normal))
            .collect();
        match &self.shape {
            Shape::Surface { polygon, .. } => {
                let vertices: Vec<DVec3> = polygon.contours.iter().flatten().copied().collect();
                Shaft::new(&planes, &vertices, polygon.normal)
            }
            Shape::Ball(_) => {
                let away = (self.centre - places.centre()).normalize_or(DVec3::Y);
                if self.radius == 0.0 {
                    return Shaft::new(&planes, &[self.centre], -away);
                }
                let cube = Aabb {
                    min: self.centre - self.radius,
                    max: self.centre + self.radius,
                };
                Shaft::new(&planes, &cube.corners(), -away)
            }
            Shape::Distant { towards, .. } => {
                // A square around what the receivers see, each at its own place.
                let reach = self.radius + places.diagonal();
                let (u, v) = towards.any_orthonormal_pair();
                let middle = self.centre;
                let corners = [
                    middle + reach * (-u - v),
                    middle + reach * (u - v),
                    middle + reach * (u + v),
                    middle + reach * (v - u),
                ];
                Shaft::new(&planes, &corners, -*towards)
            }
        }
    }

    /// A point of a plane that no part of the light lies before, seen from `places`, and its unit normal that points away from there; `front`
    /// says which side of a polygon `places` are on.
    pub(super) fn backdrop(&self, places: &Aabb, front: bool) -> (DVec3, DVec3) {
        match &self.shape {
            Shape::Surface { plane, .. } => {
                let away = if front { -plane.normal } else { plane.normal };
                (plane.point, away)
            }
            Shape::Ball(_) => {
                let middle = places.centre();
                let away = (self.centre - middle).normalize_or(DVec3::Y);
                let margin = self.radius + 0.5 * places.diagonal();
                // Behind this plane occluders are cut for each receiver anew.
                let depth = (self.centre.distance(middle) - margin).max(0.5 * places.diagonal());
                (middle + depth * away, away)
            }
            Shape::Distant { towards, .. } => (self.centre, *towards),
        }
    }

    /// Metres of `position` in front of the plane of a polygon, negative behind it; otherwise the distance of the plane of what is seen.
    pub(super) fn plane_distance(&self, position: DVec3) -> f64 {
        match &self.shape {
            Shape::Surface { plane, .. } => plane.normal.dot(position - plane.point),
            Shape::Ball(light) => {
                let distance = position.distance(light.position);
                if distance > light.radius {
                    distance - light.radius * (light.radius / distance)
                } else {
                    0.0
                }
            }
            Shape::Distant { distance, .. } => *distance,
        }
    }

    /// Whether `receiver` sees any of the light when nothing stands in the way.
    pub(super) fn shines_on(&self, receiver: &Receiver) -> bool {
        let horizon = horizon_of(receiver);
        match &self.shape {
            Shape::Surface { polygon, .. } => {
                self.height(receiver.position) != 0.0
                    && polygon
                        .contours
                        .iter()
                        .flatten()
                        .any(|&vertex| horizon.is_above(vertex))
            }
            Shape::Ball(light) => {
                let top = light.position + light.radius * receiver.normal;
                self.height(receiver.position) > 0.0 && horizon.is_above(top)
            }
            Shape::Distant {
                towards, contours, ..
            } => {
                towards.dot(receiver.normal) > 0.0
                    || contours
                        .iter()
                        .flatten()
                        .any(|vertex| vertex.dot(receiver.normal) > 0.0)
            }
        }
    }

    /// Metres of `position` in front of the plane, as far as light goes that way: behind a two-sided light as well, 0 where there is none.
    pub(super) fn height(&self, position: DVec3) -> f64 {
        let height = self.plane_distance(position);
        let Shape::Surface { polygon, plane } = &self.shape else {
            return height;
        };
        let scale = self.largest_coordinate + position.distance(plane.point);
        let dark = height.abs() <= COPLANAR * scale || (height < 0.0 && !polygon.two_sided);
        if dark { 0.0 } else { height }
    }

    /// Unit normal of the plane of what `position` sees that points away from there.
    pub(super) fn away(&self, position: DVec3) -> DVec3 {
        match &self.shape {
            Shape::Surface { plane, .. } => {
                if self.height(position) > 0.0 {
                    -plane.normal
                } else {
                    plane.normal
                }
            }
            Shape::Ball(light) => (light.position - position).normalize_or(DVec3::Y),
            Shape::Distant { towards, .. } => *towards,
        }
    }

    /// Share of the strength that reaches `position`, and its derivative per metre: 1 but for points with a range and spots.
    pub(super) fn attenuation(&self, position: DVec3) -> (f64, DVec3) {
        match self.shape {
            Shape::Ball(light) => light.attenuation(position),
            _ => (1.0, DVec3::ZERO),
        }
    }

    /// The light at `receiver` when nothing stands in the way, per unit strength and without attenuation; `None` when it is below the
    /// horizon, or the receiver behind it, in its plane, or inside. `pieces` is scratch memory.
    pub(super) fn unoccluded(
        &self,
        receiver: &Receiver,
        gradients: bool,
        pieces: &mut Vec<Piece>,
    ) -> Option<Unoccluded> {
        if let Shape::Ball(_) | Shape::Distant { .. } = self.shape
            && let Some(whole) = self.round(receiver, gradients)
        {
            return whole;
        }
        let centre = match &self.shape {
            Shape::Distant {
                towards, distance, ..
            } => *distance * *towards,
            _ => self.centre - receiver.position,
        };
        let is_distant = centre.length() > distant::MIN_RADII * self.radius;
        // Differences of nearby positions are exact; those of positions far apart are not.
        let origin = if is_distant {
            self.seen_middle(receiver.position)
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

    /// [`Self::unoccluded`] of points, hard suns, and spheres that lie above the horizon as a whole; `None` for what needs its outline.
    fn round(&self, receiver: &Receiver, gradients: bool) -> Option<Option<Unoccluded>> {
        let mut sums = Sums {
            has_gradient: gradients,
            ..Sums::DARK
        };
        match &self.shape {
            Shape::Ball(light) => {
                let offset = light.position - receiver.position;
                let distance = offset.length();
                if distance <= light.radius || distance == 0.0 {
                    return Some(None);
                }
                let height = offset.dot(receiver.normal);
                if height <= -light.radius || (height <= 0.0 && light.radius == 0.0) {
                    return Some(None);
                }
                if height < light.radius {
                    return None;
                }
                let towards = offset / distance;
                // Per unit radiance of a sphere, per unit intensity of a point.
                let area = PI * light.radius * light.radius;
                let (strength, phi, slope) = if light.radius > 0.0 {
                    let sine = light.radius / distance;
                    let cosine = ((1.0 - sine) * (1.0 + sine)).sqrt();
                    // 2π (1 − cos) and its derivative along the way.
                    (
                        area,
                        2.0 * PI * sine * sine / (1.0 + cosine),
                        2.0 * PI * sine * sine / (distance * cosine),
                    )
                } else {
                    let square = (distance * distance).recip();
                    (1.0, square, 2.0 * square / distance)
                };
                sums.g = towards * (strength / (distance * distance));
                sums.phi = phi;
                sums.rounding = contour::TERM_ROUNDING * sums.g.length();
                if gradients {
                    let cube = strength / (distance * distance * distance);
                    sums.j = (contour::outer(towards, towards) * 3.0 - DMat3::IDENTITY) * cube;
                    sums.grad_phi = towards * slope;
                }
                Some(Some(Unoccluded {
                    sums,
                    middle: light.position,
                }))
            }
            Shape::Distant {
                towards, contours, ..
            } if contours.is_empty() => {
                if towards.dot(receiver.normal) <= 0.0 {
                    return Some(None);
                }
                sums.g = *towards;
                sums.phi = 1.0;
                Some(Some(Unoccluded {
                    sums,
                    middle: self.seen_middle(receiver.position),
                }))
            }
            _ => None,
        }
    }

    /// World place of the light's middle as seen from `position`.
    pub(super) fn seen_middle(&self, position: DVec3) -> DVec3 {
        match &self.shape {
            Shape::Distant {
                towards, distance, ..
            } => position + *distance * *towards,
            _ => self.centre,
        }
    }

    /// Replaces `pieces` by the light's outline above the receiver's horizon, relative to `origin` (world metres); false when nothing of it
    /// shines there.
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
        // Of what keeps its place relative to the receiver.
        let own_horizon = Plane {
            point: DVec3::ZERO,
            normal: receiver.normal,
        };
        let own_origin = origin - receiver.position;
        match &self.shape {
            Shape::Surface { polygon, .. } => {
                let direction = if height > 0.0 {
                    Direction::Reversed
                } else {
                    Direction::Stored
                };
                let horizon = horizon_of(receiver);
                clip::outline(&polygon.contours, direction, &horizon, origin, pieces);
            }
            Shape::Ball(light) => {
                let contours = [disc_of(light, receiver.position)];
                let reversed = Direction::Reversed;
                clip::outline(&contours, reversed, &own_horizon, own_origin, pieces);
            }
            Shape::Distant { contours, .. } => {
                let reversed = Direction::Reversed;
                clip::outline(contours, reversed, &own_horizon, own_origin, pieces);
                // It moves with the receiver.
                for piece in &mut *pieces {
                    piece.horizon = true;
                }
            }
        }
        !pieces.is_empty()
    }

    /// The light's surface as `position` meets it, to spread points on.
    pub(super) fn spread(&self, position: DVec3) -> Surface<'a> {
        match &self.shape {
            Shape::Surface { polygon, .. } => Surface::new(Cow::Borrowed(&polygon.triangles)),
            Shape::Ball(light) => {
                let mut contour = disc_of(light, position);
                for vertex in &mut contour {
                    *vertex += position;
                }
                Surface::new(Cow::Owned(fan(&contour)))
            }
            Shape::Distant { contours, .. } => {
                let contour: Vec<DVec3> =
                    contours.iter().flatten().map(|v| *v + position).collect();
                Surface::new(Cow::Owned(fan(&contour)))
            }
        }
    }

    /// Whether [`Self::spread`] is the same for all receivers.
    pub(super) fn is_fixed(&self) -> bool {
        matches!(self.shape, Shape::Surface { .. })
    }

    /// Whether it is somewhere, and not at infinity.
    pub(super) fn has_place(&self) -> bool {
        !matches!(self.shape, Shape::Distant { .. })
    }

    /// Diameter over distance, radians.
    pub(super) fn apparent_size(&self, position: DVec3) -> f64 {
        let distance = self.seen_middle(position).distance(position);
        2.0 * self.radius / distance.max(self.radius)
    }

    /// A box that holds it, world metres.
    pub(super) fn bounds(&self) -> Aabb {
        Aabb {
            min: self.centre - self.radius,
            max: self.centre + self.radius,
        }
    }

    /// About the irradiance in lux, brightest channel, that `receiver` would get at its own normal with nothing in the way. Positive wherever
    /// the light can be seen; right for a small light, rough for a near one.
    pub(super) fn potential(&self, receiver: &Receiver) -> f64 {
        let offset = self.seen_middle(receiver.position) - receiver.position;
        let square = offset.length_squared();
        let distance = square.sqrt();
        // Some of a light is above the horizon even when its middle is below.
        let highest = offset.dot(receiver.normal) + self.radius;
        if highest <= 0.0 || distance == 0.0 {
            return 0.0;
        }
        let cosine = (highest / distance).min(1.0);
        let per_unit = match &self.shape {
            Shape::Surface { polygon, .. } => {
                let height = self.height(receiver.position).abs();
                polygon.area * cosine * height / (distance * (square + polygon.area / PI))
            }
            Shape::Ball(light) => {
                let (share, _) = light.attenuation(receiver.position);
                let area = PI * light.radius * light.radius;
                let unit = if area > 0.0 { area } else { 1.0 };
                share * cosine * unit / (square + area / PI)
            }
            Shape::Distant { .. } => cosine * PI * (self.radius / distance).powi(2),
        };
        self.strength.max_element() * per_unit
    }

    /// [`Self::unoccluded`] with its attenuation, without derivatives, and for lights above the horizon and very small for their distance with
    /// a relative error of the square of that ratio.
    pub(super) fn at_a_glance(&self, receiver: &Receiver, pieces: &mut Vec<Piece>) -> Option<Sums> {
        if let Shape::Surface { polygon, .. } = &self.shape {
            let offset = self.centre - receiver.position;
            let square = offset.length_squared();
            let is_speck = square > SPECK * SPECK * self.radius * self.radius;
            if is_speck && offset.dot(receiver.normal) > self.radius {
                let height = self.height(receiver.position).abs();
                let distance = square.sqrt();
                let phi = polygon.area * height / (distance * square);
                return Some(Sums {
                    g: offset * (phi / distance),
                    phi,
                    rounding: phi / (SPECK * SPECK),
                    ..Sums::DARK
                });
            }
        }
        let (share, slope) = self.attenuation(receiver.position);
        if share <= 0.0 {
            return None;
        }
        let mut sums = self.unoccluded(receiver, false, pieces)?.sums;
        sums.attenuate(share, slope);
        Some(sums)
    }

    /// Upper bound in lux of the irradiance that this light can give, brightest channel, to any receiver within `radius` metres of
    /// `centre`, whatever stands in the way: radiance × area × cosine at the light / distance², and never more than π × radiance.
    pub(super) fn irradiance_bound(&self, centre: DVec3, radius: f64) -> f64 {
        let nearest = (centre.distance(self.centre) - radius - self.radius).max(0.0);
        let per_unit = match &self.shape {
            Shape::Surface { polygon, .. } => {
                let height = self.plane_distance(centre);
                let highest = if polygon.two_sided {
                    height.abs() + radius
                } else {
                    (height + radius).max(0.0)
                };
                if nearest > 0.0 {
                    let cosine = (highest / nearest).min(1.0);
                    (polygon.area * cosine / (nearest * nearest)).min(PI)
                } else if highest > 0.0 {
                    PI
                } else {
                    0.0
                }
            }
            Shape::Ball(light) if light.misses(centre, radius) => 0.0,
            Shape::Ball(light) => {
                let distance = (centre.distance(light.position) - radius).max(light.radius);
                if light.radius > 0.0 {
                    PI * (light.radius / distance).powi(2)
                } else {
                    (distance * distance).recip()
                }
            }
            Shape::Distant {
                contours, distance, ..
            } => {
                if contours.is_empty() {
                    1.0
                } else {
                    PI * (self.radius / distance).powi(2).min(1.0)
                }
            }
        };
        self.strength.max_element() * per_unit
    }
}

/// What `position` sees of a sphere: the circle where its lines of sight touch it, as a polygon around as much light, relative to `position`,
/// counter-clockwise from there. Its points lie on those lines where they touch, so to first order they stay where they are when `position`
/// moves.
fn disc_of(light: &Point, position: DVec3) -> Vec<DVec3> {
    let offset = light.position - position;
    let distance = offset.length();
    let towards = offset / distance;
    let sine = light.radius / distance;
    let cosine = ((1.0 - sine) * (1.0 + sine)).sqrt();
    let depth = distance * cosine * cosine;
    let radius = depth * disc::circumradius(sine / cosine);
    disc::directions(towards)
        .map(|side| depth * towards + radius * side)
        .collect()
}

/// Triangles of a convex polygon.
fn fan(contour: &[DVec3]) -> Vec<[DVec3; 3]> {
    let Some((&first, rest)) = contour.split_first() else {
        return Vec::new();
    };
    rest.windows(2)
        .map(|edge| [first, edge[0], edge[1]])
        .collect()
}

/// The surface of a light, to spread points on.
#[derive(Debug)]
pub(super) struct Surface<'a> {
    /// World metres.
    triangles: Cow<'a, [[DVec3; 3]]>,
    /// Area of the triangles up to each, square metres.
    cumulative_area: Vec<f64>,
}

impl<'a> Surface<'a> {
    pub(super) fn new(triangles: Cow<'a, [[DVec3; 3]]>) -> Self {
        let mut area = 0.0;
        Self {
            cumulative_area: triangles
                .iter()
                .map(|[a, b, c]| {
                    area += 0.5 * (b - a).cross(c - a).length();
                    area
                })
                .collect(),
            triangles,
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
        let Some(&[a, b, c]) = self.triangles.get(index) else {
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

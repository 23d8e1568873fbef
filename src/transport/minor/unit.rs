//! What is tested as one: a light, or a group of small ones that is far away.

use glam::DVec3;

use crate::math;
use crate::math::Aabb;
use crate::transport::Receiver;
use crate::transport::contour::{Piece, Sums};
use crate::transport::source::{Source, Surface};

/// Distance in its radii from which a group of lights that look the same way counts as one, at its middle: it then gives some 0.1 % more or
/// less, and a shadow's edge seldom runs through it.
const AS_ONE: f64 = 25.0;

/// Cosine between normals that count as one: a thousandth of what a light gives edge-on.
const SAME_WAY: f64 = 1.0 - 1e-6;

/// Lights that are tried as one, and what that many are tried as when they are too near.
const SIZES: [usize; 2] = [16, 4];

/// A light or a flock.
pub(super) enum Unit<'s, 'a> {
    One {
        source: &'s Source<'a>,
        /// Names it in random numbers.
        light: u64,
        /// Where its rays go, once one was cast.
        surface: Option<Surface<'a>>,
    },
    Flock(Flock<'s, 'a>),
}

/// Polygons of one direction, small and far away.
pub(super) struct Flock<'s, 'a> {
    members: Vec<&'s Source<'a>>,
    /// Weighted by what they give, world metres.
    centre: DVec3,
    /// Radius of a sphere around the centre that holds all.
    radius: f64,
    normal: DVec3,
    /// Sum of radiance × area, per channel.
    output: DVec3,
}

/// The minor `lights` of `tile`, which are in the order of space; together where there are more than `enough`.
pub(super) fn units<'s, 'a>(
    sources: &'s [Source<'a>],
    lights: &[usize],
    tile: &[Receiver],
    enough: usize,
) -> Vec<Unit<'s, 'a>> {
    let mut units = Vec::with_capacity(lights.len());
    let sizes: &[usize] = if lights.len() > enough { &SIZES } else { &[] };
    gather(sources, lights, tile, sizes, &mut units);
    units
}

fn gather<'s, 'a>(
    sources: &'s [Source<'a>],
    lights: &[usize],
    tile: &[Receiver],
    sizes: &[usize],
    units: &mut Vec<Unit<'s, 'a>>,
) {
    let Some((&size, smaller)) = sizes.split_first() else {
        units.extend(lights.iter().map(|&light| Unit::One {
            source: &sources[light],
            light: light as u64,
            surface: None,
        }));
        return;
    };
    for group in lights.chunks(size) {
        let flock = Flock::of(group.iter().map(|&light| &sources[light]).collect());
        match flock.filter(|flock| tile.iter().all(|receiver| flock.is_one_to(receiver))) {
            Some(flock) => units.push(Unit::Flock(flock)),
            None => gather(sources, group, tile, smaller, units),
        }
    }
}

impl Unit<'_, '_> {
    /// See [`Source::potential`].
    pub(super) fn potential(&self, receiver: &Receiver) -> f64 {
        match self {
            Self::One { source, .. } => source.potential(receiver),
            Self::Flock(flock) => {
                let sums = flock.sums(receiver.position);
                flock.output.max_element() * sums.g.dot(receiver.normal)
            }
        }
    }

    /// The light with nothing in the way, without derivatives, and what it is to be multiplied by.
    pub(super) fn light(
        &self,
        receiver: &Receiver,
        pieces: &mut Vec<Piece>,
    ) -> Option<(Sums, DVec3)> {
        match self {
            Self::One { source, .. } => {
                let sums = source.at_a_glance(receiver, pieces)?;
                Some((sums.without_gradient(), source.strength))
            }
            Self::Flock(flock) => {
                let sums = flock.sums(receiver.position);
                Some((sums.without_gradient(), flock.output))
            }
        }
    }

    /// A random place of it, world metres, as `receiver` meets it.
    pub(super) fn target(&mut self, receiver: &Receiver) -> DVec3 {
        match self {
            Self::One { source, .. } if source.is_hard() => source.seen_middle(receiver.position),
            Self::One {
                source,
                light,
                surface,
            } => {
                let place = math::unit_pair(math::hash(receiver.seed, *light, 0));
                if source.is_fixed() {
                    surface
                        .get_or_insert_with(|| source.spread(DVec3::ZERO))
                        .point(place)
                } else {
                    source.spread(receiver.position).point(place)
                }
            }
            Self::Flock(flock) => flock.member(receiver).seen_middle(receiver.position),
        }
    }

    /// Whether a triangle of the scene is the light.
    pub(super) fn owns(&self, triangle: u32) -> bool {
        let is_own = |source: &Source<'_>| source.own_triangles().binary_search(&triangle).is_ok();
        match self {
            Self::One { source, .. } => is_own(source),
            Self::Flock(flock) => flock.members.iter().any(|source| is_own(source)),
        }
    }

    /// A box that holds it, world metres.
    pub(super) fn bounds(&self) -> Aabb {
        match self {
            Self::One { source, .. } => source.bounds(),
            Self::Flock(flock) => flock
                .members
                .iter()
                .map(|source| source.bounds())
                .fold(Aabb::from_points([]), Aabb::union),
        }
    }

    /// Whether a ray says all about it.
    pub(super) fn is_hard(&self) -> bool {
        matches!(self, Self::One { source, .. } if source.is_hard())
    }
}

impl<'s, 'a> Flock<'s, 'a> {
    /// `None` when they do not look the same way, or one is not a polygon.
    fn of(members: Vec<&'s Source<'a>>) -> Option<Self> {
        let normal = members.first()?.polygon()?.normal;
        let (mut centre, mut weight, mut output) = (DVec3::ZERO, 0.0, DVec3::ZERO);
        for source in &members {
            let polygon = source.polygon()?;
            if polygon.two_sided || polygon.normal.dot(normal) < SAME_WAY {
                return None;
            }
            let own = polygon.radiance * polygon.area;
            output += own;
            centre += own.element_sum() * source.bounds().centre();
            weight += own.element_sum();
        }
        centre /= weight;
        let reach = |source: &&Source<'_>| {
            let bounds = source.bounds();
            bounds.centre().distance(centre) + 0.5 * bounds.diagonal()
        };
        let radius = members.iter().map(reach).fold(0.0, f64::max);
        centre.is_finite().then_some(Self {
            members,
            centre,
            radius,
            normal,
            output,
        })
    }

    /// Whether `receiver` is far enough away, before all of its lights, and all are above the horizon.
    fn is_one_to(&self, receiver: &Receiver) -> bool {
        let offset = self.centre - receiver.position;
        offset.length_squared() > (AS_ONE * self.radius).powi(2)
            && offset.dot(receiver.normal) > self.radius
            && -offset.dot(self.normal) > self.radius
    }

    /// Light of a square metre at the centre.
    fn sums(&self, position: DVec3) -> Sums {
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

    /// One of them, as often as it gives light.
    fn member(&self, receiver: &Receiver) -> &'s Source<'a> {
        let [at, _] = math::unit_pair(math::hash(receiver.seed, self.centre.x.to_bits(), 2));
        let mut left = at * self.output.element_sum();
        for source in &self.members {
            let own = source.polygon().map_or(0.0, |polygon| {
                (polygon.radiance * polygon.area).element_sum()
            });
            if left < own {
                return source;
            }
            left -= own;
        }
        self.members[self.members.len() - 1]
    }
}

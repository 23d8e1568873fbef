//! The sun and its like: bright compact regions of a picture, taken out as light sources of their own.
//!
//! A sun of half a degree is a pixel or two, in a picture that was blurred and quantised on its way. What it has left in the picture is
//! its light, its place, and how wide that light is spread. So a region becomes an ellipse of uniform radiance with the same light, mean
//! direction and second moments, as a convex polygon: its penumbrae are as wide as the picture says and no pixel edges are seen in them.
//!
//! The pixels of a region keep the radiance of what surrounds them. Picture and regions together have the light that the picture had.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::cells::solid_angle;
use super::grid::{Grid, norm};
use super::rule::{Cell, mean, turn};
use crate::scene::Environment;

/// Most regions of a picture. Each costs as much as a light. What is left stays in the picture, where it does no harm.
const MAX_REGIONS: usize = 8;

/// Pixels that may turn out not to be regions before the search ends.
const MAX_ATTEMPTS: usize = 64;

/// Part of its brightest pixel that a pixel of the region has at least. Larger: half of a blurred sun stays behind, in cells that are
/// much larger than it. Smaller: haze around it makes it wide.
const EDGE: f64 = 0.02;

/// Times the radiance around it that a region's mean has at least. Smaller: windows and clouds become regions.
const CONTRAST: f64 = 10.0;

/// Part of the picture's light that a region has at least. Smaller: lamps nobody would miss the shadow of.
const LEAST_SHARE: f64 = 0.01;

/// Largest radius of a region, radians: 5°. Larger lights are spread over enough cells to be smooth.
const MAX_RADIUS: f64 = 0.0873;

/// Corners of the polygon. With its second moments right, a 16-gon differs from the ellipse by its corners alone: 1.3 % of the radius.
const CORNERS: usize = 16;

/// A bright compact light at infinity.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Its light; the solid angle is the polygon's.
    pub cell: Cell,
    /// Corners of a convex polygon as unit vectors, counter-clockwise seen from the origin.
    pub polygon: Vec<DVec3>,
    /// Its uniform radiance in nit, linear RGB: the light over the solid angle. It adds to the picture behind it.
    pub radiance: DVec3,
}

impl Region {
    /// Turned by `rotation` radians about Y, counter-clockwise seen from above, and `strength` times as bright.
    #[must_use]
    pub fn turned(&self, rotation: f64, strength: f64) -> Self {
        let turn = turn(rotation);
        Self {
            cell: self.cell.turned(rotation, strength),
            polygon: self.polygon.iter().map(|&corner| turn * corner).collect(),
            radiance: strength * self.radiance,
        }
    }
}

/// A pixel: column and row.
type Place = (u32, u32);

/// Takes bright compact regions out of `image` and returns them, brightest pixel first; their pixels keep the radiance around them.
///
/// A region is what is connected to a bright pixel and at least 2 % as bright, is not wider than 10°, holds at least 1 % of the picture's
/// light, and is on average ten times as bright as its surroundings. Most pictures without a sun have none.
#[must_use]
pub fn split_bright(image: &mut Environment) -> Vec<Region> {
    let mut regions = Vec::new();
    let least = LEAST_SHARE * Grid::new(image).weight();
    // Less than that all over the largest region is too little.
    let dimmest = least / (2.0 * PI * (1.0 - MAX_RADIUS.cos()));
    let mut is_done = vec![false; image.pixels().len()];
    for _ in 0..MAX_ATTEMPTS {
        let Some(places) = brightest(image, dimmest, &mut is_done) else {
            break;
        };
        let Some(replaced) = places.and_then(|places| surroundings(image, &places)) else {
            continue;
        };
        if let Some(region) = region(image, &replaced, least) {
            for (place, radiance) in replaced {
                image.set(place.0, place.1, radiance);
            }
            regions.push(region);
            if regions.len() == MAX_REGIONS {
                break;
            }
        }
    }
    regions
}

/// The pixels connected to the brightest one that is not done and not dimmer than `dimmest`; `Some(None)` when they are too wide. Marks all it meets as done.
fn brightest(
    image: &Environment,
    dimmest: f64,
    is_done: &mut [bool],
) -> Option<Option<Vec<Place>>> {
    let width = image.width() as usize;
    let (start, peak) = image
        .pixels()
        .iter()
        .enumerate()
        .filter(|&(index, _)| !is_done[index])
        .map(|(index, pixel)| (index, norm(pixel)))
        .fold(
            (0, 0.0),
            |best, next| if next.1 > best.1 { next } else { best },
        );
    if peak == 0.0 || peak < dimmest {
        return None;
    }
    let grid = Grid::new(image);
    let at = |(column, row): Place| row as usize * width + column as usize;
    let start = ((start % width) as u32, (start / width) as u32);
    let centre = grid.patch(start.0, start.1).direction;
    let mut is_compact = true;
    let mut places = Vec::new();
    let mut queue = VecDeque::from([start]);
    is_done[at(start)] = true;
    while let Some(place) = queue.pop_front() {
        let distance = centre.angle_between(grid.patch(place.0, place.1).direction);
        // The bright pixel may be at the region's border. Beyond, the rest is followed all the same, so that it is met only once.
        is_compact &= distance <= 2.0 * MAX_RADIUS;
        places.push(place);
        for next in neighbours(image, place) {
            let pixel = image.row(next.1)[next.0 as usize];
            if !is_done[at(next)] && norm(&pixel) >= EDGE * peak {
                is_done[at(next)] = true;
                queue.push_back(next);
            }
        }
    }
    Some(is_compact.then_some(places))
}

/// The eight pixels around one; around the poles those of the opposite columns.
fn neighbours(image: &Environment, (column, row): Place) -> impl Iterator<Item = Place> {
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    (-1..=1_i64)
        .flat_map(|dy| (-1..=1_i64).map(move |dx| (dx, dy)))
        .filter(|&step| step != (0, 0))
        .map(move |(dx, dy)| {
            let (mut x, mut y) = (i64::from(column) + dx, i64::from(row) + dy);
            if !(0..height).contains(&y) {
                x += width / 2;
                y = y.clamp(0, height - 1);
            }
            (x.rem_euclid(width) as u32, y as u32)
        })
}

/// What the pixels at `places` have when the light is taken out: the mean of the two rings around them, and never more than they had.
/// `None` without anything around them.
fn surroundings(image: &Environment, places: &[Place]) -> Option<Vec<(Place, [f32; 3])>> {
    let grid = Grid::new(image);
    let width = image.width() as usize;
    let mut is_met = vec![false; image.pixels().len()];
    let at = |(column, row): Place| row as usize * width + column as usize;
    for &place in places {
        is_met[at(place)] = true;
    }
    let mut sum = DVec3::ZERO;
    let mut area = 0.0;
    let mut border = places.to_vec();
    for _ in 0..2 {
        let mut ring = Vec::new();
        for next in border.iter().flat_map(|&place| neighbours(image, place)) {
            if !std::mem::replace(&mut is_met[at(next)], true) {
                ring.push(next);
                let solid_angle = grid.patch(next.0, next.1).solid_angle;
                let radiance = image.row(next.1)[next.0 as usize].map(f64::from);
                sum += solid_angle * DVec3::from_array(radiance);
                area += solid_angle;
            }
        }
        border = ring;
    }
    let around = (area > 0.0).then(|| (sum / area).to_array().map(|value| value as f32))?;
    Some(
        places
            .iter()
            .map(|&(column, row)| {
                let pixel = image.row(row)[column as usize];
                let left = std::array::from_fn(|channel| pixel[channel].min(around[channel]));
                ((column, row), left)
            })
            .collect(),
    )
}

/// The light that `replaced` pixels lose, if it makes a region of at least `least` ‖B‖.
fn region(image: &Environment, replaced: &[(Place, [f32; 3])], least: f64) -> Option<Region> {
    /// Pieces along the side of a pixel, for the second moments.
    const PIECES: u32 = 8;
    let grid = Grid::new(image);
    let mut cell = Cell {
        direction: DVec3::ZERO,
        fluence: DVec3::ZERO,
        light_vector: [DVec3::ZERO; 3],
        solid_angle: 0.0,
    };
    let mut kept = 0.0;
    let mut pieces = Vec::new();
    for &((column, row), left) in replaced {
        let pixel = image.row(row)[column as usize];
        let lost: [f64; 3] =
            std::array::from_fn(|channel| f64::from(pixel[channel]) - f64::from(left[channel]));
        let patch = grid.patch(column, row);
        kept += norm(&left) * patch.solid_angle;
        cell.fluence += patch.solid_angle * DVec3::from_array(lost);
        for (sum, lost) in cell.light_vector.iter_mut().zip(lost) {
            *sum += lost * patch.moment;
        }
        let lost: f64 = lost.iter().sum();
        pieces.extend(
            grid.pieces(column, row, PIECES)
                .map(|piece| (lost * piece.solid_angle, piece.direction)),
        );
    }
    if cell.norm() < least || cell.norm() < (CONTRAST - 1.0) * kept {
        return None;
    }
    cell.direction = mean(pieces.iter().copied())?;
    let farthest = pieces
        .iter()
        .map(|&(_, direction)| cell.direction.angle_between(direction))
        .fold(0.0, f64::max);
    if farthest > MAX_RADIUS {
        return None;
    }
    let polygon = ellipse(cell.direction, &pieces);
    cell.solid_angle = solid_angle(&polygon);
    (cell.solid_angle > 0.0).then(|| Region {
        radiance: cell.fluence / cell.solid_angle,
        cell,
        polygon,
    })
}

/// The polygon around `centre` whose uniform light is spread as that of `pieces`, counter-clockwise seen from the origin.
fn ellipse(centre: DVec3, pieces: &[(f64, DVec3)]) -> Vec<DVec3> {
    let (a, b) = centre.any_orthonormal_pair();
    let (mut xx, mut xy, mut yy, mut sum) = (0.0, 0.0, 0.0, 0.0);
    for &(weight, direction) in pieces {
        let (x, y) = (direction.dot(a), direction.dot(b));
        xx += weight * x * x;
        xy += weight * x * y;
        yy += weight * y * y;
        sum += weight;
    }
    let (xx, xy, yy) = (xx / sum, xy / sum, yy / sum);
    // Main axes of the variances.
    let spread = (0.5 * (xx - yy)).hypot(xy);
    let axis = DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
    let middle = 0.5 * (xx + yy);
    // Variance of a regular n-gon of radius 1 along any axis.
    let unit = (2.0 + (TAU / CORNERS as f64).cos()) / 12.0;
    let major = ((middle + spread) / unit).sqrt();
    let minor = ((middle - spread).max(0.0) / unit).sqrt();
    let is_counter_clockwise_outside = a.cross(b).dot(centre) > 0.0;
    (0..CORNERS)
        .map(|corner| {
            let turn = TAU * corner as f64 / CORNERS as f64;
            let turn = if is_counter_clockwise_outside {
                -turn
            } else {
                turn
            };
            let along = major * turn.cos() * axis + minor * turn.sin() * axis.perp();
            // Orthographic, as the moments were taken.
            let height = (1.0 - along.length_squared()).max(0.0).sqrt();
            (height * centre + along.x * a + along.y * b).normalize()
        })
        .collect()
}

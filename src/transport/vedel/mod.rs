//! The visible part of a light as Vedel published it: its contour traced with shadow rays. The baseline that other estimators are
//! measured against.
//!
//! A coarse grid of samples on the light, a two-dimensional marching of its squares, dichotomy along their sides for the places where the
//! contour crosses them, one more crossing within each square to check, and subdivision where that one changes the form factor by more
//! than the dichotomy leaves open (`lattice`). The border of the light is not traced but cut (`border`).
//!
//! What deviates from the paper:
//! - The density of the first-level grid is found anew for each point. The paper carries it along a scanline, so points would depend on
//!   their order.
//! - Light of any shape: the grid spans a parallelogram around what is above the horizon, the light itself when it is a
//!   parallelogram and whole. Samples beside the light are traced as if they were on it, to a point of its plane; the contour they give
//!   is then cut by the light's border. So borders stay exact, and no square mistakes them for silhouettes.
//! - The derivative is not that of the appendix, which is wrong where contours cross (see `appendix`), but that of
//!   [`super::contour`] with each piece on the chord between the two places where the rays beside its ends were stopped.
//! - The threshold is the form factor of the area that the contour in a square sweeps when its two ends move through the intervals
//!   they are known to be in. The paper says a strip along it of the width of an interval, the same for a contour across its sides.
//! - No interpolation along scanlines and no shaft of candidates per span; what follows the bake does both.
//!
//! What no setting heals but a denser first level: an occluder that lies between the samples is not seen at all. The claimed error allows
//! for it by a share of the light per sample. Where the contour is a tangle the grid is refined down to the sample array, and a point costs thousands of rays.
//!
//! Source: C. Vedel, "Computing illumination from area light sources by approximate contour integration", Graphics Interface 1993.

pub(super) mod appendix;
mod border;
mod lattice;

use glam::{DVec2, DVec3};

use self::border::Traced;
use self::lattice::{Eye, Lattice, Line, Place, Settings, Tracer};
use super::Receiver;
use super::contour::Piece;
use super::source::Source;
use crate::lights::Polygon;
use crate::math;
use crate::visibility::Visibility;

/// How [`super::Estimator::Vedel`] looks at a light. The defaults are those of the paper: nine first samples, five steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Squares along a side of the first-level grid. Range: 1..=64. Default: 2. Occluders whose shadow on the light is smaller than a
    /// square may be missed.
    pub cells: u32,
    /// Times a side of such a square can be halved; decides how precisely crossings are found and how often squares can be subdivided. Range:
    /// 0..=6. Default: 5. A point never casts more than (cells · 2^steps + 1)² rays at a light.
    pub steps: u32,
    /// Validity threshold: accepted difference of form factor in a square, relative to that of a strip along the contour one step wide.
    /// Range: ≥ 0. Default: 1. Smaller subdivides more.
    pub threshold: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            cells: 2,
            steps: 5,
            threshold: 1.0,
        }
    }
}

impl Options {
    fn settings(&self, seed: u64) -> Settings {
        Settings {
            cells: self.cells.clamp(1, 64),
            steps: self.steps.min(6),
            threshold: self.threshold,
            seed,
        }
    }
}

/// A parallelogram in the plane of a light that holds it; its axes span the grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    /// World metres.
    origin: DVec3,
    /// Sides; their cross product points along the light's front normal.
    axes: [DVec3; 2],
    /// Vectors whose scalar product with a place relative to the origin is its coordinate.
    duals: [DVec3; 2],
}

/// A polygon is a parallelogram when its fourth corner is off by less than this, relative to a diagonal. Larger would leave a visible
/// strip to the cutting of borders, which is exact as well; smaller would miss rectangles whose coordinates were rounded to `f32`.
const PARALLELOGRAM: f64 = 1e-5;

impl Frame {
    /// The polygon itself when it is a parallelogram; else the smallest rectangle around it that has a side along one of its.
    pub(super) fn new(polygon: &Polygon) -> Self {
        if let [contour] = polygon.contours.as_slice()
            && let [a, b, c, d] = *contour.as_slice()
            && (a + c - b - d).length() <= PARALLELOGRAM * (c - a).length()
        {
            return Self::of(a, [b - a, d - a]);
        }
        let vertices: Vec<DVec3> = polygon.contours.iter().flatten().copied().collect();
        let mut smallest: Option<(f64, Self)> = None;
        for contour in &polygon.contours {
            for (index, &a) in contour.iter().enumerate() {
                let along = (contour[(index + 1) % contour.len()] - a).normalize_or_zero();
                let across = polygon.normal.cross(along);
                let [width, height] = [along, across].map(|axis| extent(&vertices, a, axis));
                let area = width * height;
                if area > 0.0 && smallest.is_none_or(|(least, _)| area < least) {
                    smallest = Some((area, Self::of(a, [along * width, across * height])));
                }
            }
        }
        let [u, v] = polygon.normal.any_orthonormal_pair().into();
        smallest.map_or_else(|| Self::of(DVec3::ZERO, [u, v]), |(_, frame)| frame)
    }

    fn of(origin: DVec3, axes: [DVec3; 2]) -> Self {
        let [u, v] = axes;
        let normal = u.cross(v);
        let square = normal.length_squared();
        Self {
            origin,
            axes,
            duals: [v.cross(normal) / square, normal.cross(u) / square],
        }
    }
}

/// Length of the projection on an axis.
fn extent(vertices: &[DVec3], origin: DVec3, axis: DVec3) -> f64 {
    let places = vertices.iter().map(|vertex| (*vertex - origin).dot(axis));
    let (low, high) = places.fold((0.0f64, 0.0f64), |(low, high), x| (low.min(x), high.max(x)));
    high - low
}

/// The grid of one receiver.
struct Grid<'a, V: ?Sized> {
    receiver: &'a Receiver,
    polygon: &'a Polygon,
    visibility: &'a V,
    /// The sample (0, 0) relative to the receiver, metres.
    corner: DVec3,
    /// From a sample to the next of its row and of its column.
    steps: [DVec3; 2],
    /// Square metres.
    step_area: f64,
}

impl<V: Visibility + ?Sized> Grid<'_, V> {
    fn at(&self, place: DVec2) -> DVec3 {
        self.corner + place.x * self.steps[0] + place.y * self.steps[1]
    }

    fn ignores(&self, triangle: u32) -> bool {
        self.polygon.surface.binary_search(&triangle).is_ok()
    }

    /// Distance of what hides a sample, relative to that of the sample.
    fn depth(&self, place: Place) -> f64 {
        let to_sample = self.at(lattice::position(place));
        let length = to_sample.length();
        let ignore = |triangle: u32| self.ignores(triangle);
        let direction = to_sample / length;
        self.visibility
            .closest(self.receiver.position, direction, length, &ignore)
            .map_or(1.0, |hit| hit.distance / length)
    }
}

impl<V: Visibility + ?Sized> Eye for Grid<'_, V> {
    fn sees(&self, place: Place) -> bool {
        let from = self.receiver.position;
        let to = from + self.at(lattice::position(place));
        !self
            .visibility
            .occluded(from, to, &|triangle| self.ignores(triangle))
    }

    fn triangle(&self, corners: [DVec2; 3]) -> f64 {
        let corners = corners.map(|corner| self.at(corner));
        let vector: DVec3 = (0..3)
            .map(|k| {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                let w = a.cross(b - a);
                let s = w.length();
                if s > 0.0 {
                    w * (0.5 * s.atan2(a.dot(b)) / s)
                } else {
                    DVec3::ZERO
                }
            })
            .sum();
        vector.dot(self.receiver.normal).abs()
    }

    fn element(&self, place: DVec2, area: f64) -> f64 {
        let to_place = self.at(place);
        let cosines = to_place.dot(self.receiver.normal) * to_place.dot(self.polygon.normal);
        cosines.abs() / to_place.length_squared().powi(2) * area * self.step_area
    }
}

/// Memory that evaluations reuse.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    lattice: Lattice,
    lines: Vec<Line>,
    border: Vec<[DVec2; 2]>,
}

/// What was traced besides the contour.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome {
    /// Form factor by which the contour may be off, steradians: the validity differences and half of the strips that dichotomy left open.
    pub(super) error: f64,
    /// Rays cast.
    pub(super) rays: u32,
    /// Those of them that looked whether a place is visible.
    pub(super) samples: u32,
}

/// A light that rays look at.
pub(super) struct View<'a, V: ?Sized> {
    pub(super) source: &'a Source<'a>,
    pub(super) frame: &'a Frame,
    /// Names the light in random choices.
    pub(super) light: u64,
    pub(super) options: &'a Options,
    /// Whether to find out where in front of the light the contour lies, which its derivative needs and its light does not.
    pub(super) in_depth: bool,
    pub(super) visibility: &'a V,
}

impl<V: Visibility + ?Sized> View<'_, V> {
    /// Contour of the part that `receiver` sees.
    ///
    /// `borders` are the light's contours above the horizon, relative to the receiver. Appends to `pieces`, each on the light's border, on
    /// the chord between two places of the occluder, or when those are not asked for, on the light.
    pub(super) fn visible_contour(
        &self,
        receiver: &Receiver,
        borders: &[Piece],
        scratch: &mut Scratch,
        pieces: &mut Vec<Piece>,
    ) -> Outcome {
        let Scratch {
            lattice,
            lines,
            border,
        } = scratch;
        let seed = math::hash(receiver.seed, self.light, 0);
        let settings = self.options.settings(seed);
        let Some(grid) = self.grid(receiver, borders, settings.side(), border) else {
            // A sliver along the horizon, or of a light without area: next to nothing, whether hidden or not.
            pieces.extend_from_slice(borders);
            return Outcome {
                error: 0.0,
                rays: 0,
                samples: 0,
            };
        };
        let mut tracer = Tracer::new(&grid, settings, lattice, lines);
        tracer.trace();
        let traced = Traced::new(lines, f64::from(settings.side()), lattice.origin());
        for (piece, side) in borders.iter().zip(&*border) {
            traced.for_each_visible_part(*side, |start, end| {
                let at = |t: f64| piece.a + t * (piece.b - piece.a);
                pieces.push(Piece {
                    a: at(start),
                    b: at(end),
                    ..*piece
                });
            });
        }
        let depths = if self.in_depth {
            depths_of(&grid, lines)
        } else {
            Vec::new()
        };
        let is_front = self.source.height(receiver.position) > 0.0;
        let mut error = 0.0;
        for line in &*lines {
            let chord = Chord::new(&grid, &depths, line);
            border::for_each_inner_part(line.ends.map(|end| end.at), border, |start, end| {
                error += line.error * (end - start);
                // A contour is clockwise as the receiver sees it.
                let (from, to) = if is_front { (end, start) } else { (start, end) };
                pieces.push(Piece {
                    a: chord.at(from),
                    b: chord.at(to),
                    horizon: false,
                });
            });
        }
        Outcome {
            error,
            rays: (lattice.n_filled() + depths.len()) as u32,
            samples: lattice.n_filled() as u32,
        }
    }

    /// Spans the grid over what is above the horizon and puts that, in lattice coordinates, into `border`; `None` when it has no area.
    fn grid<'b>(
        &'b self,
        receiver: &'b Receiver,
        borders: &[Piece],
        side: u32,
        border: &mut Vec<[DVec2; 2]>,
    ) -> Option<Grid<'b, V>> {
        let polygon = self.source.polygon()?;
        let origin = self.frame.origin - receiver.position;
        let place = |point: DVec3| {
            let [u, v] = self.frame.duals.map(|dual| dual.dot(point - origin));
            DVec2::new(u, v)
        };
        border.clear();
        border.extend(borders.iter().map(|side| [place(side.a), place(side.b)]));
        let places = || border.iter().flatten().copied();
        let low = places().fold(DVec2::INFINITY, DVec2::min);
        let high = places().fold(DVec2::NEG_INFINITY, DVec2::max);
        let step = (high - low) / f64::from(side);
        if !(step.min_element() > 0.0 && step.is_finite()) {
            return None;
        }
        for place in border.iter_mut().flatten() {
            *place = (*place - low) / step;
        }
        let [u, v] = self.frame.axes;
        let steps = [u * step.x, v * step.y];
        Some(Grid {
            receiver,
            polygon,
            visibility: self.visibility,
            corner: origin + low.x * u + low.y * v,
            steps,
            step_area: steps[0].cross(steps[1]).length(),
        })
    }
}

/// A line on the light and, in front of it or on it, what makes it.
struct Chord {
    /// Relative to the receiver, metres.
    ends: [DVec3; 2],
    /// Their depths relative to the light's.
    depths: [f64; 2],
}

impl Chord {
    fn new<V: Visibility + ?Sized>(
        grid: &Grid<'_, V>,
        depths: &[(Place, f64)],
        line: &Line,
    ) -> Self {
        let depths = line.ends.map(|end| {
            let index = depths.binary_search_by_key(&end.hidden, |(place, _)| *place);
            index.map_or(1.0, |index| depths[index].1)
        });
        let [from, to] = line.ends.map(|end| grid.at(end.at));
        Self {
            ends: [from * depths[0], to * depths[1]],
            depths,
        }
    }

    /// What is seen in the direction of the point at parameter `t` of the line on the light.
    fn at(&self, t: f64) -> DVec3 {
        let [near, far] = self.depths;
        let tau = t * near / ((1.0 - t) * far + t * near);
        self.ends[0] + tau * (self.ends[1] - self.ends[0])
    }
}

/// Depths of the hidden samples beside the lines' ends, each looked up once, sorted.
fn depths_of<V: Visibility + ?Sized>(grid: &Grid<'_, V>, lines: &[Line]) -> Vec<(Place, f64)> {
    let mut places: Vec<Place> = lines
        .iter()
        .flat_map(|line| line.ends.map(|end| end.hidden))
        .collect();
    places.sort_unstable();
    places.dedup();
    places
        .into_iter()
        .map(|place| (place, grid.depth(place)))
        .collect()
}

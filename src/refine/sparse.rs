//! Rounds of evaluation: where the triangles' corners disagree, points are added; everywhere else the value is interpolated.

use glam::DVec2;
use rayon::prelude::*;

use super::border::{self, Squares};
use super::cubic::{self, Corner, Patch};
use super::domain::Domain;
use super::mesh::{Face, Mesh};
use crate::error::{Error, Result};

/// What is known at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<const K: usize> {
    /// The values.
    pub value: [f64; K],
    /// Their derivatives per cell, along columns and along rows. Not read unless `has_slopes`.
    pub slopes: [[f64; K]; 2],
    /// Whether the derivatives are known.
    pub has_slopes: bool,
    /// Estimated absolute error of the values.
    pub error: f64,
}

/// How far to refine.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Absolute error that interpolation may have at 99 of 100 points. Range: 0 and more; at 0 every point is evaluated that is not surrounded
    /// by a quadratic.
    pub tolerance: f64,
    /// Most points that may be evaluated. What is left then is interpolated all the same, and [`Refined::complete`] is false. Points that
    /// hang together with nothing are evaluated in any case.
    pub budget: usize,
    /// Whether interpolated derivatives are wanted.
    pub slopes: bool,
}

/// Values at all points of a domain.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Refined<const K: usize> {
    /// In the order of the points. Finite.
    pub values: Vec<[f32; K]>,
    /// Derivatives per cell along columns and rows; empty unless asked for. Zero where a point was evaluated without.
    pub slopes: Vec<[[f32; K]; 2]>,
    /// Estimated absolute error: of the evaluation, and of the interpolation.
    pub errors: Vec<f32>,
    /// Whether a point was evaluated.
    pub evaluated: Vec<bool>,
    /// The triangles that were interpolated over, as indices of points.
    pub triangles: Vec<[u32; 3]>,
    /// Whether refinement ended because the error was reached everywhere.
    pub complete: bool,
}

/// Disagreement of two corners, in tolerances, from which on more points are added. At 3.75 the error of cubic interpolation on soft shadows
/// has a mean of 0.1 and a 99th percentile of 1 tolerance (bench `refine`); the error is proportional to it.
const TRAPEZOID: f64 = 3.75;

/// Disagreement of two triangles, as part of the difference of their second derivatives over a side. For a cubic it would be a twelfth to
/// mean the same as that of two corners; more, because the error around a jump of derivatives is larger than that of a cubic. At a
/// twelfth the shadow of a box that stands on the floor is off by 2.5 tolerances at the 99th percentile, at 0.3 soft shadows are a third
/// dearer.
const BEND: f64 = 0.2;

/// Least share of what [`TRAPEZOID`] allows for that a triangle is trusted to be off by, when the points added to it before were hit better
/// than that. At 0 one lucky hit would end refinement; at 1 smooth light costs a third more.
const LEAST_SURPRISE: f64 = 0.25;

/// A side is split when it is no shorter than this part of the longest. Smaller lets triangles grow thin along shadows, which cubics
/// follow less well; at 1 always the longest side is split, which costs a third more.
const THIN: f64 = 0.5;

/// The error of linear interpolation, seen from the change of derivatives along a side, is an eighth of it; one tolerance is allowed.
const CHORD: f64 = TRAPEZOID / 8.0;

/// Estimated error over a triangle, from the largest disagreement of its corners. See the bench `refine`.
const ERROR_SHARE: f64 = 0.1;

/// Domains of so few points are evaluated everywhere: their border alone needs as many.
const FEW: usize = 16;

/// Largest side in cells of the square that a batch comes from, and the number of points from which on it is cut into smaller ones.
const BATCH_SIDE: i32 = 32;
const BATCH: usize = 64;

/// Smallest such side.
const MIN_BATCH_SIDE: i32 = 8;

/// How far outside of a triangle its cubic may be used, in barycentric weight and in cells.
const OUTSIDE: (f64, f64) = (0.5, 0.75);

/// Evaluates a quantity where it bends, and interpolates it everywhere else.
///
/// `evaluate` gets points that lie close together, as indices in the domain, and gives a sample for each; it must depend on them only.
/// The result then does not depend on the number of threads.
///
/// Two neighbouring samples predict each other: by the trapezoid rule the difference of their values is the mean of their derivatives
/// times the way between them, up to a third derivative. Where that fails by more than 3.75 tolerances on a side of a triangle, or
/// neighbouring triangles bend differently by as much, the middle of a side is evaluated too. Where samples come without derivatives, those are estimated from their neighbours, and
/// interpolation is linear.
///
/// What happens entirely between the points that are evaluated first (see [`super::Point::spacing`]) is not seen.
///
/// # Errors
/// [`Error::Interrupted`] when `cancelled` returns true.
pub fn sparse<const K: usize>(
    domain: &Domain,
    evaluate: &(impl Fn(&[u32]) -> Vec<Sample<K>> + Sync),
    options: &Options,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Refined<K>> {
    let mut work = Work {
        domain,
        evaluate,
        options,
        cancelled,
        slots: vec![NONE; domain.points().len()],
        found: Vec::new(),
        points: Vec::new(),
        surprises: Vec::new(),
        mesh: Mesh::default(),
        complete: true,
    };
    if domain.points().len() <= FEW {
        work.evaluate((0..domain.points().len() as u32).collect())?;
        return Ok(work.finish(&[], Vec::new()));
    }
    let squares = Squares::new(domain);
    work.start(&squares)?;
    while work.round(&squares)? {}
    work.interpolate(&squares)
}

const NONE: u32 = u32::MAX;

struct Work<'a, const K: usize, F> {
    domain: &'a Domain,
    evaluate: &'a F,
    options: &'a Options,
    cancelled: &'a (dyn Fn() -> bool + Sync),
    /// Per point its index in `found`.
    slots: Vec<u32>,
    found: Vec<Sample<K>>,
    /// Per sample its point.
    points: Vec<u32>,
    /// Per sample how far the surface was off there before, relative to what [`TRAPEZOID`] allows for; 1 where there was none.
    surprises: Vec<f64>,
    mesh: Mesh,
    complete: bool,
}

/// A point to be added, and the vertex it is near to.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    point: u32,
    /// The triangle it is wanted for, as a place in the list of all.
    face: usize,
    disagreement: f64,
}

impl<const K: usize, F: Fn(&[u32]) -> Vec<Sample<K>> + Sync> Work<'_, K, F> {
    fn place(&self, point: usize) -> DVec2 {
        self.domain.points()[point].place
    }

    /// Evaluates points that were not evaluated yet.
    fn evaluate(&mut self, mut points: Vec<u32>) -> Result<()> {
        points.retain(|&point| self.slots[point as usize] == NONE);
        points.sort_unstable();
        points.dedup();
        let mut batches = Vec::new();
        self.cut(points, BATCH_SIDE, &mut batches);
        let samples: Vec<Vec<Sample<K>>> = batches
            .par_iter()
            .map(|batch| {
                if (self.cancelled)() {
                    return Err(Error::Interrupted);
                }
                Ok((self.evaluate)(batch))
            })
            .collect::<Result<_>>()?;
        for (batch, samples) in batches.iter().zip(samples) {
            for (&point, sample) in batch.iter().zip(samples) {
                self.slots[point as usize] = self.found.len() as u32;
                self.found.push(tidied(sample));
                self.points.push(point);
                self.surprises.push(1.0);
            }
        }
        Ok(())
    }

    /// Sorts points into squares of the grid.
    fn cut(&self, mut points: Vec<u32>, side: i32, batches: &mut Vec<Vec<u32>>) {
        let square = |point: u32| {
            let [x, y] = self.domain.offset(point as usize);
            (y / side, x / side)
        };
        points.sort_by_key(|&point| square(point));
        for batch in points.chunk_by(|&a, &b| square(a) == square(b)) {
            if batch.len() > BATCH && side > MIN_BATCH_SIDE {
                self.cut(batch.to_vec(), side / 2, batches);
            } else {
                batches.push(batch.to_vec());
            }
        }
    }

    /// The borders, a grid within them, and what belongs to nothing.
    fn start(&mut self, squares: &Squares) -> Result<()> {
        let domain = self.domain;
        let borders: Vec<Vec<usize>> = squares
            .loops(domain)
            .iter()
            .map(|border| border::simplified(domain, border))
            .collect();
        let grid: Vec<u32> = (0..domain.points().len())
            .filter(|&point| self.is_on_start_grid(point))
            .map(|point| point as u32)
            .collect();
        let mut first: Vec<u32> = borders
            .iter()
            .flatten()
            .map(|&point| point as u32)
            .chain(grid.iter().copied())
            .collect();
        first.extend(squares.loose(domain));
        self.evaluate(first)?;
        let mut near = None;
        let mut loops = Vec::new();
        for border in &borders {
            let mut handles = Vec::new();
            for &point in border {
                if let Some(handle) = self.mesh.insert(point, self.place(point), near) {
                    near = Some(handle);
                    handles.push(handle);
                }
            }
            loops.push(handles);
        }
        for handles in loops {
            for (index, &from) in handles.iter().enumerate() {
                self.mesh
                    .constrain(from, handles[(index + 1) % handles.len()]);
            }
        }
        for point in grid {
            let point = point as usize;
            near = self.mesh.insert(point, self.place(point), near).or(near);
        }
        Ok(())
    }

    /// Whether a point is one of those that are evaluated first: every so many, not too near to the border, where there are others.
    fn is_on_start_grid(&self, point: usize) -> bool {
        let spacing = i32::from(self.domain.points()[point].spacing.max(1));
        let [x, y] = self.domain.offset(point);
        let on_grid = |position: i32| position % spacing == spacing / 2;
        if !on_grid(x) || !on_grid(y) {
            return false;
        }
        let [x, y] = self.domain.points()[point].cell.map(i32::from);
        let margin = (spacing / 4).max(1);
        [[margin, 0], [-margin, 0], [0, margin], [0, -margin]]
            .iter()
            .all(|[dx, dy]| self.domain.at([x + dx, y + dy]).is_some())
    }

    /// Adds points where corners disagree. Returns whether there were any.
    fn round(&mut self, squares: &Squares) -> Result<bool> {
        let corners = self.corners();
        let limit = TRAPEZOID * self.options.tolerance;
        let faces: Vec<Face> = self.mesh.faces().collect();
        let bends: Vec<Option<Bend<K>>> = faces
            .par_iter()
            .map(|face| self.bend(face, &corners, squares))
            .collect();
        let mut wanted: Vec<Wanted> = (0..faces.len())
            .into_par_iter()
            .filter_map(|index| {
                let face = &faces[index];
                let known = face.points.map(|point| &corners[point_slot(self, point)]);
                let disagreement =
                    disagreement(&known).max(disagreement_around(index, &faces, &bends));
                let surprise = face
                    .points
                    .map(|point| self.surprises[point_slot(self, point)])
                    .into_iter()
                    .fold(LEAST_SURPRISE, f64::max)
                    .min(1.0);
                if disagreement * surprise <= limit {
                    return None;
                }
                let point = self.next_point(face, &known, squares)?;
                Some(Wanted {
                    point,
                    face: index,
                    disagreement,
                })
            })
            .collect();
        // The worst first, in case not all can be had; each once.
        wanted.sort_by(|a, b| {
            b.disagreement
                .total_cmp(&a.disagreement)
                .then(a.point.cmp(&b.point))
        });
        let mut seen = std::collections::BTreeSet::new();
        wanted.retain(|wanted| seen.insert(wanted.point));
        let room = self.options.budget.saturating_sub(self.found.len());
        if wanted.len() > room {
            self.complete = false;
            wanted.truncate(room);
        }
        if wanted.is_empty() {
            return Ok(false);
        }
        self.evaluate(wanted.iter().map(|wanted| wanted.point).collect())?;
        wanted.sort_by_key(|wanted| wanted.point);
        for wanted in wanted {
            let face = &faces[wanted.face];
            let point = wanted.point as usize;
            let known = face.points.map(|point| &corners[point_slot(self, point)]);
            let slot = point_slot(self, wanted.point);
            self.surprises[slot] = TRAPEZOID
                * surprise(&known, self.place(point), &self.found[slot])
                / wanted.disagreement;
            self.mesh
                .insert(point, self.place(point), Some(face.vertices[0]));
        }
        Ok(true)
    }

    /// How derivatives change over a triangle of the surface; `None` where they are not known.
    fn bend(&self, face: &Face, corners: &[Known<K>], squares: &Squares) -> Option<Bend<K>> {
        let known = face.points.map(|point| &corners[point_slot(self, point)]);
        let places = known.map(|known| known.corner.place);
        let is_exact = known.iter().all(|known| known.is_exact);
        if !is_exact || !squares.hold(places.iter().sum::<DVec2>() / 3.0) {
            return None;
        }
        let slopes = cubic::weight_slopes(&places)?;
        let change = |axis: usize, along: usize| -> [f64; K] {
            std::array::from_fn(|k| {
                (0..3)
                    .map(|corner| slopes[corner][along] * known[corner].corner.slopes[axis][k])
                    .sum()
            })
        };
        let (xy, yx) = (change(0, 1), change(1, 0));
        Some(Bend {
            sides: std::array::from_fn(|k| places[(k + 1) % 3] - places[k]),
            xx: change(0, 0),
            xy: std::array::from_fn(|k| xy[k] + yx[k]),
            yy: change(1, 1),
        })
    }

    /// The next point to evaluate in a triangle; `None` when all are, or it lies outside of the surface.
    fn next_point(&self, face: &Face, known: &[&Known<K>; 3], squares: &Squares) -> Option<u32> {
        let places = face.points.map(|point| self.place(point as usize));
        if !squares.hold(places.iter().sum::<DVec2>() / 3.0) {
            return None;
        }
        let lengths: [f64; 3] =
            std::array::from_fn(|k| places[k].distance_squared(places[(k + 1) % 3]));
        let disagreements: [f64; 3] =
            std::array::from_fn(|k| disagreement_along(known[k], known[(k + 1) % 3]));
        let largest =
            |of: &[f64; 3]| (1..3).fold(0, |best, k| if of[k] > of[best] { k } else { best });
        // Across a shadow's border rather than along it, unless the triangle would become too thin.
        let (worst, longest) = (largest(&disagreements), largest(&lengths));
        let thin = lengths[worst] < THIN * THIN * lengths[longest];
        let side = if thin { longest } else { worst };
        let middle = places[side].midpoint(places[(side + 1) % 3]);
        let mut inside: Option<(f64, u32)> = None;
        self.each_within(&places, |point, _| {
            if self.slots[point] == NONE {
                let distance = self.place(point).distance_squared(middle);
                if inside.is_none_or(|(least, _)| distance < least) {
                    inside = Some((distance, point as u32));
                }
            }
        });
        // A triangle without points of its own is of no interest.
        let (_, inside) = inside?;
        let cell = middle.floor().as_ivec2();
        let reach = (0.15 * lengths[side].sqrt()).clamp(0.75, 2.0);
        self.domain
            .within([cell.x - 2, cell.y - 2], [cell.x + 2, cell.y + 2])
            .filter(|&point| self.slots[point] == NONE)
            .map(|point| (self.place(point).distance(middle), point as u32))
            .filter(|&(distance, _)| distance <= reach)
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .map_or(Some(inside), |(_, point)| Some(point))
    }

    /// Calls `visit` with every point in a triangle, sides included, and its barycentric weights.
    fn each_within(&self, places: &[DVec2; 3], mut visit: impl FnMut(usize, [f64; 3])) {
        let Some(slopes) = cubic::weight_slopes(places) else {
            return;
        };
        let top = places[0].y.min(places[1].y).min(places[2].y).floor() as i32 - 1;
        let bottom = places[0].y.max(places[1].y).max(places[2].y).floor() as i32 + 1;
        for row in top..=bottom {
            // Points lie no more than a cell from their own.
            let Some((left, right)) = span(places, f64::from(row) - 1.0, f64::from(row) + 2.0)
            else {
                continue;
            };
            let columns = [left.floor() as i32 - 1, right.floor() as i32 + 1];
            for point in self.domain.within([columns[0], row], [columns[1], row]) {
                let weights = cubic::weights_at(places, &slopes, self.place(point));
                if weights.iter().all(|&weight| weight >= -1e-9) {
                    visit(point, weights);
                }
            }
        }
    }

    /// Per sample what triangles need to know of it.
    fn corners(&self) -> Vec<Known<K>> {
        let mut corners: Vec<Known<K>> = self
            .found
            .iter()
            .zip(&self.points)
            .map(|(sample, &point)| Known {
                corner: Corner {
                    place: self.place(point as usize),
                    value: sample.value,
                    slopes: sample.slopes,
                },
                is_exact: sample.has_slopes,
                error: sample.error,
            })
            .collect();
        for (handle, point) in self.mesh.vertices() {
            let slot = point_slot(self, point);
            if !corners[slot].is_exact {
                let around: Vec<usize> = self
                    .mesh
                    .around(handle)
                    .map(|other| point_slot(self, other))
                    .collect();
                corners[slot].corner.slopes = estimated_slopes(&corners, slot, &around);
            }
        }
        corners
    }

    /// Fills in everything that was not evaluated.
    fn interpolate(mut self, squares: &Squares) -> Result<Refined<K>> {
        let corners = self.corners();
        let faces: Vec<Face> = self
            .mesh
            .faces()
            .filter(|face| {
                let places = face.points.map(|point| self.place(point as usize));
                squares.hold(places.iter().sum::<DVec2>() / 3.0)
            })
            .collect();
        let mut filled: Vec<Vec<Filled<K>>> = faces
            .par_chunks(64)
            .map(|faces| {
                let mut filled = Vec::new();
                for face in faces {
                    self.fill(face, &corners, &mut filled);
                }
                filled
            })
            .collect();
        let mut is_filled: Vec<bool> = self.slots.iter().map(|&slot| slot != NONE).collect();
        for filled in filled.iter().flatten() {
            is_filled[filled.point as usize] = true;
        }
        // Points that simplifying the border left outside.
        let mut beyond = Vec::new();
        let mut left = Vec::new();
        for point in (0..is_filled.len()).filter(|&point| !is_filled[point]) {
            match self.extrapolate(point, squares, &corners) {
                Some(filled) => beyond.push(filled),
                None => left.push(point as u32),
            }
        }
        filled.push(beyond);
        self.evaluate(left)?;
        let triangles = faces.iter().map(|face| face.points).collect();
        Ok(self.finish(&filled, triangles))
    }

    fn fill(&self, face: &Face, corners: &[Known<K>], filled: &mut Vec<Filled<K>>) {
        let known = face.points.map(|point| &corners[point_slot(self, point)]);
        let mut surface = None;
        let places = known.map(|known| known.corner.place);
        self.each_within(&places, |point, weights| {
            if self.slots[point] == NONE {
                let surface = surface.get_or_insert_with(|| Surface::new(&known));
                filled.push(self.filled(point, surface, weights));
            }
        });
    }

    fn filled(&self, point: usize, surface: &Surface<'_, K>, weights: [f64; 3]) -> Filled<K> {
        Filled {
            point: point as u32,
            value: surface.value(weights).map(stored),
            slopes: self
                .options
                .slopes
                .then(|| surface.slopes(weights).map(|slopes| slopes.map(stored))),
            error: stored(surface.error(weights)),
        }
    }

    /// A point a little outside of the triangles.
    fn extrapolate(
        &self,
        point: usize,
        squares: &Squares,
        corners: &[Known<K>],
    ) -> Option<Filled<K>> {
        let place = self.place(point);
        let (lowest, face, weights) = self
            .mesh
            .faces_near(place)
            .into_iter()
            .filter_map(|face| {
                let places = face.points.map(|point| self.place(point as usize));
                let (weights, slopes) = cubic::weights_in(&places, place)?;
                let within = (0..3).all(|k| {
                    weights[k] >= -OUTSIDE.0 && weights[k] >= -OUTSIDE.1 * slopes[k].length()
                });
                let lowest = weights.iter().copied().fold(f64::INFINITY, f64::min);
                (within && squares.hold(places.iter().sum::<DVec2>() / 3.0))
                    .then_some((lowest, face, weights))
            })
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        debug_assert!(lowest.is_finite());
        let known = face.points.map(|point| &corners[point_slot(self, point)]);
        Some(self.filled(point, &Surface::new(&known), weights))
    }

    fn finish(self, filled: &[Vec<Filled<K>>], triangles: Vec<[u32; 3]>) -> Refined<K> {
        let n = self.slots.len();
        let mut refined = Refined {
            values: vec![[0.0; K]; n],
            slopes: Vec::new(),
            errors: vec![0.0; n],
            evaluated: self.slots.iter().map(|&slot| slot != NONE).collect(),
            triangles,
            complete: self.complete,
        };
        if self.options.slopes {
            refined.slopes = vec![[[0.0; K]; 2]; n];
        }
        for filled in filled.iter().flatten() {
            let point = filled.point as usize;
            refined.values[point] = filled.value;
            refined.errors[point] = filled.error;
            if let Some(slopes) = filled.slopes {
                refined.slopes[point] = slopes;
            }
        }
        for (point, &slot) in self.slots.iter().enumerate() {
            if let Some(sample) = self.found.get(slot as usize) {
                refined.values[point] = sample.value.map(stored);
                refined.errors[point] = stored(sample.error);
                if self.options.slopes {
                    refined.slopes[point] = sample.slopes.map(|slopes| slopes.map(stored));
                }
            }
        }
        refined
    }
}

fn point_slot<const K: usize, F>(work: &Work<'_, K, F>, point: u32) -> usize {
    work.slots[point as usize] as usize
}

/// An evaluated point as a corner.
#[derive(Clone, Copy, Debug)]
struct Known<const K: usize> {
    corner: Corner<K>,
    /// Whether its derivatives were evaluated, not estimated.
    is_exact: bool,
    error: f64,
}

/// An interpolated point.
struct Filled<const K: usize> {
    point: u32,
    value: [f32; K],
    slopes: Option<[[f32; K]; 2]>,
    error: f32,
}

/// The value over a triangle.
struct Surface<'a, const K: usize> {
    known: [&'a Known<K>; 3],
    /// `None` where it is linear.
    patch: Option<Patch<K>>,
    weight_slopes: [DVec2; 3],
    error: f64,
}

impl<'a, const K: usize> Surface<'a, K> {
    fn new(known: &[&'a Known<K>; 3]) -> Self {
        let corners = known.map(|known| known.corner);
        let is_exact = known.iter().all(|known| known.is_exact);
        Self {
            known: *known,
            patch: is_exact.then(|| Patch::new(&corners)),
            weight_slopes: cubic::weight_slopes(&corners.map(|corner| corner.place))
                .unwrap_or_default(),
            error: ERROR_SHARE * disagreement(known),
        }
    }

    fn value(&self, weights: [f64; 3]) -> [f64; K] {
        match &self.patch {
            Some(patch) => patch.value(weights),
            None => self.linear(weights),
        }
    }

    fn linear(&self, weights: [f64; 3]) -> [f64; K] {
        std::array::from_fn(|k| {
            (0..3)
                .map(|corner| weights[corner] * self.known[corner].corner.value[k])
                .sum()
        })
    }

    fn slopes(&self, weights: [f64; 3]) -> [[f64; K]; 2] {
        match &self.patch {
            Some(patch) => patch.slopes(weights, &self.weight_slopes),
            None => [0, 1].map(|axis| self.linear(self.weight_slopes.map(|slope| slope[axis]))),
        }
    }

    /// Of the corners, and of what lies between them.
    fn error(&self, weights: [f64; 3]) -> f64 {
        let corners: f64 = (0..3)
            .map(|corner| weights[corner].clamp(0.0, 1.0) * self.known[corner].error)
            .sum();
        corners + self.error
    }
}

/// How derivatives change over a triangle, taken as linear there.
struct Bend<const K: usize> {
    sides: [DVec2; 3],
    /// Second derivatives; the mixed one twice.
    xx: [f64; K],
    xy: [f64; K],
    yy: [f64; K],
}

/// By how much the corners of a triangle fail to predict each other: the largest of all sides and quantities.
fn disagreement<const K: usize>(corners: &[&Known<K>; 3]) -> f64 {
    (0..3)
        .map(|side| disagreement_along(corners[side], corners[(side + 1) % 3]))
        .fold(0.0, f64::max)
}

fn disagreement_along<const K: usize>(a: &Known<K>, b: &Known<K>) -> f64 {
    let step = b.corner.place - a.corner.place;
    let is_exact = a.is_exact && b.is_exact;
    let mut largest = 0.0_f64;
    for k in 0..K {
        let along = |known: &Known<K>| {
            let [x, y] = &known.corner.slopes;
            x[k] * step.x + y[k] * step.y
        };
        let (start, end) = (along(a), along(b));
        let change = b.corner.value[k] - a.corner.value[k];
        largest = largest.max((change - 0.5 * (start + end)).abs());
        if !is_exact {
            largest = largest.max(CHORD * (end - start).abs());
        }
    }
    largest
}

/// The same between triangles: a bend in the middle of a side is no different from a parabola to its ends, but the triangles beside it
/// do not bend. Where one bends less than its neighbour, that is the neighbour's matter.
fn disagreement_around<const K: usize>(
    index: usize,
    faces: &[Face],
    bends: &[Option<Bend<K>>],
) -> f64 {
    let Some(bend) = &bends[index] else {
        return 0.0;
    };
    let mut largest = 0.0_f64;
    for beyond in faces[index].beyond.iter().flatten() {
        let Some(other) = &bends[*beyond] else {
            continue;
        };
        for side in &bend.sides {
            let (xx, xy, yy) = (side.x * side.x, side.x * side.y, side.y * side.y);
            for k in 0..K {
                let along = |bend: &Bend<K>| xx * bend.xx[k] + xy * bend.xy[k] + yy * bend.yy[k];
                let (here, there) = (along(bend), along(other));
                if here.abs() > there.abs() {
                    largest = largest.max((here - there).abs());
                }
            }
        }
    }
    BEND * largest
}

/// By how much the surface over a triangle is off at a place inside.
fn surprise<const K: usize>(known: &[&Known<K>; 3], place: DVec2, sample: &Sample<K>) -> f64 {
    let places = known.map(|known| known.corner.place);
    let Some((weights, _)) = cubic::weights_in(&places, place) else {
        return f64::INFINITY;
    };
    let value = Surface::new(known).value(weights);
    (0..K)
        .map(|k| (value[k] - sample.value[k]).abs())
        .fold(0.0, f64::max)
}

/// First and last column of the part of a triangle between two rows.
fn span(places: &[DVec2; 3], top: f64, bottom: f64) -> Option<(f64, f64)> {
    let mut span: Option<(f64, f64)> = None;
    for k in 0..3 {
        let (a, b) = (places[k], places[(k + 1) % 3]);
        let (low, high) = if a.y < b.y { (a, b) } else { (b, a) };
        if low.y > bottom || high.y < top {
            continue;
        }
        let at = |y: f64| {
            let share = (y - low.y) / (high.y - low.y);
            low.x + share * (high.x - low.x)
        };
        let ends = [
            if low.y < top { at(top) } else { low.x },
            if high.y > bottom { at(bottom) } else { high.x },
        ];
        let (left, right) = span.unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
        span = Some((
            left.min(ends[0]).min(ends[1]),
            right.max(ends[0]).max(ends[1]),
        ));
    }
    span
}

/// Derivatives that fit the differences to the neighbours best, near ones most.
fn estimated_slopes<const K: usize>(
    corners: &[Known<K>],
    of: usize,
    around: &[usize],
) -> [[f64; K]; 2] {
    let here = &corners[of].corner;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    let [mut along_x, mut along_y] = [[0.0; K]; 2];
    for &other in around {
        let there = &corners[other].corner;
        let step = there.place - here.place;
        let weight = 1.0 / step.length_squared().max(1e-12);
        xx += weight * step.x * step.x;
        xy += weight * step.x * step.y;
        yy += weight * step.y * step.y;
        let pairs = there.value.iter().zip(&here.value);
        for ((x, y), (there, here)) in along_x.iter_mut().zip(&mut along_y).zip(pairs) {
            let change = weight * (there - here);
            *x += change * step.x;
            *y += change * step.y;
        }
    }
    let determinant = xx * yy - xy * xy;
    if determinant <= 1e-9 * (xx + yy).powi(2) {
        return [[0.0; K]; 2];
    }
    [
        std::array::from_fn(|k| (yy * along_x[k] - xy * along_y[k]) / determinant),
        std::array::from_fn(|k| (xx * along_y[k] - xy * along_x[k]) / determinant),
    ]
}

/// A sample that no arithmetic can be spoiled by.
fn tidied<const K: usize>(mut sample: Sample<K>) -> Sample<K> {
    for value in &mut sample.value {
        if !value.is_finite() {
            *value = 0.0;
        }
    }
    sample.has_slopes &= sample
        .slopes
        .iter()
        .flatten()
        .all(|slope| slope.is_finite());
    if !sample.has_slopes {
        sample.slopes = [[0.0; K]; 2];
    }
    sample
}

/// The nearest finite f32.
fn stored(value: f64) -> f32 {
    value.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32
}

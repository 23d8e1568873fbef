//! The samples of a light and the lines between seen and hidden ones: Vedel's section 3, without any geometry of its own.
//!
//! Places are numbered on a lattice whose step is the smallest interval of a dichotomy, so every ray that may ever be traced has its slot
//! and none is traced twice, also after the grid was refined.

use std::ops::ControlFlow;

use glam::DVec2;

use crate::math;

/// A sample: its column and row.
pub(super) type Place = [u32; 2];

/// What the tracing asks about the light.
pub(super) trait Eye {
    /// Whether the receiver sees the sample.
    fn sees(&self, place: Place) -> bool;

    /// Form factor of a triangle of the light, in lattice coordinates, any consistent unit.
    fn triangle(&self, corners: [DVec2; 3]) -> f64;

    /// Form factor of a small part of the light around a place, of an area in lattice steps squared, in the same unit.
    fn element(&self, place: DVec2, area: f64) -> f64;
}

/// The sample array.
#[derive(Debug, Default)]
pub(super) struct Lattice {
    /// Steps along a side; there is one sample more.
    side: u32,
    seen: Vec<Option<bool>>,
    /// Slots that are filled.
    filled: Vec<usize>,
}

impl Lattice {
    /// Forgets all samples. The array is kept, because clearing it costs more than most points fill.
    fn reset(&mut self, side: u32) {
        if self.side == side {
            for slot in self.filled.drain(..) {
                self.seen[slot] = None;
            }
        } else {
            let row = side as usize + 1;
            self.side = side;
            self.filled.clear();
            self.seen.clear();
            self.seen.resize(row * row, None);
        }
    }

    /// Whether the sample (0, 0) is seen.
    pub(super) fn origin(&self) -> bool {
        self.seen.first().copied().flatten().unwrap_or(true)
    }

    /// How many samples were taken.
    pub(super) fn n_filled(&self) -> usize {
        self.filled.len()
    }

    fn slot(&self, [column, row]: Place) -> usize {
        row as usize * (self.side as usize + 1) + column as usize
    }

    fn known(&self, place: Place) -> Option<bool> {
        self.seen[self.slot(place)]
    }
}

/// Where the contour crosses an interval of the lattice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Crossing {
    /// The middle of the interval.
    pub(super) at: DVec2,
    /// The end of the interval that is hidden.
    pub(super) hidden: Place,
}

/// A straight part of the contour, the visible side on the left where columns run to the right and rows upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub(super) ends: [Crossing; 2],
    /// Form factor by which it may be off: its share of the validity difference and of the strip that the dichotomy leaves open.
    pub(super) error: f64,
}

/// How finely to look.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settings {
    /// First-level squares along a side.
    pub(super) cells: u32,
    /// Times a side of those is halved.
    pub(super) steps: u32,
    /// Factor of the validity threshold.
    pub(super) threshold: f64,
    /// Key of the choices that the paper leaves to chance.
    pub(super) seed: u64,
}

impl Settings {
    /// Lattice steps along a side of the light.
    pub(super) fn side(&self) -> u32 {
        self.cells << self.steps
    }
}

/// One light and one receiver.
pub(super) struct Tracer<'a, E> {
    eye: &'a E,
    settings: Settings,
    lattice: &'a mut Lattice,
    lines: &'a mut Vec<Line>,
    /// Deepest subdivision of the pass.
    deepest: u32,
}

/// An inconsistency with a square that was finished before.
const BACKTRACK: ControlFlow<()> = ControlFlow::Break(());

/// The contour in one square: one crossing on its side, one added within to check, one on another side.
#[derive(Clone, Copy)]
struct Bend {
    exit: Crossing,
    /// `None` in the smallest squares, which have no sample within.
    middle: Option<Crossing>,
    enter: Crossing,
}

impl<'a, E: Eye> Tracer<'a, E> {
    pub(super) fn new(
        eye: &'a E,
        settings: Settings,
        lattice: &'a mut Lattice,
        lines: &'a mut Vec<Line>,
    ) -> Self {
        lattice.reset(settings.side());
        Self {
            eye,
            settings,
            lattice,
            lines,
            deepest: 0,
        }
    }

    /// Replaces the lines by the contour of what is seen.
    ///
    /// The first-level grid is made twice as dense and the contour traced anew, with the samples there are, as long as squares contradict
    /// finished neighbours or are subdivided twice. In the paper the second rule, and its converse, choose the grid of the *next*
    /// point of a scanline; here a point starts from the coarsest grid each time, so that it does not depend on others.
    pub(super) fn trace(&mut self) {
        let mut cells = self.settings.cells;
        loop {
            self.lines.clear();
            self.deepest = 0;
            let consistent = self.pass(cells).is_continue();
            if cells == self.settings.side() || (consistent && self.deepest < 2) {
                return;
            }
            cells *= 2;
        }
    }

    /// Whether the receiver sees the sample; traced when asked for the first time.
    fn look(&mut self, place: Place) -> bool {
        let slot = self.lattice.slot(place);
        if let Some(seen) = self.lattice.seen[slot] {
            return seen;
        }
        let seen = self.eye.sees(place);
        self.lattice.seen[slot] = Some(seen);
        self.lattice.filled.push(slot);
        seen
    }

    /// All squares of the grid, row by row; stops at an inconsistency.
    fn pass(&mut self, cells: u32) -> ControlFlow<()> {
        let size = self.settings.side() / cells;
        for row in 0..cells {
            for column in 0..cells {
                self.square([column * size, row * size], size, 0, None)?;
            }
        }
        ControlFlow::Continue(())
    }

    /// `threshold` is that of the square it was cut from.
    fn square(
        &mut self,
        [column, row]: Place,
        size: u32,
        depth: u32,
        threshold: Option<f64>,
    ) -> ControlFlow<()> {
        self.deepest = self.deepest.max(depth);
        let corners = [
            [column, row],
            [column + size, row],
            [column + size, row + size],
            [column, row + size],
        ];
        let seen = corners.map(|corner| self.look(corner));
        if (0..4).any(|side| self.is_contradicted(corners[side], corners[(side + 1) % 4])) {
            return self.subdivide(corners, size, depth, threshold);
        }
        let bends = self.bends(corners, seen, size);
        let bends = || bends.iter().flatten();
        let eye = self.eye;
        let strip = |bend: &Bend| bend.strip(eye);
        let own = || self.settings.threshold * bends().map(strip).sum::<f64>();
        let threshold = threshold.unwrap_or_else(own);
        let difference: f64 = bends().map(|bend| bend.difference(eye)).sum();
        if size > 1 && difference > threshold {
            return self.subdivide(corners, size, depth, Some(threshold));
        }
        for bend in bends() {
            let error = bend.difference(eye) + 0.5 * strip(bend);
            bend.add_to(self.lines, error);
        }
        ControlFlow::Continue(())
    }

    /// Four squares for one, unless a new sample contradicts a square that is finished. Those are to the left and below.
    fn subdivide(
        &mut self,
        corners: [Place; 4],
        size: u32,
        depth: u32,
        threshold: Option<f64>,
    ) -> ControlFlow<()> {
        let [column, row] = corners[0];
        let half = size / 2;
        let below = (row > 0).then_some([corners[0], corners[1]]);
        let left = (column > 0).then_some([corners[0], corners[3]]);
        for [from, to] in [below, left].into_iter().flatten() {
            let middle = middle(from, to);
            let is_new = self.lattice.known(middle).is_none();
            let ends = [from, to].map(|end| self.look(end));
            if self.look(middle) != ends[0] && ends[0] == ends[1] && is_new {
                return BACKTRACK;
            }
        }
        let threshold = threshold.map(|threshold| 0.5 * threshold);
        for [right, up] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            let corner = [column + right * half, row + up * half];
            self.square(corner, half, depth + 1, threshold)?;
        }
        ControlFlow::Continue(())
    }

    /// Whether samples that neighbours took on a side say that the contour crosses it oftener than its ends show.
    fn is_contradicted(&self, from: Place, to: Place) -> bool {
        if distance(from, to) < 2 {
            return false;
        }
        let middle = middle(from, to);
        // Sides are only ever sampled by halves.
        let Some(seen) = self.lattice.known(middle) else {
            return false;
        };
        let ends = [from, to].map(|end| self.lattice.known(end));
        (ends[0] == ends[1] && ends[0] != Some(seen))
            || self.is_contradicted(from, middle)
            || self.is_contradicted(middle, to)
    }

    /// The sixteen configurations. Case 1 has no bend, cases 2 and 3 have one, case 4 has two.
    fn bends(&mut self, corners: [Place; 4], seen: [bool; 4], size: u32) -> [Option<Bend>; 2] {
        let has_middle = size > 1;
        let n_seen = seen.iter().filter(|seen| **seen).count();
        if n_seen == 0 || n_seen == 4 {
            return [None; 2];
        }
        if n_seen == 2 && seen[0] == seen[2] {
            return self.two_bends(corners, seen, has_middle);
        }
        // Leaving the visible corners counter-clockwise, and coming back to them.
        let exit = (0..4).position(|k| seen[k] && !seen[(k + 1) % 4]);
        let enter = (0..4).position(|k| !seen[k] && seen[(k + 1) % 4]);
        let (Some(exit), Some(enter)) = (exit, enter) else {
            return [None; 2];
        };
        let diagonal = if n_seen == 2 {
            // Either will do, "chosen at random".
            let [column, row] = corners[0].map(u64::from);
            (math::hash(self.settings.seed, column, row) & 1) as usize
        } else {
            let is_alone = |k: &usize| (n_seen == 1) == seen[*k];
            (0..4).find(is_alone).unwrap_or_default()
        };
        let ends = [corners[diagonal], corners[(diagonal + 2) % 4]];
        let bend = Bend {
            exit: self.dichotomy(corners[exit], corners[(exit + 1) % 4]),
            middle: has_middle.then(|| self.dichotomy(ends[0], ends[1])),
            enter: self.dichotomy(corners[enter], corners[(enter + 1) % 4]),
        };
        [Some(bend), None]
    }

    /// Case 4: the centre says which corners belong together. The smallest squares have none; there the visible ones are kept apart.
    fn two_bends(
        &mut self,
        corners: [Place; 4],
        seen: [bool; 4],
        has_middle: bool,
    ) -> [Option<Bend>; 2] {
        let centre = middle(corners[0], corners[2]);
        let joined = has_middle && self.look(centre);
        let first = usize::from(seen[0] == joined);
        // Around each corner that differs from the centre.
        [first, first + 2].map(|k| {
            let (next, before) = (corners[(k + 1) % 4], corners[(k + 3) % 4]);
            let after = self.dichotomy(corners[k], next);
            let ahead = self.dichotomy(before, corners[k]);
            let (exit, enter) = if joined {
                (ahead, after)
            } else {
                (after, ahead)
            };
            Some(Bend {
                exit,
                middle: has_middle.then(|| self.dichotomy(corners[k], centre)),
                enter,
            })
        })
    }

    /// Narrows an interval with one visible end to one lattice step.
    fn dichotomy(&mut self, mut from: Place, mut to: Place) -> Crossing {
        let seen = self.look(from);
        while distance(from, to) > 1 {
            let middle = middle(from, to);
            if self.look(middle) == seen {
                from = middle;
            } else {
                to = middle;
            }
        }
        Crossing {
            at: 0.5 * (position(from) + position(to)),
            hidden: if seen { to } else { from },
        }
    }
}

impl Bend {
    /// Form factor of what lies between the simple contour's extremes when its ends move through the intervals they are known to be in:
    /// the paper's strip of the width of an interval. As an area of the lattice it does not depend on how stretched the light is.
    fn strip(&self, eye: &impl Eye) -> f64 {
        let (exit, enter) = (self.exit, self.enter);
        let chord = enter.at - exit.at;
        let half_swept = |end: Crossing| chord.perp_dot(end.at - position(end.hidden)).abs();
        eye.element(
            0.5 * (exit.at + enter.at),
            half_swept(exit) + half_swept(enter),
        )
    }

    /// Form factor of what the middle crossing adds or takes away.
    fn difference(&self, eye: &impl Eye) -> f64 {
        self.middle.map_or(0.0, |middle| {
            eye.triangle([self.exit.at, middle.at, self.enter.at])
        })
    }

    fn add_to(&self, lines: &mut Vec<Line>, error: f64) {
        if let Some(middle) = self.middle {
            let error = 0.5 * error;
            for ends in [[self.exit, middle], [middle, self.enter]] {
                lines.push(Line { ends, error });
            }
        } else {
            let ends = [self.exit, self.enter];
            lines.push(Line { ends, error });
        }
    }
}

pub(super) fn position(place: Place) -> DVec2 {
    DVec2::new(f64::from(place[0]), f64::from(place[1]))
}

/// Steps along the longer axis; intervals run along an axis or a diagonal.
fn distance(a: Place, b: Place) -> u32 {
    a[0].abs_diff(b[0]).max(a[1].abs_diff(b[1]))
}

fn middle(a: Place, b: Place) -> Place {
    [a[0].midpoint(b[0]), a[1].midpoint(b[1])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::vedel::border::{Traced, for_each_inner_part};

    /// Sees where a field is positive that is given at the corners of a square of `side` steps and bilinear in between. Form factors are areas.
    struct Field {
        side: f64,
        corners: [f64; 4],
    }

    impl Field {
        fn value(&self, x: f64, y: f64) -> f64 {
            let [a, b, c, d] = self.corners;
            (a * (1.0 - x) + b * x) * (1.0 - y) + (d * (1.0 - x) + c * x) * y
        }

        fn area(&self) -> f64 {
            let n = 512;
            let at = |k: u32| (f64::from(k) + 0.5) / f64::from(n);
            let n_seen = (0..n * n)
                .filter(|index| self.value(at(index % n), at(index / n)) > 0.0)
                .count();
            n_seen as f64 / f64::from(n * n)
        }
    }

    impl Eye for Field {
        fn sees(&self, place: Place) -> bool {
            let [x, y] = place.map(|k| f64::from(k) / self.side);
            self.value(x, y) > 0.0
        }

        fn triangle(&self, [a, b, c]: [DVec2; 3]) -> f64 {
            0.5 * (b - a).perp_dot(c - a).abs()
        }

        fn element(&self, _place: DVec2, area: f64) -> f64 {
            area
        }
    }

    fn settings(cells: u32, steps: u32, threshold: f64) -> Settings {
        Settings {
            cells,
            steps,
            threshold,
            seed: 3,
        }
    }

    /// Visible area of a unit square by its contour, counter-clockwise; its claimed error; samples.
    fn traced_area(eye: &impl Eye, settings: Settings) -> (f64, f64, usize) {
        let (mut lattice, mut lines) = (Lattice::default(), Vec::new());
        Tracer::new(eye, settings, &mut lattice, &mut lines).trace();
        let side = f64::from(settings.side());
        let corners = [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]].map(DVec2::from_array);
        let border: Vec<_> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        let traced = Traced::new(&lines, side, lattice.origin());
        let (mut area, mut error) = (0.0, 0.0);
        let mut add = |[from, to]: [DVec2; 2], start: f64, end: f64| {
            let at = |t: f64| from + t * (to - from);
            area += 0.5 * at(start).perp_dot(at(end));
        };
        for line in &lines {
            let ends = line.ends.map(|end| end.at);
            error += line.error;
            for_each_inner_part(ends, &border, |start, end| add(ends, start, end));
        }
        for &piece in &border {
            traced.for_each_visible_part(piece, |start, end| add(piece, start, end));
        }
        let scale = side * side;
        (area / scale, error / scale, lattice.n_filled())
    }

    #[test]
    fn all_sixteen_configurations_enclose_what_is_seen() {
        for pattern in 0..16u64 {
            for case in 0..40 {
                let corners = [0, 1, 2, 3].map(|k| {
                    let [size, _] = math::unit_pair(math::hash(pattern, case, k));
                    let sign = if pattern >> k & 1 == 1 { 1.0 } else { -1.0 };
                    sign * (0.1 + size)
                });
                // One square as it is, which turns a hyperbola into two bends; subdivided down to the lattice; from a dense grid.
                for (cells, steps, threshold, tolerance) in
                    [(1, 5, 1e9, 0.2), (1, 6, 0.0, 0.04), (16, 2, 1.0, 0.04)]
                {
                    let settings = settings(cells, steps, threshold);
                    let side = f64::from(settings.side());
                    let field = Field { side, corners };
                    let want = field.area();
                    let (got, error, _) = traced_area(&field, settings);
                    assert!(
                        (got - want).abs() < tolerance,
                        "pattern {pattern:04b} case {case}, {cells} cells: {got} not {want}"
                    );
                    // A single square does not know what it does not look at.
                    assert!(
                        cells == 1 && threshold > 1.0 || (got - want).abs() <= 3.0 * error + 1e-3,
                        "pattern {pattern:04b} case {case}: {got} not {want}, claims {error}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_straight_shadow_edge_costs_two_crossings_and_one_check() {
        let field = Field {
            side: 32.0,
            corners: [-0.4, 0.6, 0.6, -0.4],
        };
        let (area, _, n_samples) = traced_area(&field, settings(1, 5, 1.0));
        assert!((area - 0.6).abs() < 1.0 / 64.0, "area {area}");
        assert_eq!(n_samples, 4 + 3 * 5);
    }

    /// Hides a disc.
    struct Disc {
        centre: DVec2,
        radius: f64,
    }

    impl Eye for Disc {
        fn sees(&self, place: Place) -> bool {
            position(place).distance(self.centre) > self.radius
        }

        fn triangle(&self, [a, b, c]: [DVec2; 3]) -> f64 {
            0.5 * (b - a).perp_dot(c - a).abs()
        }

        fn element(&self, _place: DVec2, area: f64) -> f64 {
            area
        }
    }

    #[test]
    fn no_sample_is_taken_twice_however_often_the_grid_is_refined() {
        /// Hides every other sample: the worst there is.
        struct Checkers(std::cell::RefCell<Vec<Place>>);

        impl Eye for Checkers {
            fn sees(&self, place: Place) -> bool {
                self.0.borrow_mut().push(place);
                (place[0] + place[1]).is_multiple_of(2)
            }

            fn triangle(&self, _corners: [DVec2; 3]) -> f64 {
                1.0
            }

            fn element(&self, _place: DVec2, _area: f64) -> f64 {
                0.1
            }
        }

        let eye = Checkers(std::cell::RefCell::default());
        let (_, _, n_samples) = traced_area(&eye, settings(2, 3, 1.0));
        let mut asked = eye.0.into_inner();
        asked.sort_unstable();
        let n_asked = asked.len();
        asked.dedup();
        assert_eq!((n_asked, n_samples), (asked.len(), asked.len()));
        assert!(n_asked <= 17 * 17);
    }

    #[test]
    fn a_disc_across_squares_is_consistent_and_converges() {
        for case in 0..100 {
            let [x, y] = math::unit_pair(math::hash(case, 8, 0));
            let [size, _] = math::unit_pair(math::hash(case, 8, 1));
            let mut errors = Vec::new();
            for cells in [4, 16] {
                let settings = settings(cells, 4, 1.0);
                let side = f64::from(settings.side());
                let disc = Disc {
                    centre: side * DVec2::new(0.4 + 0.2 * x, 0.4 + 0.2 * y),
                    radius: side * (0.2 + 0.15 * size),
                };
                let want = 1.0 - std::f64::consts::PI * (disc.radius / side).powi(2);
                let (got, claimed, _) = traced_area(&disc, settings);
                errors.push((got - want).abs());
                assert!(
                    (got - want).abs() <= 3.0 * claimed,
                    "case {case}: {got} not {want}"
                );
            }
            assert!(
                errors[0] < 0.02 && errors[1] < 0.004,
                "case {case}: {errors:?}"
            );
        }
    }
}

//! Where values are wanted: points that belong to the cells of a grid, and which of them hang together.

use glam::DVec2;
use rayon::prelude::*;

use crate::error::{Error, Result};

/// A place where the value is wanted, and where it can be evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Column and row in the grid. One point per cell.
    pub cell: [u16; 2],
    /// Where it lies, in cells: near its cell, not necessarily in its middle.
    pub place: DVec2,
    /// Whether the quantity goes on without a crease to the cell on the right and to the one below, if there are points there.
    pub joined: [bool; 2],
    /// Largest distance in cells between the points around here that are evaluated first. At least 1.
    pub spacing: u16,
}

/// Points of one surface.
#[derive(Clone, Debug, Default)]
pub struct Domain {
    points: Vec<Point>,
    /// Smallest column and row.
    origin: [i32; 2],
    /// Per row: its first column, and where its cells start in `cells`.
    rows: Vec<(i32, usize)>,
    /// Index of the point per cell, row after row, or [`NONE`].
    cells: Vec<u32>,
}

/// No point.
const NONE: u32 = u32::MAX;

/// Cells that rows may span: 2³⁰ take 4 GB, as much as a page of 16384² that is one chart needs four times over.
const MAX_CELLS: usize = 1 << 30;

/// Twice the area in cells below which a square is no piece of surface: where the border of a surface runs along the middles of cells,
/// the outer points lie as good as on the inner ones.
const MIN_AREA: f64 = 1e-6;

impl Domain {
    /// Of two points in one cell the later one has it; the other belongs to nothing.
    ///
    /// # Errors
    /// `TooLarge` when the rows span more than 2³⁰ cells.
    pub fn new(points: Vec<Point>) -> Result<Self> {
        let low = |k: usize| points.iter().map(|p| i32::from(p.cell[k])).min();
        let (Some(left), Some(top)) = (low(0), low(1)) else {
            return Ok(Self::default());
        };
        let n_rows = points
            .iter()
            .map(|point| i32::from(point.cell[1]) - top + 1)
            .max()
            .unwrap_or(0) as usize;
        let mut spans = vec![(i32::MAX, i32::MIN); n_rows];
        for point in &points {
            let column = i32::from(point.cell[0]);
            let span = &mut spans[(i32::from(point.cell[1]) - top) as usize];
            *span = (span.0.min(column), span.1.max(column));
        }
        let mut rows = Vec::with_capacity(n_rows + 1);
        let mut n_cells = 0;
        for (first, last) in spans {
            rows.push((first, n_cells));
            n_cells += (i64::from(last) - i64::from(first) + 1).max(0) as usize;
        }
        rows.push((0, n_cells));
        if n_cells > MAX_CELLS || points.len() >= NONE as usize {
            return Err(Error::TooLarge {
                reason: format!("a surface of {n_cells} cells is too large to refine"),
            });
        }
        let mut cells = vec![NONE; n_cells];
        for (index, point) in points.iter().enumerate() {
            let (first, start) = rows[(i32::from(point.cell[1]) - top) as usize];
            cells[start + (i32::from(point.cell[0]) - first) as usize] = index as u32;
        }
        Ok(Self {
            points,
            origin: [left, top],
            rows,
            cells,
        })
    }

    /// Asks of all pairs of neighbours whether the quantity goes on without a crease from one to the other. `joined` gets the indices of
    /// both, the left or upper one first.
    #[must_use]
    pub fn joined_where(mut self, joined: impl Fn(usize, usize) -> bool) -> Self {
        for point in 0..self.points.len() {
            let [x, y] = self.points[point].cell.map(i32::from);
            let next = [self.at([x + 1, y]), self.at([x, y + 1])];
            self.points[point].joined =
                next.map(|next| next.is_some_and(|next| joined(point, next)));
        }
        self
    }

    /// Sets [`Point::spacing`] square by square of `side` cells; `spacing` gets the points of a square that has any, row after row, and gives
    /// a number for each.
    #[must_use]
    pub fn spaced_by(mut self, side: u16, spacing: impl Fn(&[usize]) -> Vec<u16> + Sync) -> Self {
        let square = |point: usize| {
            let [x, y] = self.offset(point);
            let side = i32::from(side.max(1));
            (y / side, x / side)
        };
        let mut points: Vec<usize> = (0..self.points.len()).collect();
        points.sort_by_key(|&point| square(point));
        let squares: Vec<&[usize]> = points.chunk_by(|&a, &b| square(a) == square(b)).collect();
        let found: Vec<Vec<u16>> = squares.par_iter().map(|points| spacing(points)).collect();
        for (points, spacings) in squares.iter().zip(found) {
            for (&point, spacing) in points.iter().zip(spacings) {
                self.points[point].spacing = spacing;
            }
        }
        self
    }

    /// In the order given.
    #[must_use]
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// The point of a cell.
    #[must_use]
    pub fn at(&self, [x, y]: [i32; 2]) -> Option<usize> {
        let row = y - self.origin[1];
        if row < 0 || row as usize + 1 >= self.rows.len() {
            return None;
        }
        let (first, start) = self.rows[row as usize];
        let end = self.rows[row as usize + 1].1;
        if x < first {
            return None;
        }
        let index = start + (x - first) as usize;
        (index < end)
            .then(|| self.cells[index])
            .filter(|&point| point != NONE)
            .map(|point| point as usize)
    }

    /// All cells of a rectangle that have points: indices of the points, row after row.
    pub(super) fn within(&self, low: [i32; 2], high: [i32; 2]) -> impl Iterator<Item = usize> {
        let top = self.origin[1];
        let last = top + self.rows.len() as i32 - 2;
        (low[1].max(top)..=high[1].min(last)).flat_map(move |y| {
            let (first, start) = self.rows[(y - top) as usize];
            let end = self.rows[(y - top) as usize + 1].1;
            let from = (low[0] - first).max(0) as usize;
            let to = ((high[0] - first + 1).max(0) as usize).min(end - start);
            self.cells[start + from.min(to)..start + to]
                .iter()
                .filter(|&&point| point != NONE)
                .map(|&point| point as usize)
        })
    }

    /// The position of a point's cell from the upper left one, for patterns that do not depend on where a surface lies.
    pub(super) fn offset(&self, point: usize) -> [i32; 2] {
        let [x, y] = self.points[point].cell;
        [i32::from(x) - self.origin[0], i32::from(y) - self.origin[1]]
    }

    /// Which corners of the square right of and below a cell hang together: bit k for corner k, clockwise from the upper left one, as rows
    /// go down. All four, three of them, or none.
    pub(super) fn square(&self, [x, y]: [i32; 2]) -> u8 {
        let corners = [
            self.at([x, y]),
            self.at([x + 1, y]),
            self.at([x + 1, y + 1]),
            self.at([x, y + 1]),
        ];
        let holds = |from: Option<usize>, to: Option<usize>, direction: usize| {
            from.is_some_and(|from| self.points[from].joined[direction]) && to.is_some()
        };
        let [a, b, c, d] = corners;
        let sides = [
            holds(a, b, 0),
            holds(b, c, 1),
            holds(d, c, 0),
            holds(a, d, 1),
        ];
        let held = match sides.iter().filter(|&&side| side).count() {
            4 => 0b1111,
            // Two sides in a row hold three corners; the one opposite of theirs is missing. Three sides: a crease ends here.
            2 => match (0..4).find(|&k| sides[k] && sides[(k + 1) % 4]) {
                Some(k) => 0b1111 & !(1 << ((k + 3) % 4)),
                None => 0,
            },
            _ => 0,
        };
        let mut places = (0..4)
            .filter(|k| held & (1 << k) != 0)
            .filter_map(|k| corners[k])
            .map(|point| self.points[point].place);
        let Some(first) = places.next() else { return 0 };
        let mut area = 0.0;
        let mut last = None;
        for place in places {
            if let Some(last) = last.replace(place) {
                let last: DVec2 = last;
                area += (last - first).perp_dot(place - first);
            }
        }
        // Points that were moved to the border of their surface may have changed places.
        if area > MIN_AREA { held } else { 0 }
    }

    /// First row and column, and rows and columns in all.
    pub(super) fn extent(&self) -> ([i32; 2], [usize; 2]) {
        let n_rows = self.rows.len().saturating_sub(1);
        let right = (0..n_rows)
            .map(|row| self.rows[row].0 as i64 + (self.rows[row + 1].1 - self.rows[row].1) as i64)
            .filter(|&end| end < i64::from(i32::MAX))
            .max()
            .unwrap_or_default();
        let width = (right - i64::from(self.origin[0])).max(0) as usize;
        (self.origin, [width, n_rows])
    }
}

//! Places the charts of one mesh beside each other, so that no texel is read on two of them and the padding stays free.
//!
//! Each chart is known by its outline: for each column the first and the last row that it reads. Charts come largest first and sink onto
//! the skyline of those before, in the turn and at the column where the skyline stays lowest.
//!
//! Source: Lévy, Petitjean, Ray and Maillot, "Least squares conformal maps for automatic texture atlas generation", SIGGRAPH 2002,
//! section 4 (the "Tetris" packing). Deviation: outlines are of texels that are read, not of polygons, and charts may be turned.

use std::ops::Range;

use glam::DVec2;

use super::chart::Chart;
use super::footprint::each_covered;

/// Where a chart lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Seat {
    /// Page of this mesh.
    pub(super) page: usize,
    /// What is done to the chart before it is moved.
    pub(super) turn: Turn,
    /// Where its first texel goes.
    pub(super) offset: [i32; 2],
}

/// One of four turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Turn {
    /// Rows become columns. Applied first.
    pub(super) transposed: bool,
    /// Upside down and left to right.
    pub(super) half: bool,
}

impl Turn {
    const ALL: [Self; 4] = [
        Self {
            transposed: false,
            half: false,
        },
        Self {
            transposed: true,
            half: false,
        },
        Self {
            transposed: false,
            half: true,
        },
        Self {
            transposed: true,
            half: true,
        },
    ];

    /// Turns a point of a chart that reads `size` texels.
    pub(super) fn apply(self, point: DVec2, size: [i32; 2]) -> DVec2 {
        let (point, size) = if self.transposed {
            (DVec2::new(point.y, point.x), [size[1], size[0]])
        } else {
            (point, size)
        };
        if self.half {
            DVec2::from_array(size.map(f64::from)) - point
        } else {
            point
        }
    }
}

/// The texels that a chart reads, without what its outline encloses.
#[derive(Clone, Debug)]
pub(super) struct Outline {
    /// Columns and rows.
    pub(super) size: [i32; 2],
    /// Rows read in each column, and columns in each row, widened by the margin and counted from there.
    spans: [Vec<Range<i32>>; 2],
}

impl Outline {
    /// Of an aligned chart; `margin` texels around those read stay free.
    pub(super) fn new(chart: &Chart, margin: u32) -> Self {
        let extent = chart.extent();
        // An aligned chart starts at 0.5 and reads the texels of its footprint.
        let size = [extent.x, extent.y].map(|side| side.ceil() as i32 + 1);
        let mut spans = size.map(|side| vec![EMPTY; side as usize]);
        for &corners in &chart.corners {
            each_covered(corners, |x, y| {
                for (axis, (at, along)) in [(x, y), (y, x)].into_iter().enumerate() {
                    let span = &mut spans[axis][at as usize];
                    *span = span.start.min(along)..span.end.max(along + 1);
                }
            });
        }
        Self {
            size,
            spans: spans.map(|spans| widen(&spans, margin as usize)),
        }
    }

    /// Columns and rows with margins, turned.
    fn turned_size(&self, turn: Turn) -> [i32; 2] {
        let [columns, rows] = [0, 1].map(|axis| self.spans[axis].len() as i32);
        if turn.transposed {
            [rows, columns]
        } else {
            [columns, rows]
        }
    }

    /// Rows of each column, turned.
    fn columns(&self, turn: Turn) -> Vec<Range<i32>> {
        let spans = &self.spans[usize::from(turn.transposed)];
        if !turn.half {
            return spans.clone();
        }
        let height = self.turned_size(turn)[1];
        spans
            .iter()
            .rev()
            .map(|span| {
                if span.is_empty() {
                    EMPTY
                } else {
                    height - span.end..height - span.start
                }
            })
            .collect()
    }
}

/// A column that is not read.
#[expect(clippy::reversed_empty_ranges, reason = "folds over spans start here")]
const EMPTY: Range<i32> = i32::MAX..i32::MIN;

/// Grows spans by `margin` on all sides.
fn widen(spans: &[Range<i32>], margin: usize) -> Vec<Range<i32>> {
    (0..spans.len() + 2 * margin)
        .map(|at| {
            let near = at.saturating_sub(2 * margin)..(at + 1).min(spans.len());
            spans[near]
                .iter()
                .filter(|span| !span.is_empty())
                .fold(EMPTY, |wide, span| {
                    wide.start.min(span.start)..wide.end.max(span.end + 2 * margin as i32)
                })
        })
        .collect()
}

/// Seats all charts, none of which is larger than `room` texels with its margins, on pages of that size; as few as it finds, a small one if
/// one is enough.
pub(super) fn seats(outlines: &[Outline], room: i32) -> Vec<Seat> {
    let mut order: Vec<usize> = (0..outlines.len()).collect();
    order.sort_by_key(|&index| {
        let [width, height] = outlines[index].turned_size(Turn::default());
        let (long, short) = (width.max(height), width.min(height));
        (std::cmp::Reverse((long, short)), index)
    });
    let area: f64 = outlines
        .iter()
        .map(|outline| {
            let read: i64 = outline.spans[0]
                .iter()
                .map(|span| i64::from((span.end - span.start).max(0)))
                .sum();
            read as f64
        })
        .sum();
    let narrowest = outlines
        .iter()
        .map(|outline| outline.turned_size(Turn::default()))
        .map(|[width, height]| width.min(height))
        .max()
        .unwrap_or(0);
    let mut best: Option<(i64, Vec<Seat>)> = None;
    // A mesh of many charts packs alike at any width; one of few charts may fit one width much better than another.
    let widths: &[f64] = if outlines.len() <= FEW {
        &[0.7, 0.85, 1.0, 1.1, 1.2, 1.35, 1.5, 2.0]
    } else {
        &[1.1]
    };
    for factor in widths {
        let width = ((area.sqrt() * factor).ceil() as i32).max(narrowest);
        if width > room {
            break;
        }
        let Some(seats) = sit(outlines, &order, width, room, 1) else {
            continue;
        };
        let [width, height] = used(outlines, &seats);
        let size = i64::from(width) * i64::from(height);
        if best.as_ref().is_none_or(|(smallest, _)| size < *smallest) {
            best = Some((size, seats));
        }
    }
    best.map(|(_, seats)| seats)
        .or_else(|| sit(outlines, &order, room, room, usize::MAX))
        .expect("charts are cut to fit a page")
}

/// Charts up to which several widths are tried: 500 charts take some 10 ms per width.
const FEW: usize = 500;

/// Columns and rows that the charts of a single page take.
fn used(outlines: &[Outline], seats: &[Seat]) -> [i32; 2] {
    let mut used = [0; 2];
    for (outline, seat) in outlines.iter().zip(seats) {
        let size = outline.turned_size(seat.turn);
        for axis in 0..2 {
            used[axis] = used[axis].max(seat.offset[axis] + size[axis]);
        }
    }
    used
}

/// Seats charts in `order` on pages of `width` × `height`; `None` when more than `max_pages` are needed, or a chart is too large for any.
fn sit(
    outlines: &[Outline],
    order: &[usize],
    width: i32,
    height: i32,
    max_pages: usize,
) -> Option<Vec<Seat>> {
    let mut pages: Vec<Vec<i32>> = Vec::new();
    let mut seats = vec![Seat::default(); outlines.len()];
    for &index in order {
        let outline = &outlines[index];
        let turned: Vec<(Turn, Vec<Range<i32>>)> = Turn::ALL
            .iter()
            .map(|&turn| (turn, outline.columns(turn)))
            .collect();
        let mut page = 0;
        loop {
            if page == pages.len() {
                // A chart that does not even fit an empty page fits none.
                if page == max_pages
                    || pages
                        .last()
                        .is_some_and(|last| last.iter().all(|&y| y == 0))
                {
                    return None;
                }
                pages.push(vec![0; width as usize]);
            }
            let found = turned
                .iter()
                .filter_map(|(turn, columns)| {
                    let rows = outline.turned_size(*turn)[1];
                    let (score, offset) = lowest(&pages[page], columns, rows, height)?;
                    Some((score, offset, turn, columns))
                })
                // The first of equals stays.
                .min_by_key(|(score, ..)| *score);
            if let Some((_, offset, turn, columns)) = found {
                for (column, span) in columns.iter().enumerate() {
                    let skyline = &mut pages[page][offset[0] as usize + column];
                    *skyline = (*skyline).max(offset[1].saturating_add(span.end));
                }
                seats[index] = Seat {
                    page,
                    turn: *turn,
                    offset,
                };
                break;
            }
            page += 1;
        }
    }
    Some(seats)
}

/// The offset at which a chart's top is lowest above `skyline`, then wastes least below it; with (top, waste). `None` when its top would
/// be above `height` everywhere.
fn lowest(
    skyline: &[i32],
    columns: &[Range<i32>],
    rows: i32,
    height: i32,
) -> Option<((i32, i64), [i32; 2])> {
    let mut best: Option<((i32, i64), [i32; 2])> = None;
    let mut limit = height - rows;
    for x in 0..(skyline.len() + 1).saturating_sub(columns.len()) {
        let below = &skyline[x..x + columns.len()];
        let mut y = 0;
        for (sky, span) in below.iter().zip(columns) {
            // An empty column starts at MAX and stands on nothing.
            y = y.max(sky.saturating_sub(span.start));
            if y > limit {
                break;
            }
        }
        if y > limit {
            continue;
        }
        let waste = below
            .iter()
            .zip(columns)
            .filter(|(_, span)| !span.is_empty())
            .map(|(sky, span)| i64::from(y + span.start - sky))
            .sum();
        let score = (y + rows, waste);
        if best.is_none_or(|(lowest, _)| score < lowest) {
            best = Some((score, [x as i32, y]));
            limit = y;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_keep_the_outline_on_its_texels() {
        // A triangle that reads 4 × 3 texels: every turn of its corners reads the turned outline.
        let corners = [
            DVec2::new(0.5, 0.5),
            DVec2::new(3.5, 0.5),
            DVec2::new(0.5, 2.5),
        ];
        let chart = Chart {
            triangles: vec![0],
            corners: vec![corners],
        };
        let outline = Outline::new(&chart, 0);
        assert_eq!(outline.size, [4, 3]);
        for turn in Turn::ALL {
            let turned = Chart {
                triangles: vec![0],
                corners: vec![corners.map(|corner| turn.apply(corner, outline.size))],
            };
            assert_eq!(
                Outline::new(&turned, 0).spans[0],
                outline.columns(turn),
                "{turn:?}"
            );
        }
    }

    #[test]
    fn outlines_are_widened_on_all_sides() {
        let spans = [2..4, 3..5];
        assert_eq!(widen(&spans, 1), [2..6, 2..7, 2..7, 3..7]);
    }

    #[test]
    fn squares_fill_a_square() {
        let square = |side: f64| Chart {
            triangles: vec![0, 1],
            corners: {
                let at = |x: f64, y: f64| DVec2::new(0.5 + x * side, 0.5 + y * side);
                vec![
                    [at(0., 0.), at(1., 0.), at(1., 1.)],
                    [at(0., 0.), at(1., 1.), at(0., 1.)],
                ]
            },
        };
        // Sixteen squares of 8 × 8 texels.
        let outlines = vec![Outline::new(&square(7.0), 0); 16];
        let seats = seats(&outlines, 64);
        assert!(seats.iter().all(|seat| seat.page == 0));
        let [width, height] = used(&outlines, &seats);
        assert_eq!(width * height, 16 * 64);
        // The same with room for four of them only.
        let seats = super::seats(&outlines, 16);
        assert_eq!(seats.iter().map(|seat| seat.page).max(), Some(3));
    }
}

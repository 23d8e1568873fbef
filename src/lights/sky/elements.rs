//! What is handed out to the nearest direction: patches of the sphere with their light, in compact chunks.
//!
//! [`Pixels`] are the picture itself; results come from them alone. [`Cut`] is a coarser stand-in for the thousands of relaxations on the
//! way: nodes of a quadtree over the picture, as large as the number of directions so far allows, each with its exact light and first
//! moment. Only where a node lies across the border of two cells does it differ from its pixels.
//!
//! In both, a pixel that holds more light than a small part of a cell's share is cut into pieces. So even a sun of one pixel can be shared
//! by hundreds of directions.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use super::grid::{Grid, Patch, norm};

/// Elements per direction, at least. Fewer: cells become ragged at the size of elements, and directions are placed by accident. More: the
/// way to the final relaxation becomes as slow as that one.
const PER_DIRECTION: f64 = 64.0;

/// Most elements per chunk of a [`Cut`]. Fewer: finding the directions near a chunk dominates. More: chunks are wide, and each of their elements
/// is compared with many directions.
const CHUNK: usize = 64;

/// Side of a tile of [`Pixels`], for the same reasons.
const TILE: u32 = 32;

/// Most nodes in the finest level of the quadtree, for its memory: 32 bytes each and a third more. Larger pictures start it at blocks of
/// 2 × 2 or 4 × 4 pixels, and take heavier blocks apart when they are met.
const MAX_NODES: u64 = 1 << 21;

/// Patches in chunks that are small on the sphere.
pub(super) trait Elements: Sync {
    fn n_chunks(&self) -> usize;

    /// A cap that holds all directions of a chunk: unit centre and radius.
    fn cap(&self, chunk: usize) -> (DVec3, f64);

    /// Calls `visit` with direction, ∫ ‖L‖ dω and ∫ ‖L‖ ω dω of each element that shines.
    fn visit(&self, chunk: usize, visit: impl FnMut(DVec3, f64, DVec3));
}

/// Most light in an element for `n` directions.
fn limit(grid: &Grid<'_>, n: usize) -> f64 {
    grid.weight() / (PER_DIRECTION * n as f64)
}

/// Into how many pieces along each side a pixel of `weight` is cut.
fn pieces(weight: f64, limit: f64) -> u32 {
    if weight <= limit {
        return 1;
    }
    // At most 2 √(64 · 4096) even when all light is in one pixel.
    (((weight / limit).sqrt().ceil()) as u32).next_power_of_two()
}

/// The pixels of a picture in square tiles.
#[derive(Debug)]
pub(super) struct Pixels<'a> {
    grid: &'a Grid<'a>,
    limit: f64,
    n_columns: u32,
    n_rows: u32,
}

impl<'a> Pixels<'a> {
    /// Fine enough for `n` directions.
    pub(super) fn new(grid: &'a Grid<'a>, n: usize) -> Self {
        Self {
            grid,
            limit: limit(grid, n),
            n_columns: grid.image.width().div_ceil(TILE),
            n_rows: grid.image.height().div_ceil(TILE),
        }
    }

    /// Columns and rows of a tile, each as start and end.
    fn tile(&self, chunk: usize) -> ([u32; 2], [u32; 2]) {
        let column = chunk as u32 % self.n_columns * TILE;
        let row = chunk as u32 / self.n_columns * TILE;
        let image = self.grid.image;
        (
            [column, (column + TILE).min(image.width())],
            [row, (row + TILE).min(image.height())],
        )
    }

    /// Calls `visit` with every patch of a chunk, dark ones too, and its radiance.
    pub(super) fn patches(&self, chunk: usize, mut visit: impl FnMut(&Patch, &[f32; 3])) {
        let (columns, rows) = self.tile(chunk);
        for row in rows[0]..rows[1] {
            let pixels = self.grid.image.row(row);
            for column in columns[0]..columns[1] {
                let radiance = &pixels[column as usize];
                let patch = self.grid.patch(column, row);
                match pieces(norm(radiance) * patch.solid_angle, self.limit) {
                    1 => visit(&patch, radiance),
                    n => {
                        for piece in self.grid.pieces(column, row, n) {
                            visit(&piece, radiance);
                        }
                    }
                }
            }
        }
    }
}

impl Elements for Pixels<'_> {
    fn n_chunks(&self) -> usize {
        self.n_columns as usize * self.n_rows as usize
    }

    fn cap(&self, chunk: usize) -> (DVec3, f64) {
        let (columns, rows) = self.tile(chunk);
        self.grid.cap(columns, rows)
    }

    fn visit(&self, chunk: usize, mut visit: impl FnMut(DVec3, f64, DVec3)) {
        self.patches(chunk, |patch, radiance| {
            let norm = norm(radiance);
            if norm > 0.0 {
                visit(
                    patch.direction,
                    norm * patch.solid_angle,
                    norm * patch.moment,
                );
            }
        });
    }
}

/// Light of a block of pixels.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    weight: f64,
    moment: DVec3,
}

impl Node {
    fn add(&mut self, other: Self) {
        self.weight += other.weight;
        self.moment += other.moment;
    }
}

/// A quadtree over a picture.
#[derive(Debug)]
pub(super) struct Pyramid<'a> {
    grid: &'a Grid<'a>,
    /// A block of the finest level has `1 << base` pixels along each side.
    base: u32,
    /// Finest first; the last one has a single node.
    levels: Vec<Level>,
}

#[derive(Debug)]
struct Level {
    width: u32,
    height: u32,
    nodes: Vec<Node>,
}

impl<'a> Pyramid<'a> {
    pub(super) fn new(grid: &'a Grid<'a>) -> Self {
        let (width, height) = (grid.image.width(), grid.image.height());
        let blocks = |base: u32| (width.div_ceil(1 << base), height.div_ceil(1 << base));
        let mut base = 0;
        while u64::from(blocks(base).0) * u64::from(blocks(base).1) > MAX_NODES {
            base += 1;
        }
        let mut levels = vec![Level::finest(grid, base, blocks(base))];
        while let Some(level) = levels.last()
            && level.nodes.len() > 1
        {
            let next = level.coarser();
            levels.push(next);
        }
        Self { grid, base, levels }
    }

    /// Elements for `n` directions: none with more light or wider than a small part of an even share of both.
    pub(super) fn cut(&self, n: usize) -> Cut {
        let mut cut = Cut::default();
        let limits = [limit(self.grid, n), 4.0 * PI / (PER_DIRECTION * n as f64)];
        self.refine(self.levels.len() - 1, 0, 0, limits, &mut cut);
        let ends = cut.starts.iter().skip(1).copied();
        cut.caps = (cut.starts.iter().copied())
            .zip(ends.chain([cut.elements.len()]))
            .map(|(start, end)| cap(&cut.elements[start..end]))
            .collect();
        cut
    }

    fn refine(&self, level: usize, x: u32, y: u32, limits: [f64; 2], cut: &mut Cut) {
        let Level {
            width,
            height,
            ref nodes,
        } = self.levels[level];
        if x >= width || y >= height {
            return;
        }
        let node = nodes[y as usize * width as usize + x as usize];
        if node.weight == 0.0 {
            return;
        }
        let side = 1_u32 << (self.base + level as u32);
        let image = self.grid.image;
        let columns = [x * side, ((x + 1) * side).min(image.width())];
        let rows = [y * side, ((y + 1) * side).min(image.height())];
        // The patch in its middle stands for all of them.
        let middle = self.grid.patch(
            columns[0].midpoint(columns[1] - 1),
            rows[0].midpoint(rows[1] - 1),
        );
        let n_pixels = f64::from(columns[1] - columns[0]) * f64::from(rows[1] - rows[0]);
        let is_wide = middle.solid_angle * n_pixels > limits[1];
        let direction = node.moment.normalize_or_zero();
        if node.weight <= limits[0] && (level == 0 || !is_wide) && direction != DVec3::ZERO {
            cut.starts.push(cut.elements.len());
            cut.elements.push(Element {
                direction,
                weight: node.weight,
                moment: node.moment,
            });
        } else if level > 0 {
            let (n_chunks, start) = (cut.starts.len(), cut.elements.len());
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                self.refine(level - 1, 2 * x + dx, 2 * y + dy, limits, cut);
            }
            // A chunk is a node, so that it does not reach from a lamp far into the dark.
            if (1..=CHUNK).contains(&(cut.elements.len() - start)) {
                cut.starts.truncate(n_chunks);
                cut.starts.push(start);
            }
        } else {
            self.take_apart(columns, rows, limits[0], cut);
        }
    }

    fn take_apart(&self, columns: [u32; 2], rows: [u32; 2], limit: f64, cut: &mut Cut) {
        for row in rows[0]..rows[1] {
            for column in columns[0]..columns[1] {
                let norm = norm(&self.grid.image.row(row)[column as usize]);
                if norm == 0.0 {
                    continue;
                }
                let n = pieces(norm * self.grid.patch(column, row).solid_angle, limit);
                let start = cut.elements.len();
                let pieces = self.grid.pieces(column, row, n).map(|piece| Element {
                    direction: piece.direction,
                    weight: norm * piece.solid_angle,
                    moment: norm * piece.moment,
                });
                cut.elements.extend(pieces);
                cut.starts
                    .extend((start..cut.elements.len()).step_by(CHUNK));
            }
        }
    }
}

impl Level {
    fn finest(grid: &Grid<'_>, base: u32, (width, height): (u32, u32)) -> Self {
        let image = grid.image;
        let nodes = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                let mut nodes = vec![Node::default(); width as usize];
                for row in y << base..((y + 1) << base).min(image.height()) {
                    for (column, pixel) in (0..).zip(image.row(row)) {
                        let patch = grid.patch(column, row);
                        let norm = norm(pixel);
                        nodes[(column >> base) as usize].add(Node {
                            weight: norm * patch.solid_angle,
                            moment: norm * patch.moment,
                        });
                    }
                }
                nodes
            })
            .collect();
        Self {
            width,
            height,
            nodes,
        }
    }

    /// Half as wide and high.
    fn coarser(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut nodes = vec![Node::default(); width as usize * height as usize];
        for (y, row) in self.nodes.chunks(self.width as usize).enumerate() {
            for (x, &node) in row.iter().enumerate() {
                nodes[y / 2 * width as usize + x / 2].add(node);
            }
        }
        Self {
            width,
            height,
            nodes,
        }
    }
}

/// Elements node by node, so that neighbours in the list are neighbours on the sphere.
#[derive(Debug, Default)]
pub(super) struct Cut {
    elements: Vec<Element>,
    /// Where in `elements` each chunk begins.
    starts: Vec<usize>,
    caps: Vec<(DVec3, f64)>,
}

#[derive(Clone, Copy, Debug)]
struct Element {
    direction: DVec3,
    weight: f64,
    moment: DVec3,
}

/// A cap that holds `elements`.
fn cap(elements: &[Element]) -> (DVec3, f64) {
    let sum: DVec3 = elements.iter().map(|element| element.direction).sum();
    let centre = sum.try_normalize().unwrap_or(DVec3::Y);
    let radius = elements
        .iter()
        .map(|element| centre.angle_between(element.direction))
        .fold(0.0, f64::max);
    // The arc cosine of nearly one is that inexact.
    (centre, radius + 1e-7)
}

impl Elements for Cut {
    fn n_chunks(&self) -> usize {
        self.caps.len()
    }

    fn cap(&self, chunk: usize) -> (DVec3, f64) {
        self.caps[chunk]
    }

    fn visit(&self, chunk: usize, mut visit: impl FnMut(DVec3, f64, DVec3)) {
        let end = self.starts.get(chunk + 1).copied();
        let end = end.unwrap_or(self.elements.len());
        for element in &self.elements[self.starts[chunk]..end] {
            visit(element.direction, element.weight, element.moment);
        }
    }
}

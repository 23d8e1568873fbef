//! Conservative coverage: which texels of a page are read, on which triangle each samples, and which belong to one tile.

use glam::DVec2;
use rayon::prelude::*;

use crate::atlas::{Atlas, NO_CHART, Unwrap, closest, each_covered};

use super::TILE;

/// A covered texel of an unwrap.
#[derive(Clone, Copy, Debug)]
pub(super) struct Covered {
    /// Column and row in the unwrap's rectangle; −1 to its size, as authored layouts are read one texel outside.
    pub(super) texel: [i32; 2],
    /// Chart whose texel it is.
    pub(super) chart: u32,
    /// Primitive and triangle (in the unwrap's lists) that it samples.
    pub(super) triangle: [u32; 2],
    /// Where on the triangle: barycentric weights.
    pub(super) weights: [f64; 3],
}

/// A covered texel of a page.
#[derive(Clone, Copy, Debug)]
pub(super) struct OnPage {
    /// Column and row in the page.
    pub(super) texel: [u16; 2],
    /// Index in the atlas's placements.
    pub(super) placement: u32,
    /// Chart of the placement's unwrap.
    pub(super) chart: u32,
    /// Index in [`Coverage::of`].
    pub(super) covered: u32,
}

/// What the unwraps of a page cover: once each, however many instances share them.
#[derive(Debug)]
pub(super) struct Coverage {
    /// The covered texels by unwrap; none for unwraps of other pages.
    of: Vec<Vec<Covered>>,
}

impl Coverage {
    /// Of all unwraps placed on `page`.
    pub(super) fn new(atlas: &Atlas, page: usize) -> Self {
        let mut placed = vec![false; atlas.unwraps.len()];
        for placement in &atlas.placements {
            placed[placement.unwrap] |= placement.page == page;
        }
        let of = atlas
            .unwraps
            .par_iter()
            .zip(placed)
            .map(|(unwrap, placed)| if placed { cover(unwrap) } else { Vec::new() })
            .collect();
        Self { of }
    }

    /// What a texel of the page covers.
    pub(super) fn of(&self, atlas: &Atlas, texel: &OnPage) -> &Covered {
        let unwrap = atlas.placements[texel.placement as usize].unwrap;
        &self.of[unwrap][texel.covered as usize]
    }

    /// All covered texels of the page in the order of the tiles: by row and column of the 8×8 block, placement, chart, then row and column.
    pub(super) fn in_tiles(&self, atlas: &Atlas, page: usize) -> Vec<OnPage> {
        let mut texels: Vec<OnPage> = atlas
            .placements
            .par_iter()
            .enumerate()
            .filter(|(_, placement)| placement.page == page)
            .flat_map_iter(|(index, placement)| {
                let covered = self.of[placement.unwrap].iter().enumerate();
                covered.map(move |(number, covered)| OnPage {
                    // Rectangles keep a margin, so that texels just outside of them are still on the page.
                    texel: [0, 1]
                        .map(|axis| (placement.offset[axis] as i32 + covered.texel[axis]) as u16),
                    placement: index as u32,
                    chart: covered.chart,
                    covered: number as u32,
                })
            })
            .collect();
        texels.par_sort_unstable_by_key(|texel| {
            let [x, y] = texel.texel;
            let tile = TILE as u16;
            ((y / tile, x / tile), (texel.placement, texel.chart), (y, x))
        });
        texels
    }
}

/// The covered texels of an unwrap; every texel once.
fn cover(unwrap: &Unwrap) -> Vec<Covered> {
    let mut by_chart: Vec<Vec<[u32; 2]>> = vec![Vec::new(); unwrap.n_charts as usize];
    for (index, primitive) in unwrap.primitives.iter().enumerate() {
        for (triangle, &chart) in primitive.charts.iter().enumerate() {
            if chart != NO_CHART {
                by_chart[chart as usize].push([index as u32, triangle as u32]);
            }
        }
    }
    let mut claims: Vec<(Covered, f64)> = by_chart
        .into_par_iter()
        .enumerate()
        .flat_map_iter(|(chart, triangles)| cover_chart(unwrap, chart as u32, &triangles))
        .collect();
    // Only authored layouts have texels that several charts claim.
    claims.par_sort_unstable_by(|(a, a_distance), (b, b_distance)| {
        let place = |covered: &Covered| (covered.texel[1], covered.texel[0]);
        place(a)
            .cmp(&place(b))
            .then(a_distance.total_cmp(b_distance))
            .then(a.triangle.cmp(&b.triangle))
    });
    claims.dedup_by_key(|(covered, _)| covered.texel);
    claims.into_iter().map(|(covered, _)| covered).collect()
}

/// The texels that a chart covers, with the squared distance of the centre from the chart in texels.
fn cover_chart(unwrap: &Unwrap, chart: u32, triangles: &[[u32; 2]]) -> Vec<(Covered, f64)> {
    let flat = |[primitive, triangle]: [u32; 2]| {
        let primitive = &unwrap.primitives[primitive as usize];
        primitive.triangles[triangle as usize].map(|vertex| primitive.texcoords[vertex as usize])
    };
    let (low, high) = triangles.iter().flat_map(|&triangle| flat(triangle)).fold(
        (DVec2::INFINITY, DVec2::NEG_INFINITY),
        |(low, high), point| (low.min(point), high.max(point)),
    );
    // A box around all footprints; charts have at least one triangle.
    let origin = [low.x, low.y].map(|x| (x - 1.5).floor() as i32);
    let end = [high.x, high.y].map(|x| (x + 1.5).ceil() as i32);
    let width = (end[0] - origin[0] + 1) as usize;
    let height = (end[1] - origin[1] + 1) as usize;
    let mut nearest: Vec<Option<(Covered, f64)>> = vec![None; width * height];
    for &triangle in triangles {
        let corners = flat(triangle);
        each_covered(corners, |x, y| {
            let cell = (y - origin[1]) as usize * width + (x - origin[0]) as usize;
            if nearest[cell].is_some_and(|(_, distance)| distance == 0.0) {
                return;
            }
            let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (distance, weights) = closest(corners, centre);
            // Triangles come in order, so that the first of equally near ones stays.
            if nearest[cell].is_none_or(|(_, best)| distance < best) {
                let covered = Covered {
                    texel: [x, y],
                    chart,
                    triangle,
                    weights,
                };
                nearest[cell] = Some((covered, distance));
            }
        });
    }
    nearest.into_iter().flatten().collect()
}

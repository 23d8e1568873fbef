//! Continues the borders of charts outwards.
//!
//! A bilinear or mip-mapped lookup near the border of a chart also reads texels beside it. They repeat the nearest covered texel, so
//! that what is read is what the border has. The answer is an index, not a value: it is found once per page and serves every plane,
//! and no dilated copy of a plane is ever held.

use rayon::iter::{IndexedParallelIterator, ParallelIterator};
use rayon::slice::{ParallelSlice, ParallelSliceMut};

use crate::refine::Field;

/// Source of a texel that has none.
pub(super) const EMPTY: u32 = u32::MAX;

/// For every texel of the page, row by row, the index in [`Field::places`] of the covered texel it repeats.
///
/// A covered texel repeats itself. Any other takes the nearest covered texel (Euclidean, between centres) among those at most `reach`
/// columns and `reach` rows away; of equally near ones the topmost, then the leftmost; [`EMPTY`] when there is none.
pub(super) fn sources(field: &Field, reach: u32) -> Vec<u32> {
    let width = field.width as usize;
    let height = field.height as usize;
    let mut covered = vec![EMPTY; width * height];
    for (index, place) in field.places.iter().enumerate() {
        covered[place[1] as usize * width + place[0] as usize] = index as u32;
    }
    if reach == 0 || width == 0 {
        return covered;
    }
    // The nearest texel of a row is the best of that row at any distance from it, so two passes of one dimension are exact.
    covered
        .par_chunks_mut(width)
        .for_each(|row| spread(row, reach as usize));
    let rows: Vec<&[u32]> = covered.par_chunks(width).collect();
    let mut sources = vec![EMPTY; width * height];
    sources
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            let first = y.saturating_sub(reach as usize);
            let last = (y + reach as usize).min(height - 1);
            for (x, source) in row.iter_mut().enumerate() {
                *source = nearest(&rows[first..=last], field, [x, y]);
            }
        });
    sources
}

/// Fills the empty texels of a row with the nearest one at most `reach` columns away, of two equally near ones the left one.
fn spread(row: &mut [u32], reach: usize) {
    let authored: Vec<usize> = (0..row.len()).filter(|&x| row[x] != EMPTY).collect();
    let mut next = 0;
    for x in 0..row.len() {
        while next < authored.len() && authored[next] < x {
            next += 1;
        }
        let left = next.checked_sub(1).map(|index| authored[index]);
        let right = authored.get(next).copied();
        let nearest = match (left, right) {
            (Some(left), Some(right)) if right - x < x - left => Some(right),
            (Some(left), _) => Some(left),
            (None, right) => right,
        };
        if let Some(nearest) = nearest.filter(|nearest| nearest.abs_diff(x) <= reach) {
            row[x] = row[nearest];
        }
    }
}

/// The nearest to `texel` among the candidates that `rows` hold in its column.
fn nearest(rows: &[&[u32]], field: &Field, texel: [usize; 2]) -> u32 {
    let mut best = EMPTY;
    let mut best_distance_sq = usize::MAX;
    for row in rows {
        let source = row[texel[0]];
        if source == EMPTY {
            continue;
        }
        let [x, y] = field.places[source as usize];
        let dx = texel[0].abs_diff(x as usize);
        let dy = texel[1].abs_diff(y as usize);
        let distance_sq = dx * dx + dy * dy;
        if distance_sq < best_distance_sq {
            best = source;
            best_distance_sq = distance_sq;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The obvious way: looks at every covered texel, topmost and leftmost first.
    fn brute(field: &Field, reach: u32) -> Vec<u32> {
        let mut order: Vec<usize> = (0..field.places.len()).collect();
        order.sort_by_key(|&index| (field.places[index][1], field.places[index][0]));
        let mut sources = Vec::new();
        for y in 0..field.height {
            for x in 0..field.width {
                let distance = |index: usize| {
                    let [source_x, source_y] = field.places[index].map(u32::from);
                    [source_x.abs_diff(x), source_y.abs_diff(y)]
                };
                let near = order
                    .iter()
                    .copied()
                    .filter(|&index| distance(index).into_iter().all(|away| away <= reach));
                let nearest = near.min_by_key(|&index| {
                    let [dx, dy] = distance(index);
                    dx * dx + dy * dy
                });
                sources.push(nearest.map_or(EMPTY, |index| index as u32));
            }
        }
        sources
    }

    fn field(case: u64) -> Field {
        let bits = |index: u64| crate::math::hash(case, index, 0);
        let width = 1 + (bits(0) % 17) as u32;
        let height = 1 + (bits(1) % 17) as u32;
        let sparsity = 1 + bits(2) % 40;
        let mut places = Vec::new();
        for y in 0..height as u16 {
            for x in 0..width as u16 {
                if bits(3 + u64::from(y) * 64 + u64::from(x)).is_multiple_of(sparsity) {
                    places.push([x, y]);
                }
            }
        }
        // The order of places must not matter.
        places.reverse();
        Field {
            width,
            height,
            places,
            planes: Vec::new(),
        }
    }

    #[test]
    fn every_texel_repeats_the_nearest_covered_one() {
        for case in 0..300 {
            let field = field(case);
            for reach in [0, 1, 2, 4, 9, u32::MAX] {
                assert_eq!(
                    sources(&field, reach),
                    brute(&field, reach),
                    "case {case}, reach {reach}"
                );
            }
        }
    }
}

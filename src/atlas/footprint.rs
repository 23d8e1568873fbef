//! Which texels a bilinear lookup on a triangle reads.
//!
//! A lookup at point p blends the four texels whose centres lie less than one texel from p in both axes, so a texel is read from a
//! triangle exactly when the open square of side 2 around its centre meets the triangle. Square and triangle are convex: row by row,
//! the part of the triangle inside the row's open strip spans an interval of x, and the texels of that row are those whose open
//! interval meets it. This is exact but for the rounding of the cut points.

use std::ops::RangeInclusive;

use glam::DVec2;

/// Visits all texels `(x, y)` that a bilinear lookup on `triangle` reads, row by row.
///
/// `triangle` is in texels, centres at halves; it may be degenerate (a segment or a point is covered as such). Coordinates must be
/// finite.
pub(crate) fn each_covered(triangle: [DVec2; 3], mut visit: impl FnMut(i32, i32)) {
    let low = triangle[0].y.min(triangle[1].y).min(triangle[2].y);
    let high = triangle[0].y.max(triangle[1].y).max(triangle[2].y);
    for y in read(low, high) {
        let centre = f64::from(y) + 0.5;
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            if let Some((x0, x1)) =
                span_in_strip(triangle[a], triangle[b], centre - 1.0, centre + 1.0)
            {
                left = left.min(x0).min(x1);
                right = right.max(x0).max(x1);
            }
        }
        for x in read(left, right) {
            visit(x, y);
        }
    }
}

/// Texels along one axis whose open interval `(centre - 1, centre + 1)` meets `[low, high]`; none when `low > high`.
pub(super) fn read(low: f64, high: f64) -> RangeInclusive<i32> {
    if low > high {
        #[expect(clippy::reversed_empty_ranges, reason = "the empty range")]
        return 1..=0;
    }
    // centre + 1 > low and centre − 1 < high with centre = x + 0.5.
    (low - 1.5).floor() as i32 + 1..=(high + 0.5).ceil() as i32 - 1
}

/// x at both ends of the part of the segment `ab` that lies in the strip `low..high` of y.
fn span_in_strip(a: DVec2, b: DVec2, low: f64, high: f64) -> Option<(f64, f64)> {
    let (a, b) = if a.y <= b.y { (a, b) } else { (b, a) };
    if b.y < low || a.y > high {
        return None;
    }
    let at = |y: f64| a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
    let x0 = if a.y < low { at(low) } else { a.x };
    let x1 = if b.y > high { at(high) } else { b.x };
    Some((x0, x1))
}

/// The point of `triangle` nearest to `point`: its squared distance and its barycentric weights, which are not negative and sum to 1.
///
/// The distance is 0 exactly when the point lies inside or on the border. Degenerate triangles count as their edges.
pub(crate) fn closest(triangle: [DVec2; 3], point: DVec2) -> (f64, [f64; 3]) {
    let [a, b, c] = triangle;
    let doubled = signed_area([a, b, c]);
    if doubled != 0.0 {
        let sign = doubled.signum();
        let parts = [
            signed_area([point, b, c]) * sign,
            signed_area([a, point, c]) * sign,
            signed_area([a, b, point]) * sign,
        ];
        let sum: f64 = parts.iter().sum();
        if sum > 0.0 && parts.iter().all(|&part| part >= 0.0) {
            return (0.0, parts.map(|part| part / sum));
        }
    }
    let mut best = (f64::INFINITY, [1.0, 0.0, 0.0]);
    for (from, to) in [(0, 1), (1, 2), (2, 0)] {
        let edge = triangle[to] - triangle[from];
        let length_sq = edge.length_squared();
        let t = if length_sq > 0.0 {
            ((point - triangle[from]).dot(edge) / length_sq).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let distance_sq = (triangle[from] + edge * t).distance_squared(point);
        if distance_sq < best.0 {
            let mut weights = [0.0; 3];
            weights[from] = 1.0 - t;
            weights[to] = t;
            best = (distance_sq, weights);
        }
    }
    best
}

/// Twice the signed area of a triangle.
pub(crate) fn signed_area([a, b, c]: [DVec2; 3]) -> f64 {
    (b - a).perp_dot(c - a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{hash, unit_pair};

    /// The obvious way: separating axes of square and triangle.
    fn meets(triangle: [DVec2; 3], x: i32, y: i32) -> bool {
        let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let edges = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (triangle[b] - triangle[a]).perp());
        [DVec2::X, DVec2::Y]
            .into_iter()
            .chain(edges)
            .filter(|axis| *axis != DVec2::ZERO)
            .all(|axis| {
                let on_axis = triangle.map(|vertex| axis.dot(vertex - centre));
                let radius = axis.x.abs() + axis.y.abs();
                let low = on_axis.into_iter().fold(f64::INFINITY, f64::min);
                let high = on_axis.into_iter().fold(f64::NEG_INFINITY, f64::max);
                low < radius && high > -radius
            })
    }

    fn random_triangle(case: u64) -> [DVec2; 3] {
        // Quarters make vertices hit centres and borders exactly; every third case is thin.
        let quarter = |bits| {
            let [x, y] = unit_pair(bits);
            DVec2::new((x * 40.0).round() / 4.0, (y * 40.0).round() / 4.0)
        };
        let [a, b, c] = [0, 1, 2].map(|corner| quarter(hash(case, corner, 1)));
        if case.is_multiple_of(3) {
            [a, b, a + (b - a) * 0.25]
        } else {
            [a, b, c]
        }
    }

    #[test]
    fn rows_cover_the_same_texels_as_separating_axes() {
        for case in 0..2000 {
            let triangle = random_triangle(case);
            let mut covered = Vec::new();
            each_covered(triangle, |x, y| covered.push((x, y)));
            let mut expected = Vec::new();
            for y in -3..14 {
                for x in -3..14 {
                    if meets(triangle, x, y) {
                        expected.push((x, y));
                    }
                }
            }
            assert_eq!(covered, expected, "case {case}: {triangle:?}");
        }
    }

    #[test]
    fn nearest_point_beats_every_point_of_the_triangle() {
        for case in 0..500 {
            let triangle = random_triangle(case);
            let [x, y] = unit_pair(hash(case, 9, 9));
            let point = DVec2::new(x * 14.0 - 2.0, y * 14.0 - 2.0);
            let (distance_sq, weights) = closest(triangle, point);
            let at = |w: [f64; 3]| triangle[0] * w[0] + triangle[1] * w[1] + triangle[2] * w[2];
            assert!(weights.iter().all(|&w| w >= 0.0), "case {case}");
            // Weights are sums of three roundings of numbers up to 1.
            assert!(
                (weights.iter().sum::<f64>() - 1.0).abs() < 1e-15,
                "case {case}"
            );
            assert!(
                (at(weights).distance_squared(point) - distance_sq).abs() < 1e-10,
                "case {case}"
            );
            for probe in 0..40 {
                let [u, v] = unit_pair(hash(case, probe, 4));
                let (u, v) = if u + v > 1.0 {
                    (1.0 - u, 1.0 - v)
                } else {
                    (u, v)
                };
                let other = at([1.0 - u - v, u, v]).distance_squared(point);
                assert!(distance_sq <= other + 1e-12, "case {case}");
            }
        }
    }
}

//! The outline of a light above a receiver's horizon, as pieces of a contour.
//!
//! Sutherland and Hodgman's clipping by one plane, loop by loop: every edge keeps its upper part, and where a loop dives below the plane
//! the gap is closed by a piece along it. In a concave loop or between loops these closing pieces may overlap; they lie on one line
//! and cancel where they do, so the sums over the contour come out right although the clipped loops are not simple polygons.
//!
//! Source: I. Sutherland and G. Hodgman, "Reentrant polygon clipping", Communications of the ACM 17 (1974).

use glam::DVec3;

use super::contour::Piece;

/// Which way round a contour is walked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    /// As it is stored: right for the back of a light.
    Stored,
    /// The other way: right for the front, which is stored counter-clockwise as seen from where it shines.
    Reversed,
}

/// An oriented plane: a receiver's horizon, or the plane of a light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    /// A point of it, world metres.
    pub(super) point: DVec3,
    /// Unit vector upwards.
    pub(super) normal: DVec3,
}

/// Rounding of a plain scalar product of a rounded difference, relative to the product of the 1-norms; four operations deep. Smaller
/// could decide a side wrongly; larger only sends more points to the slow way.
const SIDE_ROUNDING: f64 = 4.0 * f64::EPSILON;

impl Plane {
    /// Whether `point` is above the plane, decided exactly; points in it are not.
    pub(super) fn is_above(&self, point: DVec3) -> bool {
        let difference = point - self.point;
        let height = self.normal.dot(difference);
        let scale = self.normal.abs().dot(difference.abs());
        if height.abs() > SIDE_ROUNDING * scale {
            height > 0.0
        } else {
            self.height(point) > 0.0
        }
    }

    /// The part of the segment from `upper` to `lower` that is above the plane.
    fn part_above(&self, upper: DVec3, lower: DVec3) -> f64 {
        let height = self.height(upper);
        height / (height - self.height(lower))
    }

    /// Metres above the plane, negative below. Rounded only once, however near to the plane `point` lies: the share of a light
    /// that reaches over the horizon must not depend on how far away it is.
    ///
    /// Source: T. Ogita, S. Rump and S. Oishi, "Accurate sum and dot product", SIAM J. Sci. Comput. 26 (2005), algorithm Dot2.
    fn height(&self, point: DVec3) -> f64 {
        let (mut sum, mut error) = (0.0, 0.0);
        for axis in 0..3 {
            let (difference, lost) = two_sum(point[axis], -self.point[axis]);
            let product = self.normal[axis] * difference;
            let (total, carried) = two_sum(sum, product);
            sum = total;
            error += carried
                + self.normal[axis].mul_add(difference, -product)
                + self.normal[axis] * lost;
        }
        sum + error
    }
}

/// Appends the part of `contours` (world metres, closed) above `horizon` to `pieces`, relative to `origin`.
///
/// Points exactly on the horizon count as below it, so a light that touches the plane from below or lies in it adds nothing.
pub(super) fn outline(
    contours: &[Vec<DVec3>],
    direction: Direction,
    horizon: &Plane,
    origin: DVec3,
    pieces: &mut Vec<Piece>,
) {
    for contour in contours {
        clip_loop(contour, direction, horizon, origin, pieces);
    }
}

fn clip_loop(
    contour: &[DVec3],
    direction: Direction,
    horizon: &Plane,
    origin: DVec3,
    pieces: &mut Vec<Piece>,
) {
    let count = contour.len();
    let at = |step: usize| {
        let vertex = match direction {
            Direction::Stored => contour[step % count],
            Direction::Reversed => contour[(2 * count - 1 - step) % count],
        };
        (vertex - origin, vertex, horizon.is_above(vertex))
    };
    // Where the loop came up first, and where it went down and has not come up since.
    let (mut first_up, mut last_down) = (None, None);
    let Some(last) = count.checked_sub(1) else {
        return;
    };
    let mut start = at(last);
    for step in 0..count {
        let end = at(step);
        let ((mut a, vertex_a, a_above), (mut b, vertex_b, b_above)) = (start, end);
        start = end;
        // A crossing is measured from the upper end, so that an edge and its reverse are cut at the same point.
        if a_above && !b_above {
            b = a + (b - a) * horizon.part_above(vertex_a, vertex_b);
            last_down = Some(b);
        }
        if b_above && !a_above {
            a = b + (a - b) * horizon.part_above(vertex_b, vertex_a);
            match last_down.take() {
                Some(down) => pieces.push(along_horizon(down, a)),
                None => first_up = Some(a),
            }
        }
        if a_above || b_above {
            pieces.push(Piece {
                a,
                b,
                horizon: false,
            });
        }
    }
    if let (Some(down), Some(up)) = (last_down, first_up) {
        pieces.push(along_horizon(down, up));
    }
}

fn along_horizon(a: DVec3, b: DVec3) -> Piece {
    Piece {
        a,
        b,
        horizon: true,
    }
}

/// The rounded sum of two numbers and what was rounded off (Knuth).
fn two_sum(x: f64, y: f64) -> (f64, f64) {
    let sum = x + y;
    let of_y = sum - x;
    (sum, (x - (sum - of_y)) + (y - of_y))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clipped(contours: &[Vec<DVec3>], height: f64) -> Vec<Piece> {
        let horizon = Plane {
            point: DVec3::new(0.0, 0.0, height),
            normal: DVec3::Z,
        };
        let mut pieces = Vec::new();
        outline(
            contours,
            Direction::Stored,
            &horizon,
            DVec3::ZERO,
            &mut pieces,
        );
        pieces
    }

    /// Twice the area along Y.
    fn double_area(pieces: &[Piece]) -> f64 {
        -pieces.iter().map(|p| p.a.cross(p.b).y).sum::<f64>()
    }

    /// A wall in the plane y = 0.
    fn wall(points: &[[f64; 2]]) -> Vec<DVec3> {
        points.iter().map(|p| DVec3::new(p[0], 0.0, p[1])).collect()
    }

    #[test]
    fn pieces_close_and_enclose_what_is_above() {
        let square = wall(&[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
        // Every start vertex, so that loops begin above and below.
        for start in 0..4 {
            let mut turned = square.clone();
            turned.rotate_left(start);
            let pieces = clipped(&[turned], 1.5);
            assert_eq!(pieces.len(), 4);
            assert_eq!(pieces.iter().filter(|p| p.horizon).count(), 1);
            assert!((double_area(&pieces) - 2.0).abs() < 1e-15);
            let gap: DVec3 = pieces.iter().map(|p| p.b - p.a).sum();
            assert!(gap.length() < 1e-15);
        }
    }

    #[test]
    fn a_comb_and_its_hole_lose_what_is_above() {
        // Two teeth that point down, cut through both; a hole in the left one, cut too.
        let comb = wall(&[
            [0.0, 0.0],
            [1.0, 0.0],
            [1.0, 2.0],
            [2.0, 2.0],
            [2.0, 0.0],
            [3.0, 0.0],
            [3.0, 3.0],
            [0.0, 3.0],
        ]);
        let hole = wall(&[[0.25, 0.5], [0.25, 1.5], [0.75, 1.5], [0.75, 0.5]]);
        let pieces = clipped(&[comb, hole], 1.0);
        assert!((double_area(&pieces) - 2.0 * (5.0 - 0.25)).abs() < 1e-14);
    }

    #[test]
    fn touching_the_horizon_from_below_is_dark_and_from_above_is_whole() {
        let square = wall(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        assert!(clipped(std::slice::from_ref(&square), 1.0).is_empty());
        assert!(clipped(std::slice::from_ref(&square), 3.0).is_empty());
        let pieces = clipped(&[square], 0.0);
        assert!((double_area(&pieces) - 2.0).abs() < 1e-15);
        assert!(clipped(&[Vec::new()], 0.0).is_empty());
    }

    #[test]
    fn heights_keep_their_digits_far_away() {
        let horizon = Plane {
            point: DVec3::new(1e5, -2e5, 3e5),
            normal: DVec3::new(0.6, 0.8, 0.0),
        };
        let step = 2f64.powi(-30);
        let on = horizon.height(horizon.point + DVec3::new(4096.0, -3072.0, 0.0));
        let above = horizon.height(horizon.point + DVec3::new(4096.0, -3072.0 + step, 0.0));
        // The normal is (0.6, 0.8) only up to rounding, so the point is a little off the plane. Products with powers of two are exact.
        let residue = (0.6 * 4096.0 - 0.8 * 2048.0) - 0.8 * 1024.0;
        assert!((on - residue).abs() < 1e-25, "{on:e} {residue:e}");
        assert!((above - on - 0.8 * step).abs() < 1e-25);
    }
}

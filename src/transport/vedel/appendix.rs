//! The derivative of Vedel's appendix, for comparison: every piece turns about ends that are fixed in space.
//!
//! That is right for a contour of real corners and wrong where a silhouette crosses the light's border or another silhouette, since the
//! crossing slides along both as the receiver moves: nearly every contour in a penumbra has such corners. [`crate::transport::contour`] has
//! the right derivative.
//!
//! With a, b the ends relative to the receiver, w = a × b, n = w/|w|, β the angle between a and b, and a move δ of the receiver:
//!
//! ```text
//! δβ = (a + b − (a·b) (a/a² + b/b²))·δ / |w|      (9), whose root is misplaced in print: it is |w|
//! δw = (b − a) × δ                                 given there as δc
//! δn = (δw − n (n·δw)) / |w|                      (10)
//! δG = ½ Σ (δβ n + β δn)                          (8)
//! ```
//!
//! Source: C. Vedel, "Computing illumination from area light sources by approximate contour integration", Graphics Interface 1993.

use glam::{DMat3, DVec3};

use crate::transport::contour::{Piece, outer};

/// `∂G_i/∂x_k` per unit radiance at row i and column k, by the appendix.
pub(in crate::transport) fn jacobian(pieces: &[Piece]) -> DMat3 {
    pieces
        .iter()
        .filter(|piece| !piece.horizon)
        .map(|piece| fixed_ends(piece.a, piece.b))
        .sum()
}

fn fixed_ends(a: DVec3, b: DVec3) -> DMat3 {
    let along = b - a;
    let w = a.cross(along);
    let s = w.length();
    if s == 0.0 {
        return DMat3::ZERO;
    }
    let n = w / s;
    let dot = a.dot(b);
    let beta = s.atan2(dot);
    let d_beta = (a + b - dot * (a / a.length_squared() + b / b.length_squared())) / s;
    let d_n = DVec3::AXES.map(|axis| {
        let d_w = along.cross(axis);
        (d_w - n * n.dot(d_w)) / s
    });
    0.5 * (outer(n, d_beta) + beta * DMat3::from_cols(d_n[0], d_n[1], d_n[2]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::contour;

    #[test]
    fn a_contour_of_real_corners_has_the_same_derivative_either_way() {
        let corners = [
            DVec3::new(1.0, 0.2, 0.4),
            DVec3::new(0.3, 1.0, 0.7),
            DVec3::new(-0.5, 0.6, 1.1),
            DVec3::new(-0.2, 0.1, 1.3),
        ];
        let pieces: Vec<Piece> = (0..4)
            .map(|k| Piece {
                a: corners[k],
                b: corners[(k + 1) % 4],
                horizon: false,
            })
            .collect();
        let by_edges = contour::sum(&pieces, DVec3::Z, true).j;
        let by_ends = jacobian(&pieces);
        for axis in 0..3 {
            let error = (by_edges.col(axis) - by_ends.col(axis)).length();
            assert!(error < 1e-14, "column {axis}: {by_edges} {by_ends}");
        }
    }
}

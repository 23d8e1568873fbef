//! The sums of [`super::contour`] for a light that is small for its distance, without the loss of digits.
//!
//! For any closed contour Σ w = 2A, twice its area vector. Taking out the value of each integral at one point c of the light,
//!
//! ```text
//! Σ K w = K(c) 2A + Σ (K − K(c)) w
//! ```
//!
//! leaves terms as small as the result. The differences are written so that nothing cancels in them, from the positions of the
//! vertices relative to c, which are exact however far away the receiver is. They are smooth along each piece, so a Gauss rule
//! integrates them to rounding. Lengths are in units of |c|.
//!
//! | code | meaning                                         |
//! |------|-------------------------------------------------|
//! | `c`  | unit vector from the receiver to the centre     |
//! | `o`  | point of the contour relative to the centre     |
//! | `d2` | the square of the distance of that point, less 1 |
//!
//! Why not the closed form: it loses a factor of distance / size, which at ten thousand sizes leaves 1e-11 of the light. Why not
//! cubature over the area: the outline is shorter, and holes and clipping come for free.

use glam::DVec3;

use super::contour::{Piece, Sums, TERM_ROUNDING, outer};

/// Distance of the centre in radii of the light from which this form is used. At 4 the Gauss rule begins to show (3e-15); at 10 the
/// closed form has lost a digit.
pub(super) const MIN_RADII: f64 = 5.0;

/// Places and weights of Gauss's rule of 8 points on 0..1. Its error falls with the 16th power of the ratio of a piece's half length
/// to twice its distance: 1e-16 of the integral at [`MIN_RADII`].
const GAUSS: [[f64; 2]; 8] = [
    [0.019_855_071_751_231_884, 0.050_614_268_145_188_13],
    [0.101_666_761_293_186_64, 0.111_190_517_226_687_24],
    [0.237_233_795_041_835_5, 0.156_853_322_938_943_63],
    [0.408_282_678_752_175_1, 0.181_341_891_689_181],
    [0.591_717_321_247_825, 0.181_341_891_689_181],
    [0.762_766_204_958_164_5, 0.156_853_322_938_943_63],
    [0.898_333_238_706_813_4, 0.111_190_517_226_687_24],
    [0.980_144_928_248_768_1, 0.050_614_268_145_188_13],
];

/// Sums over the pieces of closed contours, given relative to `centre`, which is itself relative to the receiver and at least
/// [`MIN_RADII`] times as far away as any of them.
///
/// Agrees with [`super::contour::sum`]; accurate to rounding relative to the light itself unless it is seen nearly edge-on.
pub(super) fn sum(centre: DVec3, pieces: &[Piece], gradients: bool) -> Sums {
    let distance = centre.length();
    let c = centre / distance;
    let mut sums = Sums {
        has_gradient: gradients,
        ..Sums::DARK
    };
    // Σ w over all pieces, and over those that have derivatives.
    let (mut closed, mut moving) = (DVec3::ZERO, DVec3::ZERO);
    for piece in pieces {
        let (a, b) = (piece.a / distance, piece.b / distance);
        let d = b - a;
        let area = a.cross(d);
        let w = c.cross(d) + area;
        let excess = Excess::of_piece(c, a, d, gradients && !piece.horizon);
        sums.g += w * excess.f;
        sums.phi += c.dot(w) * excess.q;
        sums.rounding += w.length() * excess.f.abs() + area.length();
        closed += area;
        if gradients {
            sums.j += outer(excess.m, w);
            sums.grad_phi += w * excess.k;
            // A horizon piece keeps no w of its own in the sum: take out what `closed` counts for it.
            moving += if piece.horizon { area - w } else { area };
        }
    }
    sums.g += 0.5 * closed;
    sums.phi += 0.5 * c.dot(closed);
    sums.rounding *= TERM_ROUNDING;
    if gradients {
        sums.j = (sums.j + outer(c, moving)) * (1.0 / distance);
        sums.grad_phi = (sums.grad_phi + moving) / distance;
    }
    sums
}

/// Integrals along a piece, less their value at the centre, where f = q = ½, m = c and k = 1.
#[derive(Default)]
struct Excess {
    f: f64,
    q: f64,
    m: DVec3,
    k: f64,
}

impl Excess {
    /// The piece from `a` along `d`, relative to the centre `c`. `m` and `k` stay 0 unless `gradients`.
    fn of_piece(c: DVec3, a: DVec3, d: DVec3, gradients: bool) -> Self {
        let mut sum = Self::default();
        for [place, weight] in GAUSS {
            let o = a + d * place;
            let along = c.dot(o);
            let d2 = 2.0 * along + o.length_squared();
            let square = 1.0 + d2;
            let length = square.sqrt();
            let d1 = d2 / (1.0 + length);
            let denominator = square + length * (1.0 + along);
            sum.f -= weight * 0.5 * d2 / square;
            sum.q -= weight * 0.5 * (d2 + d1 + length * along) / denominator;
            if gradients {
                let fourth = square * square;
                sum.m += (o - c * (d2 * (square + 1.0))) * (weight / fourth);
                sum.k -= weight * d1 * (square + length + 1.0) / (square * length);
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::contour;

    #[test]
    fn agrees_with_the_closed_form_where_both_are_good() {
        let normal = DVec3::new(0.2, -0.3, 0.8).normalize();
        let vertices = [
            DVec3::new(-0.5, -0.6, 0.1),
            DVec3::new(-0.4, 0.7, 0.0),
            DVec3::new(0.8, 0.4, -0.2),
            DVec3::new(0.3, -0.7, 0.3),
        ];
        for case in 0..40 {
            let radii = MIN_RADII * (1.0 + 0.1 * f64::from(case));
            let centre = DVec3::new(0.3, 0.4, 0.866) * radii * 0.93;
            let pieces: Vec<_> = (0..4)
                .map(|index| Piece {
                    a: vertices[index],
                    b: vertices[(index + 1) % 4],
                    horizon: index == case as usize % 4,
                })
                .collect();
            let near: Vec<_> = pieces
                .iter()
                .map(|piece| Piece {
                    a: centre + piece.a,
                    b: centre + piece.b,
                    ..*piece
                })
                .collect();
            let got = sum(centre, &pieces, true);
            let want = contour::sum(&near, normal, true);
            // The closed form loses a factor of the distance in radii.
            let tolerance = 1e-14 * radii;
            assert!((got.g - want.g).length() < tolerance * want.g.length());
            assert!((got.phi - want.phi).abs() < tolerance * want.phi.abs());
            assert!((got.grad_phi - want.grad_phi).length() < tolerance * want.grad_phi.length());
            for axis in 0..3 {
                let error = (got.j.col(axis) - want.j.col(axis)).length();
                assert!(
                    error < tolerance * want.j.col(axis).length(),
                    "case {case}: {error:e}"
                );
            }
        }
    }
}

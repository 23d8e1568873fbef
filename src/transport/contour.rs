//! Light from a uniform polygon as a sum over the pieces of its visible contour.
//!
//! The integrals over the light's area turn into integrals along its border (Lambert 1760, Arvo 1994), so the result is exact up to
//! rounding. All four quantities have one shape, an integral along each piece times the normal of the plane of piece and receiver:
//!
//! ```text
//! G  = Σ f w    f = ½ ∫ du/|p|²        = β / 2|w|
//! φ  = Σ q e·w  q = ∫ du/(|p|(|p|+e·p)), the solid angle of the triangle (e, a, b)
//! J  = Σ m ⊗ w  m = ∫ p du/|p|⁴
//! ∇φ = Σ k w    k = ∫ du/|p|³
//!
//! p = a + u (b − a),  0 ≤ u ≤ 1,   w = a × (b − a)
//! ```
//!
//! φ is the circulation of a vector potential of p/|p|³ that is singular along −e; with e = the receiver's normal it is regular above
//! the horizon. ∇φ is the field of a current along the contour (Biot and Savart). The derivatives are those of Reynolds' transport
//! theorem: each piece moves as the line in space that makes it, so they hold for silhouettes in front of the light as well.
//!
//! | code        | meaning                                                                | unit |
//! |-------------|------------------------------------------------------------------------|------|
//! | `a`, `b`    | ends of a piece relative to the receiver                               | m    |
//! | `beta`      | angle between `a` and `b`                                              | rad  |
//! | `t`         | unit vector from `a` to `b`                                            | –    |
//! | `e1`        | unit vector from the receiver to the nearest point of the piece's line | –    |
//! | `h`         | distance of that line                                                  | m    |
//! | `sa`, `sb`  | coordinates of `a` and `b` along `t`                                   | m    |
//!
//! The sum over a closed contour cancels all but (light size / distance)² of terms of (light size / distance). For lights that are
//! small for their distance [`super::distant`] evaluates the same sums without that loss.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

/// A straight part of a visible contour.
///
/// Direction: the lit region lies so that `G` points to it, which is clockwise seen from the receiver. The front of a polygon is wound the
/// other way; [`super::clip`] turns it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// Start, relative to the receiver, on the line in space that makes the piece: the light's border or an occluder's silhouette.
    pub a: DVec3,
    /// End, on the same line.
    pub b: DVec3,
    /// Whether the piece lies on the receiver's horizon plane. It moves with the receiver, so it adds nothing to the derivatives.
    pub horizon: bool,
}

/// Light per unit radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sums {
    /// Light vector in steradians; `g · n` is the cosine-weighted solid angle, at most π.
    pub g: DVec3,
    /// Solid angle in steradians, at most 2π.
    pub phi: f64,
    /// `∂g_i/∂x_k` at row i and column k, per metre. Zero unless `has_gradient`.
    pub j: DMat3,
    /// ∂φ/∂x per metre. Zero unless `has_gradient`.
    pub grad_phi: DVec3,
    /// Whether the derivatives were asked for and exist: they do not where the receiver touches the contour.
    pub has_gradient: bool,
    /// Bound on the rounding error of `g` in steradians, for inputs that are exact.
    pub rounding: f64,
}

impl Sums {
    /// No light, of which the derivative is known.
    pub const DARK: Self = Self {
        g: DVec3::ZERO,
        phi: 0.0,
        j: DMat3::ZERO,
        grad_phi: DVec3::ZERO,
        has_gradient: true,
        rounding: 0.0,
    };

    /// Multiplies the light by a `share` that changes by `slope` per metre.
    pub(super) fn attenuate(&mut self, share: f64, slope: DVec3) {
        self.j = self.j * share + outer(self.g, slope);
        self.grad_phi = self.grad_phi * share + self.phi * slope;
        if !self.has_gradient {
            (self.j, self.grad_phi) = (DMat3::ZERO, DVec3::ZERO);
        }
        self.g *= share;
        self.phi *= share;
        self.rounding *= share;
    }

    /// The same light without derivatives.
    #[must_use]
    pub fn without_gradient(self) -> Self {
        Self {
            j: DMat3::ZERO,
            grad_phi: DVec3::ZERO,
            has_gradient: false,
            ..self
        }
    }
}

/// Rounding error of one term relative to its magnitude: some fifteen operations, few of which add up. Smaller would not bound the
/// error in the tests against extended precision, larger would only be vaguer.
pub(super) const TERM_ROUNDING: f64 = 8.0 * f64::EPSILON;

/// A receiver nearer to a piece than this, relative to the piece's length, touches it: the derivatives, which grow as one over the
/// distance, are given up. Larger takes them from receivers that still have them to 1e-6; smaller lets them be ruled by the
/// rounding of positions, 1e-11 of the length when both lie 1e5 lengths from the origin.
const CONTACT: f64 = 1e-9;

/// Sums over the `pieces` of closed contours, seen by a receiver at the origin with the unit normal `normal`.
///
/// No piece may lie below the plane through the origin with that normal, and the origin must not lie on the polygon. Order does not
/// matter; a piece and its reverse cancel. A piece that points at the receiver adds nothing.
///
/// Source: J. Arvo, "The irradiance Jacobian for partially occluded polyhedral sources", SIGGRAPH 1994, for the idea of a derivative by
/// edges; C. Vedel, "Computing illumination from area light sources by approximate contour integration", Graphics Interface 1993, for
/// G; A. van Oosterom and J. Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomed. Eng. 30 (1983), for φ.
#[must_use]
pub fn sum(pieces: &[Piece], normal: DVec3, gradients: bool) -> Sums {
    sum_moved(pieces, normal, gradients, 0.0)
}

/// [`sum`] when rounding may have moved every piece by `shift` metres: each then sweeps its angle times that distance as seen from the
/// receiver, which enters the error.
pub(super) fn sum_moved(pieces: &[Piece], normal: DVec3, gradients: bool, shift: f64) -> Sums {
    let mut sums = Sums {
        has_gradient: gradients,
        ..Sums::DARK
    };
    for piece in pieces {
        let (a, b) = (piece.a, piece.b);
        let edge = Edge::new(a, b);
        let touches = edge.distance() <= CONTACT * edge.length;
        if gradients && !piece.horizon && touches {
            sums.has_gradient = false;
        }
        if edge.s == 0.0 {
            continue;
        }
        sums.phi += edge.solid_angle(normal);
        sums.g += edge.w * (edge.beta / (2.0 * edge.s));
        let nearest = edge.length_a.min(edge.length_b).max(shift);
        sums.rounding += edge.beta * (TERM_ROUNDING * edge.uncertainty() + shift / nearest);
        if sums.has_gradient && !piece.horizon {
            sums.j += edge.jacobian();
            sums.grad_phi += edge.solid_angle_gradient();
        }
    }
    sums.rounding = sums.rounding.min(PI);
    if sums.has_gradient {
        sums
    } else {
        sums.without_gradient()
    }
}

/// A piece and what its terms share.
struct Edge {
    a: DVec3,
    b: DVec3,
    length_a: f64,
    length_b: f64,
    /// |b − a|.
    length: f64,
    w: DVec3,
    /// |w|.
    s: f64,
    /// a·b.
    dot: f64,
    beta: f64,
}

impl Edge {
    fn new(a: DVec3, b: DVec3) -> Self {
        let d = b - a;
        // a × b would lose the digits that a and b have in common, which are most when the light is far.
        let w = a.cross(d);
        let s = w.length();
        let dot = a.dot(b);
        Self {
            a,
            b,
            length_a: a.length(),
            length_b: b.length(),
            length: d.length(),
            w,
            s,
            dot,
            // acos would lose half of the digits of a small angle.
            beta: s.atan2(dot),
        }
    }

    /// Distance of the origin from the segment.
    fn distance(&self) -> f64 {
        let d = self.b - self.a;
        if self.a.dot(d) < 0.0 && self.b.dot(d) > 0.0 {
            self.s / self.length
        } else {
            self.length_a.min(self.length_b)
        }
    }

    /// Error of the G term in roundings of its angle. An end that was cut from a longer edge is known to the rounding of the far one, so
    /// its direction is as much less certain as it is nearer; and so is the plane of a long piece that passes near the receiver.
    fn uncertainty(&self) -> f64 {
        let ends = self.length_a.max(self.length_b) / self.length_a.min(self.length_b);
        ends + self.length_a * self.length / self.s
    }

    /// Signed solid angle of the triangle (apex, a, b), none of which is opposite to another.
    fn solid_angle(&self, apex: DVec3) -> f64 {
        let (la, lb) = (self.length_a, self.length_b);
        let denominator = la * lb + self.dot + apex.dot(self.a) * lb + apex.dot(self.b) * la;
        // Above the horizon the denominator is not negative; rounding must not turn a flat triangle into the whole sphere.
        2.0 * apex.dot(self.w).atan2(denominator.max(0.0))
    }

    /// m ⊗ w: ∫ cos ψ (e1 cos ψ + t sin ψ) dψ / h over the angles ψ of the piece from e1, in a form that subtracts nothing nearly
    /// equal when the piece is small for its distance.
    fn jacobian(&self) -> DMat3 {
        let t = (self.b - self.a) / self.length;
        let n = self.w / self.s;
        let e1 = t.cross(n);
        let h = self.s / self.length;
        let (sa, sb) = (self.a.dot(t), self.b.dot(t));
        let scale = h * self.length / (2.0 * self.length_a.powi(2) * self.length_b.powi(2));
        let v = e1 * (0.5 * self.beta + scale * (h * h - sa * sb)) + t * (scale * h * (sa + sb));
        outer(v / h, n)
    }

    /// k w.
    fn solid_angle_gradient(&self) -> DVec3 {
        let product = self.length_a * self.length_b;
        let sum = self.length_a + self.length_b;
        // 1/(|a||b| + a·b), where the sum would cancel if a and b point away from each other.
        let inverse = if self.dot >= 0.0 {
            1.0 / (product + self.dot)
        } else {
            (product - self.dot) / (self.s * self.s)
        };
        self.w * (sum / product * inverse)
    }
}

/// The matrix with `v_i n_k` at row i and column k.
pub(super) fn outer(v: DVec3, n: DVec3) -> DMat3 {
    DMat3::from_cols(v * n.x, v * n.y, v * n.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

    fn closed(vertices: &[DVec3]) -> Vec<Piece> {
        (0..vertices.len())
            .map(|index| Piece {
                a: vertices[index],
                b: vertices[(index + 1) % vertices.len()],
                horizon: false,
            })
            .collect()
    }

    #[test]
    fn an_octant_of_the_sky_gives_a_quarter_of_pi_to_each_axis() {
        let sums = sum(&closed(&[DVec3::X, DVec3::Y, DVec3::Z]), DVec3::Z, true);
        assert!((sums.g - DVec3::splat(FRAC_PI_4)).length() < 1e-15);
        assert!((sums.phi - FRAC_PI_2).abs() < 1e-15);
    }

    #[test]
    fn the_reversed_contour_negates() {
        let vertices = [
            DVec3::new(1.0, 0.2, 0.4),
            DVec3::new(0.3, 1.0, 0.7),
            DVec3::new(-0.2, 0.1, 1.3),
        ];
        let reversed: Vec<_> = vertices.iter().rev().copied().collect();
        let forwards = sum(&closed(&vertices), DVec3::Z, true);
        let backwards = sum(&closed(&reversed), DVec3::Z, true);
        assert!((forwards.g + backwards.g).length() < 1e-15);
        assert!((forwards.phi + backwards.phi).abs() < 1e-15);
        assert!((forwards.grad_phi + backwards.grad_phi).length() < 1e-15);
        for axis in 0..3 {
            assert!((forwards.j.col(axis) + backwards.j.col(axis)).length() < 1e-14);
        }
    }

    #[test]
    fn a_piece_that_points_at_the_receiver_adds_nothing() {
        let pointing = Piece {
            a: DVec3::new(1.0, 2.0, 3.0),
            b: DVec3::new(2.0, 4.0, 6.0),
            horizon: false,
        };
        assert_eq!(sum(&[pointing], DVec3::Z, true), Sums::DARK);
    }

    #[test]
    fn a_receiver_on_the_contour_has_no_derivative_and_finite_light() {
        for offset in [0.0, 1e-200, 1e-12] {
            let vertices = [
                DVec3::new(-1.0, 0.0, offset),
                DVec3::new(1.0, 0.0, offset),
                DVec3::new(0.0, 1.0, 1.0),
            ];
            let sums = sum(&closed(&vertices), DVec3::Z, true);
            assert!(!sums.has_gradient, "offset {offset:e}");
            assert!(sums.g.is_finite() && sums.phi.is_finite());
            assert_eq!(sums.j, DMat3::ZERO);
        }
    }

    #[test]
    fn horizon_pieces_have_no_derivative() {
        let mut pieces = closed(&[DVec3::X, DVec3::Y, DVec3::Z]);
        let with = sum(&pieces, DVec3::Z, true);
        pieces[0].horizon = true;
        let without = sum(&pieces, DVec3::Z, true);
        assert_eq!(with.g, without.g);
        assert_eq!(with.phi.to_bits(), without.phi.to_bits());
        let only = sum(&pieces[..1], DVec3::Z, true);
        assert_eq!(only.j, DMat3::ZERO);
        assert_eq!(only.grad_phi, DVec3::ZERO);
        assert!((with.j.col(2) - without.j.col(2)).length() > 0.1);
    }
}

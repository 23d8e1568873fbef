//! Arithmetic with twice the digits of f64 and the light of a rectangle in it, by other formulas than the library's.
//!
//! Uncut: the classical double integral over the rectangle in its own frame. Cut by a horizon: Lambert's sum for the light vector and
//! Girard's angle excess for the solid angle. Both know 30 digits, so that even central differences of them know 20.

use std::ops::{Add, Div, Mul, Neg, Sub};

use glam::DVec3;

/// An unevaluated sum of two numbers, the second below the rounding of the first.
///
/// Source: T. Dekker, "A floating-point technique for extending the available precision", Numerische Mathematik 18 (1971).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dd {
    high: f64,
    low: f64,
}

pub(crate) const ZERO: Dd = Dd {
    high: 0.0,
    low: 0.0,
};
const HALF_PI: Dd = Dd {
    high: std::f64::consts::FRAC_PI_2,
    low: 6.123_233_995_736_766e-17,
};

impl Dd {
    fn sum(x: f64, y: f64) -> Self {
        let high = x + y;
        let of_y = high - x;
        Self {
            high,
            low: (x - (high - of_y)) + (y - of_y),
        }
    }

    pub(crate) fn to_f64(self) -> f64 {
        self.high + self.low
    }

    fn sqrt(self) -> Self {
        if self.high <= 0.0 {
            return ZERO;
        }
        let root = Self::from(self.high.sqrt());
        root + (self - root * root) / (root + root)
    }

    /// Sine and cosine of an angle, by quadrant and Taylor series.
    fn sin_cos(angle: f64) -> [Self; 2] {
        let quarters = (angle / HALF_PI.high).round();
        let x = Self::from(angle) - HALF_PI * quarters.into();
        let square = x * x;
        let (mut sin, mut cos) = (ZERO, ZERO);
        let mut term = Self::from(1.0);
        // 0.8^28 / 28! = 6e-33.
        for order in 0..29 {
            match order % 4 {
                0 => cos = cos + term,
                1 => sin = sin + term,
                2 => cos = cos - term,
                _ => sin = sin - term,
            }
            term = term * x / Self::from(f64::from(order + 1));
        }
        debug_assert!(square.high < 0.7);
        match (quarters as i64).rem_euclid(4) {
            0 => [sin, cos],
            1 => [cos, -sin],
            2 => [-sin, -cos],
            _ => [-cos, sin],
        }
    }

    fn atan2(self, x: Self) -> Self {
        let guess = self.high.atan2(x.high);
        let [sin, cos] = Self::sin_cos(guess);
        let rest = (self * cos - x * sin) / (x * cos + self * sin);
        Self::from(guess) + rest - rest * rest * rest / Self::from(3.0)
    }
}

impl From<f64> for Dd {
    fn from(high: f64) -> Self {
        Self { high, low: 0.0 }
    }
}

impl Add for Dd {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let high = Self::sum(self.high, other.high);
        let low = Self::sum(self.low, other.low);
        let sum = Self::sum(high.high, high.low + low.high);
        Self::sum(sum.high, sum.low + low.low)
    }
}

impl Neg for Dd {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            high: -self.high,
            low: -self.low,
        }
    }
}

impl Sub for Dd {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Dd {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let product = self.high * other.high;
        let lost = self.high.mul_add(other.high, -product);
        Self::sum(
            product,
            lost + self.high * other.low + self.low * other.high,
        )
    }
}

impl Div for Dd {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * first.into();
        let second = rest.high / other.high;
        let third = (rest - other * second.into()).high / other.high;
        Self::sum(first, second) + third.into()
    }
}

/// A vector of them.
pub(crate) type Vector = [Dd; 3];

pub(crate) fn vector(v: DVec3) -> Vector {
    v.to_array().map(Dd::from)
}

pub(crate) fn rounded(v: Vector) -> DVec3 {
    DVec3::from_array(v.map(Dd::to_f64))
}

pub(crate) fn plus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|k| a[k] + b[k])
}

pub(crate) fn minus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|k| a[k] - b[k])
}

pub(crate) fn times(a: Vector, factor: Dd) -> Vector {
    a.map(|x| x * factor)
}

fn dot(a: Vector, b: Vector) -> Dd {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn length(a: Vector) -> Dd {
    dot(a, a).sqrt()
}

/// Light vector and solid angle.
pub(crate) type Light = (Vector, Dd);

/// The rectangle at `corner` with sides `u` and `v`, shining along u × v, at `x` in front of it, all of it.
///
/// G = d ∫∫ p/|p|⁴ and φ = d ∫∫ 1/|p|³ over coordinates (s, t) of the light's plane around the foot of x, distance d:
/// the parts of G along the sides integrate to arctangents over one side, the part across is the form factor of a parallel patch, φ is
/// the arctangent of a corner. Source: J. Howell, "A catalog of radiation heat transfer configuration factors", differential element
/// to finite rectangle in parallel and perpendicular planes.
pub(crate) fn rectangle([corner, u, v]: [DVec3; 3], x: Vector) -> Light {
    let (u, v) = (vector(u), vector(v));
    let across = cross(u, v);
    let unit = |side: Vector| times(side, Dd::from(1.0) / length(side));
    let frame = [unit(u), unit(v), unit(across)];
    let from_x = minus(vector(corner), x);
    let d = -dot(from_x, frame[2]);
    let s0 = dot(from_x, frame[0]);
    let t0 = dot(from_x, frame[1]);
    let (s, t) = ([s0, s0 + length(u)], [t0, t0 + length(v)]);

    // ∫ dt d/2 /(s²+t²+d²) between the sides.
    let half = Dd::from(0.5);
    let along = |near: [Dd; 2], other: [Dd; 2]| {
        let side = |at: Dd| {
            let reach = (at * at + d * d).sqrt();
            (other[1].atan2(reach) - other[0].atan2(reach)) / reach
        };
        d * half * (side(near[0]) - side(near[1]))
    };
    let (mut through, mut solid_angle) = (ZERO, ZERO);
    for (i, &s) in s.iter().enumerate() {
        for (k, &t) in t.iter().enumerate() {
            let (reach_s, reach_t) = ((s * s + d * d).sqrt(), (t * t + d * d).sqrt());
            let form = s / reach_s * t.atan2(reach_s) + t / reach_t * s.atan2(reach_t);
            let corner = (s * t).atan2(d * (s * s + t * t + d * d).sqrt());
            if i == k {
                through = through + half * form;
                solid_angle = solid_angle + corner;
            } else {
                through = through - half * form;
                solid_angle = solid_angle - corner;
            }
        }
    }
    let g = plus(
        plus(times(frame[0], along(s, t)), times(frame[1], along(t, s))),
        times(frame[2], -through),
    );
    (g, solid_angle)
}

/// The part of the same rectangle above the plane through `x` across `normal`.
pub(crate) fn rectangle_above([corner, u, v]: [DVec3; 3], x: Vector, normal: DVec3) -> Light {
    let (corner, u, v) = (vector(corner), vector(u), vector(v));
    let around = [
        corner,
        plus(corner, u),
        plus(plus(corner, u), v),
        plus(corner, v),
    ];
    let polygon = above(&around.map(|vertex| minus(vertex, x)), vector(normal));
    let count = polygon.len();
    if count < 3 {
        return ([ZERO; 3], ZERO);
    }
    let planes: Vec<Vector> = (0..count)
        .map(|i| cross(polygon[(i + 1) % count], polygon[i]))
        .collect();
    let mut g = [ZERO; 3];
    let mut solid_angle = HALF_PI * Dd::from(4.0);
    for i in 0..count {
        let (start, end) = (polygon[i], polygon[(i + 1) % count]);
        let sine = length(planes[i]);
        let angle = sine.atan2(dot(start, end));
        g = plus(g, times(planes[i], angle * Dd::from(0.5) / sine));
        let turn = cross(planes[i], planes[(i + 1) % count]);
        solid_angle = solid_angle - length(turn).atan2(dot(planes[i], planes[(i + 1) % count]));
    }
    (g, solid_angle)
}

/// A convex polygon less what is below the plane through the origin.
fn above(polygon: &[Vector], normal: Vector) -> Vec<Vector> {
    let heights: Vec<Dd> = polygon.iter().map(|&p| dot(p, normal)).collect();
    let mut kept = Vec::new();
    for i in 0..polygon.len() {
        let next = (i + 1) % polygon.len();
        if heights[i].high > 0.0 {
            kept.push(polygon[i]);
        }
        if (heights[i].high > 0.0) != (heights[next].high > 0.0) {
            let part = heights[i] / (heights[i] - heights[next]);
            kept.push(plus(
                polygon[i],
                times(minus(polygon[next], polygon[i]), part),
            ));
        }
    }
    kept
}

/// Irradiance by what is left of `light` (triangles, seen from their front) behind `occluders`, at `x` with this normal.
///
/// Cuts the light, in space, by the planes through receiver and sides of occluders, keeps what is outside of any, and adds up Lambert's
/// formula. Occluders lie between receiver and light.
pub(crate) fn irradiance_behind(
    x: DVec3,
    normal: DVec3,
    light: &[[DVec3; 3]],
    occluders: &[[DVec3; 3]],
) -> f64 {
    let (x, normal) = (vector(x), vector(normal));
    let seen = |triangle: &[DVec3; 3]| triangle.map(|vertex| minus(vector(vertex), x)).to_vec();
    let mut pieces: Vec<Vec<Vector>> = light
        .iter()
        .map(|triangle| above(&seen(triangle), normal))
        .collect();
    for occluder in occluders.iter().map(seen) {
        let planes = [0, 1, 2].map(|k| cross(occluder[k], occluder[(k + 1) % 3]));
        let volume = dot(planes[0], occluder[2]);
        if volume.high == 0.0 {
            continue;
        }
        let planes = planes.map(|plane| {
            if volume.high < 0.0 {
                plane.map(|x| -x)
            } else {
                plane
            }
        });
        let mut next = Vec::new();
        for mut rest in pieces {
            for plane in planes {
                next.push(above(&rest, plane.map(|x| -x)));
                rest = above(&rest, plane);
            }
        }
        next.retain(|piece| piece.len() > 2);
        pieces = next;
    }
    let mut sum = ZERO;
    for piece in pieces {
        for k in 0..piece.len() {
            let (a, b) = (piece[k], piece[(k + 1) % piece.len()]);
            let w = cross(minus(b, a), a);
            let s = length(w);
            if s.high > 0.0 {
                let angle = s.atan2(dot(a, b));
                sum = sum + dot(w, normal) * angle * Dd::from(0.5) / s;
            }
        }
    }
    sum.to_f64()
}

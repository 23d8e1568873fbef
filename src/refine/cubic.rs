//! The surface over a triangle: a cubic with the values and derivatives of its corners, smooth across the sides.
//!
//! R. Clough and J. Tocher, "Finite element stiffness matrices for analysis of plate bending", 1965, reduced by making the derivative
//! across each side linear along it; in Bézier form after G. Farin, "Triangular Bernstein–Bézier patches", Computer Aided Geometric
//! Design 3, 1986. It needs nothing but what the corners know, and gives back every quadratic as it is.

use glam::DVec2;

/// Values and derivatives at a corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner<const K: usize> {
    pub(super) place: DVec2,
    pub(super) value: [f64; K],
    /// Along columns and rows, per cell.
    pub(super) slopes: [[f64; K]; 2],
}

/// Three cubics that meet in the middle of the triangle.
#[derive(Debug)]
pub(super) struct Patch<const K: usize> {
    corners: [[f64; K]; 3],
    /// On side k, which runs from corner k to corner k + 1: the control points a third and two thirds along.
    sides: [[[f64; K]; 2]; 3],
    /// A third of the way from each corner to the middle.
    spokes: [[f64; K]; 3],
    /// Beside the middle of each side.
    beside: [[f64; K]; 3],
    /// Two thirds of the way from each corner to the middle.
    inner: [[f64; K]; 3],
    middle: [f64; K],
}

fn combined<const K: usize, const N: usize>(terms: [(f64, &[f64; K]); N]) -> [f64; K] {
    std::array::from_fn(|k| terms.iter().map(|(weight, term)| weight * term[k]).sum())
}

impl<const K: usize> Patch<K> {
    pub(super) fn new(corners: &[Corner<K>; 3]) -> Self {
        let next = |corner: usize| (corner + 1) % 3;
        let last = |corner: usize| (corner + 2) % 3;
        let towards = |from: usize, to: usize| -> [f64; K] {
            let step = (corners[to].place - corners[from].place) / 3.0;
            let [along, down] = &corners[from].slopes;
            combined([(1.0, &corners[from].value), (step.x, along), (step.y, down)])
        };
        let third = 1.0 / 3.0;
        let sides: [_; 3] = std::array::from_fn(|k| [towards(k, next(k)), towards(next(k), k)]);
        let spokes: [_; 3] = std::array::from_fn(|k| {
            combined([
                (third, &corners[k].value),
                (third, &sides[k][0]),
                (third, &sides[last(k)][1]),
            ])
        });
        let centroid = corners.iter().map(|corner| corner.place).sum::<DVec2>() / 3.0;
        let beside: [_; 3] = std::array::from_fn(|k| {
            let (a, b) = (&corners[k], &corners[next(k)]);
            let side = b.place - a.place;
            let share = (centroid - a.place).dot(side) / side.length_squared();
            let [first, second] = &sides[k];
            std::array::from_fn(|c| {
                // Derivative across the side at both ends, and their mean in between.
                let start = spokes[k][c] - a.value[c] - share * (first[c] - a.value[c]);
                let end = spokes[next(k)][c] - second[c] - share * (b.value[c] - second[c]);
                first[c] + share * (second[c] - first[c]) + 0.5 * (start + end)
            })
        });
        let inner: [_; 3] = std::array::from_fn(|k| {
            combined([
                (third, &spokes[k]),
                (third, &beside[k]),
                (third, &beside[last(k)]),
            ])
        });
        let middle = combined([(third, &inner[0]), (third, &inner[1]), (third, &inner[2])]);
        Self {
            corners: std::array::from_fn(|k| corners[k].value),
            sides,
            spokes,
            beside,
            inner,
            middle,
        }
    }

    /// The value at barycentric `weights`, which sum up to 1. A little outside of the triangle the cubics go on.
    pub(super) fn value(&self, weights: [f64; 3]) -> [f64; K] {
        let (k, [a, b, c]) = sub_triangle(weights);
        let next = (k + 1) % 3;
        combined([
            (a * a * a, &self.corners[k]),
            (b * b * b, &self.corners[next]),
            (c * c * c, &self.middle),
            (3.0 * a * a * b, &self.sides[k][0]),
            (3.0 * a * b * b, &self.sides[k][1]),
            (3.0 * a * a * c, &self.spokes[k]),
            (3.0 * b * b * c, &self.spokes[next]),
            (3.0 * a * c * c, &self.inner[k]),
            (3.0 * b * c * c, &self.inner[next]),
            (6.0 * a * b * c, &self.beside[k]),
        ])
    }

    /// The derivatives along columns and rows; `slopes` are those of the barycentric weights.
    pub(super) fn slopes(&self, weights: [f64; 3], slopes: &[DVec2; 3]) -> [[f64; K]; 2] {
        let (k, [a, b, c]) = sub_triangle(weights);
        let (next, last) = ((k + 1) % 3, (k + 2) % 3);
        let along_a = combined([
            (3.0 * a * a, &self.corners[k]),
            (6.0 * a * b, &self.sides[k][0]),
            (3.0 * b * b, &self.sides[k][1]),
            (6.0 * a * c, &self.spokes[k]),
            (3.0 * c * c, &self.inner[k]),
            (6.0 * b * c, &self.beside[k]),
        ]);
        let along_b = combined([
            (3.0 * b * b, &self.corners[next]),
            (3.0 * a * a, &self.sides[k][0]),
            (6.0 * a * b, &self.sides[k][1]),
            (6.0 * b * c, &self.spokes[next]),
            (3.0 * c * c, &self.inner[next]),
            (6.0 * a * c, &self.beside[k]),
        ]);
        let along_c = combined([
            (3.0 * c * c, &self.middle),
            (3.0 * a * a, &self.spokes[k]),
            (3.0 * b * b, &self.spokes[next]),
            (6.0 * a * c, &self.inner[k]),
            (6.0 * b * c, &self.inner[next]),
            (6.0 * a * b, &self.beside[k]),
        ]);
        let steps = [
            slopes[k] - slopes[last],
            slopes[next] - slopes[last],
            3.0 * slopes[last],
        ];
        [0, 1].map(|axis| {
            combined([
                (steps[0][axis], &along_a),
                (steps[1][axis], &along_b),
                (steps[2][axis], &along_c),
            ])
        })
    }
}

/// The side that a place is nearest to in barycentric weights, and its weights in the triangle of that side and the middle.
fn sub_triangle(weights: [f64; 3]) -> (usize, [f64; 3]) {
    let opposite = (1..3).fold(
        0,
        |best, k| {
            if weights[k] < weights[best] { k } else { best }
        },
    );
    let k = (opposite + 1) % 3;
    let least = weights[opposite];
    let a = weights[k] - least;
    let b = weights[(k + 1) % 3] - least;
    (k, [a, b, 3.0 * least])
}

/// Barycentric weights of a place in a triangle, and their derivatives; `None` when it has no area to speak of.
pub(super) fn weights_in(places: &[DVec2; 3], place: DVec2) -> Option<([f64; 3], [DVec2; 3])> {
    let slopes = weight_slopes(places)?;
    Some((weights_at(places, &slopes, place), slopes))
}

/// Derivatives of the barycentric weights.
pub(super) fn weight_slopes(places: &[DVec2; 3]) -> Option<[DVec2; 3]> {
    let [a, b, c] = *places;
    let doubled = (b - a).perp_dot(c - a);
    let longest = (b - a)
        .length_squared()
        .max((c - a).length_squared())
        .max((c - b).length_squared());
    // A height of a millionth of the side: below it, weights are noise.
    if doubled.abs() <= 1e-6 * longest {
        return None;
    }
    Some([
        (c - b).perp() / doubled,
        (a - c).perp() / doubled,
        (b - a).perp() / doubled,
    ])
}

pub(super) fn weights_at(places: &[DVec2; 3], slopes: &[DVec2; 3], place: DVec2) -> [f64; 3] {
    let second = slopes[1].dot(place - places[0]);
    let third = slopes[2].dot(place - places[0]);
    [1.0 - second - third, second, third]
}

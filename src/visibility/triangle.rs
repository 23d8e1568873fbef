//! A straight line against a triangle, without cracks between neighbours.
//!
//! Which triangle a line goes through is decided by signs of two-dimensional edge functions after shearing the line onto an axis
//! (Woop, Benthin and Wald, "Watertight ray/triangle intersection", JCGT 2(1), 2013). A vertex is sheared the same way in every triangle
//! that shares it and an edge function only changes its sign when the edge is walked the other way, so a line that passes between two
//! neighbours passes neither. Zero counts as inside. The paper repeats the test in higher precision where a value is zero; here that is
//! a difference of products with a fused multiply-add (Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm for the
//! accurate computation of 2x2 determinants", Math. Comp. 82, 2013), whose sign is right.
//!
//! Whether the line is long enough is not decided by a distance along it but by the heights of its end points above the triangle's
//! plane. A distance would have to grow without limit for grazing lines; the rounding of a point that was put on a plane does not.

use glam::DVec3;

/// How many units of rounding ([`f64::EPSILON`]) a point may be off the plane it was put on, relative to the largest coordinate
/// involved.
///
/// A vertex is a matrix product and a sum (4 roundings), a point of a triangle a weighted sum of three vertices (5), its height another
/// product and sum (8); 256 leaves a factor of 15 for points that went through a few more transformations. Smaller shadows surfaces by
/// themselves; larger loses occluders closer than it to an end point: at 1 km from the origin that is 6e-11 m.
pub(super) const ROUNDING: f64 = 256.0 * f64::EPSILON;

/// A line with a direction, prepared for many triangles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    origin: DVec3,
    direction: DVec3,
    /// Axis along which it is longest, and the two others.
    axes: [usize; 3],
    /// What moves a point along the two others so that the line becomes the longest axis.
    shear: [f64; 2],
}

/// Where a [`Line`] goes through a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// Barycentric weights of the three vertices, not negative; their sum is 1.
    pub(super) weights: [f64; 3],
}

/// On which side of a triangle's plane a point lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Front,
    /// On the plane, as far as rounding lets one tell.
    On,
    Back,
}

/// The plane of a triangle, and how well its vertices determine it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    corner: DVec3,
    /// Twice the area times the unit front normal.
    area_vector: DVec3,
    /// Its length.
    area: f64,
    /// Product of the two edge lengths that span it.
    spread: f64,
    /// Largest coordinate of the vertices.
    extent: f64,
}

impl Line {
    /// The line through `origin` along `direction`, of any length; `None` when the direction has none, or is not finite.
    #[inline]
    pub(super) fn new(origin: DVec3, direction: DVec3) -> Option<Self> {
        let size = direction.abs();
        let longest = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let axes = [longest, (longest + 1) % 3, (longest + 2) % 3];
        let length = direction[longest];
        (length != 0.0 && direction.is_finite() && origin.is_finite()).then(|| Self {
            origin,
            direction,
            axes,
            shear: [direction[axes[1]] / length, direction[axes[2]] / length],
        })
    }

    /// The axis along which it is longest and the two others, and the factors that shear the line onto the first.
    #[inline]
    pub(super) fn axes(&self) -> ([usize; 3], [f64; 2]) {
        (self.axes, self.shear)
    }

    /// Where it goes through `triangle`, borders included, in either direction from the origin. A triangle seen edge-on is missed.
    #[inline]
    pub(super) fn crosses(&self, triangle: &[DVec3; 3]) -> Option<Crossing> {
        let [a, b, c] = triangle.map(|vertex| self.sheared(vertex));
        let mut edges = [
            c[0] * b[1] - c[1] * b[0],
            a[0] * c[1] - a[1] * c[0],
            b[0] * a[1] - b[1] * a[0],
        ];
        if edges.contains(&0.0) {
            edges = [
                difference_of_products(c[0], b[1], c[1], b[0]),
                difference_of_products(a[0], c[1], a[1], c[0]),
                difference_of_products(b[0], a[1], b[1], a[0]),
            ];
        }
        let [u, v, w] = edges;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        (sum != 0.0).then(|| Crossing {
            weights: [u / sum, v / sum, w / sum],
        })
    }

    /// Parameter along the direction at a crossing of `triangle`.
    pub(super) fn parameter(&self, triangle: &[DVec3; 3], crossing: &Crossing) -> f64 {
        let axis = self.axes[0];
        let depth: f64 = triangle
            .iter()
            .zip(crossing.weights)
            .map(|(vertex, weight)| weight * (vertex[axis] - self.origin[axis]))
            .sum();
        depth / self.direction[axis]
    }

    /// The two coordinates of `point` relative to the line, seen along it.
    #[inline]
    fn sheared(&self, point: DVec3) -> [f64; 2] {
        let p = point - self.origin;
        let [z, x, y] = self.axes;
        [p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z]]
    }
}

impl Plane {
    /// The plane of `triangle`.
    #[inline]
    pub(super) fn new(triangle: &[DVec3; 3]) -> Self {
        let [a, b, c] = *triangle;
        let (ab, ac) = (b - a, c - a);
        let area_vector = ab.cross(ac);
        Self {
            corner: a,
            area_vector,
            area: area_vector.length(),
            spread: (ab.length_squared() * ac.length_squared()).sqrt(),
            extent: a.abs().max(b.abs()).max(c.abs()).max_element(),
        }
    }

    /// On which side `point` lies; `extent` is the largest coordinate of anything that was used to place it.
    #[inline]
    pub(super) fn side(&self, point: DVec3, extent: f64) -> Side {
        let offset = point - self.corner;
        self.side_within(offset, self.tolerance(ROUNDING, offset.length(), extent))
    }

    /// On which side `point` lies, with at most an eighth of the tolerance of [`Plane::side`]: points that all lie on one side this way
    /// have none between them that lies on the other side in the other way, although the tolerance depends on the point.
    #[inline]
    pub(super) fn side_strictly(&self, point: DVec3, extent: f64) -> Side {
        let offset = point - self.corner;
        let distance = offset.abs().max_element();
        self.side_within(offset, self.tolerance(0.125 * ROUNDING, distance, extent))
    }

    /// Whether `direction` runs towards the front (`Some(true)`), the back, or within the plane.
    pub(super) fn leaves(&self, direction: DVec3) -> Option<bool> {
        let height = self.area_vector.dot(direction);
        let tolerance = ROUNDING * self.spread * direction.length();
        (height.abs() > tolerance).then_some(height > 0.0)
    }

    fn side_within(&self, offset: DVec3, tolerance: f64) -> Side {
        let height = self.area_vector.dot(offset);
        if height > tolerance {
            Side::Front
        } else if height < -tolerance {
            Side::Back
        } else {
            Side::On
        }
    }

    /// Rounding of a height times `area`. A sliver's plane is uncertain by `spread / area` times more than that of an equilateral
    /// triangle, growing with the distance from the corner.
    fn tolerance(&self, rounding: f64, distance: f64, extent: f64) -> f64 {
        rounding * (self.spread * distance + self.extent.max(extent) * self.area)
    }
}

/// Whether `triangle` stands strictly between the points `from` and `to` of `line`: it is crossed, and they lie on different sides of it.
#[inline]
pub(super) fn separates(
    triangle: &[DVec3; 3],
    line: &Line,
    from: DVec3,
    to: DVec3,
) -> Option<Crossing> {
    if !straddles(triangle, from, to) {
        return None;
    }
    let crossing = line.crosses(triangle)?;
    divides(triangle, from, to).then_some(crossing)
}

/// Whether the points lie on different sides of the plane of `triangle`.
pub(super) fn divides(triangle: &[DVec3; 3], from: DVec3, to: DVec3) -> bool {
    let plane = Plane::new(triangle);
    let extent = from.abs().max(to.abs()).max_element();
    matches!(
        (plane.side(from, extent), plane.side(to, extent)),
        (Side::Front, Side::Back) | (Side::Back, Side::Front)
    )
}

/// False where both ends are on one side, or one is on the plane by half the smallest tolerance it can have, which spares [`divides`]:
/// most triangles in the line's way are its ends' own, or beyond them.
#[inline(always)]
pub(super) fn straddles(triangle: &[DVec3; 3], from: DVec3, to: DVec3) -> bool {
    let [a, b, c] = *triangle;
    let area_vector = (b - a).cross(c - a);
    let heights = [area_vector.dot(from - a), area_vector.dot(to - a)];
    let extent = from.abs().max(to.abs()).max_element();
    let small = 0.25 * (ROUNDING * extent).powi(2) * area_vector.length_squared();
    (heights[0] > 0.0) != (heights[1] > 0.0)
        && heights.iter().all(|height| height * height >= small)
}

/// Distance at which `line`, of unit direction, meets `triangle` ahead of its origin, whether it meets the front, and where.
pub(super) fn meets(triangle: &[DVec3; 3], line: &Line) -> Option<(f64, bool, Crossing)> {
    let crossing = line.crosses(triangle)?;
    let plane = Plane::new(triangle);
    let extent = line.origin.abs().max_element();
    let front = match (
        plane.side(line.origin, extent),
        plane.leaves(line.direction)?,
    ) {
        (Side::Front, false) => true,
        (Side::Back, true) => false,
        _ => return None,
    };
    let distance = line.parameter(triangle, &crossing);
    (distance > 0.0).then_some((distance, front, crossing))
}

/// `a b - c d`, off by at most 1.5 units in the last place: the sign is right.
fn difference_of_products(a: f64, b: f64, c: f64, d: f64) -> f64 {
    let cd = c * d;
    let error = (-c).mul_add(d, cd);
    a.mul_add(b, -cd) + error
}

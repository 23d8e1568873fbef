//! Convex outlines in two dimensions, for the planes of a shaft.

use glam::DVec3;

/// Corners of a light up to which every edge gets a plane of its own. A rounder light is bounded by eight edges; more would cost more
/// than they reject.
pub(super) const MAX_EDGES: usize = 12;

/// Edges of a convex outline of `light` in its plane: a point of each, and its outward normal within the plane.
pub(super) fn edges(light: &[DVec3], normal: DVec3) -> Vec<(DVec3, DVec3)> {
    let (x, y) = normal.any_orthonormal_pair();
    let flat: Vec<[f64; 2]> = light
        .iter()
        .map(|&vertex| [x.dot(vertex - light[0]), y.dot(vertex - light[0])])
        .collect();
    let hull = convex_hull(&flat);
    let normals: Vec<[f64; 2]> = if hull.len() <= MAX_EDGES {
        (0..hull.len())
            .map(|index| {
                let (a, b) = (hull[index], hull[(index + 1) % hull.len()]);
                [flat[b][1] - flat[a][1], flat[a][0] - flat[b][0]]
            })
            .collect()
    } else {
        (0..8)
            .map(|index| {
                let (sin, cos) = (f64::from(index) * std::f64::consts::FRAC_PI_4).sin_cos();
                [cos, sin]
            })
            .collect()
    };
    normals
        .into_iter()
        .filter_map(|[u, v]| {
            let outwards = (u * x + v * y).try_normalize()?;
            let support = hull
                .iter()
                .map(|&index| light[index])
                .max_by(|a, b| outwards.dot(*a).total_cmp(&outwards.dot(*b)))?;
            Some((support, outwards))
        })
        .collect()
}

/// Indices of the convex hull of `points`, counter-clockwise (A. M. Andrew, "Another efficient algorithm for convex hulls in two
/// dimensions", Information Processing Letters 9(5), 1979).
fn convex_hull(points: &[[f64; 2]]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_unstable_by(|&a, &b| {
        points[a][0]
            .total_cmp(&points[b][0])
            .then(points[a][1].total_cmp(&points[b][1]))
    });
    let mut hull: Vec<usize> = Vec::with_capacity(points.len() + 1);
    let extend = |hull: &mut Vec<usize>, keep: usize, index: usize| {
        while hull.len() >= keep + 2
            && cross(
                points[hull[hull.len() - 2]],
                points[hull[hull.len() - 1]],
                points[index],
            ) <= 0.0
        {
            hull.pop();
        }
        hull.push(index);
    };
    for &index in &order {
        extend(&mut hull, 0, index);
    }
    let lower = hull.len() - 1;
    for &index in order.iter().rev().skip(1) {
        extend(&mut hull, lower, index);
    }
    hull.pop();
    hull
}

/// Outward normals of the lines that touch a rectangle at one corner and a set of points, with both on one side.
pub(super) fn tangents(corners: &[[f64; 2]; 4], points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut normals = Vec::new();
    for &corner in corners {
        for side in [1.0, -1.0] {
            // The point that lies farthest round to this side, seen from the corner.
            let mut touched = points[0];
            for &point in points {
                if side * cross(corner, touched, point) < 0.0 {
                    touched = point;
                }
            }
            let inside = |point: &[f64; 2]| side * cross(corner, touched, *point) >= 0.0;
            if touched != corner && points.iter().all(inside) && corners.iter().all(inside) {
                let along = [touched[0] - corner[0], touched[1] - corner[1]];
                normals.push([side * along[1], -side * along[0]]);
            }
        }
    }
    normals
}

/// Twice the area of the triangle `abc`, positive when counter-clockwise.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

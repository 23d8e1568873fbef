//! The outline of a region of polygons.
//!
//! An edge that two members walk in opposite directions is inside; what is left over is the outline, with the region on its left. As
//! only opposite pairs are taken away, every integral along all edges, the area among them, keeps its value.

use std::collections::BTreeMap;

use glam::DVec3;

/// Closed contours around the region that `members` (loops of vertex numbers, counter-clockwise) cover: counter-clockwise around the
/// outside, clockwise around holes, those around more area first. None meets a vertex twice.
///
/// `normal`: unit front normal. `tolerance`: metres by which a vertex may be off the line of its neighbours to be left out. Parts where
/// the outline runs to and fro without area are left out when they stand alone.
pub(super) fn outline(
    members: &[&[u32]],
    positions: &[DVec3],
    normal: DVec3,
    tolerance: f64,
) -> Vec<Vec<DVec3>> {
    let mut contours: Vec<(f64, Vec<DVec3>)> = loops(&border(members))
        .into_iter()
        .map(|contour| {
            let contour: Vec<DVec3> = contour
                .iter()
                .map(|&vertex| positions[vertex as usize])
                .collect();
            straightened(&contour, tolerance)
        })
        .filter(|contour| contour.len() >= 3)
        .map(|contour| (signed_area(&contour, normal), contour))
        .collect();
    contours.sort_by(|a, b| b.0.total_cmp(&a.0));
    contours.into_iter().map(|(_, contour)| contour).collect()
}

/// Area within `contour`, negative when it runs clockwise around `normal`.
fn signed_area(contour: &[DVec3], normal: DVec3) -> f64 {
    let sum: DVec3 = contour
        .windows(2)
        .map(|edge| (edge[0] - contour[0]).cross(edge[1] - contour[0]))
        .sum();
    0.5 * normal.dot(sum)
}

/// Directed edges that no opposite one cancels, ascending.
fn border(members: &[&[u32]]) -> Vec<(u32, u32)> {
    let mut edges: Vec<(u32, u32, bool)> = Vec::with_capacity(3 * members.len());
    for member in members {
        for (index, &a) in member.iter().enumerate() {
            let b = member[(index + 1) % member.len()];
            edges.push((a.min(b), a.max(b), a > b));
        }
    }
    edges.sort_unstable();
    let mut border = Vec::new();
    for run in edges.chunk_by(|p, q| (p.0, p.1) == (q.0, q.1)) {
        let (low, high, _) = run[0];
        let backwards = run.iter().filter(|edge| edge.2).count();
        let forwards = run.len() - backwards;
        border.extend(std::iter::repeat_n(
            (low, high),
            forwards.saturating_sub(backwards),
        ));
        border.extend(std::iter::repeat_n(
            (high, low),
            backwards.saturating_sub(forwards),
        ));
    }
    border.sort_unstable();
    border
}

/// Takes `edges` (ascending) apart into closed loops that meet no vertex twice: where the region touches itself at a vertex, one loop
/// ends and another begins.
///
/// As many edges enter a vertex as leave it, so a walk along unused edges can only end where it started. Whenever it comes back to a
/// vertex, what lies between is a loop and is taken out.
fn loops(edges: &[(u32, u32)]) -> Vec<Vec<u32>> {
    let mut found = Vec::new();
    // For the first edge of each vertex: how many of its edges have been used.
    let mut used = vec![0; edges.len()];
    let mut leave = |vertex: u32| {
        let first = edges.partition_point(|edge| edge.0 < vertex);
        let edge = edges.get(first + used.get(first)?)?;
        (edge.0 == vertex).then(|| {
            used[first] += 1;
            edge.1
        })
    };
    for &(start, _) in edges {
        let mut path = vec![start];
        let mut place_of = BTreeMap::from([(start, 0)]);
        while let Some(next) = path.last().and_then(|&last| leave(last)) {
            match place_of.get(&next) {
                Some(&place) => {
                    found.push(path[place..].to_vec());
                    for passed in path.drain(place + 1..) {
                        place_of.remove(&passed);
                    }
                }
                None => {
                    place_of.insert(next, path.len());
                    path.push(next);
                }
            }
        }
    }
    found
}

/// `contour` without the vertices that lie within `tolerance` of the segment between those kept before and after them.
///
/// D. Douglas and T. Peucker, "Algorithms for the reduction of the number of points required to represent a digitized line", The
/// Canadian Cartographer 10(2), 1973.
fn straightened(contour: &[DVec3], tolerance: f64) -> Vec<DVec3> {
    let n = contour.len();
    let centre = contour.iter().sum::<DVec3>() / n as f64;
    // The vertices farthest from the middle and from each other are corners, safe places to start.
    let start = farthest(contour, |vertex| vertex.distance_squared(centre));
    let opposite = farthest(contour, |vertex| vertex.distance_squared(contour[start]));
    let opposite = (opposite + n - start) % n;
    let at = |index: usize| contour[(start + index) % n];
    let mut keep = vec![false; n];
    keep[0] = true;
    keep[opposite] = true;
    let mut open = vec![(0, opposite), (opposite, n)];
    while let Some((first, last)) = open.pop() {
        let (a, b) = (at(first), at(last));
        let mut worst = (first, tolerance * tolerance);
        for index in first + 1..last {
            let off = distance_squared_to_segment(at(index), a, b);
            if off > worst.1 {
                worst = (index, off);
            }
        }
        if worst.0 > first {
            keep[worst.0] = true;
            open.extend([(first, worst.0), (worst.0, last)]);
        }
    }
    (0..n).filter(|&index| keep[index]).map(at).collect()
}

/// Index of the first point with the largest `measure`.
fn farthest(points: &[DVec3], measure: impl Fn(DVec3) -> f64) -> usize {
    let mut best = 0;
    for index in 1..points.len() {
        if measure(points[index]) > measure(points[best]) {
            best = index;
        }
    }
    best
}

fn distance_squared_to_segment(point: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let length_squared = along.length_squared();
    let offset = point - a;
    let position = along.dot(offset);
    if position <= 0.0 {
        offset.length_squared()
    } else if position >= length_squared {
        point.distance_squared(b)
    } else {
        along.cross(offset).length_squared() / length_squared
    }
}

//! The outline of a region of polygons.
//!
//! An edge that two members walk in opposite directions is inside; what is left over is the outline, with the region on its left. As
//! only opposite pairs are taken away, every integral along all edges, the area among them, keeps its value.

use glam::DVec3;

/// Closed contours around the region that `members` (loops of vertex numbers, counter-clockwise) cover: counter-clockwise around the
/// outside, clockwise around holes, those around more area first.
///
/// `normal`: unit front normal. `tolerance`: metres by which a vertex may be off the line of its neighbours to be left out. Parts where
/// the outline runs to and fro without area are left out when they stand alone.
pub(super) fn outline(
    members: &[&[u32]],
    positions: &[DVec3],
    normal: DVec3,
    tolerance: f64,
) -> Vec<Vec<DVec3>> {
    let mut contours: Vec<(f64, Vec<DVec3>)> = Loops::new(border(members), positions, normal)
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

/// Links border edges into closed loops. As many edges enter a vertex as leave it, so every walk comes back to its start.
struct Loops<'a> {
    edges: Vec<(u32, u32)>,
    used: Vec<bool>,
    positions: &'a [DVec3],
    normal: DVec3,
    next_start: usize,
}

impl<'a> Loops<'a> {
    fn new(edges: Vec<(u32, u32)>, positions: &'a [DVec3], normal: DVec3) -> Self {
        Self {
            used: vec![false; edges.len()],
            edges,
            positions,
            normal,
            next_start: 0,
        }
    }

    /// The edge that goes on after `edge`: where several leave its end, the first one clockwise from the way back, which bounds the
    /// same corner of the region. `start` may be taken although it is used: the loop is closed then.
    fn after(&self, edge: usize, start: usize) -> usize {
        let (from, at) = self.edges[edge];
        let first = self.edges.partition_point(|other| other.0 < at);
        let leaving = (first..self.edges.len())
            .take_while(|&other| self.edges[other].0 == at)
            .filter(|&other| other == start || !self.used[other]);
        let back = self.positions[from as usize] - self.positions[at as usize];
        leaving
            .map(|other| {
                let along =
                    self.positions[self.edges[other].1 as usize] - self.positions[at as usize];
                (self.clockwise_angle(back, along), other)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(start, |(_, other)| other)
    }

    /// Angle in (0, 2π] by which `from` turns clockwise around the normal to point along `to`.
    fn clockwise_angle(&self, from: DVec3, to: DVec3) -> f64 {
        let angle = self.normal.dot(to.cross(from)).atan2(from.dot(to));
        if angle > 0.0 {
            angle
        } else {
            angle + std::f64::consts::TAU
        }
    }
}

impl Iterator for Loops<'_> {
    type Item = Vec<u32>;

    fn next(&mut self) -> Option<Vec<u32>> {
        let start = (self.next_start..self.edges.len()).find(|&edge| !self.used[edge])?;
        self.next_start = start + 1;
        let mut contour = Vec::new();
        let mut edge = start;
        loop {
            self.used[edge] = true;
            contour.push(self.edges[edge].0);
            edge = self.after(edge, start);
            if edge == start {
                return Some(contour);
            }
        }
    }
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

//! Charts as xatlas gives them, and what is done about those that are no good.
//!
//! Now and then a chart comes back folded or blown up, because its parametrisation did not converge: it is flattened again in flat
//! regions. Charts that do not fit a page are cut, and a single triangle that does not fit is made smaller.

use glam::{DVec2, DVec3};

use super::footprint::signed_area;
use super::xatlas::Output;

/// A mesh at the scale of the world: all primitives, vertices numbered over all of them.
#[derive(Debug)]
pub(super) struct Surface {
    /// Vertices of each triangle.
    pub(super) triangles: Vec<[u32; 3]>,
    /// For each vertex the first one at the same position of the same primitive.
    pub(super) places: Vec<u32>,
    /// Positions in texels.
    pub(super) texels: Vec<DVec3>,
}

impl Surface {
    /// Corners of a triangle in texels.
    pub(super) fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|vertex| self.texels[vertex as usize])
    }

    fn area_vector(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.corners(triangle as usize);
        0.5 * (b - a).cross(c - a)
    }
}

/// Triangles that lie together in the plane.
#[derive(Clone, Debug, Default)]
pub(super) struct Chart {
    /// Triangles of the surface.
    pub(super) triangles: Vec<u32>,
    /// Corners of each of them in the plane, in texels.
    pub(super) corners: Vec<[DVec2; 3]>,
}

impl Chart {
    fn bounds(&self) -> (DVec2, DVec2) {
        self.corners.iter().flatten().fold(
            (DVec2::INFINITY, DVec2::NEG_INFINITY),
            |(low, high), &point| (low.min(point), high.max(point)),
        )
    }

    /// Width and height.
    pub(super) fn extent(&self) -> DVec2 {
        let (low, high) = self.bounds();
        high - low
    }

    /// Maps every corner.
    pub(super) fn map(&mut self, to: impl Fn(DVec2) -> DVec2) {
        for corner in self.corners.iter_mut().flatten() {
            *corner = to(*corner);
        }
    }

    /// Moves the chart so that its smallest coordinates lie on the first texel's centre: no row or column more than needed is read.
    pub(super) fn align(&mut self) {
        let (low, _) = self.bounds();
        self.map(|corner| corner - low + 0.5);
    }
}

/// Charts of xatlas; `handed_over` names the triangle of the surface of each triangle that it got.
pub(super) fn collect(output: &Output, handed_over: &[u32]) -> Vec<Chart> {
    let n_charts = output.vertices.iter().filter_map(|vertex| vertex.chart);
    let n_charts = n_charts.max().map_or(0, |last| last as usize + 1);
    let mut charts = vec![Chart::default(); n_charts];
    for (&triangle, corners) in handed_over.iter().zip(&output.triangles) {
        let vertices = corners.map(|corner| &output.vertices[corner as usize]);
        if vertices
            .iter()
            .all(|vertex| vertex.chart == vertices[0].chart)
            && let Some(chart) = vertices[0].chart
        {
            let chart = &mut charts[chart as usize];
            chart.triangles.push(triangle);
            chart.corners.push(vertices.map(|vertex| vertex.texcoord));
        }
    }
    charts.retain(|chart| !chart.triangles.is_empty());
    charts
}

/// A triangle that was made smaller to fit a page: texels per metre it has, relative to what was asked.
pub(super) type Shrunk = f64;

/// Mends what is wrong with a chart, which may take several in its place. None of them is wider or higher than `room` texels.
pub(super) fn mend(
    mut chart: Chart,
    surface: &Surface,
    room: f64,
    mended: &mut Vec<Chart>,
) -> Option<Shrunk> {
    undo_shrinking(&mut chart, surface, room);
    if is_flat(&chart, surface) {
        return cut(chart, room, mended);
    }
    let mut shrunk: Option<Shrunk> = None;
    for region in flat_regions(&chart.triangles, surface) {
        let smaller = cut(region, room, mended);
        shrunk = [shrunk, smaller].into_iter().flatten().reduce(f64::min);
    }
    shrunk
}

/// xatlas makes charts smaller that would not fit a page; they have to be cut instead.
fn undo_shrinking(chart: &mut Chart, surface: &Surface, room: f64) {
    if chart.extent().max_element() < room - 3.0 {
        return;
    }
    let plane: f64 = chart.corners.iter().map(|&c| signed_area(c).abs()).sum();
    let space: f64 = chart
        .triangles
        .iter()
        .map(|&triangle| 2.0 * surface.area_vector(triangle).length())
        .sum();
    let ratio = (space / plane).sqrt();
    if ratio > 1.0 && ratio.is_finite() {
        chart.map(|corner| corner * ratio);
    }
}

/// Whether a chart is what it should be, a flattened surface: not folded, nothing squeezed to nothing, not blown up.
fn is_flat(chart: &Chart, surface: &Surface) -> bool {
    /// Part of the area that may be folded back or squeezed. Good charts have none; a fold of a hundredth is a hairline.
    const WRONG: f64 = 0.01;
    /// A triangle is squeezed when it has less than this part of its area. Conformal maps shrink by half in bad cases.
    const SQUEEZED: f64 = 0.05;
    /// A chart is blown up when it is wider than this many times its surface. Half a tube is π/2 times as wide as its box.
    const BLOWN_UP: f64 = 3.0;
    let (mut forward, mut backward, mut space, mut squeezed) = (0.0, 0.0, 0.0, 0.0);
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (&triangle, &corners) in chart.triangles.iter().zip(&chart.corners) {
        let flat = 0.5 * signed_area(corners);
        let area = surface.area_vector(triangle).length();
        if flat > 0.0 {
            forward += flat;
        } else {
            backward -= flat;
        }
        space += area;
        if flat.abs() < SQUEEZED * area {
            squeezed += area;
        }
        for corner in surface.corners(triangle as usize) {
            low = low.min(corner);
            high = high.max(corner);
        }
    }
    // Charts are rounded up to whole texels, which blows up what is smaller.
    let largest = BLOWN_UP * (high - low).length() + 2.0;
    f64::min(forward, backward) <= WRONG * (forward + backward)
        && squeezed <= WRONG * space
        && chart.extent().max_element() <= largest
}

/// The triangles in connected, nearly flat regions, each projected onto the plane of its largest triangle.
fn flat_regions(triangles: &[u32], surface: &Surface) -> Vec<Chart> {
    /// Cosine of 5°: the projection shortens by 0.4 % at most.
    const FLAT: f64 = 0.996_2;
    let mut edges: Vec<([u32; 2], usize)> = Vec::with_capacity(3 * triangles.len());
    let edges_of = |index: usize| {
        let corners = surface.triangles[triangles[index] as usize];
        let [a, b, c] = corners.map(|vertex| surface.places[vertex as usize]);
        [
            [a.min(b), a.max(b)],
            [b.min(c), b.max(c)],
            [c.min(a), c.max(a)],
        ]
    };
    for index in 0..triangles.len() {
        edges.extend(edges_of(index).map(|edge| (edge, index)));
    }
    edges.sort_unstable();
    let area: Vec<DVec3> = triangles.iter().map(|&t| surface.area_vector(t)).collect();
    let mut by_area: Vec<usize> = (0..triangles.len()).collect();
    by_area.sort_by(|&a, &b| {
        area[b]
            .length()
            .total_cmp(&area[a].length())
            .then(a.cmp(&b))
    });

    let mut taken = vec![false; triangles.len()];
    let mut regions = Vec::new();
    for seed in by_area {
        if taken[seed] {
            continue;
        }
        let normal = area[seed].normalize_or(DVec3::Y);
        let mut members = Vec::new();
        let mut front = vec![seed];
        taken[seed] = true;
        while let Some(index) = front.pop() {
            members.push(index);
            for edge in edges_of(index) {
                let first = edges.partition_point(|other| other.0 < edge);
                for &(_, neighbour) in edges[first..].iter().take_while(|other| other.0 == edge) {
                    if !taken[neighbour]
                        && area[neighbour].dot(normal) >= FLAT * area[neighbour].length()
                    {
                        taken[neighbour] = true;
                        front.push(neighbour);
                    }
                }
            }
        }
        members.sort_unstable();
        let members: Vec<u32> = members.into_iter().map(|index| triangles[index]).collect();
        regions.push(project(members, normal, surface));
    }
    regions
}

/// Projects triangles along `normal`, their longest edge along the first axis.
fn project(triangles: Vec<u32>, normal: DVec3, surface: &Surface) -> Chart {
    let longest = triangles
        .iter()
        .flat_map(|&triangle| {
            let [a, b, c] = surface.corners(triangle as usize);
            [b - a, c - b, a - c]
        })
        .fold(DVec3::ZERO, |longest, edge| {
            if edge.length_squared() > longest.length_squared() {
                edge
            } else {
                longest
            }
        });
    let x = longest
        .reject_from_normalized(normal)
        .normalize_or(normal.any_orthonormal_vector());
    let y = normal.cross(x);
    // Far from the origin coordinates lose digits.
    let origin = surface.corners(triangles[0] as usize)[0];
    Chart {
        corners: triangles
            .iter()
            .map(|&triangle| {
                surface
                    .corners(triangle as usize)
                    .map(|corner| DVec2::new((corner - origin).dot(x), (corner - origin).dot(y)))
            })
            .collect(),
        triangles,
    }
}

/// Halves a chart along its longer side, between its triangles, until every piece fits; single triangles are made smaller.
fn cut(mut chart: Chart, room: f64, pieces: &mut Vec<Chart>) -> Option<Shrunk> {
    // Charts span one texel less than they read. A thousandth less again, as a chart that is made as large as that comes out rounded, and
    // another texel wide if upwards.
    let limit = room - 1.0 - 1e-3;
    let extent = chart.extent();
    let too_large = extent.max_element() / limit;
    if too_large <= 1.0 {
        pieces.push(chart);
        return None;
    }
    if chart.triangles.len() == 1 {
        chart.map(|corner| corner / too_large);
        pieces.push(chart);
        return Some(1.0 / too_large);
    }
    let axis = extent.max_position();
    let centroid = |corners: &[DVec2; 3]| (corners[0] + corners[1] + corners[2])[axis];
    let mut order: Vec<usize> = (0..chart.triangles.len()).collect();
    order.sort_by(|&a, &b| {
        centroid(&chart.corners[a])
            .total_cmp(&centroid(&chart.corners[b]))
            .then(a.cmp(&b))
    });
    let (low, high) = order.split_at(order.len() / 2);
    let mut shrunk: Option<Shrunk> = None;
    for half in [low, high] {
        let mut half = half.to_vec();
        half.sort_unstable();
        let piece = Chart {
            triangles: half.iter().map(|&index| chart.triangles[index]).collect(),
            corners: half.iter().map(|&index| chart.corners[index]).collect(),
        };
        shrunk = [shrunk, cut(piece, room, pieces)]
            .into_iter()
            .flatten()
            .reduce(f64::min);
    }
    shrunk
}

//! Keeps the second set of texture coordinates where its author made it for a lightmap.
//!
//! glTF does not say what `TEXCOORD_1` is for. It is taken for a lightmap layout when it gives every surface a place of its own inside
//! the unit square; layouts for tiled or shared textures leave the square, overlap themselves or use a corner of it.

use std::collections::BTreeSet;

use glam::{DVec2, Vec2};
use rayon::prelude::*;

use crate::error::Warnings;
use crate::scene::{Mesh, Primitive, Scene};

use super::footprint::{each_covered, signed_area};
use super::group::Group;
use super::split::Forest;
use super::{Layout, NO_CHART, Options, Unwrap, UnwrappedPrimitive, Uv};

/// How far coordinates may leave 0..1: what quantising to 16 bits and a few roundings in 32 bits can do. A texel of the largest page is 6e-5.
const OUTSIDE: f32 = 1e-4;

/// Part of the covered samples that may be covered twice. Rounding lets neighbours overlap along their seams by less than a sample; a
/// single pair of faces on one place is 0.1 % as soon as they are a thousandth of the layout.
const OVERLAP: f64 = 1e-3;

/// Samples along each side of the layout's bounding box when looking for overlaps. A face needs about 1/1000 of the side to be seen;
/// finer costs time by the square.
const SAMPLES: f64 = 1024.0;

/// Part of the surface that may have no area in the layout: faces that nobody sees are often collapsed on purpose.
const COLLAPSED: f64 = 0.01;

/// Part of the unit square that a layout has to use. Each instance gets a whole square, so that layouts below this waste nine texels of
/// ten; and they were made for something else: lightmap layouts seen so far use 0.49 to 0.99, coordinates for shared textures 0.06 at most.
const USED: f64 = 0.1;

/// Meshes whose authored layout is used.
pub(super) fn meshes_to_keep(
    scene: &Scene,
    groups: &[Group],
    options: &Options,
) -> BTreeSet<usize> {
    let meshes: BTreeSet<usize> = groups.iter().map(|group| group.mesh).collect();
    if options.uv == Uv::Unwrap {
        return BTreeSet::new();
    }
    let meshes: Vec<usize> = meshes.into_iter().collect();
    meshes
        .into_par_iter()
        .filter(|&mesh| {
            let mesh = &scene.meshes[mesh];
            lies_in_unit_square(mesh)
                && has_area(mesh)
                && (options.uv == Uv::Keep || (uses_square(mesh) && !overlaps(mesh)))
        })
        .collect()
}

fn lies_in_unit_square(mesh: &Mesh) -> bool {
    mesh.primitives
        .iter()
        .filter(|primitive| !primitive.triangles.is_empty())
        .all(|primitive| {
            let Some(texcoords) = primitive.texcoords.get(1) else {
                return false;
            };
            texcoords.len() == primitive.positions.len()
                && primitive.triangles.iter().flatten().all(|&vertex| {
                    // False for coordinates that are not a number as well.
                    let texcoord = texcoords[vertex as usize];
                    (-OUTSIDE..=1.0 + OUTSIDE).contains(&texcoord.x)
                        && (-OUTSIDE..=1.0 + OUTSIDE).contains(&texcoord.y)
                })
        })
}

/// Each triangle's layout, with its area in local space.
fn flat_triangles(mesh: &Mesh) -> impl Iterator<Item = ([DVec2; 3], f64)> {
    mesh.primitives.iter().flat_map(|primitive| {
        primitive.triangles.iter().map(|&triangle| {
            let [a, b, c] = triangle.map(|vertex| primitive.positions[vertex as usize].as_dvec3());
            let area = 0.5 * (b - a).cross(c - a).length();
            (texcoords(primitive, triangle), area)
        })
    })
}

fn texcoords(primitive: &Primitive, triangle: [u32; 3]) -> [DVec2; 3] {
    triangle.map(|vertex| primitive.texcoords[1][vertex as usize].as_dvec2())
}

/// Whether all but a little of the surface has area in the layout.
fn has_area(mesh: &Mesh) -> bool {
    let (mut all, mut collapsed) = (0.0, 0.0);
    for (flat, area) in flat_triangles(mesh) {
        all += area;
        if is_collapsed(flat) {
            collapsed += area;
        }
    }
    collapsed <= COLLAPSED * all && all > 0.0
}

/// Whether the layout uses enough of the unit square.
fn uses_square(mesh: &Mesh) -> bool {
    let used: f64 = flat_triangles(mesh)
        .map(|(flat, _)| 0.5 * signed_area(flat).abs())
        .sum();
    used >= USED
}

/// Whether a triangle has no area in the layout: thinner than coordinates of 32 bits near 1 resolve.
fn is_collapsed([a, b, c]: [DVec2; 3]) -> bool {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    signed_area([a, b, c]).abs() <= f64::from(f32::EPSILON) * longest
}

/// Whether the layout covers places twice: counts the samples of a grid that lie inside several triangles.
fn overlaps(mesh: &Mesh) -> bool {
    let (low, high) = flat_triangles(mesh).flat_map(|(flat, _)| flat).fold(
        (DVec2::INFINITY, DVec2::NEG_INFINITY),
        |(low, high), point| (low.min(point), high.max(point)),
    );
    let scale = SAMPLES / (high - low).max_element();
    let side = SAMPLES as usize;
    let mut hits = vec![0_u8; side * side];
    for (flat, _) in flat_triangles(mesh) {
        // Samples off any simple fraction: borders of authored layouts lie on those, and a sample on a shared border counts for both.
        let flat = flat.map(|point| (point - low) * scale - DVec2::new(0.381_966, 0.618_034));
        each_inside(flat, side, |x, y| {
            let hit = &mut hits[y * side + x];
            *hit = hit.saturating_add(1);
        });
    }
    let covered = hits.iter().filter(|&&hits| hits > 0).count();
    let doubly = hits.iter().filter(|&&hits| hits > 1).count();
    covered == 0 || doubly as f64 > OVERLAP * covered as f64
}

/// Visits the grid points in `0..side` that lie strictly inside a triangle.
fn each_inside(triangle: [DVec2; 3], side: usize, mut visit: impl FnMut(usize, usize)) {
    let [a, b, c] = triangle;
    let triangle = if signed_area(triangle) < 0.0 {
        [a, c, b]
    } else {
        triangle
    };
    let low = a.min(b).min(c).ceil().max(DVec2::ZERO);
    let high = a.max(b).max(c).floor().min(DVec2::splat(side as f64 - 1.0));
    let mut y = low.y;
    while y <= high.y {
        // Each edge bounds x from one side in this row.
        let (mut left, mut right) = (low.x, high.x);
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (triangle[from], triangle[to]);
            if from.y == to.y {
                continue;
            }
            let x = from.x + (to.x - from.x) * ((y - from.y) / (to.y - from.y));
            if to.y < from.y {
                left = left.max(x.floor() + 1.0);
            } else {
                right = right.min(x.ceil() - 1.0);
            }
        }
        let mut x = left;
        while x <= right {
            visit(x as usize, y as usize);
            x += 1.0;
        }
        y += 1.0;
    }
}

/// Lays out the mesh of `group` by its authored coordinates, at the density that the middle of its surface needs.
pub(super) fn layout(scene: &Scene, group: &Group, options: &Options) -> Layout {
    let mesh = &scene.meshes[group.mesh];
    let place = || format!("meshes[{}] ({})", mesh.source, mesh.name);
    let mut warnings = Warnings::default();
    // One texel more on each side than charts need: a lookup on the border of the unit square reads beyond it.
    let room = options.room() - 2;
    let wanted = side(mesh, group);
    let size = wanted.min(f64::from(room)).max(1.0) as u32;
    if wanted > f64::from(room) {
        warnings.push(
            "authored TEXCOORD_1 needs more than a page, has fewer texels per metre",
            format!("{}: {:.3} of them", place(), f64::from(room) / wanted),
        );
    }
    let (charts, n_charts) = charts(mesh);
    let mut charts = charts.into_iter();
    let unwrap = Unwrap {
        mesh: group.mesh,
        size: [size; 2],
        primitives: mesh
            .primitives
            .iter()
            .map(|primitive| UnwrappedPrimitive {
                source_vertices: (0..primitive.positions.len() as u32).collect(),
                texcoords: primitive.texcoords.get(1).map_or_else(Vec::new, |set| {
                    set.iter().map(|&uv| place_in(uv, size)).collect()
                }),
                triangles: primitive.triangles.clone(),
                source_triangles: (0..primitive.triangles.len() as u32).collect(),
                charts: charts.by_ref().take(primitive.triangles.len()).collect(),
            })
            .collect(),
        n_charts,
        authored: true,
        texels_per_metre: group.texels_per_metre,
    };
    if charts_touch(&unwrap) {
        warnings.push(
            "charts of the authored TEXCOORD_1 lie closer than 2 texels at this density, light bleeds between them",
            place(),
        );
    }
    Layout {
        unwraps: vec![unwrap],
        warnings,
    }
}

/// Texel coordinates; vertices that no triangle uses may have any.
fn place_in(uv: Vec2, size: u32) -> DVec2 {
    let uv = uv.as_dvec2();
    if uv.is_finite() {
        uv * f64::from(size)
    } else {
        DVec2::ZERO
    }
}

/// Texels along the unit square at which half of the surface has more texels per metre than asked and half has fewer.
fn side(mesh: &Mesh, group: &Group) -> f64 {
    /// A hundredth of a texel less is nothing; rounding of positions would otherwise make 20 texels 21.
    const NOTHING: f64 = 0.01;
    let mut needs: Vec<(f64, f64)> = Vec::new();
    for primitive in &mesh.primitives {
        for &triangle in &primitive.triangles {
            let [a, b, c] = triangle.map(|vertex| {
                group.texels_from_local * primitive.positions[vertex as usize].as_dvec3()
            });
            let doubled = (b - a).cross(c - a).length();
            let flat = texcoords(primitive, triangle);
            if doubled > 0.0 && !is_collapsed(flat) {
                needs.push(((doubled / signed_area(flat).abs()).sqrt(), doubled));
            }
        }
    }
    needs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let half = 0.5 * needs.iter().map(|need| need.1).sum::<f64>();
    let mut sum = 0.0;
    needs
        .iter()
        .find(|need| {
            sum += need.1;
            sum >= half
        })
        .map_or(1.0, |need| (need.0 - NOTHING).ceil())
}

/// The chart of every triangle over all primitives, and the number of charts. Triangles belong to one chart when they share an edge
/// both in space and in the layout.
fn charts(mesh: &Mesh) -> (Vec<u32>, u32) {
    /// A vertex by what it is, not by its index: bits of position and coordinates.
    type Corner = [u32; 5];
    let mut edges: Vec<([Corner; 2], u32)> = Vec::new();
    let mut collapsed = Vec::new();
    for primitive in &mesh.primitives {
        for &triangle in &primitive.triangles {
            let index = collapsed.len() as u32;
            let is_collapsed = is_collapsed(texcoords(primitive, triangle));
            collapsed.push(is_collapsed);
            if is_collapsed {
                continue;
            }
            let corners: [Corner; 3] = triangle.map(|vertex| {
                let [x, y, z] = primitive.positions[vertex as usize].to_array();
                let [u, v] = primitive.texcoords[1][vertex as usize].to_array();
                // −0 + 0 = +0: both zeros are one place.
                [x, y, z, u, v].map(|value| (value + 0.0).to_bits())
            });
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let (a, b) = (corners[a].min(corners[b]), corners[a].max(corners[b]));
                edges.push(([a, b], index));
            }
        }
    }
    edges.sort_unstable();
    let mut forest = Forest {
        parents: (0..collapsed.len() as u32).collect(),
    };
    for shared in edges.chunk_by(|a, b| a.0 == b.0) {
        for pair in shared.windows(2) {
            forest.join(pair[0].1, pair[1].1);
        }
    }
    let mut numbers = vec![NO_CHART; collapsed.len()];
    let mut n_charts = 0;
    for triangle in 0..collapsed.len() as u32 {
        if collapsed[triangle as usize] {
            continue;
        }
        // The root is the smallest index of its chart, so it has its number first.
        let root = forest.root(triangle);
        if root == triangle {
            numbers[triangle as usize] = n_charts;
            n_charts += 1;
        } else {
            numbers[triangle as usize] = numbers[root as usize];
        }
    }
    (numbers, n_charts)
}

/// Whether a texel is read by two charts.
fn charts_touch(unwrap: &Unwrap) -> bool {
    let width = unwrap.size[0] as usize + 2;
    let mut owners = vec![NO_CHART; width * (unwrap.size[1] as usize + 2)];
    let mut touch = false;
    for primitive in &unwrap.primitives {
        for (triangle, &chart) in primitive.triangles.iter().zip(&primitive.charts) {
            if chart == NO_CHART {
                continue;
            }
            let flat = triangle.map(|vertex| primitive.texcoords[vertex as usize]);
            each_covered(flat, |x, y| {
                // One texel beyond the square on each side; coordinates slightly outside are clamped.
                let column = (x + 1).clamp(0, width as i32 - 1) as usize;
                let row = (y + 1).clamp(0, unwrap.size[1] as i32 + 1) as usize;
                let owner = &mut owners[row * width + column];
                touch |= *owner != NO_CHART && *owner != chart;
                *owner = chart;
            });
        }
    }
    touch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{hash, unit_pair};

    #[test]
    fn rows_visit_the_grid_points_inside_a_triangle() {
        for case in 0..300 {
            let triangle = [0, 1, 2].map(|corner| {
                let [x, y] = unit_pair(hash(case, corner, 2));
                DVec2::new(x * 24.0 - 4.0, y * 24.0 - 4.0)
            });
            let mut visited = BTreeSet::new();
            each_inside(triangle, 16, |x, y| assert!(visited.insert((y, x))));
            for y in 0..16 {
                for x in 0..16 {
                    let point = DVec2::new(x as f64, y as f64);
                    let [a, b, c] = triangle;
                    let sides = [[a, b, point], [b, c, point], [c, a, point]].map(signed_area);
                    let inside = sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0);
                    assert_eq!(visited.contains(&(y, x)), inside, "case {case}: {point}");
                }
            }
        }
    }
}

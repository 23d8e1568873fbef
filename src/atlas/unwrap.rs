//! Lays out a mesh by cutting it into charts: prepares it for xatlas, mends what comes back, seats the charts and spells out the result
//! as [`Unwrap`]s, one per page that the mesh needs.

use std::collections::BTreeMap;

use glam::{DMat3, DVec2, DVec3};

use crate::error::{Result, Warnings};
use crate::scene::{Mesh, Scene};

use super::chart::{self, Chart, Surface};
use super::footprint::read;
use super::group::Group;
use super::place::{self, Outline};
use super::sliver::{self, Spot};
use super::split;
use super::xatlas::{self, Input, SPAN};
use super::{Layout, NO_CHART, Options, Unwrap, UnwrappedPrimitive};

/// xatlas rounds charts up to whole texels. Its own rounding would make a wall of 32 texels 33 wide; this much smaller, it stays at 32
/// (32 bits come with errors of 1e-6 after a few operations), and others are rounded up all the same.
const EXACT: f64 = 1.0 - 2e-5;

/// Lays out the mesh of `group`, in as many parts as pages it needs. No part when no triangle has area at this scale.
///
/// # Errors
/// `Interrupted`.
pub(super) fn layout(
    scene: &Scene,
    group: &Group,
    options: &Options,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Layout> {
    let mesh = &scene.meshes[group.mesh];
    let name = format!("meshes[{}] ({})", mesh.source, mesh.name);
    let mut warnings = Warnings::default();
    let surface = Surface {
        triangles: split::triangles(mesh),
        places: split::places(mesh),
        texels: mesh
            .primitives
            .iter()
            .flat_map(|primitive| &primitive.positions)
            .map(|position| group.texels_from_local * position.as_dvec3())
            .collect(),
    };
    let room = f64::from(options.room());
    let thin = sliver::slivers(&surface);
    let handed_over: Vec<u32> = (0..thin.len() as u32)
        .filter(|&triangle| !thin[triangle as usize])
        .collect();
    let Some(input) = input(mesh, group, &surface, &handed_over, room) else {
        warnings.push("mesh has no area at its scale, gets no texels", name);
        return Ok(Layout {
            unwraps: Vec::new(),
            warnings,
        });
    };
    let Some(output) = xatlas::unwrap(input, cancelled)? else {
        warnings.push("mesh cannot be cut into charts, gets no texels", name);
        return Ok(Layout {
            unwraps: Vec::new(),
            warnings,
        });
    };
    let mut charts = Vec::new();
    for chart in chart::collect(&output, &handed_over) {
        if let Some(ratio) = chart::mend(chart, &surface, room, &mut charts) {
            warnings.push(
                "triangle is larger than a page, has fewer texels per metre",
                format!("{name}: {ratio:.3} of them"),
            );
        }
    }
    let parts = seat(&mut charts, options);
    Ok(Layout {
        unwraps: spell_out(mesh, group, &surface, &charts, &parts),
        warnings,
    })
}

/// The mesh as xatlas wants it; `None` when no triangle has an area that it sees.
fn input(
    mesh: &Mesh,
    group: &Group,
    surface: &Surface,
    handed_over: &[u32],
    room: f64,
) -> Option<Input> {
    let triangles: Vec<[u32; 3]> = handed_over
        .iter()
        .map(|&triangle| surface.triangles[triangle as usize])
        .collect();
    let (low, high) = triangles
        .iter()
        .flatten()
        .map(|&vertex| surface.texels[vertex as usize])
        .fold(
            (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |(low, high), point| (low.min(point), high.max(point)),
        );
    let extent = (high - low).max_element();
    // A power of two, so that scaling rounds nothing.
    let units_per_texel = (SPAN / extent).log2().floor().exp2();
    let texels_per_unit = (EXACT / units_per_texel) as f32;
    // False for NaN as well; the smallest and largest floats are no scales to compute with.
    if !(extent > 0.0 && (1e-30..1e30).contains(&texels_per_unit)) {
        return None;
    }
    let centre = 0.5 * (low + high);
    // Vertices that no triangle uses may lie anywhere; they are put onto the border.
    let units: Vec<[f32; 3]> = surface
        .texels
        .iter()
        .map(|&texel| {
            ((texel - centre) * units_per_texel)
                .clamp(DVec3::splat(-SPAN), DVec3::splat(SPAN))
                .as_vec3()
                .to_array()
        })
        .collect();
    let has_area = |triangle: &[u32; 3]| {
        let [a, b, c] =
            triangle.map(|vertex| DVec3::from_array(units[vertex as usize].map(f64::from)));
        // Twice xatlas's limit, as it computes in 32 bits.
        (b - a).cross(c - a).length() > 4.0 * f64::from(f32::EPSILON)
    };
    if !triangles.iter().any(has_area) {
        return None;
    }
    // A flat patch may lie askew in its box, then it is √2 times as wide.
    let max_extent = room * std::f64::consts::FRAC_1_SQRT_2;
    Some(Input {
        normals: normals(mesh, group.texels_from_local),
        patches: split::patches(&triangles, &surface.places, &surface.texels, max_extent),
        positions: units.into_flattened(),
        indices: triangles.into_flattened(),
        texels_per_unit,
        // A closed line of twice a page's side spans one page at most.
        max_boundary: (2.0 * room * units_per_texel) as f32,
        max_chart: room as u32,
    })
}

/// Vertex normals at the scale of the world, if all primitives have them.
fn normals(mesh: &Mesh, linear: DMat3) -> Option<Vec<f32>> {
    let complete = mesh
        .primitives
        .iter()
        .all(|primitive| primitive.normals.len() == primitive.positions.len());
    if !complete {
        return None;
    }
    // The cofactor matrix is the inverse transpose up to a factor, and exists for flattening transforms too.
    let cofactor = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    );
    Some(
        mesh.primitives
            .iter()
            .flat_map(|primitive| &primitive.normals)
            .flat_map(|normal| {
                (cofactor * normal.as_dvec3())
                    .normalize_or(DVec3::Y)
                    .as_vec3()
                    .to_array()
            })
            .collect(),
    )
}

/// Moves every chart to its seat. Returns the part of each chart.
fn seat(charts: &mut [Chart], options: &Options) -> Vec<usize> {
    let margin = options.margin();
    for chart in charts.iter_mut() {
        chart.align();
    }
    let outlines: Vec<Outline> = charts
        .iter()
        .map(|chart| Outline::new(chart, margin))
        .collect();
    let seats = place::seats(&outlines, options.page_side() as i32);
    for ((chart, outline), seat) in charts.iter_mut().zip(&outlines).zip(&seats) {
        let offset = DVec2::from_array(seat.offset.map(f64::from));
        chart.map(|corner| seat.turn.apply(corner, outline.size) + offset);
    }
    seats.into_iter().map(|seat| seat.page).collect()
}

/// The layout as it leaves this stage. `parts` names the part of each chart.
fn spell_out(
    mesh: &Mesh,
    group: &Group,
    surface: &Surface,
    charts: &[Chart],
    parts: &[usize],
) -> Vec<Unwrap> {
    let mut spots: Vec<Option<Spot>> = vec![None; surface.triangles.len()];
    let mut owners = vec![NO_CHART; surface.triangles.len()];
    for (index, (chart, &part)) in charts.iter().zip(parts).enumerate() {
        for (&triangle, &corners) in chart.triangles.iter().zip(&chart.corners) {
            spots[triangle as usize] = Some(Spot { part, corners });
            owners[triangle as usize] = index as u32;
        }
    }
    let borrowed = sliver::borrow(surface, &spots);
    let n_parts = parts.iter().map(|part| part + 1).max().unwrap_or(0);
    let mut unwraps: Vec<Part> = (0..n_parts).map(|_| Part::new(mesh)).collect();
    let mut triangle = 0;
    for (index, primitive) in mesh.primitives.iter().enumerate() {
        for (local, vertices) in primitive.triangles.iter().enumerate() {
            let owner = owners[triangle];
            let spot = spots[triangle].or(borrowed[triangle]);
            // Where there is no neighbour either, any place will do.
            let spot = spot.unwrap_or(Spot {
                part: 0,
                corners: [DVec2::NAN; 3],
            });
            if let Some(part) = unwraps.get_mut(spot.part) {
                part.add(index, local as u32, *vertices, owner, spot.corners);
            }
            triangle += 1;
        }
    }
    unwraps.into_iter().map(|part| part.finish(group)).collect()
}

/// An [`Unwrap`] in the making.
struct Part {
    primitives: Vec<UnwrappedPrimitive>,
    /// New vertex by primitive, source vertex and place.
    vertices: BTreeMap<(usize, u32, [u64; 2]), u32>,
    /// Number in this part of each chart of the mesh.
    charts: BTreeMap<u32, u32>,
}

impl Part {
    fn new(mesh: &Mesh) -> Self {
        Self {
            primitives: mesh
                .primitives
                .iter()
                .map(|_| UnwrappedPrimitive::default())
                .collect(),
            vertices: BTreeMap::new(),
            charts: BTreeMap::new(),
        }
    }

    fn add(
        &mut self,
        primitive: usize,
        triangle: u32,
        vertices: [u32; 3],
        chart: u32,
        corners: [DVec2; 3],
    ) {
        let unwrapped = &mut self.primitives[primitive];
        let mut new = [0; 3];
        for corner in 0..3 {
            let place = corners[corner].to_array().map(f64::to_bits);
            let key = (primitive, vertices[corner], place);
            new[corner] = *self.vertices.entry(key).or_insert_with(|| {
                unwrapped.source_vertices.push(vertices[corner]);
                unwrapped.texcoords.push(corners[corner]);
                unwrapped.source_vertices.len() as u32 - 1
            });
        }
        unwrapped.triangles.push(new);
        unwrapped.source_triangles.push(triangle);
        let next = self.charts.len() as u32;
        unwrapped.charts.push(if chart == NO_CHART {
            NO_CHART
        } else {
            *self.charts.entry(chart).or_insert(next)
        });
    }

    /// Moves the rectangle to the origin and cuts it to the texels that are read.
    fn finish(mut self, group: &Group) -> Unwrap {
        let (low, high) = self
            .primitives
            .iter()
            .flat_map(|primitive| &primitive.texcoords)
            .filter(|texcoord| texcoord.is_finite())
            .fold(
                (DVec2::INFINITY, DVec2::NEG_INFINITY),
                |(low, high), &texcoord| (low.min(texcoord), high.max(texcoord)),
            );
        let columns = read(low.x, high.x);
        let rows = read(low.y, high.y);
        let origin = DVec2::new(f64::from(*columns.start()), f64::from(*rows.start()));
        for texcoord in self.primitives.iter_mut().flat_map(|p| &mut p.texcoords) {
            *texcoord = if texcoord.is_finite() {
                *texcoord - origin
            } else {
                DVec2::ZERO
            };
        }
        Unwrap {
            mesh: group.mesh,
            size: [columns, rows].map(|range| (range.end() - range.start() + 1) as u32),
            primitives: self.primitives,
            n_charts: self.charts.len() as u32,
            authored: false,
            texels_per_metre: group.texels_per_metre,
        }
    }
}

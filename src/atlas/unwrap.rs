//! Lays out a mesh by cutting it into charts: prepares the mesh for xatlas, judges what comes back and turns it into [`Unwrap`]s.

use glam::{DMat3, DVec2, DVec3};

use crate::error::{Result, Warnings};
use crate::scene::{Mesh, Scene};

use super::footprint::{read, signed_area};
use super::group::Group;
use super::split;
use super::xatlas::{self, Input, Output, SPAN};
use super::{Layout, NO_CHART, Options, Unwrap, UnwrappedPrimitive};

/// How often a mesh with a chart larger than a page is cut finer. Each time patches get half as wide; what is too wide after that is
/// one triangle, or a fan of triangles that wide.
const ATTEMPTS: u32 = 3;

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
    let place = || format!("meshes[{}] ({})", mesh.source, mesh.name);
    let mut warnings = Warnings::default();
    let Some(prepared) = Prepared::new(mesh, group) else {
        warnings.push("mesh has no area at its scale, gets no texels", place());
        return Ok(Layout {
            unwraps: Vec::new(),
            warnings,
        });
    };
    let mut page = Page::new(options);
    // A flat patch may lie askew in its box, then it is √2 times as wide.
    let mut max_extent = page.room * std::f64::consts::FRAC_1_SQRT_2;
    let mut attempt = 0;
    let flat = loop {
        let patches = split::patches(mesh, &prepared.texels, max_extent);
        let input = prepared.input(mesh, group, patches, &page);
        let Some(output) = xatlas::unwrap(input, cancelled)? else {
            warnings.push("mesh cannot be cut into charts, gets no texels", place());
            return Ok(Layout {
                unwraps: Vec::new(),
                warnings,
            });
        };
        let flat = Flat {
            triangles: split::triangles(mesh),
            output,
        };
        let worst = flat.worst(&prepared.texels, &page);
        attempt += 1;
        if worst.is_none_or(|worst| worst.n_triangles == 1) || attempt == ATTEMPTS {
            if let Some(worst) = worst {
                warnings.push(
                    "chart is larger than a page, has fewer texels per metre there",
                    format!("{}: {:.3} of them", place(), worst.ratio),
                );
            }
            break flat;
        }
        max_extent *= 0.5;
        page.max_boundary *= 0.5;
    };
    Ok(Layout {
        unwraps: flat.parts(mesh, group),
        warnings,
    })
}

/// What a page allows.
struct Page {
    /// Side that charts can use, in texels.
    room: f64,
    /// Longest boundary of a chart in texels.
    max_boundary: f64,
    /// See [`Input::margin`].
    margin: u32,
}

impl Page {
    fn new(options: &Options) -> Self {
        // Two texels less than there are, because positions of vertices come rounded.
        let room = f64::from(options.room()) - 2.0;
        Self {
            room,
            // A closed line of this length spans one page at most, and a square chart with it half a page: two of them share one.
            max_boundary: 2.0 * room,
            margin: options.margin(),
        }
    }
}

/// A mesh at the scale of the world.
struct Prepared {
    /// Positions of all primitives in texels.
    texels: Vec<DVec3>,
    /// The same for xatlas: centred, three per vertex.
    units: Vec<f32>,
    /// A power of two, so that scaling rounds nothing.
    units_per_texel: f64,
}

impl Prepared {
    /// `None` when no triangle has an area that xatlas sees.
    fn new(mesh: &Mesh, group: &Group) -> Option<Self> {
        let texels: Vec<DVec3> = mesh
            .primitives
            .iter()
            .flat_map(|primitive| &primitive.positions)
            .map(|position| group.texels_from_local * position.as_dvec3())
            .collect();
        let triangles = split::triangles(mesh);
        let (low, high) = triangles
            .iter()
            .flatten()
            .map(|&vertex| texels[vertex as usize])
            .fold(
                (DVec3::INFINITY, DVec3::NEG_INFINITY),
                |(low, high), point| (low.min(point), high.max(point)),
            );
        let extent = (high - low).max_element();
        if !(extent > 0.0 && extent.is_finite()) {
            return None;
        }
        let units_per_texel = (SPAN / extent).log2().floor().exp2();
        let centre = 0.5 * (low + high);
        // Vertices that no triangle uses may lie anywhere; they are put onto the border.
        let units: Vec<f32> = texels
            .iter()
            .flat_map(|&texel| {
                ((texel - centre) * units_per_texel)
                    .clamp(DVec3::splat(-SPAN), DVec3::splat(SPAN))
                    .as_vec3()
                    .to_array()
            })
            .collect();
        let has_area = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|vertex| {
                let first = 3 * vertex as usize;
                DVec3::new(
                    f64::from(units[first]),
                    f64::from(units[first + 1]),
                    f64::from(units[first + 2]),
                )
            });
            // Twice xatlas's limit, as it computes in 32 bits.
            (b - a).cross(c - a).length() > 4.0 * f64::from(f32::EPSILON)
        };
        let any = units_per_texel.is_finite() && triangles.iter().any(has_area);
        any.then_some(Self {
            texels,
            units,
            units_per_texel,
        })
    }

    fn input(&self, mesh: &Mesh, group: &Group, patches: Vec<u32>, page: &Page) -> Input {
        Input {
            positions: self.units.clone(),
            normals: normals(mesh, group.texels_from_local),
            indices: split::triangles(mesh).into_iter().flatten().collect(),
            patches,
            texels_per_unit: (1.0 / self.units_per_texel) as f32,
            max_boundary: (page.max_boundary * self.units_per_texel) as f32,
            area: group.area,
            page: page.room as u32,
            margin: page.margin,
        }
    }
}

/// Vertex normals at the scale of the world, if all primitives have them.
fn normals(mesh: &Mesh, linear: DMat3) -> Option<Vec<f32>> {
    let complete = |primitive: &crate::scene::Primitive| {
        !primitive.normals.is_empty() && primitive.normals.len() == primitive.positions.len()
    };
    if !mesh.primitives.iter().all(complete) {
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
                    .try_normalize()
                    .unwrap_or(DVec3::Y)
                    .as_vec3()
                    .to_array()
            })
            .collect(),
    )
}

/// A mesh that xatlas has laid out.
struct Flat {
    /// Triangles of all primitives, as they were handed over.
    triangles: Vec<[u32; 3]>,
    output: Output,
}

/// A chart that xatlas made smaller to fit a page.
#[derive(Clone, Copy)]
struct Shrunk {
    /// Texels per metre it got, relative to what was asked.
    ratio: f64,
    n_triangles: usize,
}

impl Flat {
    fn corners(&self, triangle: usize) -> [u32; 3] {
        let first = 3 * triangle;
        [
            self.output.indices[first],
            self.output.indices[first + 1],
            self.output.indices[first + 2],
        ]
    }

    fn texcoords(&self, triangle: usize) -> [DVec2; 3] {
        self.corners(triangle).map(|corner| {
            let [u, v] = self.output.vertices[corner as usize].texcoord;
            DVec2::new(f64::from(u), f64::from(v))
        })
    }

    /// Page and chart of a triangle.
    fn place(&self, triangle: usize) -> Option<(usize, u32)> {
        let corners = self.corners(triangle);
        let first = &self.output.vertices[corners[0] as usize];
        corners
            .iter()
            .all(|&corner| self.output.vertices[corner as usize].page == first.page)
            .then_some(())
            .and(first.page.map(|page| (page, first.chart)))
    }

    /// The chart that lost most when xatlas made it smaller to fit a page; one with several triangles, which can be cut, before others.
    fn worst(&self, texels: &[DVec3], page: &Page) -> Option<Shrunk> {
        /// Below the rounding of charts to whole texels (half a texel of a page) and above that of 32 bits.
        const NOTHING: f64 = 0.99;
        let n_charts = self.output.vertices.iter().filter(|v| v.page.is_some());
        let n_charts = n_charts.map(|v| v.chart + 1).max().unwrap_or(0);
        // Area in texels, area in the plane, extent, triangles.
        let mut sums = vec![(0.0, 0.0, DVec2::INFINITY, DVec2::NEG_INFINITY, 0); n_charts as usize];
        for (index, corners) in self.triangles.iter().enumerate() {
            let Some((_, chart)) = self.place(index) else {
                continue;
            };
            let [a, b, c] = corners.map(|vertex| texels[vertex as usize]);
            let flat = self.texcoords(index);
            let sum = &mut sums[chart as usize];
            sum.0 += (b - a).cross(c - a).length();
            sum.1 += signed_area(flat).abs();
            sum.2 = flat.iter().fold(sum.2, |low, &point| low.min(point));
            sum.3 = flat.iter().fold(sum.3, |high, &point| high.max(point));
            sum.4 += 1;
        }
        sums.into_iter()
            .filter(|&(_, _, low, high, _)| (high - low).max_element() > page.room - 3.0)
            .map(|(surface, plane, _, _, n_triangles)| Shrunk {
                ratio: f64::sqrt(plane / surface),
                n_triangles,
            })
            .filter(|shrunk| shrunk.ratio < NOTHING)
            .min_by(|a, b| {
                let can_be_cut = |shrunk: &Shrunk| shrunk.n_triangles > 1;
                can_be_cut(b)
                    .cmp(&can_be_cut(a))
                    .then(a.ratio.total_cmp(&b.ratio))
            })
    }

    /// One part per page, cropped to what is read.
    fn parts(&self, mesh: &Mesh, group: &Group) -> Vec<Unwrap> {
        let n_parts = (0..self.triangles.len())
            .filter_map(|triangle| self.place(triangle))
            .map(|(page, _)| page + 1)
            .max()
            .unwrap_or(0);
        let mut parts: Vec<Part> = (0..n_parts)
            .map(|_| Part::new(mesh, &self.output))
            .collect();
        let mut triangle = 0;
        for (primitive, source) in mesh.primitives.iter().enumerate() {
            let first_vertex = self.first_vertex(mesh, primitive);
            for local in 0..source.triangles.len() {
                let place = self.place(triangle);
                // A triangle without a place still belongs to the mesh: the first part takes it.
                if let Some(part) = parts.get_mut(place.map_or(0, |(page, _)| page)) {
                    let chart = place.map(|(_, chart)| chart);
                    part.add(self, primitive, first_vertex, (triangle, local), chart);
                }
                triangle += 1;
            }
        }
        parts.into_iter().map(|part| part.finish(group)).collect()
    }

    fn first_vertex(&self, mesh: &Mesh, primitive: usize) -> u32 {
        mesh.primitives[..primitive]
            .iter()
            .map(|primitive| primitive.positions.len() as u32)
            .sum()
    }
}

/// An [`Unwrap`] in the making.
struct Part {
    primitives: Vec<UnwrappedPrimitive>,
    /// New vertex of each vertex of xatlas, with and without a place.
    vertices: [Vec<u32>; 2],
    /// Number of each chart of xatlas in this part.
    charts: std::collections::BTreeMap<u32, u32>,
}

impl Part {
    fn new(mesh: &Mesh, output: &Output) -> Self {
        Self {
            primitives: mesh
                .primitives
                .iter()
                .map(|_| UnwrappedPrimitive::default())
                .collect(),
            vertices: [(); 2].map(|()| vec![u32::MAX; output.vertices.len()]),
            charts: std::collections::BTreeMap::new(),
        }
    }

    /// Adds `(triangle of the mesh, triangle of the primitive)`.
    fn add(
        &mut self,
        flat: &Flat,
        primitive: usize,
        first_vertex: u32,
        (triangle, local): (usize, usize),
        chart: Option<u32>,
    ) {
        let unwrapped = &mut self.primitives[primitive];
        let known = &mut self.vertices[usize::from(chart.is_none())];
        let corners = flat.corners(triangle).map(|corner| {
            let vertex = &mut known[corner as usize];
            if *vertex == u32::MAX {
                let copied = &flat.output.vertices[corner as usize];
                *vertex = unwrapped.source_vertices.len() as u32;
                unwrapped.source_vertices.push(copied.source - first_vertex);
                let [u, v] = copied.texcoord;
                unwrapped.texcoords.push(if chart.is_some() {
                    DVec2::new(f64::from(u), f64::from(v))
                } else {
                    DVec2::NAN
                });
            }
            *vertex
        });
        let next = self.charts.len() as u32;
        unwrapped.triangles.push(corners);
        unwrapped.source_triangles.push(local as u32);
        unwrapped
            .charts
            .push(chart.map_or(NO_CHART, |chart| *self.charts.entry(chart).or_insert(next)));
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

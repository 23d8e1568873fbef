//! The border to xatlas: the only file that calls it.
//!
//! xatlas (Jonathan Young, after Ignacio Castaño's thekla_atlas) is C++ with habits that this file shuts in:
//! - Its areas below `FLT_EPSILON` do not count, whatever the unit; so meshes come scaled to a fixed size and the density goes into
//!   the packing.
//! - Coordinates that are not finite, or huge, make it hang; callers hand over coordinates up to [`SPAN`].
//! - Dropping an instance joins its worker threads after a wake-up that they can miss, about once in 5,000 instances, and then waits for
//!   ever. So each instance lives on its own detached thread, which sends its result before it drops the instance. The same makes
//!   cancellation possible, which xatlas itself only looks at between connected surfaces.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use xatlas_rs::{ChartOptions, IndexData, MeshData, MeshDecl, PackOptions, Xatlas};

use crate::error::{Error, Result};

/// Size that meshes are scaled to, to within a factor of two. Triangles with edges below 3e-4 units do not count for xatlas, which then
/// is 2e-8 of the mesh and below what 32-bit positions resolve; areas of 1e9 are far from overflow.
pub(super) const SPAN: f64 = 16384.0;

/// A mesh as xatlas wants it.
pub(super) struct Input {
    /// Three per vertex, within ±[`SPAN`].
    pub(super) positions: Vec<f32>,
    /// Three per vertex, or none. xatlas prefers to cut where they jump.
    pub(super) normals: Option<Vec<f32>>,
    /// Three per triangle.
    pub(super) indices: Vec<u32>,
    /// One per triangle; charts never join different ones.
    pub(super) patches: Vec<u32>,
    /// Texels per unit of the positions.
    pub(super) texels_per_unit: f32,
    /// Longest boundary of a chart in units.
    pub(super) max_boundary: f32,
    /// Texels that the surface covers, about.
    pub(super) area: f64,
    /// Side of a page in texels.
    pub(super) page: u32,
    /// Texels that each chart keeps free around the texels that are read on it.
    pub(super) margin: u32,
}

/// Vertex of a chart.
pub(super) struct Vertex {
    /// Page it lies on; `None` when its triangles got no place.
    pub(super) page: Option<usize>,
    /// Chart, over all pages.
    pub(super) chart: u32,
    /// Texels from the top left corner of its page.
    pub(super) texcoord: [f32; 2],
    /// The vertex of the input it copies.
    pub(super) source: u32,
}

/// Charts of a mesh, packed.
pub(super) struct Output {
    /// Vertices of all charts.
    pub(super) vertices: Vec<Vertex>,
    /// Three per triangle of the input, in its order.
    pub(super) indices: Vec<u32>,
}

/// Cuts a mesh into charts and packs them. `None` when xatlas refuses the mesh, or its thread died.
///
/// # Errors
/// `Interrupted` when `cancelled` returns true meanwhile.
pub(super) fn unwrap(
    input: Input,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Output>> {
    let input = Arc::new(input);
    let (sender, receiver) = channel();
    let on_thread = Arc::clone(&input);
    let spawned = std::thread::Builder::new()
        .name("xatlas".to_owned())
        .spawn(move || {
            run(&on_thread, |output| {
                // Nobody listens any more after a cancellation.
                let _ = sender.send(output);
            });
        });
    match spawned {
        // Detached: see above. The input dies with the thread.
        Ok(_thread) => wait(&receiver, cancelled),
        Err(_) => {
            let mut result = None;
            run(&input, |output| result = output);
            Ok(result)
        }
    }
}

/// Waits for the thread's message and for the user, whoever comes first.
fn wait(
    receiver: &Receiver<Option<Output>>,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Output>> {
    /// Long enough to cost nothing, short enough that Ctrl-C feels immediate.
    const PATIENCE: Duration = Duration::from_millis(50);
    loop {
        match receiver.recv_timeout(PATIENCE) {
            Ok(output) => return Ok(output),
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
            Err(RecvTimeoutError::Timeout) if cancelled() => return Err(Error::Interrupted),
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

/// Tells `deliver` the result and drops the xatlas instance only after that.
fn run(input: &Input, deliver: impl FnOnce(Option<Output>)) {
    let declaration = MeshDecl {
        vertex_position_data: MeshData::Contiguous(&input.positions),
        vertex_normal_data: input.normals.as_deref().map(MeshData::Contiguous),
        index_data: Some(IndexData::U32(&input.indices)),
        face_material_data: Some(&input.patches),
        ..MeshDecl::default()
    };
    let mut xatlas = Xatlas::new();
    if xatlas.add_mesh(&declaration).is_err() {
        deliver(None);
        return;
    }
    xatlas.compute_charts(&ChartOptions {
        max_boundary_length: input.max_boundary,
        ..ChartOptions::default()
    });
    // A page of its own size wastes nothing on small meshes; it is not tried where it would be thrown away.
    let page = input.page as f64;
    let free = PackOptions {
        padding: input.margin,
        texels_per_unit: input.texels_per_unit,
        bilinear: true,
        ..PackOptions::default()
    };
    let mut packed = false;
    if input.area < 0.6 * page * page {
        xatlas.pack_charts(&free);
        packed = xatlas.width() <= input.page && xatlas.height() <= input.page;
    }
    if !packed {
        xatlas.pack_charts(&PackOptions {
            resolution: input.page,
            ..free
        });
    }
    deliver(read(&xatlas, input));
}

fn read(xatlas: &Xatlas<'_>, input: &Input) -> Option<Output> {
    if xatlas.mesh_count() != 1 {
        return None;
    }
    let meshes = xatlas.meshes();
    let mesh = meshes.first()?;
    if mesh.index_array.len() != input.indices.len() {
        return None;
    }
    let vertices = mesh
        .vertex_array
        .iter()
        .map(|vertex| Vertex {
            page: usize::try_from(vertex.atlas_index)
                .ok()
                .filter(|_| vertex.uv.iter().all(|x| x.is_finite())),
            chart: vertex.chart_index as u32,
            texcoord: vertex.uv,
            source: vertex.xref,
        })
        .collect();
    Some(Output {
        vertices,
        indices: mesh.index_array.to_vec(),
    })
}

//! The border to xatlas: the only file that calls it.
//!
//! xatlas (Jonathan Young, after Ignacio Castaño's `thekla_atlas`) is C++ with habits that this file shuts in:
//! - Its areas below `FLT_EPSILON` do not count, whatever the unit; so meshes come scaled to a fixed size and the density goes into
//!   the packing.
//! - Coordinates that are not finite, or huge, make it hang; callers hand over coordinates up to [`SPAN`].
//! - Dropping an instance joins its worker threads after a wake-up that they can miss, about once in 5,000 instances, and then waits for
//!   ever. So each instance lives on its own detached thread, which sends its result before it drops the instance. The same makes
//!   cancellation possible, which xatlas itself only looks at between connected surfaces.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use glam::DVec2;
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
    /// Longest boundary of a chart in units. Flat regions with sharp edges all around are not held to it.
    pub(super) max_boundary: f32,
    /// Charts wider or higher than this many texels are made smaller.
    pub(super) max_chart: u32,
}

/// Vertex of a chart.
pub(super) struct Vertex {
    /// Its chart; `None` when its triangles got no place.
    pub(super) chart: Option<u32>,
    /// Texels. Charts lie somewhere in the first quadrant; they may overlap where they have no area.
    pub(super) texcoord: DVec2,
}

/// Charts of a mesh.
pub(super) struct Output {
    /// Vertices of all charts.
    pub(super) vertices: Vec<Vertex>,
    /// For each triangle of the input, in its order, the vertices that copy its own.
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Cuts a mesh into charts and flattens them. `None` when xatlas refuses the mesh, or its thread died.
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
    // Charts come out flat from the packing only. Its result is not used: it reserves nothing for charts without area, tries places at
    // random, and cannot be cut at pages; so it does without padding.
    xatlas.pack_charts(&PackOptions {
        max_chart_size: input.max_chart,
        texels_per_unit: input.texels_per_unit,
        bilinear: false,
        ..PackOptions::default()
    });
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
        .map(|vertex| {
            let texcoord = DVec2::from_array(vertex.uv.map(f64::from));
            let chart = u32::try_from(vertex.chart_index).ok();
            Vertex {
                chart: chart.filter(|_| texcoord.is_finite()),
                texcoord,
            }
        })
        .collect();
    Some(Output {
        vertices,
        triangles: mesh.index_array.as_chunks().0.to_vec(),
    })
}

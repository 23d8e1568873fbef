//! Field → files: dilation, EXR, glTF, preview, manifest. Nothing appears under its final name before everything is written.

use std::path::{Path, PathBuf};

use crate::atlas::Atlas;
use crate::error::Result;
use crate::refine::Field;
use crate::scene::Scene;

/// How files are written.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Stores 32-bit floats instead of halves everywhere. Default: false; a map whose values do not fit into halves within the
    /// tolerance is stored in floats all the same, and the manifest says so.
    pub float: bool,
    /// Accepted error relative to the page's maximum, which decides between half and float. Range: 1e-6..=1. Default: 0.004.
    pub tolerance: f64,
    /// How many texels the borders of charts are continued outwards. Default: 4, the padding between charts.
    pub dilation: u32,
    /// Whether to write the tone-mapped preview.
    pub preview: bool,
    /// Whether to write the glTF file.
    pub glb: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            float: false,
            tolerance: 0.004,
            dilation: 4,
            preview: true,
            glb: true,
        }
    }
}

/// A lightmap page as it was written.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PageFiles {
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The maps, in the order of the field's planes, then the preview.
    pub maps: Vec<MapFile>,
}

/// One file of a page.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MapFile {
    /// Name of the plane, or `preview`.
    pub plane: String,
    /// File name, relative to the bake's directory.
    pub file: String,
    /// `half`, `float` or `srgb8`.
    pub precision: &'static str,
    /// Smallest stored value over all components (dilated texels included).
    pub min: f32,
    /// Largest stored value.
    pub max: f32,
}

/// A bake on its way to the disk.
///
/// Files go to a temporary folder beside the target; [`Writer::commit`] renames them into place. Dropping the writer removes the
/// temporary folder and leaves the previous bake as it was.
#[derive(Debug)]
pub struct Writer {
    _stub: PathBuf,
}

impl Writer {
    /// Opens a bake of the scene called `name` into `directory`, which need not exist; nothing is created under that name yet.
    ///
    /// # Errors
    /// `Io` when the parent folder cannot be written, or when `directory` is a file.
    pub fn create(_directory: &Path, _name: &str, _options: &Options) -> Result<Self> {
        unimplemented!()
    }

    /// Writes all planes of page `index`, dilated.
    ///
    /// # Errors
    /// `Io`.
    pub fn page(&mut self, _index: usize, _field: &Field) -> Result<PageFiles> {
        unimplemented!()
    }

    /// Writes `<name>.glb`: the document of `scene` with `TEXCOORD_1`, the extension and its mirror in extras.
    ///
    /// # Errors
    /// `Io`; `InvalidFile` when the document cannot be written again.
    pub fn glb(&mut self, _scene: &Scene, _atlas: &Atlas, _pages: &[PageFiles]) -> Result<()> {
        unimplemented!()
    }

    /// Writes `<name>.lumel.json`.
    ///
    /// # Errors
    /// `Io`.
    pub fn manifest(&mut self, _manifest: &serde_json::Value) -> Result<()> {
        unimplemented!()
    }

    /// Renames everything into place and removes files of the previous bake that this one no longer has. Returns the names of the
    /// files, sorted.
    ///
    /// # Errors
    /// `Io`.
    pub fn commit(self) -> Result<Vec<String>> {
        unimplemented!()
    }
}

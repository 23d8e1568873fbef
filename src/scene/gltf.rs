//! stub

use std::path::Path;

use crate::error::Result;

use super::{Options, Scene};

/// Reads a `.gltf` or `.glb`.
pub fn load(_path: &Path, _options: &Options) -> Result<Scene> {
    unimplemented!()
}

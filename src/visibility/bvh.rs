//! stub

use glam::DVec3;

use super::{Hit, Shaft, Visibility};
use crate::scene::Scene;

/// The occluding triangles of a scene.
#[derive(Debug)]
pub struct Occluders;

impl Occluders {
    /// Builds the hierarchy.
    #[must_use]
    pub fn build(_scene: &Scene) -> Self {
        unimplemented!()
    }

    /// Triangles that may stand in `shaft`, those accepted by `ignore` excepted, ascending. Never misses one that does.
    #[must_use]
    pub fn in_shaft(&self, _shaft: &Shaft, _ignore: &dyn Fn(u32) -> bool) -> Vec<u32> {
        unimplemented!()
    }
}

impl Visibility for Occluders {
    fn occluded(&self, _from: DVec3, _to: DVec3, _ignore: &dyn Fn(u32) -> bool) -> bool {
        unimplemented!()
    }

    fn closest(
        &self,
        _origin: DVec3,
        _direction: DVec3,
        _max_distance: f64,
        _ignore: &dyn Fn(u32) -> bool,
    ) -> Option<Hit> {
        unimplemented!()
    }
}

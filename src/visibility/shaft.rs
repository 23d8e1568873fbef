//! The region between a group of receivers and a light.

use glam::DVec3;

/// Convex region that holds every segment from a receiver to a light polygon, as far as it matters: above the horizons of the
/// receivers and in front of the light.
#[derive(Clone, Debug)]
pub struct Shaft;

impl Shaft {
    /// `receivers`: positions and unit normals. `light`: its vertices (any contour order) and its unit plane normal.
    #[must_use]
    pub fn new(_receivers: &[(DVec3, DVec3)], _light: &[DVec3], _light_normal: DVec3) -> Self {
        unimplemented!()
    }
}

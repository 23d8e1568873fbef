//! Bevy's `Lightmap`: E/π. The material's `lightmap_exposure` has to undo the camera's exposure.

use std::f32::consts::FRAC_1_PI;

use super::{Kind, Picture};
use crate::refine::Plane;

/// The irradiance over π.
pub(super) fn picture(irradiance: &Plane) -> Picture {
    Picture {
        name: "bevy",
        components: 3,
        slices: vec![irradiance.values.iter().map(|e| e * FRAC_1_PI).collect()],
        kind: Kind::Exr,
    }
}

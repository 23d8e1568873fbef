//! Light through glass.
//!
//! Surfaces that let light through are kept apart from those that stop it, so that scenes without any pay nothing for them. A segment
//! looks for them one by one, nearest first, until it arrives.

use glam::DVec3;

use super::bvh::Occluders;
use super::{Shaft, Visibility};

/// Layers that light passes through; behind more it counts as stopped. A stack of panes that is still bright after eight is hardly meant, and
/// without a limit a pile of thousand of them would cost as much.
pub const MAX_LAYERS: usize = 8;

impl Occluders<'_> {
    /// Share of the light that passes from `from` to `to` (world metres) through everything translucent in between, per channel in [0, 1];
    /// triangles accepted by `ignore` do not count, nor do surfaces through either end. What stops light is not looked at.
    ///
    /// The product of [`crate::scene::Scene::transmittance`] over the layers; 0 behind more than [`MAX_LAYERS`].
    #[must_use]
    pub fn transmittance(&self, from: DVec3, to: DVec3, ignore: &dyn Fn(u32) -> bool) -> DVec3 {
        let Some(panes) = self.panes() else {
            return DVec3::ONE;
        };
        let length = from.distance(to);
        let Some(direction) = (to - from).try_normalize() else {
            return DVec3::ONE;
        };
        let mut share = DVec3::ONE;
        let mut crossed = Vec::new();
        // One test decides which triangles lie between the ends, as for what stops light.
        while panes.occluded(from, to, &|id| ignore(id) || crossed.contains(&id)) {
            let hit = panes.closest(from, direction, length, &|id| {
                ignore(id) || crossed.contains(&id)
            });
            let Some(hit) = hit else {
                break;
            };
            if crossed.len() == MAX_LAYERS {
                return DVec3::ZERO;
            }
            crossed.push(hit.triangle);
            let place = from + hit.distance * direction;
            let triangle = &self.scene().triangles[hit.triangle as usize];
            let weights = weights(&triangle.vertices, place);
            share *= self.scene().transmittance(hit.triangle, weights);
            if share == DVec3::ZERO {
                break;
            }
        }
        share
    }

    /// Whether anything translucent stands in `shaft`, triangles accepted by `ignore` excepted.
    #[must_use]
    pub fn has_pane_in(&self, shaft: &Shaft, ignore: &dyn Fn(u32) -> bool) -> bool {
        self.panes()
            .is_some_and(|panes| !panes.in_shaft(shaft, ignore).is_empty())
    }
}

/// Barycentric weights of the vertices at a point of a triangle.
fn weights([a, b, c]: &[DVec3; 3], place: DVec3) -> [f64; 3] {
    let normal = (b - a).cross(c - a);
    let square = normal.length_squared();
    if square == 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let share =
        |p: &DVec3, q: &DVec3| ((q - p).cross(place - p).dot(normal) / square).clamp(0.0, 1.0);
    let (of_b, of_c) = (share(c, a), share(a, b));
    [(1.0 - of_b - of_c).max(0.0), of_b, of_c]
}

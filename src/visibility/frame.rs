//! The cube in which rays walk the tree in `f32`.
//!
//! So that the coarse walk never skips what the exact test would hit, it runs in a frame where the scene fills the cube from -1 to 1,
//! whatever its size and place, rays that start outside are moved to the cube first, and every box is larger than its triangles by
//! [`PADDING`].

use glam::{DVec3, Vec3};

use super::ray::Ray;
use super::triangle::Line;
use crate::math::Aabb;

/// How much larger than its triangles a box is, in units of half the scene.
///
/// A ray starts within 2 of the centre and meets the scene within a distance of 6. In units of 2⁻²⁴, half a step of `f32` at 1, it may
/// be off by 2 (origin) + 12 (direction; components below 2⁻²³ are moved to 2⁻²³) + 9 (slab arithmetic) + 1 (the box): 24.
/// This is 32. Smaller leaks light; larger opens more boxes.
pub(super) const PADDING: f64 = 1.0 / (1u64 << 19) as f64;

/// Rays that start farther than this from the centre are moved to the cube of [`ENTRY`], both in units of half the scene.
pub(super) const FAR: f64 = 2.0;

/// Half side of the cube to which far rays are moved: larger than the scene with its padding, smaller than [`FAR`].
const ENTRY: f64 = 1.5;

/// Maps the scene's box into the cube from -1 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) centre: DVec3,
    /// A power of two, so that scaling rounds nothing.
    pub(super) scale: f64,
}

/// A ray in the frame of the tree.
pub(super) struct Walk {
    start: Vec3,
    direction: Vec3,
    /// Distance in the frame by which the start was moved.
    skipped: f64,
    /// How far it goes, from the moved start.
    pub(super) length: f32,
}

impl Frame {
    pub(super) fn new(bounds: &Aabb) -> Self {
        let centre = bounds.centre();
        let half = 0.5 * (bounds.max - bounds.min).max_element();
        if !(centre.is_finite() && half.is_normal() && half > 0.0) {
            return Self {
                centre: DVec3::ZERO,
                scale: 1.0,
            };
        }
        // Clamped so that neither the power nor its use leaves the range of `f64`.
        let exponent = half.log2().ceil().clamp(-1000.0, 1000.0);
        Self {
            centre,
            scale: (-exponent).exp2(),
        }
    }

    #[inline(always)]
    pub(super) fn point(&self, point: DVec3) -> DVec3 {
        (point - self.centre) * self.scale
    }

    /// False only for coordinates beyond the range of [`Frame::new`], which no level has.
    pub(super) fn holds(&self, triangle: &[DVec3; 3]) -> bool {
        triangle
            .iter()
            .all(|&vertex| self.point(vertex).abs().max_element() <= FAR)
    }

    pub(super) fn bounds(&self, triangle: &[DVec3; 3]) -> obvhs::aabb::Aabb {
        let bounds = Aabb::from_points(triangle.iter().map(|&vertex| self.point(vertex)));
        obvhs::aabb::Aabb::new(
            (bounds.min - PADDING).as_vec3a(),
            (bounds.max + PADDING).as_vec3a(),
        )
    }

    /// The part of the segment from `from` to `from + offset` that can meet the scene; `None` when it misses the scene's cube.
    #[inline(always)]
    pub(super) fn segment(&self, from: DVec3, offset: DVec3) -> Option<Walk> {
        let start = self.point(from);
        // In `f32` all components are off by one factor of at most 4 · 2⁻²⁴, which changes the length alone, and by 1 each.
        let direction = (offset * self.scale).as_vec3();
        let square = direction.length_squared();
        let near = start.abs().cmple(DVec3::splat(FAR)).all();
        if !near || !(1e-30..1e30).contains(&square) {
            return self.walk(from, offset.try_normalize()?, offset.length());
        }
        let length = square.sqrt();
        Some(Walk {
            start: start.as_vec3(),
            direction: direction / length,
            skipped: 0.0,
            length: length + PADDING as f32,
        })
    }

    /// The part of a ray that can meet the scene; `None` when it misses the scene's cube.
    #[inline(always)]
    pub(super) fn walk(&self, origin: DVec3, direction: DVec3, length: f64) -> Option<Walk> {
        let mut start = self.point(origin);
        let mut skipped = 0.0;
        if start.abs().max_element() > FAR {
            for axis in 0..3 {
                let towards = -start[axis].signum() * direction[axis];
                let outside = start[axis].abs() - ENTRY;
                if outside > 0.0 {
                    if towards <= 0.0 {
                        return None;
                    }
                    skipped = f64::max(skipped, outside / towards);
                }
            }
            start += skipped * direction;
        }
        // False for what is not finite, too.
        if !start.abs().cmple(DVec3::splat(FAR)).all() {
            return None;
        }
        let mut walk = Walk {
            start: start.as_vec3(),
            direction: direction.as_vec3(),
            skipped,
            length: 0.0,
        };
        walk.length = walk.limit(length * self.scale);
        (walk.length > 0.0).then_some(walk)
    }
}

impl Walk {
    #[inline(always)]
    pub(super) fn ray(&self, line: &Line) -> Ray {
        let (axes, shear) = line.axes();
        Ray::new(self.start, self.direction, axes, shear)
    }

    /// Distance in the frame at which the walk may stop, rounded up, so that equally near triangles are still looked at.
    pub(super) fn limit(&self, distance: f64) -> f32 {
        (distance - self.skipped + PADDING) as f32
    }
}

//! Scene → [`Occluders`]: what stands between two points.
//!
//! Two implementations of [`Visibility`] run the same test suite: [`Occluders`], a bounding volume hierarchy, and [`BruteForce`],
//! which looks at every triangle and is obviously right. Both borrow the scene, for the alpha of masked surfaces.
//!
//! A segment is hidden by a triangle when the triangle lies between its end points and they are on different sides of the triangle's
//! plane, by more than rounding. Nothing else keeps a surface from hiding itself: there is no offset along the ray.

mod boxes;
mod brute;
mod bundle;
mod bvh;
mod edges;
mod entries;
mod filter;
mod frame;
mod lanes;
mod outline;
mod panes;
mod query;
mod ray;
mod shaft;
mod surface;
mod triangle;
mod wide;

use glam::DVec3;

pub use self::brute::BruteForce;
pub use self::bvh::Occluders;
pub use self::edges::Edges;
pub use self::panes::MAX_LAYERS;
pub use self::shaft::Shaft;

/// The nearest surface along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Metres from the origin.
    pub distance: f64,
    /// Index in `Scene::triangles`.
    pub triangle: u32,
    /// Whether the front was hit.
    pub front: bool,
}

/// Answers about the opaque part of a scene. Masked surfaces count where their alpha reaches the cutoff, what lets
/// light through does not count: [`Occluders::transmittance`] is about that.
pub trait Visibility: Sync {
    /// Whether anything stands strictly between `from` and `to` (world metres), triangles accepted by `ignore` excepted.
    ///
    /// Surfaces through either end point do not count, however the coordinates are rounded. Coinciding points see each other.
    fn occluded(&self, from: DVec3, to: DVec3, ignore: &dyn Fn(u32) -> bool) -> bool;

    /// [`Visibility::occluded`] for each of `segments`, from the first point to the second, in their order, in place of what `hidden` held.
    ///
    /// Worth it where neighbours run alike, as those from a few texels to one light do.
    fn occluded_each(
        &self,
        segments: &[[DVec3; 2]],
        ignore: &dyn Fn(u32) -> bool,
        hidden: &mut Vec<bool>,
    ) {
        hidden.clear();
        hidden.extend(
            segments
                .iter()
                .map(|&[from, to]| self.occluded(from, to, ignore)),
        );
    }

    /// The nearest surface from `origin` along the unit vector `direction`, strictly farther than rounding and at most `max_distance`
    /// metres away, triangles accepted by `ignore` excepted.
    fn closest(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_distance: f64,
        ignore: &dyn Fn(u32) -> bool,
    ) -> Option<Hit>;
}

//! The obvious implementation: every triangle, one after the other.

use glam::DVec3;

use super::surface;
use super::triangle::{self, Line};
use super::{Hit, Visibility};
use crate::scene::Scene;

/// The occluding triangles of a scene, without any order.
#[derive(Debug)]
pub struct BruteForce<'a> {
    scene: &'a Scene,
    occluding: Vec<u32>,
}

impl<'a> BruteForce<'a> {
    /// Lists the occluding triangles of `scene`.
    #[must_use]
    pub fn build(scene: &'a Scene) -> Self {
        Self {
            scene,
            occluding: surface::occluding(scene).0,
        }
    }

    fn triangles(&self) -> impl Iterator<Item = (u32, &[DVec3; 3])> {
        self.occluding
            .iter()
            .map(|&index| (index, &self.scene.triangles[index as usize].vertices))
    }
}

impl Visibility for BruteForce<'_> {
    fn occluded(&self, from: DVec3, to: DVec3, ignore: &dyn Fn(u32) -> bool) -> bool {
        let Some(line) = Line::new(from, to - from) else {
            return false;
        };
        self.triangles().any(|(index, vertices)| {
            triangle::separates(vertices, &line, from, to).is_some_and(|crossing| {
                !ignore(index) && surface::is_there(self.scene, index, &crossing)
            })
        })
    }

    fn closest(
        &self,
        origin: DVec3,
        direction: DVec3,
        max_distance: f64,
        ignore: &dyn Fn(u32) -> bool,
    ) -> Option<Hit> {
        let line = Line::new(origin, direction)?;
        let mut best: Option<Hit> = None;
        for (index, vertices) in self.triangles() {
            let Some((distance, front, crossing)) = triangle::meets(vertices, &line) else {
                continue;
            };
            // Ascending indices: of equally near triangles the first one stays.
            if distance <= max_distance
                && best.is_none_or(|hit| distance < hit.distance)
                && !ignore(index)
                && surface::is_there(self.scene, index, &crossing)
            {
                best = Some(Hit {
                    distance,
                    triangle: index,
                    front,
                });
            }
        }
        best
    }
}

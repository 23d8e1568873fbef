//! The questions of [`Visibility`], put to the tree on eight lanes: what it finds in `f32` is settled in `f64`.

use glam::DVec3;

use super::bundle::Bundle;
use super::filter::Verdict;
use super::lanes::{Kernel, LANES, Lanes};
use super::triangle::{self, Line};
use super::{Hit, Occluders, Visibility};

/// Segments that are sorted at once by their longest axis. More would go together more often, but farther from their neighbours.
const BATCH: usize = 64;

/// [`Visibility::occluded`] on eight lanes.
pub(super) struct Occluded<'a> {
    pub(super) occluders: &'a Occluders<'a>,
    pub(super) from: DVec3,
    pub(super) to: DVec3,
    pub(super) ignore: &'a dyn Fn(u32) -> bool,
}

impl Kernel for Occluded<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> bool {
        let Self {
            occluders,
            from,
            to,
            ignore,
        } = self;
        let offset = to - from;
        let Some(line) = Line::new(from, offset) else {
            return false;
        };
        let Some(walk) = occluders.frame.segment(from, offset) else {
            return false;
        };
        let ray = walk.ray(&line);
        occluders.wide.any(lanes, &ray, walk.length, |candidates| {
            for (place, solid) in candidates.each() {
                let id = occluders.ids[place];
                let triangle = &occluders.vertices[place];
                let stopped = triangle::straddles(triangle, from, to)
                    && if solid {
                        triangle::divides(triangle, from, to)
                    } else {
                        triangle::separates(triangle, &line, from, to)
                            .is_some_and(|crossing| occluders.stops(id, &crossing))
                    };
                if stopped && !ignore(id) {
                    return true;
                }
            }
            false
        })
    }
}

/// [`Visibility::occluded_each`], a segment in each lane.
pub(super) struct OccludedEach<'a> {
    pub(super) occluders: &'a Occluders<'a>,
    pub(super) segments: &'a [[DVec3; 2]],
    pub(super) ignore: &'a dyn Fn(u32) -> bool,
    pub(super) hidden: &'a mut Vec<bool>,
}

impl Kernel for OccludedEach<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            occluders,
            segments,
            ignore,
            hidden,
        } = self;
        hidden.clear();
        hidden.resize(segments.len(), false);
        for (segments, hidden) in segments.chunks(BATCH).zip(hidden.chunks_mut(BATCH)) {
            let mut alike = [[0u8; BATCH]; 3];
            let mut counts = [0; 3];
            for (place, [from, to]) in segments.iter().enumerate() {
                let axis = longest_axis(*to - *from);
                alike[axis][counts[axis]] = place as u8;
                counts[axis] += 1;
            }
            for axis in 0..3 {
                for places in alike[axis][..counts[axis]].chunks(LANES) {
                    occluders.stop(lanes, segments, (places, axis), ignore, hidden);
                }
            }
        }
    }
}

impl Occluders<'_> {
    /// Sets which of `segments` at `places`, at most eight that are all longest along `axis`, are `hidden`.
    #[inline(always)]
    fn stop<L: Lanes>(
        &self,
        lanes: L,
        segments: &[[DVec3; 2]],
        (places, axis): (&[u8], usize),
        ignore: &dyn Fn(u32) -> bool,
        hidden: &mut [bool],
    ) {
        let mut chosen = [segments[places[0] as usize]; LANES];
        for (segment, &place) in chosen.iter_mut().zip(places) {
            *segment = segments[place as usize];
        }
        let mut bundle = Bundle::new(&chosen, axis);
        bundle.place(&self.frame);
        bundle.together &= (1 << places.len()) - 1;
        let stopped = self.wide.any_of(lanes, &bundle, |place, verdict| {
            self.stopped(place, verdict, &bundle, &chosen, ignore)
        });
        for (lane, &place) in places.iter().enumerate() {
            hidden[place as usize] = if bundle.together >> lane & 1 == 1 {
                stopped >> lane & 1 == 1
            } else {
                let [from, to] = chosen[lane];
                self.occluded(from, to, ignore)
            };
        }
    }

    /// Those of `segments` that the triangle at `place` stops, given what is known of it.
    #[inline(always)]
    fn stopped(
        &self,
        place: usize,
        verdict: Verdict,
        bundle: &Bundle,
        segments: &[[DVec3; 2]],
        ignore: &dyn Fn(u32) -> bool,
    ) -> u32 {
        let triangle = &self.vertices[place];
        let mut doubtful = verdict.possible & bundle.straddling(triangle);
        let mut stopped = verdict.inside & doubtful;
        if stopped != 0 {
            stopped &= bundle.divided(triangle);
            doubtful &= !stopped;
        }
        while doubtful != 0 {
            let lane = doubtful.trailing_zeros();
            doubtful &= doubtful - 1;
            let [from, to] = segments[lane as usize];
            let hides = Line::new(from, to - from)
                .and_then(|line| triangle::separates(triangle, &line, from, to))
                .is_some_and(|crossing| self.stops(self.ids[place], &crossing));
            stopped |= u32::from(hides) << lane;
        }
        if stopped != 0 && ignore(self.ids[place]) {
            return 0;
        }
        stopped
    }
}

/// Axis along which `offset` is longest.
#[inline(always)]
fn longest_axis(offset: DVec3) -> usize {
    let size = offset.abs();
    if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    }
}

/// [`Visibility::closest`] on eight lanes.
pub(super) struct Closest<'a> {
    pub(super) occluders: &'a Occluders<'a>,
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
    pub(super) max_distance: f64,
    pub(super) ignore: &'a dyn Fn(u32) -> bool,
}

impl Kernel for Closest<'_> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Option<Hit> {
        let Self {
            occluders,
            origin,
            direction,
            max_distance,
            ignore,
        } = self;
        let line = Line::new(origin, direction)?;
        let walk = occluders.frame.walk(origin, direction, max_distance)?;
        let ray = walk.ray(&line);
        let mut best: Option<Hit> = None;
        let mut length = walk.length;
        occluders.wide.nearest(lanes, &ray, length, |candidates| {
            for (place, _) in candidates.each() {
                let Some((distance, front, crossing)) =
                    triangle::meets(&occluders.vertices[place], &line)
                else {
                    continue;
                };
                let id = occluders.ids[place];
                let nearer = distance <= max_distance
                    && best.is_none_or(|hit| (distance, id) < (hit.distance, hit.triangle));
                if nearer && !ignore(id) && occluders.stops(id, &crossing) {
                    best = Some(Hit {
                        distance,
                        triangle: id,
                        front,
                    });
                    length = walk.limit(distance * occluders.frame.scale);
                }
            }
            length
        });
        best
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, Vec3};

    use super::*;
    use crate::math;
    use crate::scene::{Instance, Material, Mesh, Primitive, Scene};
    use crate::visibility::BruteForce;
    use crate::visibility::lanes::Machine;

    fn point(seed: u64, index: u64) -> DVec3 {
        let [x, y] = math::unit_pair(math::hash(seed, 0, index));
        let [z, _] = math::unit_pair(math::hash(seed, 1, index));
        2.0 * DVec3::new(x, y, z) - 1.0
    }

    /// Small triangles in a cube.
    fn soup(count: u64) -> Scene {
        let positions: Vec<Vec3> = (0..3 * count)
            .map(|index| (point(1, index / 3) + 0.2 * point(2, index)).as_vec3())
            .collect();
        let primitive = Primitive {
            source: 0,
            material: 0,
            positions,
            normals: Vec::new(),
            texcoords: Vec::new(),
            vertex_alpha: Vec::new(),
            triangles: (0..count as u32)
                .map(|index| [3 * index, 3 * index + 1, 3 * index + 2])
                .collect(),
        };
        let mesh = Mesh {
            name: "mesh".to_owned(),
            source: 0,
            primitives: vec![primitive],
        };
        let instance = Instance {
            name: "node".to_owned(),
            node: 0,
            copy: None,
            mesh: 0,
            world_from_local: DAffine3::IDENTITY,
            density: 1.0,
        };
        Scene::assemble(
            "soup",
            vec![mesh],
            vec![instance],
            vec![Material::default()],
            Vec::new(),
        )
    }

    #[test]
    fn machines_without_wide_registers_answer_as_brute_force() {
        let scene = soup(300);
        let brute = BruteForce::build(&scene);
        let mut tree = Occluders::build(&scene);
        tree.machine = Machine::Any;
        let nothing = |_| false;
        let segments: Vec<[DVec3; 2]> = (0..20_000)
            .map(|index| {
                // Eight at a time run alike.
                let towards = 1.5 * point(4, index / 8) + 0.1 * point(5, index);
                [1.5 * point(3, index / 8), towards]
            })
            .collect();
        let mut hidden = Vec::new();
        tree.occluded_each(&segments, &nothing, &mut hidden);
        for (index, &[from, to]) in segments.iter().enumerate() {
            let want = brute.occluded(from, to, &nothing);
            assert_eq!(tree.occluded(from, to, &nothing), want, "segment {index}");
            assert_eq!(hidden[index], want, "segment {index} among others");
            let direction = (to - from).normalize();
            assert_eq!(
                tree.closest(from, direction, 3.0, &nothing),
                brute.closest(from, direction, 3.0, &nothing),
                "ray {index}"
            );
        }
        let share = hidden.iter().filter(|&&hidden| hidden).count();
        assert!((5_000..15_000).contains(&share), "{share} hidden");
    }
}

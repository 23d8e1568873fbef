//! Rays and shafts: the hierarchy against looking at every triangle, and both against what is known.

use glam::{DAffine2, DAffine3, DVec3, Vec2};
use lumel::error::Warnings;
use lumel::scene::{
    Alpha, Image, Instance, Material, Mesh, Primitive, Scene, Source, Texture, Triangle, Wrap,
};
use lumel::visibility::{BruteForce, Hit, Occluders, Shaft, Visibility};

use crate::support::Rng;

const NOTHING: &dyn Fn(u32) -> bool = &|_| false;

/// A scene that consists of world triangles only.
fn soup(triangles: &[[DVec3; 3]]) -> Scene {
    Scene {
        name: "soup".to_owned(),
        path: std::path::PathBuf::new(),
        meshes: Vec::new(),
        instances: Vec::new(),
        materials: vec![Material::default()],
        images: Vec::new(),
        triangles: triangles
            .iter()
            .enumerate()
            .map(|(index, &vertices)| Triangle {
                vertices,
                corners: [0, 1, 2],
                instance: 0,
                primitive: 0,
                triangle: index as u32,
                material: 0,
            })
            .collect(),
        punctual_lights: Vec::new(),
        area_lights: Vec::new(),
        sky: None,
        source: Source {
            json: serde_json::Value::Null,
            buffers: Vec::new(),
            folder: std::path::PathBuf::new(),
        },
        warnings: Warnings::default(),
    }
}

/// A closed sphere of `rings` × 2 `rings` quads around `centre`, fronts outwards.
fn sphere(centre: DVec3, radius: f64, rings: usize) -> Vec<[DVec3; 3]> {
    let vertex = |ring: usize, sector: usize| {
        let polar = std::f64::consts::PI * ring as f64 / rings as f64;
        let angle = std::f64::consts::PI * (sector % (2 * rings)) as f64 / rings as f64;
        let planar = if ring == 0 || ring == rings {
            0.0
        } else {
            polar.sin()
        };
        centre + radius * DVec3::new(planar * angle.cos(), polar.cos(), -planar * angle.sin())
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for sector in 0..2 * rings {
            let [a, b, c, d] = [
                vertex(ring, sector),
                vertex(ring + 1, sector),
                vertex(ring + 1, sector + 1),
                vertex(ring, sector + 1),
            ];
            if ring > 0 {
                triangles.push([a, b, d]);
            }
            if ring + 1 < rings {
                triangles.push([b, c, d]);
            }
        }
    }
    triangles
}

/// Random triangles of about `size` in a cube of half side 1, scaled by `scale` and moved by `offset`.
fn random_soup(
    rng: &mut Rng,
    count: usize,
    size: f64,
    scale: f64,
    offset: DVec3,
) -> Vec<[DVec3; 3]> {
    (0..count)
        .map(|_| {
            let centre = random_point(rng);
            [(); 3].map(|()| offset + scale * (centre + size * random_point(rng)))
        })
        .collect()
}

fn random_point(rng: &mut Rng) -> DVec3 {
    DVec3::new(
        rng.range(-1.0, 1.0),
        rng.range(-1.0, 1.0),
        rng.range(-1.0, 1.0),
    )
}

/// Möller and Trumbore's test, as a check that shares no code with ours: parameter along `to - from` and how far inside the hit is
/// (the smallest barycentric weight).
fn moller_trumbore(triangle: &[DVec3; 3], from: DVec3, to: DVec3) -> Option<(f64, f64)> {
    let [a, b, c] = *triangle;
    let direction = to - from;
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(e2);
    let det = e1.dot(p);
    if det == 0.0 {
        return None;
    }
    let s = from - a;
    let q = s.cross(e1);
    let (u, v) = (s.dot(p) / det, direction.dot(q) / det);
    Some((e2.dot(q) / det, u.min(v).min(1.0 - u - v)))
}

/// What every implementation must answer for one segment: `Some` when the answer is beyond doubt.
fn beyond_doubt(triangles: &[[DVec3; 3]], from: DVec3, to: DVec3) -> Option<bool> {
    // Rounding of the coordinates, relative to the segment: a hit nearer than this to a border or an end may go either way.
    let extent = triangles
        .iter()
        .flatten()
        .chain([&from, &to])
        .fold(0.0, |extent: f64, point| {
            extent.max(point.abs().max_element())
        });
    let doubt = 1e-9 + 1e4 * f64::EPSILON * extent / (to - from).length();
    let mut blocked = Some(false);
    for triangle in triangles {
        if let Some((t, inside)) = moller_trumbore(triangle, from, to) {
            if inside > doubt && t > doubt && t < 1.0 - doubt {
                return Some(true);
            }
            if inside > -doubt && t > -doubt && t < 1.0 + doubt {
                blocked = None;
            }
        }
    }
    blocked
}

/// Segments whose answers are known, asked again many at a time.
#[derive(Default)]
struct Together {
    segments: Vec<[DVec3; 2]>,
    want: Vec<bool>,
}

impl Together {
    fn add(&mut self, tree: &Occluders<'_>, segment: [DVec3; 2], want: bool) {
        self.segments.push(segment);
        self.want.push(want);
        // Not a multiple of anything that they may be divided into.
        if self.segments.len() == 203 {
            let mut hidden = vec![true; 5];
            tree.occluded_each(&self.segments, NOTHING, &mut hidden);
            assert_eq!(hidden, self.want, "{:?}", self.segments);
            self.segments.clear();
            self.want.clear();
        }
    }
}

/// A ray of one of many kinds: random, parallel to an axis with zeros of both signs, from afar.
fn random_direction(rng: &mut Rng) -> DVec3 {
    match rng.bits() % 4 {
        0 => {
            let mut direction = [0.0, -0.0, 0.0];
            direction[(rng.bits() % 3) as usize] = if rng.bits().is_multiple_of(2) {
                1.0
            } else {
                -1.0
            };
            if rng.bits().is_multiple_of(2) {
                direction = direction.map(|d| if d == 0.0 { -0.0 } else { d });
            }
            DVec3::from_array(direction)
        }
        1 => {
            let mut direction = rng.direction();
            direction[(rng.bits() % 3) as usize] = if rng.bits().is_multiple_of(2) {
                0.0
            } else {
                1e-12
            };
            direction.normalize()
        }
        _ => rng.direction(),
    }
}

/// Scale and offset of the scenes that every implementation is tried on.
const PLACES: [(f64, f64); 5] = [
    (1.0, 0.0),
    (1e-4, 0.0),
    (1e5, 0.0),
    (1.0, 1e6),
    (1e-4, 10.0),
];

#[test]
fn hierarchy_answers_as_brute_force() {
    let mut hits = 0;
    let mut hidden = Vec::new();
    for (case, (scale, offset)) in PLACES.into_iter().enumerate() {
        let rng = &mut Rng::new(case as u64);
        let offset = offset * DVec3::new(1.0, -0.7, 0.3);
        let mut triangles = random_soup(rng, 200, 0.2, scale, offset);
        // Duplicates, turned-over ones and rows of axis-parallel quads, whose halves share a box.
        triangles.extend_from_within(..20);
        for index in 0..20 {
            let [a, b, c] = triangles[index];
            triangles.push([a, c, b]);
        }
        let scene = soup(&triangles);
        let (tree, brute) = (Occluders::build(&scene), BruteForce::build(&scene));
        for ray in 0..25_000 {
            let far = if ray % 10 == 0 { 100.0 } else { 1.5 };
            let mut from = offset + far * scale * random_point(rng);
            let mut direction = random_direction(rng);
            if far > 10.0 && ray % 20 == 0 {
                direction = (offset + scale * random_point(rng) - from).normalize();
            }
            if ray % 7 == 0 {
                // Through a vertex.
                from = triangles[ray % triangles.len()][ray % 3]
                    - rng.range(0.0, 2.0) * scale * direction;
            }
            let odd = |id: u32| id % 2 == 1;
            let ignore: &dyn Fn(u32) -> bool = if ray % 3 == 0 { &odd } else { NOTHING };
            let length = scale * rng.range(0.0, 3.0) * far;
            let to = from + length * direction;
            assert_eq!(
                tree.occluded(from, to, ignore),
                brute.occluded(from, to, ignore),
                "case {case}, ray {ray}: {from:?} to {to:?}"
            );
            // Neighbours of like direction, as from one texel to one light.
            let segments: Vec<[DVec3; 2]> = (0..11)
                .map(|_| [from, to + 0.05 * length * random_point(rng)])
                .collect();
            tree.occluded_each(&segments, ignore, &mut hidden);
            for (&[from, to], &hidden) in segments.iter().zip(&hidden) {
                assert_eq!(
                    hidden,
                    brute.occluded(from, to, ignore),
                    "case {case}, ray {ray}: {from:?} to {to:?} among others"
                );
            }
            let limit = if ray % 2 == 0 { f64::INFINITY } else { length };
            let want = brute.closest(from, direction, limit, ignore);
            assert_eq!(
                tree.closest(from, direction, limit, ignore),
                want,
                "case {case}, ray {ray}: {from:?} along {direction:?}"
            );
            hits += usize::from(want.is_some());
        }
    }
    assert!(hits > 15_000, "only {hits} rays met anything");
}

#[test]
fn a_million_rays_are_answered_as_by_brute_force() {
    let mut hits = 0;
    for (case, (scale, offset)) in PLACES.into_iter().enumerate() {
        let rng = &mut Rng::new(300 + case as u64);
        let offset = offset * DVec3::new(-0.2, 1.0, 0.6);
        // Few enough for brute force, and several packets of eight: large ones, small ones and two that share a box.
        let mut triangles = random_soup(rng, 10, 0.8, scale, offset);
        triangles.extend(random_soup(rng, 18, 0.1, scale, offset));
        let corner = |x: f64, z: f64| offset + scale * DVec3::new(x, 0.25, z);
        let [a, b, c, d] = [
            corner(-0.5, -0.5),
            corner(0.5, -0.5),
            corner(0.5, 0.5),
            corner(-0.5, 0.5),
        ];
        triangles.extend([[a, b, c], [a, c, d]]);
        let scene = soup(&triangles);
        let (tree, brute) = (Occluders::build(&scene), BruteForce::build(&scene));
        let mut together = Together::default();
        for ray in 0..200_000usize {
            let direction = random_direction(rng);
            let [a, b, c] = triangles[ray % triangles.len()];
            let from = match ray % 5 {
                // Through a vertex, through an edge, from a surface.
                0 => a - 2.0 * scale * rng.unit() * direction,
                1 => a.lerp(b, rng.unit()) - 2.0 * scale * rng.unit() * direction,
                2 => (a + b + c) / 3.0,
                _ => offset + 1.5 * scale * random_point(rng),
            };
            if rng.bits().is_multiple_of(2) {
                let to = from + 4.0 * scale * rng.unit() * direction;
                let want = brute.occluded(from, to, NOTHING);
                assert_eq!(
                    tree.occluded(from, to, NOTHING),
                    want,
                    "case {case}, ray {ray}: {from:?} to {to:?}"
                );
                hits += usize::from(want);
                together.add(&tree, [from, to], want);
            } else {
                let want = brute.closest(from, direction, 3.0 * scale, NOTHING);
                assert_eq!(
                    tree.closest(from, direction, 3.0 * scale, NOTHING),
                    want,
                    "case {case}, ray {ray}: {from:?} along {direction:?}"
                );
                hits += usize::from(want.is_some());
            }
        }
    }
    assert!(hits > 300_000, "only {hits} rays met anything");
}

#[test]
fn both_agree_with_an_independent_test() {
    for (case, (scale, offset)) in PLACES.into_iter().enumerate() {
        let rng = &mut Rng::new(100 + case as u64);
        let offset = DVec3::splat(offset);
        let triangles = random_soup(rng, 60, 0.3, scale, offset);
        let scene = soup(&triangles);
        let tree = Occluders::build(&scene);
        let mut doubtful = 0;
        for ray in 0..20_000 {
            let from = offset + 1.5 * scale * random_point(rng);
            let to = from + 3.0 * scale * rng.unit() * random_direction(rng);
            match beyond_doubt(&triangles, from, to) {
                Some(want) => assert_eq!(
                    tree.occluded(from, to, NOTHING),
                    want,
                    "case {case}, ray {ray}: {from:?} to {to:?}"
                ),
                None => doubtful += 1,
            }
        }
        assert!(doubtful < 200, "case {case}: {doubtful} doubtful rays");
    }
}

#[test]
fn a_closed_mesh_lets_no_ray_through_its_edges_and_vertices() {
    for (case, (scale, offset)) in PLACES.into_iter().enumerate() {
        let rng = &mut Rng::new(200 + case as u64);
        let centre = offset * DVec3::new(1.0, 0.3, -0.6);
        let triangles = sphere(centre, scale, 24);
        let scene = soup(&triangles);
        let (tree, brute) = (Occluders::build(&scene), BruteForce::build(&scene));
        let mut together = Together::default();
        for ray in 0..200_000usize {
            let triangle = &triangles[ray % triangles.len()];
            let target = match ray % 3 {
                0 => triangle[0],
                1 => 0.5 * (triangle[0] + triangle[1]),
                _ => triangle[0].lerp(triangle[1], rng.unit()),
            };
            let from = if ray % 2 == 0 {
                centre
            } else {
                centre + 0.5 * scale * random_point(rng)
            };
            let direction = (target - from).normalize();
            let to = from + 3.0 * scale * direction;
            assert!(
                tree.occluded(from, to, NOTHING),
                "case {case}, ray {ray} leaks: {from:?} to {to:?}"
            );
            together.add(&tree, [from, to], true);
            let hit = tree.closest(from, direction, f64::INFINITY, NOTHING);
            assert!(
                hit.is_some_and(|hit| !hit.front),
                "case {case}, ray {ray}: {hit:?}"
            );
            if ray % 200 == 0 {
                assert_eq!(hit, brute.closest(from, direction, f64::INFINITY, NOTHING));
            }
        }
    }
}

#[test]
fn axis_parallel_rays_through_grid_lines_are_stopped() {
    // A wall of axis-parallel quads; texel grids hit its edges and vertices exactly.
    for (case, (scale, offset)) in PLACES.into_iter().enumerate() {
        let offset = DVec3::splat(offset);
        let n = 16;
        let mut triangles = Vec::new();
        for i in 0..n {
            for j in 0..n {
                let corner = |di: usize, dj: usize| {
                    offset + scale * DVec3::new((i + di) as f64, (j + dj) as f64, 0.0)
                };
                triangles.push([corner(0, 0), corner(1, 0), corner(1, 1)]);
                triangles.push([corner(0, 0), corner(1, 1), corner(0, 1)]);
            }
        }
        let scene = soup(&triangles);
        let tree = Occluders::build(&scene);
        for i in 0..=2 * n {
            for j in 0..=2 * n {
                let point = offset + 0.5 * scale * DVec3::new(i as f64, j as f64, 0.0);
                for zero in [0.0, -0.0] {
                    let up = DVec3::new(zero, -zero, 1.0);
                    let from = point - scale * up;
                    let hit = tree
                        .closest(from, up, f64::INFINITY, NOTHING)
                        .unwrap_or_else(|| panic!("case {case}: leak at {i} {j}"));
                    // Back to back: the wall's front looks along +z, the ray comes from below.
                    assert!(!hit.front, "case {case} at {i} {j}");
                    assert!(tree.occluded(from, point + scale * up, NOTHING));
                }
            }
        }
    }
}

#[test]
fn a_surface_never_hides_what_starts_or_ends_on_it() {
    for (case, (scale, offset)) in PLACES.into_iter().enumerate() {
        let offset = offset * DVec3::new(-0.4, 1.0, 0.9);
        for round in 0..40 {
            let rng = &mut Rng::new(1000 * case as u64 + round);
            // One triangle, from well shaped to a sliver of 1 : 10⁴, cut into four along its edges' middles.
            let flat = 10f64.powf(-4.0 * rng.unit());
            let (x, y) = rng.direction().any_orthonormal_pair();
            let [a, b, c] = [
                random_point(rng),
                random_point(rng) + x,
                random_point(rng) + flat * y,
            ]
            .map(|vertex| offset + scale * vertex);
            let triangles = vec![[a, b, c]];
            let scene = soup(&triangles);
            let tree = Occluders::build(&scene);
            for ray in 0..200 {
                let [u, v] = [rng.unit(), rng.unit()];
                let [u, v] = if u + v > 1.0 {
                    [1.0 - u, 1.0 - v]
                } else {
                    [u, v]
                };
                let on = (1.0 - u - v) * a + u * b + v * c;
                // From steep to grazing by 1e-8.
                let normal = (b - a).cross(c - a).normalize();
                let along = (b - a).normalize();
                let height = 10f64.powf(-8.0 * rng.unit());
                let direction = (along + height * normal).normalize();
                let away = on + scale * rng.range(0.1, 10.0) * direction;
                for (from, to) in [(on, away), (away, on)] {
                    assert!(
                        !tree.occluded(from, to, NOTHING),
                        "case {case}, round {round}, ray {ray}: {from:?} to {to:?}"
                    );
                }
                assert_eq!(tree.closest(on, direction, f64::INFINITY, NOTHING), None);
            }
        }
    }
}

#[test]
fn degenerate_scenes_and_segments_are_answered() {
    let empty = soup(&[]);
    let tree = Occluders::build(&empty);
    assert!(!tree.occluded(DVec3::ZERO, DVec3::X, NOTHING));
    assert_eq!(tree.closest(DVec3::ZERO, DVec3::X, 1.0, NOTHING), None);

    let one = soup(&[[DVec3::X, DVec3::Y, DVec3::Z]]);
    let tree = Occluders::build(&one);
    assert!(tree.occluded(DVec3::ZERO, DVec3::ONE, NOTHING));
    assert!(!tree.occluded(DVec3::ZERO, DVec3::ZERO, NOTHING));
    assert!(!tree.occluded(DVec3::ZERO, DVec3::splat(0.2), NOTHING));
    assert!(!tree.occluded(DVec3::ZERO, DVec3::ONE, &|id| id == 0));
    let direction = DVec3::ONE.normalize();
    let hit = tree
        .closest(DVec3::ZERO, direction, 10.0, NOTHING)
        .expect("hit");
    assert!((hit.distance - 1.0 / 3f64.sqrt()).abs() < 1e-15);
    assert!(!hit.front, "seen from the origin it is its back");
    assert_eq!(tree.closest(DVec3::ZERO, direction, 0.5, NOTHING), None);
    assert_eq!(tree.closest(DVec3::NAN, direction, 0.5, NOTHING), None);
    assert!(!tree.occluded(DVec3::ZERO, DVec3::NAN, NOTHING));
}

#[test]
fn twenty_thousand_equal_triangles_build_and_answer() {
    let triangle = [DVec3::X, DVec3::Y, DVec3::Z];
    let mut triangles = vec![triangle; 20_000];
    // And detail that `f32` cannot tell apart, far from the rest.
    let rng = &mut Rng::new(0);
    triangles.extend(random_soup(rng, 20_000, 1e-3, 1e-3, DVec3::splat(1e5)));
    let scene = soup(&triangles);
    let tree = Occluders::build(&scene);
    let hit = tree.closest(DVec3::ZERO, DVec3::ONE.normalize(), 10.0, NOTHING);
    assert_eq!(hit.map(|hit| hit.triangle), Some(0));
    let all = |id: u32| id < 20_000;
    assert!(!tree.occluded(DVec3::ZERO, DVec3::ONE, &all));
}

/// Receivers of a tile and a light polygon, at random but in front of each other.
struct Pair {
    receivers: Vec<(DVec3, DVec3)>,
    light: Vec<DVec3>,
    light_normal: DVec3,
}

fn random_pair(rng: &mut Rng, scale: f64, offset: DVec3, curved: bool) -> Pair {
    let aligned = rng.bits().is_multiple_of(2);
    let direction = |rng: &mut Rng| {
        if aligned {
            DVec3::AXES[(rng.bits() % 3) as usize]
                * if rng.bits().is_multiple_of(2) {
                    1.0
                } else {
                    -1.0
                }
        } else {
            rng.direction()
        }
    };
    let (centre, light_centre) = (random_point(rng), random_point(rng));
    let mut normal = direction(rng);
    if normal.dot(light_centre - centre) < 0.0 {
        normal = -normal;
    }
    let mut light_normal = direction(rng);
    if !rng.bits().is_multiple_of(4) && light_normal.dot(centre - light_centre) < 0.0 {
        light_normal = -light_normal;
    }
    let (x, y) = normal.any_orthonormal_pair();
    let size = 10f64.powf(rng.range(-2.5, -0.3));
    let bump = if rng.bits().is_multiple_of(4) {
        0.3
    } else {
        0.0
    };
    let receivers = (0..64)
        .map(|index| {
            let (u, v) = (f64::from(index % 8) / 7.0, f64::from(index / 8) / 7.0);
            let w = bump * rng.unit();
            let bent = if curved {
                0.3 * rng.direction()
            } else {
                DVec3::ZERO
            };
            (
                offset + scale * (centre + size * (u * x + v * y + w * normal)),
                (normal + bent).normalize(),
            )
        })
        .collect();
    let (x, y) = light_normal.any_orthonormal_pair();
    let corners = 3 + rng.bits() % 14;
    let size = 10f64.powf(rng.range(-2.0, 0.0));
    let light = (0..corners)
        .map(|index| {
            let angle = std::f64::consts::TAU * index as f64 / corners as f64;
            let radius = size * rng.range(0.3, 1.0);
            offset + scale * (light_centre + radius * (angle.cos() * x + angle.sin() * y))
        })
        .collect();
    Pair {
        receivers,
        light,
        light_normal,
    }
}

#[test]
fn whatever_hides_light_is_in_the_shaft() {
    let (mut blockers, mut candidates, mut empty, mut unhidden) = (0, 0, 0, 0);
    for case in 0..1500u64 {
        let rng = &mut Rng::new(case);
        let (scale, offset) = PLACES[case as usize % PLACES.len()];
        let offset = DVec3::splat(offset);
        let size = 10f64.powf(rng.range(-1.5, 0.5));
        let count = if size > 0.5 { 12 } else { 150 };
        let triangles = random_soup(rng, count, size, scale, offset);
        let scene = soup(&triangles);
        let tree = Occluders::build(&scene);
        let pair = random_pair(rng, scale, offset, case % 3 == 0);
        let shaft = Shaft::new(&pair.receivers, &pair.light, pair.light_normal);
        let ignore = |id: u32| id % 5 == 4;
        let found = tree.in_shaft(&shaft, &ignore);
        assert!(found.is_sorted() && !found.iter().any(|&id| ignore(id)));
        let one = |index: u32| soup(&[triangles[index as usize]]);
        let mut hiding = Vec::new();
        for index in 0..triangles.len() as u32 {
            let alone = one(index);
            let brute = BruteForce::build(&alone);
            let hides = (0..400).any(|_| {
                let (from, normal) = pair.receivers[(rng.bits() % 64) as usize];
                let a = pair.light[0];
                let k = 1 + (rng.bits() as usize) % (pair.light.len() - 2);
                let [u, v] = [rng.unit(), rng.unit()];
                let [u, v] = if u + v > 1.0 {
                    [1.0 - u, 1.0 - v]
                } else {
                    [u, v]
                };
                let to = a + u * (pair.light[k] - a) + v * (pair.light[k + 1] - a);
                normal.dot(to - from) > 0.0 && brute.occluded(from, to, NOTHING)
            });
            if hides && !ignore(index) {
                assert!(
                    found.binary_search(&index).is_ok(),
                    "case {case}: triangle {index} hides light and is not in the shaft"
                );
                hiding.push(index);
            }
        }
        blockers += hiding.len();
        candidates += found.len();
        empty += usize::from(found.is_empty());
        unhidden += usize::from(hiding.is_empty());
    }
    assert!(blockers > 1500, "only {blockers} hiding triangles");
    // 400 segments miss some of the hiding triangles. Measured: 2334 candidates for 1813, and 646 empty shafts of 706.
    assert!(2 * candidates < 3 * blockers, "{candidates} for {blockers}");
    assert!(10 * empty > 8 * unhidden, "{empty} of {unhidden}");
}

#[test]
fn a_convex_room_stands_in_no_shaft() {
    for (scale, offset) in PLACES {
        let offset = DVec3::splat(offset);
        let corner = |x: f64, y: f64, z: f64| offset + scale * DVec3::new(x, y, z);
        let mut triangles = Vec::new();
        let mut quad = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| {
            triangles.push([a, b, c]);
            triangles.push([a, c, d]);
        };
        let [o, x, z, xz] =
            [(0., 0.), (4., 0.), (0., 3.), (4., 3.)].map(|(x, z)| corner(x, 0.0, z));
        let [p, px, pz, pxz] =
            [(0., 0.), (4., 0.), (0., 3.), (4., 3.)].map(|(x, z)| corner(x, 2.5, z));
        quad(o, z, xz, x);
        quad(p, px, pxz, pz);
        quad(o, x, px, p);
        quad(z, pz, pxz, xz);
        quad(o, p, pz, z);
        quad(x, xz, pxz, px);
        let scene = soup(&triangles);
        let tree = Occluders::build(&scene);
        // A lamp in the ceiling's plane, and tiles on the floor and on a wall, up to the corners.
        let light = [(1., 1.), (2., 1.), (2., 2.), (1., 2.)].map(|(x, z)| corner(x, 2.5, z));
        let tile = |at: &dyn Fn(f64, f64) -> DVec3, normal: DVec3| -> Vec<(DVec3, DVec3)> {
            (0..64)
                .map(|index| {
                    (
                        at(f64::from(index % 8) / 7.0, f64::from(index / 8) / 7.0),
                        normal,
                    )
                })
                .collect()
        };
        let floor = tile(&|u, v| corner(4.0 * u, 0.0, 3.0 * v), DVec3::Y);
        let wall = tile(&|u, v| corner(0.0, 2.5 * u, 3.0 * v), DVec3::X);
        for receivers in [floor, wall] {
            let shaft = Shaft::new(&receivers, &light, -DVec3::Y);
            assert_eq!(tree.in_shaft(&shaft, NOTHING), Vec::<u32>::new());
        }
    }
}

#[test]
fn a_shaft_without_receivers_or_light_is_empty() {
    let scene = soup(&[[DVec3::X, DVec3::Y, DVec3::Z]]);
    let tree = Occluders::build(&scene);
    let light = [DVec3::X, DVec3::Y, DVec3::Z];
    let receivers = [(DVec3::ZERO, DVec3::Z)];
    for shaft in [
        Shaft::new(&[], &light, DVec3::Z),
        Shaft::new(&receivers, &[], DVec3::Z),
    ] {
        assert_eq!(tree.in_shaft(&shaft, NOTHING), Vec::<u32>::new());
    }
}

#[test]
fn hits_are_reported_with_distance_and_side() {
    let triangles = sphere(DVec3::ZERO, 1.0, 64);
    let scene = soup(&triangles);
    let tree = Occluders::build(&scene);
    for case in 0..2000 {
        let rng = &mut Rng::new(case);
        let direction = rng.direction();
        let hit = tree
            .closest(-2.0 * direction, direction, f64::INFINITY, NOTHING)
            .expect("the sphere is in the way");
        assert!(hit.front);
        // The facets of a sphere of 64 rings lie at most 1 − cos²(π/128) below it.
        assert!((1.0..1.0013).contains(&hit.distance), "{hit:?}");
        let Hit { triangle, .. } = hit;
        assert!(
            scene.triangles[triangle as usize]
                .area_vector()
                .dot(direction)
                < 0.0
        );
    }
}

/// A unit square in z = 0, its texture coordinates its x and y, with a picture of 2 × 1 texels: clear on the left.
fn curtain(alpha: Alpha) -> Scene {
    let texture = Texture {
        image: Some(0),
        texcoord: 0,
        transform: DAffine2::IDENTITY,
        wrap: [Wrap::ClampToEdge; 2],
    };
    let material = Material {
        alpha,
        base_color_texture: Some(texture),
        ..Material::default()
    };
    let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    Scene::assemble(
        "curtain",
        vec![Mesh {
            name: "mesh".to_owned(),
            source: 0,
            primitives: vec![Primitive {
                source: 0,
                material: 0,
                positions: corners.map(|corner| corner.extend(0.0)).to_vec(),
                normals: Vec::new(),
                texcoords: vec![corners.to_vec()],
                vertex_alpha: Vec::new(),
                triangles: vec![[0, 1, 2], [0, 2, 3]],
            }],
        }],
        vec![Instance {
            name: "node".to_owned(),
            node: 0,
            copy: None,
            mesh: 0,
            world_from_local: DAffine3::IDENTITY,
            density: 1.0,
        }],
        vec![material],
        vec![Image {
            width: 2,
            height: 1,
            rgba: vec![[255, 255, 255, 0], [255; 4]],
        }],
    )
}

#[test]
fn masked_surfaces_stop_light_where_they_are_opaque() {
    let stopped = |alpha: Alpha, x: f64| {
        let scene = curtain(alpha);
        let (tree, brute) = (Occluders::build(&scene), BruteForce::build(&scene));
        let from = DVec3::new(x, 0.4, 1.0);
        let to = DVec3::new(x, 0.4, -1.0);
        let occluded = tree.occluded(from, to, NOTHING);
        assert_eq!(occluded, brute.occluded(from, to, NOTHING));
        let hit = tree.closest(from, -DVec3::Z, 5.0, NOTHING);
        assert_eq!(hit, brute.closest(from, -DVec3::Z, 5.0, NOTHING));
        assert_eq!(hit.is_some(), occluded);
        occluded
    };
    let mask = Alpha::Mask { cutoff: 0.5 };
    assert!(!stopped(mask, 0.1));
    assert!(stopped(mask, 0.9));
    assert!(stopped(Alpha::Mask { cutoff: 0.0 }, 0.1));
    assert!(!stopped(Alpha::Mask { cutoff: 1.5 }, 0.9));
    assert!(stopped(Alpha::Opaque, 0.1));
    assert!(!stopped(Alpha::Blend, 0.9));

    // A masked surface may hide light, so it is in the shaft; a blended one never does.
    let light = [DVec3::ZERO, DVec3::X, DVec3::ONE, DVec3::Y].map(|v| v.with_z(1.0));
    let receivers = [(DVec3::new(0.5, 0.5, -1.0), DVec3::Z)];
    let shaft = Shaft::new(&receivers, &light, -DVec3::Z);
    for (alpha, want) in [(mask, vec![0, 1]), (Alpha::Blend, vec![])] {
        let scene = curtain(alpha);
        assert_eq!(Occluders::build(&scene).in_shaft(&shaft, NOTHING), want);
    }
}

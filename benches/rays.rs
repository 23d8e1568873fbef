//! How fast `Occluders` answers rays, beside `obvhs`' own `Bvh2` and `CwBvh` with its triangle test in `f32`.
//!
//! Prints ratios of one run; the three take turns on the same rays, on one thread, and the best of several turns counts. Real levels are
//! tried where they lie beside the checkout, bundled fixtures elsewhere.

#![expect(clippy::print_stdout, reason = "a program that prints a table")]

use std::path::{Path, PathBuf};
use std::time::Duration;

use glam::{DVec3, Vec3A};
use lumel::scene::{Options, Scene};
use lumel::visibility::{Occluders, Visibility};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::{Ray, RayHit};
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;

/// Rays of each kind.
const RAYS: usize = 400_000;

/// Turns of each competitor.
const TURNS: usize = 5;

/// How far `obvhs` stays away from both ends, in units of the scene: its test has no notion of rounding.
const CLEARANCE: f64 = 1e-5;

struct Segment {
    from: DVec3,
    to: DVec3,
}

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let levels = [
        "../shared/scenes/levels/mindfall_lvl1/lvl1.glb",
        "../shared/scenes/levels/littlest_tokyo/LittlestTokyo-transformed.plain.glb",
    ];
    let fixtures = [
        "fixtures/penumbra/penumbra.gltf",
        "fixtures/leaves/leaves.gltf",
    ];
    for (level, fixture) in levels.into_iter().zip(fixtures) {
        let path: PathBuf = [level, fixture]
            .map(|path| root.join(path))
            .into_iter()
            .find(|path| path.exists())
            .unwrap_or_default();
        match Scene::open(&path, &Options::default()) {
            Ok(scene) => race(&scene),
            Err(error) => println!("{}: {error}", path.display()),
        }
    }
}

fn race(scene: &Scene) {
    println!("\n{}: {} triangles", scene.name, scene.triangles.len());
    println!(
        "{:<28}{:>10}{:>10}{:>10}{:>16}{:>12}",
        "Mray/s", "lumel", "Bvh2", "CwBvh", "lumel / better", "stopped"
    );
    let occluders = Occluders::build(scene);
    let rivals = Rivals::build(scene);
    let shadow = shadow_rays(scene, &occluders);
    let sky = hemisphere_rays(scene);
    let mut shuffled: Vec<&Segment> = sky.iter().collect();
    let mut rng = Rng(1);
    for index in (1..shuffled.len()).rev() {
        shuffled.swap(index, (rng.unit() * (index + 1) as f64) as usize);
    }
    let ordered = |rays: &'_ [Segment]| -> Vec<Segment> {
        rays.iter().map(|ray| Segment { ..*ray }).collect()
    };
    let shuffled: Vec<Segment> = shuffled.into_iter().map(|ray| Segment { ..*ray }).collect();
    for (name, rays) in [
        ("texel to area light", ordered(&shadow)),
        ("hemisphere, texel order", ordered(&sky)),
        ("hemisphere, shuffled", shuffled),
    ] {
        occlusion(name, &rays, &occluders, &rivals);
    }
    closest("closest, texel order", &sky, &occluders, &rivals);
}

fn occlusion(name: &str, rays: &[Segment], occluders: &Occluders<'_>, rivals: &Rivals) {
    report(
        name,
        rays.len(),
        [
            &|| {
                let stopped = |ray: &&Segment| occluders.occluded(ray.from, ray.to, &|_| false);
                rays.iter().filter(stopped).count()
            },
            &|| {
                let stopped = |ray: &&Segment| {
                    let narrow = narrowed(ray, rivals.clearance);
                    !rivals.bvh2.ray_traverse_miss(narrow, |ray, id| {
                        rivals.bvh2_triangles[id].intersect(ray)
                    })
                };
                rays.iter().filter(stopped).count()
            },
            &|| {
                let stopped = |ray: &&Segment| {
                    let narrow = narrowed(ray, rivals.clearance);
                    !rivals.cwbvh.ray_traverse_miss(narrow, |ray, id| {
                        rivals.cwbvh_triangles[id].intersect(ray)
                    })
                };
                rays.iter().filter(stopped).count()
            },
        ],
    );
}

fn closest(name: &str, rays: &[Segment], occluders: &Occluders<'_>, rivals: &Rivals) {
    report(
        name,
        rays.len(),
        [
            &|| {
                let met = |ray: &&Segment| {
                    let (direction, length) = (ray.to - ray.from).normalize_and_length();
                    occluders
                        .closest(ray.from, direction, length, &|_| false)
                        .is_some()
                };
                rays.iter().filter(met).count()
            },
            &|| {
                let met = |ray: &&Segment| {
                    let narrow = narrowed(ray, rivals.clearance);
                    rivals
                        .bvh2
                        .ray_traverse(narrow, &mut RayHit::none(), |ray, id| {
                            rivals.bvh2_triangles[id].intersect(ray)
                        })
                };
                rays.iter().filter(met).count()
            },
            &|| {
                let met = |ray: &&Segment| {
                    let narrow = narrowed(ray, rivals.clearance);
                    rivals
                        .cwbvh
                        .ray_traverse(narrow, &mut RayHit::none(), |ray, id| {
                            rivals.cwbvh_triangles[id].intersect(ray)
                        })
                };
                rays.iter().filter(met).count()
            },
        ],
    );
}

/// Lets the competitors take turns and prints their best.
fn report(name: &str, rays: usize, runs: [&dyn Fn() -> usize; 3]) {
    let mut best = [f64::INFINITY; 3];
    let mut stopped = [0; 3];
    for _ in 0..TURNS {
        for (index, run) in runs.iter().enumerate() {
            let start = cpu_time();
            stopped[index] = run();
            best[index] = best[index].min((cpu_time() - start).as_secs_f64());
        }
    }
    let speed = best.map(|seconds| 1e-6 * rays as f64 / seconds);
    println!(
        "{name:<28}{:>10.2}{:>10.2}{:>10.2}{:>16.2}{:>11.1}% {:?}",
        speed[0],
        speed[1],
        speed[2],
        speed[0] / speed[1].max(speed[2]),
        100.0 * stopped[0] as f64 / rays as f64,
        [stopped[1], stopped[2]].map(|other| other as i64 - stopped[0] as i64),
    );
}

/// `obvhs` over the same triangles, each tree with the triangles in its own order.
struct Rivals {
    clearance: f64,
    bvh2: obvhs::bvh2::Bvh2,
    bvh2_triangles: Vec<RtTriangle>,
    cwbvh: obvhs::cwbvh::CwBvh,
    cwbvh_triangles: Vec<RtTriangle>,
}

impl Rivals {
    fn build(scene: &Scene) -> Self {
        let triangles: Vec<Triangle> = scene
            .triangles
            .iter()
            .map(|triangle| {
                let [v0, v1, v2] = triangle.vertices.map(|vertex| vertex.as_vec3a());
                Triangle { v0, v1, v2 }
            })
            .filter(|triangle| triangle.compute_normal() != Vec3A::ZERO)
            .collect();
        let mut time = Duration::default();
        let bvh2 = build_bvh2(&triangles, BvhBuildParams::medium_build(), &mut time);
        let cwbvh = build_cwbvh(&triangles, BvhBuildParams::medium_build(), &mut time);
        let in_order = |order: &[u32]| -> Vec<RtTriangle> {
            order
                .iter()
                .map(|&id| RtTriangle::from(&triangles[id as usize]))
                .collect()
        };
        let (min, max) = extent(scene);
        Self {
            clearance: CLEARANCE * (max - min).max_element(),
            bvh2_triangles: in_order(&bvh2.primitive_indices),
            cwbvh_triangles: in_order(&cwbvh.primitive_indices),
            bvh2,
            cwbvh,
        }
    }
}

fn narrowed(segment: &Segment, clearance: f64) -> Ray {
    let (direction, length) = (segment.to - segment.from).normalize_and_length();
    // Adding zero turns -0 into 0, of which `CwBvh` is afraid.
    Ray::new(
        segment.from.as_vec3a(),
        direction.as_vec3a() + Vec3A::ZERO,
        clearance as f32,
        (length - clearance) as f32,
    )
}

/// Texels in rows over the triangles of the scene, `per_texel` rays each: a point and the normal there.
fn texels(scene: &Scene, count: usize) -> Vec<(DVec3, DVec3)> {
    let total: f64 = scene
        .triangles
        .iter()
        .map(|t| t.area_vector().length())
        .sum();
    // Twice the area of a texel.
    let texel = total / count as f64;
    let mut texels = Vec::with_capacity(count);
    let mut owed = 0.0;
    for triangle in &scene.triangles {
        let [a, b, c] = triangle.vertices;
        let area = triangle.area_vector().length();
        owed += area / texel;
        if owed < 1.0 {
            continue;
        }
        let rows = owed.sqrt().ceil() as usize;
        let normal = triangle.area_vector().normalize();
        for row in 0..rows {
            for column in 0..rows - row {
                let (u, v) = (
                    (column as f64 + 1.0 / 3.0) / rows as f64,
                    (row as f64 + 1.0 / 3.0) / rows as f64,
                );
                texels.push((a + u * (b - a) + v * (c - a), normal));
            }
        }
        owed = 0.0;
    }
    texels
}

/// Four rays from each texel to the nearest of 1000 lights of 2 : 1, which hang amid the free space of the scene.
fn shadow_rays(scene: &Scene, occluders: &Occluders<'_>) -> Vec<Segment> {
    let (min, max) = extent(scene);
    let size = 0.01 * (max - min).max_element();
    let texels = texels(scene, RAYS / 4);
    let mut rng = Rng(2);
    let lights: Vec<DVec3> = (0..1000)
        .filter_map(|_| {
            let (from, normal) = texels[(rng.unit() * texels.len() as f64) as usize];
            let hit = occluders.closest(from, normal, 40.0 * size, &|_| false)?;
            Some(from + 0.5 * hit.distance * normal)
        })
        .collect();
    let mut rays = Vec::new();
    for (from, normal) in texels {
        let near = |light: &&DVec3| light.distance_squared(from);
        let facing = lights
            .iter()
            .filter(|&&light| normal.dot(light - from) > 0.0);
        let Some(centre) = facing.min_by(|a, b| near(a).total_cmp(&near(b))) else {
            continue;
        };
        for _ in 0..4 {
            let to = centre + size * DVec3::new(2.0 * rng.unit() - 1.0, 0.0, rng.unit() - 0.5);
            rays.push(Segment { from, to });
        }
    }
    rays.truncate(RAYS);
    rays
}

/// Four cosine-distributed rays from each texel through the whole scene.
fn hemisphere_rays(scene: &Scene) -> Vec<Segment> {
    let (min, max) = extent(scene);
    let length = (max - min).length();
    let mut rng = Rng(3);
    let mut rays = Vec::new();
    for (from, normal) in texels(scene, RAYS / 4) {
        for _ in 0..4 {
            let (z, angle) = (2.0 * rng.unit() - 1.0, std::f64::consts::TAU * rng.unit());
            let radius = (1.0 - z * z).sqrt();
            let sphere = DVec3::new(radius * angle.cos(), radius * angle.sin(), z);
            if let Some(direction) = (normal + sphere).try_normalize() {
                rays.push(Segment {
                    from,
                    to: from + length * direction,
                });
            }
        }
    }
    rays.truncate(RAYS);
    rays
}

fn extent(scene: &Scene) -> (DVec3, DVec3) {
    scene.triangles.iter().flat_map(|t| t.vertices).fold(
        (DVec3::INFINITY, DVec3::NEG_INFINITY),
        |(min, max), vertex| (min.min(vertex), max.max(vertex)),
    )
}

/// Time this thread has computed.
#[cfg(target_os = "linux")]
fn cpu_time() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// Time on the wall, where threads have no clock of their own that is worth a dependency.
#[cfg(not(target_os = "linux"))]
fn cpu_time() -> Duration {
    use std::sync::OnceLock;
    use std::time::Instant;
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

/// `SplitMix64`.
struct Rng(u64);

impl Rng {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

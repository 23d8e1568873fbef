//! How fast `Occluders` answers rays, beside `obvhs`' own `Bvh2` and `CwBvh` with its triangle test in `f32`.
//!
//! Prints ratios of one run; the three take turns on the same segments, on one thread, and the best of several turns counts. Each is given
//! end points in `f64` and pays for what it makes of them. Real levels are tried where they lie beside the checkout, bundled fixtures
//! elsewhere.

#![expect(clippy::print_stdout, reason = "a program that prints a table")]

use std::path::{Path, PathBuf};
use std::time::Duration;

use glam::{DVec3, Vec3A};
use lumel::scene::{Alpha, Options, Scene};
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

/// Segments that are asked together: the rays of a patch of texels.
const TOGETHER: usize = 64;

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
        "{:<34}{:>8}{:>8}{:>8}{:>16}{:>10}{:>16}",
        "Mray/s", "lumel", "Bvh2", "CwBvh", "lumel / better", "stopped", "others differ"
    );
    let occluders = Occluders::build(scene);
    let rivals = Rivals::build(scene);
    let race = Race {
        occluders: &occluders,
        rivals: &rivals,
    };
    let patches = shadow_rays(scene, &occluders, 4);
    race.together("16 neighbouring texels to a light", &patches);
    race.one_by_one("the same, one by one", &patches);
    let scattered = shadow_rays(scene, &occluders, 1);
    race.together("lone texels to a light", &scattered);
    race.one_by_one("the same, one by one", &scattered);
    let mut sky = hemisphere_rays(scene);
    race.one_by_one("hemisphere, texel order", &sky);
    race.closest("closest, texel order", &sky);
    let mut rng = Rng(1);
    for index in (1..sky.len()).rev() {
        sky.swap(index, (rng.unit() * (index + 1) as f64) as usize);
    }
    race.one_by_one("hemisphere, shuffled", &sky);
    race.closest("closest, shuffled", &sky);
}

struct Race<'a> {
    occluders: &'a Occluders<'a>,
    rivals: &'a Rivals,
}

impl Race<'_> {
    fn together(&self, name: &str, segments: &[[DVec3; 2]]) {
        let ours = || {
            let mut hidden = Vec::new();
            let count = |segments: &[[DVec3; 2]]| {
                self.occluders
                    .occluded_each(segments, &|_| false, &mut hidden);
                hidden.iter().filter(|&&hidden| hidden).count()
            };
            segments.chunks(TOGETHER).map(count).sum()
        };
        self.occlusion(name, segments, &ours);
    }

    fn one_by_one(&self, name: &str, segments: &[[DVec3; 2]]) {
        let ours = || {
            let stopped =
                |&&[from, to]: &&[DVec3; 2]| self.occluders.occluded(from, to, &|_| false);
            segments.iter().filter(stopped).count()
        };
        self.occlusion(name, segments, &ours);
    }

    fn occlusion(&self, name: &str, segments: &[[DVec3; 2]], ours: &dyn Fn() -> usize) {
        let Rivals {
            clearance,
            bvh2,
            bvh2_triangles,
            cwbvh,
            cwbvh_triangles,
        } = self.rivals;
        let by_bvh2 = || {
            let stopped = |segment: &&[DVec3; 2]| {
                let narrow = narrowed(segment, *clearance);
                !bvh2.ray_traverse_miss(narrow, |ray, id| bvh2_triangles[id].intersect(ray))
            };
            segments.iter().filter(stopped).count()
        };
        let by_cwbvh = || {
            let stopped = |segment: &&[DVec3; 2]| {
                let narrow = narrowed(segment, *clearance);
                !cwbvh.ray_traverse_miss(narrow, |ray, id| cwbvh_triangles[id].intersect(ray))
            };
            segments.iter().filter(stopped).count()
        };
        report(name, segments.len(), [ours, &by_bvh2, &by_cwbvh]);
    }

    fn closest(&self, name: &str, segments: &[[DVec3; 2]]) {
        let Rivals {
            clearance,
            bvh2,
            bvh2_triangles,
            cwbvh,
            cwbvh_triangles,
        } = self.rivals;
        let ours = || {
            let met = |&&[from, to]: &&[DVec3; 2]| {
                let (direction, length) = (to - from).normalize_and_length();
                self.occluders
                    .closest(from, direction, length, &|_| false)
                    .is_some()
            };
            segments.iter().filter(met).count()
        };
        let by_bvh2 = || {
            let met = |segment: &&[DVec3; 2]| {
                let narrow = narrowed(segment, *clearance);
                bvh2.ray_traverse(narrow, &mut RayHit::none(), |ray, id| {
                    bvh2_triangles[id].intersect(ray)
                })
            };
            segments.iter().filter(met).count()
        };
        let by_cwbvh = || {
            let met = |segment: &&[DVec3; 2]| {
                let narrow = narrowed(segment, *clearance);
                cwbvh.ray_traverse(narrow, &mut RayHit::none(), |ray, id| {
                    cwbvh_triangles[id].intersect(ray)
                })
            };
            segments.iter().filter(met).count()
        };
        report(name, segments.len(), [&ours, &by_bvh2, &by_cwbvh]);
    }
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
        "{name:<34}{:>8.2}{:>8.2}{:>8.2}{:>16.2}{:>9.1}%{:>16}",
        speed[0],
        speed[1],
        speed[2],
        speed[0] / speed[1].max(speed[2]),
        100.0 * stopped[0] as f64 / rays as f64,
        format!(
            "{:+} {:+}",
            stopped[1] as i64 - stopped[0] as i64,
            stopped[2] as i64 - stopped[0] as i64
        ),
    );
}

/// `obvhs` over the same triangles, of which it takes the masked ones for opaque, each tree with the triangles in its own order.
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
            .filter(|triangle| scene.materials[triangle.material as usize].alpha != Alpha::Blend)
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

fn narrowed([from, to]: &[DVec3; 2], clearance: f64) -> Ray {
    let (direction, length) = (*to - *from).normalize_and_length();
    // Adding zero turns -0 into 0, of which `CwBvh` is afraid.
    Ray::new(
        from.as_vec3a(),
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

/// Four rays from each texel to the nearest of 1000 lights of 2 : 1, which hang amid the free space of the scene. Texels lie in patches
/// of `side` squared, as wide as those of a lightmap of a million, and a patch has one light.
fn shadow_rays(scene: &Scene, occluders: &Occluders<'_>, side: usize) -> Vec<[DVec3; 2]> {
    let (min, max) = extent(scene);
    let size = 0.01 * (max - min).max_element();
    let areas = scene.triangles.iter().map(|t| t.area_vector().length());
    let texel = (0.5 * areas.sum::<f64>() / 1e6).sqrt();
    let patches = texels(scene, RAYS / (4 * side * side));
    let mut rng = Rng(2);
    let lights: Vec<DVec3> = (0..1000)
        .filter_map(|_| {
            let (from, normal) = patches[(rng.unit() * patches.len() as f64) as usize];
            let hit = occluders.closest(from, normal, 40.0 * size, &|_| false)?;
            Some(from + 0.5 * hit.distance * normal)
        })
        .collect();
    let mut rays = Vec::new();
    for (corner, normal) in patches {
        let near = |light: &&DVec3| light.distance_squared(corner);
        let facing = lights
            .iter()
            .filter(|&&light| normal.dot(light - corner) > 0.0);
        let Some(centre) = facing.min_by(|a, b| near(a).total_cmp(&near(b))) else {
            continue;
        };
        let (x, y) = normal.any_orthonormal_pair();
        for index in 0..4 * side * side {
            let (column, row) = (index / 4 % side, index / 4 / side);
            let from = corner + texel * (column as f64 * x + row as f64 * y);
            let offset = DVec3::new(2.0 * rng.unit() - 1.0, 0.0, rng.unit() - 0.5);
            rays.push([from, centre + size * offset]);
        }
    }
    rays.truncate(RAYS);
    rays
}

/// Four cosine-distributed rays from each texel through the whole scene.
fn hemisphere_rays(scene: &Scene) -> Vec<[DVec3; 2]> {
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
                rays.push([from, from + length * direction]);
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

//! Adaptive shadow testing: what is left untested is bounded by the error that is reported, and nothing is tested without need.

use glam::DVec3;
use lumel::bake;
use lumel::lights::{self, Lights, Polygon};
use lumel::math;
use lumel::scene::{self, Material, Scene};
use lumel::transport::{self, Counters, Options, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::{self, quad, scene_of};

fn theatre() -> Scene {
    let path = support::fixture("theatre/theatre.gltf");
    Scene::open(&path, &scene::Options::default()).expect("a fixture")
}

/// 8 × 8 receivers on the floor, 25 cm apart.
fn tile(corner: DVec3) -> Vec<Receiver> {
    (0..64)
        .map(|place| {
            let (x, z) = (place % 8, place / 8);
            Receiver {
                position: corner + DVec3::new(x as f64, 0.0, z as f64) * 0.25,
                normal: DVec3::Y,
                seed: math::hash(x, z, corner.x.to_bits()),
            }
        })
        .collect()
}

fn gather(
    scene: &Scene,
    lights: &Lights,
    tile: &[Receiver],
    threshold: f64,
) -> (Vec<Sample>, Counters) {
    let options = Options {
        direct_threshold: threshold,
        gradients: false,
        ..Options::default()
    };
    let occluders = Occluders::build(scene);
    transport::gather(tile, lights, &occluders, &options)
}

fn irradiance(sample: &Sample) -> f64 {
    sample.irradiance(DVec3::Y).max_element()
}

/// Root mean square of the difference over the mean.
fn rmse(got: &[Sample], want: &[Sample]) -> f64 {
    let n = got.len() as f64;
    let mean = want.iter().map(irradiance).sum::<f64>() / n;
    let squares: f64 = got
        .iter()
        .zip(want)
        .map(|(got, want)| (irradiance(got) - irradiance(want)).powi(2))
        .sum();
    (squares / n).sqrt() / mean
}

#[test]
fn the_error_stays_below_what_is_reported_at_every_threshold() {
    let scene = theatre();
    let lights = lights::collect(&scene, &lights::Options::default());
    assert_eq!(lights.polygons.len(), 200);
    for corner in [DVec3::new(4.1, 0.0, 6.3), DVec3::new(20.3, 0.0, 11.0)] {
        let tile = tile(corner);
        let (all, counters) = gather(&scene, &lights, &tile, 0.0);
        assert_eq!((counters.pairs_minor, counters.lights_untested), (0, 0));
        let mut before = 0.0;
        for threshold in [0.002, 0.01, 0.05] {
            let (some, counters) = gather(&scene, &lights, &tile, threshold);
            assert!(counters.lights_untested > 0);
            for (got, want) in some.iter().zip(&all) {
                let error = (irradiance(got) - irradiance(want)).abs();
                assert!(
                    error <= got.error + want.error,
                    "{threshold}: {error} {}",
                    got.error
                );
            }
            let error = rmse(&some, &all);
            assert!(error <= 2.0 * threshold, "{threshold}: {error}");
            assert!(error > before, "a larger threshold is cheaper, not better");
            before = error;
        }
    }
}

/// `side`² lamps in a plane 9 m up, of very different output.
fn lamps(side: usize) -> Lights {
    let step = 24.0 / side as f64;
    let polygons = (0..side * side).map(|index| {
        let [column, row] = [index % side, index / side].map(|k| (k as f64 + 0.5) * step);
        let centre = DVec3::new(column - 12.0, 9.0, row - 12.0);
        let (u, v) = (DVec3::X * (0.2 * step), DVec3::Z * (0.2 * step));
        let [a, b, c, d] = [
            centre - u - v,
            centre + u - v,
            centre + u + v,
            centre - u + v,
        ];
        Polygon {
            contours: vec![vec![a, b, c, d]],
            triangles: vec![[a, b, c], [a, c, d]],
            normal: DVec3::NEG_Y,
            area: 0.16 * step * step,
            radiance: DVec3::splat([100.0, 300.0, 50.0, 700.0, 20.0][index * 7 % 5]),
            two_sided: false,
            surface: Vec::new(),
        }
    });
    Lights {
        polygons: polygons.collect(),
        ..Lights::default()
    }
}

#[test]
fn thousands_of_lights_are_drawn_from_without_bias() {
    // Half of the lamps are hidden from half of the receivers.
    let wall = quad(DVec3::new(-1.0, 4.0, -8.0), 9.0 * DVec3::X, 16.0 * DVec3::Z);
    let scene = scene_of(&[(Material::default(), wall)]);
    let lights = lamps(50);
    let tile = tile(DVec3::new(-2.0, 0.0, -1.0));
    let (all, _) = gather(&scene, &lights, &tile, 0.0);
    let (some, counters) = gather(&scene, &lights, &tile, 0.004);
    assert!(counters.pairs_minor > 2000);
    assert!(counters.shadow_rays < 64 * 1200, "{}", counters.shadow_rays);
    let error = rmse(&some, &all);
    assert!(error < 0.006, "{error}");
    let bias: f64 = some
        .iter()
        .zip(&all)
        .map(|(got, want)| irradiance(got) / irradiance(want) - 1.0)
        .sum::<f64>()
        / 64.0;
    assert!(bias.abs() < 0.002, "{bias}");
    // G keeps its direction: the seen lamps are on one side.
    for (got, want) in some.iter().zip(&all) {
        assert!(got.g[0].angle_between(want.g[0]) < 0.02);
        assert!((got.phi[0] / want.phi[0] - 1.0).abs() < 0.05);
    }
}

#[test]
fn in_the_open_nothing_is_tested() {
    let corner = DVec3::new(-20.0, -1.0, -20.0);
    let floor = quad(corner, 40.0 * DVec3::Z, 40.0 * DVec3::X);
    let scene = scene_of(&[(Material::default(), floor)]);
    let lights = lamps(40);
    let tile = tile(DVec3::ZERO);
    let (all, _) = gather(&scene, &lights, &tile, 0.0);
    let (some, counters) = gather(&scene, &lights, &tile, 0.004);
    assert!(counters.pairs_minor > 1000);
    assert_eq!((counters.shadow_rays, counters.lights_untested), (0, 0));
    // Far lights count as specks, groups of them as one.
    let error = rmse(&some, &all);
    assert!(error < 1e-3, "{error}");
}

#[test]
fn few_lights_are_all_integrated() {
    let wall = quad(DVec3::new(-1.0, 4.0, -8.0), 9.0 * DVec3::X, 16.0 * DVec3::Z);
    let scene = scene_of(&[(Material::default(), wall)]);
    let mut lights = lamps(4);
    lights.polygons.truncate(transport::MANY_LIGHTS - 1);
    let tile = tile(DVec3::ZERO);
    let (all, _) = gather(&scene, &lights, &tile, 0.0);
    let (some, _) = gather(&scene, &lights, &tile, 0.9);
    assert_eq!(some, all);
}

/// Names and bytes of all files of a bake of the theatre.
fn files_of_a_bake(threads: usize) -> Vec<(String, Vec<u8>)> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cancelled = std::sync::atomic::AtomicBool::new(false);
    let execution = bake::Execution {
        threads: Some(threads),
        cancelled: &cancelled,
        progress: &|_| {},
    };
    let mut options = bake::Options::default();
    options.atlas.texels_per_metre = 0.5;
    let report = bake::bake(&theatre(), folder.path(), &options, &execution).expect("a bake");
    let light = &report.manifest["counters"]["light"];
    assert!(light["lights_untested"].as_u64() > Some(1000), "{light}");
    let read = |name: &String| {
        let bytes = std::fs::read(folder.path().join(name)).expect("a file of the bake");
        (name.clone(), bytes)
    };
    report.files.iter().map(read).collect()
}

#[test]
fn threads_change_nothing_of_what_the_histories_of_tiles_say() {
    let alone = files_of_a_bake(1);
    assert!(alone.len() >= 3);
    assert!(alone == files_of_a_bake(2), "two threads give other bytes");
}

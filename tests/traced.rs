//! Traced contours against exact ones: where tracing is good, where it would go blind, and what it leaves to the exact way.
//!
//! Errors are in steps of 255 of the brightest point, averaged over active points: those with a triangle between them and the light.

use glam::{DMat3, DVec3};
use lumel::lights;
use lumel::scene::{self, Material, Scene};
use lumel::transport::{self, Counters, Estimator, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::{Rng, emitter, fixture, quad, scene_of};

/// Points of the floor, 10 × 10 m: every fourth of 256 along each side.
fn floor() -> Vec<Receiver> {
    let side = 64;
    let place = |index: u32| 10.0 * (f64::from(index) + 0.5) / f64::from(side) - 5.0;
    (0..side * side)
        .map(|index| receiver(place(index % side), place(index / side)))
        .collect()
}

fn receiver(x: f64, z: f64) -> Receiver {
    Receiver {
        position: DVec3::new(x, 0.0, z),
        normal: DVec3::Y,
        seed: 0,
    }
}

fn gather(
    scene: &Scene,
    tiles: &[Vec<Receiver>],
    estimator: Estimator,
) -> Vec<(Vec<Sample>, Counters)> {
    let lights = lights::collect(scene, &lights::Options::default());
    let occluders = Occluders::build(scene);
    let options = transport::Options {
        estimator,
        ..transport::Options::default()
    };
    tiles
        .iter()
        .map(|tile| transport::gather(tile, &lights, &occluders, &options))
        .collect()
}

fn norm(matrix: DMat3) -> f64 {
    (0..3)
        .map(|axis| matrix.col(axis).length_squared())
        .sum::<f64>()
        .sqrt()
}

fn sorted(mut numbers: Vec<f64>) -> Vec<f64> {
    numbers.sort_by(f64::total_cmp);
    numbers
}

/// What is asked of a scene, per active point.
#[derive(Debug)]
struct Figures {
    n_active: usize,
    /// Mean.
    rays: f64,
    /// Share of points that went the exact way.
    fallbacks: f64,
    /// Mean of |ΔE| · 255 / max E.
    average_difference: f64,
    /// Median of |ΔJ| / |J|, over points with a J.
    j_median: f64,
    /// Share of points whose error is more than three times the reported one.
    underestimated: f64,
}

/// Each point is a tile of its own, so that the active ones can be told.
fn figures(scene: &Scene, receivers: Vec<Receiver>) -> Figures {
    let tiles: Vec<_> = receivers.into_iter().map(|r| vec![r]).collect();
    let exact = gather(scene, &tiles, Estimator::Exact);
    let traced = gather(scene, &tiles, Estimator::Traced);
    let irradiance = |sample: &Sample| sample.irradiance(DVec3::Y).max_element();
    let brightest = exact
        .iter()
        .map(|(samples, _)| irradiance(&samples[0]))
        .fold(0.0, f64::max);
    let (mut errors, mut js) = (Vec::new(), Vec::new());
    let (mut rays, mut fallbacks, mut underestimated) = (0, 0, 0);
    for ((want, exact_counters), (got, counters)) in exact.iter().zip(&traced) {
        if exact_counters.pairs_exact == 0 {
            continue;
        }
        let (want, got) = (&want[0], &got[0]);
        assert!(got.g[0].is_finite() && got.phi[0] >= 0.0);
        rays += counters.shadow_rays;
        fallbacks += counters.points_fallback;
        let error = (irradiance(want) - irradiance(got)).abs();
        errors.push(error * 255.0 / brightest);
        underestimated += usize::from(error > 3.0 * (got.error + want.error));
        if norm(want.j[0]) > 0.0 && got.has_gradient {
            js.push(norm(got.j[0] - want.j[0]) / norm(want.j[0]));
        }
    }
    let n_active = errors.len();
    let per_point = |count: u64| count as f64 / n_active as f64;
    Figures {
        n_active,
        rays: per_point(rays),
        fallbacks: per_point(fallbacks),
        average_difference: errors.iter().sum::<f64>() / n_active as f64,
        j_median: sorted(js.clone())[js.len() / 2],
        underestimated: underestimated as f64 / n_active as f64,
    }
}

fn load(name: &str) -> Scene {
    let path = fixture(name).join(format!("{name}.gltf"));
    Scene::open(&path, &scene::Options::default()).expect("the fixture is a scene")
}

/// The limits are those of the plan for tracing: a fiftieth of a step, forty rays.
#[test]
fn smooth_penumbrae_need_few_rays_and_lose_nothing() {
    let figures = figures(&load("penumbra"), floor());
    assert!(figures.n_active > 500, "{figures:?}");
    assert!(figures.rays <= 40.0, "{figures:?}");
    assert!(figures.average_difference <= 0.005, "{figures:?}");
    assert!(figures.j_median <= 1e-3, "{figures:?}");
    assert!(figures.underestimated <= 0.01, "{figures:?}");
    // Otherwise it would be the exact way that is tested.
    assert!(figures.fallbacks <= 0.05, "{figures:?}");
}

#[test]
fn a_sheet_thinner_than_the_lattice_is_not_missed() {
    let figures = figures(&load("slab"), floor());
    assert!(figures.n_active > 500, "{figures:?}");
    assert!(figures.rays <= 40.0, "{figures:?}");
    assert!(figures.average_difference <= 0.01, "{figures:?}");
    assert!(figures.j_median <= 1e-3, "{figures:?}");
    assert!(figures.underestimated <= 0.01, "{figures:?}");
    assert!(figures.fallbacks <= 0.05, "{figures:?}");
}

/// A light of 2 × 2 m at 5 m that looks down.
fn light() -> Vec<[DVec3; 3]> {
    quad(
        DVec3::new(-1.0, 5.0, -1.0),
        DVec3::new(2.0, 0.0, 0.0),
        DVec3::new(0.0, 0.0, 2.0),
    )
}

fn any_point(rng: &mut Rng, low: DVec3, high: DVec3) -> DVec3 {
    DVec3::new(
        rng.range(low.x, high.x),
        rng.range(low.y, high.y),
        rng.range(low.z, high.z),
    )
}

/// Some triangles and tetrahedra of all sizes between floor and light.
fn clutter(rng: &mut Rng) -> Vec<[DVec3; 3]> {
    let mut triangles = Vec::new();
    for _ in 0..1 + (rng.unit() * 6.0) as usize {
        let (low, high) = (DVec3::new(-1.5, 0.4, -1.5), DVec3::new(1.5, 4.4, 1.5));
        let centre = any_point(rng, low, high);
        let size = rng.range(0.02, 0.8);
        let [a, b, c, d] = [0; 4].map(|_| (centre + size * rng.direction()).as_vec3().as_dvec3());
        if rng.unit() < 0.5 {
            triangles.push([a, b, c]);
        } else {
            triangles.extend([[a, b, c], [a, c, d], [a, d, b], [b, d, c]]);
        }
    }
    triangles.retain(|triangle| {
        triangle
            .iter()
            .all(|vertex| 0.0 < vertex.y && vertex.y < 5.0)
    });
    triangles
}

#[test]
fn random_clutter_is_traced_as_it_is_clipped() {
    let (mut n_points, mut n_traced, mut n_off) = (0, 0, 0);
    for seed in 0..200 {
        let rng = &mut Rng::new(seed);
        let scene = scene_of(&[(emitter(1.0), light()), (Material::default(), clutter(rng))]);
        let tile: Vec<_> = (0..8)
            .map(|_| receiver(rng.range(-2.0, 2.0), rng.range(-2.0, 2.0)))
            .collect();
        let tiles = [tile];
        let (exact, _) = &gather(&scene, &tiles, Estimator::Exact)[0];
        let (traced, counters) = &gather(&scene, &tiles, Estimator::Traced)[0];
        n_points += tiles[0].len() as u64;
        n_traced += counters.pairs_traced * 8 - counters.points_fallback;
        for (want, got) in exact.iter().zip(traced) {
            // The whole light gives at most 0.25 lux there.
            n_off += u64::from((got.g[0] - want.g[0]).length() > 1e-9);
        }
    }
    assert!(
        n_traced * 10 > n_points * 7,
        "{n_traced} of {n_points} traced"
    );
    assert!(n_off * 200 <= n_points, "{n_off} of {n_points} are off");
}

/// Concave, with a hole, across the horizon of a tilted receiver: all are clipped, and counted.
#[test]
fn lights_of_other_shapes_are_left_to_the_exact_way() {
    let corner = DVec3::new(-1.0, 5.0, -1.0);
    let (u, v) = (DVec3::X, DVec3::Z);
    let square = |i: f64, j: f64| quad(corner + i * u + j * v, u, v);
    let concave: Vec<_> = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
        .into_iter()
        .flat_map(|(i, j)| square(i, j))
        .collect();
    let ring: Vec<_> = (0..9)
        .filter(|index| *index != 4)
        .flat_map(|index| square(f64::from(index % 3), f64::from(index / 3)))
        .collect();
    let tilted = DVec3::new(1.0, 0.05, 0.0).normalize();
    for (light, normal) in [(concave, DVec3::Y), (ring, DVec3::Y), (light(), tilted)] {
        let sheet = quad(
            DVec3::new(-0.2, 2.0, -0.3),
            DVec3::new(0.9, 0.3, 0.0),
            DVec3::new(0.1, 0.0, 0.8),
        );
        let scene = scene_of(&[(emitter(1.0), light), (Material::default(), sheet)]);
        let tiles = [vec![Receiver {
            normal,
            ..receiver(0.2, 0.1)
        }]];
        let (exact, _) = &gather(&scene, &tiles, Estimator::Exact)[0];
        let (traced, counters) = &gather(&scene, &tiles, Estimator::Traced)[0];
        assert_eq!(counters.points_fallback, 1);
        assert_eq!(traced[0], exact[0]);
    }
}

#[test]
fn neither_order_nor_threads_change_a_bit() {
    let scene = load("penumbra");
    let tile: Vec<_> = (0..64)
        .map(|index| receiver(f64::from(index % 8) / 8.0, f64::from(index / 8) / 8.0))
        .collect();
    let reversed: Vec<_> = tile.iter().rev().copied().collect();
    let (expected, counters) =
        gather(&scene, std::slice::from_ref(&tile), Estimator::Traced).remove(0);
    assert!(counters.pairs_traced == 1 && counters.shadow_rays > 0);
    let (mut backwards, _) = gather(&scene, &[reversed], Estimator::Traced).remove(0);
    backwards.reverse();
    assert_eq!(expected, backwards);
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let options = transport::Options {
        estimator: Estimator::Traced,
        ..transport::Options::default()
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| transport::gather(&tile, &lights, &occluders, &options)))
            .collect();
        for thread in threads {
            let (samples, _) = thread.join().expect("gathering does not panic");
            assert_eq!(samples, expected);
        }
    });
}

//! Same physics, several ways: every estimator on every fixture against the exact contour, and whether each knows its own error.

use glam::DVec3;
use lumel::lights;
use lumel::math;
use lumel::scene::{self, Scene};
use lumel::transport::{self, Estimator, Options, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::exact::reference;
use crate::support::fixture;
use crate::transport::extended::irradiance_behind;

/// Fixtures with a floor at y = 0 under one light: half side of the floor that is looked at, and receivers along it.
const FLOORS: [(&str, f64, usize); 4] = [
    ("penumbra", 3.0, 40),
    ("slab", 3.0, 64),
    ("contact", 1.5, 48),
    ("leaves", 1.2, 10),
];

/// Receivers in tiles of 2 × 2, off the lines of the fixtures' own coordinates.
fn floor(half: f64, n: usize) -> Vec<Vec<Receiver>> {
    let at = |index: usize| (index as f64 + 0.437) * 2.0 * half / n as f64 - half;
    let mut tiles = Vec::new();
    for row in (0..n).step_by(2) {
        for column in (0..n).step_by(2) {
            let places = [(0, 0), (1, 0), (0, 1), (1, 1)];
            let tile = places.map(|(x, z)| Receiver {
                position: DVec3::new(at(column + x), 0.0, at(row + z)),
                normal: DVec3::Y,
                seed: math::hash((column + x) as u64, (row + z) as u64, 7),
            });
            tiles.push(tile.to_vec());
        }
    }
    tiles
}

struct Floor {
    name: &'static str,
    scene: Scene,
    /// Receivers whose shaft to the light is not empty.
    tiles: Vec<Vec<Receiver>>,
}

fn floors() -> Vec<Floor> {
    FLOORS
        .iter()
        .map(|&(name, half, n)| {
            let path = fixture(name).join(format!("{name}.gltf"));
            let scene = Scene::open(&path, &scene::Options::default()).expect("a fixture");
            let mut tiles = floor(half, n);
            {
                let lights = lights::collect(&scene, &lights::Options::default());
                let occluders = Occluders::build(&scene);
                tiles.retain(|tile| {
                    let options = with(Estimator::Sampled, 1);
                    let (_, counters) = transport::gather(tile, &lights, &occluders, &options);
                    counters.pairs_sampled > 0
                });
            }
            Floor { name, scene, tiles }
        })
        .collect()
}

fn with(estimator: Estimator, samples: u32) -> Options {
    Options {
        estimator,
        samples,
        ..Options::default()
    }
}

fn samples(floor: &Floor, options: &Options) -> Vec<Sample> {
    let lights = lights::collect(&floor.scene, &lights::Options::default());
    let occluders = Occluders::build(&floor.scene);
    floor
        .tiles
        .iter()
        .flat_map(|tile| transport::gather(tile, &lights, &occluders, options).0)
        .collect()
}

/// Triangles that shine, and the others.
fn parts(scene: &Scene) -> (Vec<[DVec3; 3]>, Vec<[DVec3; 3]>) {
    let is_light = |material: u32| scene.materials[material as usize].emissive.x > 0.0;
    let part = |light: bool| {
        let triangles = scene.triangles.iter();
        triangles
            .filter(|triangle| is_light(triangle.material) == light)
            .map(|triangle| triangle.vertices)
            .collect()
    };
    (part(true), part(false))
}

fn irradiance(sample: &Sample) -> f64 {
    sample.irradiance(DVec3::Y).x
}

#[test]
fn exact_is_exact_on_slab_and_contact() {
    for floor in floors() {
        if !["slab", "contact"].contains(&floor.name) {
            continue;
        }
        let (light, occluders) = parts(&floor.scene);
        let radiance = lights::collect(&floor.scene, &lights::Options::default()).polygons[0]
            .radiance
            .x;
        let receivers = floor.tiles.iter().flatten();
        let got = samples(&floor, &with(Estimator::Exact, 1));
        for (receiver, sample) in receivers.zip(&got) {
            let (g, phi) = reference(receiver.position, receiver.normal, &light, &occluders);
            let (open, open_phi) = reference(receiver.position, receiver.normal, &light, &[]);
            let off = (sample.g[0] / radiance - g).length() / open.length();
            let off_phi = (sample.phi[0] / radiance - phi).abs() / open_phi;
            assert!(
                off < 1e-8 && off_phi < 1e-8,
                "{} at {}: G off by {off:e}, φ by {off_phi:e}",
                floor.name,
                receiver.position
            );
        }
    }
}

#[test]
fn sampling_stays_within_four_standard_errors() {
    let (mut n_points, mut n_outside) = (0, 0);
    for floor in floors() {
        let truth = samples(&floor, &with(Estimator::Exact, 1));
        for (sample, truth) in samples(&floor, &with(Estimator::Sampled, 64))
            .iter()
            .zip(&truth)
        {
            n_points += 1;
            let off = (irradiance(sample) - irradiance(truth)).abs();
            n_outside += usize::from(off > 4.0 * sample.error + truth.error);
        }
    }
    assert!(n_points > 3000, "only {n_points} points");
    assert!(
        n_outside * 10_000 <= n_points,
        "{n_outside} of {n_points} points are more than four standard errors off"
    );
}

#[test]
fn every_estimator_knows_its_own_error() {
    let mut bad = Vec::new();
    for estimator in Estimator::ALL {
        if matches!(estimator, Estimator::Exact | Estimator::Auto) {
            // Errors of rounding have a test of their own, against extended precision.
            continue;
        }
        let (mut n_points, mut n_honest) = (0, 0);
        let (mut claimed, mut real) = (0.0, 0.0);
        for floor in floors() {
            let truth = samples(&floor, &with(Estimator::Exact, 1));
            let got = samples(&floor, &with(estimator, 64));
            for (sample, truth) in got.iter().zip(&truth) {
                let off = (irradiance(sample) - irradiance(truth)).abs();
                n_points += 1;
                n_honest += usize::from(off <= 3.0 * sample.error + truth.error);
                claimed += sample.error;
                real += off;
            }
        }
        let ratio = claimed / real;
        if n_honest * 100 < n_points * 99 || !(0.1..=10.0).contains(&ratio) {
            bad.push(format!(
                "{estimator:?}: {n_honest} of {n_points} within three times the claim, which is {ratio:.2} times the error on average"
            ));
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

#[test]
fn exact_contours_know_their_rounding() {
    for floor in floors() {
        if !["slab", "contact"].contains(&floor.name) {
            continue;
        }
        let (light, occluders) = parts(&floor.scene);
        let lights = lights::collect(&floor.scene, &lights::Options::default());
        let radiance = lights.polygons[0].radiance.x;
        let got = samples(&floor, &with(Estimator::Exact, 1));
        let (mut n_points, mut n_honest, mut claimed, mut real) = (0, 0, 0.0, 0.0);
        for (receiver, sample) in floor.tiles.iter().flatten().zip(&got) {
            let want = radiance
                * irradiance_behind(receiver.position, receiver.normal, &light, &occluders);
            let off = (irradiance(sample) - want).abs();
            n_points += 1;
            // Where nothing is seen the reference keeps slivers of its own rounding.
            n_honest += usize::from(off <= 3.0 * sample.error + 1e-25 * radiance);
            claimed += sample.error;
            real += off;
        }
        let ratio = claimed / real;
        assert!(
            n_honest * 100 >= n_points * 99 && (1.0..=10.0).contains(&ratio),
            "{}: {n_honest} of {n_points} within three times the claim, which is {ratio:.2} times the error on average",
            floor.name
        );
    }
}

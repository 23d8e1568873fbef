//! Traced contours against exact ones: on the fixtures that show where tracing is good and where it goes blind.

use glam::{DMat3, DVec3};
use lumel::lights;
use lumel::scene::{self, Scene};
use lumel::transport::{self, Counters, Estimator, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::fixture;

/// Points along each side of the floor: every fourth of 256.
const SIDE: usize = 64;

/// Points of the floor, 10 × 10 m.
fn floor(side: usize) -> Vec<Receiver> {
    let place = |index: usize| 10.0 * (index as f64 + 0.5) / side as f64 - 5.0;
    (0..side * side)
        .map(|index| Receiver {
            position: DVec3::new(place(index % side), 0.0, place(index / side)),
            normal: DVec3::Y,
            seed: index as u64,
        })
        .collect()
}

fn load(name: &str) -> Scene {
    let path = fixture(name).join(format!("{name}.gltf"));
    scene::load(&path, &scene::Options::default()).expect("the fixture is a scene").0
}

/// Each receiver as a tile of its own, so that those with an empty shaft can be told from the others.
fn gather_each(
    scene: &Scene,
    receivers: &[Receiver],
    estimator: Estimator,
) -> Vec<(Sample, Counters)> {
    let lights = lights::collect(scene, &lights::Options::default());
    let occluders = Occluders::build(scene);
    let options = transport::Options {
        estimator,
        ..transport::Options::default()
    };
    receivers
        .iter()
        .map(|&receiver| {
            let (samples, counters) =
                transport::gather(&[receiver], &lights, &occluders, &options);
            (samples[0], counters)
        })
        .collect()
}

fn norm(matrix: DMat3) -> f64 {
    (0..3).map(|axis| matrix.col(axis).length_squared()).sum::<f64>().sqrt()
}

#[test]
fn figures() {
    for name in ["penumbra", "slab", "contact", "room", "cornell"] {
        let scene = load(name);
        let receivers = floor(SIDE);
        let exact = gather_each(&scene, &receivers, Estimator::Exact);
        let traced = gather_each(&scene, &receivers, Estimator::Traced);
        let brightest = exact.iter().map(|e| e.0.irradiance(DVec3::Y).x).fold(0.0, f64::max);
        let (mut active, mut rays, mut fallback, mut sum, mut reported) = (0, 0, 0, 0.0, 0.0);
        let mut errors = Vec::new();
        let mut js = Vec::new();
        let mut dishonest = 0;
        let mut n_rays_points=0;
        for (e, t) in exact.iter().zip(&traced) {
            if e.1.pairs_exact == 0 { continue; }
            active += 1;
            rays += t.0.rays; fallback += t.1.points_fallback;
            if t.0.rays>0 {n_rays_points+=1;}
            let d = (e.0.irradiance(DVec3::Y) - t.0.irradiance(DVec3::Y)).abs().max_element();
            errors.push(d * 255.0 / brightest);
            sum += d; reported += t.0.error;
            if d > 3.0 * t.0.error + 1e-12*brightest { dishonest += 1; }
            if t.0.has_gradient && e.0.has_gradient && norm(e.0.j[0]) > 0.0 { js.push(norm(t.0.j[0]-e.0.j[0])/norm(e.0.j[0])); }
        }
        errors.sort_by(f64::total_cmp);
        js.sort_by(f64::total_cmp);
        let n = f64::from(active);
        println!("{name}: active {active} rayed {n_rays_points} rays {:.2} fallback {:.3} AvDif {:.5} p99 {:.5} p99.9 {:.5} max {:.5} J median {:.2e} p99 {:.2e} dishonest {dishonest} true {:.3e} reported {:.3e}",
            f64::from(rays)/n, fallback as f64/n, sum*255.0/brightest/n, errors[(errors.len()*99)/100], errors[errors.len()*999/1000], errors[errors.len()-1],
            js[js.len()/2], js[js.len()*99/100], sum/n, reported/n);
    }
}

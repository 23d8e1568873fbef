//! Light through glass: what a pane lets through, known answers.

use glam::{DVec3, Vec3};
use lumel::lights::{self, Lights};
use lumel::scene::{Alpha, Material, PunctualKind, PunctualLight, Scene};
use lumel::transport::{self, Counters, Estimator, Options, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::{self, quad, scene_of};

/// A horizontal square with its middle above the origin.
fn square(half: f64, y: f64) -> Vec<[DVec3; 3]> {
    let corner = DVec3::new(-half, y, -half);
    quad(corner, 2.0 * half * DVec3::X, 2.0 * half * DVec3::Z)
}

fn glass(color: [f32; 3], alpha: f32) -> Material {
    let [r, g, b] = color;
    Material {
        base_color: [r, g, b, alpha],
        alpha: Alpha::Blend,
        ..Material::default()
    }
}

const RED: [f32; 3] = [1.0, 0.25, 0.0];
const GREEN: [f32; 3] = [0.5, 1.0, 0.5];

/// The panes, and below them a light over the floor when `lamp`.
fn scene(panes: &[(Material, f64)], lamp: bool) -> Scene {
    let mut parts: Vec<_> = panes
        .iter()
        .map(|(material, y)| (material.clone(), square(50.0, *y)))
        .collect();
    if lamp {
        parts.push((support::emitter(7.0), square(1.0, 5.0)));
    }
    scene_of(&parts)
}

fn bulb() -> PunctualLight {
    PunctualLight {
        name: "bulb".to_owned(),
        node: 0,
        intensity: DVec3::splat(25.0),
        position: DVec3::new(0.0, 5.0, 0.0),
        direction: DVec3::NEG_Y,
        kind: PunctualKind::Point { range: None },
        size: Some(0.0),
    }
}

fn look(scene: &Scene, lights: &Lights) -> (Sample, Counters) {
    let receiver = Receiver {
        position: DVec3::new(0.3, 0.0, 0.2),
        normal: DVec3::Y,
        seed: 3,
    };
    let occluders = Occluders::build(scene);
    let options = Options {
        estimator: Estimator::Auto,
        ..Options::default()
    };
    let (samples, counters) = transport::gather(&[receiver], lights, &occluders, &options);
    (samples[0], counters)
}

/// E through the panes over E without them, for a lamp with an area and for one without.
fn shares(panes: &[(Material, f64)]) -> [DVec3; 2] {
    [true, false].map(|lamp| {
        let mut with = scene(panes, lamp);
        let mut without = scene(&[(Material::default(), -9.0)], lamp);
        if !lamp {
            with.punctual_lights.push(bulb());
            without.punctual_lights.push(bulb());
        }
        let [got, want] = [&with, &without].map(|scene| {
            let lights = lights::collect(scene, &lights::Options::default());
            look(scene, &lights).0.irradiance(DVec3::Y)
        });
        got / want
    })
}

fn assert_shares(panes: &[(Material, f64)], want: DVec3) {
    for got in shares(panes) {
        assert!((got - want).length() < 1e-6, "{got:?} {want:?}");
    }
}

#[test]
fn a_red_pane_tints() {
    assert_shares(&[(glass(RED, 0.5), 2.0)], DVec3::new(0.5, 0.125, 0.0));
    // Seen from either side, and from any height.
    assert_shares(
        &[(glass(RED, 0.0625), 4.9)],
        DVec3::new(0.9375, 0.234_375, 0.0),
    );
}

#[test]
fn overlapping_panes_multiply() {
    let panes = [(glass(RED, 0.5), 2.0), (glass(GREEN, 0.25), 3.0)];
    assert_shares(&panes, DVec3::new(0.5 * 0.375, 0.125 * 0.75, 0.0));
    // Two of one mesh in one place count twice.
    let panes = [(glass(RED, 0.5), 2.0), (glass(RED, 0.5), 2.0)];
    assert_shares(&panes, DVec3::new(0.25, 0.015_625, 0.0));
}

#[test]
fn what_is_not_there_does_not_tint_and_what_is_opaque_hides() {
    assert_shares(&[(glass([0.0; 3], 0.0), 2.0)], DVec3::ONE);
    assert_shares(&[(glass(RED, 1.0), 2.0)], DVec3::ZERO);
    let panes = [(glass(RED, 0.5), 2.0), (Material::default(), 3.0)];
    assert_shares(&panes, DVec3::ZERO);
}

#[test]
fn glass_by_transmission_tints_too() {
    let pane = Material {
        base_color: [0.5, 0.25, 1.0, 1.0],
        transmission: 0.5,
        ..Material::default()
    };
    assert_shares(&[(pane, 2.0)], DVec3::new(0.25, 0.125, 0.5));
}

#[test]
fn light_ends_behind_eight_layers() {
    let panes = |n: usize| -> Vec<_> {
        (0..n)
            .map(|k| (glass([1.0; 3], 0.125), 1.0 + 0.25 * k as f64))
            .collect()
    };
    assert_shares(&panes(8), DVec3::splat(0.875_f64.powi(8)));
    assert_shares(&panes(9), DVec3::ZERO);
}

#[test]
fn half_a_pane_tints_half_of_a_lamp() {
    let half = quad(
        DVec3::new(-50.0, 2.5, -50.0),
        50.0 * DVec3::X,
        100.0 * DVec3::Z,
    );
    let lamp = (support::emitter(7.0), square(1.0, 5.0));
    let scene = scene_of(&[(glass(RED, 0.5), half), lamp.clone()]);
    let lights = lights::collect(&scene, &lights::Options::default());
    let receiver = |x: f64| Receiver {
        position: DVec3::new(x, 0.0, 0.0),
        normal: DVec3::Y,
        seed: 3,
    };
    let occluders = Occluders::build(&scene);
    let options = Options {
        samples: 4096,
        ..Options::default()
    };
    let at = |x: f64| transport::gather(&[receiver(x)], &lights, &occluders, &options).0[0];
    let (middle, left, right) = (at(0.0), at(-9.0), at(9.0));
    let open = at(0.0).irradiance(DVec3::Y).x / 0.75;
    let want = open * DVec3::new(0.75, 0.5625, 0.5);
    let got = middle.irradiance(DVec3::Y);
    assert!((got - want).length() < 5e-3 * open, "{got:?} {want:?}");
    assert!(middle.error < 0.01 * open && !middle.has_gradient);
    // Off the middle the pane covers all of the lamp or nothing of it, and nothing is sampled where it covers nothing.
    let ratio = left.irradiance(DVec3::Y) / right.irradiance(DVec3::Y);
    assert!((ratio - DVec3::new(0.5, 0.125, 0.0)).length() < 1e-6);
    assert!(right.has_gradient && right.rays == 0);
}

#[test]
fn a_leaf_casts_its_leaf() {
    // Alpha by vertex: 0 on the left edge, 1 on the right; the cutoff is in the middle.
    let mut scene = scene_of(&[(
        Material {
            alpha: Alpha::Mask { cutoff: 0.5 },
            ..Material::default()
        },
        square(1.0, 2.5),
    )]);
    let primitive = &mut scene.meshes[0].primitives[0];
    primitive.vertex_alpha = primitive
        .positions
        .iter()
        .map(|position: &Vec3| 0.5 * (position.x + 1.0))
        .collect();
    scene.punctual_lights.push(bulb());
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    for step in -30_i32..=30 {
        let x = 0.1 * f64::from(step) + 0.01;
        let receiver = Receiver {
            position: DVec3::new(x, 0.0, 0.0),
            normal: DVec3::Y,
            seed: 1,
        };
        let (samples, _) = transport::gather(&[receiver], &lights, &occluders, &Options::default());
        // The shadow is twice as large as the leaf.
        let hidden = (0.0..2.0).contains(&x);
        assert_eq!(samples[0].g[0] == DVec3::ZERO, hidden, "{x}");
    }
}

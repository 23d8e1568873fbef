//! Authored lights: closed forms, differences, and the shadows of a straight edge, whose penumbrae have closed forms too.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use lumel::lights::{self, Lights};
use lumel::scene::{Material, PunctualKind, PunctualLight, Scene};
use lumel::transport::{self, Estimator, Options, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::{Rng, quad, scene_of};

fn light(kind: PunctualKind, position: DVec3, direction: DVec3) -> PunctualLight {
    PunctualLight {
        name: "light".to_owned(),
        node: 0,
        intensity: DVec3::new(3.0, 2.0, 1.0),
        position,
        direction: direction.normalize(),
        kind,
        size: Some(0.0),
    }
}

fn point(position: DVec3) -> PunctualLight {
    light(PunctualKind::Point { range: None }, position, DVec3::NEG_Y)
}

fn lights_of(scene: &mut Scene, authored: Vec<PunctualLight>) -> Lights {
    scene.punctual_lights = authored;
    lights::collect(scene, &lights::Options::default())
}

fn upwards(position: DVec3) -> Receiver {
    Receiver {
        position,
        normal: DVec3::Y,
        seed: 1,
    }
}

fn sample(lights: &Lights, scene: &Scene, receiver: &Receiver) -> Sample {
    sample_with(lights, scene, receiver, Estimator::Auto)
}

fn sample_with(
    lights: &Lights,
    scene: &Scene,
    receiver: &Receiver,
    estimator: Estimator,
) -> Sample {
    let options = Options {
        estimator,
        ..Options::default()
    };
    let occluders = Occluders::build(scene);
    let (samples, _) = transport::gather(&[*receiver], lights, &occluders, &options);
    samples[0]
}

/// A scene with nothing but a far speck, so that it has an extent.
fn open() -> Scene {
    let corner = DVec3::new(0.0, -50.0, 0.0);
    scene_of(&[(Material::default(), quad(corner, DVec3::X, DVec3::Z))])
}

/// Checks `j` and `grad_phi` against central differences.
fn assert_derivatives(lights: &Lights, scene: &Scene, receiver: &Receiver, tolerance: f64) {
    let here = sample(lights, scene, receiver);
    assert!(here.has_gradient);
    let step = 1e-5;
    let (mut j, mut grad_phi) = (DMat3::ZERO, DVec3::ZERO);
    for axis in 0..3 {
        let at = |sign: f64| {
            let mut moved = *receiver;
            moved.position[axis] += sign * step;
            sample(lights, scene, &moved)
        };
        let (after, before) = (at(1.0), at(-1.0));
        *j.col_mut(axis) = (after.g[0] - before.g[0]) / (2.0 * step);
        grad_phi[axis] = (after.phi[0] - before.phi[0]) / (2.0 * step);
    }
    let scale = j.x_axis.length() + j.y_axis.length() + j.z_axis.length();
    let error = here.j[0] - j;
    let error = error.x_axis.length() + error.y_axis.length() + error.z_axis.length();
    assert!(
        error <= tolerance * scale,
        "J: {:?}, differences {j:?}",
        here.j[0]
    );
    let error = (here.grad_phi[0] - grad_phi).length();
    assert!(
        error <= tolerance * grad_phi.length(),
        "∇φ: {:?}, differences {grad_phi:?}",
        here.grad_phi[0]
    );
}

#[test]
fn a_point_light_falls_with_the_square_of_the_distance() {
    let mut scene = open();
    for seed in 0..50 {
        let mut rng = Rng::new(seed);
        let position = 3.0 * rng.direction();
        let lights = lights_of(&mut scene, vec![point(position)]);
        let receiver = Receiver {
            normal: (position + 0.5 * rng.direction()).normalize(),
            ..upwards(DVec3::ZERO)
        };
        let got = sample(&lights, &scene, &receiver);
        let want = position * (3.0 / position.length().powi(3));
        assert!((got.g[0] - want).length() < 1e-15 && got.rays == 0);
        assert!((got.phi[1] - 2.0 / 9.0).abs() < 1e-15);
        assert_derivatives(&lights, &scene, &receiver, 1e-8);
    }
}

#[test]
fn spots_fall_off_as_the_extension_says() {
    let mut scene = open();
    let (inner, outer) = (0.3_f64, 0.7_f64);
    let kind = PunctualKind::Spot {
        range: Some(9.0),
        inner_angle: inner,
        outer_angle: outer,
    };
    let lights = lights_of(
        &mut scene,
        vec![light(kind, DVec3::new(0.0, 4.0, 0.0), DVec3::NEG_Y)],
    );
    let mut n_ramp = 0;
    for step in 0..100 {
        let x = 0.06 * f64::from(step);
        let receiver = upwards(DVec3::new(x, 0.0, 0.3));
        let got = sample(&lights, &scene, &receiver);
        let to_light = DVec3::new(0.0, 4.0, 0.0) - receiver.position;
        let d = to_light.length();
        // As printed in the extension.
        let scale = 1.0 / f64::max(0.001, inner.cos() - outer.cos());
        let offset = -outer.cos() * scale;
        let cosine = DVec3::NEG_Y.dot(-to_light / d);
        let angular = (cosine * scale + offset).clamp(0.0, 1.0);
        let window = (1.0 - (d / 9.0).powi(4)).clamp(0.0, 1.0);
        let want = 3.0 * angular * angular * window / (d * d);
        assert!((got.g[0].length() - want).abs() < 1e-14, "{x}");
        if 0.01 < angular && angular < 0.99 {
            n_ramp += 1;
            assert_derivatives(&lights, &scene, &receiver, 1e-6);
        }
    }
    assert!(n_ramp > 20);
}

#[test]
fn nothing_arrives_beyond_the_range() {
    let mut scene = open();
    let kind = PunctualKind::Point { range: Some(2.0) };
    let lights = lights_of(&mut scene, vec![light(kind, DVec3::ZERO, DVec3::NEG_Y)]);
    for (distance, lit) in [(1.99, true), (2.0, false), (2.5, false)] {
        let receiver = upwards(DVec3::new(0.0, -distance, 0.0));
        let got = sample(&lights, &scene, &receiver);
        assert_eq!(got.g[0].length() > 0.0, lit, "{distance}");
    }
    let bounded = |centre: DVec3| lights.points[0].misses(centre, 0.5);
    assert!(bounded(DVec3::new(2.6, 0.0, 0.0)) && !bounded(DVec3::new(2.4, 0.0, 0.0)));
}

#[test]
fn what_a_spot_is_said_to_miss_it_misses() {
    let mut n_missed = 0;
    for seed in 0..3000 {
        let mut rng = Rng::new(seed);
        let inner = rng.range(0.0, 1.2);
        let spot = lights::Point {
            position: rng.direction(),
            intensity: DVec3::ONE,
            radius: 0.0,
            range: Some(rng.range(0.5, 4.0)),
            cone: Some(lights::Cone {
                axis: rng.direction(),
                inner_angle: inner,
                outer_angle: inner + rng.range(0.01, 0.3),
            }),
        };
        let (centre, radius) = (2.0 * rng.direction(), rng.range(0.01, 1.0));
        if spot.misses(centre, radius) {
            n_missed += 1;
            for _ in 0..20 {
                let place = centre + rng.direction() * (radius * rng.unit());
                assert_eq!(spot.attenuation(place).0, 0.0, "case {seed}");
            }
        }
    }
    assert!(n_missed > 500);
}

/// A wall that fills x < 0 at the height `y`, much larger than everything else.
fn half_plane(y: f64) -> Scene {
    let corner = DVec3::new(-500.0, y, -500.0);
    let triangles = quad(corner, 500.0 * DVec3::X, 1000.0 * DVec3::Z);
    scene_of(&[(Material::default(), triangles)])
}

/// Share of a disc of radius 1 beyond a chord at `x` from its middle.
fn segment(x: f64) -> f64 {
    let x = x.clamp(-1.0, 1.0);
    (x.acos() - x * (1.0 - x * x).sqrt()) / PI
}

#[test]
fn points_and_suns_without_a_size_cast_hard_shadows() {
    let mut scene = half_plane(1.0);
    let sun = light(PunctualKind::Directional, DVec3::ZERO, DVec3::NEG_Y);
    let lights = lights_of(&mut scene, vec![point(DVec3::new(0.0, 2.0, 0.0)), sun]);
    assert_eq!((lights.points.len(), lights.suns.len()), (1, 1));
    for (x, point_seen, sun_seen) in [(-1e-3, 0.0, 0.0), (1e-3, 1.0, 1.0)] {
        let got = sample(&lights, &scene, &upwards(DVec3::new(x, 0.0, 0.0)));
        let want = 3.0 * (point_seen / 4.0 + sun_seen);
        assert!((got.g[0].y - want).abs() < 1e-5, "{x}: {}", got.g[0].y);
        // Where nothing can stand in the way no ray is cast.
        assert_eq!(got.rays, if x < 0.0 { 2 } else { 0 });
    }
}

#[test]
fn the_sun_s_penumbra_is_as_wide_as_the_sun() {
    let mut scene = half_plane(10.0);
    let mut sun = light(PunctualKind::Directional, DVec3::ZERO, DVec3::NEG_Y);
    sun.size = None;
    let lights = lights_of(&mut scene, vec![sun]);
    let radius = 10.0 * (0.5 * 0.53_f64.to_radians()).tan();
    for step in -12_i32..=12 {
        let x = 0.1 * f64::from(step) * radius;
        let receiver = upwards(DVec3::new(x, 0.0, 0.0));
        let got = sample(&lights, &scene, &receiver);
        let want = 3.0 * (1.0 - segment(x / radius));
        assert!(
            (got.g[0].y - want).abs() < 3e-3 * 3.0,
            "{x}: {} {want}",
            got.g[0].y
        );
        assert_eq!(got.rays, 0);
        if step.abs() < 9 {
            // The border of the sun has corners: 1e-4 of a step over one.
            assert_derivatives(&lights, &scene, &receiver, 1e-4);
        }
    }
    // Where it begins and ends, within 1 % of its width.
    let lit = |x: f64| sample(&lights, &scene, &upwards(DVec3::new(x, 0.0, 0.0))).g[0].y / 3.0;
    assert!(lit(-1.01 * radius) == 0.0 && lit(-0.98 * radius) > 0.0);
    assert!((lit(1.01 * radius) - 1.0).abs() < 1e-12 && lit(0.98 * radius) < 1.0);
}

#[test]
fn a_sphere_gives_the_light_of_a_point_and_a_penumbra() {
    let mut scene = half_plane(1.0);
    let mut bulb = point(DVec3::new(0.0, 2.0, 0.0));
    bulb.size = Some(0.1);
    let lights = lights_of(&mut scene, vec![bulb]);
    let at = |x: f64, estimator| {
        sample_with(
            &lights,
            &scene,
            &upwards(DVec3::new(x, 0.0, 0.0)),
            estimator,
        )
    };
    // In the open, and just before the shadow begins: as bright as a point.
    for x in [1.0, 0.12] {
        let got = at(x, Estimator::Auto);
        let want = 3.0 * 2.0 / f64::hypot(2.0, x).powi(3);
        assert!((got.g[0].y - want).abs() < 1e-12, "{x}");
    }
    for x in [-0.08, -0.05, 0.0, 0.03, 0.09] {
        let exact = at(x, Estimator::Exact);
        let sampled = at(x, Estimator::Sampled);
        assert!(exact.rays == 0 && sampled.rays > 0);
        let difference = (exact.g[0].y - sampled.g[0].y).abs();
        assert!(
            difference < 5.0 * sampled.error.max(1e-3),
            "{x}: {difference}"
        );
        // The disc is seen edge-on by nobody: a straight edge at half height moves over it twice as fast as the receiver.
        let want = 0.75 * (1.0 - segment(x / 0.1));
        assert!(
            (exact.g[0].y - want).abs() < 0.01,
            "{x}: {} {want}",
            exact.g[0].y
        );
        assert_derivatives(&lights, &scene, &upwards(DVec3::new(x, 0.0, 0.0)), 0.02);
    }
}

#[test]
fn a_sphere_sinks_below_the_horizon_smoothly() {
    let mut scene = open();
    let mut bulb = point(DVec3::new(2.0, 0.0, 0.0));
    bulb.size = Some(0.5);
    let lights = lights_of(&mut scene, vec![bulb]);
    // Half of it is above; E of a half disc: ∫ sin over the upper half of the cone.
    let got = sample(&lights, &scene, &upwards(DVec3::ZERO));
    let radiance = 3.0 / (PI * 0.25);
    let sine: f64 = 0.25;
    let n = 400_000;
    let mut want = 0.0;
    // Over the disc of directions: y dω with dω = dA / cos.
    for index in 0..n {
        let r = sine * ((index as f64 + 0.5) / n as f64).sqrt();
        let mean_y = 2.0 * r / PI;
        want += mean_y / (1.0 - r * r).sqrt() * (PI * sine * sine / 2.0) / n as f64;
    }
    let difference = (got.g[0].y - radiance * want).abs();
    assert!(
        difference < 5e-3 * radiance * want,
        "{} {}",
        got.g[0].y,
        radiance * want
    );
    let dark = sample(&lights, &scene, &upwards(DVec3::new(0.0, 0.51, 0.0)));
    assert_eq!(dark.g[0], DVec3::ZERO);
    let inside = sample(&lights, &scene, &upwards(DVec3::new(2.0, 0.1, 0.0)));
    assert_eq!(inside.g[0], DVec3::ZERO);
}

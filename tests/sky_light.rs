//! Light of a sky in a scene: closed forms, pixel sums, brute force with a sun for every pixel.

use std::f64::consts::PI;

use glam::{DMat3, DVec3, Vec3};
use lumel::lights::{self, Lights, SkyMode, Sun, sky};
use lumel::scene::{Environment, Material, Scene, Sky};
use lumel::transport::{self, Options, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::{quad, scene_of};

const MODES: [SkyMode; 3] = [SkyMode::Points, SkyMode::Interleaved, SkyMode::Cells];

/// A picture with some structure: dim below, a bright patch, a colour gradient.
fn picture() -> Environment {
    Environment::from_fn(64, 32, |d| {
        let up = (1.2 + d.y) as f32;
        let patch = if d.dot(DVec3::new(0.6, 0.7, 0.4).normalize()) > 0.9 {
            6.0
        } else {
            0.0
        };
        Vec3::new(up + patch, up, 0.5 + patch * 0.5)
    })
}

fn hung(image: Environment, rotation: f64) -> Sky {
    Sky {
        image,
        rotation,
        strength: 2.0,
        rule: None,
    }
}

fn lights_of(scene: &mut Scene, sky: Sky, mode: SkyMode, n: usize) -> Lights {
    scene.sky = Some(sky);
    let options = lights::Options {
        sky_lights: n,
        sky_mode: mode,
        ..lights::Options::default()
    };
    lights::collect(scene, &options)
}

fn receiver(position: DVec3, normal: DVec3, seed: u64) -> Receiver {
    Receiver {
        position,
        normal: normal.normalize(),
        seed,
    }
}

fn look(scene: &Scene, lights: &Lights, receiver: &Receiver) -> Sample {
    let occluders = Occluders::build(scene);
    transport::gather(&[*receiver], lights, &occluders, &Options::default()).0[0]
}

fn speck() -> Scene {
    let corner = DVec3::new(0.0, -900.0, 0.0);
    scene_of(&[(Material::default(), quad(corner, DVec3::X, DVec3::Z))])
}

#[test]
fn a_uniform_sky_gives_pi_in_the_open_and_half_beside_a_wall() {
    let image = || Environment::constant(Vec3::splat(0.5));
    let mut open = speck();
    let wall = quad(DVec3::new(0.0, -1e4, -1e4), 2e4 * DVec3::Z, 2e4 * DVec3::Y);
    let mut walled = scene_of(&[(Material::default(), wall)]);
    for n in [1, 7, 64] {
        let lights = lights_of(&mut open, hung(image(), 0.0), SkyMode::Cells, n);
        let at = receiver(DVec3::ZERO, DVec3::new(0.3, 1.0, 0.2), 0);
        let got = look(&open, &lights, &at);
        let e = got.irradiance(at.normal);
        assert!((e - PI).abs().max_element() < 1e-6, "{n}: {e:?}");
        assert!((got.phi[0] - 2.0 * PI).abs() < 1e-6);
        // A texel one metre from a wall 20 km wide.
        let lights = lights_of(&mut walled, hung(image(), 0.0), SkyMode::Cells, n);
        let at = receiver(DVec3::X, DVec3::Y, 0);
        let e = look(&walled, &lights, &at).irradiance(DVec3::Y);
        assert!((e - PI / 2.0).abs().max_element() < 1e-3, "{n}: {e:?}");
    }
}

#[test]
fn what_nothing_hides_has_the_light_of_its_pixels() {
    let mut scene = speck();
    for mode in MODES {
        // Nine sets of more would take minutes to make.
        let most = if mode == SkyMode::Interleaved { 16 } else { 64 };
        for n in [5, most] {
            let options = sky::Options {
                directions: n,
                sets: if mode == SkyMode::Interleaved { 9 } else { 1 },
                split_bright: mode == SkyMode::Cells,
                ..sky::Options::default()
            };
            let made = sky::build(&picture(), &options, &|_| true).expect("good options");
            assert!(made.regions.is_empty());
            for seed in [0, 4] {
                let at = receiver(DVec3::ZERO, DVec3::new(0.2, 1.0, 0.1), seed);
                let set = &made.sets[seed as usize % made.sets.len()];
                let outlines = sky::cells(&set.directions());
                let is_above = |index: usize| match mode {
                    SkyMode::Cells => outlines[index]
                        .vertices
                        .iter()
                        .all(|v| v.dot(at.normal) > 0.0),
                    _ => set.cells[index].direction.dot(at.normal) > 0.0,
                };
                let want: DVec3 = (0..set.cells.len())
                    .filter(|&index| is_above(index))
                    .map(|index| {
                        let vectors = set.cells[index].light_vector;
                        2.0 * DVec3::from_array(vectors.map(|v| v.dot(at.normal)))
                    })
                    .sum();
                let mut lights = lights_of(&mut scene, hung(picture(), 0.0), mode, n);
                lights
                    .distant
                    .retain(|light| light.contour.iter().all(|v| v.dot(at.normal) > 0.0));
                let got = look(&scene, &lights, &at).irradiance(at.normal);
                let error = (got - want).abs().max_element();
                assert!(
                    error < 1e-6 * want.max_element(),
                    "{mode:?} {n}: {got:?} {want:?}"
                );
            }
        }
    }
}

/// A sun for every pixel.
fn brute_force(image: &Environment, strength: f64) -> Lights {
    let (width, height) = (image.width(), image.height());
    let mut lights = Lights {
        extent: (DVec3::ZERO, 20.0),
        ..Lights::default()
    };
    for row in 0..height {
        let edge = |row: u32| (f64::from(row) / f64::from(height) * PI).cos();
        let solid_angle = 2.0 * PI / f64::from(width) * (edge(row) - edge(row + 1));
        for (column, pixel) in (0..width).zip(image.row(row)) {
            let u = (f64::from(column) + 0.5) / f64::from(width);
            let v = (f64::from(row) + 0.5) / f64::from(height);
            lights.suns.push(Sun {
                towards: Environment::direction(u, v),
                illuminance: Vec3::from_array(*pixel).as_dvec3() * (solid_angle * strength),
                excess: [DVec3::ZERO; 3],
                set: (0, 1),
            });
        }
    }
    lights
}

/// A roof over x < 0 and a pillar.
fn shelter() -> Scene {
    let mut triangles = quad(DVec3::new(-6.0, 2.0, -6.0), 6.0 * DVec3::X, 12.0 * DVec3::Z);
    triangles.extend(quad(
        DVec3::new(1.0, 0.0, -0.3),
        0.6 * DVec3::Z,
        3.0 * DVec3::Y,
    ));
    scene_of(&[(Material::default(), triangles)])
}

#[test]
fn shadows_of_the_sky_approach_those_of_all_its_pixels() {
    let mut scene = shelter();
    let fine = brute_force(
        &Environment::from_fn(128, 64, |d| Vec3::from_array(picture().radiance(d))),
        2.0,
    );
    let places: Vec<Receiver> = (0..12)
        .map(|k| {
            receiver(
                DVec3::new(-2.0 + 0.4 * f64::from(k), 0.0, 0.3),
                DVec3::Y,
                u64::from(k as u32),
            )
        })
        .collect();
    let reference: Vec<DVec3> = places
        .iter()
        .map(|at| look(&scene, &fine, at).irradiance(DVec3::Y))
        .collect();
    let error = |scene: &Scene, lights: &Lights| -> f64 {
        let differences = places.iter().zip(&reference).map(|(at, want)| {
            let got = look(scene, lights, at).irradiance(DVec3::Y);
            ((got - want) / want.max_element()).length_squared()
        });
        (differences.sum::<f64>() / places.len() as f64).sqrt()
    };
    let cells: Vec<f64> = [16, 64, 256]
        .map(|n| {
            let lights = lights_of(&mut scene, hung(picture(), 0.0), SkyMode::Cells, n);
            error(&scene, &lights)
        })
        .to_vec();
    let points = lights_of(&mut scene, hung(picture(), 0.0), SkyMode::Points, 256);
    let points = error(&scene, &points);
    assert!(
        cells[0] < 0.15 && cells[1] < 0.05 && cells[2] < 0.02,
        "{cells:?}"
    );
    assert!(cells[1] < points, "{cells:?} {points}");
}

#[test]
fn a_quarter_turn_of_the_sky_turns_its_light() {
    let mut scene = speck();
    let turn = DMat3::from_rotation_y(PI / 2.0);
    for mode in [SkyMode::Points, SkyMode::Cells] {
        let straight = lights_of(&mut scene, hung(picture(), 0.0), mode, 40);
        let turned = lights_of(&mut scene, hung(picture(), PI / 2.0), mode, 40);
        let normal = DVec3::new(0.5, 0.7, -0.2);
        let before = look(&scene, &straight, &receiver(DVec3::ZERO, normal, 0));
        let after = look(&scene, &turned, &receiver(DVec3::ZERO, turn * normal, 0));
        for channel in 0..3 {
            let want = turn * before.g[channel];
            assert!(
                (after.g[channel] - want).length() < 1e-9 * want.length(),
                "{mode:?}"
            );
        }
    }
}

#[test]
fn derivatives_of_a_sky_s_shadow_are_those_of_its_light() {
    let mut scene = shelter();
    let lights = lights_of(&mut scene, hung(picture(), 0.0), SkyMode::Cells, 64);
    let (mut good, mut count) = (0, 0);
    for k in 0..20 {
        let x = -1.5 + 0.11 * f64::from(k);
        let at = receiver(DVec3::new(x, 0.0, 0.31), DVec3::Y, 0);
        let here = look(&scene, &lights, &at);
        assert!(here.has_gradient && here.rays == 0);
        let step = 1e-5;
        let moved = |sign: f64| {
            let mut moved = at;
            moved.position.x += sign * step;
            look(&scene, &lights, &moved).g[0]
        };
        let difference = (moved(1.0) - moved(-1.0)) / (2.0 * step);
        let error = (here.j[0].x_axis - difference).length() / difference.length();
        count += 1;
        good += u32::from(error < 1e-3);
    }
    assert!(good * 10 >= count * 9, "{good} of {count}");
}

#[test]
fn the_sun_of_a_picture_casts_a_sharp_shadow() {
    let sun = DVec3::new(0.3, 1.0, 0.1).normalize();
    let image = Environment::from_fn(512, 256, |d| {
        Vec3::splat(if d.angle_between(sun) < 0.012 {
            5e4
        } else {
            1.0
        })
    });
    let roof = quad(
        DVec3::new(-60.0, 2.0, -60.0),
        60.0 * DVec3::X,
        120.0 * DVec3::Z,
    );
    let mut scene = scene_of(&[(Material::default(), roof)]);
    let lights = lights_of(&mut scene, hung(image, 0.0), SkyMode::Cells, 16);
    // The shadow's edge lies where the line to the sun meets the roof's edge.
    let edge = -2.0 * sun.x / sun.y;
    let e = |x: f64| {
        look(
            &scene,
            &lights,
            &receiver(DVec3::new(x, 0.0, 0.0), DVec3::Y, 0),
        )
        .irradiance(DVec3::Y)
        .x
    };
    let (dark, lit) = (e(edge - 0.1), e(edge + 0.1));
    assert!(lit > 4.0 * dark, "{dark} {lit}");
    // Half of the sun at the edge.
    let middle = e(edge);
    assert!(
        middle > 1.5 * dark && middle < 0.8 * lit,
        "{dark} {middle} {lit}"
    );
}

#[test]
fn a_closed_room_asks_no_sky() {
    let mut triangles = Vec::new();
    let size = 4.0;
    for (corner, u, v) in [
        (DVec3::ZERO, DVec3::X, DVec3::Z),
        (DVec3::Y * size, DVec3::Z, DVec3::X),
        (DVec3::ZERO, DVec3::Y, DVec3::X),
        (DVec3::Z * size, DVec3::X, DVec3::Y),
        (DVec3::ZERO, DVec3::Z, DVec3::Y),
        (DVec3::X * size, DVec3::Y, DVec3::Z),
    ] {
        triangles.extend(quad(corner, size * u, size * v));
    }
    let mut scene = scene_of(&[(Material::default(), triangles)]);
    let lights = lights_of(&mut scene, hung(picture(), 0.0), SkyMode::Cells, 256);
    let tile: Vec<Receiver> = (0..64)
        .map(|k| {
            receiver(
                DVec3::new(
                    1.0 + 0.05 * (k % 8) as f64,
                    0.0,
                    1.5 + 0.05 * (k / 8) as f64,
                ),
                DVec3::Y,
                k,
            )
        })
        .collect();
    let occluders = Occluders::build(&scene);
    let (samples, counters) = transport::gather(&tile, &lights, &occluders, &Options::default());
    assert!(samples.iter().all(|sample| sample.g[0].length() < 1e-12));
    assert_eq!(counters.shadow_rays, 0);
    assert!(counters.pairs_hidden > 20, "{counters:?}");
}

#[test]
fn a_black_sky_and_no_sky_are_the_same() {
    let mut scene = speck();
    for mode in MODES {
        let lights = lights_of(
            &mut scene,
            hung(Environment::constant(Vec3::ZERO), 0.0),
            mode,
            8,
        );
        assert!(lights.is_empty());
    }
}

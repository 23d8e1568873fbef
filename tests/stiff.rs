//! Stiff and extreme input: a table of cases, each with what must come out.
//!
//! Every row is evaluated by every estimator; none may give a number that is not finite or an irradiance below zero. The exact one must
//! give the value in the row.

use glam::{DAffine3, DVec3};
use lumel::lights;
use lumel::scene::{Material, Scene};
use lumel::transport::{self, Estimator, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::exact::reference;
use crate::support::{emitter, quad, scene_of};

struct Row {
    name: &'static str,
    scene: Scene,
    receiver: Receiver,
    /// Irradiance in lux, and by how much of it the exact estimator may be off.
    want: f64,
    tolerance: f64,
}

fn up(position: DVec3) -> Receiver {
    Receiver {
        position,
        normal: DVec3::Y,
        seed: 0,
    }
}

/// A light of `size` metres at the height `height`, facing down, its centre above the origin.
fn lamp(size: f64, height: f64) -> Vec<[DVec3; 3]> {
    let corner = DVec3::new(-0.5 * size, height, -0.5 * size);
    quad(corner, size * DVec3::X, size * DVec3::Z)
}

fn room(light: Vec<[DVec3; 3]>, occluders: Vec<[DVec3; 3]>) -> Scene {
    scene_of(&[(emitter(1.0), light), (Material::default(), occluders)])
}

/// The row whose expected value comes from the independent reference.
fn against_reference(
    name: &'static str,
    light: Vec<[DVec3; 3]>,
    occluders: Vec<[DVec3; 3]>,
    receiver: Receiver,
) -> Row {
    let rounded = |triangles: &[[DVec3; 3]]| -> Vec<[DVec3; 3]> {
        triangles
            .iter()
            .map(|triangle| triangle.map(|vertex| vertex.as_vec3().as_dvec3()))
            .collect()
    };
    let (g, _) = reference(
        receiver.position,
        receiver.normal,
        &rounded(&light),
        &rounded(&occluders),
    );
    Row {
        name,
        scene: room(light, occluders),
        receiver,
        want: g.dot(receiver.normal),
        tolerance: 1e-8,
    }
}

/// The same scene, moved and scaled.
fn transformed(mut scene: Scene, motion: DAffine3) -> Scene {
    for instance in &mut scene.instances {
        instance.world_from_local = motion * instance.world_from_local;
    }
    Scene::assemble(
        scene.name,
        scene.meshes,
        scene.instances,
        scene.materials,
        scene.images,
    )
}

/// A box and a thin quad between a floor point in their penumbra and a lamp.
fn shadow() -> (Vec<[DVec3; 3]>, Vec<[DVec3; 3]>, Receiver) {
    let mut occluders = quad(DVec3::new(-0.3, 2.0, -0.2), 0.7 * DVec3::X, 0.9 * DVec3::Z);
    occluders.extend(quad(
        DVec3::new(0.1, 2.5, -2.0),
        0.05 * DVec3::X,
        4.0 * DVec3::Z,
    ));
    (lamp(2.0, 5.0), occluders, up(DVec3::new(0.4, 0.0, 0.3)))
}

fn rows() -> Vec<Row> {
    let mut rows = Vec::new();

    let wall_light = quad(DVec3::new(-1.0, -1.0, 2.0), 2.0 * DVec3::Y, 2.0 * DVec3::X);
    rows.push(against_reference(
        "a wall light that the receiver's plane cuts in half",
        wall_light.clone(),
        Vec::new(),
        up(DVec3::ZERO),
    ));
    rows.push(against_reference(
        "the same half hidden by a quad",
        wall_light,
        quad(DVec3::new(-0.5, 0.2, 1.0), 2.0 * DVec3::X, 0.2 * DVec3::Y),
        up(DVec3::ZERO),
    ));
    rows.push(against_reference(
        "a receiver 1e-6 m below the edge of a light",
        lamp(2.0, 1e-6),
        Vec::new(),
        up(DVec3::new(1.0, 0.0, 0.0)),
    ));
    rows.push(against_reference(
        "a receiver 1e-6 m from the edge of an occluder",
        lamp(2.0, 5.0),
        quad(DVec3::new(0.0, 1e-6, -1.0), DVec3::X, 2.0 * DVec3::Z),
        up(DVec3::ZERO),
    ));
    // A texel of a shelf's side, at the very edge of the board above it, as it was found in `room`.
    let side = f64::from(3.47_f32);
    rows.push(against_reference(
        "a receiver whose horizon runs along the edge of an occluder that hides all",
        quad(DVec3::new(0.4, 2.9, 2.5), 2.4 * DVec3::X, 1.1 * DVec3::Z),
        quad(
            DVec3::new(side - 9.0, 1.08, -9.0),
            9.0 * DVec3::X,
            18.0 * DVec3::Z,
        ),
        Receiver {
            position: DVec3::new(side, 0.984_615_399_287_297_1, 0.100_000_003_973_642_98),
            normal: DVec3::NEG_X,
            seed: 0,
        },
    ));
    // Far and small: radiance × area / distance², to (size / distance)².
    rows.push(Row {
        name: "a light of 1 mm at 10 km",
        scene: room(lamp(1e-3, 0.0), Vec::new()),
        receiver: up(DVec3::new(0.0, -1e4, 0.0)),
        want: f64::from(1e-3_f32).powi(2) / 1e8,
        tolerance: 1e-7,
    });
    // E/π of a square of half side a at height 1: (4/π) · a/√(1+a²) · atan(a/√(1+a²)) · ½·2 (Howell C-11, four corners).
    let half = 500.0_f64;
    let ratio = half / half.hypot(1.0);
    rows.push(Row {
        name: "a light of 1 km at 1 m",
        scene: room(lamp(1e3, 1.0), Vec::new()),
        receiver: up(DVec3::ZERO),
        want: 4.0 * ratio * ratio.atan(),
        tolerance: 1e-12,
    });

    let (light, occluders, receiver) = shadow();
    let mut with_needles = occluders.clone();
    with_needles.push([
        DVec3::new(-0.6, 3.0, 0.0),
        DVec3::new(0.8, 3.0, 0.1),
        DVec3::new(0.8, 3.0, 0.1 + 1e-6),
    ]);
    rows.push(against_reference(
        "a needle",
        light.clone(),
        with_needles,
        receiver,
    ));
    let plain = against_reference("a penumbra", light.clone(), occluders.clone(), receiver);
    let want = plain.want;
    rows.push(plain);
    let mut with_points = occluders.clone();
    let point = DVec3::new(0.2, 3.0, 0.1);
    with_points.extend([
        [point; 3],
        [point, point + DVec3::X, point],
        [point, point + DVec3::X, point + 0.5 * DVec3::X],
    ]);
    let same = |name, scene, receiver| Row {
        name,
        scene,
        receiver,
        want,
        tolerance: 1e-8,
    };
    rows.push(same(
        "triangles without area",
        room(light.clone(), with_points),
        receiver,
    ));
    let mut twice = occluders.clone();
    twice.extend(occluders.iter().map(|&[a, b, c]| [a, c, b]));
    twice.extend(occluders.iter().copied());
    rows.push(same(
        "every occluder three times, both ways round",
        room(light.clone(), twice),
        receiver,
    ));
    let mut frame = occluders.clone();
    frame.extend(quad(DVec3::new(0.5, 5.0, 0.5), DVec3::X, DVec3::Z));
    rows.push(same(
        "an occluder that lies in the light",
        room(light.clone(), frame),
        receiver,
    ));
    let mut carpet = occluders.clone();
    carpet.extend(quad(
        DVec3::new(-1.0, 0.0, -1.0),
        4.0 * DVec3::Z,
        4.0 * DVec3::X,
    ));
    rows.push(same(
        "an occluder that the receiver lies on",
        room(light.clone(), carpet),
        receiver,
    ));

    let moved = |name, motion: DAffine3, tolerance| {
        let (light, occluders, receiver) = shadow();
        Row {
            name,
            scene: transformed(room(light, occluders), motion),
            receiver: up(motion.transform_point3(receiver.position)),
            want,
            tolerance,
        }
    };
    // At 1e6 m a position is known to 1e-10 m, a part in 1e10 of the light's distance; a shadow's edge moves as much.
    let offset = DVec3::new(1e6, -1e6, 1e6);
    rows.push(moved(
        "the penumbra 1000 km away",
        DAffine3::from_translation(offset),
        1e-8,
    ));
    rows.push(moved(
        "the penumbra 1e5 times larger",
        DAffine3::from_scale(DVec3::splat(1e5)),
        1e-8,
    ));
    rows.push(moved(
        "the penumbra 1e4 times smaller",
        DAffine3::from_scale(DVec3::splat(1e-4)),
        1e-8,
    ));
    for (name, radiance) in [("radiance 1e-30", 1e-30_f32), ("radiance 1e30", 1e30)] {
        rows.push(Row {
            name,
            scene: scene_of(&[
                (emitter(radiance), light.clone()),
                (Material::default(), occluders.clone()),
            ]),
            receiver,
            want: want * f64::from(radiance),
            tolerance: 1e-8,
        });
    }

    let halves = |split: f64| {
        let left = quad(
            DVec3::new(-3.0, 2.0, -3.0),
            (3.0 + split) * DVec3::X,
            6.0 * DVec3::Z,
        );
        let right = quad(
            DVec3::new(split, 2.0, -3.0),
            (3.0 - split) * DVec3::X,
            6.0 * DVec3::Z,
        );
        (left, right)
    };
    let (left, right) = halves(0.0);
    rows.push(Row {
        name: "the crack between two quads that share an edge",
        scene: room(lamp(2.0, 5.0), [left.clone(), right].concat()),
        receiver: up(DVec3::ZERO),
        want: 0.0,
        tolerance: 1e-12,
    });
    // The right side in two pieces, so that a vertex of theirs lies on the edge of the left one.
    let lower = quad(DVec3::new(0.0, 2.0, -3.0), 3.0 * DVec3::X, 2.7 * DVec3::Z);
    let upper = quad(DVec3::new(0.0, 2.0, -0.3), 3.0 * DVec3::X, 3.3 * DVec3::Z);
    rows.push(Row {
        name: "the crack with a T-junction",
        scene: room(lamp(2.0, 5.0), [left, lower, upper].concat()),
        receiver: up(DVec3::ZERO),
        want: 0.0,
        // Vertices are rounded to f32 and the crack with them: 1e-7 m of 2 m.
        tolerance: 1e-6,
    });
    rows.push(Row {
        name: "a receiver in the plane of the light",
        scene: room(lamp(2.0, 5.0), Vec::new()),
        receiver: up(DVec3::new(3.0, 5.0, 0.0)),
        want: 0.0,
        tolerance: 0.0,
    });
    rows.push(Row {
        name: "a receiver on the light",
        scene: room(lamp(2.0, 5.0), Vec::new()),
        receiver: up(DVec3::new(0.25, 5.0, 0.25)),
        want: 0.0,
        tolerance: 0.0,
    });
    rows
}

fn sample(row: &Row, estimator: Estimator) -> Sample {
    let lights = lights::collect(&row.scene, &lights::Options::default());
    let occluders = Occluders::build(&row.scene);
    let options = transport::Options {
        estimator,
        ..transport::Options::default()
    };
    transport::gather(&[row.receiver], &lights, &occluders, &options).0[0]
}

#[test]
fn stiff_cases_have_the_documented_values() {
    let mut bad = Vec::new();
    for row in rows() {
        for estimator in Estimator::ALL {
            let sample = sample(&row, estimator);
            let finite = sample.g.iter().all(|g| g.is_finite())
                && sample.phi.iter().all(|phi| phi.is_finite() && *phi >= 0.0)
                && sample.j.iter().all(|j| j.is_finite())
                && sample.grad_phi.iter().all(|gradient| gradient.is_finite())
                && sample.error.is_finite()
                && sample.error >= 0.0;
            let got = sample.irradiance(row.receiver.normal).x;
            let scale = if row.want == 0.0 { 1.0 } else { row.want };
            let off = (got - row.want).abs() / scale;
            let right =
                !matches!(estimator, Estimator::Exact | Estimator::Auto) || off <= row.tolerance;
            if !(finite && got >= 0.0 && right) {
                bad.push(format!(
                    "{}: {estimator:?}: expected {:e}, got {got:e}, off by {off:e}",
                    row.name, row.want
                ));
            }
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

//! Light from polygons: closed forms against extended precision, laws, and the estimators against closed forms.

pub(crate) mod extended;

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use lumel::lights::Lights;
use lumel::lights::Polygon;
use lumel::scene::{Material, Scene};
use lumel::transport::{self, Estimator, Options, Receiver, Sums};
use lumel::visibility::Occluders;

use self::extended::Dd;
use crate::support::{self, Rng};

/// The parallelogram at `corner` with sides `u` and `v`, shining along u × v.
fn polygon([corner, u, v]: [DVec3; 3]) -> Polygon {
    let [a, b, c, d] = [corner, corner + u, corner + u + v, corner + v];
    let across = u.cross(v);
    Polygon {
        contours: vec![vec![a, b, c, d]],
        triangles: vec![[a, b, c], [a, c, d]],
        normal: across.normalize(),
        area: across.length(),
        radiance: DVec3::ONE,
        two_sided: false,
        surface: Vec::new(),
    }
}

/// A rectangle and a receiver in general position.
struct Case {
    rectangle: [DVec3; 3],
    receiver: Receiver,
    /// Distance from a point on the light, in diagonals of the light.
    sizes: f64,
    /// Cosine of the angle at which that point is seen.
    cosine: f64,
    /// Whether the light crosses the horizon.
    cut: bool,
}

/// A rectangle whose corners are exact: the sides are columns of a matrix of whole numbers that rotates and scales, times a short
/// number each. Thirds of the cases have a light across the horizon, a receiver that faces the light's plane, and any receiver. Every
/// other case lies 1e5 from the origin, on a grid of 2^-30 that keeps positions exact there.
fn case(seed: u64) -> Case {
    let mut rng = Rng::new(seed);
    let [a, b, c, d] = std::array::from_fn(|_| (rng.unit() * 15.0).floor() - 7.0);
    let d = if a == 0.0 && b == 0.0 && c == 0.0 {
        1.0
    } else {
        d
    };
    let u = DVec3::new(
        a * a + b * b - c * c - d * d,
        2.0 * (b * c + a * d),
        2.0 * (b * d - a * c),
    );
    let v = DVec3::new(
        2.0 * (b * c - a * d),
        a * a - b * b + c * c - d * d,
        2.0 * (c * d + a * b),
    );
    let mut side = || (rng.range(0.1, 1.0) * 256.0).round() / 256.0 / 64.0;
    let (u, v) = (u * side(), v * side());
    let offset = if seed.is_multiple_of(2) { 1e5 } else { 0.0 };
    let on_grid = |p: DVec3| (p * 2f64.powi(30)).round() * 2f64.powi(-30);
    let corner = on_grid(rng.direction()) + (rng.direction() * offset).round();
    let size = (u + v).length();

    let target = corner + u * rng.unit() + v * rng.unit();
    let across = u.cross(v).normalize();
    let towards = rng.direction();
    let towards = towards * towards.dot(across).signum();
    let sizes = 10f64.powf(rng.range(-3.0, 4.0));
    let mut position = target + towards * (sizes * size);
    if offset > 0.0 {
        position = on_grid(position);
    }
    let any = rng.direction();
    let to_target = target - position;
    let normal = match seed % 3 {
        0 => to_target.cross(any),
        1 => any * 0.1 * sizes.min(1.0) * towards.dot(across) - across,
        _ => any * any.dot(to_target).signum(),
    }
    .normalize();
    Case {
        rectangle: [corner, u, v],
        receiver: Receiver {
            position,
            normal,
            seed,
        },
        sizes,
        cosine: towards.dot(across),
        cut: [corner, corner + u, corner + u + v, corner + v]
            .iter()
            .any(|&vertex| (vertex - position).dot(normal) <= 0.0),
    }
}

/// The light at `x` in extended precision.
fn reference(case: &Case, x: extended::Vector) -> extended::Light {
    if case.cut {
        extended::rectangle_above(case.rectangle, x, case.receiver.normal)
    } else {
        extended::rectangle(case.rectangle, x)
    }
}

/// Derivatives of the reference by central differences. With a step of 1e-7 of the smallest length in the case the difference quotient is
/// off by 1e-14 (relative to scale over distance), its rounding by less.
fn differences(case: &Case) -> (DMat3, DVec3) {
    let [_, u, v] = case.rectangle;
    let x = extended::vector(case.receiver.position);
    let step = 1e-7 * case.sizes.min(1.0) * case.cosine * (u + v).length();
    let (mut j, mut grad_phi) = (DMat3::ZERO, DVec3::ZERO);
    for axis in 0..3 {
        let shift = extended::vector(DVec3::AXES[axis] * step);
        let (g1, phi1) = reference(case, extended::plus(x, shift));
        let (g0, phi0) = reference(case, extended::minus(x, shift));
        let per = Dd::from(0.5) / Dd::from(step);
        *j.col_mut(axis) = extended::rounded(extended::times(extended::minus(g1, g0), per));
        grad_phi[axis] = ((phi1 - phi0) * per).to_f64();
    }
    (j, grad_phi)
}

fn norm(matrix: DMat3) -> f64 {
    (0..3)
        .map(|axis| matrix.col(axis).length_squared())
        .sum::<f64>()
        .sqrt()
}

#[test]
fn rectangles_agree_with_extended_precision_at_any_distance() {
    let (mut cut, mut nearest, mut farthest) = (0, f64::INFINITY, 0.0f64);
    for seed in 0..1000 {
        let case = case(seed);
        let light = polygon(case.rectangle);
        let got = transport::unoccluded(&light, &case.receiver, true);
        let (g, phi) = reference(&case, extended::vector(case.receiver.position));
        let (g, phi) = (extended::rounded(g), phi.to_f64());
        let (j, grad_phi) = differences(&case);
        // Rounding of positions alone moves the light's plane by ε of the distance: within 1e-3 rad of edge-on that is 1e-13 of its
        // foreshortened light, and no formula in f64 keeps 1e-12 there.
        let tolerance = 1e-12 * (1e-3 / case.cosine).max(1.0);
        let error = (got.g - g).length() / g.length();
        assert!(error < tolerance, "case {seed}: G {error:e}");
        let error = (got.phi - phi).abs() / phi;
        assert!(error < tolerance, "case {seed}: fluence {error:e}");
        assert!(got.has_gradient, "case {seed}");
        let error = norm(got.j - j) / norm(j);
        assert!(error < 1e-9, "case {seed}: J {error:e}");
        let error = (got.grad_phi - grad_phi).length() / grad_phi.length();
        assert!(error < 1e-9, "case {seed}: gradient of fluence {error:e}");
        let error = (got.g - g).length();
        assert!(
            error <= got.rounding,
            "case {seed}: {error:e} {:e}",
            got.rounding
        );
        cut += usize::from(case.cut);
        nearest = nearest.min(case.sizes);
        farthest = farthest.max(case.sizes);
    }
    assert!((300..700).contains(&cut), "{cut} cross the horizon");
    assert!(nearest < 2e-3 && farthest > 5e3);
}

#[test]
fn the_two_references_agree() {
    for seed in 0..1000 {
        let case = case(seed);
        if case.cut {
            continue;
        }
        let x = extended::vector(case.receiver.position);
        let (g, phi) = extended::rectangle(case.rectangle, x);
        let (other, excess) = extended::rectangle_above(case.rectangle, x, case.receiver.normal);
        let difference = extended::rounded(extended::minus(g, other)).length();
        // 30 digits, of which the excess of a small light's angles loses as many as the light is small, twice.
        let tolerance = 1e-28 * case.sizes.max(1.0).powi(2) / case.cosine;
        assert!(
            difference < tolerance * extended::rounded(g).length(),
            "case {seed}"
        );
        let difference = (phi - excess).to_f64().abs();
        assert!(
            difference < tolerance * phi.to_f64(),
            "case {seed}: {difference:e}"
        );
    }
}

/// Whether two results agree to `tolerance` relative to the size of each quantity.
fn assert_agree(got: &Sums, want: &Sums, tolerance: f64, place: &str) {
    let pairs = [
        ((got.g - want.g).length(), want.g.length()),
        ((got.phi - want.phi).abs(), want.phi.abs()),
        (norm(got.j - want.j), norm(want.j)),
        (
            (got.grad_phi - want.grad_phi).length(),
            want.grad_phi.length(),
        ),
    ];
    for (quantity, (difference, size)) in pairs.into_iter().enumerate() {
        assert!(
            difference <= tolerance * size,
            "{place}: quantity {quantity} differs by {difference:e} of {size:e}"
        );
    }
}

fn plus(a: &Sums, b: &Sums) -> Sums {
    Sums {
        g: a.g + b.g,
        phi: a.phi + b.phi,
        j: a.j + b.j,
        grad_phi: a.grad_phi + b.grad_phi,
        ..*a
    }
}

#[test]
fn the_quarters_of_a_light_add_up() {
    for seed in 0..300 {
        let case = case(seed);
        let [corner, u, v] = case.rectangle;
        let whole = transport::unoccluded(&polygon(case.rectangle), &case.receiver, true);
        let parts = [DVec3::ZERO, u / 2.0, v / 2.0, (u + v) / 2.0].map(|shift| {
            let quarter = polygon([corner + shift, u / 2.0, v / 2.0]);
            transport::unoccluded(&quarter, &case.receiver, true)
        });
        let sum = parts[1..]
            .iter()
            .fold(parts[0], |sum, part| plus(&sum, part));
        // An inner edge near the receiver has terms of one over its distance, which cancel between the quarters.
        let tolerance = 1e-11 / case.cosine / case.sizes.min(1.0);
        assert_agree(&sum, &whole, tolerance, &format!("case {seed}"));
    }
}

#[test]
fn turning_moving_and_scaling_the_scene_changes_nothing_but_units() {
    for seed in 0..300 {
        let case = case(2 * seed + 1);
        let mut rng = Rng::new(seed);
        let turn = DMat3::from_quat(glam::DQuat::from_axis_angle(
            rng.direction(),
            rng.range(0.0, 6.0),
        ));
        let scale = 10f64.powf(rng.range(-4.0, 4.0));
        let [corner, u, v] = case.rectangle;
        let before = transport::unoccluded(&polygon(case.rectangle), &case.receiver, true);
        // The receiver stays at the origin, so that moving it costs no digits of the other positions.
        let from = case.receiver.position;
        let rectangle = [corner - from, u, v].map(|side| turn * side * scale);
        let receiver = Receiver {
            position: DVec3::ZERO,
            normal: turn * case.receiver.normal,
            ..case.receiver
        };
        let after = transport::unoccluded(&polygon(rectangle), &receiver, true);
        let back = turn.transpose();
        let after = Sums {
            g: back * after.g,
            j: back * after.j * turn * scale,
            grad_phi: back * after.grad_phi * scale,
            ..after
        };
        // Turned positions are rounded: ε of the distance, against the light's size or the distance of its plane or the horizon.
        let tolerance = 1e-13 * case.sizes.max(1.0 / case.sizes) / case.cosine;
        assert_agree(&after, &before, tolerance, &format!("case {seed}"));
    }
}

/// The outline of a shape drawn in the plane of `u` and `v`.
fn drawn(origin: DVec3, u: DVec3, v: DVec3, points: &[[f64; 2]]) -> Vec<DVec3> {
    points
        .iter()
        .map(|&[s, t]| origin + u * s + v * t)
        .collect()
}

#[test]
fn a_ring_is_its_outside_less_its_hole() {
    for seed in 0..300 {
        let case = case(seed);
        let [corner, u, v] = case.rectangle;
        let outer = polygon(case.rectangle);
        let inner = polygon([corner + 0.25 * u + 0.5 * v, 0.5 * u, 0.25 * v]);
        let mut ring = outer.clone();
        let mut hole = inner.contours[0].clone();
        hole.reverse();
        ring.contours.push(hole);
        let [ring, inner, outer] =
            [ring, inner, outer].map(|light| transport::unoccluded(&light, &case.receiver, true));
        let tolerance = 1e-11 / case.cosine / case.sizes.min(1.0);
        assert_agree(
            &plus(&ring, &inner),
            &outer,
            tolerance,
            &format!("case {seed}"),
        );
    }
}

#[test]
fn a_concave_light_is_the_sum_of_its_convex_parts_on_every_horizon() {
    // A comb with two teeth, so that a horizon can cut it in two.
    let comb = [
        [0.0, 0.0],
        [1.0, 0.0],
        [1.0, 2.0],
        [2.0, 2.0],
        [2.0, 0.0],
        [3.0, 0.0],
        [3.0, 3.0],
        [0.0, 3.0],
    ];
    let parts = [
        [0.0, 0.0, 1.0, 2.0],
        [2.0, 0.0, 3.0, 2.0],
        [0.0, 2.0, 3.0, 3.0],
    ];
    for seed in 0..300 {
        let case = case(seed);
        let [corner, u, v] = case.rectangle;
        let (u, v) = (u / 3.0, v / 3.0);
        let light = Polygon {
            contours: vec![drawn(corner, u, v, &comb)],
            ..polygon(case.rectangle)
        };
        let got = transport::unoccluded(&light, &case.receiver, true);
        let sum = parts
            .map(|[s0, t0, s1, t1]| {
                let part = [corner + u * s0 + v * t0, u * (s1 - s0), v * (t1 - t0)];
                transport::unoccluded(&polygon(part), &case.receiver, true)
            })
            .into_iter()
            .reduce(|sum, part| plus(&sum, &part))
            .expect("there are parts");
        // Vertices at thirds are rounded, by 1e-11 in the cases that lie 1e5 away.
        let largest = corner.abs().max_element() + 1.0;
        let tolerance = 1e-13 * largest / case.cosine / case.sizes.min(1.0);
        assert_agree(&got, &sum, tolerance, &format!("case {seed}"));
    }
}

#[test]
fn only_the_front_shines_unless_the_light_is_two_sided() {
    let mut light = polygon([DVec3::new(-1.0, -1.0, 2.0), DVec3::Y * 2.0, DVec3::X * 2.0]);
    let at = |z: f64, normal| Receiver {
        position: DVec3::new(0.3, 0.2, z),
        normal,
        seed: 0,
    };
    let front = at(0.0, DVec3::Z);
    let lit = transport::unoccluded(&light, &front, true);
    assert!(lit.g.z > 0.5);
    for dark in [
        at(4.0, -DVec3::Z),
        at(4.0, DVec3::Z),
        at(0.0, -DVec3::Z),
        // In the plane of the light, looking at it or along it.
        at(2.0, DVec3::X),
        at(2.0, -DVec3::Z),
        at(2.0, DVec3::Z),
    ] {
        assert_eq!(transport::unoccluded(&light, &dark, true), Sums::DARK);
    }
    light.two_sided = true;
    let back = transport::unoccluded(&light, &at(4.0, -DVec3::Z), true);
    assert!((back.g.z + lit.g.z).abs() < 1e-15 && (back.phi - lit.phi).abs() < 1e-15);
    assert!((back.g.truncate() - lit.g.truncate()).length() < 1e-15);
    assert_eq!(
        transport::unoccluded(&light, &at(2.0, DVec3::X), true),
        Sums::DARK
    );
}

#[test]
fn under_a_huge_light_the_sky_is_full() {
    let size = 1e6;
    let corner = DVec3::new(-size / 2.0, -size / 2.0, 1.0);
    let light = polygon([corner, DVec3::Y * size, DVec3::X * size]);
    let receiver = Receiver {
        position: DVec3::ZERO,
        normal: DVec3::Z,
        seed: 0,
    };
    let got = transport::unoccluded(&light, &receiver, true);
    // What is missing is a strip of 2/size at the horizon; its cosine is as small again.
    assert!((got.phi - 2.0 * PI).abs() < 20.0 / size);
    assert!((got.g - DVec3::Z * PI).length() < 1e-9);
    assert!(norm(got.j) < 20.0 / size);
}

#[test]
fn receivers_that_touch_a_light_get_finite_light() {
    let light = polygon([DVec3::ZERO, DVec3::X, DVec3::Z]);
    // Its front looks along −Y; the floor in front of it meets its lower border.
    for height in [0.0, 1e-300, 1e-30, 1e-15, 1e-12, 1e-10, 1e-8, 1e-3] {
        for x in [-0.5, 0.0, 1e-9, 0.3, 1.0, 2.0] {
            for z in [0.0, 1e-16, 0.5, 1.0] {
                let receiver = Receiver {
                    position: DVec3::new(x, -height, z),
                    normal: DVec3::Z,
                    seed: 0,
                };
                let got = transport::unoccluded(&light, &receiver, true);
                let place = format!("{x:e} {height:e} {z:e}: {got:?}");
                assert!(got.g.is_finite() && got.phi.is_finite(), "{place}");
                assert!(
                    norm(got.j).is_finite() && got.grad_phi.is_finite(),
                    "{place}"
                );
                assert!(got.has_gradient || norm(got.j) == 0.0, "{place}");
                assert!(got.g.z >= 0.0 && got.g.length() <= PI + 1e-9, "{place}");
                assert!((0.0..=2.0 * PI).contains(&got.phi), "{place}");
            }
        }
    }
}

/// A room without walls: a light of 2 × 2 m and 3 nit that looks down from 5 m, and `occluders`.
fn scene(occluders: Vec<[DVec3; 3]>) -> (Scene, Lights) {
    let sides = [DVec3::new(-1.0, -1.0, 5.0), DVec3::Y * 2.0, DVec3::X * 2.0];
    let light = Polygon {
        radiance: DVec3::new(3.0, 1.0, 0.0),
        surface: vec![0, 1],
        ..polygon(sides)
    };
    let [corner, u, v] = sides;
    let scene = support::scene_of(&[
        (support::emitter(3.0), support::quad(corner, u, v)),
        (Material::default(), occluders),
    ]);
    let lights = Lights {
        polygons: vec![light],
        ..Lights::default()
    };
    (scene, lights)
}

/// Receivers on the floor, a row of eight along x from `from` in steps of `step`.
fn row(from: f64, step: f64) -> Vec<Receiver> {
    (0..8u32)
        .map(|index| Receiver {
            position: DVec3::new(from + step * f64::from(index), 0.1, 0.0),
            normal: DVec3::Z,
            seed: u64::from(index) + (from * 1e6).abs() as u64,
        })
        .collect()
}

/// A ceiling at half height over x < 0, with its border on x = 0: where x > 0 on the floor, the part of the light with x > −x is seen.
fn half_ceiling() -> Vec<[DVec3; 3]> {
    support::quad(
        DVec3::new(-50.0, -50.0, 2.5),
        DVec3::X * 50.0,
        DVec3::Y * 100.0,
    )
}

#[test]
fn tiles_with_nothing_in_the_way_cast_no_ray_and_are_exact() {
    let (scene, lights) = scene(vec![]);
    let tile = row(-2.0, 0.5);
    let occluders = Occluders::build(&scene);
    let (samples, counters) = transport::gather(&tile, &lights, &occluders, &Options::default());
    assert_eq!(counters.shadow_rays, 0);
    assert_eq!(counters.pairs_unoccluded, 1);
    assert_eq!(counters.pairs, 1);
    assert_eq!(counters.points, 8);
    let light = &lights.polygons[0];
    for (sample, receiver) in samples.iter().zip(&tile) {
        let want = transport::unoccluded(light, receiver, true);
        for channel in 0..3 {
            let radiance = light.radiance[channel];
            assert_eq!(sample.g[channel], want.g * radiance);
            assert_eq!(sample.j[channel], want.j * radiance);
            assert_eq!(sample.grad_phi[channel], want.grad_phi * radiance);
        }
        assert!(sample.has_gradient && sample.rays == 0);
        assert!(sample.error > 0.0 && sample.error < 1e-13 * 3.0 * PI);
    }
}

#[test]
fn gradients_that_nobody_wants_are_not_given() {
    let (scene, lights) = scene(vec![]);
    let options = Options {
        gradients: false,
        ..Options::default()
    };
    let occluders = Occluders::build(&scene);
    let (samples, _) = transport::gather(&row(0.0, 0.1), &lights, &occluders, &options);
    for sample in samples {
        assert!(!sample.has_gradient && sample.j == [DMat3::ZERO; 3]);
        assert!(sample.irradiance(DVec3::Z).x > 0.1);
    }
}

#[test]
fn lights_behind_or_below_are_not_looked_at() {
    let (scene, mut lights) = scene(half_ceiling());
    let mut tile = row(-2.0, 0.5);
    for receiver in &mut tile {
        receiver.normal = -DVec3::Z;
    }
    let occluders = Occluders::build(&scene);
    let options = Options::default();
    let (samples, counters) = transport::gather(&tile, &lights, &occluders, &options);
    assert!(
        samples
            .iter()
            .all(|sample| *sample == transport::Sample::DARK)
    );
    assert_eq!((counters.pairs, counters.pairs_facing_away), (1, 1));
    assert_eq!(counters.shadow_rays, 0);

    lights.polygons.clear();
    let (samples, counters) = transport::gather(&tile, &lights, &occluders, &options);
    assert!(
        samples
            .iter()
            .all(|sample| *sample == transport::Sample::DARK)
    );
    assert_eq!(counters.pairs, 0);
}

#[test]
fn penumbrae_agree_with_the_visible_part_of_the_light() {
    let (scene, lights) = scene(half_ceiling());
    let occluders = Occluders::build(&scene);
    let mut squares = [0.0; 2];
    let (mut count, mut rays) = (0.0, 0);
    for step in 0..50 {
        let tile = row(-1.0 + 0.04 * f64::from(step), 0.005);
        let options = Options {
            estimator: Estimator::Sampled,
            ..Options::default()
        };
        let (samples, counters) = transport::gather(&tile, &lights, &occluders, &options);
        assert_eq!(counters.pairs_sampled, 1);
        rays += counters.shadow_rays;
        for (sample, receiver) in samples.iter().zip(&tile) {
            let from = (-receiver.position.x).max(-1.0);
            let width = 1.0 - from;
            let mut want = 0.0;
            if width > 0.0 {
                let part = [
                    DVec3::new(from, -1.0, 5.0),
                    DVec3::Y * 2.0,
                    DVec3::X * width,
                ];
                want = 3.0 * transport::unoccluded(&polygon(part), receiver, false).g.z;
            }
            let got = sample.irradiance(DVec3::Z).x;
            // Six times what the estimate claims, or two rays in 64 of the whole 0.48 lux where all agree.
            let largest = 6.0 * sample.error + 2.0 * 0.48 / 64.0;
            assert!(
                (got - want).abs() < largest,
                "{}: {got} {want}",
                receiver.position
            );
            assert!(!sample.has_gradient);
            squares[0] += (got - want).powi(2);
            squares[1] += sample.error.powi(2);
            count += 1.0;
        }
    }
    assert_eq!(rays, 64 * 400);
    let [truth, claim] = squares.map(|square: f64| (square / count).sqrt());
    assert!(
        (0.7..3.0).contains(&(claim / truth)),
        "claims {claim:e}, is {truth:e}"
    );
    // 0.02 of the light with one straight edge and 64 points.
    assert!(truth < 0.03 * 0.48, "error {truth:e}");
}

#[test]
fn a_tile_gives_the_same_bytes_again_and_does_not_know_its_neighbours() {
    let (scene, lights) = scene(half_ceiling());
    let occluders = Occluders::build(&scene);
    let tile = row(-0.5, 0.1);
    let options = Options::default();
    let (first, counters) = transport::gather(&tile, &lights, &occluders, &options);
    assert_eq!(
        transport::gather(&tile, &lights, &occluders, &options),
        (first.clone(), counters)
    );
    let mut turned = tile.clone();
    turned.reverse();
    let (mut second, _) = transport::gather(&turned, &lights, &occluders, &options);
    second.reverse();
    assert_eq!(first, second);
}

#[test]
fn radiance_of_any_size_stays_finite() {
    for radiance in [1e-30, 1e30] {
        let (scene, mut lights) = scene(half_ceiling());
        lights.polygons[0].radiance = DVec3::splat(radiance);
        let occluders = Occluders::build(&scene);
        let tile = row(-0.5, 0.1);
        let (samples, _) = transport::gather(&tile, &lights, &occluders, &Options::default());
        for sample in samples {
            assert!(sample.error.is_finite() && sample.error > 0.0);
            let e = sample.irradiance(DVec3::Z).x / radiance;
            assert!(e > 1e-3 && e < PI, "{e:e}");
        }
    }
}

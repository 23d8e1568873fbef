//! Exact contours against an independent exact answer: the light minus the cone of every occluder, cut up into convex pieces.
//!
//! The reference shares nothing with the library. It never projects and has no edges, no winding numbers and no contours: it cuts the
//! light's triangles, in space, by the three planes through receiver and occluder sides and by the occluder's own plane, throws away what
//! is inside all four, and adds up Lambert's formula over the convex pieces that are left. Its error is rounding only, so derivatives
//! can be had from it by differences.

use glam::{DMat3, DQuat, DVec3, EulerRot};
use lumel::lights;
use lumel::scene::{Material, Scene};
use lumel::transport::{self, Estimator, Receiver, Sample};
use lumel::visibility::Occluders;

use crate::support::{Rng, emitter, quad, scene_of};

/// The part of a convex polygon where `normal · p ≥ offset`, and the rest.
fn split(polygon: &[DVec3], normal: DVec3, offset: f64) -> [Vec<DVec3>; 2] {
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for (index, &p) in polygon.iter().enumerate() {
        let q = polygon[(index + 1) % polygon.len()];
        let (at_p, at_q) = (normal.dot(p) - offset, normal.dot(q) - offset);
        if at_p >= 0.0 {
            inside.push(p);
        } else {
            outside.push(p);
        }
        if (at_p >= 0.0) != (at_q >= 0.0) {
            let crossing = p + (q - p) * (at_p / (at_p - at_q));
            inside.push(crossing);
            outside.push(crossing);
        }
    }
    [inside, outside].map(|part| if part.len() < 3 { Vec::new() } else { part })
}

/// What is left of `light` (triangles, seen from their front) for a receiver with this horizon.
fn visible_pieces(
    position: DVec3,
    normal: DVec3,
    light: &[[DVec3; 3]],
    occluders: &[[DVec3; 3]],
) -> Vec<Vec<DVec3>> {
    let mut pieces: Vec<Vec<DVec3>> = light
        .iter()
        .map(|triangle| {
            let [above, _] = split(&triangle.map(|vertex| vertex - position), normal, 0.0);
            above
        })
        .filter(|piece| !piece.is_empty())
        .collect();
    for occluder in occluders {
        let [a, b, c] = occluder.map(|vertex| vertex - position);
        let volume = a.dot(b.cross(c));
        // Seen edge-on it hides nothing.
        if volume == 0.0 {
            continue;
        }
        let sign = volume.signum();
        let plane = (b - a).cross(c - a);
        let height = plane.dot(a);
        let cuts = [
            (sign * a.cross(b), 0.0),
            (sign * b.cross(c), 0.0),
            (sign * c.cross(a), 0.0),
            (plane * height.signum(), height.abs()),
        ];
        let mut next = Vec::new();
        for piece in pieces {
            let mut rest = piece;
            for (cut, offset) in cuts {
                let [inside, outside] = split(&rest, cut, offset);
                if !outside.is_empty() {
                    next.push(outside);
                }
                rest = inside;
                if rest.is_empty() {
                    break;
                }
            }
        }
        pieces = next;
    }
    pieces
}

/// Light vector and fluence per unit radiance: Lambert's formula, and Van Oosterom and Strackee's for the solid angle.
pub(crate) fn reference(
    position: DVec3,
    normal: DVec3,
    light: &[[DVec3; 3]],
    occluders: &[[DVec3; 3]],
) -> (DVec3, f64) {
    let (mut g, mut phi) = (DVec3::ZERO, 0.0);
    for piece in visible_pieces(position, normal, light, occluders) {
        for (index, &a) in piece.iter().enumerate() {
            let b = piece[(index + 1) % piece.len()];
            let w = (b - a).cross(a);
            if w != DVec3::ZERO {
                g += w * (0.5 * w.length().atan2(a.dot(b)) / w.length());
            }
        }
        let a = piece[0];
        for pair in piece[1..].windows(2) {
            let (b, c) = (pair[0], pair[1]);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            let volume = a.dot((c - a).cross(b - a));
            phi += 2.0 * volume.atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
        }
    }
    (g, phi)
}

/// Central differences of the reference: ∂G/∂x and ∂φ/∂x.
fn differences(
    position: DVec3,
    normal: DVec3,
    light: &[[DVec3; 3]],
    occluders: &[[DVec3; 3]],
) -> (DMat3, DVec3) {
    // Truncation grows with the step squared, rounding with its inverse; 1e-5 m suits distances of metres.
    const STEP: f64 = 1e-5;
    let mut j = DMat3::ZERO;
    let mut grad_phi = DVec3::ZERO;
    for axis in 0..3 {
        let step = STEP * DVec3::AXES[axis];
        let (g_ahead, phi_ahead) = reference(position + step, normal, light, occluders);
        let (g_behind, phi_behind) = reference(position - step, normal, light, occluders);
        *j.col_mut(axis) = (g_ahead - g_behind) / (2.0 * STEP);
        grad_phi[axis] = (phi_ahead - phi_behind) / (2.0 * STEP);
    }
    (j, grad_phi)
}

fn norm(matrix: DMat3) -> f64 {
    (0..3)
        .map(|axis| matrix.col(axis).length_squared())
        .sum::<f64>()
        .sqrt()
}

/// A light, what stands before it, and where it is looked at from.
struct Case {
    light: Vec<[DVec3; 3]>,
    two_sided: bool,
    occluders: Vec<[DVec3; 3]>,
    position: DVec3,
    normal: DVec3,
}

/// A 2 × 2 m light facing down, 5 m above the origin.
fn square_light() -> Vec<[DVec3; 3]> {
    quad(DVec3::new(-1.0, 5.0, -1.0), 2.0 * DVec3::X, 2.0 * DVec3::Z)
}

/// An L of three squares.
fn concave_light() -> Vec<[DVec3; 3]> {
    [[-1.0, -1.0], [0.0, -1.0], [-1.0, 0.0]]
        .iter()
        .flat_map(|&[x, z]| quad(DVec3::new(x, 5.0, z), DVec3::X, DVec3::Z))
        .collect()
}

/// A square with a square hole: eight squares around nothing.
fn holed_light() -> Vec<[DVec3; 3]> {
    (0..9)
        .filter(|cell| *cell != 4)
        .flat_map(|cell| {
            let (x, z) = (f64::from(cell % 3), f64::from(cell / 3));
            quad(DVec3::new(x - 1.5, 5.0, z - 1.5), DVec3::X, DVec3::Z)
        })
        .collect()
}

fn cube(centre: DVec3, half: f64, rotation: DQuat) -> Vec<[DVec3; 3]> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| rotation * axis * half);
    (0..3)
        .flat_map(|axis| {
            let (n, u, v) = (axes[axis], axes[(axis + 1) % 3], axes[(axis + 2) % 3]);
            let front = quad(centre + n - u - v, 2.0 * u, 2.0 * v);
            let back = quad(centre - n - v - u, 2.0 * v, 2.0 * u);
            front.into_iter().chain(back)
        })
        .collect()
}

fn any_point(rng: &mut Rng, half: f64) -> DVec3 {
    DVec3::new(
        rng.range(-half, half),
        rng.range(-half, half),
        rng.range(-half, half),
    )
}

fn any_triangle(rng: &mut Rng, size: f64) -> [DVec3; 3] {
    let centre = DVec3::new(
        rng.range(-2.0, 2.0),
        rng.range(-0.5, 5.5),
        rng.range(-2.0, 2.0),
    );
    [0; 3].map(|_| centre + any_point(rng, size))
}

fn any_rotation(rng: &mut Rng) -> DQuat {
    let angles = [0; 3].map(|_| rng.range(0.0, std::f64::consts::TAU));
    DQuat::from_euler(EulerRot::XYZ, angles[0], angles[1], angles[2])
}

/// Every kind of trouble in turn.
fn case(seed: u64) -> Case {
    let rng = &mut Rng::new(seed);
    let n_triangles = 1 + (rng.unit() * 40.0) as usize;
    let mut case = Case {
        light: square_light(),
        two_sided: false,
        occluders: Vec::new(),
        position: DVec3::new(rng.range(-3.0, 3.0), 0.0, rng.range(-3.0, 3.0)),
        normal: DVec3::Y,
    };
    match seed % 12 {
        0 => {}
        1 => case.normal = (rng.direction() + 0.2 * DVec3::Y).normalize(),
        2 => case.position.y = rng.range(0.0, 4.9),
        3 => {
            for _ in 0..1 + n_triangles / 10 {
                let centre = DVec3::new(
                    rng.range(-1.5, 1.5),
                    rng.range(0.0, 5.0),
                    rng.range(-1.5, 1.5),
                );
                let half = rng.range(0.1, 0.6);
                let rotation = any_rotation(rng);
                case.occluders.extend(cube(centre, half, rotation));
            }
        }
        // Boxes on a grid: coincident faces and edges, contact with floor and light.
        4 => {
            for _ in 0..1 + n_triangles / 8 {
                let centre = DVec3::new(
                    (rng.range(-2.0, 2.0) * 2.0).round() * 0.5,
                    (rng.range(0.0, 5.0) * 2.0).round() * 0.5,
                    (rng.range(-2.0, 2.0) * 2.0).round() * 0.5,
                );
                case.occluders.extend(cube(centre, 0.25, DQuat::IDENTITY));
            }
        }
        // Far larger than the room.
        5 => case
            .occluders
            .extend((0..n_triangles / 4).map(|_| any_triangle(rng, 4.0))),
        // Duplicates, the same way round and the other.
        6 => {
            let [a, b, c] = any_triangle(rng, 1.0);
            case.occluders.extend([[a, b, c], [a, b, c], [a, c, b]]);
        }
        7 => case.light = concave_light(),
        8 => case.light = holed_light(),
        // From behind.
        9 => {
            case.two_sided = true;
            case.position.y = rng.range(5.5, 8.0);
            case.normal = (rng.direction() - DVec3::Y).normalize();
        }
        // Receiver inside a box with a missing side.
        10 => {
            case.occluders.extend(
                cube(case.position, 0.4, any_rotation(rng))
                    .into_iter()
                    .skip(2),
            );
        }
        // Occluders that touch the receiver's plane and the light's plane with a side.
        _ => {
            for _ in 0..4 {
                let foot = DVec3::new(rng.range(-2.0, 2.0), 0.0, rng.range(-2.0, 2.0));
                let side = DVec3::new(rng.range(-1.0, 1.0), 0.0, rng.range(-1.0, 1.0));
                let up = DVec3::new(rng.range(-0.5, 0.5), 5.0, rng.range(-0.5, 0.5));
                case.occluders.push([foot, foot + side, foot + 0.4 * up]);
                case.occluders
                    .push([foot + up, foot + up + side, foot + 0.7 * up]);
            }
        }
    }
    if matches!(seed % 12, 0..=2 | 6..=9) {
        case.occluders
            .extend((0..n_triangles).map(|_| any_triangle(rng, 0.8)));
    }
    // The library's geometry starts from f32 vertices.
    for triangle in case.occluders.iter_mut().chain(&mut case.light) {
        for vertex in triangle {
            *vertex = vertex.as_vec3().as_dvec3();
        }
    }
    case
}

impl Case {
    fn scene(&self) -> Scene {
        let light = Material {
            double_sided: self.two_sided,
            ..emitter(1.0)
        };
        scene_of(&[
            (light, self.light.clone()),
            (Material::default(), self.occluders.clone()),
        ])
    }

    /// The light as its receiver sees it.
    fn seen_light(&self) -> Vec<[DVec3; 3]> {
        let behind = self.position.y > 5.0;
        self.light
            .iter()
            .map(|&[a, b, c]| if behind { [a, c, b] } else { [a, b, c] })
            .collect()
    }

    fn sample(&self, estimator: Estimator) -> Sample {
        let scene = self.scene();
        let lights = lights::collect(&scene, &lights::Options::default());
        let occluders = Occluders::build(&scene);
        let receiver = Receiver {
            position: self.position,
            normal: self.normal,
            seed: 0,
        };
        let options = transport::Options {
            estimator,
            ..transport::Options::default()
        };
        let (samples, _) = transport::gather(&[receiver], &lights, &occluders, &options);
        samples[0]
    }
}

#[test]
fn exact_contours_equal_the_light_minus_the_cones_of_its_occluders() {
    let mut relative_errors = Vec::new();
    let mut n_partial = 0;
    for seed in 0..600 {
        let case = case(seed);
        let light = case.seen_light();
        let got = case.sample(Estimator::Exact);
        let (g, phi) = reference(case.position, case.normal, &light, &case.occluders);
        let (open_g, open_phi) = reference(case.position, case.normal, &light, &[]);
        if open_phi <= 0.0 {
            assert_eq!(got.g[0], DVec3::ZERO, "case {seed}");
            continue;
        }
        // Relative to the unoccluded light: what is left of it may be a sliver.
        let error_g = (got.g[0] - g).length() / open_g.length();
        let error_phi = (got.phi[0] - phi).abs() / open_phi;
        assert!(error_g < 1e-8, "case {seed}: G got {} want {g}", got.g[0]);
        assert!(
            error_phi < 1e-8,
            "case {seed}: φ got {} want {phi}",
            got.phi[0]
        );

        let visible = phi / open_phi;
        if got.has_gradient && 1e-9 < visible && visible < 1.0 - 1e-9 {
            n_partial += 1;
            let (j, grad_phi) = differences(case.position, case.normal, &light, &case.occluders);
            // The unoccluded gradient keeps the measure from vanishing where the visible part hardly moves.
            let scale = norm(j) + 1e-3 * open_g.length();
            relative_errors.push((norm(got.j[0] - j) / scale, seed));
            relative_errors.push((
                (got.grad_phi[0] - grad_phi).length() / (grad_phi.length() + 1e-3 * open_phi),
                seed,
            ));
        }
    }
    relative_errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(n_partial > 250, "only {n_partial} partly visible lights");
    let median = relative_errors[relative_errors.len() / 2];
    assert!(median.0 < 1e-8, "median error of derivatives {median:?}");
    // The differences are themselves off where an edge passes a vertex within the step.
    let n_bad = relative_errors
        .iter()
        .filter(|error| error.0 > 1e-5)
        .count();
    assert!(
        n_bad * 200 <= relative_errors.len(),
        "{n_bad} of {} derivatives off by more than 1e-5, worst {:?}",
        relative_errors.len(),
        relative_errors.last()
    );
}

/// A sphere of so many rings and twice as many sectors, fronts outwards.
fn coarse_sphere(centre: DVec3, radius: f64, rings: u32) -> Vec<[DVec3; 3]> {
    let at = |ring: u32, sector: u32| {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        let around = std::f64::consts::PI * f64::from(sector % (2 * rings)) / f64::from(rings);
        let direction = DVec3::new(
            polar.sin() * around.cos(),
            polar.cos(),
            -polar.sin() * around.sin(),
        );
        (centre + radius * direction).as_vec3().as_dvec3()
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for sector in 0..2 * rings {
            let [a, b, c, d] = [
                at(ring, sector),
                at(ring + 1, sector),
                at(ring + 1, sector + 1),
                at(ring, sector + 1),
            ];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    triangles
}

#[test]
fn the_penumbra_of_a_coarse_sphere_is_exact() {
    // The sphere of the fixture `penumbra`, with 256 triangles in place of 20,000.
    let occluders = coarse_sphere(DVec3::new(0.0, 1.3, 0.0), 0.6, 8);
    let (mut n_partial, mut errors) = (0, Vec::new());
    for index in 0..100 {
        let at = |k: u32| -1.63 + 0.33 * f64::from(k);
        let case = Case {
            light: square_light(),
            two_sided: false,
            occluders: occluders.clone(),
            position: DVec3::new(at(index % 10), 0.0, at(index / 10)),
            normal: DVec3::Y,
        };
        let light = case.seen_light();
        let got = case.sample(Estimator::Exact);
        let (g, phi) = reference(case.position, case.normal, &light, &occluders);
        let (open_g, open_phi) = reference(case.position, case.normal, &light, &[]);
        let off = (got.g[0] - g).length() / open_g.length();
        let off_phi = (got.phi[0] - phi).abs() / open_phi;
        assert!(
            off < 1e-8 && off_phi < 1e-8,
            "at {}: G off by {off:e}, φ by {off_phi:e}",
            case.position
        );
        if (1e-9..1.0 - 1e-9).contains(&(phi / open_phi)) {
            n_partial += 1;
            let (j, _) = differences(case.position, case.normal, &light, &occluders);
            errors.push(norm(got.j[0] - j) / norm(j));
        }
    }
    errors.sort_by(f64::total_cmp);
    assert!(n_partial > 40, "only {n_partial} partly visible");
    // Of the few hundred pieces of a point one may pass a vertex within the step of the differences.
    assert!(
        errors[n_partial / 2] < 1e-8 && errors[n_partial * 9 / 10] < 1e-5,
        "{errors:?}"
    );
}

//! Functions that have nothing to do with light: interpolation is exact where it must be, close elsewhere, and the same on any number of
//! threads.

#![expect(clippy::print_stdout, reason = "the figures are worth reading")]

use std::sync::atomic::AtomicBool;

use glam::{DVec2, DVec3};
use lumel::Error;
use lumel::bake;
use lumel::refine::{self, Domain, Options, Point, Refined, Sample};
use lumel::scene::{Material, Scene};

use crate::support::{Rng, emitter, quad, scene_of};

/// The cells of a grid that a test keeps.
fn domain(width: u16, height: u16, keep: impl Fn(u16, u16) -> bool) -> Domain {
    let points = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .filter(|&(x, y)| keep(x, y))
        .map(|(x, y)| Point {
            cell: [x, y],
            place: DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5),
            joined: [true; 2],
            spacing: 16,
        })
        .collect();
    Domain::new(points).expect("a small domain")
}

fn options(tolerance: f64) -> Options {
    Options {
        tolerance,
        budget: usize::MAX,
        slopes: true,
    }
}

/// A value and its derivatives.
type Function = fn(DVec2) -> (f64, DVec2);

fn refine(domain: &Domain, function: Function, has_slopes: bool, options: &Options) -> Refined<1> {
    let evaluate = |points: &[u32]| {
        points
            .iter()
            .map(|&point| {
                let (value, slope) = function(domain.points()[point as usize].place);
                Sample {
                    value: [value],
                    slopes: [[slope.x], [slope.y]],
                    has_slopes,
                    error: 0.0,
                }
            })
            .collect()
    };
    refine::sparse(domain, &evaluate, options, &|| false).expect("nobody cancels")
}

/// Largest and mean error of the values, and the share of points that were evaluated.
fn figures(domain: &Domain, refined: &Refined<1>, function: Function) -> [f64; 3] {
    let n = domain.points().len() as f64;
    let errors = domain
        .points()
        .iter()
        .zip(&refined.values)
        .map(|(point, value)| (f64::from(value[0]) - function(point.place).0).abs());
    let (largest, sum) = errors.fold((0.0_f64, 0.0), |(largest, sum), error| {
        (largest.max(error), sum + error)
    });
    let n_evaluated = refined.evaluated.iter().filter(|&&is| is).count();
    [largest, sum / n, n_evaluated as f64 / n]
}

fn quadratic(p: DVec2) -> (f64, DVec2) {
    let (x, y) = (p.x / 100.0, p.y / 100.0);
    (
        0.2 + x - 0.5 * y + x * x - 0.7 * x * y + 0.3 * y * y,
        DVec2::new(1.0 + 2.0 * x - 0.7 * y, -0.5 - 0.7 * x + 0.6 * y) / 100.0,
    )
}

fn cubic(p: DVec2) -> (f64, DVec2) {
    let (x, y) = (p.x / 100.0, p.y / 100.0);
    (
        x * x * x - 2.0 * x * x * y + y * y * y,
        DVec2::new(3.0 * x * x - 4.0 * x * y, -2.0 * x * x + 3.0 * y * y) / 100.0,
    )
}

/// The distance to a slanted line, cut off: two lines where the derivative jumps.
fn ridge(p: DVec2) -> (f64, DVec2) {
    let across = DVec2::new(0.8, 0.6);
    let height = (across.dot(p) - 70.0) / 25.0;
    if height.abs() < 1.0 {
        (1.0 - height.abs(), -across * (height.signum() / 25.0))
    } else {
        (0.0, DVec2::ZERO)
    }
}

/// A shadow without penumbra.
fn step(p: DVec2) -> (f64, DVec2) {
    (
        if 0.9 * p.x + 0.3 * p.y < 61.3 {
            1.0
        } else {
            0.0
        },
        DVec2::ZERO,
    )
}

fn bump(p: DVec2) -> (f64, DVec2) {
    let offset = (p - DVec2::new(60.0, 45.0)) / 20.0;
    let value = (-offset.length_squared()).exp();
    (value, -2.0 * value * offset / 20.0)
}

#[test]
fn a_quadratic_needs_no_more_than_the_first_points() {
    let domain = domain(128, 96, |_, _| true);
    let refined = refine(&domain, quadratic, true, &options(1e-6));
    let [largest, _, share] = figures(&domain, &refined, quadratic);
    // Stored as f32, values up to 3.
    assert!(largest < 4e-7, "{largest}");
    // One point in 16 × 16, and the border.
    assert!(share < 0.01, "{share}");
    for (point, slopes) in domain.points().iter().zip(&refined.slopes) {
        let (_, slope) = quadratic(point.place);
        let found = DVec2::new(f64::from(slopes[0][0]), f64::from(slopes[1][0]));
        assert!(
            found.distance(slope) < 1e-7,
            "{point:?}: {found} for {slope}"
        );
    }
    assert!(refined.complete);
}

#[test]
fn smooth_functions_come_within_the_tolerance() {
    let domain = domain(128, 96, |_, _| true);
    for (name, function) in [
        ("cubic", cubic as Function),
        ("bump", bump),
        ("ridge", ridge),
    ] {
        for tolerance in [3e-2, 4e-3, 3e-4] {
            let refined = refine(&domain, function, true, &options(tolerance));
            let [largest, mean, share] = figures(&domain, &refined, function);
            println!(
                "{name} {tolerance}: largest {largest:.1e}, mean {mean:.1e}, {share:.4} evaluated"
            );
            // What is asked for holds at 99 of 100 points; the rest is where a derivative jumps between them.
            assert!(mean < 0.5 * tolerance, "{name} {tolerance}: mean {mean}");
            assert!(
                largest < 5.0 * tolerance,
                "{name} {tolerance}: largest {largest}"
            );
            assert!(share < 0.3, "{name} {tolerance}: {share} evaluated");
        }
    }
}

#[test]
fn a_step_is_evaluated_along_its_whole_length() {
    let domain = domain(128, 96, |_, _| true);
    for has_slopes in [true, false] {
        let refined = refine(&domain, step, has_slopes, &options(4e-3));
        let [largest, _, share] = figures(&domain, &refined, step);
        assert!(largest < 1e-6, "{has_slopes}: {largest}");
        assert!(share < 0.15, "{has_slopes}: {share}");
    }
}

#[test]
fn values_alone_are_enough_at_a_price() {
    let domain = domain(128, 96, |_, _| true);
    let tolerance = 4e-3;
    let with = figures(
        &domain,
        &refine(&domain, bump, true, &options(tolerance)),
        bump,
    );
    let without = figures(
        &domain,
        &refine(&domain, bump, false, &options(tolerance)),
        bump,
    );
    assert!(without[0] < 3.0 * tolerance, "{without:?}");
    assert!(without[2] > with[2], "{without:?} {with:?}");
}

#[test]
fn odd_domains_get_a_finite_value_everywhere() {
    let nan: Function = |p| (if p.x < 9.0 { f64::NAN } else { 1.0 }, DVec2::INFINITY);
    let shapes: [(&str, Domain); 9] = [
        ("nothing", domain(0, 0, |_, _| true)),
        ("one", domain(1, 1, |_, _| true)),
        ("a row", domain(100, 1, |_, _| true)),
        ("a column", domain(1, 100, |_, _| true)),
        ("two rows", domain(100, 2, |_, _| true)),
        ("a diagonal", domain(60, 60, |x, y| x == y)),
        ("a chess board", domain(40, 40, |x, y| (x + y) % 2 == 0)),
        ("holes", domain(80, 80, |x, y| x % 20 > 6 || y % 20 > 6)),
        ("islands", domain(80, 80, |x, y| x % 20 > 6 && y % 20 > 6)),
    ];
    for (name, domain) in &shapes {
        for function in [bump as Function, ridge, step, nan] {
            let refined = refine(domain, function, true, &options(1e-3));
            let n = domain.points().len();
            assert_eq!(
                (refined.values.len(), refined.errors.len()),
                (n, n),
                "{name}"
            );
            let finite = refined.values.iter().all(|value| value[0].is_finite())
                && refined
                    .slopes
                    .iter()
                    .flatten()
                    .all(|slope| slope[0].is_finite());
            assert!(finite, "{name}");
        }
        let refined = refine(domain, bump, true, &options(1e-3));
        let [largest, ..] = figures(domain, &refined, bump);
        assert!(largest < 5e-3, "{name}: {largest}");
    }
}

#[test]
fn creases_are_not_interpolated_across() {
    // Two planes of different value that meet between columns 41 and 42, told by the domain alone.
    let domain = domain(90, 70, |_, _| true).joined_where(|a, b| {
        // Indices run along rows.
        !(a % 90 == 41 && b % 90 == 42)
    });
    let folded: Function = |p| {
        if p.x < 42.0 {
            quadratic(p)
        } else {
            (5.0 - 0.01 * p.x, DVec2::new(-0.01, 0.0))
        }
    };
    let refined = refine(&domain, folded, true, &options(1e-4));
    let [largest, _, share] = figures(&domain, &refined, folded);
    assert!(largest < 1e-5, "{largest}");
    assert!(share < 0.02, "{share}");
}

#[test]
fn places_off_their_cells_are_taken_where_they_are() {
    // The border cells of a chart sample its edge, half a cell inwards.
    let points = domain(64, 48, |_, _| true)
        .points()
        .iter()
        .map(|point| Point {
            place: point.place.clamp(DVec2::splat(1.0), DVec2::new(63.0, 47.0)),
            ..*point
        })
        .collect();
    let domain = Domain::new(points).expect("a small domain");
    let refined = refine(&domain, quadratic, true, &options(1e-5));
    let [largest, _, share] = figures(&domain, &refined, quadratic);
    assert!(largest < 1e-5, "{largest}");
    assert!(share < 0.03, "{share}");
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let domain = domain(128, 96, |x, y| (x / 8 + y / 8) % 7 != 0);
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool")
            .install(|| refine(&domain, ridge, true, &options(1e-3)))
    };
    let one = on(1);
    for threads in [2, 5] {
        assert!(on(threads) == one, "{threads} threads");
    }
}

#[test]
fn a_budget_is_kept_and_a_shortfall_is_said() {
    let domain = domain(128, 96, |_, _| true);
    let all = refine(&domain, ridge, true, &options(1e-4));
    let n_all = all.evaluated.iter().filter(|&&is| is).count();
    let refined = refine(
        &domain,
        ridge,
        true,
        &Options {
            budget: n_all / 2,
            ..options(1e-4)
        },
    );
    let n_evaluated = refined.evaluated.iter().filter(|&&is| is).count();
    assert!(n_evaluated <= n_all / 2, "{n_evaluated} of {n_all}");
    assert!(!refined.complete && all.complete);
    let claimed = |refined: &Refined<1>| refined.errors.iter().sum::<f32>();
    assert!(claimed(&refined) > claimed(&all));
}

#[test]
fn refinement_can_be_interrupted() {
    let domain = domain(64, 64, |_, _| true);
    let evaluate = |points: &[u32]| -> Vec<Sample<1>> {
        points
            .iter()
            .map(|_| unreachable!("cancelled before"))
            .collect()
    };
    let result = refine::sparse(&domain, &evaluate, &options(1e-3), &|| true);
    assert!(matches!(result, Err(Error::Interrupted)));
}

/// A floor, a lamp, and what stands between them.
fn room(casters: Vec<[DVec3; 3]>) -> Scene {
    let floor = quad(DVec3::new(-4.0, 0.0, 4.0), 8.0 * DVec3::X, -8.0 * DVec3::Z);
    let lamp = quad(DVec3::new(-0.2, 4.0, -0.2), 0.4 * DVec3::X, 0.4 * DVec3::Z);
    scene_of(&[
        (Material::default(), floor),
        (emitter(1000.0), lamp),
        (Material::default(), casters),
    ])
}

/// A square bar between two points.
fn bar(from: DVec3, to: DVec3, width: f64) -> Vec<[DVec3; 3]> {
    let along = to - from;
    let (u, v) = along.normalize().any_orthonormal_pair();
    let (u, v) = (u * width, v * width);
    let corner = from - 0.5 * (u + v);
    let mut triangles = Vec::new();
    for (start, side) in [
        (corner, u),
        (corner + u, v),
        (corner + u + v, -u),
        (corner + v, -v),
    ] {
        triangles.extend(quad(start, side, along));
    }
    triangles.extend(quad(corner, v, u));
    triangles.extend(quad(corner + along, u, v));
    triangles
}

/// E of a bake, texel by texel, and the share of texels that were evaluated.
fn baked(scene: &Scene, options: &bake::Options) -> (Vec<f32>, f64) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cancelled = AtomicBool::new(false);
    let execution = bake::Execution {
        threads: None,
        cancelled: &cancelled,
        progress: &|_| {},
    };
    let report = bake::bake(scene, folder.path(), options, &execution).expect("a bake");
    let mut values = Vec::new();
    for file in report.files.iter().filter(|file| file.ends_with("_E.exr")) {
        let image = exr::prelude::read_first_rgba_layer_from_file(
            folder.path().join(file),
            |size, _| (size.width(), vec![0.0; size.area()]),
            |(width, pixels): &mut (usize, Vec<f32>), place, (_, g, _, _): (f32, f32, f32, f32)| {
                pixels[place.y() * *width + place.x()] = g;
            },
        )
        .expect("an EXR with R, G, B");
        values.extend(image.layer_data.channel_data.pixels.1);
    }
    let counters = &report.manifest["counters"];
    let number = |key: &str| counters[key].as_f64().expect("a number");
    (values, number("evaluatedTexels") / number("texels"))
}

#[test]
fn no_thin_shadow_is_missed() {
    let mut rng = Rng::new(6);
    let pole = bar(DVec3::new(0.3, 0.0, 0.2), DVec3::new(0.3, 2.0, 0.2), 0.01);
    let fence = (0..40)
        .flat_map(|index| {
            let x = -2.0 + 0.1 * f64::from(index);
            bar(DVec3::new(x, 0.0, 1.03), DVec3::new(x, 1.0, 1.03), 0.002)
        })
        .collect();
    let slivers = (0..100)
        .map(|_| {
            let place = DVec3::new(
                rng.range(-2.0, 2.0),
                rng.range(0.05, 2.5),
                rng.range(-2.0, 2.0),
            );
            let along = rng.direction() * 0.4;
            [
                place,
                place + along,
                place + 0.5 * along + rng.direction() * 0.02,
            ]
        })
        .collect();
    for (name, casters) in [("pole", pole), ("fence", fence), ("slivers", slivers)] {
        let scene = room(casters);
        let options = |refine| {
            let mut options = bake::Options {
                refine,
                float: true,
                outputs: Some(vec![bake::Output::E]),
                ..bake::Options::default()
            };
            options.atlas.texels_per_metre = 4.0;
            options
        };
        let (truth, _) = baked(&scene, &options(bake::Refine::Off));
        let (found, share) = baked(&scene, &options(bake::Refine::Texels));
        assert_eq!(truth.len(), found.len());
        let brightest = truth.iter().copied().fold(0.0, f32::max);
        let largest = truth
            .iter()
            .zip(&found)
            .map(|(a, b)| (a - b).abs() / brightest * 255.0)
            .fold(0.0, f32::max);
        println!("{name}: largest error {largest:.2}/255, {share:.3} of the texels evaluated");
        assert!(largest < 5.0, "{name}: {largest}");
    }
}

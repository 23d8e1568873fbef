//! Vedel's estimator against the exact contour: what it is good for as a baseline, and what it is known to get wrong.

#![expect(
    clippy::print_stdout,
    reason = "the figures of a baseline are looked up"
)]

use glam::{DMat3, DVec3};
use lumel::lights::{self, Lights};
use lumel::scene::{self, Material, Scene};
use lumel::transport::{self, Estimator, Receiver, Sample, VedelOptions};
use lumel::visibility::Occluders;

use crate::support::{self, Rng, emitter, quad, scene_of};

/// The middles of `count` × `count` cells of a square of the floor y = 0.
fn floor(count: u64, side: f64) -> Vec<Receiver> {
    (0..count * count)
        .map(|index| {
            let at = |k: u64| ((k as f64 + 0.5) / count as f64 - 0.5) * side;
            Receiver {
                position: DVec3::new(at(index % count), 0.0, at(index / count)),
                normal: DVec3::Y,
                seed: index,
            }
        })
        .collect()
}

fn fixture(name: &str) -> Scene {
    let path = support::fixture(name).join(format!("{name}.gltf"));
    scene::load(&path, &scene::Options::default()).expect("the fixture is valid")
}

fn vedel(cells: u32, threshold: f64) -> transport::Options {
    transport::Options {
        estimator: Estimator::Vedel,
        vedel: VedelOptions {
            cells,
            threshold,
            ..VedelOptions::default()
        },
        ..transport::Options::default()
    }
}

fn exact() -> transport::Options {
    transport::Options {
        estimator: Estimator::Exact,
        ..transport::Options::default()
    }
}

/// One receiver of a floor whose shaft to the light is not empty: rays, and Vedel's and the exact answer.
struct Active {
    rays: u64,
    got: Sample,
    want: Sample,
}

impl Active {
    fn error(&self) -> f64 {
        (self.got.g[0].y - self.want.g[0].y).abs()
    }

    /// Error of ∇E along the floor, and the true one; `None` where it is dark, whole or without one.
    fn gradient_error(&self) -> Option<(DVec3, DVec3)> {
        let along = |sample: &Sample| {
            let gradient = sample.j[0].transpose() * DVec3::Y;
            gradient - gradient.y * DVec3::Y
        };
        let (got, want) = (along(&self.got), along(&self.want));
        let is_partial = self.got.has_gradient && self.want.has_gradient && got != want;
        (is_partial && self.want.g[0].y > 1e-6).then_some((got - want, want))
    }
}

/// A floor below one light.
struct Study {
    active: Vec<Active>,
    brightest: f64,
}

impl Study {
    fn new(
        (occluders, lights): (&Occluders<'_>, &Lights),
        receivers: &[Receiver],
        options: &transport::Options,
        reference: &transport::Options,
    ) -> Self {
        let mut active = Vec::new();
        let mut brightest: f64 = 0.0;
        for receiver in receivers {
            let sample = |options| transport::gather(&[*receiver], lights, occluders, options);
            let (got, counters) = sample(options);
            brightest = brightest.max(got[0].g[0].y);
            if counters.pairs_unoccluded == 0 {
                active.push(Active {
                    rays: counters.shadow_rays,
                    got: got[0],
                    want: sample(reference).0[0],
                });
            }
        }
        Self { active, brightest }
    }

    fn mean(&self, value: impl Fn(&Active) -> f64) -> f64 {
        self.active.iter().map(value).sum::<f64>() / self.active.len() as f64
    }

    /// Mean |ΔE| in steps of an 8-bit picture, as in the paper's table.
    fn av_dif(&self) -> f64 {
        self.mean(Active::error) * 255.0 / self.brightest
    }

    fn rays(&self) -> f64 {
        self.mean(|point| point.rays as f64)
    }

    /// Share of points whose error is at most thrice the claimed one, and mean claim over mean error.
    fn honesty(&self) -> [f64; 2] {
        let share = self.mean(|point| f64::from(u8::from(point.error() <= 3.0 * point.got.error)));
        [
            share,
            self.mean(|point| point.got.error) / self.mean(Active::error),
        ]
    }

    /// Error of ∇E relative to its root mean square, and the median of the relative errors.
    fn gradient(&self) -> [f64; 2] {
        let errors = || self.active.iter().filter_map(Active::gradient_error);
        let squares: f64 = errors().map(|(error, _)| error.length_squared()).sum();
        let scale: f64 = errors().map(|(_, want)| want.length_squared()).sum();
        let mut relative: Vec<f64> = errors()
            .map(|(error, want)| error.length() / want.length())
            .collect();
        relative.sort_by(f64::total_cmp);
        [(squares / scale).sqrt(), relative[relative.len() / 2]]
    }
}

fn with_appendix(options: transport::Options) -> transport::Options {
    transport::Options {
        appendix_derivative: true,
        ..options
    }
}

#[test]
fn paper_settings_need_few_rays_and_converge_where_shapes_are_smooth() {
    let scene = fixture("penumbra");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let receivers = floor(64, 10.0);
    let study = |options| Study::new((&occluders, &lights), &receivers, &options, &exact());

    let paper = study(vedel(2, 1.0));
    let (av_dif, rays) = (paper.av_dif(), paper.rays());
    let [share, ratio] = paper.honesty();
    let [rms, median] = paper.gradient();
    println!(
        "penumbra: {} points, {rays:.1} rays, AvDif {av_dif:.3}, honest {share:.3} ratio {ratio:.2}, ∇E {rms:.3} median {median:.3}",
        paper.active.len()
    );
    assert!(paper.active.len() > 600);
    assert!(
        av_dif <= 0.7 && rays <= 55.0,
        "AvDif {av_dif} with {rays} rays"
    );
    assert!(
        share > 0.96 && (0.5..10.0).contains(&ratio),
        "{share} {ratio}"
    );
    // Chords for curves, and depths half a step inside the silhouette.
    assert!(
        rms < 0.1 && median < 0.06,
        "∇E off by {rms}, median {median}"
    );

    let appendix = study(with_appendix(vedel(2, 1.0)));
    let [rms, median] = appendix.gradient();
    println!("penumbra, appendix: ∇E {rms:.3} median {median:.3}");
    assert!((0.4..0.8).contains(&rms) && (0.4..0.8).contains(&median));

    let fine = study(vedel(4, 1.0));
    println!(
        "penumbra, 4 squares: {:.1} rays, AvDif {:.3}",
        fine.rays(),
        fine.av_dif()
    );
    assert!(fine.av_dif() < 0.5 * av_dif, "AvDif {}", fine.av_dif());
    let finer = study(vedel(8, 1.0));
    println!(
        "penumbra, 8 squares: {:.1} rays, AvDif {:.3}",
        finer.rays(),
        finer.av_dif()
    );
    assert!(
        finer.av_dif() < 0.5 * fine.av_dif(),
        "AvDif {}",
        finer.av_dif()
    );
}

#[test]
fn a_thin_occluder_between_the_first_samples_is_missed_until_they_are_dense() {
    let scene = fixture("slab");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let receivers = floor(40, 10.0);
    let study = |options| Study::new((&occluders, &lights), &receivers, &options, &exact());
    // Its image on the light is 0.13 of the light wide; squares are 0.5, 0.25 and 0.0625.
    let [coarse, middle, fine] = [2, 4, 16].map(|cells| study(vedel(cells, 1.0)));
    for study in [&coarse, &middle, &fine] {
        println!(
            "slab: {:.1} rays, AvDif {:.3}, {:?}",
            study.rays(),
            study.av_dif(),
            study.honesty()
        );
    }
    assert!(coarse.av_dif() > 1.0);
    assert!(middle.av_dif() < 0.3);
    assert!(fine.av_dif() < 0.05);
}

/// Metres of central differences: truncation grows with its square, rounding with its inverse.
const STEP: f64 = 1e-5;

#[test]
fn on_exact_contours_the_edge_form_is_right_and_the_appendix_is_not() {
    let scene = fixture("slab");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    // Off the floor, which a step down would hide the light.
    let lifted = |receiver: &Receiver, offset: DVec3| Receiver {
        position: receiver.position + offset + 0.01 * DVec3::Y,
        ..*receiver
    };
    let g = |receiver: &Receiver, offset: DVec3| {
        let receiver = lifted(receiver, offset);
        transport::gather(&[receiver], &lights, &occluders, &exact()).0[0].g[0]
    };
    let (mut by_edges, mut by_ends) = (Vec::new(), Vec::new());
    for receiver in &floor(40, 10.0) {
        let raised = lifted(receiver, DVec3::ZERO);
        let sample = |options| transport::gather(&[raised], &lights, &occluders, &options).0[0];
        let (edges, ends) = (sample(exact()), sample(with_appendix(exact())));
        let norm = |m: DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        if edges.j == ends.j || edges.g[0].y < 1e-3 {
            continue;
        }
        let mut differences = DMat3::ZERO;
        for axis in 0..3 {
            let step = STEP * DVec3::AXES[axis];
            *differences.col_mut(axis) = (g(receiver, step) - g(receiver, -step)) / (2.0 * STEP);
        }
        by_edges.push(norm(edges.j[0] - differences) / norm(differences));
        by_ends.push(norm(ends.j[0] - differences) / norm(differences));
    }
    for errors in [&mut by_edges, &mut by_ends] {
        errors.sort_by(f64::total_cmp);
    }
    let middle = by_edges.len() / 2;
    println!(
        "exact contours, {} points: edges {:e}, appendix {:.3}",
        by_edges.len(),
        by_edges[middle],
        by_ends[middle]
    );
    assert!(by_edges.len() > 100);
    assert!(by_edges[middle] < 1e-6, "edges {:e}", by_edges[middle]);
    assert!(
        (0.2..1.5).contains(&by_ends[middle]),
        "ends {}",
        by_ends[middle]
    );
}

#[test]
fn points_do_not_depend_on_their_order_or_on_threads() {
    let scene = fixture("slab");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let options = vedel(2, 1.0);
    let tile = floor(16, 4.0);
    let gather = |tile: &[Receiver]| transport::gather(tile, &lights, &occluders, &options).0;
    let forwards = gather(&tile);
    assert!(forwards.iter().any(|sample| sample.rays > 50));
    let mut reversed: Vec<_> = tile.iter().rev().copied().collect();
    let mut backwards = gather(&reversed);
    backwards.reverse();
    assert_eq!(forwards, backwards);

    let mut rng = Rng::new(0);
    for index in (1..reversed.len()).rev() {
        reversed.swap(index, (rng.bits() % (index as u64 + 1)) as usize);
    }
    let shuffled = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..3).map(|_| scope.spawn(|| gather(&reversed))).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().expect("no thread panics"))
            .collect::<Vec<_>>()
    });
    for samples in shuffled {
        for (receiver, sample) in reversed.iter().zip(samples) {
            assert_eq!(sample, forwards[receiver.seed as usize]);
        }
    }
}

/// Lights at y = 3 that look down: a parallelogram, an L, a frame around a hole, a polygon of 14 sides.
fn lights_of_all_shapes() -> Vec<Vec<[DVec3; 3]>> {
    let at = |x: f64, z: f64| DVec3::new(x, 3.0, z);
    let block = |x: f64, z: f64| quad(at(x, z), DVec3::X, DVec3::Z);
    let blocks = |places: &[[f64; 2]]| places.iter().flat_map(|&[x, z]| block(x, z)).collect();
    let corner = |k: u32| {
        let angle = std::f64::consts::TAU * f64::from(k) / 14.0;
        at(angle.cos(), -angle.sin())
    };
    vec![
        quad(
            at(-1.0, -1.0),
            DVec3::new(1.5, 0.0, 0.3),
            DVec3::new(0.4, 0.0, 1.6),
        ),
        blocks(&[[-1.0, -1.0], [0.0, -1.0], [-1.0, 0.0]]),
        blocks(&[
            [-1.5, -1.5],
            [-0.5, -1.5],
            [0.5, -1.5],
            [-1.5, -0.5],
            [0.5, -0.5],
            [-1.5, 0.5],
            [-0.5, 0.5],
            [0.5, 0.5],
        ]),
        (1..13)
            .map(|k| [corner(0), corner(k + 1), corner(k)])
            .collect(),
    ]
}

#[test]
fn lights_of_any_shape_seen_from_either_side_over_any_horizon_converge_to_the_exact_answer() {
    let shapes = lights_of_all_shapes();
    let mut errors = Vec::new();
    let mut n_partial = 0;
    for case in 0..240u64 {
        let mut rng = Rng::new(case);
        let light = shapes[case as usize % shapes.len()].clone();
        let from_above = case % 3 == 0;
        let mirror = |p: DVec3| {
            if from_above {
                DVec3::new(p.x, 6.0 - p.y, p.z)
            } else {
                p
            }
        };
        let side = 0.8 + rng.unit();
        let (u, tilt) = (rng.direction() * side, rng.direction() * side);
        let v = u.cross(tilt).normalize() * side;
        let middle = DVec3::new(
            rng.range(-0.8, 0.8),
            rng.range(1.2, 2.0),
            rng.range(-0.8, 0.8),
        );
        let hidden: Vec<_> = quad(middle - 0.5 * (u + v), u, v)
            .into_iter()
            .map(|triangle| triangle.map(|p| mirror(p.with_y(p.y.clamp(0.2, 2.8)))))
            .collect();
        let material = Material {
            double_sided: true,
            ..emitter(1.0)
        };
        let scene = scene_of(&[(material, light), (Material::default(), hidden)]);
        let found = lights::collect(&scene, &lights::Options::default());
        assert_eq!(found.polygons.len(), 1, "case {case}");
        let occluders = Occluders::build(&scene);
        // Half of the horizons lean so far that they cut the light.
        let lean = if case % 2 == 0 { 0.3 } else { 2.5 };
        let up = DVec3::Y + lean * rng.direction().with_y(0.0);
        let receiver = Receiver {
            position: mirror(DVec3::new(rng.range(-1.5, 1.5), 0.0, rng.range(-1.5, 1.5))),
            normal: (mirror(up) - mirror(DVec3::ZERO)).normalize(),
            seed: case,
        };
        let sample = |options| transport::gather(&[receiver], &found, &occluders, &options).0[0];
        let want = sample(exact());
        let got = sample(vedel(8, 1.0));
        let open = transport::unoccluded(&found.polygons[0], &receiver, false);
        let whole = open.g.dot(receiver.normal);
        assert!(got.g[0].is_finite() && got.phi[0] >= 0.0, "case {case}");
        if whole <= 1e-9 {
            continue;
        }
        let error = (got.g[0] - want.g[0]).length() / open.g.length();
        let visible = want.g[0].dot(receiver.normal) / whole;
        if visible > 1.0 - 1e-12 {
            assert!(
                error < 1e-12,
                "case {case}: {error:e} although nothing hides the light"
            );
            continue;
        }
        n_partial += usize::from(visible > 1e-9);
        // A corner that reaches between samples takes a sixteenth of a square's side at most; thin ones take more.
        assert!(error < 0.03, "case {case}: {error}");
        errors.push(error);
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!(
        "{n_partial} partial, mean error {mean:e}, worst {:e}",
        errors.iter().copied().fold(0.0, f64::max)
    );
    assert!(n_partial > 80, "{n_partial}");
    assert!(mean < 2e-3, "mean error {mean}");
}

//! What interpolation saves and what it costs: evaluations and CPU time per texel against evaluating every texel, and the error.
//!
//! `cargo bench --bench refine [FIXTURE ...]`. Figures are of floors of 512² texels. "Active" texels are those in 8×8 tiles
//! whose shaft to the light is not empty. Errors are of E in 1/255 of its maximum, at active texels. Times are CPU time of this thread, and
//! what counts is their ratio within one run.

#![expect(clippy::print_stdout, reason = "the figures are what it is for")]

use std::cell::RefCell;
use std::time::Duration;

use glam::{DVec2, DVec3};
use lumel::lights::{self, Lights};
use lumel::math;
use lumel::refine::{self, Domain, Point, Refined};
use lumel::scene::{self, Scene};
use lumel::transport::{self, Estimator, Receiver, Sample};
use lumel::visibility::Occluders;
use rustix::time::{ClockId, clock_gettime};

/// Texels along each side of the floor.
const N: usize = 512;

/// Fixtures with the half side of the floor in metres and the evaluations per active texel that are asked for.
const SCENES: [(&str, f64, f64); 3] = [
    ("penumbra", 5.0, 0.03),
    ("slab", 5.0, 0.035),
    ("contact", 2.5, 0.045),
];

/// One step of 255: the default tolerance.
const TOLERANCE: f64 = 0.004;

fn main() {
    let asked: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    let wants = |name: &str| asked.is_empty() || asked.iter().any(|other| other == name);
    // One thread, so that its CPU time is all there is.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build()
        .expect("a pool of this thread");
    pool.install(|| {
        for (name, half, target) in SCENES {
            if wants(name) {
                Floor::open(name, half).compare(target);
            }
        }
    });
}

fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(
        time.tv_sec.unsigned_abs(),
        time.tv_nsec.unsigned_abs() as u32,
    )
}

fn timed<R>(work: impl FnOnce() -> R) -> (R, f64) {
    let start = cpu_time();
    let result = work();
    (result, (cpu_time() - start).as_secs_f64())
}

/// Which derivatives interpolation gets.
#[derive(Clone, Copy, PartialEq)]
enum Derivatives {
    True,
    /// By the formula of Vedel's appendix.
    Appendix,
    None,
}

struct Floor {
    name: String,
    half: f64,
    scene: Scene,
    lights: Lights,
}

impl Floor {
    fn open(name: &str, half: f64) -> Self {
        let path = format!("{}/fixtures/{name}/{name}.gltf", env!("CARGO_MANIFEST_DIR"));
        let scene = Scene::open(path.as_ref(), &scene::Options::default()).expect("a fixture");
        Self {
            name: name.to_owned(),
            half,
            lights: lights::collect(&scene, &lights::Options::default()),
            scene,
        }
    }

    fn step(&self) -> f64 {
        2.0 * self.half / N as f64
    }

    fn receiver(&self, index: usize) -> Receiver {
        let at = |k: usize| (k as f64 + 0.5) * self.step() - self.half;
        Receiver {
            position: DVec3::new(at(index % N), 0.0, at(index / N)),
            normal: DVec3::Y,
            seed: math::hash(index as u64, 0, 0),
        }
    }

    fn domain() -> Domain {
        let points = (0..N * N)
            .map(|index| Point {
                cell: [(index % N) as u16, (index / N) as u16],
                place: DVec2::new((index % N) as f64 + 0.5, (index / N) as f64 + 0.5),
                joined: [true; 2],
                spacing: 16,
            })
            .collect();
        Domain::new(points).expect("a small domain")
    }

    fn compare(&self, target: f64) {
        let occluders = Occluders::build(&self.scene);
        let _ = occluders.edges();
        let options = transport::Options::default();
        let gather = |points: &[u32], options: &transport::Options| {
            let receivers: Vec<Receiver> = points
                .iter()
                .map(|&point| self.receiver(point as usize))
                .collect();
            transport::gather(&receivers, &self.lights, &occluders, options)
        };
        let tiles: Vec<Vec<u32>> = (0..N * N / 64)
            .map(|tile| {
                let corner = tile / (N / 8) * 8 * N + tile % (N / 8) * 8;
                (0..64)
                    .map(|place| (corner + place / 8 * N + place % 8) as u32)
                    .collect()
            })
            .collect();
        let all = |options: &transport::Options| {
            let mut truth = vec![Sample::DARK; N * N];
            let mut active = vec![false; N * N];
            for tile in &tiles {
                let (samples, counters) = gather(tile, options);
                let is_active =
                    counters.pairs_unoccluded + counters.pairs_facing_away < counters.pairs;
                for (&point, sample) in tile.iter().zip(samples) {
                    truth[point as usize] = sample;
                    active[point as usize] = is_active;
                }
            }
            (truth, active)
        };
        // As `--refine off` does it: without derivatives.
        let ((truth, active), dense) = timed(|| {
            all(&transport::Options {
                gradients: false,
                ..options.clone()
            })
        });
        let n_active = active.iter().filter(|&&active| active).count();
        let brightest = truth.iter().map(|s| s.g[0].y).fold(0.0, f64::max);
        // 1,024 stratified rays, at one active tile in 64.
        let some: Vec<&Vec<u32>> = tiles
            .iter()
            .filter(|tile| active[tile[0] as usize])
            .step_by(64)
            .collect();
        let (_, sampled) = timed(|| {
            let options = transport::Options {
                estimator: Estimator::Sampled,
                samples: 1024,
                gradients: false,
                ..options.clone()
            };
            some.iter()
                .map(|tile| gather(tile, &options).0.len())
                .sum::<usize>()
        });
        let sampled = sampled / (64 * some.len()) as f64 * n_active as f64;
        println!(
            "\n{}: {n_active} active texels of {}; asked: {target} evaluations per active texel, mean 0.25, 99 % 1",
            self.name,
            N * N
        );
        println!(
            "  every texel {:.2} µs per texel; 1,024 stratified rays {:.1} times as much",
            dense * 1e6 / (N * N) as f64,
            sampled / dense
        );
        println!(
            "  derivatives  tolerance   evaluations   active   per active    mean    99 %  99.9 %     max  claimed/true  CPU saved  against 1,024 rays"
        );
        for (derivatives, tolerances) in [
            (
                Derivatives::True,
                &[1.0, 7.5, 4.0, 2.0, 0.5, 0.25, 0.125, 0.075][..],
            ),
            (Derivatives::None, &[1.0, 0.5, 0.25]),
            (Derivatives::Appendix, &[1.0, 4.0, 2.0]),
        ] {
            for factor in tolerances {
                let tolerance = factor * TOLERANCE;
                let n_calls = RefCell::new(0);
                let (refined, cpu) =
                    timed(|| self.refine(&gather, derivatives, tolerance * brightest, &n_calls));
                let mut errors: Vec<(f64, f64)> = (0..N * N)
                    .filter(|&index| active[index])
                    .map(|index| {
                        let error = f64::from(refined.values[index][0]) - truth[index].g[0].y;
                        let scale = 255.0 / brightest;
                        (
                            error.abs() * scale,
                            f64::from(refined.errors[index]) * scale,
                        )
                    })
                    .collect();
                errors.sort_by(|a, b| a.0.total_cmp(&b.0));
                let mean = errors.iter().map(|e| e.0).sum::<f64>() / n_active as f64;
                let claimed = errors.iter().map(|e| e.1).sum::<f64>() / n_active as f64;
                let quantile = |share: f64| errors[(share * (n_active - 1) as f64) as usize].0;
                let n_evaluated = refined.evaluated.iter().filter(|&&e| e).count();
                let n_active_evaluated = (0..N * N)
                    .filter(|&index| active[index] && refined.evaluated[index])
                    .count();
                println!(
                    "  {:11} {tolerance:10.5} {n_evaluated:13} {n_active_evaluated:8} {:12.4} {mean:7.3} {:7.3} {:7.3} {:7.3} {:13.2} {:10.2} {:8.0}   ({} calls)",
                    match derivatives {
                        Derivatives::True => "true",
                        Derivatives::Appendix => "appendix",
                        Derivatives::None => "none",
                    },
                    n_active_evaluated as f64 / n_active as f64,
                    quantile(0.99),
                    quantile(0.999),
                    quantile(1.0),
                    claimed / mean,
                    dense / cpu,
                    sampled / cpu,
                    n_calls.borrow(),
                );
            }
        }
    }

    fn refine(
        &self,
        gather: &(impl Fn(&[u32], &transport::Options) -> (Vec<Sample>, transport::Counters) + Sync),
        derivatives: Derivatives,
        tolerance: f64,
        n_calls: &RefCell<usize>,
    ) -> Refined<3> {
        let n_called = std::sync::atomic::AtomicUsize::new(0);
        let options = transport::Options {
            appendix_derivative: derivatives == Derivatives::Appendix,
            gradients: derivatives != Derivatives::None,
            ..transport::Options::default()
        };
        let evaluate = |points: &[u32]| {
            n_called.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            gather(points, &options)
                .0
                .iter()
                .map(|sample| {
                    let slope = |along: DVec3| {
                        [0, 1, 2].map(|channel| (sample.j[channel] * along).y * self.step())
                    };
                    refine::Sample {
                        value: [0, 1, 2].map(|channel| sample.g[channel].y),
                        slopes: [slope(DVec3::X), slope(DVec3::Z)],
                        has_slopes: sample.has_gradient,
                        error: sample.error,
                    }
                })
                .collect()
        };
        let refined = refine::sparse(
            &Self::domain(),
            &evaluate,
            &refine::Options {
                tolerance,
                budget: usize::MAX,
                slopes: false,
            },
            &|| false,
        )
        .expect("nobody cancels");
        *n_calls.borrow_mut() = n_called.into_inner();
        refined
    }
}

//! How good and how dear each estimator is on the fixtures: error, rays, and CPU time in shadow rays of the same scene.
//!
//! `cargo bench --bench estimators [FIXTURE ...]`. Figures are of floor points in tiles whose shaft to the light is not empty. Times are
//! CPU time of this thread, and what counts is their ratio within one run: "as rays" is the cost of a point over the cost of one
//! stratified shadow ray there. `AvDif` is mean |ΔE| · 255 / max E (Vedel 1993, table 1).

#![expect(clippy::print_stdout, reason = "the figures are what it is for")]

use std::time::Duration;

use glam::DVec3;
use lumel::lights;
use lumel::math;
use lumel::scene::{self, Scene};
use lumel::transport::{self, Counters, Estimator, Options, Receiver, Sample};
use lumel::visibility::Occluders;
use rustix::time::{ClockId, clock_gettime};

/// Floor points along each axis, and the half side of the floor in metres.
const SCENES: [(&str, usize, f64); 4] = [
    ("penumbra", 256, 5.0),
    ("slab", 256, 5.0),
    ("contact", 128, 2.5),
    ("leaves", 40, 2.5),
];

fn main() {
    let asked: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    if std::env::args().any(|a| a == "--only-exact") {
        for (name, n, half) in SCENES {
            if asked.iter().any(|f| f == name) {
                only(name, n.min(128), half);
            }
        }
        return;
    }
    for (name, n, half) in SCENES {
        if asked.is_empty() || asked.iter().any(|fixture| fixture == name) {
            compare(name, n, half);
        }
    }
}

fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(
        time.tv_sec.unsigned_abs(),
        time.tv_nsec.unsigned_abs() as u32,
    )
}

/// 8 × 8 blocks of a grid of receivers on the floor.
fn tiles(n: usize, half: f64) -> Vec<Vec<Receiver>> {
    let step = 2.0 * half / n as f64;
    let at = |index: usize| (index as f64 + 0.5) * step - half;
    let mut tiles = Vec::new();
    for row in (0..n).step_by(8) {
        for column in (0..n).step_by(8) {
            let tile = (0..64)
                .map(|place| (column + place % 8, row + place / 8))
                .filter(|&(x, z)| x < n && z < n)
                .map(|(x, z)| Receiver {
                    position: DVec3::new(at(x), 0.0, at(z)),
                    normal: DVec3::Y,
                    seed: math::hash(x as u64, z as u64, 0),
                })
                .collect();
            tiles.push(tile);
        }
    }
    tiles
}

fn only(name: &str, n: usize, half: f64) {
    let path = format!("{}/fixtures/{name}/{name}.gltf", env!("CARGO_MANIFEST_DIR"));
    let scene = Scene::open(path.as_ref(), &scene::Options::default()).expect("a fixture");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let _ = occluders.edges();
    let mut sum = 0.0;
    let mut np = 0;
    let options = Options {
        estimator: Estimator::Exact,
        ..Options::default()
    };
    let mut total = Counters::default();
    let active: Vec<_> = tiles(n, half)
        .into_iter()
        .filter(|tile| {
            let o = Options {
                estimator: Estimator::Sampled,
                samples: 1,
                ..Options::default()
            };
            transport::gather(tile, &lights, &occluders, &o)
                .1
                .pairs_sampled
                > 0
        })
        .collect();
    for tile in active {
        let (samples, counters) = transport::gather(&tile, &lights, &occluders, &options);
        sum += samples
            .iter()
            .map(|s| s.phi[0] + s.j[0].col(0).x + s.error)
            .sum::<f64>();
        if counters.pairs_exact > 0 {
            np += tile.len();
        }
        total.add(&counters);
    }
    println!(
        "{name} {np} points, checksum {sum:.15e} edges/pair {}",
        total.edges as f64 / total.pairs_exact as f64
    );
}

struct Run {
    samples: Vec<Sample>,
    counters: Counters,
    cpu: Duration,
}

fn compare(name: &str, n: usize, half: f64) {
    let path = format!("{}/fixtures/{name}/{name}.gltf", env!("CARGO_MANIFEST_DIR"));
    let scene = Scene::open(path.as_ref(), &scene::Options::default()).expect("a fixture");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let _ = occluders.edges();
    let run = |tiles: &[Vec<Receiver>], estimator, samples| {
        let options = Options {
            estimator,
            samples,
            ..Options::default()
        };
        let mut result = Run {
            samples: Vec::new(),
            counters: Counters::default(),
            cpu: Duration::ZERO,
        };
        let start = cpu_time();
        for tile in tiles {
            let (samples, counters) = transport::gather(tile, &lights, &occluders, &options);
            result.samples.extend(samples);
            result.counters.add(&counters);
        }
        result.cpu = cpu_time() - start;
        result
    };

    let active: Vec<Vec<Receiver>> = tiles(n, half)
        .into_iter()
        .filter(|tile| {
            let options = Options {
                samples: 1,
                estimator: Estimator::Sampled,
                ..Options::default()
            };
            let (_, counters) = transport::gather(tile, &lights, &occluders, &options);
            counters.pairs_sampled > 0
        })
        .collect();
    let n_active: usize = active.iter().map(Vec::len).sum();
    println!("\n{name}: {n_active} active points of {}", n * n);
    println!("  method            rays/point  as rays    AvDif    99.9 %  claimed/true  fallbacks");
    let truth = run(&active, Estimator::Exact, 1);
    let brightest = truth
        .samples
        .iter()
        .map(|sample| sample.irradiance(DVec3::Y).max_element())
        .fold(0.0, f64::max);
    // One ray: the difference of two sample counts, so that what is done once per point cancels.
    let (few, many) = (
        run(&active, Estimator::Sampled, 64),
        run(&active, Estimator::Sampled, 256),
    );
    let n_rays = (many.counters.shadow_rays - few.counters.shadow_rays) as f64;
    let ray = (many.cpu.as_secs_f64() - few.cpu.as_secs_f64()) / n_rays;
    let print = |label: &str, run: &Run| {
        let mut errors: Vec<f64> = run
            .samples
            .iter()
            .zip(&truth.samples)
            .map(|(sample, truth)| {
                (sample.irradiance(DVec3::Y) - truth.irradiance(DVec3::Y))
                    .abs()
                    .max_element()
                    * 255.0
                    / brightest
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        let mean = errors.iter().sum::<f64>() / n_active as f64;
        let claimed: f64 = run.samples.iter().map(|sample| sample.error).sum::<f64>() * 255.0
            / brightest
            / n_active as f64;
        println!(
            "  {label:16} {:10.1} {:9.1} {mean:10.5} {:9.4} {:10.2}  {}",
            run.counters.shadow_rays as f64 / n_active as f64,
            run.cpu.as_secs_f64() / n_active as f64 / ray,
            errors[n_active * 999 / 1000],
            if mean > 0.0 { claimed / mean } else { f64::NAN },
            run.counters.points_fallback,
        );
    };
    for samples in [16, 64, 256, 1024] {
        let label = format!("sampled {samples}");
        print(&label, &run(&active, Estimator::Sampled, samples));
    }
    for estimator in Estimator::ALL {
        if estimator != Estimator::Sampled {
            print(
                &format!("{estimator:?}").to_lowercase(),
                &run(&active, estimator, 64),
            );
        }
    }
    println!("  ({:.3} µs a ray)", ray * 1e6);
}

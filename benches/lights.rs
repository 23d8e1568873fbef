//! What adaptive shadow testing saves and what it costs in accuracy, and how the cost grows with the number of lights.
//!
//! `cargo bench --bench lights`. Points are on the floor of `fixtures/theatre`, in tiles of 8 × 8 at 4 texels per metre. Errors are relative to
//! the mean irradiance; "bound broken" counts points where the true error exceeds the reported one. Times are CPU time of this thread; what
//! counts is their ratio within one run.

#![expect(clippy::print_stdout, reason = "the figures are what it is for")]

use std::time::Duration;

use glam::DVec3;
use lumel::lights::{self, Lights, Polygon};
use lumel::math;
use lumel::scene::{self, Scene};
use lumel::transport::{self, Counters, Options, Receiver, Sample};
use lumel::visibility::Occluders;
use rustix::time::{ClockId, clock_gettime};

/// Every so many-th tile of the floor is looked at.
const STRIDE: usize = 37;

fn main() {
    let path = format!(
        "{}/fixtures/theatre/theatre.gltf",
        env!("CARGO_MANIFEST_DIR")
    );
    let scene = Scene::open(path.as_ref(), &scene::Options::default()).expect("a fixture");
    let lights = lights::collect(&scene, &lights::Options::default());
    let occluders = Occluders::build(&scene);
    let _ = occluders.edges();
    let tiles: Vec<_> = tiles().into_iter().step_by(STRIDE).collect();
    println!(
        "theatre: {} lights, {} tiles of 64 points",
        lights.len(),
        tiles.len()
    );
    let all = run(&tiles, &lights, &occluders, &Options::default());
    println!(
        "  threshold certainty   rel. RMSE  rel. max   rays/point  untested/point  bound broken  CPU of all"
    );
    for (threshold, certainty) in [
        (0.0, 1.0),
        (0.0025, 0.5),
        (0.004, 0.5),
        (0.005, 0.5),
        (0.01, 0.5),
        (0.02, 0.5),
        (0.05, 0.5),
        (0.02, 0.0),
        (0.02, 1.0),
    ] {
        let options = Options {
            direct_threshold: threshold,
            direct_certainty: certainty,
            ..Options::default()
        };
        compare(
            &run(&tiles, &lights, &occluders, &options),
            &all,
            (threshold, certainty),
        );
    }

    println!("\nthe same hall with the same light from more lamps, default threshold");
    println!("  lights   rel. RMSE   rays/point   CPU of the first");
    let mut first = None;
    for side in [10, 32, 100] {
        let lights = grid(side);
        // Fewer tiles: the reference tests all.
        let tiles: Vec<_> = tiles.iter().step_by(10).cloned().collect();
        let options = Options {
            direct_threshold: 0.004,
            ..Options::default()
        };
        let adaptive = run(&tiles, &lights, &occluders, &options);
        let reference = run(&tiles, &lights, &occluders, &Options::default());
        let cpu = adaptive.cpu.as_secs_f64();
        let first = *first.get_or_insert(cpu);
        let (rmse, _) = errors(&adaptive, &reference);
        println!(
            "  {:6} {rmse:11.5} {:12.1} {:10.2}   (of testing all: {:.3})",
            lights.len(),
            adaptive.counters.shadow_rays as f64 / adaptive.counters.points as f64,
            cpu / first,
            cpu / reference.cpu.as_secs_f64(),
        );
    }
}

/// `side`² lamps below the ceiling, of one area and one flux in all.
fn grid(side: usize) -> Lights {
    let step = DVec3::new(40.0, 0.0, 24.0) / side as f64;
    let polygons = (0..side * side).map(|index| {
        let place = DVec3::new(
            (index % side) as f64 + 0.5,
            0.0,
            (index / side) as f64 + 0.5,
        );
        let centre = place * step + DVec3::Y * 8.7;
        let (u, v) = (
            DVec3::X * (4.0 / side as f64),
            DVec3::Z * (2.4 / side as f64),
        );
        let [a, b, c, d] = [
            centre - u - v,
            centre + u - v,
            centre + u + v,
            centre - u + v,
        ];
        let output = [0.2, 0.5, 1.0, 2.0, 5.0][(index * 7 + index / side) % 5];
        Polygon {
            contours: vec![vec![a, b, c, d]],
            triangles: vec![[a, b, c], [a, c, d]],
            normal: DVec3::NEG_Y,
            area: 4.0 * u.x * v.z,
            radiance: DVec3::splat(100.0 * output),
            two_sided: false,
            surface: Vec::new(),
        }
    });
    Lights {
        polygons: polygons.collect(),
        ..Lights::default()
    }
}

fn tiles() -> Vec<Vec<Receiver>> {
    let mut tiles = Vec::new();
    for row in 0..12 {
        for column in 0..20 {
            let tile = (0..64).map(|place| {
                let (x, z) = (8 * column + place % 8, 8 * row + place / 8);
                Receiver {
                    position: DVec3::new((x as f64 + 0.5) / 4.0, 0.0, (z as f64 + 0.5) / 4.0),
                    normal: DVec3::Y,
                    seed: math::hash(x as u64, z as u64, 0),
                }
            });
            tiles.push(tile.collect());
        }
    }
    tiles
}

struct Run {
    samples: Vec<Sample>,
    counters: Counters,
    cpu: Duration,
}

fn run(
    tiles: &[Vec<Receiver>],
    lights: &Lights,
    occluders: &Occluders<'_>,
    options: &Options,
) -> Run {
    let options = Options {
        gradients: false,
        ..options.clone()
    };
    let mut samples = Vec::new();
    let mut counters = Counters::default();
    let start = cpu_time();
    for tile in tiles {
        let (found, counted) = transport::gather(tile, lights, occluders, &options);
        samples.extend(found);
        counters.add(&counted);
    }
    Run {
        samples,
        counters,
        cpu: cpu_time() - start,
    }
}

fn irradiance(sample: &Sample) -> f64 {
    sample.irradiance(DVec3::Y).max_element()
}

/// Root mean square and largest error over the mean irradiance.
fn errors(run: &Run, truth: &Run) -> (f64, f64) {
    let mean = truth.samples.iter().map(irradiance).sum::<f64>() / truth.samples.len() as f64;
    let differences = || {
        let pairs = run.samples.iter().zip(&truth.samples);
        pairs.map(|(got, want)| (irradiance(got) - irradiance(want)).abs())
    };
    let square = differences().map(|d| d * d).sum::<f64>() / truth.samples.len() as f64;
    (
        square.sqrt() / mean,
        differences().fold(0.0, f64::max) / mean,
    )
}

fn compare(run: &Run, truth: &Run, (threshold, certainty): (f64, f64)) {
    let n = run.samples.len() as f64;
    let (rmse, largest) = errors(run, truth);
    let n_broken = run
        .samples
        .iter()
        .zip(&truth.samples)
        .filter(|(got, want)| {
            (irradiance(got) - irradiance(want)).abs() > got.error + want.error + 1e-9
        })
        .count();
    println!(
        "  {threshold:9} {certainty:9} {rmse:11.5} {largest:9.4} {:12.1} {:15.1} {n_broken:13} {:11.3}",
        run.counters.shadow_rays as f64 / n,
        run.counters.lights_untested as f64 / n,
        run.cpu.as_secs_f64() / truth.cpu.as_secs_f64(),
    );
}

fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(
        time.tv_sec.unsigned_abs(),
        time.tv_nsec.unsigned_abs() as u32,
    )
}

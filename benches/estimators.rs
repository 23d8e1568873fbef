//! How good and how dear each estimator is on the fixtures: error, rays, and CPU time in shadow rays of the same scene.
//!
//! `cargo bench --bench estimators [FIXTURE ...]`; behind `--`, `--fit` fits what exact contours and rays cost to what is counted, for
//! `transport/cost.rs`, and `--count` only clips, without reading a clock, for callgrind. Figures are of floor points in tiles whose shaft to the light is not empty. Times are
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
    let (flags, asked): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .partition(|argument| argument.starts_with('-'));
    let has = |flag: &str| flags.iter().any(|other| other == flag);
    let mut fit = Fit::default();
    for (name, n, half) in SCENES {
        if !asked.is_empty() && !asked.iter().any(|fixture| fixture == name) {
            continue;
        }
        let floor = Floor::open(name, n, half);
        if has("--count") {
            floor.count();
        } else if has("--fit") {
            fit.add(&floor);
        } else {
            compare(&floor);
        }
    }
    fit.print();
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

struct Run {
    samples: Vec<Sample>,
    counters: Counters,
    cpu: Duration,
}

/// A fixture and the tiles on its floor whose shaft to the light is not empty.
struct Floor {
    name: &'static str,
    scene: Scene,
    n: usize,
    half: f64,
}

/// What rays and outlines are looked up in.
struct World<'a> {
    lights: lights::Lights,
    occluders: Occluders<'a>,
    tiles: Vec<Vec<Receiver>>,
}

impl Floor {
    fn open(name: &'static str, n: usize, half: f64) -> Self {
        let path = format!("{}/fixtures/{name}/{name}.gltf", env!("CARGO_MANIFEST_DIR"));
        let scene = Scene::open(path.as_ref(), &scene::Options::default()).expect("a fixture");
        Self {
            name,
            scene,
            n,
            half,
        }
    }

    fn world(&self) -> World<'_> {
        let mut world = World {
            lights: lights::collect(&self.scene, &lights::Options::default()),
            occluders: Occluders::build(&self.scene),
            tiles: tiles(self.n, self.half),
        };
        let _ = world.occluders.edges();
        let mut tiles = std::mem::take(&mut world.tiles);
        let look = with(Estimator::Sampled, 1, 0.0);
        tiles.retain(|tile| world.gather(tile, &look).1.pairs_sampled > 0);
        world.tiles = tiles;
        world
    }

    /// Clips, without a clock.
    fn count(&self) {
        let world = self.world();
        let mut counters = Counters::default();
        let mut sum = 0.0;
        for tile in &world.tiles {
            let (samples, more) = world.gather(tile, &with(Estimator::Exact, 1, 0.0));
            sum += samples.iter().map(|sample| sample.phi[0]).sum::<f64>();
            counters.add(&more);
        }
        println!(
            "{} {} points {sum:e} {counters:?}",
            self.name, counters.points
        );
    }
}

impl World<'_> {
    fn gather(&self, tile: &[Receiver], options: &Options) -> (Vec<Sample>, Counters) {
        transport::gather(tile, &self.lights, &self.occluders, options)
    }

    fn run(&self, options: &Options) -> Run {
        let mut result = Run {
            samples: Vec::new(),
            counters: Counters::default(),
            cpu: Duration::ZERO,
        };
        let start = cpu_time();
        for tile in &self.tiles {
            let (samples, counters) = self.gather(tile, options);
            result.samples.extend(samples);
            result.counters.add(&counters);
        }
        result.cpu = cpu_time() - start;
        result
    }

    /// Seconds of one shadow ray: the difference of two sample counts, so that what is done once per point cancels.
    fn ray(&self) -> f64 {
        let [few, many] = [64, 256].map(|n| self.run(&with(Estimator::Sampled, n, 0.0)));
        let n_rays = many.counters.shadow_rays - few.counters.shadow_rays;
        (many.cpu.as_secs_f64() - few.cpu.as_secs_f64()) / n_rays as f64
    }
}

fn with(estimator: Estimator, samples: u32, accepted_error: f64) -> Options {
    Options {
        estimator,
        samples,
        accepted_error,
        ..Options::default()
    }
}

fn irradiance(sample: &Sample) -> f64 {
    sample.irradiance(DVec3::Y).max_element()
}

/// What is asked of an estimator on a fixture: the figure, and its limit.
const LIMITS: [(&str, &str, &str, f64); 8] = [
    ("penumbra", "exact", "as rays", 100.0),
    ("penumbra", "traced", "rays/point", 40.0),
    ("penumbra", "traced", "AvDif", 0.005),
    ("penumbra", "vedel", "rays/point", 55.0),
    ("penumbra", "vedel", "AvDif", 0.7),
    ("slab", "exact", "as rays", 20.0),
    ("slab", "auto", "AvDif", 0.01),
    ("slab", "auto", "as rays", 20.0),
];

/// The errors, in 255ths of the brightest point, that all ways are asked to keep to.
const TOLERANCES: [f64; 3] = [4.0, 1.0, 0.25];

/// One fixture, the truth there, and the cost of a ray.
struct Table<'a> {
    name: &'a str,
    truth: Vec<f64>,
    brightest: f64,
    ray: f64,
}

impl Table<'_> {
    /// Prints a line; returns the cost in rays.
    fn print(&self, label: &str, run: &Run) -> f64 {
        let n = self.truth.len();
        let unit = 255.0 / self.brightest;
        let pairs = run.samples.iter().zip(&self.truth);
        let mut errors: Vec<f64> = pairs
            .map(|(sample, truth)| (irradiance(sample) - truth).abs() * unit)
            .collect();
        errors.sort_by(f64::total_cmp);
        let mean = errors.iter().sum::<f64>() / n as f64;
        let claimed = run
            .samples
            .iter()
            .map(|sample| sample.error * unit)
            .sum::<f64>()
            / n as f64;
        let rays = run.counters.shadow_rays as f64 / n as f64;
        let as_rays = run.cpu.as_secs_f64() / n as f64 / self.ray;
        let limits: Vec<String> = LIMITS
            .iter()
            .filter(|limit| (limit.0, limit.1) == (self.name, label))
            .map(|&(_, _, figure, limit)| {
                let got = match figure {
                    "as rays" => as_rays,
                    "AvDif" => mean,
                    _ => rays,
                };
                let verdict = if got <= limit { "kept" } else { "MISSED" };
                format!("{figure} ≤ {limit} {verdict}")
            })
            .collect();
        println!(
            "  {label:18} {rays:10.1} {as_rays:9.1} {mean:10.5} {:9.4} {:10.2} {:9}  {}",
            errors[n * 999 / 1000],
            if mean > 0.0 { claimed / mean } else { f64::NAN },
            run.counters.points_fallback,
            limits.join(", ")
        );
        as_rays
    }
}

fn compare(floor: &Floor) {
    let world = floor.world();
    let truth = world.run(&with(Estimator::Exact, 1, 0.0));
    let truth: Vec<f64> = truth.samples.iter().map(irradiance).collect();
    let table = Table {
        name: floor.name,
        brightest: truth.iter().copied().fold(0.0, f64::max),
        ray: world.ray(),
        truth,
    };
    println!(
        "\n{}: {} active points of {}; {:.3} µs a ray",
        floor.name,
        table.truth.len(),
        floor.n * floor.n,
        table.ray * 1e6
    );
    println!(
        "  method             rays/point   as rays      AvDif    99.9 %  claimed/true fallbacks"
    );
    for samples in [16, 64, 256, 1024] {
        let run = world.run(&with(Estimator::Sampled, samples, 0.0));
        table.print(&format!("sampled {samples}"), &run);
    }
    for estimator in Estimator::ALL {
        if estimator != Estimator::Sampled {
            let run = world.run(&with(estimator, 64, 0.0));
            table.print(&format!("{estimator:?}").to_lowercase(), &run);
        }
    }
    for tolerance in TOLERANCES {
        let accepted = tolerance / 255.0 * table.brightest;
        let cost = |estimator: Estimator| {
            let label = format!("{estimator:?} to {tolerance}").to_lowercase();
            table.print(&label, &world.run(&with(estimator, 64, accepted)))
        };
        let ways = [Estimator::Exact, Estimator::Sampled, Estimator::Traced].map(cost);
        let cheapest = ways.into_iter().fold(f64::INFINITY, f64::min);
        let ratio = cost(Estimator::Auto) / cheapest;
        println!(
            "    auto costs {ratio:.2} of the cheapest of the three (asked: 1, and 0.1 for noise)"
        );
    }
}

/// Counts, nanoseconds, and the fixture.
type Row<const N: usize> = ([f64; N], f64, &'static str);

/// Least squares for what a tile costs.
#[derive(Default)]
struct Fit {
    /// Counts of a tile, and nanoseconds: of exact contours per tile, of a ray per fixture.
    exact: Vec<Row<4>>,
    rays: Vec<Row<2>>,
}

impl Fit {
    fn add(&mut self, floor: &Floor) {
        let world = floor.world();
        let options = with(Estimator::Exact, 1, 0.0);
        let mut all = Counters::default();
        for tile in &world.tiles {
            let mut fastest = f64::INFINITY;
            let mut counters = Counters::default();
            for _ in 0..3 {
                let start = cpu_time();
                counters = world.gather(tile, &options).1;
                fastest = fastest.min((cpu_time() - start).as_secs_f64() * 1e9);
            }
            let points = tile.len() as f64;
            let counts = [
                points,
                points * counters.edges as f64,
                counters.silhouettes as f64,
                counters.crossings as f64,
            ];
            self.exact.push((counts, fastest, floor.name));
            all.add(&counters);
        }
        let silhouettes = all.silhouettes as f64 / all.points as f64;
        self.rays
            .push(([1.0, silhouettes], world.ray() * 1e9, floor.name));
    }

    fn print(&self) {
        if self.exact.is_empty() {
            return;
        }
        let report = |what: &str, rows: Vec<(f64, f64, &'static str)>| {
            for (name, ..) in SCENES {
                let own = || rows.iter().filter(|row| row.2 == name);
                let sum = |column: fn(&(f64, f64, &'static str)) -> f64| -> f64 {
                    own().map(column).sum()
                };
                let ratio = sum(|row| row.0) / sum(|row| row.1);
                println!("  {what} on {name}: predicted {ratio:.2} of measured");
            }
        };
        let exact = least_squares(&self.exact);
        println!("exact, ns per point, edge, silhouette edge, crossing: {exact:.1?}");
        report("exact", predictions(&self.exact, exact));
        let ray = least_squares(&self.rays);
        println!("ray, ns, and per silhouette edge: {ray:.3?}");
        report("ray", predictions(&self.rays, ray));
    }
}

fn predictions<const N: usize>(
    rows: &[Row<N>],
    factors: [f64; N],
) -> Vec<(f64, f64, &'static str)> {
    rows.iter()
        .map(|(counts, measured, name)| {
            let predicted = (0..N).map(|k| counts[k] * factors[k]).sum();
            (predicted, *measured, *name)
        })
        .collect()
}

/// Factors of the counts that predict the measured values with the least sum of squares of relative errors, every fixture counting alike.
fn least_squares<const N: usize>(rows: &[Row<N>]) -> [f64; N] {
    let mut matrix = [[0.0; N]; N];
    let mut right = [0.0; N];
    for (counts, measured, name) in rows {
        let total: f64 = rows
            .iter()
            .filter(|row| row.2 == *name)
            .map(|row| row.1)
            .sum();
        for i in 0..N {
            for k in 0..N {
                matrix[i][k] += counts[i] * counts[k] / (measured * total);
            }
            right[i] += counts[i] / total;
        }
    }
    // Gauss and Jordan; the matrix is positive definite.
    for i in 0..N {
        let pivot = matrix[i][i];
        matrix[i] = matrix[i].map(|value| value / pivot);
        right[i] /= pivot;
        for k in (0..N).filter(|k| *k != i) {
            let factor = matrix[k][i];
            let row = matrix[i];
            for (value, other) in matrix[k].iter_mut().zip(row) {
                *value -= factor * other;
            }
            right[k] -= factor * right[i];
        }
    }
    right
}

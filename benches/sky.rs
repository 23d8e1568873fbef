//! How well a few directions stand for a picture of the sky: the evidence of Kollig and Keller 2003, section 3.1 and figure 5, again.
//!
//! `cargo bench --bench sky [DIR]`. Prints, for each picture, the largest ‖B‖ as part of all light, its log–log slope over N, the
//! decentration, and the times of construction; with DIR also writes them there as SVG. The pictures are a sky with clouds and a lamp made
//! in code, and the high dynamic range pictures of the project's shared scenes where those are.

#![expect(clippy::print_stdout, reason = "the figures are what it is for")]

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec3, Vec3};
use lumel::lights::sky::{self, Options, Rule, Sky};
use lumel::scene::Environment;
use plotters::prelude::{
    BLACK, BLUE, ChartBuilder, Color, IntoDrawingArea, IntoLogRange, LineSeries, PathElement, RED,
    RGBColor, SVGBackend, WHITE,
};

const NUMBERS: [usize; 9] = [4, 8, 16, 32, 64, 128, 256, 512, 1024];

/// Pictures of the shared scenes.
const SHARED: [&str; 3] = [
    "potsdamer_platz_1k",
    "studio_small_03_1k",
    "kloofendal_48d_partly_cloudy_1k",
];

/// Plain relaxations that are averaged; it depends on its random directions.
const SEEDS: u64 = 4;

type Outcome<T> = Result<T, Box<dyn Error>>;

fn main() -> Outcome<()> {
    let directory = std::env::args()
        .skip(1)
        .find(|argument| !argument.starts_with('-'))
        .map(PathBuf::from);
    if let Some(directory) = &directory {
        fs::create_dir_all(directory)?;
    }
    times()?;
    for (name, image) in pictures() {
        println!("\n{name}: {} × {}", image.width(), image.height());
        let with_sun = figure_3(&name, &image, directory.as_deref())?;
        if with_sun > 0 {
            let mut rest = image.clone();
            let regions = sky::split_bright(&mut rest);
            for region in &regions {
                println!(
                    "  bright region: {:.1} % of the light in {:.3} msr",
                    100.0 * region.cell.norm() / (rule_of(&image, 1)?.fluence().element_sum()),
                    1e3 * region.cell.solid_angle,
                );
            }
            figure_3(
                &format!("{name} without its bright regions"),
                &rest,
                directory.as_deref(),
            )?;
        }
        figure_5(&name, &image, directory.as_deref())?;
    }
    if let Some(peak) = peak_memory() {
        println!("\npeak memory of all that: {peak} MB");
    }
    Ok(())
}

fn pictures() -> Vec<(String, Environment)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes/hdr");
    let mut pictures = vec![("made in code".to_owned(), procedural(1024))];
    for name in SHARED {
        match Environment::open(&folder.join(format!("{name}.hdr"))) {
            Ok(image) => pictures.push((name.to_owned(), image)),
            Err(error) => println!("left out: {error}"),
        }
    }
    pictures
}

/// A blue sky with bright bands of cloud, a brown ground, and a soft lamp of some degrees.
fn procedural(width: u32) -> Environment {
    let lamp = DVec3::new(0.6, 0.5, -0.3).normalize();
    Environment::from_fn(width, width / 2, |direction| {
        let height = direction.y as f32;
        let base = if height > 0.0 {
            Vec3::new(0.3, 0.5, 1.0) * (1.2 - height)
        } else {
            Vec3::new(0.2, 0.15, 0.1)
        };
        let waves = (9.0 * direction.x + 5.0 * (4.0 * direction.z).sin()).sin()
            * (7.0 * direction.y + 3.0 * direction.z).cos();
        let cloud = 3.0 * ((waves as f32) - 0.4).max(0.0) * height.max(0.0);
        let distance = direction.angle_between(lamp);
        let glow = 400.0 * (-(distance / 0.06).powi(2)).exp() as f32;
        base + Vec3::splat(cloud) + Vec3::new(1.0, 0.9, 0.7) * glow
    })
}

fn options(n: usize) -> Options {
    Options {
        directions: n,
        ..Options::default()
    }
}

fn rule_of(image: &Environment, n: usize) -> Outcome<Rule> {
    let sky = sky::build(image, &options(n), &|_| true)?;
    Ok(sky.sets.into_iter().next().ok_or("a rule")?)
}

/// Largest ‖B‖ and decentration over N; returns the number of bright regions.
fn figure_3(name: &str, image: &Environment, directory: Option<&Path>) -> Outcome<usize> {
    println!("  {name}");
    println!("     N   largest ‖B‖: incremental    plain   decentration: incremental    plain");
    let mut rows = Vec::new();
    for n in NUMBERS {
        let rule = rule_of(image, n)?;
        let total = rule.fluence().element_sum();
        let (mut largest, mut decentration) = (0.0, 0.0_f64);
        for seed in 0..SEEDS {
            let plain = sky::plain(image, &options(n), seed)?;
            largest += plain.largest() / total / SEEDS as f64;
            decentration = decentration.max(plain.decentration);
        }
        let row = [
            rule.largest() / total,
            largest,
            rule.decentration,
            decentration,
        ];
        println!(
            "  {n:4} {:26.5} {:8.5} {:27.5} {:8.5}",
            row[0], row[1], row[2], row[3]
        );
        rows.push(row);
    }
    let column = |k: usize| -> Vec<(f64, f64)> {
        NUMBERS
            .iter()
            .zip(&rows)
            .map(|(&n, row)| (n as f64, row[k]))
            .collect()
    };
    let slopes = [0, 1].map(|k| slope(&column(k)));
    println!(
        "  slope over all N: incremental {:.3}, plain {:.3}",
        slopes[0], slopes[1]
    );
    if let Some(directory) = directory {
        let ideal: Vec<(f64, f64)> = NUMBERS
            .iter()
            .map(|&n| (n as f64, 1.0 / n as f64))
            .collect();
        plot(
            &directory.join(format!("{}.svg", name.replace(' ', "_"))),
            &format!("{name}: largest ‖B‖ over N"),
            &[
                ("incremental", RED, &column(0)),
                ("plain", BLUE, &column(1)),
                ("1/N", BLACK, &ideal),
            ],
        )?;
    }
    Ok(sky::split_bright(&mut image.clone()).len())
}

fn figure_5(name: &str, image: &Environment, directory: Option<&Path>) -> Outcome<()> {
    let options = Options {
        directions: 32,
        sets: 4,
        iterations: 16,
        ..Options::default()
    };
    let Sky { quality, sets, .. } = sky::build(image, &options, &|_| true)?;
    let total = sets[0].fluence().element_sum();
    println!("  interleaved, M = 4, N = 32");
    println!("     k   decentration: separate composite   largest ‖B‖: separate composite");
    for (k, at) in quality.iter().enumerate() {
        println!(
            "  {k:4} {:24.5} {:9.5} {:23.5} {:9.5}",
            at.separate_decentration,
            at.composite_decentration,
            at.separate_largest / total,
            at.composite_largest / total
        );
    }
    let Some(directory) = directory else {
        return Ok(());
    };
    let line = |value: fn(&sky::Quality) -> f64, scale: f64| -> Vec<(f64, f64)> {
        (1..)
            .zip(&quality)
            .map(|(k, at)| (f64::from(k), value(at) * scale))
            .collect()
    };
    plot(
        &directory.join(format!("{}_interleaved.svg", name.replace(' ', "_"))),
        &format!("{name}: interleaved rules over k + 1"),
        &[
            (
                "decentration, separate",
                RED,
                &line(|at| at.separate_decentration, 1.0),
            ),
            (
                "decentration, composite",
                RGBColor(128, 0, 0),
                &line(|at| at.composite_decentration, 1.0),
            ),
            (
                "largest ‖B‖, separate",
                BLUE,
                &line(|at| at.separate_largest, 1.0 / total),
            ),
            (
                "largest ‖B‖, composite",
                RGBColor(0, 0, 128),
                &line(|at| at.composite_largest, 1.0 / total),
            ),
        ],
    )
}

fn times() -> Outcome<()> {
    println!("\nseconds on {} threads", rayon_threads());
    for (n, width) in [
        (64, 1024),
        (256, 1024),
        (1024, 1024),
        (1024, 2048),
        (256, 8192),
    ] {
        let image = procedural(width);
        let start = Instant::now();
        let rule = rule_of(&image, n)?;
        println!(
            "  N = {n:4} on {width:4} × {:4}: {:.2}   (decentration {:.4})",
            width / 2,
            start.elapsed().as_secs_f64(),
            rule.decentration
        );
    }
    Ok(())
}

fn rayon_threads() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Least squares in the logarithms.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let mean_x = logs.iter().map(|point| point.0).sum::<f64>() / n;
    let mean_y = logs.iter().map(|point| point.1).sum::<f64>() / n;
    let products: f64 = logs.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let squares: f64 = logs.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
    products / squares
}

/// Megabytes, where the system says so.
fn peak_memory() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes / 1024)
}

type Line<'a> = (&'a str, RGBColor, &'a [(f64, f64)]);

fn plot(path: &Path, title: &str, lines: &[Line<'_>]) -> Outcome<()> {
    let all = || lines.iter().flat_map(|line| line.2);
    let range = |value: fn(&(f64, f64)) -> f64| {
        let low = all()
            .map(value)
            .filter(|&v| v > 0.0)
            .fold(f64::INFINITY, f64::min);
        let high = all().map(value).fold(0.0, f64::max);
        low * 0.8..high * 1.25
    };
    let area = SVGBackend::new(path, (720, 480)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(30)
        .y_label_area_size(60)
        .build_cartesian_2d(range(|p| p.0).log_scale(), range(|p| p.1).log_scale())?;
    chart.configure_mesh().draw()?;
    for &(label, color, points) in lines {
        chart
            .draw_series(LineSeries::new(points.iter().copied(), &color))?
            .label(label)
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], color));
    }
    chart
        .configure_series_labels()
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK)
        .draw()?;
    area.present()?;
    Ok(())
}

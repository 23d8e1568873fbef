//! Skies: pictures are read as they are meant, rules keep all their light, cells cover the sphere.

#![expect(clippy::print_stdout, reason = "says what was skipped")]

use std::f64::consts::{FRAC_PI_2, PI};
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

use glam::{DMat3, DVec3, Vec3};
use lumel::Error;
use lumel::lights::sky::{self, Options, Rule, Sky};
use lumel::scene::{Environment, environment};
use tempfile::TempDir;

use crate::support::{self, Rng};

/// A sky with a soft lamp.
fn picture(width: u32, height: u32) -> Environment {
    let lamp = DVec3::new(0.6, 0.5, -0.3).normalize();
    Environment::from_fn(width, height, |direction| {
        let height = direction.y as f32;
        let cloud = ((9.0 * direction.x).sin() * (7.0 * direction.z).cos()).max(0.0) as f32;
        let glow = 200.0 * (-(direction.angle_between(lamp) / 0.1).powi(2)).exp() as f32;
        Vec3::new(0.2, 0.3, 0.5) * (1.2 + height) + Vec3::splat(cloud) + Vec3::splat(glow)
    })
}

fn options(directions: usize, sets: usize) -> Options {
    Options {
        directions,
        sets,
        ..Options::default()
    }
}

fn build(image: &Environment, options: &Options) -> Sky {
    sky::build(image, options, &|_| true).expect("valid options")
}

fn rule(image: &Environment, n: usize) -> Rule {
    build(image, &options(n, 1)).sets.remove(0)
}

/// ∫ L dω by the definition of a pixel's solid angle.
fn fluence(image: &Environment) -> DVec3 {
    let (width, height) = (f64::from(image.width()), f64::from(image.height()));
    (0..image.height())
        .map(|row| {
            let [top, bottom] =
                [f64::from(row), f64::from(row) + 1.0].map(|y| (PI * y / height).cos());
            let sum: DVec3 = image
                .row(row)
                .iter()
                .map(|pixel| DVec3::from_array(pixel.map(f64::from)))
                .sum();
            sum * (2.0 * PI / width * (top - bottom))
        })
        .sum()
}

/// Writes `bytes` to a file and opens it as a picture.
fn open(name: &str, bytes: &[u8]) -> Result<Environment, Error> {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("a file");
    Environment::open(&path)
}

fn hdr(header: &str, data: &[u8]) -> Vec<u8> {
    [header.as_bytes(), data].concat()
}

const HEADER: &str = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n";

#[test]
fn places_in_the_picture_are_those_of_the_viewers() {
    // three.js: u = atan2(z, x) / 2π + ½, v = asin(y) / π + ½ with v upwards.
    for (direction, u, v) in [
        (DVec3::X, 0.5, 0.5),
        (DVec3::Z, 0.75, 0.5),
        (DVec3::NEG_Z, 0.25, 0.5),
        (DVec3::Y, 0.5, 0.0),
        (DVec3::NEG_Y, 0.5, 1.0),
    ] {
        let place = Environment::place(direction);
        assert!((place.1 - v).abs() < 1e-15, "{direction}: {place:?}");
        assert!(
            direction.y != 0.0 || (place.0 - u).abs() < 1e-15,
            "{direction}: {place:?}"
        );
        assert!(Environment::direction(u, v).distance(direction) < 1e-15);
    }
    let mut rng = Rng::new(0);
    for _ in 0..1000 {
        let direction = rng.direction();
        let (u, v) = Environment::place(3.0 * direction);
        // The arc tangent of nearly the pole is good to 1e-16 / sin θ.
        assert!(Environment::direction(u, v).distance(direction) < 1e-12);
    }
}

#[test]
fn the_orientation_picture_reads_as_it_is_labelled() {
    let Some(folder) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let image = Environment::open(&folder.join("hdr/OrientationLatLong.exr")).expect("a picture");
    assert_eq!((image.width(), image.height()), (1024, 512));
    // On each face of a cube the picture has dark strokes from the centre along the positive axes, and letters elsewhere. Its centre is
    // labelled +Z, by OpenEXR's own convention, where ours is +X: turning it by −90° about Y makes the labels true.
    let picture_from_world = DMat3::from_rotation_y(FRAC_PI_2);
    for face in [DVec3::X, DVec3::NEG_X, DVec3::Z, DVec3::NEG_Z] {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            if face.dot(axis).abs() > 0.5 {
                continue;
            }
            let mean = |axis: DVec3| {
                (1..=10)
                    .map(|step| {
                        image.radiance(picture_from_world * (face + 0.03 * f64::from(step) * axis))
                            [1]
                    })
                    .sum::<f32>()
                    / 10.0
            };
            let (along, against) = (mean(axis), mean(-axis));
            assert!(
                along < 0.2 && against > 0.4,
                "{axis} on {face}: {along} and {against}"
            );
        }
    }
}

#[test]
fn every_shared_picture_loads() {
    let Some(folder) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    let mut n = 0;
    for entry in fs::read_dir(folder.join("hdr")).expect("pictures") {
        let path = entry.expect("a readable entry").path();
        let image = Environment::open(&path).expect("a picture");
        let sum = fluence(&image);
        assert!(
            sum.is_finite() && sum.min_element() > 0.0,
            "{}: {sum}",
            path.display()
        );
        let rule = rule(&image, 16);
        assert!(
            (rule.fluence() - sum).abs().cmple(1e-12 * sum).all(),
            "{}: {} instead of {sum}",
            path.display(),
            rule.fluence()
        );
        n += 1;
    }
    assert!(n >= 7, "only {n} pictures");
}

#[test]
fn radiance_files_of_every_kind_hold_the_same_pixels() {
    // 8 × 4, every pixel another.
    let pixel = |x: u8, y: u8| [x * 16 + 2, y * 32 + 3, 200, 129];
    let flat: Vec<u8> = (0..4)
        .flat_map(|y| (0..8).flat_map(move |x| pixel(x, y)))
        .collect();
    let reference = open("a.hdr", &hdr(&format!("{HEADER}-Y 4 +X 8\n"), &flat)).expect("flat");
    assert_eq!(
        reference.pixels()[0],
        [2.0, 3.0, 200.0].map(|value: f32| value / 128.0)
    );
    assert!(reference.warnings.is_empty(), "{:?}", reference.warnings);

    let mut packed = Vec::new();
    for y in 0..4 {
        packed.extend([2, 2, 0, 8]);
        for channel in 0..4 {
            if channel < 1 {
                packed.push(8);
                packed.extend((0..8).map(|x| pixel(x, y)[channel]));
            } else {
                // The others are constant along a row.
                packed.extend([128 + 5, pixel(0, y)[channel], 128 + 3, pixel(0, y)[channel]]);
            }
        }
    }
    let new = open("a.hdr", &hdr(&format!("{HEADER}-Y 4 +X 8\n"), &packed)).expect("run lengths");
    assert_eq!(new.pixels(), reference.pixels());

    let orders = [
        "-Y 4 -X 8",
        "+Y 4 +X 8",
        "+Y 4 -X 8",
        "+X 8 -Y 4",
        "-X 8 -Y 4",
        "+X 8 +Y 4",
        "-X 8 +Y 4",
    ];
    for order in orders {
        let (is_left, is_down) = (!order.contains("-X"), order.contains("-Y"));
        let x = |x: u8| if is_left { x } else { 7 - x };
        let y = |y: u8| if is_down { y } else { 3 - y };
        let data: Vec<u8> = if order.find('Y') < order.find('X') {
            (0..4)
                .flat_map(|b| (0..8).flat_map(move |a| pixel(x(a), y(b))))
                .collect()
        } else {
            (0..8)
                .flat_map(|a| (0..4).flat_map(move |b| pixel(x(a), y(b))))
                .collect()
        };
        let image = open("a.hdr", &hdr(&format!("{HEADER}{order}\n"), &data)).expect(order);
        assert_eq!(image.pixels(), reference.pixels(), "{order}");
    }

    // Old run lengths: 1 + 7, and 1 + (2 + 1 · 256) − 253 would be beyond the end.
    let old: Vec<u8> = (0..4)
        .flat_map(|y| [pixel(0, y), [1, 1, 1, 7]].concat())
        .collect();
    let old = open("a.hdr", &hdr(&format!("{HEADER}-Y 4 +X 8\n"), &old)).expect("old run lengths");
    for row in 0..4 {
        assert_eq!(old.row(row), vec![reference.row(row)[0]; 8]);
    }

    let exposed =
        "#?RGBE\r\nEXPOSURE=2\nEXPOSURE=4\nCOLORCORR=1 2 4\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n";
    let exposed = open("a.hdr", &hdr(exposed, &flat)).expect("exposure");
    assert_eq!(
        exposed.pixels()[0],
        [2.0 / 8.0, 3.0 / 16.0, 200.0 / 32.0].map(|value: f32| value / 128.0)
    );
    assert_eq!(exposed.warnings.iter().count(), 2);
}

#[test]
fn flat_pixels_that_look_like_runs_stay_pixels() {
    let data = [[9, 9, 9, 130], [1, 1, 1, 128]].concat();
    let image = open("a.hdr", &hdr(&format!("{HEADER}-Y 1 +X 2\n"), &data)).expect("flat");
    assert_eq!(image.pixels()[1], [1.0 / 256.0; 3]);
}

#[test]
fn broken_pictures_are_named_with_place_and_limit() {
    let row = [9_u8, 9, 9, 130].repeat(16);
    for (bytes, words) in [
        (b"GIF89a".to_vec(), "neither"),
        (Vec::new(), "neither"),
        (
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n".to_vec(),
            "header: has no end",
        ),
        (b"#?RADIANCE\n\n".to_vec(), "size: is missing"),
        (hdr("#?RADIANCE\n", &[b' '; 70_000]), "header: has no end"),
        (
            hdr("#?RADIANCE\nFORMAT=16-bit\n\n-Y 1 +X 1\n", &row),
            "FORMAT",
        ),
        (
            hdr("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n", &row),
            "ra_xyze",
        ),
        (hdr(&format!("{HEADER}-Y 1\n"), &row), "must be like"),
        (hdr(&format!("{HEADER}-Y 1 +Y 1\n"), &row), "must be like"),
        (hdr(&format!("{HEADER}*Y 1 +X 1\n"), &row), "must be like"),
        (hdr(&format!("{HEADER}-Y 0 +X 1\n"), &row), "1 × 0"),
        (
            hdr(&format!("{HEADER}-Y 99999 +X 99999\n"), &row),
            "33554432",
        ),
        (
            hdr(&format!("{HEADER}-Y 18446744073709551615 +X 2\n"), &row),
            "33554432",
        ),
        (
            hdr(&format!("{HEADER}-Y 99999999999999999999 +X 2\n"), &row),
            "must be like",
        ),
        // A promise of 33 million pixels in 64 bytes.
        (
            hdr(&format!("{HEADER}-Y 4096 +X 8192\n"), &row),
            "scan line 0: ends early",
        ),
        (
            hdr(&format!("{HEADER}-Y 3 +X 8\n"), &row),
            "scan line 2: ends early",
        ),
        (
            hdr(&format!("{HEADER}-Y 1 +X 8\n"), &[2, 2, 0, 8, 200]),
            "beyond its end",
        ),
        (
            hdr(&format!("{HEADER}-Y 1 +X 8\n"), &[2, 2, 0, 8, 0]),
            "no length",
        ),
        (
            hdr(&format!("{HEADER}-Y 1 +X 8\n"), &[2, 2, 0, 8, 8, 1]),
            "ends early",
        ),
        (
            hdr(&format!("{HEADER}-Y 1 +X 8\n"), &[1, 1, 1, 8]),
            "before the first",
        ),
        (
            hdr(&format!("{HEADER}-Y 1 +X 8\n"), &[5, 5, 5, 5, 1, 1, 1, 9]),
            "beyond its end",
        ),
        (b"\x76\x2f\x31\x01".to_vec(), "header"),
        (b"\x76\x2f\x31\x01\x02\0\0\0channels\0".to_vec(), "header"),
    ] {
        let error = open("a.hdr", &bytes).expect_err(words).to_string();
        assert!(
            error.contains(words) && error.contains("a.hdr"),
            "{words}: {error}"
        );
    }
    assert!(matches!(
        Environment::open("no/such.hdr".as_ref()),
        Err(Error::Io { .. })
    ));
}

#[test]
fn mutilated_pictures_never_panic() {
    let Some(folder) = support::shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    for name in ["OrientationLatLong.exr", "old-rle.hdr", "scale.hdr"] {
        let bytes = fs::read(folder.join("hdr").join(name)).expect("a picture");
        for case in 0..60 {
            let mut rng = Rng::new(case);
            let mut bytes = bytes.clone();
            // Headers are where the promises are.
            let reach = if case % 2 == 0 { 400 } else { bytes.len() };
            for _ in 0..1 + case % 5 {
                let place = (rng.unit() * reach as f64) as usize;
                bytes[place] = rng.bits() as u8;
            }
            if case % 7 == 0 {
                bytes.truncate((rng.unit() * bytes.len() as f64) as usize);
            }
            if let Ok(image) = open(name, &bytes) {
                assert!(
                    image
                        .pixels()
                        .iter()
                        .flatten()
                        .all(|value| value.is_finite())
                );
            }
        }
    }
}

#[test]
fn what_is_no_radiance_becomes_black_and_is_counted() {
    let image = Environment::from_fn(5, 2, |direction| match Environment::place(direction) {
        (u, _) if u < 0.2 => Vec3::new(f32::NAN, 1.0, f32::INFINITY),
        (u, _) if u < 0.4 => Vec3::new(-1.0, 2.0, -0.0),
        _ => Vec3::ONE,
    });
    assert_eq!(image.pixels()[0], [0.0, 1.0, 0.0]);
    assert_eq!(image.pixels()[1][..2], [0.0, 2.0]);
    let counts: Vec<usize> = image.warnings.iter().map(|warning| warning.count).collect();
    // Aspect, not a number, infinite, negative.
    assert_eq!(counts, [1, 2, 2, 2], "{:?}", image.warnings);
}

#[test]
fn rules_keep_all_light_and_cover_the_sphere() {
    for (width, height) in [(128, 64), (97, 31), (16, 16), (1, 1), (3, 200)] {
        let image = picture(width, height);
        let sum = fluence(&image);
        for n in [1, 2, 3, 50] {
            let rule = rule(&image, n);
            let what = format!("{width} × {height}, N = {n}");
            assert_eq!(rule.cells.len(), n, "{what}");
            assert!(
                (rule.fluence() - sum).abs().cmple(1e-12 * sum).all(),
                "{what}: {} instead of {sum}",
                rule.fluence()
            );
            let area: f64 = rule.cells.iter().map(|cell| cell.solid_angle).sum();
            assert!((area / (4.0 * PI) - 1.0).abs() < 1e-12, "{what}: {area}");
            for cell in &rule.cells {
                assert!(cell.direction.is_normalized(), "{what}");
                for (channel, vector) in cell.light_vector.iter().enumerate() {
                    assert!(
                        vector.length() <= cell.fluence[channel] * (1.0 + 1e-12),
                        "{what}: {vector} of {}",
                        cell.fluence
                    );
                }
            }
        }
    }
}

#[test]
fn light_vectors_add_up_to_the_picture_s_own() {
    // L = 1 + x + 2 y + 3 z: ∫ L ω dω = 4π/3 (1, 2, 3). The picture is constant per pixel, so the sum is off by the square of its size.
    let width = 512;
    let image = Environment::from_fn(width, width / 2, |d| {
        Vec3::splat((4.0 + d.x + 2.0 * d.y + 3.0 * d.z.max(-1.0)) as f32)
    });
    let rule = rule(&image, 20);
    let sum: DVec3 = rule.cells.iter().map(|cell| cell.light_vector[1]).sum();
    let exact = DVec3::new(1.0, 2.0, 3.0) * (4.0 * PI / 3.0);
    assert!(sum.distance(exact) < 1e-3, "{sum} instead of {exact}");
    // Irradiance of the upper hemisphere of a uniform sky is π.
    let above = build(
        &Environment::from_fn(64, 32, |d| if d.y > 0.0 { Vec3::ONE } else { Vec3::ZERO }),
        &options(7, 1),
    );
    let up: f64 = above.sets[0]
        .cells
        .iter()
        .map(|cell| cell.light_vector[0].y)
        .sum();
    assert!((up - PI).abs() < 1e-12, "{up}");
}

#[test]
fn rules_do_not_depend_on_the_number_of_threads() {
    let image = picture(256, 128);
    let options = Options {
        split_bright: true,
        ..options(24, 3)
    };
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        sky::to_json(&pool.install(|| build(&image, &options)))
    };
    let one = with(1);
    for threads in [2, 5] {
        assert!(one == with(threads), "{threads} threads differ");
    }
}

#[test]
fn the_directions_are_centred_and_share_the_light() {
    let image = picture(256, 128);
    let mut largest = Vec::new();
    for n in [32, 256] {
        let rule = rule(&image, n);
        assert!(rule.decentration <= Options::default().max_decentration);
        let plain = sky::plain(&image, &options(n, 1), 1).expect("valid options");
        assert!(plain.decentration <= Options::default().max_decentration);
        assert!(
            rule.largest() < 0.6 * plain.largest(),
            "{} {}",
            rule.largest(),
            plain.largest()
        );
        largest.push(rule.largest());
    }
    // Eight times the directions, at least 8^0.9 times smaller.
    assert!(largest[0] / largest[1] > 8.0_f64.powf(0.9), "{largest:?}");
}

#[test]
fn degenerate_pictures_have_an_answer() {
    let black = Environment::from_fn(64, 32, |_| Vec3::ZERO);
    let rule_of_black = rule(&black, 100);
    assert_eq!(rule_of_black.cells.len(), 1);
    assert_eq!(rule_of_black.fluence(), DVec3::ZERO);
    assert!((rule_of_black.cells[0].solid_angle - 4.0 * PI).abs() < 1e-12);

    let mut dot = black.clone();
    dot.set(40, 10, [1e30, 0.0, 0.0]);
    for n in [1, 2, 100, 1000] {
        let rule = rule(&dot, n);
        assert_eq!(rule.cells.len(), n);
        let share = rule.largest() / rule.fluence().element_sum();
        assert!(share * n as f64 <= 2.0, "N = {n}: {share}");
    }

    let uniform = Environment::constant(Vec3::new(1.0, 2.0, 3.0));
    for n in [1, 2, 64] {
        let rule = rule(&uniform, n);
        let share = rule.largest() / rule.fluence().element_sum();
        assert!(share * n as f64 <= 1.5, "N = {n}: {share}");
    }

    let huge = Environment::constant(Vec3::MAX);
    let sum = rule(&huge, 10).fluence();
    assert!(
        (sum.x / (4.0 * PI * f64::from(f32::MAX)) - 1.0).abs() < 1e-12,
        "{sum}"
    );
    let tiny = Environment::constant(Vec3::splat(f32::from_bits(1)));
    assert_eq!(rule(&tiny, 10).cells.len(), 10);
}

#[test]
fn options_out_of_range_are_refused() {
    for (options, name) in [
        (options(0, 1), "directions"),
        (options(4097, 1), "directions"),
        (options(64, 0), "sets"),
        (options(64, 65), "sets"),
        (
            Options {
                iterations: 1001,
                ..Options::default()
            },
            "iterations",
        ),
        (
            Options {
                max_decentration: f64::NAN,
                ..Options::default()
            },
            "max-decentration",
        ),
    ] {
        match sky::build(&picture(8, 4), &options, &|_| true) {
            Err(Error::InvalidOption { option, .. }) => assert_eq!(option, name),
            other => panic!("{name}: {other:?}"),
        }
    }
    let stopped = sky::build(&picture(64, 32), &options(64, 1), &|n| n < 10);
    assert!(matches!(stopped, Err(Error::Interrupted)), "{stopped:?}");
}

#[test]
fn interleaved_sets_are_rules_each_and_together() {
    let image = picture(256, 128);
    let sky = build(&image, &options(16, 4));
    let sum = fluence(&image);
    assert_eq!(sky.sets.len(), 4);
    assert_eq!(sky.quality.len(), 5);
    let composite = sky.composite.expect("several sets");
    for rule in sky.sets.iter().chain([&composite]) {
        assert!((rule.fluence() - sum).abs().cmple(1e-12 * sum).all());
    }
    for (index, cell) in composite.cells.iter().enumerate() {
        assert_eq!(
            cell.direction,
            sky.sets[index / 16].cells[index % 16].direction
        );
    }
    // Figure 5: the composite becomes a rule of its own, at some cost to the sets. How much of either depends on the picture; these
    // bounds were kept by all pictures that were tried.
    let (first, last) = (sky.quality[0], sky.quality[4]);
    assert!(
        last.composite_decentration < 0.75 * first.composite_decentration,
        "{first:?} {last:?}"
    );
    assert!(
        last.separate_largest < 2.0 * first.separate_largest,
        "{first:?} {last:?}"
    );
    assert!(
        last.composite_largest < last.separate_largest,
        "{first:?} {last:?}"
    );
}

#[test]
fn every_pixel_is_in_the_cell_of_its_nearest_direction() {
    let (width, height) = (128, 64);
    // So even that no pixel is cut into pieces.
    let image = Environment::from_fn(width, height, |d| {
        Vec3::new(
            1.5 + d.x as f32,
            1.5 + d.y as f32,
            1.5 + (3.0 * d.z).sin() as f32,
        )
    });
    let rule = rule(&image, 30);
    let mut areas = vec![0.0; 30];
    let mut sums = vec![DVec3::ZERO; 30];
    let edge = |row: u32| (PI * f64::from(row) / f64::from(height)).cos();
    for row in 0..height {
        for (column, pixel) in (0..).zip(image.row(row)) {
            let place = [(column, width), (row, height)]
                .map(|(at, of): (u32, u32)| (f64::from(at) + 0.5) / f64::from(of));
            let direction = Environment::direction(place[0], place[1]);
            let area = 2.0 * PI / f64::from(width) * (edge(row) - edge(row + 1));
            let cell = nearest(&rule.directions(), direction);
            areas[cell] += area;
            sums[cell] += area * f64::from(pixel.iter().sum::<f32>()) * direction;
        }
    }
    for ((cell, area), sum) in rule.cells.iter().zip(areas).zip(sums) {
        assert!(
            (cell.solid_angle - area).abs() < 1e-12,
            "{} instead of {area}",
            cell.solid_angle
        );
        // Pixels' centres stand for their moments here: off by a part of a pixel's square.
        let miss = cell.direction.angle_between(sum.normalize());
        assert!(
            miss <= rule.decentration + 1e-3,
            "{miss} instead of {}",
            rule.decentration
        );
    }
}

#[test]
fn perturbed_directions_stay_in_their_cells() {
    let rule = rule(&picture(128, 64), 60);
    let mut rng = Rng::new(3);
    for (index, (cell, radius)) in rule.cells.iter().zip(rule.cap_radii()).enumerate() {
        assert!(radius > 0.0 && radius < FRAC_PI_2);
        for _ in 0..20 {
            let direction = cell.perturbed(radius, [rng.unit(), rng.unit()]);
            assert_eq!(nearest(&rule.directions(), direction), index);
        }
    }
    assert_eq!(self::rule(&picture(8, 4), 1).cap_radii(), [PI]);
}

fn nearest(directions: &[DVec3], direction: DVec3) -> usize {
    (0..directions.len())
        .max_by(|&a, &b| {
            directions[a]
                .dot(direction)
                .total_cmp(&directions[b].dot(direction))
        })
        .expect("directions")
}

#[test]
fn turning_by_a_quarter_turns_everything() {
    let sky = build(&picture(64, 32), &options(9, 1));
    let turned = sky.sets[0].turned(FRAC_PI_2, 2.0);
    for (cell, turned) in sky.sets[0].cells.iter().zip(&turned.cells) {
        // Counter-clockwise from above: +X goes to −Z. The cosine of π/2 is 6e-17.
        let quarter = |v: DVec3| DVec3::new(v.z, v.y, -v.x);
        assert!(turned.direction.distance(quarter(cell.direction)) < 1e-15);
        assert_eq!(turned.fluence, 2.0 * cell.fluence);
        for (vector, turned) in cell.light_vector.iter().zip(turned.light_vector) {
            assert!(turned.distance(2.0 * quarter(*vector)) <= 1e-15 * cell.fluence.max_element());
        }
    }
}

#[test]
fn outlines_cover_the_sphere_and_nothing_twice() {
    let mut sets: Vec<Vec<DVec3>> = vec![
        vec![DVec3::Y],
        vec![DVec3::Y, DVec3::NEG_Y],
        vec![DVec3::X, DVec3::new(0.9, 0.1, 0.0).normalize()],
        vec![DVec3::X, DVec3::Y, DVec3::Z],
        // On one circle: lunes.
        (0..7)
            .map(|k| DVec3::from_array([f64::from(k).cos(), 0.0, f64::from(k).sin()]))
            .collect(),
        // A cube's corners and faces: four and more on one circle everywhere.
        (0..8)
            .map(|k| {
                DVec3::new(
                    f64::from(k & 1) - 0.5,
                    f64::from(k >> 1 & 1) - 0.5,
                    f64::from(k >> 2) - 0.5,
                )
                .normalize()
            })
            .collect(),
        vec![
            DVec3::X,
            DVec3::NEG_X,
            DVec3::Y,
            DVec3::NEG_Y,
            DVec3::Z,
            DVec3::NEG_Z,
        ],
        // Some twice.
        vec![DVec3::X, DVec3::X, DVec3::Y, DVec3::X, DVec3::NEG_Z],
    ];
    for seed in 0..6 {
        let mut rng = Rng::new(seed);
        let n = [4, 5, 30, 200, 1000, 60][seed as usize];
        let mut set: Vec<DVec3> = (0..n).map(|_| rng.direction()).collect();
        if seed == 5 {
            // All within a sun, but one.
            set = set
                .iter()
                .map(|d| (DVec3::X + 1e-4 * *d).normalize())
                .collect();
            set.push(DVec3::Z);
        }
        sets.push(set);
    }
    for (case, set) in sets.iter().enumerate() {
        let outlines = sky::cells(set);
        let area: f64 = outlines.iter().map(|outline| outline.solid_angle).sum();
        assert!((area - 4.0 * PI).abs() < 1e-10, "case {case}: {area}");
        let mut rng = Rng::new(100 + case as u64);
        for (index, outline) in outlines.iter().enumerate() {
            let n = outline.vertices.len();
            assert_eq!(outline.neighbours.len(), n);
            for k in 0..n {
                let (a, b) = (outline.vertices[k], outline.vertices[(k + 1) % n]);
                assert!(a.is_normalized() && a.angle_between(b) < 2.1, "case {case}");
                // The side lies on the border with the neighbour it names.
                let other = set[outline.neighbours[k] as usize];
                let middle = (a + b).normalize();
                let off = (middle.dot(set[index]) - middle.dot(other)) / set[index].distance(other);
                assert!(off.abs() < 1e-7, "case {case}: {off:e}");
            }
        }
        for _ in 0..300 {
            let direction = if case == 13 && rng.unit() < 0.5 {
                (DVec3::X + 1e-4 * rng.direction()).normalize()
            } else {
                rng.direction()
            };
            let at = outlines.iter().position(|outline| {
                outline.vertices.is_empty() && outline.solid_angle > 0.0
                    || contains(&outline.vertices, direction)
            });
            let at = at.expect("some cell");
            let best = nearest(set, direction);
            let gap = set[best].dot(direction) - set[at].dot(direction);
            assert!(gap <= 1e-13, "case {case}: {at} instead of {best}, {gap:e}");
        }
    }
}

/// Whether a direction is in a convex polygon that is counter-clockwise seen from the origin.
fn contains(polygon: &[DVec3], direction: DVec3) -> bool {
    !polygon.is_empty()
        && polygon
            .iter()
            .zip(polygon.iter().cycle().skip(1))
            .all(|(a, b)| b.cross(*a).dot(direction) >= -1e-14)
}

#[test]
fn outlines_have_the_areas_of_their_pixels() {
    let image = picture(512, 256);
    let rule = rule(&image, 40);
    for (cell, outline) in rule.cells.iter().zip(sky::cells(&rule.directions())) {
        // Pixels of the border are right on average: off by the root of their number times half their size.
        let pixel = (2.0 * PI / 512.0_f64).powi(2);
        let border = 2.0 * (PI * cell.solid_angle).sqrt() / pixel.sqrt();
        assert!(
            (cell.solid_angle - outline.solid_angle).abs() < 3.0 * pixel * border.sqrt(),
            "{} and {}",
            cell.solid_angle,
            outline.solid_angle
        );
    }
}

#[test]
fn a_sun_becomes_a_polygon_and_no_light_is_lost() {
    for (width, axis) in [
        (512, DVec3::new(0.5, 0.7, 0.2)),
        (1024, DVec3::new(-1.0, 0.3, 1e-3)),
        (256, DVec3::new(0.01, 1.0, 0.0)),
    ] {
        let axis = axis.normalize();
        let radius = 0.02_f64;
        let mut image = Environment::from_fn(width, width / 2, |direction| {
            let is_sun = direction.angle_between(axis) < radius;
            Vec3::new(0.3, 0.5, 1.0) + if is_sun { Vec3::splat(1e4) } else { Vec3::ZERO }
        });
        let before = fluence(&image);
        let vector = rule(&image, 1).cells[0].light_vector;
        let regions = sky::split_bright(&mut image);
        assert_eq!(regions.len(), 1, "{width}");
        let region = &regions[0];
        let after = fluence(&image) + region.cell.fluence;
        assert!(
            (after / before - 1.0).abs().max_element() < 1e-6,
            "{before} {after}"
        );
        let rest = rule(&image, 1).cells[0].light_vector;
        for channel in 0..3 {
            let after = rest[channel] + region.cell.light_vector[channel];
            assert!(after.distance(vector[channel]) < 1e-6 * before[channel]);
        }
        // As wide as it was drawn, to the pixel.
        let pixel = 2.0 * PI / f64::from(width);
        assert!(region.cell.direction.angle_between(axis) < pixel, "{width}");
        let wide = (region.cell.solid_angle / PI).sqrt();
        assert!((wide - radius).abs() < 0.5 * pixel, "{width}: {wide}");
        assert!(contains(&region.polygon, region.cell.direction), "{width}");
        assert!(
            (region.radiance * region.cell.solid_angle).distance(region.cell.fluence)
                < 1e-9 * region.cell.norm()
        );
        assert!(
            image.pixels().iter().flatten().all(|&value| value < 2.0),
            "{width}: some of it is left"
        );
        assert!(sky::split_bright(&mut image).is_empty());
    }
    assert!(
        sky::split_bright(&mut picture(256, 128)).is_empty(),
        "a soft lamp is no sun"
    );
}

#[test]
fn a_stored_sky_comes_back_to_the_bit_or_not_at_all() {
    let mut image = picture(64, 32);
    image.set(20, 8, [1e5, 9e4, 8e4]);
    let options = Options {
        split_bright: true,
        ..options(12, 2)
    };
    let sky = build(&image, &options);
    assert_eq!(sky.regions.len(), 1);
    let text = sky::to_json(&sky);
    assert_eq!(
        sky::load_if_fits(&text, image.hash(), &options).as_ref(),
        Some(&sky)
    );

    let other = Options {
        directions: 13,
        ..options.clone()
    };
    assert!(sky::load_if_fits(&text, image.hash(), &other).is_none());
    assert!(sky::load_if_fits(&text, image.hash() ^ 1, &options).is_none());
    assert!(sky::load_if_fits("", image.hash(), &options).is_none());
    assert!(sky::load_if_fits(&text[..text.len() / 2], image.hash(), &options).is_none());
    for (from, to) in [
        ("\"version\": 1", "\"version\": 2"),
        ("\"fluence\": [", "\"fluence\": [-"),
        ("\"direction\": [", "\"direction\": [1"),
    ] {
        let compact = text.replace("[\n", "[").replace("[          ", "[");
        let compact: String = compact
            .lines()
            .map(str::trim_start)
            .collect::<Vec<_>>()
            .join(" ")
            .replace("[ ", "[");
        assert!(sky::load_if_fits(&compact, image.hash(), &options).is_some());
        let broken = compact.replacen(from, to, 1);
        assert_ne!(broken, compact, "{from}");
        assert!(
            sky::load_if_fits(&broken, image.hash(), &options).is_none(),
            "{to}"
        );
    }
}

#[test]
fn a_picture_s_hash_is_of_its_pixels() {
    let image = picture(64, 32);
    let mut other = image.clone();
    assert_eq!(image.hash(), other.hash());
    other.set(5, 5, [0.1, 0.2, 0.3]);
    assert_ne!(image.hash(), other.hash());
    let [wide, high] = [(4, 2), (2, 4)].map(|(w, h)| Environment::from_fn(w, h, |_| Vec3::ONE));
    assert_ne!(wide.hash(), high.hash());
}

/// A picture on the disk, and a folder that goes with it.
fn stored_picture() -> (TempDir, PathBuf) {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("sky.hdr");
    let data: Vec<u8> = (0..32 * 16_u32)
        .flat_map(|i| [i as u8, (i / 3) as u8, 40, 128])
        .collect();
    fs::write(&path, hdr(&format!("{HEADER}-Y 16 +X 32\n"), &data)).expect("a file");
    (folder, path)
}

fn lumel(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lumel"))
        .args(arguments)
        .output()
        .expect("the command")
}

#[test]
fn the_command_stores_a_rule_beside_the_picture_and_finds_it_again() {
    let (folder, path) = stored_picture();
    let path = path.to_str().expect("a plain name");
    let run = |more: &[&str]| {
        let output = lumel(&[&["sky", path, "-n", "20", "--json"], more].concat());
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("JSON")
    };
    assert_eq!(run(&[])["reused"], false);
    let target = folder.path().join("sky.hdr.sky.json");
    assert_eq!(target, environment::rule_path(path.as_ref()));
    let text = environment::read_rule(path.as_ref()).expect("a stored rule");
    let image = Environment::open(path.as_ref()).expect("a picture");
    let sky = sky::load_if_fits(&text, image.hash(), &options(20, 1)).expect("that fits");
    assert_eq!(sky, build(&image, &options(20, 1)));
    assert_eq!(run(&[])["reused"], true);
    assert_eq!(run(&["-m", "2"])["reused"], false);
    assert_eq!(
        fs::read_dir(folder.path()).expect("a folder").count(),
        2,
        "something is left behind"
    );
    let output = lumel(&["sky", path, "-n", "8"]);
    let shown = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(shown.contains("8 directions"), "{shown}");
}

#[test]
fn the_command_says_what_is_wrong() {
    let (_folder, path) = stored_picture();
    let path = path.to_str().expect("a plain name");
    for (arguments, code, words) in [
        (&["sky"] as &[&str], 2, "FILE"),
        (&["sky", path, "-n", "0"], 2, "1..=4096"),
        (&["sky", path, "-n", "64", "-m", "65"], 2, "1..=64"),
        (&["sky", "no/such.hdr"], 1, "such.hdr"),
        (&["sky", path, "-o", "no/such/rule.json"], 1, "rule.json"),
    ] {
        let output = lumel(arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
    let help = lumel(&["sky", "--help"]);
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    for word in ["-n", "-m", "--split-bright", ".sky.json", "+X", "Examples"] {
        assert!(help.contains(word), "{word} is missing from:\n{help}");
    }
}

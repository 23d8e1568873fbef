//! The layouts of engines, evaluated with each engine's own formula on what was written.

#![expect(clippy::print_stdout, reason = "the rounding is a figure to report")]

use std::f64::consts::PI;
use std::path::Path;

use glam::DVec3;
use lumel::output::{Export, Options, PageFiles};
use lumel::refine::{Field, Plane};

use crate::output::maps;
use crate::support::Rng;

const WIDTH: u32 = 40;
const HEIGHT: u32 = 30;

/// Light of one texel in f64, as its planes hold it.
struct Light {
    normal: DVec3,
    /// By colour channel.
    g: [DVec3; 3],
    phi: [f64; 3],
}

/// Texels of a page with light from the front of random normals: one light, many, or a sky; a dark one now and then.
fn lights() -> Vec<Light> {
    (0..u64::from(WIDTH * HEIGHT))
        .map(|case| {
            let mut rng = Rng::new(case);
            let normal = rng.direction();
            let mut g = [DVec3::ZERO; 3];
            let mut phi = [0.0; 3];
            let n_lights = case % 6;
            for _ in 0..n_lights {
                let towards = rng.direction();
                let towards = towards * towards.dot(normal).signum();
                for channel in 0..3 {
                    let strength = 100.0 * rng.unit();
                    g[channel] += towards * strength;
                    phi[channel] += strength;
                }
            }
            // As stored: what comes behind is compared with numbers that were floats.
            Light {
                normal,
                g: g.map(|g| g.as_vec3().as_dvec3()),
                phi: phi.map(|phi| f64::from(phi as f32)),
            }
        })
        .collect()
}

fn field(lights: &[Light]) -> Field {
    let plane = |name, values: &dyn Fn(&Light) -> [f64; 3]| Plane {
        name,
        components: 3,
        values: lights
            .iter()
            .flat_map(values)
            .map(|value| value as f32)
            .collect(),
    };
    Field {
        width: WIDTH,
        height: HEIGHT,
        places: (0..HEIGHT as u16)
            .flat_map(|y| (0..WIDTH as u16).map(move |x| [x, y]))
            .collect(),
        planes: vec![
            plane("E", &|light| light.g.map(|g| g.dot(light.normal))),
            plane("Gr", &|light| light.g[0].to_array()),
            plane("Gg", &|light| light.g[1].to_array()),
            plane("Gb", &|light| light.g[2].to_array()),
            plane("phi", &|light| light.phi),
        ],
    }
}

/// Pixels of a picture, row by row; PNG as numbers in 0..=1.
fn pixels(directory: &Path, page: &PageFiles, name: &str) -> Vec<[f64; 4]> {
    let map = page.exports.iter().find(|map| map.plane == name);
    let path = directory.join(&map.expect("the picture was written").file);
    if path.extension().is_some_and(|ending| ending == "png") {
        let picture = image::open(path).expect("a PNG").to_rgba16();
        return picture
            .pixels()
            .map(|pixel| pixel.0.map(|value| f64::from(value) / 65535.0))
            .collect();
    }
    let channels = maps::channels(&path);
    let [b, g, r] = [0, 1, 2].map(|k| channels[k].1.values_as_f32().collect::<Vec<f32>>());
    (0..r.len())
        .map(|at| [r[at], g[at], b[at], 1.0].map(f64::from))
        .collect()
}

/// Writes `export` of the test's page.
fn written(export: Export) -> (Vec<Light>, PageFiles, tempfile::TempDir) {
    let lights = lights();
    let folder = tempfile::tempdir().expect("temporary folder");
    let options = Options {
        exports: vec![export],
        ..Options::default()
    };
    let page = maps::write(folder.path(), &field(&lights), &options);
    assert_eq!(page.width, WIDTH);
    assert!(page.exports.iter().all(|map| map.precision != "float"));
    (lights, page, folder)
}

/// Compares what the engine shows, `shown(texel, normal)` in E/π by channel, with `wanted(light, channel, normal)` in E, at eight normals per
/// texel. Fails where they differ by more than `tolerance(light, channel, normal)`. Prints the error as share of the mean.
fn compare(
    name: &str,
    lights: &[Light],
    shown: impl Fn(usize, DVec3) -> [f64; 3],
    wanted: impl Fn(&Light, usize, DVec3) -> f64,
    tolerance: impl Fn(&Light, usize, DVec3) -> f64,
) {
    let mut rng = Rng::new(1);
    let [mut n_values, mut sum, mut squares, mut worst] = [0.0_f64; 4];
    for (texel, light) in lights.iter().enumerate() {
        for index in 0..8 {
            let n = if index == 0 {
                light.normal
            } else {
                rng.direction()
            };
            let shown = shown(texel, n);
            for (channel, shown) in shown.into_iter().enumerate() {
                let got = PI * shown;
                let want = wanted(light, channel, n);
                let error = (got - want).abs();
                assert!(
                    error <= tolerance(light, channel, n),
                    "{name}: texel {texel}, channel {channel}, normal {n}: {got} for {want}"
                );
                n_values += 1.0;
                sum += want;
                squares += error * error;
                worst = worst.max(error);
            }
        }
    }
    let mean = sum / n_values;
    println!(
        "{name}: rounding rms {:.4} %, worst {:.3} % of the mean",
        100.0 * (squares / n_values).sqrt() / mean,
        100.0 * worst / mean
    );
}

/// What linear spherical harmonics of first order show: a quarter of φ and half of G·n.
fn linear(light: &Light, channel: usize, n: DVec3) -> f64 {
    0.25 * light.phi[channel] + 0.5 * light.g[channel].dot(n)
}

/// Rounding of L0 by a half, and of three numbers in 0..=1 that are multiplied with `factor` · L0.
fn rounding(light: &Light, channel: usize, n: DVec3, factor: f64) -> f64 {
    let half = 0.5_f64.powi(11);
    let l0 = 0.25 * light.phi[channel];
    // L0 scales all of it; numbers up to 1 are rounded by up to a quarter of a thousandth.
    let spread = n.abs().element_sum() * factor * l0 * half / 2.0;
    half * (l0 + 0.5 * light.g[channel].length()) + spread + 1e-4
}

#[test]
fn bakery_shows_the_linear_part_of_the_light() {
    let (lights, page, folder) = written(Export::BakerySh);
    let names = ["L0", "L1x", "L1y", "L1z"].map(|part| format!("bakery_{part}"));
    let maps = names.map(|name| pixels(folder.path(), &page, &name));
    let shown = |texel: usize, n: DVec3| {
        // Unity's world is mirrored along x.
        let n = [-n.x, n.y, n.z];
        [0, 1, 2].map(|channel| {
            let l0 = maps[0][texel][channel];
            let l1 = [1, 2, 3].map(|map: usize| (maps[map][texel][channel] * 2.0 - 1.0) * l0 * 2.0);
            l0 + n[0] * l1[0] + n[1] * l1[1] + n[2] * l1[2]
        })
    };
    compare("bakery-sh", &lights, shown, linear, |light, channel, n| {
        rounding(light, channel, n, 4.0)
    });
}

#[test]
fn bakery_s_non_linear_formula_gets_numbers_that_it_can_take() {
    let (lights, page, folder) = written(Export::BakerySh);
    let names = ["L0", "L1x", "L1y", "L1z"].map(|part| format!("bakery_{part}"));
    let maps = names.map(|name| pixels(folder.path(), &page, &name));
    for (texel, light) in lights.iter().enumerate().filter(|(texel, _)| texel % 6 > 0) {
        for (channel, l0) in maps[0][texel].into_iter().take(3).enumerate() {
            let axis = |map: usize| (maps[map][texel][channel] * 2.0 - 1.0) * l0 * 2.0;
            let half_l1 = 0.5 * DVec3::new(axis(1), axis(2), axis(3));
            // A single light has |R1| = R0, the most there can be; rounding adds less than a thousandth.
            let ratio = half_l1.length() / l0;
            assert!(ratio <= 1.001, "texel {texel}: {ratio}");
            let want = light.g[channel].length() / light.phi[channel];
            assert!(
                (ratio - want).abs() < 2e-3,
                "texel {texel}: {ratio}, {want}"
            );
        }
    }
}

#[test]
fn godot_shows_the_linear_part_of_the_light() {
    let (lights, page, folder) = written(Export::GodotSh);
    let tall = pixels(folder.path(), &page, "godot");
    let n_texels = lights.len();
    assert_eq!(tall.len(), 4 * n_texels);
    let shown = |texel: usize, n: DVec3| {
        [0, 1, 2].map(|channel| {
            let slice = |index: usize| tall[index * n_texels + texel][channel];
            let l0 = slice(0);
            let l1 = |index: usize| (slice(index) - 0.5) * 2.0 * l0 * 4.0;
            l0 + l1(1) * n.y + l1(2) * n.z + l1(3) * n.x
        })
    };
    compare("godot-sh", &lights, shown, linear, |light, channel, n| {
        rounding(light, channel, n, 8.0)
    });
}

#[test]
fn unity_shows_the_irradiance_at_the_baked_normal_and_tilts_it_by_one_direction() {
    let (lights, page, folder) = written(Export::UnityDirectional);
    let color = pixels(folder.path(), &page, "unity_color");
    let direction = pixels(folder.path(), &page, "unity_dir");
    let shown = |texel: usize, n: DVec3| {
        let [x, y, z, w] = direction[texel];
        let n = DVec3::new(-n.x, n.y, n.z);
        let half_lambert = n.dot(DVec3::new(x, y, z) - 0.5) + 0.5;
        [0, 1, 2].map(|channel| color[texel][channel] * half_lambert / w.max(1e-4))
    };
    let wanted = |light: &Light, channel: usize, n: DVec3| {
        let luminance =
            |of: &dyn Fn(usize) -> DVec3| 0.2126 * of(0) + 0.7152 * of(1) + 0.0722 * of(2);
        let g = luminance(&|c| light.g[c]);
        let phi = luminance(&|c| DVec3::splat(light.phi[c])).x;
        let d = (2.0 * g / phi.max(1e-30)).clamp_length_max(1.0);
        let e = light.g[channel].dot(light.normal);
        e * (1.0 + d.dot(n)) / (1.0 + d.dot(light.normal))
    };
    // The colour is a half; bracket and w are right to 16 bits, and w is a half at least.
    compare(
        "unity-directional",
        &lights,
        shown,
        wanted,
        |light, c, _| {
            let e = light.g[c].dot(light.normal);
            2.0 * e * (0.5_f64.powi(11) + 2e-4) + 1e-4
        },
    );
}

#[test]
fn bevy_shows_the_irradiance() {
    let (lights, page, folder) = written(Export::Bevy);
    let map = pixels(folder.path(), &page, "bevy");
    compare(
        "bevy",
        &lights,
        |texel, _| [0, 1, 2].map(|channel| map[texel][channel]),
        |light, channel, _| light.g[channel].dot(light.normal),
        |light, c, _| light.g[c].dot(light.normal) * 0.5_f64.powi(11) * 1.01 + 1e-4,
    );
}

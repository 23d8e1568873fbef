//! Vedel's estimator against the exact contour.

use glam::{DMat3, DVec3};
use lumel::lights::{self, Lights};
use lumel::scene::{self, Scene};
use lumel::transport::{self, Estimator, Receiver, Sample, VedelOptions};
use lumel::visibility::Occluders;

use crate::support;

/// A square of the floor, `count` × `count` points in the middle of its cells.
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

fn fixture(name: &str) -> (Scene, Lights) {
    let path = support::fixture(name).join(format!("{name}.gltf"));
    let scene = scene::load(&path, &scene::Options::default()).expect("the fixture is valid");
    let lights = lights::collect(&scene, &lights::Options::default());
    (scene, lights)
}

fn options(estimator: Estimator, vedel: VedelOptions) -> transport::Options {
    transport::Options { estimator, vedel, ..transport::Options::default() }
}

struct Figures {
    av_dif: f64,
    rays: f64,
    active: usize,
    gradient: f64,
    gradient_median: f64,
    honest: f64,
    mean_ratio: f64,
    p999: f64,
}

fn figures(occluders: &Occluders<'_>, lights: &Lights, receivers: &[Receiver], vedel: &transport::Options) -> Figures {
    let exact = options(Estimator::Exact, VedelOptions::default());
    let (mut largest, mut sum, mut rays, mut active) = (0.0f64, 0.0, 0u64, 0);
    let (mut claimed, mut honest) = (0.0, 0usize);
    let mut gradients = Vec::new();
    let mut differences = Vec::new();
    let (mut g2, mut d2) = (0.0, 0.0);
    for receiver in receivers {
        let (got, counters) = transport::gather(&[*receiver], lights, occluders, vedel);
        let n = receiver.normal;
        let e = |sample: &Sample| sample.g[0].dot(n);
        largest = largest.max(e(&got[0]));
        if counters.pairs_unoccluded > 0 { continue; }
        let (want, _) = transport::gather(&[*receiver], lights, occluders, &exact);
        active += 1;
        rays += counters.shadow_rays;
        let d = (e(&got[0]) - e(&want[0])).abs();
        sum += d;
        differences.push(d);
        claimed += got[0].error;
        if d <= 3.0 * got[0].error { honest += 1; }
        let grad = |s: &Sample| { let g = s.j[0].transpose() * n; g - n * g.dot(n) };
        let (a, b) = (grad(&got[0]), grad(&want[0]));
        let visible = e(&want[0]);
        if visible > 1e-6 && got[0].has_gradient && want[0].has_gradient && a != b {
            gradients.push((a - b).length() / b.length());
            g2 += b.length_squared();
            d2 += (a - b).length_squared();
        }
    }
    gradients.sort_by(f64::total_cmp);
    differences.sort_by(f64::total_cmp);
    Figures {
        av_dif: sum / active as f64 * 255.0 / largest,
        rays: rays as f64 / active as f64,
        active,
        gradient: (d2 / g2 as f64).sqrt(),
        gradient_median: gradients.get(gradients.len() / 2).copied().unwrap_or(0.0),
        honest: honest as f64 / active as f64,
        mean_ratio: claimed / sum,
        p999: differences[(differences.len() as f64 * 0.999) as usize] * 255.0 / largest,
    }
}

#[test]
fn measure() {
    for (name, count, side) in [("penumbra", 64, 10.0), ("slab", 64, 10.0), ("leaves", 10, 8.0)] {
        let (scene, lights) = fixture(name);
        let occluders = Occluders::build(&scene);
        let receivers = floor(count, side);
        for (cells, steps, threshold) in [(2, 5, 1.0), (2, 5, 0.5), (2,5,0.25), (4, 5, 1.0), (8, 5, 0.5)] {
            for appendix in [false, true] {
                if appendix && (cells,threshold) != (2, 1.0) { continue; }
                let mut o = options(Estimator::Vedel, VedelOptions { cells, steps, threshold });
                o.appendix_derivative = appendix;
                let f = figures(&occluders, &lights, &receivers, &o);
                println!("{name} {cells} {steps} {threshold} {appendix}: act {} AvDif {:.3} p999 {:.2} rays {:.1} grad {:.3} ({:.3}) honest {:.4} ratio {:.2}", f.active, f.av_dif, f.p999, f.rays, f.gradient, f.gradient_median, f.honest, f.mean_ratio);
            }
        }
    }
    let _ = DMat3::ZERO;
}

//! Light from polygons: closed forms against extended precision, laws, and the estimators against closed forms.

mod extended;

use glam::{DMat3, DVec3};
use lumel::lights::Polygon;
use lumel::transport::{self, Receiver, Sums};

use self::extended::Dd;
use crate::support::Rng;

/// The parallelogram at `corner` with sides `u` and `v`, shining along u × v.
fn polygon([corner, u, v]: [DVec3; 3]) -> Polygon {
    let [a, b, c, d] = [corner, corner + u, corner + u + v, corner + v];
    let across = u.cross(v);
    Polygon {
        contours: vec![vec![a, b, c, d]],
        triangles: vec![[a, b, c], [a, c, d]],
        normal: across.normalize(),
        area: across.length(),
        radiance: DVec3::ONE,
        two_sided: false,
        surface: Vec::new(),
    }
}

/// A rectangle and a receiver in general position.
struct Case {
    rectangle: [DVec3; 3],
    receiver: Receiver,
    /// Distance from a point on the light, in diagonals of the light.
    sizes: f64,
    /// Whether the light crosses the horizon.
    cut: bool,
}

/// A rectangle whose corners are exact: the sides are columns of a matrix of whole numbers that rotates and scales, times a short
/// number each. One case in three is made to cross the horizon. Every other case lies 1e5 from the origin, on a grid of 2^-30 that
/// keeps positions exact there.
fn case(seed: u64) -> Case {
    let mut rng = Rng::new(seed);
    let [a, b, c, d] = std::array::from_fn(|_| (rng.unit() * 15.0).floor() - 7.0);
    let d = if a == 0.0 && b == 0.0 && c == 0.0 && d == 0.0 {
        1.0
    } else {
        d
    };
    let u = DVec3::new(
        a * a + b * b - c * c - d * d,
        2.0 * (b * c + a * d),
        2.0 * (b * d - a * c),
    );
    let v = DVec3::new(
        2.0 * (b * c - a * d),
        a * a - b * b + c * c - d * d,
        2.0 * (c * d + a * b),
    );
    let short = |x: f64| (x * 256.0).round() / 256.0;
    let scale = 2f64.powi(-6);
    let (u, v) = (
        u * (scale * short(rng.range(0.1, 1.0))),
        v * (scale * short(rng.range(0.1, 1.0))),
    );
    let offset = if seed.is_multiple_of(2) { 1e5 } else { 0.0 };
    let on_grid = |p: DVec3| (p * 2f64.powi(30)).round() * 2f64.powi(-30);
    let corner = on_grid(rng.direction()) + (rng.direction() * offset).round();
    let size = (u + v).length();

    let target = corner + u * rng.unit() + v * rng.unit();
    let across = u.cross(v).normalize();
    let mut towards = rng.direction();
    if towards.dot(across) < 0.0 {
        towards = -towards;
    }
    let sizes = 10f64.powf(rng.range(-3.0, 4.0));
    let mut position = target + towards * (sizes * size);
    if offset > 0.0 {
        position = on_grid(position);
    }
    let upwards = rng.direction();
    let to_target = target - position;
    let normal = match seed % 3 {
        0 => to_target.cross(upwards).normalize(),
        _ if upwards.dot(to_target) < 0.0 => -upwards,
        _ => upwards,
    };
    let heights =
        [corner, corner + u, corner + u + v, corner + v].map(|p| (p - position).dot(normal));
    Case {
        rectangle: [corner, u, v],
        receiver: Receiver {
            position,
            normal,
            seed,
        },
        sizes,
        cut: heights.iter().any(|&h| h <= 0.0),
    }
}

fn reference(case: &Case, x: extended::Vector) -> extended::Light {
    if case.cut {
        extended::rectangle_above(case.rectangle, x, case.receiver.normal)
    } else {
        extended::rectangle(case.rectangle, x)
    }
}

#[test]
fn explore() {
    let mut rows: Vec<(f64, bool, f64, [f64; 6])> = Vec::new();
    for seed in 0..6000 {
        let case = case(seed);
        let light = polygon(case.rectangle);
        let got = transport::unoccluded(&light, &case.receiver, true);
        let x = extended::vector(case.receiver.position);
        let (g, phi) = reference(&case, x);
        let (g, phi) = (extended::rounded(g), phi.to_f64());
        let other = extended::rectangle_above(case.rectangle, x, case.receiver.normal);
        let (j, grad_phi) = differences(&case, x);
        let to = (case.rectangle[0] + 0.5 * (case.rectangle[1] + case.rectangle[2])
            - case.receiver.position)
            .normalize();
        let cosine = -to.dot(light.normal);
        let dj = (got.j - j)
            .to_cols_array()
            .iter()
            .map(|x| x * x)
            .sum::<f64>()
            .sqrt()
            / j.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        rows.push((
            case.sizes,
            case.cut,
            cosine,
            [
                (got.g - g).length() / g.length(),
                (got.phi - phi).abs() / phi,
                dj,
                (got.grad_phi - grad_phi).length() / grad_phi.length(),
                (extended::rounded(other.0) - g).length() / g.length(),
                (got.g - g).dot(case.receiver.normal).abs() / got.rounding,
            ],
        ));
    }
    for cut in [false, true] {
        for decade in -3..4 {
            let mut rows: Vec<_> = rows
                .iter()
                .filter(|r| {
                    r.1 == cut && r.0.log10().floor() as i32 == decade && r.3[0].is_finite()
                })
                .collect();
            rows.sort_by(|a, b| a.3[0].total_cmp(&b.3[0]));
            if rows.is_empty() {
                println!("none {cut} {decade}");
                continue;
            }
            let stat = |k: usize| {
                let mut v: Vec<f64> = rows.iter().map(|r| r.3[k]).collect();
                v.sort_by(f64::total_cmp);
                format!(
                    "{:.0e}/{:.0e}/{:.0e}",
                    v[v.len() / 2],
                    v[v.len() * 99 / 100],
                    v[v.len() - 1]
                )
            };
            println!(
                "cut {cut} 1e{decade} n {} G {} phi {} J {} gphi {} refs {} bound {}",
                rows.len(),
                stat(0),
                stat(1),
                stat(2),
                stat(3),
                stat(4),
                stat(5)
            );
            let worst = rows[rows.len() - 1];
            println!(
                "    worst sizes {:.3e} cos {:.2e} err {:?}",
                worst.0, worst.2, worst.3
            );
        }
    }
    let bad = rows
        .iter()
        .filter(|r| !(r.3[0] < 1e-12 && r.3[1] < 1e-12))
        .count();
    println!("bad {bad}");
    for r in rows
        .iter()
        .filter(|r| !(r.3[0] < 1e-12 && r.3[1] < 1e-12))
        .take(40)
    {
        println!("{r:?}");
    }
}

/// Central differences of the reference.
fn differences(case: &Case, x: extended::Vector) -> (DMat3, DVec3) {
    let [corner, u, v] = case.rectangle;
    let size = (u + v).length();
    let _ = corner;
    let step = 1e-9 * case.sizes.min(1.0) * size;
    let mut j = DMat3::ZERO;
    let mut grad_phi = DVec3::ZERO;
    for axis in 0..3 {
        let mut shift = DVec3::ZERO;
        shift[axis] = step;
        let shift = extended::vector(shift);
        let (g1, phi1) = reference(case, extended::plus(x, shift));
        let (g0, phi0) = reference(case, extended::minus(x, shift));
        let per = Dd::from(0.5) / Dd::from(step);
        *j.col_mut(axis) = extended::rounded(extended::times(extended::minus(g1, g0), per));
        grad_phi[axis] = ((phi1 - phi0) * per).to_f64();
    }
    (j, grad_phi)
}

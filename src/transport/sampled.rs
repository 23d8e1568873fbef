//! The visible part of a light by stratified shadow rays, weighted against the closed form of the whole light.
//!
//! With f the integrand of G at points spread over the light, V their visibility, and sums over the points,
//!
//! ```text
//! S_all = Σ f,  S_vis = Σ V f,    r = (G·n)/(S_all·n),  v = (S_vis·n)/(S_all·n)
//! G_vis = r S_vis + v (G − r S_all)
//! ```
//!
//! G_vis is G when every point is visible and 0 when none is, and its irradiance G_vis·n = v G·n is the ratio estimator, which has less
//! noise than the plain one because the closed form takes out all that does not come from visibility. φ has its own ratio.
//!
//! The points lie in strata of equal area, one in each, jittered by a hash of (receiver, light, stratum).

use glam::DVec3;

use super::Receiver;
use super::contour::Sums;
use super::source::{Source, Unoccluded};
use crate::math;
use crate::visibility::Visibility;

/// The visible part of a light, per unit radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Estimate {
    /// Without derivatives.
    pub(super) sums: Sums,
    /// Standard error of the irradiance at the receiver's own normal, steradians. 0 where all points agree: that proves nothing about
    /// what lies between them.
    pub(super) error: f64,
    /// Rays cast.
    pub(super) rays: u32,
}

/// Estimates what `receiver` sees of `source`, whose unoccluded light is `whole`, by `samples` points of which those above the horizon
/// cast a ray each.
///
/// Even when all points are visible the result has no derivative: something small may stand between them.
pub(super) fn estimate<V: Visibility + ?Sized>(
    source: &Source<'_>,
    receiver: &Receiver,
    whole: &Unoccluded,
    light: u64,
    samples: u32,
    visibility: &V,
) -> Estimate {
    let surface = &source.polygon.surface;
    let ignore = |triangle: u32| surface.binary_search(&triangle).is_ok();
    let sees = |point: DVec3| !visibility.occluded(receiver.position, point, &ignore);

    let height = source.height(receiver.position).abs();
    let mut points = Vec::with_capacity(samples as usize);
    let (mut all, mut seen) = (Moments::default(), Moments::default());
    let mut rays = 0;
    for place in strata(samples, receiver.seed, light) {
        let point = source.point(place);
        let to_point = point - receiver.position;
        let cosine = to_point.dot(receiver.normal);
        let (mut weight, mut visible) = (0.0, false);
        if cosine > 0.0 {
            let square = to_point.length_squared();
            let g = to_point * (height / (square * square));
            let phi = height / (square * square.sqrt());
            rays += 1;
            visible = sees(point);
            weight = g.dot(receiver.normal);
            all.add(g, phi);
            if visible {
                seen.add(g, phi);
            }
        }
        points.push((weight, visible));
    }

    let total = all.g.dot(receiver.normal);
    if !(total > 0.0 && total.is_finite()) {
        return one_ray(whole, receiver, sees(whole.middle), rays + 1);
    }
    let g = whole.sums.g;
    let irradiance = g.dot(receiver.normal).max(0.0);
    let ratio = irradiance / total;
    let visible = seen.g.dot(receiver.normal) / total;
    Estimate {
        sums: Sums {
            g: seen.g * ratio + (g - all.g * ratio) * visible,
            phi: whole.sums.phi * (seen.phi / all.phi),
            ..whole.sums.without_gradient()
        },
        error: ratio * standard_deviation(&points, visible),
        rays,
    }
}

/// What is left when no point lies above the horizon although some of the light does: all or nothing, by one ray.
fn one_ray(whole: &Unoccluded, receiver: &Receiver, visible: bool, rays: u32) -> Estimate {
    let sums = if visible { whole.sums } else { Sums::DARK };
    Estimate {
        sums: sums.without_gradient(),
        error: 0.5 * whole.sums.g.dot(receiver.normal).max(0.0),
        rays,
    }
}

/// Sums over points.
#[derive(Default)]
struct Moments {
    g: DVec3,
    phi: f64,
}

impl Moments {
    fn add(&mut self, g: DVec3, phi: f64) {
        self.g += g;
        self.phi += phi;
    }
}

/// One point in each of `count` strata of equal area of the unit square, so ordered that neighbours in the order touch.
///
/// Rows of nearly square strata; rows may differ by one stratum, so any count will do.
fn strata(count: u32, seed: u64, light: u64) -> impl Iterator<Item = [f64; 2]> {
    let n = u64::from(count);
    let rows = n.isqrt().max(1);
    (0..rows).flat_map(move |row| {
        let (first, end) = (row * n / rows, (row + 1) * n / rows);
        (first..end).map(move |index| {
            let [x, y] = math::unit_pair(math::hash(seed, light, index));
            let column = if row % 2 == 0 {
                index - first
            } else {
                end - 1 - index
            };
            let width = (end - first) as f64;
            [
                (column as f64 + x) / width,
                (first as f64 + y * width) / n as f64,
            ]
        })
    })
}

/// Standard deviation of Σ weight (V − mean) over strata of one point each, from the differences of neighbouring strata.
///
/// Neighbours differ in their means as well as by chance, so it overestimates: by √3 where one straight shadow edge crosses the light. With
/// one point it is half of the weight.
///
/// Source: W. Cochran, "Sampling techniques", 3rd edition 1977, §5A.12 (collapsed strata) and §6.4 (the residual of a ratio).
fn standard_deviation(points: &[(f64, bool)], mean: f64) -> f64 {
    if let [(weight, _)] = points {
        return 0.5 * weight;
    }
    let residual =
        |&(weight, visible): &(f64, bool)| weight * (f64::from(u8::from(visible)) - mean);
    let squares: f64 = points
        .windows(2)
        .map(|pair| (residual(&pair[0]) - residual(&pair[1])).powi(2))
        .sum();
    (0.5 * squares * points.len() as f64 / (points.len() - 1) as f64).sqrt()
}

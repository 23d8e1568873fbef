//! The visible part of a light by stratified shadow rays, weighted against the closed form of the whole light.
//!
//! With f the integrand of G at points spread over the light, V their visibility, and sums over the points,
//!
//! ```text
//! S_all = Σ f,  S_vis = Σ V f,    r = (G·n)/(S_all·n),  v = (S_vis·n)/(S_all·n)
//! G_vis = r S_vis + v (G − r S_all)
//! ```
//!
//! The result is G when every point is visible and 0 when none is, and its irradiance v G·n is the ratio estimator, which has less
//! noise than the plain one because the closed form takes out all that does not come from visibility. φ has its own ratio.
//!
//! The points lie in strata of equal area, one in each, jittered by a hash of (receiver, light, stratum).

use glam::DVec3;

use super::Receiver;
use super::contour::Sums;
use super::pair::Part;
use super::source::{Source, Surface, Unoccluded};
use crate::math;
use crate::visibility::Visibility;

/// Samples up to which a point is refined: 64 times the default, at which a straight shadow edge is known to a part in a thousand.
pub(super) const MAX_SAMPLES: u32 = 4096;

/// The standard error falls as N^-3/4 where a straight edge crosses the light, and more slowly in a soup.
pub(super) const CONVERGENCE: f64 = 0.75;

/// Share of a sample by which the result may be off even where all samples agree: a part of a stratum may still be otherwise.
pub(super) const AGREED: f64 = 0.5;

/// [`estimate`] with `samples` points, and where its standard error exceeds `accepted` steradians, again with as many fresh points as should
/// meet it. Fresh ones, because keeping a first look only where it happened to agree with itself would bias the result.
pub(super) fn estimate_to<V: Visibility + ?Sized>(
    source: &Source<'_>,
    surface: &Surface<'_>,
    receiver: &Receiver,
    whole: &Unoccluded,
    light: u64,
    (samples, accepted): (u32, f64),
    visibility: &V,
) -> Part {
    let again =
        |light, samples| estimate(source, surface, receiver, whole, light, samples, visibility);
    let pilot = again(light, samples);
    if accepted <= 0.0 || pilot.error <= accepted {
        return pilot;
    }
    let wanted = f64::from(samples) * (pilot.error / accepted).powf(1.0 / CONVERGENCE);
    let wanted = (wanted.min(f64::from(MAX_SAMPLES))) as u32;
    if wanted <= samples {
        return pilot;
    }
    let mut part = again(!light, wanted);
    part.rays += pilot.rays;
    part
}

/// Estimates what `receiver` sees of `source`, whose unoccluded light is `whole`, by `samples` points of which those above the horizon
/// cast a ray each.
///
/// Even when all points are visible the result has no derivative: something small may stand between them.
pub(super) fn estimate<V: Visibility + ?Sized>(
    source: &Source<'_>,
    surface: &Surface<'_>,
    receiver: &Receiver,
    whole: &Unoccluded,
    light: u64,
    samples: u32,
    visibility: &V,
) -> Part {
    let own = source.own_triangles();
    let ignore = |triangle: u32| own.binary_search(&triangle).is_ok();
    let sees = |point: DVec3| !visibility.occluded(receiver.position, point, &ignore);

    let height = source.height(receiver.position).abs();
    let mut points = Vec::with_capacity(samples as usize);
    let (mut all, mut seen) = (Moments::default(), Moments::default());
    let mut rays = 0;
    for place in strata(samples, receiver.seed, light) {
        let point = surface.point(place);
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
    Part {
        sums: Sums {
            g: seen.g * ratio + (g - all.g * ratio) * visible,
            phi: whole.sums.phi * (seen.phi / all.phi),
            ..whole.sums.without_gradient()
        },
        error: (ratio * standard_deviation(&points, visible))
            .hypot(AGREED * irradiance / points.len() as f64),
        rays,
    }
}

/// What is left when no point lies above the horizon although some of the light does: all or nothing, by one ray.
fn one_ray(whole: &Unoccluded, receiver: &Receiver, visible: bool, rays: u32) -> Part {
    let sums = if visible { whole.sums } else { Sums::DARK };
    Part {
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
/// Source: W. Cochran, "Sampling techniques", 3rd edition 1977, on collapsed strata and on the residuals of a ratio.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lights::Polygon;
    use crate::transport::clip::{self, Direction, Plane};
    use crate::transport::contour;
    use crate::visibility::Hit;

    /// Hides what is on the lower side of a plane through the receiver: an occluder with one straight edge, seen edge-on.
    struct Screen(Plane);

    impl Visibility for Screen {
        fn occluded(&self, _from: DVec3, to: DVec3, _ignore: &dyn Fn(u32) -> bool) -> bool {
            !self.0.is_above(to)
        }

        fn closest(
            &self,
            _origin: DVec3,
            _direction: DVec3,
            _max_distance: f64,
            _ignore: &dyn Fn(u32) -> bool,
        ) -> Option<Hit> {
            None
        }
    }

    /// A light of 2 × 2 m that looks down from 3 m.
    fn light() -> Polygon {
        let corner = |x: f64, y: f64| DVec3::new(x, y, 3.0);
        let [a, b, c, d] = [
            corner(-1.0, -1.0),
            corner(-1.0, 1.0),
            corner(1.0, 1.0),
            corner(1.0, -1.0),
        ];
        Polygon {
            contours: vec![vec![a, b, c, d]],
            triangles: vec![[a, b, c], [a, c, d]],
            normal: -DVec3::Z,
            area: 4.0,
            radiance: DVec3::ONE,
            two_sided: false,
            surface: Vec::new(),
        }
    }

    fn receiver(position: DVec3, seed: u64) -> Receiver {
        Receiver {
            position,
            normal: DVec3::Z,
            seed,
        }
    }

    /// The light above the screen, exactly.
    fn visible_part(light: &Polygon, receiver: &Receiver, screen: &Plane) -> Sums {
        let mut pieces = Vec::new();
        let turned = Direction::Reversed;
        clip::outline(
            &light.contours,
            turned,
            screen,
            receiver.position,
            &mut pieces,
        );
        contour::sum(&pieces, receiver.normal, false)
    }

    /// True and claimed root mean square errors of E over a penumbra, and the true ones of G and φ, all relative to the unoccluded light.
    fn errors(samples: u32) -> [f64; 4] {
        let light = light();
        let source = Source::new(&light);
        let surface = source.spread(DVec3::ZERO);
        let mut squares = [0.0; 4];
        let count = 2000;
        for seed in 0..count {
            let [x, y] = math::unit_pair(math::hash(seed, 1, 0));
            let [edge, turn] = math::unit_pair(math::hash(seed, 2, 0));
            let receiver = receiver(DVec3::new(x - 0.5, y - 0.5, 0.0), seed);
            // A plane through the receiver and a point of the light, at any angle.
            let target = surface.point([edge, x]) - receiver.position;
            let along = DVec3::new((7.0 * turn).cos(), (7.0 * turn).sin(), 0.0);
            let screen = Plane {
                point: receiver.position,
                normal: target.cross(along).normalize(),
            };
            let whole = source
                .unoccluded(&receiver, false, &mut Vec::new())
                .expect("the light is above");
            let want = visible_part(&light, &receiver, &screen);
            let got = estimate(
                &source,
                &surface,
                &receiver,
                &whole,
                0,
                samples,
                &Screen(screen),
            );
            let scale = whole.sums.g.z;
            squares[0] += ((got.sums.g.z - want.g.z) / scale).powi(2);
            squares[1] += (got.error / scale).powi(2);
            squares[2] += ((got.sums.g - want.g) / scale).length_squared();
            squares[3] += ((got.sums.phi - want.phi) / whole.sums.phi).powi(2);
        }
        squares.map(|square| (square / count as f64).sqrt())
    }

    #[test]
    fn penumbrae_converge_and_say_how_far_they_are() {
        let mut before = f64::INFINITY;
        for samples in [4, 16, 64, 256] {
            let [e, claimed, g, phi] = errors(samples);
            // Jittered strata: the error falls as N^-3/4 where an edge crosses the light, a factor of 2.8 for four times the points.
            assert!(e < before / 2.0, "{samples} points: {e:e} after {before:e}");
            let honesty = claimed / e;
            assert!(
                (0.8..2.5).contains(&honesty),
                "{samples} points: claims {claimed:e}, is {e:e}"
            );
            assert!(
                g < 2.0 * e && phi < 2.0 * e,
                "{samples} points: {g:e} {phi:e}"
            );
            before = e;
        }
        // Stratified rays have 0.017 at 64 points on comparable scenes.
        assert!(before < 0.01, "error {before:e}");
    }

    #[test]
    fn all_points_visible_gives_the_closed_form_and_none_gives_nothing() {
        let light = light();
        let source = Source::new(&light);
        let surface = source.spread(DVec3::ZERO);
        for (seed, samples) in (0..50).zip(1..) {
            let receiver = receiver(DVec3::new(0.1, 0.02 * seed as f64, 0.0), seed);
            let whole = source
                .unoccluded(&receiver, true, &mut Vec::new())
                .expect("the light is above");
            let screen = |normal| {
                Screen(Plane {
                    point: receiver.position,
                    normal,
                })
            };
            let lit = estimate(
                &source,
                &surface,
                &receiver,
                &whole,
                3,
                samples,
                &screen(DVec3::Z),
            );
            assert!((lit.sums.g - whole.sums.g).length() < 1e-15);
            assert!((lit.sums.phi - whole.sums.phi).abs() < 1e-15);
            assert!(!lit.sums.has_gradient);
            assert_eq!(lit.rays, samples);
            let dark = estimate(
                &source,
                &surface,
                &receiver,
                &whole,
                3,
                samples,
                &screen(-DVec3::Z),
            );
            assert_eq!(dark.sums.g, DVec3::ZERO);
            assert!(dark.sums.phi == 0.0 && !dark.sums.has_gradient);
        }
    }

    #[test]
    fn a_sliver_above_the_horizon_that_no_point_meets_gets_one_ray() {
        let light = light();
        let source = Source::new(&light);
        let surface = source.spread(DVec3::ZERO);
        // The horizon passes 1e-6 m inside the light's border.
        let mut receiver = receiver(DVec3::ZERO, 5);
        let border = DVec3::new(1.0 - 1e-6, 0.0, 3.0);
        receiver.normal = DVec3::new(border.z, 0.0, -border.x).normalize();
        let whole = source
            .unoccluded(&receiver, false, &mut Vec::new())
            .expect("a sliver is above");
        assert!(whole.middle.dot(receiver.normal) >= 0.0);
        let open = Screen(Plane {
            point: DVec3::ZERO,
            normal: DVec3::Z,
        });
        let got = estimate(&source, &surface, &receiver, &whole, 0, 4, &open);
        assert_eq!(got.rays, 1);
        assert_eq!(got.sums.g, whole.sums.g);
        assert!(got.error > 0.0);
    }

    #[test]
    fn strata_are_as_many_as_asked_and_cover_the_square_evenly() {
        for count in 1..=130 {
            let places: Vec<_> = strata(count, 11, 4).collect();
            assert_eq!(places.len(), count as usize);
            // Every row of strata holds its share of points.
            let rows = u64::from(count).isqrt();
            for row in 0..rows {
                let bound = |row: u64| (row * u64::from(count) / rows) as f64 / f64::from(count);
                let inside = places
                    .iter()
                    .filter(|place| (bound(row)..bound(row + 1)).contains(&place[1]))
                    .count() as f64;
                let share = (bound(row + 1) - bound(row)) * f64::from(count);
                assert!((inside - share).abs() < 1e-9, "{count}: row {row}");
            }
            // Neighbours in the order lie in strata that touch: the error estimate compares them.
            let tallest = 1.0 / rows as f64 + 1.0 / f64::from(count);
            let widest = 1.0 / (u64::from(count) / rows) as f64;
            for pair in places.windows(2) {
                let [from, to] = [pair[0], pair[1]];
                assert!((from[0] - to[0]).abs() < 2.0 * widest, "{count}");
                assert!((from[1] - to[1]).abs() < 2.0 * tallest, "{count}");
            }
            for [u, v] in places {
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
            }
        }
    }

    #[test]
    fn points_cover_a_light_of_unequal_triangles_by_area() {
        let mut light = light();
        let cut = DVec3::new(-0.4, 1.0, 3.0);
        let [a, b, c] = light.triangles[0];
        light.triangles = vec![light.triangles[1], [a, b, cut], [a, cut, c]];
        let surface = Source::new(&light).spread(DVec3::ZERO);
        let n = 4096;
        let (mut mean, mut left) = (DVec3::ZERO, 0);
        for place in strata(n, 1, 2) {
            let point = surface.point(place);
            mean += point / f64::from(n);
            left += u32::from(point.x < -0.5);
        }
        // A column of 64 strata may be shared by two triangles a metre apart: 1/64 of the weight, to 1/√64. Twice two of them.
        // The quarter is known to the 64 strata on its border, half a point each.
        assert!(
            (mean - DVec3::new(0.0, 0.0, 3.0)).length() < 4.0 / 512.0,
            "{mean}"
        );
        assert!(left.abs_diff(n / 4) < 32, "{left}");
    }
}

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

/// Samples up to which a point is refined: 64 times the default, at which a straight shadow edge is known to a part in a thousand.
pub(super) const MAX_SAMPLES: u32 = 4096;

/// The standard error falls as N^-3/4 where a straight edge crosses the light, and more slowly in a soup.
pub(super) const CONVERGENCE: f64 = 0.75;

/// Share of a sample by which the result may be off even where all samples agree: a part of a stratum may still be otherwise.
pub(super) const AGREED: f64 = 0.5;

/// What there is to see of a light at one receiver.
pub(super) struct View<'a> {
    pub(super) source: &'a Source<'a>,
    pub(super) surface: &'a Surface<'a>,
    pub(super) receiver: &'a Receiver,
    /// The light with nothing in the way.
    pub(super) whole: &'a Unoccluded,
    /// Names the light in random numbers.
    pub(super) light: u64,
    /// Share of the light that arrives along each segment, per channel.
    pub(super) arrives: &'a dyn Fn(&[[DVec3; 2]]) -> Vec<DVec3>,
    /// Whether the channels differ; otherwise only the first is looked at.
    pub(super) is_tinted: bool,
}

/// What is seen, per channel where they differ.
#[derive(Clone, Debug)]
pub(super) enum Seen {
    /// The same in all channels.
    Alike(Part),
    /// Red, green, blue; each counts all rays.
    Tinted(Box<[Part; 3]>),
}

impl Seen {
    fn error(&self) -> f64 {
        match self {
            Self::Alike(part) => part.error,
            Self::Tinted(parts) => parts.iter().map(|part| part.error).fold(0.0, f64::max),
        }
    }

    fn rays(&self) -> u32 {
        match self {
            Self::Alike(part) => part.rays,
            Self::Tinted(parts) => parts[0].rays,
        }
    }

    pub(super) fn for_each(&mut self, mut change: impl FnMut(&mut Part)) {
        match self {
            Self::Alike(part) => change(part),
            Self::Tinted(parts) => parts.iter_mut().for_each(change),
        }
    }
}

/// [`estimate`] with `samples` points, and where its standard error exceeds `accepted` steradians, again with as many fresh points as should
/// meet it. Fresh ones, because keeping a first look only where it happened to agree with itself would bias the result.
pub(super) fn estimate_to(view: &View<'_>, samples: u32, accepted: f64) -> Seen {
    let pilot = estimate(view, samples);
    if accepted <= 0.0 || pilot.error() <= accepted {
        return pilot;
    }
    let wanted = f64::from(samples) * (pilot.error() / accepted).powf(1.0 / CONVERGENCE);
    let wanted = (wanted.min(f64::from(MAX_SAMPLES))) as u32;
    if wanted <= samples {
        return pilot;
    }
    let again = View {
        light: !view.light,
        ..*view
    };
    let mut seen = estimate(&again, wanted);
    seen.for_each(|part| part.rays += pilot.rays());
    seen
}

/// A point of the light.
struct Point {
    /// Integrands of G and φ there, up to a factor.
    g: DVec3,
    phi: f64,
    /// `g` along the receiver's normal; 0 below the horizon.
    weight: f64,
    /// What arrives of it, per channel.
    share: DVec3,
}

/// Estimates what the receiver sees by `samples` points of which those above the horizon cast a ray each.
///
/// Even when all points are visible the result has no derivative: something small may stand between them.
pub(super) fn estimate(view: &View<'_>, samples: u32) -> Seen {
    let points = cast(view, samples);
    let n_rays = points.iter().filter(|point| point.weight > 0.0).count() as u32;
    let mut all = Moments::default();
    for point in &points {
        all.add(point.g, point.phi);
    }
    let total = all.g.dot(view.receiver.normal);
    let of_channel: Box<dyn Fn(usize) -> Part> = if total > 0.0 && total.is_finite() {
        Box::new(|channel| view.weigh(&points, &all, channel, n_rays))
    } else {
        let segment = [view.receiver.position, view.whole.middle];
        let share = (view.arrives)(&[segment])[0];
        Box::new(move |channel| view.by_one_ray(share[channel], n_rays + 1))
    };
    if view.is_tinted {
        Seen::Tinted(Box::new([0, 1, 2].map(of_channel)))
    } else {
        Seen::Alike(of_channel(0))
    }
}

fn cast(view: &View<'_>, samples: u32) -> Vec<Point> {
    let receiver = view.receiver;
    let height = view.source.height(receiver.position).abs();
    let mut points = Vec::with_capacity(samples as usize);
    let mut segments = Vec::with_capacity(samples as usize);
    for place in strata(samples, receiver.seed, view.light) {
        let target = view.surface.point(place);
        let to_point = target - receiver.position;
        let mut point = Point {
            g: DVec3::ZERO,
            phi: 0.0,
            weight: 0.0,
            share: DVec3::ZERO,
        };
        if to_point.dot(receiver.normal) > 0.0 {
            let square = to_point.length_squared();
            point.g = to_point * (height / (square * square));
            point.phi = height / (square * square.sqrt());
            point.weight = point.g.dot(receiver.normal);
        }
        if point.weight > 0.0 {
            segments.push([receiver.position, target]);
        }
        points.push(point);
    }
    let shares = (view.arrives)(&segments);
    let lit = points.iter_mut().filter(|point| point.weight > 0.0);
    for (point, share) in lit.zip(shares) {
        point.share = share;
    }
    points
}

impl View<'_> {
    /// The ratio estimate of one channel.
    fn weigh(&self, points: &[Point], all: &Moments, channel: usize, rays: u32) -> Part {
        let normal = self.receiver.normal;
        let mut seen = Moments::default();
        for point in points {
            let share = point.share[channel];
            seen.add(point.g * share, point.phi * share);
        }
        let g = self.whole.sums.g;
        let irradiance = g.dot(normal).max(0.0);
        let total = all.g.dot(normal);
        let ratio = irradiance / total;
        let visible = seen.g.dot(normal) / total;
        Part {
            sums: Sums {
                g: seen.g * ratio + (g - all.g * ratio) * visible,
                phi: self.whole.sums.phi * (seen.phi / all.phi),
                ..self.whole.sums.without_gradient()
            },
            error: (ratio * standard_deviation(points, channel, visible))
                .hypot(AGREED * irradiance / points.len() as f64),
            rays,
        }
    }

    /// What is left when no point lies above the horizon although some of the light does: all or nothing.
    fn by_one_ray(&self, share: f64, rays: u32) -> Part {
        let whole = self.whole.sums;
        Part {
            sums: Sums {
                g: whole.g * share,
                phi: whole.phi * share,
                ..whole.without_gradient()
            },
            error: 0.5 * whole.g.dot(self.receiver.normal).max(0.0),
            rays,
        }
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
fn standard_deviation(points: &[Point], channel: usize, mean: f64) -> f64 {
    if let [point] = points {
        return 0.5 * point.weight;
    }
    let residual = |point: &Point| point.weight * (point.share[channel] - mean);
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

    /// [`super::estimate`] before an occluder with one straight edge, seen edge-on: what is on the lower side of `screen` is hidden.
    fn estimate(
        source: &Source<'_>,
        receiver: &Receiver,
        whole: &Unoccluded,
        light: u64,
        samples: u32,
        screen: &Plane,
    ) -> Part {
        let surface = source.spread(receiver.position);
        let arrives = |segments: &[[DVec3; 2]]| {
            let is_open = segments.iter().map(|[_, to]| screen.is_above(*to));
            is_open
                .map(|open| DVec3::splat(f64::from(u8::from(open))))
                .collect()
        };
        let view = View {
            source,
            surface: &surface,
            receiver,
            whole,
            light,
            arrives: &arrives,
            is_tinted: false,
        };
        match super::estimate(&view, samples) {
            Seen::Alike(part) => part,
            Seen::Tinted(_) => panic!("nothing tints"),
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
            let got = estimate(&source, &receiver, &whole, 0, samples, &screen);
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

        for (seed, samples) in (0..50).zip(1..) {
            let receiver = receiver(DVec3::new(0.1, 0.02 * seed as f64, 0.0), seed);
            let whole = source
                .unoccluded(&receiver, true, &mut Vec::new())
                .expect("the light is above");
            let screen = |normal| Plane {
                point: receiver.position,
                normal,
            };
            let lit = estimate(&source, &receiver, &whole, 3, samples, &screen(DVec3::Z));
            assert!((lit.sums.g - whole.sums.g).length() < 1e-15);
            assert!((lit.sums.phi - whole.sums.phi).abs() < 1e-15);
            assert!(!lit.sums.has_gradient);
            assert_eq!(lit.rays, samples);
            let dark = estimate(&source, &receiver, &whole, 3, samples, &screen(-DVec3::Z));
            assert_eq!(dark.sums.g, DVec3::ZERO);
            assert!(dark.sums.phi == 0.0 && !dark.sums.has_gradient);
        }
    }

    #[test]
    fn a_sliver_above_the_horizon_that_no_point_meets_gets_one_ray() {
        let light = light();
        let source = Source::new(&light);

        // The horizon passes 1e-6 m inside the light's border.
        let mut receiver = receiver(DVec3::ZERO, 5);
        let border = DVec3::new(1.0 - 1e-6, 0.0, 3.0);
        receiver.normal = DVec3::new(border.z, 0.0, -border.x).normalize();
        let whole = source
            .unoccluded(&receiver, false, &mut Vec::new())
            .expect("a sliver is above");
        assert!(whole.middle.dot(receiver.normal) >= 0.0);
        let open = Plane {
            point: DVec3::ZERO,
            normal: DVec3::Z,
        };
        let got = estimate(&source, &receiver, &whole, 0, 4, &open);
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

//! Points × lights × occluders → [`Sample`]: the light vector, the fluence and their derivatives at a point.
//!
//! [`gather()`] looks at a tile of receivers and one light at a time. Where nothing can stand between them, the light is a sum over its
//! outline ([`contour`]; `distant` for lights small for their distance), clipped to the horizon (`clip`), exact to rounding. Elsewhere
//! (`pair` decides) the outlines of the occluders (`outline`) are clipped against it (`exact`), which is as exact, or found by rays and
//! followed (`traced`, `vedel`), or shadow rays say how much of it is seen (`sampled`).

mod clip;
pub mod contour;
mod cost;
mod distant;
mod exact;
mod frame;
mod gather;
mod minor;
mod outline;
mod outlook;
mod pair;
mod sampled;
mod select;
mod source;
mod traced;
mod umbra;
mod vedel;

use glam::{DMat3, DVec3};

pub use self::contour::Sums;
pub use self::gather::gather;
pub use self::minor::MANY_LIGHTS;
pub use self::outlook::{Shadow, shadows};
use self::source::Source;
pub use self::vedel::Options as VedelOptions;
use crate::lights::{Lights, Polygon};
use crate::math::Aabb;

/// How light is evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Which estimator handles partly hidden lights. Default: [`Estimator::Auto`].
    pub estimator: Estimator,
    /// Shadow rays per point and partly hidden light of [`Estimator::Sampled`]. Range: 1..=65536. Default: 64.
    pub samples: u32,
    /// Standard error in lux of a light's irradiance above which a sampled point is sampled again, with as many rays as it takes, 4096 at
    /// most. Range: 0 and more; 0 never does. Default: 0.
    pub accepted_error: f64,
    /// Irradiance in lux that may be missing: per tile the dimmest lights are left out as long as upper bounds of what they give sum up
    /// to no more. The sum enters [`Sample::error`]; derivatives lack those lights too. Range: 0 and more. Default: 0, all lights count.
    pub negligible: f64,
    /// Lights that could give a receiver no more than this share of all its light are tested by one shadow ray at most, and none once what
    /// is left to test is below this share of what is known; what is not tested is added as often as the tile sees it, and counted as error.
    /// Radiance's `-dt`. Range: 0..=1; 0 integrates every light. Not with `gradients`. Default: 0.
    pub direct_threshold: f64,
    /// How many of the n lights left to test are compared with the threshold before testing stops: the largest n to this power. Radiance's
    /// `-dc`. Range: 0 (the next alone)..=1 (all of them: the bound holds). Default: 0.5.
    pub direct_certainty: f64,
    /// How [`Estimator::Vedel`] looks.
    pub vedel: VedelOptions,
    /// Whether to evaluate `j` and `grad_phi`.
    pub gradients: bool,
    /// For comparison only: `j` of partly hidden lights by the formula of Vedel's appendix, which is wrong where contours cross.
    #[doc(hidden)]
    pub appendix_derivative: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            estimator: Estimator::Auto,
            samples: 64,
            accepted_error: 0.0,
            negligible: 0.0,
            direct_threshold: 0.0,
            direct_certainty: 0.5,
            vedel: VedelOptions::default(),
            gradients: true,
            appendix_derivative: false,
        }
    }
}

/// How the visible part of a light is integrated where something may stand in the way. Lights that nothing can hide always take the
/// closed form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// Exact contours, except where a masked occluder makes them wrong, or where counted edges make them dearer than the rays that
    /// would meet [`Options::accepted_error`].
    Auto,
    /// The contour of the visible part, clipped exactly; no rays, noise-free, with derivatives. Lights behind masked occluders are sampled.
    Exact,
    /// Stratified shadow rays over the light's area, weighted so that fully visible lights stay exact. Gives no derivative.
    Sampled,
    /// The contour of the visible part, traced with rays as C. Vedel published it in 1993: a baseline for comparison. Misses occluders
    /// that lie between its first samples.
    Vedel,
    /// The contour of the visible part, found by rays and followed along the meshes, with derivatives; may miss what passes between the
    /// rays. Exact where that is doubtful.
    Traced,
}

impl Estimator {
    /// Each once.
    pub const ALL: [Self; 5] = [
        Self::Auto,
        Self::Exact,
        Self::Sampled,
        Self::Vedel,
        Self::Traced,
    ];
}

/// A point that receives light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// World metres.
    pub position: DVec3,
    /// Unit normal; light from below its plane does not count.
    pub normal: DVec3,
    /// Names the point in random numbers.
    pub seed: u64,
}

/// The light at a point, per colour channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Light vector in lux, world space.
    pub g: [DVec3; 3],
    /// Fluence of the upper hemisphere in lux.
    pub phi: [f64; 3],
    /// `j[channel]`: `∂G_i/∂x_k` in lux per metre at row i and column k. Zero unless `has_gradient`.
    pub j: [DMat3; 3],
    /// ∂φ/∂x in lux per metre. Zero unless `has_gradient`.
    pub grad_phi: [DVec3; 3],
    /// Whether every part of the light came with its derivative.
    pub has_gradient: bool,
    /// Estimated absolute error of E at the point's own normal, largest channel, lux.
    pub error: f64,
    /// Shadow rays cast.
    pub rays: u32,
}

impl Sample {
    /// No light.
    pub const DARK: Self = Self {
        g: [DVec3::ZERO; 3],
        phi: [0.0; 3],
        j: [DMat3::ZERO; 3],
        grad_phi: [DVec3::ZERO; 3],
        has_gradient: true,
        error: 0.0,
        rays: 0,
    };

    /// Irradiance in lux at the unit normal `n`: max(0, G·n) per channel.
    #[must_use]
    pub fn irradiance(&self, n: DVec3) -> DVec3 {
        DVec3::from_array(self.g.map(|g| g.dot(n).max(0.0)))
    }
}

/// What was done, summed over points and lights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Counters {
    /// Points evaluated.
    pub points: u64,
    /// Shadow rays cast.
    pub shadow_rays: u64,
    /// Tile × light pairs.
    pub pairs: u64,
    /// Pairs that were left out because the light cannot give the tile more than [`Options::negligible`].
    pub pairs_negligible: u64,
    /// Pairs of which the light matters little: tested by one ray per point at most.
    pub pairs_minor: u64,
    /// Lights that a point did not test: added as often as its tile sees them.
    pub lights_untested: u64,
    /// Pairs that cannot see each other: below the horizon of the whole tile, or behind the light.
    pub pairs_facing_away: u64,
    /// Pairs with an empty shaft: closed form, no ray.
    pub pairs_unoccluded: u64,
    /// Pairs where one triangle hides all of the light from the whole tile: dark, no ray.
    pub pairs_hidden: u64,
    /// Pairs of which the light has no size: a ray per point.
    pub pairs_hard: u64,
    /// Pairs with glass in between: sampled, or tested by one ray when the light has no size.
    pub pairs_tinted: u64,
    /// Pairs whose visible contour was clipped exactly.
    pub pairs_exact: u64,
    /// Candidate silhouette edges of those pairs.
    pub edges: u64,
    /// Silhouette edges that reached before a light, summed over the evaluations of those pairs.
    pub silhouettes: u64,
    /// Places where those met each other or the light's border, summed likewise.
    pub crossings: u64,
    /// Pairs that were sampled.
    pub pairs_sampled: u64,
    /// Pairs that were traced as Vedel does.
    pub pairs_vedel: u64,
    /// Pairs whose visible contour was traced.
    pub pairs_traced: u64,
    /// Evaluations of a light at a point that were to be traced and were clipped exactly instead.
    pub points_fallback: u64,
}

impl Counters {
    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.shadow_rays += other.shadow_rays;
        self.pairs += other.pairs;
        self.pairs_negligible += other.pairs_negligible;
        self.pairs_minor += other.pairs_minor;
        self.lights_untested += other.lights_untested;
        self.pairs_facing_away += other.pairs_facing_away;
        self.pairs_unoccluded += other.pairs_unoccluded;
        self.pairs_hidden += other.pairs_hidden;
        self.pairs_hard += other.pairs_hard;
        self.pairs_tinted += other.pairs_tinted;
        self.pairs_exact += other.pairs_exact;
        self.edges += other.edges;
        self.silhouettes += other.silhouettes;
        self.crossings += other.crossings;
        self.pairs_sampled += other.pairs_sampled;
        self.pairs_vedel += other.pairs_vedel;
        self.pairs_traced += other.pairs_traced;
        self.points_fallback += other.points_fallback;
    }
}

/// The light of `polygon` at `receiver` per unit radiance when nothing stands in the way: the closed form. Dark behind a one-sided light,
/// in a light's plane, and where the light is below the horizon.
///
/// Accuracy (`tests/transport`): 1e-12 of the result for lights from 1e-3 to 1e4 of their size away, also 1e5 sizes from the origin. Less
/// where the result is a small difference: within 1e-3 rad of edge-on or 1e-5 sizes of the light's plane, and for slivers above the
/// horizon, the error is below [`Sums::rounding`], some 1e-15 of the light that would be there face on.
#[must_use]
pub fn unoccluded(polygon: &Polygon, receiver: &Receiver, gradients: bool) -> Sums {
    Source::new(polygon)
        .unoccluded(receiver, gradients, &mut Vec::new())
        .map_or(Sums::DARK, |light| light.sums)
}

/// The irradiance in lux of all `lights` at `receiver`, at its own normal, when nothing stands in the way.
#[must_use]
pub fn unoccluded_irradiance(lights: &Lights, receiver: &Receiver) -> DVec3 {
    let places = Aabb::from_points([receiver.position]);
    let mut pieces = Vec::new();
    Source::all(lights, &places)
        .iter()
        .filter_map(|source| {
            let light = source.unoccluded(receiver, false, &mut pieces)?;
            let (share, _) = source.attenuation(receiver.position);
            let beyond = source.beyond().map_or(DVec3::ZERO, |beyond| {
                let share = light.sums.phi / beyond.whole;
                DVec3::from_array(beyond.light_vector.map(|v| v.dot(receiver.normal))) * share
            });
            let uniform = source.strength * (share * light.sums.g.dot(receiver.normal));
            Some((uniform + beyond).max(DVec3::ZERO))
        })
        .sum()
}

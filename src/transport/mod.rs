//! Points × lights × occluders → [`Sample`]: the light vector, the fluence and their derivatives at a point.

pub mod contour;
mod exact;
#[cfg(test)]
mod exact_dev;
mod outline;

use glam::{DMat3, DVec3};

use crate::lights::Lights;
use crate::visibility::Occluders;

/// How light is evaluated.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Which estimator handles partly hidden lights.
    pub estimator: Estimator,
    /// Shadow rays per point and partly hidden light of [`Estimator::Sampled`]. Range: 1..=65536. Default: 64.
    pub samples: u32,
    /// Whether to evaluate `j` and `grad_phi`.
    pub gradients: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            estimator: Estimator::Sampled,
            samples: 64,
            gradients: true,
        }
    }
}

/// How the visible part of a light is integrated where something may stand in the way. Lights that nothing can hide always take the
/// closed form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimator {
    /// Stratified shadow rays over the light's area, weighted so that fully visible lights stay exact. Gives no derivative.
    Sampled,
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
    /// `j[channel]`: ∂G_i/∂x_k in lux per metre at row i and column k. Zero unless `has_gradient`.
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
    /// Pairs that cannot see each other: below the horizon of the whole tile, or behind the light.
    pub pairs_facing_away: u64,
    /// Pairs with an empty shaft: closed form, no ray.
    pub pairs_unoccluded: u64,
    /// Pairs that were sampled.
    pub pairs_sampled: u64,
}

impl Counters {
    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.shadow_rays += other.shadow_rays;
        self.pairs += other.pairs;
        self.pairs_facing_away += other.pairs_facing_away;
        self.pairs_unoccluded += other.pairs_unoccluded;
        self.pairs_sampled += other.pairs_sampled;
    }
}

/// Evaluates the light of all `lights` at points that lie close together (a tile).
///
/// The result for a tile depends on its own points, the scene and the options only. Samples come in the order of `tile`.
#[must_use]
pub fn gather(
    _tile: &[Receiver],
    _lights: &Lights,
    _occluders: &Occluders<'_>,
    _options: &Options,
) -> (Vec<Sample>, Counters) {
    unimplemented!()
}

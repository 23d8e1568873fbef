//! What it costs to look at a light from a point, predicted from counts, so that the choice between ways is the same on any machine.
//!
//! Costs are nanoseconds of the machine that the constants were fitted on; only their ratios matter. `cargo bench --bench estimators --
//! --fit` measures all tiles of the fixtures, prints the fitted constants, and says how well they predict each fixture.

use super::sampled;

/// What there is to do at one point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Work {
    /// Candidate edges of the tile.
    pub(super) edges: f64,
    /// Silhouette edges before the light.
    pub(super) silhouettes: f64,
    /// Places where they meet each other or the border.
    pub(super) crossings: f64,
    /// Their length on the light in units of its side.
    pub(super) length: f64,
}

/// Fitted: a point, a candidate edge, a silhouette edge, a crossing.
const EXACT: [f64; 4] = [1150.0, 37.0, 350.0, 350.0];

/// Fitted: a shadow ray, and what it costs more for each silhouette edge that it passes on average.
const RAY: [f64; 2] = [235.0, 0.57];

/// What a sampled point costs besides its rays: the closed form of the whole light, 8 to 16 rays' worth on the fixtures.
const SAMPLED: f64 = 2500.0;

/// Standard deviation of what a sample in a stratum says that a silhouette runs through: that of a coin is 0.5, of an edge anywhere in a
/// square less. Fitted to what samples claim on `penumbra` and `leaves`, 0.39 and 0.22.
const COIN: f64 = 0.35;

impl Work {
    /// Cost of the exact contour.
    pub(super) fn exact(&self) -> f64 {
        let [point, edge, silhouette, crossing] = EXACT;
        point + edge * self.edges + silhouette * self.silhouettes + crossing * self.crossings
    }

    /// Cost of a shadow ray: where silhouettes are dense it meets more boxes and triangles.
    fn ray(&self) -> f64 {
        RAY[0] + RAY[1] * self.silhouettes
    }

    /// Cost of sampling to an error that is a share `accepted` of the light; the rest as for the rays.
    pub(super) fn sampled(&self, accepted: f64, pilot: f64, most: f64) -> f64 {
        SAMPLED + self.ray() * self.samples(accepted, pilot, most)
    }

    /// Rays of [`super::sampled::estimate_to`] for an error that is a share `accepted` of the light: `pilot`, and again as many as should
    /// meet it, `most` at most.
    ///
    /// Only strata that a silhouette runs through are uncertain, length · √N of N, in a soup all: the standard error is that of a coin in each
    /// of them.
    fn samples(&self, accepted: f64, pilot: f64, most: f64) -> f64 {
        let uncertain = pilot.min(self.length * pilot.sqrt());
        let error = (COIN * uncertain.sqrt()).hypot(sampled::AGREED) / pilot;
        if error <= accepted {
            return pilot;
        }
        // A share of 0 gives infinity.
        let again = pilot * (error / accepted).powf(1.0 / sampled::CONVERGENCE);
        pilot + again.min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOUP: Work = Work {
        edges: 800.0,
        silhouettes: 450.0,
        crossings: 2000.0,
        length: 90.0,
    };

    #[test]
    fn more_is_dearer_and_less_error_needs_more_samples() {
        let busier = Work {
            silhouettes: 900.0,
            ..SOUP
        };
        assert!(busier.exact() > SOUP.exact() && busier.ray() > SOUP.ray());
        assert!(SOUP.samples(1e-2, 64.0, 4096.0) > SOUP.samples(2e-2, 64.0, 4096.0));
    }

    #[test]
    fn no_accepted_error_needs_all_samples() {
        let clear = Work {
            length: 0.0,
            ..SOUP
        };
        assert!((SOUP.samples(0.0, 64.0, 4096.0) - 4160.0).abs() < 1e-9);
        assert!((clear.samples(0.0, 64.0, 4096.0) - 4160.0).abs() < 1e-9);
    }

    #[test]
    fn a_single_edge_needs_fewer_samples_than_a_soup() {
        let edge = Work {
            length: 1.0,
            ..SOUP
        };
        assert!(edge.samples(1e-3, 64.0, 1e9) < 0.5 * SOUP.samples(1e-3, 64.0, 1e9));
    }
}

//! A quadrature rule: directions and the light of their cells.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::elements::{Elements as _, Pixels};
use super::lloyd::{Partition, nearest};

/// The light of a part of the sphere, and the direction that stands for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Unit vector towards the light: the centroid of the cell, weighted by radiance.
    pub direction: DVec3,
    /// B: ∫ L dω over the cell per colour channel, lux.
    pub fluence: DVec3,
    /// ∫ L ω dω over the cell, one vector per colour channel, lux. Shorter than the fluence.
    pub light_vector: [DVec3; 3],
    /// Steradians of the pixels in the cell; the polygon of the cell differs by parts of pixels.
    pub solid_angle: f64,
}

/// Directions with the light of their cells, which are a partition of the sphere.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// One per direction, in the order in which they were placed. Never empty.
    pub cells: Vec<Cell>,
    /// Largest angle between a direction and the centroid of its cell's light, radians. For interleaved rules it is what is left of the
    /// compromise between each set and all of them together.
    pub decentration: f64,
}

impl Cell {
    /// ‖B‖ = R + G + B, the norm that the construction keeps small.
    #[must_use]
    pub fn norm(&self) -> f64 {
        self.fluence.element_sum()
    }

    /// Turned by `rotation` radians about Y, counter-clockwise seen from above, and `strength` times as bright.
    #[must_use]
    pub fn turned(&self, rotation: f64, strength: f64) -> Self {
        let turn = turn(rotation);
        Self {
            direction: turn * self.direction,
            fluence: strength * self.fluence,
            light_vector: self.light_vector.map(|vector| strength * (turn * vector)),
            solid_angle: self.solid_angle,
        }
    }
}

impl Rule {
    /// The rule of the picture turned by `rotation` radians about Y, counter-clockwise seen from above, and `strength` times as bright.
    #[must_use]
    pub fn turned(&self, rotation: f64, strength: f64) -> Self {
        Self {
            cells: self
                .cells
                .iter()
                .map(|cell| cell.turned(rotation, strength))
                .collect(),
            decentration: self.decentration,
        }
    }

    /// The directions alone.
    #[must_use]
    pub fn directions(&self) -> Vec<DVec3> {
        self.cells.iter().map(|cell| cell.direction).collect()
    }

    /// Sum of all Bᵢ: the fluence of the whole sphere, lux.
    #[must_use]
    pub fn fluence(&self) -> DVec3 {
        self.cells.iter().map(|cell| cell.fluence).sum()
    }

    /// The largest ‖Bᵢ‖.
    #[must_use]
    pub fn largest(&self) -> f64 {
        self.cells.iter().map(Cell::norm).fold(0.0, f64::max)
    }

    /// αᵢ: radii in radians of the largest caps around the directions that lie in their cells, which is half the way to the nearest other
    /// direction. π for a single direction, 0 for one that exists twice.
    #[must_use]
    pub fn cap_radii(&self) -> Vec<f64> {
        cap_radii(&self.directions())
    }
}

/// See [`Rule::cap_radii`].
pub(super) fn cap_radii(directions: &[DVec3]) -> Vec<f64> {
    directions
        .par_iter()
        .enumerate()
        .map(|(index, &direction)| {
            // Distances instead of cosines: the nearest may be very near.
            let nearest = directions
                .iter()
                .enumerate()
                .filter(|&(other, _)| other != index)
                .map(|(_, other)| direction.distance_squared(*other))
                .fold(f64::INFINITY, f64::min);
            if nearest.is_finite() {
                (0.5 * nearest.sqrt()).min(1.0).asin()
            } else {
                PI
            }
        })
        .collect()
}

/// A direction in the cap of `radius` radians around the unit vector `axis`, uniform for uniform `[u, v]` in [0, 1): the perturbed rule
/// (paper, section 4.1) takes these instead of ωᵢ, with αᵢ as radius and the same Bᵢ.
#[must_use]
pub(super) fn in_cap(axis: DVec3, radius: f64, [u, v]: [f64; 2]) -> DVec3 {
    // Uniform in 1 − cos, which is 2 sin² of the half: no cancellation in small caps.
    let half = (v.sqrt() * (0.5 * radius).sin()).min(1.0).asin();
    beside(axis, 2.0 * half, u)
}

impl Cell {
    /// A direction in the cap of `radius` radians around the cell's, uniform for uniform `[u, v]` in [0, 1).
    ///
    /// The perturbed rule takes these instead of the directions, with radii from [`Rule::cap_radii`], and leaves the light as it is: caps
    /// stay within their cells, and the light of a cell is already filtered (paper, section 4.1).
    #[must_use]
    pub fn perturbed(&self, radius: f64, uniform: [f64; 2]) -> DVec3 {
        in_cap(self.direction, radius, uniform)
    }
}

/// The unit vector `distance` radians from `axis`, `turn` times a full turn around it.
pub(super) fn beside(axis: DVec3, distance: f64, turn: f64) -> DVec3 {
    let (across, along) = axis.any_orthonormal_pair();
    let (sin, cos) = (TAU * turn).sin_cos();
    (distance.cos() * axis + distance.sin() * (cos * across + sin * along)).normalize()
}

pub(super) fn turn(rotation: f64) -> DMat3 {
    DMat3::from_rotation_y(rotation)
}

/// Light of a cell, as it is summed.
#[derive(Clone, Copy, Debug, Default)]
struct Light {
    fluence: DVec3,
    light_vector: [DVec3; 3],
    solid_angle: f64,
}

impl Light {
    fn add(&mut self, other: &Self) {
        self.fluence += other.fluence;
        for (sum, vector) in self.light_vector.iter_mut().zip(other.light_vector) {
            *sum += vector;
        }
        self.solid_angle += other.solid_angle;
    }
}

/// The rule of a partition of the picture.
pub(super) fn of(pixels: &Pixels<'_>, partition: &Partition<'_, Pixels<'_>>) -> Rule {
    let directions = partition.directions();
    let shares: Vec<Vec<(u32, Light)>> = (0..pixels.n_chunks())
        .into_par_iter()
        .map(|chunk| {
            let (mut shares, near): (Vec<_>, Vec<_>) = partition
                .near(chunk)
                .map(|index| ((index, Light::default()), directions[index as usize]))
                .unzip();
            pixels.patches(chunk, |patch, radiance| {
                let radiance = radiance.map(f64::from);
                shares[nearest(&near, patch.direction)].1.add(&Light {
                    fluence: patch.solid_angle * DVec3::from_array(radiance),
                    light_vector: radiance.map(|value| value * patch.moment),
                    solid_angle: patch.solid_angle,
                });
            });
            shares
        })
        .collect();
    let mut lights = vec![Light::default(); directions.len()];
    for (index, share) in shares.iter().flatten() {
        lights[*index as usize].add(share);
    }
    Rule {
        cells: directions
            .iter()
            .zip(lights)
            .map(|(&direction, light)| Cell {
                direction,
                fluence: light.fluence,
                light_vector: light.light_vector,
                solid_angle: light.solid_angle,
            })
            .collect(),
        decentration: partition.decentration(),
    }
}

/// Mean of directions, weighted; `None` when they cancel.
pub(super) fn mean(weighted: impl Iterator<Item = (f64, DVec3)>) -> Option<DVec3> {
    weighted
        .map(|(weight, direction)| weight * direction)
        .sum::<DVec3>()
        .try_normalize()
}

#[cfg(test)]
mod tests {
    use super::super::lloyd::angle;
    use super::*;

    #[test]
    fn perturbed_directions_fill_their_cap_evenly() {
        let axis = DVec3::new(0.3, -0.8, 0.5).normalize();
        for radius in [1e-6, 0.01, 1.0, PI] {
            let n = 64;
            let mut inner = 0;
            for index in 0..n * n {
                let uniform = [
                    (f64::from(index % n) + 0.5) / f64::from(n),
                    (f64::from(index / n) + 0.5) / f64::from(n),
                ];
                let distance = angle(axis, in_cap(axis, radius, uniform));
                assert!(distance <= radius * (1.0 + 1e-6), "{distance} > {radius}");
                // The cap of half the solid angle.
                let half = 2.0 * ((0.5 * radius).sin() * 0.5_f64.sqrt()).asin();
                inner += i32::from(distance < half);
            }
            assert_eq!(inner, n * n / 2, "radius {radius}");
        }
    }
}

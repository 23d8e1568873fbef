//! Lloyd's relaxation on the sphere: directions and the elements nearest to each.
//!
//! A direction is moved to the centroid of its cell, normalised: that minimises ∫ ‖L‖ |ω − ωᵢ|² dω over the cell, as the paper does with the
//! average of its samples. Nearest by chord is nearest by angle, so every step lowers one energy, and the relaxation cannot go in circles.
//!
//! Exact in spite of the short cuts: a chunk of elements within a cap of radius r, whose centre is d away from the nearest direction, is
//! compared with the directions within d + 2r of its centre whose border with the nearest one meets the cap; no other can be nearest to any
//! of its elements. A chunk is looked at again only when one of those moved, or another came within d + 2r. Sums are formed chunk by chunk and added in the order of the chunks, so they
//! are the same on any number of threads.
//!
//! Source: T. Kollig and A. Keller, "Efficient Illumination by High Dynamic Range Images", EGSR 2003, section 3.

use std::f64::consts::PI;

use glam::DVec3;
use rayon::prelude::*;

use super::elements::Elements;

/// Shorter means, relative to the light, are no direction: rounding decides them, as for a uniform sphere.
const LEAST_MEAN: f64 = 1e-9;

/// Iterations after which a relaxation is left as it is; real pictures need tens. The rule says which decentration was reached.
const MAX_ITERATIONS: usize = 1000;

/// Light of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Sum {
    /// ∫ ‖L‖ dω.
    pub(super) weight: f64,
    /// ∫ ‖L‖ ω dω.
    pub(super) moment: DVec3,
}

impl Sum {
    /// Where its direction should be; `None` for a dark cell, and where the light has no preferred direction.
    fn centroid(&self) -> Option<DVec3> {
        let length = self.moment.length();
        (length > LEAST_MEAN * self.weight).then(|| self.moment / length)
    }

    /// Root mean square distance of its light from its centroid.
    pub(super) fn radius(&self) -> f64 {
        if self.weight > 0.0 {
            (2.0 * (1.0 - self.moment.length() / self.weight))
                .max(0.0)
                .sqrt()
        } else {
            0.0
        }
    }
}

/// Directions, and the elements nearest to each.
#[derive(Debug)]
pub(super) struct Partition<'e, E> {
    elements: &'e E,
    directions: Vec<DVec3>,
    chunks: Vec<Chunk>,
    sums: Vec<Sum>,
}

/// What is known of a chunk.
#[derive(Clone, Debug)]
struct Chunk {
    /// Cosine of the distance from its centre below which directions matter; above 1 when nothing is known.
    reach: f64,
    /// The directions that matter, ascending, and what each gets of the chunk.
    shares: Vec<(u32, Sum)>,
}

impl<'e, E: Elements> Partition<'e, E> {
    pub(super) fn new(elements: &'e E, directions: Vec<DVec3>) -> Self {
        let mut partition = Self {
            elements,
            sums: vec![Sum::default(); directions.len()],
            directions: Vec::new(),
            chunks: Vec::new(),
        };
        partition.place(directions);
        partition
    }

    pub(super) fn directions(&self) -> &[DVec3] {
        &self.directions
    }

    pub(super) fn into_directions(self) -> Vec<DVec3> {
        self.directions
    }

    pub(super) fn sums(&self) -> &[Sum] {
        &self.sums
    }

    /// The directions that may be nearest to an element of `chunk`, ascending.
    pub(super) fn near(&self, chunk: usize) -> impl Iterator<Item = u32> {
        self.chunks[chunk].shares.iter().map(|&(index, _)| index)
    }

    /// Replaces all directions.
    pub(super) fn place(&mut self, directions: Vec<DVec3>) {
        self.directions = directions;
        let unknown = Chunk {
            reach: 2.0,
            shares: Vec::new(),
        };
        self.chunks = vec![unknown; self.elements.n_chunks()];
        self.update(&[]);
    }

    /// Adds one direction.
    pub(super) fn push(&mut self, direction: DVec3) {
        self.directions.push(direction);
        self.update(&[self.directions.len() as u32 - 1]);
    }

    /// Moves directions to their centroids until none is further away than `threshold`, in radians. Those that are nearer stay.
    pub(super) fn settle(&mut self, threshold: f64) {
        for _ in 0..MAX_ITERATIONS {
            let moved: Vec<u32> = (0..self.directions.len() as u32)
                .filter(|&index| self.miss(index) > threshold)
                .collect();
            if moved.is_empty() {
                return;
            }
            self.step(&moved);
        }
    }

    /// Moves some directions to their centroids.
    pub(super) fn step(&mut self, indices: &[u32]) {
        for &index in indices {
            if let Some(centroid) = self.sums[index as usize].centroid() {
                self.directions[index as usize] = centroid;
            }
        }
        self.update(indices);
    }

    /// By how much a direction misses its centroid, radians.
    fn miss(&self, index: u32) -> f64 {
        self.sums[index as usize]
            .centroid()
            .map_or(0.0, |centroid| {
                angle(self.directions[index as usize], centroid)
            })
    }

    /// Largest angle between a direction and its centroid, radians.
    pub(super) fn decentration(&self) -> f64 {
        (0..self.directions.len() as u32)
            .map(|index| self.miss(index))
            .fold(0.0, f64::max)
    }

    /// The centroids; directions without one stay.
    pub(super) fn centroids(&self) -> Vec<DVec3> {
        self.sums
            .iter()
            .zip(&self.directions)
            .map(|(sum, &direction)| sum.centroid().unwrap_or(direction))
            .collect()
    }

    /// Hands the elements out again where `moved` directions matter.
    fn update(&mut self, moved: &[u32]) {
        let (elements, directions) = (self.elements, &self.directions);
        let mut has_moved = vec![false; directions.len()];
        for &index in moved {
            has_moved[index as usize] = true;
        }
        self.chunks
            .par_iter_mut()
            .enumerate()
            .with_min_len(8)
            .for_each_init(Vec::new, |dots, (index, chunk)| {
                let (centre, radius) = elements.cap(index);
                let concerns = chunk.reach > 1.0
                    || chunk
                        .shares
                        .iter()
                        .any(|&(near, _)| has_moved[near as usize])
                    || moved
                        .iter()
                        .any(|&index| centre.dot(directions[index as usize]) >= chunk.reach);
                if concerns {
                    chunk.find(centre, radius, directions, dots);
                    chunk.share(elements, index, directions);
                }
            });
        self.sums.clear();
        self.sums.resize(directions.len(), Sum::default());
        for &(index, share) in self.chunks.iter().flat_map(|chunk| &chunk.shares) {
            let sum = &mut self.sums[index as usize];
            sum.weight += share.weight;
            sum.moment += share.moment;
        }
    }
}

impl Chunk {
    /// Finds the directions that matter; `dots` is scratch.
    fn find(&mut self, centre: DVec3, radius: f64, directions: &[DVec3], dots: &mut Vec<f64>) {
        /// Rounding of the cosines on both sides. Too large only compares with more directions than needed.
        const SLACK: f64 = 1e-12;
        /// Of the difference of two cosines.
        const ROUNDING: f64 = 1e-15;
        dots.clear();
        dots.extend(directions.iter().map(|direction| centre.dot(*direction)));
        let nearest = nearest(directions, centre);
        let reach = dots[nearest].clamp(-1.0, 1.0).acos() + 2.0 * radius;
        self.reach = if reach < PI {
            reach.cos() - SLACK
        } else {
            -2.0
        };
        let is_narrow = radius < 0.5 * PI;
        let margin = radius.sin();
        self.shares.clear();
        self.shares.extend(
            (0..)
                .zip(&*dots)
                .filter(|&(_, &dot)| dot >= self.reach)
                // Those whose border with the nearest passes by the cap.
                .filter(|&(index, &dot)| {
                    let apart = directions[nearest].distance(directions[index as usize]);
                    !is_narrow || dots[nearest] - dot <= margin * apart + SLACK * apart + ROUNDING
                })
                .map(|(index, _)| (index, Sum::default())),
        );
    }

    /// Gives each element to the nearest of them; the first of equals.
    fn share<E: Elements>(&mut self, elements: &E, index: usize, directions: &[DVec3]) {
        let near: Vec<DVec3> = self
            .shares
            .iter()
            .map(|&(index, _)| directions[index as usize])
            .collect();
        let shares = &mut self.shares;
        elements.visit(index, |direction, weight, moment| {
            let sum = &mut shares[nearest(&near, direction)].1;
            sum.weight += weight;
            sum.moment += moment;
        });
    }
}

/// Index of the direction nearest to `direction`; the first of equals.
pub(super) fn nearest(directions: &[DVec3], direction: DVec3) -> usize {
    let mut nearest = 0;
    let mut most = f64::NEG_INFINITY;
    for (index, other) in directions.iter().enumerate() {
        let dot = direction.dot(*other);
        if dot > most {
            (nearest, most) = (index, dot);
        }
    }
    nearest
}

/// Angle between unit vectors, exact for small ones too.
pub(super) fn angle(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

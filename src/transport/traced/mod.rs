//! The visible part of a light by rays that find outlines, and outlines that give the contour.
//!
//! Rays to a coarse lattice on the light tell where something hides it. From every hidden place that has a visible neighbour the mesh is
//! walked towards the neighbour until it ends: there is an outline edge, and one ray beside it shows whether light comes by. The
//! outline is then followed from edge to edge as far as it lies before the light. The outlines so found are cut up where they cross
//! ([`arrangement`]); every loop that they form bounds either visible light or something hidden, which a ray already cast or one more ray
//! decides. Every piece lies on the 3D edge that generates it, so what is found is exact and has exact derivatives.
//!
//! What can go wrong is that an outline is not found. Therefore the outlines of coarse meshes, and of every connected part of the tile's
//! occluders that may stand before the light but was hit by no ray, are looked up edge by edge. And the contour must be closed and
//! agree with all rays; when it does not, and whenever anything else is doubtful, the receiver is handed over to [`super::exact`].
//! What is left are holes and bulges of a fine mesh that lie between the rays although the rays hit the mesh elsewhere.
//!
//! Only lights that appear as convex quadrilaterals above the horizon are traced.
//!
//! Source: C. Vedel, "Computing Illumination from Area Light Sources by Approximate Contour Integration", Graphics Interface 1993, for
//! tracing the contour of the visible part by rays; the mesh takes the place of its dichotomy and its straight chords.

mod arrangement;
mod mesh;
mod tile;

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use self::arrangement::{Arrangement, Knowledge, Note, Segment};
use self::mesh::Mesh;
pub(super) use self::tile::Tile;
use self::tile::{FEW_TRIANGLES, Neighbour, pyramid};
use super::contour::Piece;
use super::exact::{self, Chain, Inside};
use super::frame::{self, Frame};
use crate::math::Aabb;
use crate::visibility::Visibility;

/// Lattice cells along each side of a light. With 2, a third of the rays miss ten times as much; with 8, three times the rays find what
/// is left, at a fifth of the error.
pub(super) const CELLS: usize = 4;

/// Share of a light by which the result is off on average where a fine mesh stands before it: bulges that the rays pass by. Measured over
/// the floor of the fixture `penumbra`, 1.0e-7; no ray tells it for a single point.
pub(super) const MISSED: f64 = 1e-7;

/// Connected parts before a light above which tracing is not tried. Most parts of a soup are hit by no ray of the lattice, so the
/// rays would be wasted; fewer would give up scenes that 25 rays can still account for.
const MAX_COMPONENTS: usize = 25;

/// Rays for one receiver per lattice point: 200 in all with 4² cells; with more, clipping is cheaper.
const MAX_RAYS: usize = 8;

/// Outline edges for one receiver.
const MAX_SEGMENTS: usize = 4096;

/// How far beside an outline a ray passes, relative to the light (or to the lattice edge). Smaller would come near the rounding of the ray
/// test, 1e-12 for a light at 100 times its size; larger loses gaps that matter at f32.
const BESIDE: f64 = 1e-7;

/// Surfaces behind which a line from hidden to visible comes out to be hidden again, up to which it is followed.
const MAX_SURFACES: usize = 8;

/// How often new outlines may turn up.
const MAX_ROUNDS: usize = 6;

/// Rays end this part of their length before the light: what lies there does not hide it, and the light's plane does not count.
const SHORT_OF_THE_LIGHT: f64 = 1e-9;

/// What tracing finds.
#[derive(Debug)]
pub(super) enum Outcome {
    /// Nothing reaches before the light.
    Open,
    /// The contour of the visible part; empty when the light is hidden.
    Contour(Vec<Piece>),
    /// Not certain: to be clipped exactly.
    Unclear,
}

impl Tile<'_> {
    /// The contour of the part of the light that `receiver` sees, with a start lattice of `cells`² cells, and the rays cast for it.
    ///
    /// - `borders`: the light's contours above the horizon, relative to the receiver.
    /// - `away`: unit normal of the light's plane, pointing away from the receiver.
    /// - `surface`: the light's own triangles, ascending.
    pub(super) fn contour(
        &self,
        receiver: DVec3,
        borders: &[Piece],
        away: DVec3,
        surface: &[u32],
        cells: usize,
    ) -> (Outcome, u32) {
        let quadrilateral = borders.len() == 4 && borders.iter().all(|border| !border.horizon);
        let frame = Frame::new(borders, away, frame::rounding(receiver, borders));
        let (Some(frame), true) = (frame, quadrilateral) else {
            return (Outcome::Unclear, 0);
        };
        let mut tracer = Tracer::new(self, receiver, borders, frame, surface);
        if !tracer.is_convex() {
            return (Outcome::Unclear, 0);
        }
        let before = self.before(receiver, borders);
        if before.is_empty() {
            return (Outcome::Open, 0);
        }
        if before.len() > MAX_COMPONENTS {
            return (Outcome::Unclear, 0);
        }
        tracer.look_at_lattice(cells, &before);
        let outcome = tracer.contour(borders, &before);
        (outcome.unwrap_or(Outcome::Unclear), tracer.rays)
    }
}

/// A point of the light and what is known of it.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Relative to the receiver.
    target: DVec3,
    place: DVec2,
    /// What hides it.
    hit: Option<u32>,
}

/// One receiver at work.
struct Tracer<'a> {
    mesh: Mesh<'a>,
    receiver: DVec3,
    surface: &'a [u32],
    frame: Frame,
    /// Rectangle around the light in the plane.
    low: DVec2,
    high: DVec2,
    rays: u32,
    /// Per connected part whether a ray hit it.
    met: Vec<bool>,
    /// A point of the light that was seen.
    seen_at: Option<DVec3>,
    samples: Vec<Sample>,
    /// Pairs of neighbours, and whether the mesh was walked between them.
    links: Vec<([usize; 2], bool)>,
    /// The light's border first, then outlines.
    segments: Vec<Segment>,
    /// Mesh edges looked at, with the segment that they became.
    visited: BTreeMap<u32, Option<usize>>,
    notes: Vec<Note>,
}

impl<'a> Tracer<'a> {
    fn new(
        tile: &'a Tile<'a>,
        receiver: DVec3,
        borders: &[Piece],
        frame: Frame,
        surface: &'a [u32],
    ) -> Self {
        let places: Vec<DVec2> = borders.iter().map(|border| frame.place(border.a)).collect();
        let low = places.iter().fold(DVec2::INFINITY, |low, p| low.min(*p));
        let high = places
            .iter()
            .fold(DVec2::NEG_INFINITY, |high, p| high.max(*p));
        let count = borders.len();
        let segments = (0..count)
            .map(|index| {
                // Turned round: what lies outside is covered.
                let (p, q) = (places[(index + 1) % count], places[index]);
                let along = (q - p).normalize_or_zero();
                Segment {
                    inside: Inside {
                        ends: [borders[index].b, borders[index].a],
                        depths: [1.0; 2],
                        places: [p, q],
                    },
                    line: DVec3::new(-along.y, along.x, along.y * p.x - along.x * p.y),
                    // Names that no vertex of a mesh has.
                    vertices: [(index + 1) % count, index].map(|end| u32::MAX - 1 - end as u32),
                    ends_there: [true; 2],
                }
            })
            .collect();
        // Outlines must reach over the border to be cut by it.
        let margin = DVec2::splat(1e-3);
        Self {
            mesh: Mesh::new(tile, receiver),
            receiver,
            surface,
            frame,
            low: low - margin,
            high: high + margin,
            rays: 0,
            met: vec![false; tile.boxes.len()],
            seen_at: None,
            samples: Vec::new(),
            links: Vec::new(),
            segments,
            visited: BTreeMap::new(),
            notes: Vec::new(),
        }
    }

    /// Whether the light appears as a convex quadrilateral that is not flat.
    fn is_convex(&self) -> bool {
        self.segments.iter().enumerate().all(|(index, segment)| {
            // The corner opposite to this side, and the one beside it.
            [2, 3].into_iter().all(|step| {
                let place = self.segments[(index + step) % 4].inside.places[1];
                segment.side(place) < -1e-6
            })
        })
    }

    /// What hides the point `target` (relative to the receiver).
    fn look(&mut self, target: DVec3) -> Option<u32> {
        self.rays += 1;
        let distance = target.length();
        let tile = self.mesh.tile;
        let surface = self.surface;
        let hit = tile.occluders.closest(
            self.receiver,
            target / distance,
            distance * (1.0 - SHORT_OF_THE_LIGHT),
            &|triangle| surface.binary_search(&triangle).is_ok(),
        );
        let Some(hit) = hit else {
            self.seen_at = Some(target);
            return None;
        };
        if let Some(place) = tile.place(hit.triangle) {
            self.met[tile.components[place] as usize] = true;
        }
        Some(hit.triangle)
    }

    /// Looks at the corners of `cells`² cells, except where no box of a connected part is in the way.
    fn look_at_lattice(&mut self, cells: usize, before: &[usize]) {
        let corners: Vec<DVec3> = self.segments[..4]
            .iter()
            .map(|segment| segment.inside.ends[1])
            .collect();
        let boxes: Vec<Aabb> = before
            .iter()
            .map(|&component| self.mesh.tile.relative_box(component, self.receiver))
            .collect();
        let step = 1.0 / cells as f64;
        for j in 0..=cells {
            for i in 0..=cells {
                let (u, v) = (i as f64 * step, j as f64 * step);
                let target = (1.0 - v) * ((1.0 - u) * corners[0] + u * corners[1])
                    + v * ((1.0 - u) * corners[3] + u * corners[2]);
                let may_be_hidden = boxes.iter().any(|bounds| is_crossed(bounds, target));
                let hit = if may_be_hidden {
                    self.look(target)
                } else {
                    self.seen_at = Some(target);
                    None
                };
                let here = self.samples.len();
                if i > 0 {
                    self.links.push(([here - 1, here], false));
                }
                if j > 0 {
                    self.links.push(([here - cells - 1, here], false));
                }
                self.samples.push(Sample {
                    target,
                    place: self.frame.place(target),
                    hit,
                });
                self.note_border([i, j], cells, hit.is_some());
            }
        }
    }

    /// Notes a lattice point for the sides of the light that it lies on.
    fn note_border(&mut self, [i, j]: [usize; 2], cells: usize, hidden: bool) {
        let sides = [
            (j == 0, cells - i),
            (i == cells, cells - j),
            (j == cells, i),
            (i == 0, j),
        ];
        let found = Knowledge {
            seen: !hidden,
            hidden,
            covered: false,
        };
        for (side, (lies_on, steps)) in sides.into_iter().enumerate() {
            if lies_on {
                self.notes.push((side, steps as f64 / cells as f64, found));
            }
        }
    }

    /// `None` when it cannot be made out.
    fn contour(&mut self, borders: &[Piece], before: &[usize]) -> Option<Outcome> {
        let sizes = &self.mesh.tile.sizes;
        self.look_up(borders, |component| sizes[component] <= FEW_TRIANGLES)?;
        self.look_between_hidden()?;
        self.find_outlines(false)?;
        if before.iter().any(|&component| !self.met[component]) {
            // They lie between the rays, or behind others.
            let met = self.met.clone();
            self.look_up(borders, |component| !met[component])?;
        }
        if self.segments.len() == borders.len() {
            let all_seen = self.samples.iter().all(|sample| sample.hit.is_none());
            if all_seen {
                return Some(Outcome::Open);
            }
            if self.seen_at.is_none() {
                return Some(Outcome::Contour(Vec::new()));
            }
        }
        let mut thorough = false;
        for _ in 0..MAX_ROUNDS {
            let mut arrangement = Arrangement::new(&self.segments)?;
            for &note in &self.notes {
                arrangement.note(&self.segments, note);
            }
            if self.decide(&mut arrangement)? {
                continue;
            }
            if let Some((pieces, places)) = arrangement.visible(&self.segments)
                && self.agrees_with(&places)
            {
                return Some(Outcome::Contour(pieces));
            }
            if thorough {
                return None;
            }
            thorough = true;
            self.find_outlines(true)?;
        }
        None
    }

    /// Walks from hidden lattice points to their visible neighbours, if `thorough` also where a known outline lies between them.
    fn find_outlines(&mut self, thorough: bool) -> Option<()> {
        for index in 0..self.links.len() {
            let ([a, b], walked) = self.links[index];
            let (seen, hidden) = match [a, b].map(|end| self.samples[end].hit.is_some()) {
                [false, true] => (self.samples[a], self.samples[b]),
                [true, false] => (self.samples[b], self.samples[a]),
                _ => continue,
            };
            if walked || (!thorough && self.is_explained(&seen, &hidden)) {
                continue;
            }
            self.links[index].1 = true;
            self.walk(&seen, &hidden)?;
        }
        Some(())
    }

    /// Whether a known outline runs between two places, covering the second.
    fn is_explained(&self, seen: &Sample, hidden: &Sample) -> bool {
        let along = hidden.place - seen.place;
        self.segments[4..].iter().any(|segment| {
            let [p, q] = segment.inside.places;
            segment.side(hidden.place) > 0.0
                && segment.side(seen.place) < 0.0
                && exact::differ([p, q].map(|end| along.perp_dot(end - seen.place)))
        })
    }

    fn has_cast_enough(&self) -> bool {
        self.rays as usize > MAX_RAYS * self.samples.len()
    }

    /// Walks between hidden neighbours: light may come through a slit.
    fn look_between_hidden(&mut self) -> Option<()> {
        for index in 0..self.links.len() {
            let ([a, b], _) = self.links[index];
            let (a, b) = (self.samples[a], self.samples[b]);
            if a.hit.is_none()
                || b.hit.is_none()
                || (self.is_looked_up(&a) && self.is_looked_up(&b))
            {
                continue;
            }
            if self.walk(&b, &a)? {
                self.walk(&a, &b)?;
            }
        }
        Some(())
    }

    /// Walks from a hidden place towards another one and adds the first outline that light passes by; false when there is none.
    fn walk(&mut self, to: &Sample, from: &Sample) -> Option<bool> {
        let mut triangle = from.hit?;
        for _ in 0..MAX_SURFACES {
            let (edge, s) = self.mesh.leave(triangle, from.target, to.target)?;
            let beside = s + BESIDE;
            let target = from.target + beside * (to.target - from.target);
            if beside >= 1.0 {
                if to.hit.is_some() {
                    return Some(false);
                }
                if s > 1.0 + BESIDE {
                    return None;
                }
            } else if let Some(next) = self.look(target) {
                triangle = next;
                if self.has_cast_enough() {
                    return None;
                }
                continue;
            }
            self.follow(edge)?;
            if let Some(Some(segment)) = self.visited.get(&edge) {
                let t = self.segments[*segment].parameter(self.frame.place(target));
                let seen = Knowledge {
                    seen: true,
                    ..Knowledge::default()
                };
                self.notes.push((*segment, t, seen));
            }
            return Some(true);
        }
        None
    }

    /// Adds the outlines of the connected parts that `wanted` accepts.
    fn look_up(&mut self, borders: &[Piece], wanted: impl Fn(usize) -> bool) -> Option<()> {
        let tile = self.mesh.tile;
        let planes = pyramid(borders);
        for triangle in 0..tile.candidates.len() {
            if !wanted(tile.components[triangle] as usize) {
                continue;
            }
            let corners = tile.corners(triangle).map(|corner| corner - self.receiver);
            let reaches_inside = planes
                .iter()
                .all(|plane| corners.iter().any(|corner| plane.dot(*corner) > 0.0));
            if reaches_inside {
                for edge in tile.sides(triangle) {
                    self.follow(edge)?;
                }
            }
        }
        Some(())
    }

    /// Whether all outlines of what hides a sample were looked up.
    fn is_looked_up(&self, sample: &Sample) -> bool {
        let tile = self.mesh.tile;
        sample
            .hit
            .and_then(|triangle| tile.place(triangle))
            .is_some_and(|place| tile.sizes[tile.components[place] as usize] <= FEW_TRIANGLES)
    }

    /// Adds the outline that `edge` is part of, as far as it lies before the light.
    fn follow(&mut self, edge: u32) -> Option<()> {
        let mut stack = vec![edge];
        while let Some(edge) = stack.pop() {
            if self.visited.contains_key(&edge) {
                continue;
            }
            let segment = self
                .mesh
                .directed(edge)
                .and_then(|(ends, vertices)| self.segment(ends, vertices));
            self.visited
                .insert(edge, segment.is_some().then_some(self.segments.len()));
            let Some(segment) = segment else {
                continue;
            };
            self.segments.push(segment);
            if self.segments.len() > MAX_SEGMENTS {
                return None;
            }
            for end in 0..2 {
                if segment.ends_there[end] {
                    let vertex = segment.vertices[end];
                    self.mesh.for_each_edge_at(vertex, |edge| stack.push(edge));
                }
            }
        }
        Some(())
    }

    /// The part of an outline edge before the light.
    fn segment(&self, ends: [DVec3; 2], vertices: [u32; 2]) -> Option<Segment> {
        let images = ends.map(|end| self.frame.project(end));
        let range = exact::depth_range(images[0].z, images[1].z)?;
        let chain = Chain::new(ends, images, range, vertices, 1)?;
        let inside = chain.clipped(self.low, self.high)?;
        Some(Segment {
            inside,
            line: chain.line,
            vertices,
            ends_there: [0, 1].map(|end| inside.ends[end] == ends[end]),
        })
    }

    /// Looks beside all loops of which nothing is known; true when that brought up new outlines.
    fn decide(&mut self, arrangement: &mut Arrangement) -> Option<bool> {
        let before = self.segments.len();
        for (index, t) in arrangement.unknown(&self.segments) {
            let segment = self.segments[index];
            let [p, q] = segment.inside.places;
            // To the right, which is not covered.
            let place = segment.place(t) - BESIDE * (q - p).normalize_or_zero().perp();
            let is_outside = arrangement::is_outside(&self.segments[..4], place, 0.0);
            let target = self.frame.point(place);
            let hit = if is_outside { None } else { self.look(target) };
            let found = Knowledge {
                covered: is_outside,
                seen: !is_outside && hit.is_none(),
                hidden: hit.is_some(),
            };
            arrangement.note(&self.segments, (index, t, found));
            self.notes.push((index, t, found));
            if let Some(triangle) = hit {
                self.follow_what_hides(triangle, target)?;
            }
            if self.has_cast_enough() {
                return None;
            }
        }
        Some(self.segments.len() > before)
    }

    /// Something unknown hides a place that nothing known covers: adds its outline.
    fn follow_what_hides(&mut self, triangle: u32, target: DVec3) -> Option<()> {
        let Some(seen) = self.seen_at else {
            return Some(());
        };
        let (edge, _) = self.mesh.leave(triangle, target, seen)?;
        self.follow(edge)
    }

    /// Whether the region enclosed by the pieces holds the visible inner lattice points and no hidden ones.
    fn agrees_with(&self, pieces: &[[DVec2; 2]]) -> bool {
        let border = &self.segments[..4];
        let is_inner =
            |sample: &&Sample| !arrangement::is_outside(border, sample.place, arrangement::SAME);
        self.samples.iter().filter(is_inner).all(|sample| {
            let enclosed = frame::turns_around(sample.place, pieces.iter().copied());
            enclosed == i32::from(sample.hit.is_none())
        })
    }
}

/// Whether the segment from the origin to `target` meets a box.
fn is_crossed(bounds: &Aabb, target: DVec3) -> bool {
    let (mut near, mut far) = (0.0, 1.0);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis], bounds.max[axis]);
        if target[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return false;
            }
            continue;
        }
        let [a, b] = [low, high].map(|bound| bound / target[axis]);
        near = f64::max(near, a.min(b));
        far = f64::min(far, a.max(b));
    }
    near <= far
}

#[cfg(test)]
mod tests;

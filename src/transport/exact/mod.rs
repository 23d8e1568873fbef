//! The visible part of a light, exactly: the outlines of the occluders, clipped against the light and against each other.
//!
//! Seen from the receiver every occluding triangle covers a triangle of the light's plane. Wound counter-clockwise there, the triangles
//! add up to a *winding number*: how many of them cover a direction. Sides shared by two triangles that cover the same side cancel, so
//! what is left are the silhouette edges, each with a coefficient. The contour of the visible part consists of the pieces of those edges
//! that have winding number 0 on one side, and of the pieces of the light's own border with winding number 0. Nothing has to be a valid
//! solid: soups, open meshes and overlaps are right as they are, and an error in one winding number changes one piece only.
//!
//! Every piece keeps its two end points *on the 3D edge that generates it*, which is what the derivative needs.
//!
//! Work in the plane of the light is done in coordinates whose unit is the size of the light and whose origin is its centre. Occluder
//! vertices are homogeneous there, `(X, Y, W)` with W the depth over the depth of the light, so that edges that reach behind the receiver
//! need no special case: side tests are 3×3 determinants of unprojected vertices.
//!
//! Source: the light contour of C. Vedel, "Computing Illumination from Area Light Sources by Approximate Contour Integration", Graphics
//! Interface 1993, found by clipping instead of by rays.

mod project;
mod sweep;
mod winding;

use glam::{DVec2, DVec3};

pub(super) use self::project::{Chain, Inside, depth_range};
use self::project::{Eye, Projection};
use self::sweep::{BorderSide, Boxed, Break, Strand, Sweep};
pub(super) use self::sweep::{differ, zero_of};
use self::winding::{Casts, Crosser, Joints, Strips};
use super::contour::Piece;
use super::cost::Work;
use super::frame::{self, Frame};
use super::outline::Outline;

/// Share of the bound on a position's rounding that is its typical error: that of one operation. The bound decides what lies within
/// rounding of what; a claim as large would be a thousand times the error (`tests/estimators.rs`, against extended precision).
pub(super) const TYPICAL_SHIFT: f64 = 1.0 / 64.0;

/// Memory that evaluations reuse.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    projection: Projection,
    crossers: Vec<Crosser>,
    strips: Strips,
    strands: Vec<Strand>,
    order: Vec<u64>,
    boxes: Vec<Boxed>,
    border: Vec<BorderSide>,
    /// As they are found.
    breaks: Vec<Break>,
    on_border: Vec<Break>,
    /// Sorted, and where those of each strand or side start.
    sorted: Vec<Break>,
    starts: Vec<u32>,
    at_vertices: Vec<[u32; 2]>,
    outline: Vec<u32>,
}

/// Contour of the part of a light that `receiver` sees.
///
/// - `receiver`: world metres.
/// - `borders`: the light's contours above the horizon, relative to the receiver.
/// - `away`: unit normal of the light's plane, pointing away from the receiver.
/// - `outline`: everything that may stand in between.
///
/// Appends to `pieces`, in no particular order; nothing when the light is hidden, or seen edge-on within rounding. Returns by how many
/// metres rounding may have moved them.
pub(super) fn visible_contour(
    receiver: DVec3,
    borders: &[Piece],
    away: DVec3,
    outline: &Outline,
    scratch: &mut Scratch,
    pieces: &mut Vec<Piece>,
) -> f64 {
    let rounding = frame::rounding(receiver, borders);
    let Some(frame) = Frame::new(borders, away, rounding) else {
        return rounding;
    };
    let near = 4.0 * rounding * frame.right.length();
    scratch.cut_up(receiver, borders, &frame, outline, near);
    let Scratch {
        projection,
        crossers,
        strips,
        strands,
        border,
        on_border,
        sorted,
        starts,
        at_vertices,
        outline: visited,
        ..
    } = scratch;
    let casts = Casts {
        crossers,
        strips,
        beside: &projection.beside,
        near,
    };
    let mut joints = Joints {
        degrees: &projection.degrees,
        strands: at_vertices,
        outline: visited,
    };
    winding::follow(strands, (starts, sorted), &casts, &mut joints);
    let view = View {
        chain: &projection.chain,
        strands,
        border,
        casts,
    };
    view.occluder_pieces((starts, sorted), pieces);
    sweep::sort(on_border, border.len(), starts, sorted);
    let view = View { border, ..view };
    view.border_pieces(borders, (starts, sorted), pieces);
    rounding
}

impl Scratch {
    /// How many silhouette edges the last receiver had before its light, and in how many places they met.
    pub(super) fn counts(&self) -> [usize; 2] {
        [self.strands.len(), self.breaks.len()]
    }

    /// What there is to do for one receiver; parameters as for [`visible_contour`].
    pub(super) fn work(
        &mut self,
        receiver: DVec3,
        borders: &[Piece],
        away: DVec3,
        outline: &Outline,
    ) -> Option<Work> {
        let rounding = frame::rounding(receiver, borders);
        let frame = Frame::new(borders, away, rounding)?;
        let near = 4.0 * rounding * frame.right.length();
        self.cut_up(receiver, borders, &frame, outline, near);
        let length: f64 = self
            .strands
            .iter()
            .map(|strand| {
                let [p, q] = strand.places;
                p.distance(q)
            })
            .sum();
        let [silhouettes, crossings] = self.counts();
        Some(Work {
            edges: outline.n_edges() as f64,
            silhouettes: silhouettes as f64,
            crossings: crossings as f64,
            // The unit of the plane is half a diagonal of the light.
            length: length * std::f64::consts::FRAC_1_SQRT_2,
        })
    }

    /// Projects everything and finds out where it meets.
    fn cut_up(
        &mut self,
        receiver: DVec3,
        borders: &[Piece],
        frame: &Frame,
        outline: &Outline,
        near: f64,
    ) {
        self.border.clear();
        self.border.extend(
            borders
                .iter()
                .map(|border| BorderSide::new([frame.place(border.a), frame.place(border.b)])),
        );
        let corners = || self.border.iter().flat_map(|side| side.places);
        let eye = Eye {
            receiver,
            frame,
            low: corners().fold(DVec2::INFINITY, DVec2::min) - near,
            high: corners().fold(DVec2::NEG_INFINITY, DVec2::max) + near,
        };
        self.projection.fill(&eye, outline);
        let chain = &self.projection.chain;
        self.crossers.clear();
        self.crossers.extend(chain.iter().map(Crosser::new));
        self.strips.fill(&self.crossers, eye.low, eye.high);
        self.strands.clear();
        let strands = chain.iter().enumerate();
        self.strands.extend(
            strands.filter_map(|(index, edge)| Strand::new(index, edge, eye.low, eye.high)),
        );
        self.breaks.clear();
        self.on_border.clear();
        let mut sweep = Sweep {
            strands: &mut self.strands,
            breaks: &mut self.breaks,
            near,
        };
        sweep.cross_strands(&mut self.order, &mut self.boxes);
        sweep.cross_border(&mut self.border, chain, &mut self.on_border);
        let n_strands = self.strands.len();
        sweep::sort(&self.breaks, n_strands, &mut self.starts, &mut self.sorted);
    }
}

/// The light's plane with everything in it.
struct View<'a> {
    chain: &'a [Chain],
    strands: &'a [Strand],
    border: &'a [BorderSide],
    casts: Casts<'a>,
}

impl View<'_> {
    /// Pieces of occluder edges: inside the light, with nothing covering one side.
    fn occluder_pieces(&self, (starts, breaks): (&[u32], &[Break]), pieces: &mut Vec<Piece>) {
        for (index, strand) in self.strands.iter().enumerate() {
            let own = &breaks[starts[index] as usize..starts[index + 1] as usize];
            let [p, q] = strand.places;
            let (mut inside, mut lies_inside) = (None, None);
            sweep::for_each_interval(own, strand.right.unwrap_or_default(), |from, to, right| {
                let middle = p + 0.5 * (from + to) * (q - p);
                let Some(visible_left) = self.visible_side(strand, middle, right) else {
                    return;
                };
                // Where it does not meet the border one place speaks for all of it.
                if strand.meets_border || lies_inside.is_none() {
                    lies_inside = Some(self.is_inside_light(middle));
                }
                if lies_inside != Some(true) {
                    return;
                }
                let part = inside
                    .get_or_insert_with(|| self.chain[strand.chain as usize].part(strand.range));
                let (from, to) = if visible_left { (from, to) } else { (to, from) };
                pieces.push(Piece {
                    a: part.point(from),
                    b: part.point(to),
                    horizon: false,
                });
            });
        }
    }

    /// Whether a strand bounds the visible region at `middle`, and if so, whether that lies on its left. `right`: coverings on its right,
    /// unless rounding decides about it.
    fn visible_side(&self, strand: &Strand, middle: DVec2, right: i32) -> Option<bool> {
        let [p, q] = strand.places;
        let (left, right) = if strand.is_delicate {
            let own = strand.chain as usize;
            let winding = self.casts.winding(middle, q - p, Some(own));
            // Of several edges on the same line the first speaks for all.
            if winding.first != Some(own) {
                return None;
            }
            (winding.left(), winding.right)
        } else {
            (right + strand.coefficient, right)
        };
        match (left, right) {
            (0, right) if right != 0 => Some(true),
            (left, 0) if left != 0 => Some(false),
            _ => None,
        }
    }

    /// Pieces of the light's own border that nothing covers.
    fn border_pieces(
        &self,
        borders: &[Piece],
        (starts, breaks): (&[u32], &[Break]),
        pieces: &mut Vec<Piece>,
    ) {
        for (index, (border, side)) in borders.iter().zip(self.border).enumerate() {
            let [p, q] = side.places;
            if p == q {
                continue;
            }
            let own = &breaks[starts[index] as usize..starts[index + 1] as usize];
            // Just inside the light is on the left.
            let coverings = |t: f64| self.casts.winding(p + t * (q - p), q - p, None).left();
            let at_start = if side.is_delicate {
                0
            } else {
                let (middle, so_far) = sweep::longest_interval(own);
                coverings(middle) - so_far
            };
            sweep::for_each_interval(own, at_start, |from, to, counted| {
                let covered = if side.is_delicate {
                    coverings(0.5 * (from + to))
                } else {
                    counted
                };
                if covered == 0 {
                    let at = |t: f64| border.a + t * (border.b - border.a);
                    pieces.push(Piece {
                        a: at(from),
                        b: at(to),
                        horizon: border.horizon,
                    });
                }
            });
        }
    }

    /// Whether a place lies inside the light and not on its border within rounding.
    fn is_inside_light(&self, place: DVec2) -> bool {
        let near = self.casts.near;
        let is_on_border = self.border.iter().any(|side| side.is_near(place, near));
        !is_on_border && frame::turns_around(place, self.border.iter().map(|side| side.places)) > 0
    }
}

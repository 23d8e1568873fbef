//! Traced lines and the border of the light: which parts of either bound what is seen.
//!
//! The border is known exactly and only has to be cut where the traced contour meets it. The lattice spans a parallelogram around what is
//! above the horizon, so a light that fills it is cut at the crossings on the sides of the border squares, as in the paper; other
//! polygons cut the traced lines as well. Every decision is the sign of one determinant that all neighbours of a corner share, so
//! that contours stay closed.

use glam::DVec2;

use super::lattice::Line;

/// The traced contour, to ask on which side of it a place is.
pub(super) struct Traced {
    /// The lines, and from where they end on the border of the lattice one step outwards.
    segments: Vec<[DVec2; 2]>,
    /// Whether the corner (0, 0) of the lattice is seen.
    corner: bool,
}

impl Traced {
    pub(super) fn new(lines: &[Line], side: f64, corner: bool) -> Self {
        let mut segments: Vec<[DVec2; 2]> = Vec::with_capacity(2 * lines.len());
        for line in lines {
            let ends = line.ends.map(|end| end.at);
            segments.push(ends);
            for end in ends {
                // Without this a border that runs along the lattice's own would touch ends instead of crossing lines.
                let outwards = end.cmpge(DVec2::splat(side));
                let inwards = end.cmple(DVec2::ZERO);
                let step = DVec2::select(outwards, DVec2::ONE, DVec2::ZERO)
                    - DVec2::select(inwards, DVec2::ONE, DVec2::ZERO);
                if step != DVec2::ZERO {
                    segments.push([end, end + step]);
                }
            }
        }
        Self { segments, corner }
    }

    /// Calls `keep` with the parameters of each visible part of a side of the light.
    pub(super) fn for_each_visible_part(&self, side: [DVec2; 2], mut keep: impl FnMut(f64, f64)) {
        for_each_part(side, &self.segments, |start, end, middle| {
            if self.is_visible(middle) {
                keep(start, end);
            }
        });
    }

    fn is_visible(&self, place: DVec2) -> bool {
        let way = [DVec2::ZERO, place];
        let n_crossed = self
            .segments
            .iter()
            .filter(|segment| crossing(way, **segment).is_some())
            .count();
        self.corner == n_crossed.is_multiple_of(2)
    }
}

/// Calls `keep` with the parameters of each part of `line` inside the light of this border.
pub(super) fn for_each_inner_part(
    line: [DVec2; 2],
    border: &[[DVec2; 2]],
    mut keep: impl FnMut(f64, f64),
) {
    for_each_part(line, border, |start, end, middle| {
        if winding(border, middle) != 0 {
            keep(start, end);
        }
    });
}

/// Calls `visit` with the ends and the middle of each part between two crossings with `others`.
fn for_each_part(
    segment: [DVec2; 2],
    others: &[[DVec2; 2]],
    mut visit: impl FnMut(f64, f64, DVec2),
) {
    let mut breaks = vec![0.0, 1.0];
    breaks.extend(others.iter().filter_map(|other| crossing(segment, *other)));
    breaks.sort_unstable_by(f64::total_cmp);
    let [from, to] = segment;
    for pair in breaks.windows(2) {
        let (start, end) = (pair[0], pair[1]);
        if start < end {
            visit(start, end, from + 0.5 * (start + end) * (to - from));
        }
    }
}

/// The parameter at which a segment crosses another one. Zero counts as negative everywhere, so a line through a corner crosses one of
/// its two sides or none or both, as it changes sides.
fn crossing(segment: [DVec2; 2], other: [DVec2; 2]) -> Option<f64> {
    let at_ends = segment.map(|place| side(other, place));
    let at_other = other.map(|place| side(segment, place));
    (differ(at_ends) && differ(at_other))
        .then(|| (at_ends[0] / (at_ends[0] - at_ends[1])).clamp(0.0, 1.0))
}

fn differ([a, b]: [f64; 2]) -> bool {
    (a > 0.0) != (b > 0.0)
}

fn side([a, b]: [DVec2; 2], place: DVec2) -> f64 {
    (b - a).perp_dot(place - a)
}

fn winding(border: &[[DVec2; 2]], place: DVec2) -> i32 {
    border
        .iter()
        .filter(|[a, b]| (a.y <= place.y) != (b.y <= place.y))
        .map(|[a, b]| {
            let upwards = b.y > a.y;
            let to_the_right = (side([*a, *b], place) > 0.0) == upwards;
            i32::from(to_the_right) * if upwards { 1 } else { -1 }
        })
        .sum()
}

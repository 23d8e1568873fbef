//! Borders of a domain: closed loops around the squares that hang together, with as few corners as they need.

use std::collections::BTreeMap;

use glam::DVec2;

use super::domain::Domain;

/// How far in cells a point may lie off the simplified border. Points beyond it are extrapolated over this distance: a quarter of a cell
/// keeps that harmless, and a straight border without corners that only rounding made.
const STRAIGHT: f64 = 0.25;

/// The squares of a domain that are surface.
#[derive(Debug)]
pub(super) struct Squares {
    origin: [i32; 2],
    width: usize,
    /// Row after row, as [`Domain::square`] gives them.
    held: Vec<u8>,
}

impl Squares {
    pub(super) fn new(domain: &Domain) -> Self {
        let (origin, [width, height]) = domain.extent();
        let [left, top] = origin;
        let held = (0..height as i32)
            .flat_map(|y| (0..width as i32).map(move |x| [left + x, top + y]))
            .map(|cell| domain.square(cell))
            .collect();
        Self {
            origin,
            width,
            held,
        }
    }

    fn held(&self, [x, y]: [i32; 2]) -> u8 {
        let [x, y] = [x - self.origin[0], y - self.origin[1]];
        if x < 0 || y < 0 || x as usize >= self.width {
            return 0;
        }
        self.held
            .get(y as usize * self.width + x as usize)
            .copied()
            .unwrap_or(0)
    }

    /// Whether a place, in cells, lies in a square that is surface.
    pub(super) fn hold(&self, place: DVec2) -> bool {
        let cell = (place - 0.5).floor().as_ivec2();
        self.held(cell.to_array()) != 0
    }

    /// Points that belong to no square.
    pub(super) fn loose(&self, domain: &Domain) -> Vec<u32> {
        (0..domain.points().len())
            .filter(|&point| {
                let [x, y] = domain.points()[point].cell.map(i32::from);
                let is_here = domain.at([x, y]) == Some(point);
                // Its place as a corner of the four squares that may have it.
                let corners = [
                    ([x, y], 1),
                    ([x - 1, y], 2),
                    ([x - 1, y - 1], 4),
                    ([x, y - 1], 8),
                ];
                !is_here
                    || corners
                        .iter()
                        .all(|&(square, bit)| self.held(square) & bit == 0)
            })
            .map(|point| point as u32)
            .collect()
    }

    /// The borders as loops of points, surface always on the same side, without their simplification.
    pub(super) fn loops(&self, domain: &Domain) -> Vec<Vec<usize>> {
        // Where border pieces lead: a point where two loops touch has two.
        let mut next: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (index, &held) in self.held.iter().enumerate().filter(|(_, held)| **held != 0) {
            let x = self.origin[0] + (index % self.width) as i32;
            let y = self.origin[1] + (index / self.width) as i32;
            let full = |cell| self.held(cell) == 0b1111;
            if held == 0b1111
                && full([x, y - 1])
                && full([x + 1, y])
                && full([x, y + 1])
                && full([x - 1, y])
            {
                continue;
            }
            let cells = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
            // The square across each side, and its two corners on it.
            let across = [
                ([x, y - 1], 0b1100),
                ([x + 1, y], 0b1001),
                ([x, y + 1], 0b0011),
                ([x - 1, y], 0b0110),
            ];
            let corners: Vec<usize> = (0..4).filter(|k| held & (1 << k) != 0).collect();
            for (place, &from) in corners.iter().enumerate() {
                let to = corners[(place + 1) % corners.len()];
                let is_side = to == (from + 1) % 4;
                let (neighbour, shared) = across[from];
                if is_side && self.held(neighbour) & shared == shared {
                    continue;
                }
                if let (Some(from), Some(to)) = (domain.at(cells[from]), domain.at(cells[to])) {
                    next.entry(from).or_default().push(to);
                }
            }
        }
        let mut loops = Vec::new();
        while let Some((&start, _)) = next.first_key_value() {
            let mut border = vec![start];
            let mut here = start;
            while let Some(ways) = next.get_mut(&here) {
                let way = ways.pop();
                if ways.is_empty() {
                    next.remove(&here);
                }
                match way {
                    Some(way) if way != start => {
                        border.push(way);
                        here = way;
                    }
                    _ => break,
                }
            }
            loops.push(border);
        }
        loops
    }
}

/// The points of a loop that give its shape, at least every `spacing` of them in number, in order.
pub(super) fn simplified(domain: &Domain, border: &[usize]) -> Vec<usize> {
    let n = border.len();
    if n < 3 {
        return border.to_vec();
    }
    let place = |index: usize| domain.points()[border[index % n]].place;
    // Two points far apart keep their place; each half is simplified on its own.
    let far = (0..n)
        .max_by(|&a, &b| {
            let distance = |index| place(index).distance_squared(place(0));
            distance(a).total_cmp(&distance(b)).then(b.cmp(&a))
        })
        .unwrap_or(0);
    let mut kept = vec![false; n + 1];
    kept[0] = true;
    kept[far] = true;
    let mut open = vec![(0, far), (far, n)];
    while let Some((first, last)) = open.pop() {
        let (a, b) = (place(first), place(last));
        let spacing = f64::from(domain.points()[border[first % n]].spacing.max(1));
        let worst = (first + 1..last)
            .map(|index| (distance_to_segment(place(index), a, b), index))
            .max_by(|x, y| x.0.total_cmp(&y.0).then(y.1.cmp(&x.1)));
        let Some((distance, index)) = worst else {
            continue;
        };
        let split = if distance > STRAIGHT {
            index
        } else if a.distance(b) > 1.5 * spacing {
            // A straight piece: halves of it, so that its parts are alike.
            usize::midpoint(first, last)
        } else {
            continue;
        };
        kept[split] = true;
        open.push((first, split));
        open.push((split, last));
    }
    (0..n)
        .filter(|&index| kept[index])
        .map(|index| border[index])
        .collect()
}

fn distance_to_segment(point: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = b - a;
    let square = along.length_squared();
    let share = if square > 0.0 {
        ((point - a).dot(along) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    point.distance(a + share * along)
}

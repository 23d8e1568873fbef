//! Joins pieces that lie in one plane, touch along whole edges and shine alike into polygons.
//!
//! A region grows from its largest piece over matching edges, nearest pieces first, and takes what lies in the plane of all it has
//! already. That plane is fitted again with every piece: the plane of one small triangle with rounded vertices says little about a
//! large floor, the plane of a thousand of them does.
//!
//! Edges match when their ends have exactly the same coordinates. Where a level is cut so that a vertex lies within another triangle's
//! edge, pieces may stay apart, which costs time and no accuracy: both polygons have the edge, in opposite directions.
//!
//! Time is n log n: vertices and edges are matched by sorting.

use std::collections::VecDeque;

use glam::DVec3;

use super::Polygon;
use super::contour;
use super::emission::position_key;
use super::split::Piece;

/// How far a vertex may be off the plane of the region it joins, in units of the vertex's [`Piece::uncertainty`].
///
/// Rounding to the nearest `f32` alone moves a vertex by up to √3 and the plane by about as much; programs that turned an object before
/// writing it add several units more. Smaller leaves large tessellated lamps in pieces, which is slow; larger flattens lamps that are
/// slightly bent: at 16 a lamp of 1 m loses a bend of 1 µm.
const FLATNESS: f64 = 16.0;

/// How far a vertex may be off the line of its neighbours to be left out, in the same units. Only what rounding to the nearest `f32`
/// explains: every vertex left out changes the area.
const STRAIGHTNESS: f64 = 4.0;

/// Triangles at one edge up to which every pair is tried. More than two meet where surfaces cross or lie on each other; without a bound
/// a fan of thousands on one edge would take their number squared.
const MAX_FAN: usize = 8;

/// A piece with its place in the web of all pieces.
struct Web {
    /// `corners[piece]` are its vertices by number, equal positions having equal numbers: three, and more where neighbours were cut
    /// finer.
    corners: Vec<Vec<u32>>,
    positions: Vec<DVec3>,
    /// Pairs of pieces that shine alike and meet at an edge, in both orders, sorted.
    neighbours: Vec<(u32, u32)>,
}

/// A growing set of pieces and the plane through them.
#[derive(Clone, Copy, Debug, Default)]
struct Region {
    /// Sum of the pieces' area vectors, twice over.
    area_vector: DVec3,
    /// Sum of area × centroid, relative to `origin`, twice over.
    moment: DVec3,
    area: f64,
    origin: DVec3,
    uncertainty: f64,
}

/// Polygons of all `pieces`, in the order of their first surface.
pub(super) fn polygons(pieces: &[Piece]) -> Vec<Polygon> {
    let web = Web::of(pieces);
    let mut order: Vec<u32> = (0..pieces.len() as u32).collect();
    let areas: Vec<f64> = pieces
        .iter()
        .map(|piece| area_vector(&piece.vertices).length())
        .collect();
    order.sort_by(|&a, &b| areas[b as usize].total_cmp(&areas[a as usize]));
    let mut taken = vec![false; pieces.len()];
    let mut regions: Vec<Vec<u32>> = Vec::new();
    for seed in order {
        if taken[seed as usize] {
            continue;
        }
        let (mut members, plane) = grow(seed, pieces, &web, &mut taken);
        members.sort_unstable();
        if members
            .iter()
            .all(|&member| plane.holds(&pieces[member as usize]))
        {
            regions.push(members);
        } else {
            // A band that bends by less than rounding from piece to piece has dragged the plane along with it.
            regions.extend(members.into_iter().map(|member| vec![member]));
        }
    }
    // Pieces are ordered by surface.
    regions.sort_unstable_by_key(|region| region[0]);
    regions
        .iter()
        .map(|region| polygon(region, pieces, &web))
        .collect()
}

/// Pieces that can be reached from `seed` within one plane, and that plane.
fn grow(seed: u32, pieces: &[Piece], web: &Web, taken: &mut [bool]) -> (Vec<u32>, Region) {
    let mut plane = Region::at(&pieces[seed as usize]);
    let mut members = vec![seed];
    let mut queue = VecDeque::from([seed]);
    taken[seed as usize] = true;
    while let Some(piece) = queue.pop_front() {
        for neighbour in web.neighbours_of(piece) {
            let candidate = &pieces[neighbour as usize];
            if !taken[neighbour as usize] && plane.holds(candidate) {
                taken[neighbour as usize] = true;
                plane.add(candidate);
                members.push(neighbour);
                queue.push_back(neighbour);
            }
        }
    }
    (members, plane)
}

fn polygon(region: &[u32], pieces: &[Piece], web: &Web) -> Polygon {
    let first = &pieces[region[0] as usize];
    let mut area_sum = DVec3::ZERO;
    let mut area = 0.0;
    let mut uncertainty: f64 = 0.0;
    let mut triangles = Vec::with_capacity(region.len());
    let mut surface = Vec::with_capacity(region.len());
    for &member in region {
        let piece = &pieces[member as usize];
        let twice = area_vector(&piece.vertices);
        area_sum += twice;
        area += 0.5 * twice.length();
        uncertainty = uncertainty.max(piece.uncertainty);
        triangles.push(piece.vertices);
        surface.push(piece.surface);
    }
    surface.dedup();
    let normal = area_sum.normalize_or_zero();
    let loops: Vec<&[u32]> = region
        .iter()
        .map(|&member| web.corners[member as usize].as_slice())
        .collect();
    Polygon {
        contours: contour::outline(&loops, &web.positions, normal, STRAIGHTNESS * uncertainty),
        triangles,
        normal,
        area,
        radiance: first.radiance,
        two_sided: first.two_sided,
        surface,
    }
}

impl Region {
    fn at(piece: &Piece) -> Self {
        let mut region = Self {
            origin: piece.vertices[0],
            ..Self::default()
        };
        region.add(piece);
        region
    }

    fn add(&mut self, piece: &Piece) {
        let area_vector = area_vector(&piece.vertices);
        let area = area_vector.length();
        let [a, b, c] = piece.vertices.map(|vertex| vertex - self.origin);
        self.area_vector += area_vector;
        self.area += area;
        self.moment += area / 3.0 * (a + b + c);
        self.uncertainty = self.uncertainty.max(piece.uncertainty);
    }

    /// Whether `piece` faces the same way and its vertices lie in the plane.
    fn holds(&self, piece: &Piece) -> bool {
        let normal = self.area_vector.normalize_or_zero();
        let centre = self.moment / self.area;
        let tolerance = FLATNESS * self.uncertainty.max(piece.uncertainty);
        normal.dot(area_vector(&piece.vertices)) > 0.0
            && piece
                .vertices
                .iter()
                .all(|&vertex| normal.dot(vertex - self.origin - centre).abs() <= tolerance)
    }
}

impl Web {
    fn of(pieces: &[Piece]) -> Self {
        let (mut corners, positions) = welded(pieces);
        insert_middles(pieces, &mut corners, &positions);
        let kinds = kinds(pieces);
        // Every edge, by its ends in ascending order, its kind, and whether it runs forwards.
        let mut edges = Vec::with_capacity(3 * pieces.len());
        for (piece, corners) in corners.iter().enumerate() {
            for (index, &a) in corners.iter().enumerate() {
                let b = corners[(index + 1) % corners.len()];
                edges.push((a.min(b), a.max(b), kinds[piece], a > b, piece as u32));
            }
        }
        edges.sort_unstable();
        let mut neighbours = Vec::with_capacity(edges.len());
        for run in edges.chunk_by(|p, q| (p.0, p.1, p.2) == (q.0, q.1, q.2)) {
            let (forwards, backwards) = run.split_at(run.partition_point(|edge| !edge.3));
            let mut meet = |p: u32, q: u32| neighbours.extend([(p, q), (q, p)]);
            if run.len() <= MAX_FAN {
                for p in forwards {
                    backwards.iter().for_each(|q| meet(p.4, q.4));
                }
            } else {
                forwards
                    .iter()
                    .zip(backwards)
                    .for_each(|(p, q)| meet(p.4, q.4));
            }
        }
        neighbours.sort_unstable();
        Self {
            corners,
            positions,
            neighbours,
        }
    }

    fn neighbours_of(&self, piece: u32) -> impl Iterator<Item = u32> {
        let start = self.neighbours.partition_point(|pair| pair.0 < piece);
        self.neighbours[start..]
            .iter()
            .take_while(move |pair| pair.0 == piece)
            .map(|pair| pair.1)
    }
}

/// Numbers equal positions equally: the corners of each piece, and the position of each number, ascending by [`position_key`].
fn welded(pieces: &[Piece]) -> (Vec<Vec<u32>>, Vec<DVec3>) {
    let mut places: Vec<([u64; 3], u32)> = pieces
        .iter()
        .flat_map(|piece| piece.vertices)
        .enumerate()
        .map(|(place, position)| (position_key(position), place as u32))
        .collect();
    places.sort_unstable();
    let mut corners = vec![vec![0; 3]; pieces.len()];
    let mut positions = Vec::new();
    for run in places.chunk_by(|p, q| p.0 == q.0) {
        for &(_, place) in run {
            corners[place as usize / 3][place as usize % 3] = positions.len() as u32;
        }
        positions.push(DVec3::from_array(run[0].0.map(f64::from_bits)));
    }
    (corners, positions)
}

/// Adds the vertices that cutting a neighbour put in the middle of an edge, again and again.
fn insert_middles(pieces: &[Piece], corners: &mut [Vec<u32>], positions: &[DVec3]) {
    if !pieces.iter().any(|piece| piece.part) {
        return;
    }
    let number = |position: DVec3| {
        let key = position_key(position);
        positions
            .binary_search_by(|other| position_key(*other).cmp(&key))
            .ok()
            .map(|number| number as u32)
    };
    for corners in corners {
        let mut index = 0;
        while index < corners.len() {
            let (a, b) = (corners[index], corners[(index + 1) % corners.len()]);
            let middle = 0.5 * (positions[a as usize] + positions[b as usize]);
            match number(middle) {
                Some(middle) if middle != a && middle != b => corners.insert(index + 1, middle),
                _ => index += 1,
            }
        }
    }
}

/// A number for everything that must be equal within a polygon: material and radiance.
fn kinds(pieces: &[Piece]) -> Vec<u32> {
    let kind = |piece: &Piece| (piece.material, position_key(piece.radiance));
    let mut all: Vec<_> = pieces.iter().map(kind).collect();
    let of_pieces = all.clone();
    all.sort_unstable();
    all.dedup();
    of_pieces
        .iter()
        .map(|kind| all.partition_point(|other| other < kind) as u32)
        .collect()
}

/// Twice the area times the front normal.
fn area_vector(vertices: &[DVec3; 3]) -> DVec3 {
    let [a, b, c] = *vertices;
    (b - a).cross(c - a)
}

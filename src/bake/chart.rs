//! The texels of one chart as the domain of a quantity that is smooth on it, except at creases.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use super::spacing::SPACING;
use crate::error::Result;
use crate::refine::{Domain, Point};
use crate::texels::{Texel, Texels};

/// Cosine of the angle between the normals of neighbouring texels up to which the surface goes on: 26°. A ball of 16 texels around goes on,
/// a bevelled edge is a crease.
const SMOOTH: f64 = 0.9;

/// How far from where its neighbour's tangent map puts it a texel may lie, in texels. Larger would join texels on both sides of a wall.
const NEAR: f64 = 0.5;

/// Largest distance on the chart between neighbouring texels.
const ADJACENT: f64 = 1.75;

/// Side in texels of the squares that are looked at as one to find out how far apart texels may be evaluated at first: smaller ones are
/// looked at more often than it is worth, larger ones let a thin thing near one corner make the whole square dense.
const LOOK: u16 = 32;

/// Texels of a square that are looked at along each side.
const LOOKED_AT: usize = 5;

/// How far apart the texels of a square may be evaluated at first, in texels; gets all of them, and some that reach to all sides.
pub(super) type Lookout<'s> = dyn Fn(&[&Texel], &[&Texel]) -> Vec<u16> + Sync + 's;

/// Texels of a page that belong to one chart of one placement.
pub(super) struct Chart<'a> {
    texels: &'a [Texel],
    /// Indices in the page's texels, row after row.
    pub(super) members: Vec<u32>,
    pub(super) domain: Domain,
    /// Change of the normal per texel to the right and down; empty where the chart is flat.
    normal_slopes: Vec<[DVec3; 2]>,
}

impl<'a> Chart<'a> {
    /// The charts of a page.
    pub(super) fn all(texels: &'a Texels, lookout: &Lookout<'_>) -> Result<Vec<Self>> {
        let mut members: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
        for tile in &texels.tiles {
            members
                .entry((tile.placement, tile.chart))
                .or_default()
                .extend(tile.texels.clone().map(|texel| texel as u32));
        }
        members
            .into_values()
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|members| Self::new(&texels.texels, members, lookout))
            .collect()
    }

    fn new(texels: &'a [Texel], mut members: Vec<u32>, lookout: &Lookout<'_>) -> Result<Self> {
        let of = |member: u32| &texels[member as usize];
        members.sort_by_key(|&member| (of(member).y, of(member).x));
        let points = members
            .iter()
            .map(|&member| {
                let texel = of(member);
                Point {
                    cell: [texel.x, texel.y],
                    place: texel.place,
                    joined: [true; 2],
                    spacing: SPACING,
                }
            })
            .collect();
        let domain = Domain::new(points)?
            .joined_where(|a, b| goes_on(of(members[a]), of(members[b])))
            .spaced_by(LOOK, |square| {
                let texels = |points: &[usize]| -> Vec<&Texel> {
                    points.iter().map(|&point| of(members[point])).collect()
                };
                lookout(&texels(square), &texels(&spread(square)))
            });
        let mut chart = Self {
            texels,
            members,
            domain,
            normal_slopes: Vec::new(),
        };
        let first = chart.texel(0).normal;
        if chart
            .members
            .iter()
            .any(|&member| of(member).normal != first)
        {
            chart.normal_slopes = (0..chart.members.len())
                .map(|point| chart.normal_slope(point))
                .collect();
        }
        Ok(chart)
    }

    /// The texel of a point of the domain.
    pub(super) fn texel(&self, point: usize) -> &'a Texel {
        &self.texels[self.members[point] as usize]
    }

    /// Change of the normal per texel to the right and down.
    pub(super) fn normal_slopes(&self, point: usize) -> [DVec3; 2] {
        self.normal_slopes.get(point).copied().unwrap_or_default()
    }

    fn normal_slope(&self, point: usize) -> [DVec3; 2] {
        let here = &self.domain.points()[point];
        [0, 1].map(|axis| {
            let step = |by: i32| {
                let mut cell = here.cell.map(i32::from);
                cell[axis] += by;
                self.domain.at(cell)
            };
            let joined = |point: Option<usize>| {
                point.is_some_and(|point| self.domain.points()[point].joined[axis])
            };
            let before = step(-1).filter(|&before| joined(Some(before)));
            let after = step(1).filter(|_| here.joined[axis]);
            let (from, to) = (before.unwrap_or(point), after.unwrap_or(point));
            let places = [from, to].map(|point| self.domain.points()[point].place[axis]);
            let way = places[1] - places[0];
            if way > 0.25 {
                (self.texel(to).normal - self.texel(from).normal) / way
            } else {
                DVec3::ZERO
            }
        })
    }
}

/// Whether light goes on smoothly from one texel to the next.
fn goes_on(a: &Texel, b: &Texel) -> bool {
    let way = b.place - a.place;
    let expected = (0.5 * way.x) * (a.du + b.du) + (0.5 * way.y) * (a.dv + b.dv);
    let step = a.du.length().max(a.dv.length());
    a.normal.dot(b.normal) >= SMOOTH
        && way.length() <= ADJACENT
        && (b.position - a.position).distance(expected) <= NEAR * step
}

/// Some points of a square that reach to all of its sides; `square` holds them row after row.
fn spread(square: &[usize]) -> Vec<usize> {
    let n = square.len();
    let side = (n as f64).sqrt().ceil() as usize;
    let step = (side / (LOOKED_AT - 1)).max(1);
    let mut chosen: Vec<usize> = (0..n)
        .filter(|place| {
            let (row, column) = (place / side, place % side);
            let on = |k: usize| k.is_multiple_of(step) || k + 1 == side;
            on(row) && on(column)
        })
        .map(|place| square[place])
        .collect();
    chosen.extend(square.first());
    chosen.extend(square.last());
    chosen
}

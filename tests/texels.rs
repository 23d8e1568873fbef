//! Every texel that a lookup can read knows its place in the world.

#![expect(clippy::print_stdout, reason = "says what was skipped")]

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DQuat, DVec2, DVec3};
use lumel::atlas::{Atlas, NO_CHART, Options, Uv};
use lumel::scene::{self, Material, Scene};
use lumel::texels::{self, Obstacle, TILE, Texels};

use crate::atlas::{build, cube, grid, instances};
use crate::support::{Rng, quad, scene_of, shared_scenes};

fn options(texels_per_metre: f64) -> Options {
    Options {
        texels_per_metre,
        uv: Uv::Unwrap,
        ..Options::default()
    }
}

fn cover(scene: &Scene, options: &Options) -> (Atlas, Vec<Texels>) {
    let atlas = build(scene, options);
    let pages: Vec<Texels> = (0..atlas.pages.len())
        .map(|page| texels::cover(scene, &atlas, page))
        .collect();
    for page in &pages {
        check(page);
    }
    (atlas, pages)
}

/// Tiles and values of a page are what their documentation says.
fn check(page: &Texels) {
    let key = |tile: &texels::Tile| {
        let first = &page.texels[tile.texels.start];
        (
            u32::from(first.y) / TILE,
            u32::from(first.x) / TILE,
            tile.placement,
            tile.chart,
        )
    };
    assert!(
        page.tiles.is_sorted_by(|a, b| key(a) < key(b)),
        "tiles are in order"
    );
    let mut next = 0;
    for tile in &page.tiles {
        assert_eq!(tile.texels.start, next, "tiles follow each other");
        next = tile.texels.end;
        let members = &page.texels[tile.texels.clone()];
        assert!(
            members.is_sorted_by(|a, b| (a.y, a.x) < (b.y, b.x)),
            "rows, then columns"
        );
        let block = |texel: &texels::Texel| (u32::from(texel.x) / TILE, u32::from(texel.y) / TILE);
        assert!(
            members
                .iter()
                .all(|texel| block(texel) == block(&members[0]))
        );
    }
    assert_eq!(next, page.texels.len(), "every texel is in a tile");
    let mut places: Vec<(u16, u16)> = page.texels.iter().map(|t| (t.y, t.x)).collect();
    places.sort_unstable();
    assert!(places.is_sorted_by(|a, b| a < b), "every texel once");
    for texel in &page.texels {
        assert!(u32::from(texel.x) < page.width && u32::from(texel.y) < page.height);
        assert!(texel.position.is_finite() && texel.du.is_finite() && texel.dv.is_finite());
        assert!(texel.geometric_normal.is_normalized() && texel.normal.is_normalized());
        assert!(texel.normal.dot(texel.geometric_normal) > 0.25);
        // Tangents lie in the plane; their rounding is relative to them.
        for tangent in [texel.du, texel.dv] {
            assert!(tangent.dot(texel.geometric_normal).abs() <= 1e-6 * tangent.length());
        }
    }
}

/// Random points on every charted triangle: all four texels of a bilinear lookup with weight are covered.
fn check_lookups(atlas: &Atlas, pages: &[Texels], per_triangle: u32) {
    let covered: Vec<BTreeMap<(i32, i32), ()>> = pages
        .iter()
        .map(|page| {
            page.texels
                .iter()
                .map(|t| ((i32::from(t.x), i32::from(t.y)), ()))
                .collect()
        })
        .collect();
    let mut rng = Rng::new(7);
    for placement in &atlas.placements {
        let offset = DVec2::from_array(placement.offset.map(f64::from));
        for primitive in &atlas.unwraps[placement.unwrap].primitives {
            for (triangle, &chart) in primitive.triangles.iter().zip(&primitive.charts) {
                if chart == NO_CHART {
                    continue;
                }
                let [a, b, c] = triangle.map(|vertex| primitive.texcoords[vertex as usize]);
                for _ in 0..per_triangle {
                    let (mut u, mut v) = (rng.unit(), rng.unit());
                    if u + v > 1.0 {
                        (u, v) = (1.0 - u, 1.0 - v);
                    }
                    let point = a + (b - a) * u + (c - a) * v + offset - 0.5;
                    let corner = point.floor();
                    let part = point - corner;
                    for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let weight = |k: i32, t: f64| if k == 0 { 1.0 - t } else { t };
                        // The point itself is rounded, by 1e-12 of a texel.
                        if weight(x, part.x).min(weight(y, part.y)) > 1e-9 {
                            let texel = (corner.x as i32 + x, corner.y as i32 + y);
                            assert!(
                                covered[placement.page].contains_key(&texel),
                                "{texel:?} of {placement:?} is read at {point}"
                            );
                        }
                    }
                }
            }
        }
    }
}

/// A ball of radius 1 with vertex normals, `n` facets around.
fn ball(n: usize) -> scene::Primitive {
    let mut primitive = grid(n, |x, y| {
        let (longitude, latitude) = (std::f64::consts::TAU * x, std::f64::consts::PI * (0.5 - y));
        DVec3::new(
            latitude.cos() * longitude.cos(),
            latitude.sin(),
            latitude.cos() * longitude.sin(),
        )
    });
    primitive.normals = primitive.positions.iter().map(|p| p.normalize()).collect();
    primitive
}

#[test]
fn a_lookup_on_any_chart_reads_covered_texels_only() {
    let places = [
        DAffine3::IDENTITY,
        DAffine3::from_scale(DVec3::new(-1.0, 2.0, 0.3)),
    ];
    let scene = instances(vec![ball(24), cube()], &places);
    for density in [1.0, 7.3, 24.0] {
        let (atlas, pages) = cover(&scene, &options(density));
        check_lookups(&atlas, &pages, 20);
    }
}

#[test]
fn a_lookup_on_an_authored_layout_reads_covered_texels_only() {
    // Up to the very border of the unit square, where lookups read beyond it.
    let scene = instances(
        vec![grid(3, |x, y| DVec3::new(5.0 * x, 0.0, -5.0 * y))],
        &[DAffine3::IDENTITY; 3],
    );
    let auto = Options {
        uv: Uv::Auto,
        ..options(4.0)
    };
    let (atlas, pages) = cover(&scene, &auto);
    assert!(atlas.unwraps[0].authored);
    check_lookups(&atlas, &pages, 50);
    // 20 × 20 texels and one around them.
    assert_eq!(pages[0].texels.len(), 3 * 22 * 22);
}

#[test]
fn texels_have_the_size_that_the_density_says() {
    let turned = DMat3::from_rotation_y(0.6) * DMat3::from_rotation_x(-0.9);
    for (stretch, sides) in [
        (DVec3::new(4.0, 2.0, 1.0), [32.0, 16.0, 8.0]),
        (DVec3::new(-4.0, 2.0, 1.0), [32.0, 16.0, 8.0]),
        (DVec3::new(0.125, -8.0, -3.0), [1.0, 64.0, 24.0]),
    ] {
        let place = DAffine3::from_mat3(turned * DMat3::from_diagonal(stretch));
        let scene = instances(vec![cube()], &[place]);
        let (_, pages) = cover(&scene, &options(8.0));
        // A side of w × h texels, its corners on texel centres, covers (w + 1)(h + 1) texels of 1/64 m².
        let [x, y, z]: [f64; 3] = sides;
        let covered = |w: f64, h: f64| 2.0 * (w + 1.0) * (h + 1.0);
        let expected = (covered(x, y) + covered(y, z) + covered(z, x)) / 64.0;
        let sum: f64 = pages[0]
            .texels
            .iter()
            .map(|t| t.du.cross(t.dv).length())
            .sum();
        // Layouts come in 32 bits.
        assert!(
            (sum / expected - 1.0).abs() < 1e-3,
            "{stretch}: {sum} instead of {expected}"
        );
        for texel in &pages[0].texels {
            for step in [texel.du, texel.dv] {
                assert!(
                    (step.length() * 8.0 - 1.0).abs() < 1e-3,
                    "{stretch}: {step}"
                );
            }
        }
    }
}

#[test]
fn the_tangent_map_leads_from_texel_to_texel() {
    let scene = instances(
        vec![ball(16)],
        &[DAffine3::from_scale(DVec3::new(2.0, 1.0, -1.5))],
    );
    let (_, pages) = cover(&scene, &options(16.0));
    let page = &pages[0];
    let by_place: BTreeMap<(u16, u16), &texels::Texel> = page
        .texels
        .iter()
        .map(|texel| ((texel.x, texel.y), texel))
        .collect();
    // Whether the centre lies well inside of its triangle.
    let inside = |texel: &texels::Texel| {
        let [a, b, c] = scene.triangles[texel.triangle as usize].vertices;
        let n = texel.geometric_normal;
        [(a, b), (b, c), (c, a)].iter().all(|&(from, to)| {
            (to - from).cross(texel.position - from).dot(n) > 0.02 * (to - from).length()
        })
    };
    let mut tried = 0;
    for texel in &page.texels {
        for (place, step) in [
            ((texel.x + 1, texel.y), texel.du),
            ((texel.x, texel.y + 1), texel.dv),
        ] {
            let Some(next) = by_place.get(&place) else {
                continue;
            };
            if next.triangle == texel.triangle && inside(texel) && inside(next) {
                let n = texel.geometric_normal;
                let difference = (next.position - texel.position).reject_from_normalized(n);
                // Positions are moved onto the round surface, by up to a tenth of a texel differently.
                assert!(difference.distance(step) < 0.1 * step.length());
                tried += 1;
            }
        }
    }
    assert!(tried > 200, "{tried}");
}

#[test]
fn samples_lie_on_their_triangle() {
    let scene = instances(vec![cube()], &[DAffine3::from_rotation_x(0.5)]);
    let (_, pages) = cover(&scene, &options(5.3));
    for texel in &pages[0].texels {
        let triangle = &scene.triangles[texel.triangle as usize];
        let [a, b, c] = triangle.vertices;
        let doubled = triangle.area_vector().length();
        let weights = [(b, c), (c, a), (a, b)].map(|(from, to)| {
            (to - from)
                .cross(texel.position - from)
                .dot(texel.geometric_normal)
                / doubled
        });
        assert!(weights.iter().all(|&w| w > -1e-12), "{weights:?}");
        assert!(
            (a * weights[0] + b * weights[1] + c * weights[2]).distance(texel.position) < 1e-12
        );
    }
}

#[test]
fn normals_look_outwards_below_any_transform() {
    for (case, scale) in [
        DVec3::ONE,
        DVec3::new(-1.0, 1.0, 1.0),
        DVec3::new(1.0, -2.0, 3.0),
        DVec3::new(-1.0, -2.0, -0.2),
    ]
    .into_iter()
    .enumerate()
    {
        let centre = DVec3::new(3.0, -4.0, 5.0);
        let place = DAffine3::from_scale_rotation_translation(
            scale,
            DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0),
            centre,
        );
        let scene = instances(vec![ball(24)], &[place]);
        let (_, pages) = cover(&scene, &options(12.0));
        for texel in &pages[0].texels {
            // Normal of an ellipsoid: the inverse transpose applied to the point of the unit ball.
            let local = place.inverse().transform_point3(texel.position);
            let expected = (place.matrix3.inverse().transpose() * local).normalize();
            // Facets of 15° are at most 7.5° off along each axis, stretching makes more of it.
            assert!(texel.geometric_normal.dot(expected) > 0.8, "case {case}");
            assert!(texel.normal.dot(expected) > 0.95, "case {case}");
            assert!(
                texel.normal.dot(texel.position - centre) > 0.0,
                "case {case}"
            );
        }
    }
}

#[test]
fn shading_normals_that_point_away_are_replaced() {
    let mut inside_out = cube();
    inside_out.normals = inside_out
        .positions
        .iter()
        .map(|p| -p.normalize())
        .collect();
    let scene = instances(vec![inside_out], &[DAffine3::IDENTITY]);
    let (_, pages) = cover(&scene, &options(8.0));
    for texel in &pages[0].texels {
        assert_eq!(texel.normal, texel.geometric_normal);
    }
}

#[test]
fn flattened_instances_keep_their_normals() {
    let place = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    let mut primitive = cube();
    primitive.normals = vec![glam::Vec3::Y; primitive.positions.len()];
    let scene = instances(vec![primitive], &[place]);
    let (_, pages) = cover(&scene, &options(8.0));
    for texel in &pages[0].texels {
        assert!(texel.geometric_normal.y.abs() > 0.999);
        assert!(texel.normal.y.abs() > 0.999);
    }
}

#[test]
fn smooth_positions_lie_between_the_facets_and_the_ball() {
    for n in [8, 12, 24] {
        let radius = 3.0;
        let scene = instances(vec![ball(n)], &[DAffine3::from_scale(DVec3::splat(radius))]);
        let (_, pages) = cover(&scene, &options(10.0));
        let (mut facets, mut moved) = (0.0, 0.0);
        for texel in &pages[0].texels {
            let vertex = scene.triangles[texel.triangle as usize].vertices[0];
            let above = (texel.position - vertex).dot(texel.geometric_normal);
            assert!(above > -1e-6, "{n}: below its facet by {above}");
            assert!(
                texel.position.length() <= radius * (1.0 + 1e-6),
                "{n}: outside of the ball"
            );
            facets += radius - (texel.position - texel.geometric_normal * above).length();
            moved += radius - texel.position.length();
        }
        // What is left is of fourth order in the angle; poles, where facets are slender, are less round.
        assert!(moved < 0.25 * facets, "{n}: {moved} of {facets} left");
    }
}

#[test]
fn boxes_with_shared_corners_stay_flat() {
    let mut primitive = cube();
    primitive.normals = primitive.positions.iter().map(|p| p.normalize()).collect();
    let scene = instances(vec![primitive], &[DAffine3::IDENTITY]);
    let (_, pages) = cover(&scene, &options(8.0));
    for texel in &pages[0].texels {
        assert!((texel.position.abs().max_element() - 0.5).abs() < 1e-12);
    }
}

#[test]
fn the_same_atlas_gives_the_same_texels_on_any_number_of_threads() {
    let scene = instances(vec![ball(20), cube()], &[DAffine3::IDENTITY; 5]);
    let atlas = build(&scene, &options(9.0));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("threads")
            .install(|| format!("{:?}", texels::cover(&scene, &atlas, 0)))
    };
    let alone = on(1);
    assert!(alone == on(1), "twice on one thread");
    assert!(alone == on(3), "on three threads");
}

#[test]
fn real_levels_are_covered() {
    let Some(folder) = shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    for (level, density) in [
        ("librequake/lq_e0m1.glb", 2.0),
        ("dive_arena/level.glb", 2.0),
        ("foxtrot2023_level/level.glb", 0.5),
        ("webxr_garage/garage.gltf", 8.0),
        ("bevyjam2_level1/level1.glb", 2.0),
    ] {
        let path = folder.join("levels").join(level);
        let scene = Scene::open(&path, &scene::Options::default()).expect(level);
        let options = Options {
            texels_per_metre: density,
            ..Options::default()
        };
        let (atlas, pages) = cover(&scene, &options);
        check_lookups(&atlas, &pages, 3);
    }
}

/// The nearest surface along a ray, by looking at all.
fn nearest(scene: &Scene, origin: DVec3, direction: DVec3, limit: f64) -> Option<Obstacle> {
    scene
        .triangles
        .iter()
        .filter_map(|triangle| {
            let [a, b, c] = triangle.vertices;
            let n = triangle.area_vector();
            let towards = n.dot(direction);
            let distance = n.dot(a - origin) / towards;
            let point = origin + direction * distance;
            let inside = [(a, b), (b, c), (c, a)]
                .iter()
                .all(|&(from, to)| (to - from).cross(point - from).dot(n) >= 0.0);
            let double_sided = scene.materials[triangle.material as usize].double_sided;
            (inside && distance > 0.0 && distance <= limit).then(|| Obstacle {
                distance,
                normal: n.normalize(),
                back: towards > 0.0 && !double_sided,
            })
        })
        .min_by(|a, b| a.distance.total_cmp(&b.distance))
}

/// The twelve triangles of a box, fronts outwards.
fn block(low: DVec3, high: DVec3) -> Vec<[DVec3; 3]> {
    let size = high - low;
    let [x, y, z] = [DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z];
    [
        quad(low, y, x),
        quad(low, z, y),
        quad(low, x, z),
        quad(low + z, x, y),
        quad(low + x, y, z),
        quad(low + y, z, x),
    ]
    .concat()
}

/// A floor of 8 × 8 m at y = 0 with blocks on it; the floor's texels, pushed out at 2 texels per metre.
fn floor_with(blocks: &[(DVec3, DVec3)], double_sided: bool) -> (Texels, Texels, usize) {
    let floor = quad(DVec3::new(-4.0, 0.0, -4.0), DVec3::Z * 8.0, DVec3::X * 8.0);
    let stone = Material {
        double_sided,
        ..Material::default()
    };
    let blocks: Vec<[DVec3; 3]> = blocks
        .iter()
        .flat_map(|&(low, high)| block(low, high))
        .collect();
    let scene = scene_of(&[(Material::default(), floor), (stone, blocks)]);
    let (_, mut pages) = cover(&scene, &options(2.0));
    let before = texels::cover(&scene, &build(&scene, &options(2.0)), 0);
    let mut after = pages.remove(0);
    let moved = texels::push_out(&mut after, &|origin, direction, limit| {
        nearest(&scene, origin, direction, limit)
    });
    let changed = before
        .texels
        .iter()
        .zip(&after.texels)
        .filter(|(a, b)| a.position != b.position);
    assert_eq!(changed.count(), moved);
    (before, after, moved)
}

#[test]
fn floor_texels_below_the_foot_of_a_wall_come_out() {
    // 0.7 m thick: with texels of 0.5 m every place below it is within a texel of a side.
    let wall = (DVec3::new(-0.3, 0.0, -6.0), DVec3::new(0.4, 3.0, 6.0));
    let (before, after, moved) = floor_with(&[wall], false);
    assert!(moved > 0);
    for (before, after) in before.texels.iter().zip(&after.texels) {
        if before.geometric_normal.y < 0.5 || before.triangle >= 2 {
            continue;
        }
        let x = after.position.x;
        assert!(
            !(wall.0.x..=wall.1.x).contains(&x),
            "{x} is inside of the wall"
        );
        assert_eq!(after.position.y, 0.0, "samples stay on their surface");
        let inside = (wall.0.x..=wall.1.x).contains(&before.position.x);
        assert_eq!(
            inside,
            before.position != after.position,
            "only those inside move"
        );
        if inside {
            // To the nearer side, and no farther than needed.
            let nearer = if before.position.x < 0.05 {
                wall.0.x
            } else {
                wall.1.x
            };
            assert!((x - nearer).abs() < 0.01, "{x} instead of {nearer}");
        }
    }
}

#[test]
fn floor_texels_deep_below_a_block_stay() {
    let block = (DVec3::new(-3.2, 0.0, -3.2), DVec3::new(3.2, 2.0, 3.2));
    let (before, after, moved) = floor_with(&[block], false);
    assert!(moved > 0);
    for (before, after) in before.texels.iter().zip(&after.texels) {
        if before.triangle >= 2 {
            continue;
        }
        let depth = 3.2 - before.position.abs().max_element();
        // A texel is 0.5 m wide, so its bilinear footprint reaches 0.5 m along the sides.
        if depth > 0.501 {
            assert_eq!(before.position, after.position, "nobody sees it");
        } else if depth > 0.0 && depth < 0.499 {
            assert!(
                after.position.abs().max_element() > 3.2,
                "{}",
                after.position
            );
            assert!((after.position - before.position).abs().max_element() < 0.5);
        } else if depth < 0.0 {
            assert_eq!(before.position, after.position, "it is outside already");
        }
    }
}

#[test]
fn samples_on_the_side_of_a_wall_step_off_it() {
    // Texel centres lie at multiples of half a metre, and so do the sides of this wall.
    let wall = (DVec3::new(-0.5, 0.0, -6.0), DVec3::new(0.5, 3.0, 6.0));
    let (before, after, _) = floor_with(&[wall], false);
    let mut stepped = 0;
    for (before, after) in before.texels.iter().zip(&after.texels) {
        let (was, is) = (before.position.x.abs(), after.position.x.abs());
        if before.triangle < 2 && (was - 0.5).abs() < 1e-6 {
            assert!(is > 0.5 && is < 0.51, "{is}");
            stepped += 1;
        }
    }
    assert!(stepped >= 2 * 16, "{stepped}");
}

#[test]
fn samples_come_out_of_crossing_walls() {
    // Out of one wall a sample may get into the other: a corner whose walls overlap.
    let walls = [
        (DVec3::new(-0.3, 0.0, -6.0), DVec3::new(0.3, 3.0, 0.45)),
        (DVec3::new(-6.0, 0.0, -0.15), DVec3::new(0.45, 3.0, 0.45)),
    ];
    let (_, after, moved) = floor_with(&walls, false);
    assert!(moved > 0);
    for texel in after.texels.iter().filter(|texel| texel.triangle < 2) {
        let p = texel.position;
        let inside = walls
            .iter()
            .any(|(low, high)| (low.x..=high.x).contains(&p.x) && (low.z..=high.z).contains(&p.z));
        assert!(!inside, "{p}");
    }
}

#[test]
fn nothing_passes_through_double_sided_surfaces_or_moves_in_the_open() {
    let curtain = (DVec3::new(0.1, 0.0, -6.0), DVec3::new(0.2, 3.0, 6.0));
    let (before, after, _) = floor_with(&[curtain], true);
    for (before, after) in before.texels.iter().zip(&after.texels) {
        // Samples of the curtain's lower rim lie in the plane of the floor and step off it.
        let step = before.position.distance(after.position);
        assert!(
            step == 0.0 || (before.triangle >= 2 && step < 0.01),
            "{step}"
        );
    }
    let floating = (DVec3::new(-1.0, 0.5, -1.0), DVec3::new(1.0, 1.0, 1.0));
    let (.., moved) = floor_with(&[floating], false);
    assert_eq!(moved, 0);
}

#[test]
fn pushing_out_does_not_depend_on_scale_place_or_threads() {
    let wall = |scale: f64, at: DVec3| {
        let floor = quad(at, DVec3::Z * 8.0 * scale, DVec3::X * 8.0 * scale);
        let low = at + DVec3::new(3.7, 0.0, -1.2) * scale;
        let stone = block(low, low + DVec3::new(0.7, 3.0, 10.0) * scale);
        let scene = scene_of(&[(Material::default(), [floor, stone].concat())]);
        let (_, mut pages) = cover(&scene, &options(2.0 / scale));
        let moved = texels::push_out(&mut pages[0], &|origin, direction, limit| {
            nearest(&scene, origin, direction, limit)
        });
        (moved, format!("{:?}", pages[0]))
    };
    let (expected, bytes) = wall(1.0, DVec3::ZERO);
    assert!(expected > 0);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a thread");
    assert!(pool.install(|| wall(1.0, DVec3::ZERO)).1 == bytes);
    for (scale, at) in [
        (0.01, DVec3::ZERO),
        (100.0, DVec3::ZERO),
        (1.0, DVec3::new(1024.0, -512.0, 4096.0)),
    ] {
        assert_eq!(wall(scale, at).0, expected, "scale {scale} at {at}");
    }
}

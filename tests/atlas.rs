//! Every surface gets its own place in the lightmap, whatever the mesh looks like.

#![expect(clippy::print_stdout, reason = "says what was skipped")]

use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use lumel::Error;
use lumel::atlas::{self, Atlas, NO_CHART, Options, Uv};
use lumel::scene::{self, Instance, Mesh, Primitive, Scene};

use crate::support::{Rng, quad, scene_of, shared_scenes};

/// A grid of `n`² quads over the unit square, bent by `shape`, with shared vertices and the grid as `TEXCOORD_1`.
pub(crate) fn grid(n: usize, shape: impl Fn(f64, f64) -> DVec3) -> Primitive {
    let at = |index: usize| (index % (n + 1), index / (n + 1));
    let unit = |k: usize| k as f64 / n as f64;
    let vertices = (n + 1) * (n + 1);
    Primitive {
        source: 0,
        material: 0,
        positions: (0..vertices)
            .map(|index| {
                let (x, y) = at(index);
                shape(unit(x), unit(y)).as_vec3()
            })
            .collect(),
        normals: Vec::new(),
        texcoords: vec![
            Vec::new(),
            (0..vertices)
                .map(|index| {
                    let (x, y) = at(index);
                    Vec2::new(unit(x) as f32, unit(y) as f32)
                })
                .collect(),
        ],
        vertex_alpha: Vec::new(),
        triangles: (0..n * n)
            .flat_map(|cell| {
                let corner = (cell / n * (n + 1) + cell % n) as u32;
                let above = corner + n as u32 + 1;
                [[corner, corner + 1, above + 1], [corner, above + 1, above]]
            })
            .collect(),
    }
}

/// A hilly square of 20 × 20 m.
fn hills(n: usize) -> Primitive {
    grid(n, |x, y| {
        let height = (9.0 * x).sin() + (7.0 * y + 3.0 * x).cos();
        DVec3::new(20.0 * x, height, -20.0 * y)
    })
}

/// A box with sides of 1 m around the origin, every corner once per side.
pub(crate) fn cube() -> Primitive {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [-0.5, 0.5] {
            let first = positions.len() as u32;
            for (u, v) in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)] {
                let mut position = [0.0; 3];
                position[axis] = side;
                position[(axis + 1) % 3] = u;
                position[(axis + 2) % 3] = v * 2.0 * side;
                positions.push(Vec3::from_array(position));
            }
            triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    Primitive {
        source: 0,
        material: 0,
        positions,
        normals: Vec::new(),
        texcoords: Vec::new(),
        vertex_alpha: Vec::new(),
        triangles,
    }
}

/// Instances of one mesh.
pub(crate) fn instances(primitives: Vec<Primitive>, places: &[DAffine3]) -> Scene {
    let mesh = Mesh {
        name: "mesh".to_owned(),
        source: 0,
        primitives,
    };
    Scene::assemble(
        "test",
        vec![mesh],
        places
            .iter()
            .enumerate()
            .map(|(node, &world_from_local)| Instance {
                name: format!("node{node}"),
                node,
                copy: None,
                mesh: 0,
                world_from_local,
                density: 1.0,
            })
            .collect(),
        Vec::new(),
        Vec::new(),
    )
}

/// Builds, and checks everything that must hold.
pub(crate) fn build(scene: &Scene, options: &Options) -> Atlas {
    let atlas = atlas::build(scene, options, &|| false).expect("an atlas");
    atlas
        .validate(scene, options)
        .unwrap_or_else(|what| panic!("{what}"));
    atlas
}

fn unwrap_always() -> Options {
    Options {
        uv: Uv::Unwrap,
        ..Options::default()
    }
}

fn warned(atlas: &Atlas, what: &str) -> usize {
    atlas
        .warnings
        .iter()
        .filter(|warning| warning.what.contains(what))
        .map(|warning| warning.count)
        .sum()
}

#[test]
fn charts_of_a_bent_surface_keep_their_distance() {
    let scene = instances(vec![hills(40), cube()], &[DAffine3::IDENTITY]);
    for (padding, page) in [(2, 2048), (3, 256), (8, 128)] {
        let options = Options {
            padding,
            page,
            ..unwrap_always()
        };
        let atlas = build(&scene, &options);
        assert!(
            atlas
                .pages
                .iter()
                .all(|p| p.width <= page && p.height <= page)
        );
        assert!(atlas.warnings.is_empty(), "{:?}", atlas.warnings);
    }
}

#[test]
fn validation_sees_charts_that_come_too_close() {
    let scene = instances(vec![cube()], &[DAffine3::IDENTITY]);
    let options = unwrap_always();
    let mut atlas = build(&scene, &options);
    let wide = Options {
        padding: options.padding + 3,
        ..options.clone()
    };
    assert!(atlas.validate(&scene, &wide).is_err());
    atlas.unwraps[0].primitives[0].source_triangles.pop();
    assert!(atlas.validate(&scene, &options).is_err());
}

#[test]
fn instances_share_a_layout_unless_they_are_stretched() {
    let turned = DMat3::from_rotation_y(1.0) * DMat3::from_rotation_x(0.4);
    let places = [
        DMat3::IDENTITY,
        turned,
        turned * DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)),
        DMat3::from_diagonal(DVec3::new(1.0, 3.0, 1.0)),
        turned * DMat3::from_diagonal(DVec3::new(1.0, 3.0, 1.0)),
    ]
    .map(DAffine3::from_mat3);
    let scene = instances(vec![cube()], &places);
    let atlas = build(&scene, &Options::default());
    assert_eq!(atlas.unwraps.len(), 2);
    let mut layouts: Vec<(usize, usize)> = atlas
        .placements
        .iter()
        .map(|placement| (placement.instance, placement.unwrap))
        .collect();
    layouts.sort_unstable();
    assert_eq!(layouts, [(0, 0), (1, 0), (2, 0), (3, 1), (4, 1)]);
}

#[test]
fn density_multiplies_the_texels_of_an_instance() {
    let mut scene = instances(vec![cube()], &[DAffine3::IDENTITY; 3]);
    scene.instances[1].density = 4.0;
    scene.instances[2].density = 0.0;
    let atlas = build(&scene, &Options::default());
    assert_eq!(atlas.placements.len(), 2);
    let densities: Vec<f64> = atlas.unwraps.iter().map(|u| u.texels_per_metre).collect();
    assert_eq!(densities, [8.0, 32.0]);
    // A side of the cube reads 9² texels at 8 per metre and 33² at 32; margins do not grow with it.
    let areas: Vec<u32> = atlas
        .unwraps
        .iter()
        .map(|u| u.size[0] * u.size[1])
        .collect();
    assert!(
        areas[0] >= 6 * 81 && areas[1] >= 6 * 33 * 33 && areas[1] < 3 * 6 * 33 * 33,
        "{areas:?}"
    );
}

#[test]
fn the_same_scene_gives_the_same_atlas_on_any_number_of_threads() {
    let places: Vec<DAffine3> = (0..30)
        .map(|k| DAffine3::from_scale(DVec3::splat(1.0 + 0.1 * f64::from(k % 7))))
        .collect();
    let scene = instances(vec![hills(12), cube()], &places);
    let options = Options {
        page: 512,
        ..unwrap_always()
    };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("threads")
            .install(|| format!("{:?}", build(&scene, &options)))
    };
    let alone = on(1);
    assert!(alone == on(1), "twice on one thread");
    assert!(alone == on(3), "on three threads");
}

#[test]
fn authored_layouts_are_kept_byte_for_byte() {
    let flat = || grid(4, |x, y| DVec3::new(8.0 * x, 0.0, -8.0 * y));
    let scene = instances(vec![flat()], &[DAffine3::IDENTITY; 2]);
    let atlas = build(&scene, &Options::default());
    assert_eq!(atlas.unwraps.len(), 1);
    let unwrap = &atlas.unwraps[0];
    assert!(unwrap.authored);
    // 8 m at 8 texels per metre fill the square.
    assert_eq!(unwrap.size, [64, 64]);
    assert_eq!(unwrap.n_charts, 1);
    let authored = &scene.meshes[0].primitives[0];
    assert_eq!(unwrap.primitives[0].triangles, authored.triangles);
    for (texcoord, authored) in unwrap.primitives[0]
        .texcoords
        .iter()
        .zip(&authored.texcoords[1])
    {
        assert_eq!(*texcoord, authored.as_dvec2() * 64.0);
    }
    assert!(!build(&scene, &unwrap_always()).unwraps[0].authored);
}

#[test]
fn authored_layouts_that_are_none_are_refused() {
    let with = |change: &dyn Fn(Vec2) -> Vec2| {
        let mut primitive = grid(6, |x, y| DVec3::new(4.0 * x, 0.0, -4.0 * y));
        for texcoord in &mut primitive.texcoords[1] {
            *texcoord = change(*texcoord);
        }
        instances(vec![primitive], &[DAffine3::IDENTITY])
    };
    let authored = |scene: &Scene, uv| {
        let options = Options {
            uv,
            ..Options::default()
        };
        build(scene, &options).unwraps[0].authored
    };
    assert!(authored(&with(&|uv| uv), Uv::Auto));
    assert!(
        authored(&with(&|uv| uv * 1.000_05), Uv::Auto),
        "rounding is no reason"
    );
    let tiled = with(&|uv| uv * 3.0);
    assert!(!authored(&tiled, Uv::Auto) && !authored(&tiled, Uv::Keep));
    let folded = with(&|uv| Vec2::new((uv.x - 0.5).abs() * 2.0, uv.y));
    assert!(!authored(&folded, Uv::Auto) && authored(&folded, Uv::Keep));
    let line = with(&|uv| Vec2::new(uv.x, uv.x));
    assert!(!authored(&line, Uv::Auto) && !authored(&line, Uv::Keep));
    let corner = with(&|uv| uv * 0.2);
    assert!(!authored(&corner, Uv::Auto) && authored(&corner, Uv::Keep));
    let broken = with(&|_| Vec2::NAN);
    assert!(!authored(&broken, Uv::Auto) && !authored(&broken, Uv::Keep));

    // Two primitives on the same place overlap as well.
    let flat = || grid(4, |x, y| DVec3::new(4.0 * x, 0.0, -4.0 * y));
    let twice = instances(vec![flat(), flat()], &[DAffine3::IDENTITY]);
    assert!(!authored(&twice, Uv::Auto));
    // And one without the set spoils the mesh.
    let mixed = instances(vec![flat(), cube()], &[DAffine3::IDENTITY]);
    assert!(!authored(&mixed, Uv::Auto) && !authored(&mixed, Uv::Keep));
}

#[test]
fn authored_charts_that_touch_are_reported() {
    // Left half and right half of the layout, apart in space.
    let half = |x0: f32, z: f64| {
        let mut primitive = grid(3, |x, y| DVec3::new(4.0 * x, z, -4.0 * y));
        for texcoord in &mut primitive.texcoords[1] {
            texcoord.x = x0 + 0.45 * texcoord.x;
        }
        primitive
    };
    let apart = instances(vec![half(0.0, 0.0), half(0.55, 3.0)], &[DAffine3::IDENTITY]);
    let touching = instances(vec![half(0.0, 0.0), half(0.45, 3.0)], &[DAffine3::IDENTITY]);
    let atlas = build(&apart, &Options::default());
    assert_eq!(
        (
            atlas.unwraps[0].n_charts,
            warned(&atlas, "closer than 2 texels")
        ),
        (2, 0)
    );
    let atlas = build(&touching, &Options::default());
    assert_eq!(
        (
            atlas.unwraps[0].n_charts,
            warned(&atlas, "closer than 2 texels")
        ),
        (2, 1)
    );
}

#[test]
fn a_mesh_larger_than_a_page_takes_several() {
    // 160 × 160 texels on pages of 64.
    let scene = instances(vec![hills(24)], &[DAffine3::IDENTITY; 2]);
    let options = Options {
        page: 64,
        ..unwrap_always()
    };
    let atlas = build(&scene, &options);
    assert!(atlas.unwraps.len() >= 9, "{}", atlas.unwraps.len());
    assert_eq!(atlas.placements.len(), 2 * atlas.unwraps.len());
    assert!(atlas.warnings.is_empty(), "{:?}", atlas.warnings);
}

#[test]
fn a_triangle_larger_than_a_page_gets_fewer_texels_and_the_rest_does_not() {
    let mut primitive = cube();
    let first = primitive.positions.len() as u32;
    primitive.positions.extend([
        Vec3::new(0.0, -1.0, 0.0),
        Vec3::new(100.0, -1.0, 0.0),
        Vec3::new(0.0, -1.0, 30.0),
    ]);
    primitive.triangles.push([first, first + 1, first + 2]);
    let scene = instances(vec![primitive], &[DAffine3::IDENTITY]);
    let options = Options {
        page: 256,
        ..unwrap_always()
    };
    let atlas = build(&scene, &options);
    assert_eq!(warned(&atlas, "larger than a page"), 1);
    // The cube keeps 8 texels per metre: each side still reads at least 8² texels.
    let cube_area: f64 = atlas
        .unwraps
        .iter()
        .flat_map(|unwrap| unwrap.primitives.iter())
        .flat_map(|primitive| {
            primitive
                .triangles
                .iter()
                .zip(&primitive.source_triangles)
                .filter(|&(_, &source)| source < 12)
                .map(|(triangle, _)| {
                    let [a, b, c] = triangle.map(|v| primitive.texcoords[v as usize]);
                    0.5 * (b - a).perp_dot(c - a).abs()
                })
        })
        .sum();
    // Charts grow to whole texels, never shrink.
    assert!(cube_area >= 6.0 * 64.0 * 0.999, "{cube_area}");
}

#[test]
fn a_triangle_of_any_size_is_fitted_to_a_page() {
    // Made smaller, it comes out rounded up or down; rounded up it once filled page after page.
    for case in 0..300 {
        let mut rng = Rng::new(case);
        let side = |low: f64, high: f64, rng: &mut Rng| {
            DVec3::new(
                rng.range(-1.0, 1.0),
                rng.range(-1.0, 1.0),
                rng.range(-1.0, 1.0),
            ) * rng.range(low, high)
        };
        let (a, b) = (side(30.0, 300.0, &mut rng), side(1.0, 300.0, &mut rng));
        let scene = scene_of(&[(scene::Material::default(), vec![[DVec3::ZERO, a, b]])]);
        let options = Options {
            page: 128 + 4 * (case as u32 % 30),
            ..unwrap_always()
        };
        build(&scene, &options);
    }
}

#[test]
fn hairlines_lie_on_their_neighbours() {
    // A quad of 4 m with a needle of 0.1 mm along its lower side.
    let scene = scene_of(&[(
        scene::Material::default(),
        [
            quad(DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0),
            vec![[DVec3::ZERO, DVec3::new(2.0, -1e-4, 0.0), DVec3::X * 4.0]],
        ]
        .concat(),
    )]);
    let atlas = build(&scene, &Options::default());
    let primitive = &atlas.unwraps[0].primitives[0];
    assert_eq!(primitive.charts, [0, 0, NO_CHART]);
    let at = |triangle: usize, corner: usize| {
        primitive.texcoords[primitive.triangles[triangle][corner] as usize]
    };
    // Its ends are those of the quad's side, its middle lies between them.
    assert_eq!(at(2, 0), at(0, 0));
    assert_eq!(at(2, 2), at(0, 1));
    assert!(at(2, 1).distance((at(0, 0) + at(0, 1)) * 0.5) < 1e-3);
}

#[test]
fn meshes_of_any_size_get_texels_while_they_have_area() {
    for exponent in [-12, -4, -2, 0, 1] {
        let scale = 10f64.powi(exponent);
        let scene = instances(
            vec![hills(4), cube()],
            &[DAffine3::from_scale_rotation_translation(
                DVec3::splat(scale),
                glam::DQuat::from_rotation_x(0.3),
                DVec3::new(5e3, -2e3, 1e4) * scale,
            )],
        );
        let options = unwrap_always();
        let atlas = build(&scene, &options);
        assert_eq!(atlas.placements.len(), 1, "scale 1e{exponent}");
        let lost = atlas.unwraps[0]
            .primitives
            .iter()
            .flat_map(|primitive| &primitive.charts)
            .filter(|&&chart| chart == NO_CHART)
            .count();
        assert_eq!(lost, 0, "scale 1e{exponent}");
    }
}

#[test]
fn what_needs_too_many_texels_is_told_which_density_fits() {
    let side = 350e3;
    let scene = scene_of(&[(
        scene::Material::default(),
        quad(DVec3::ZERO, DVec3::X * side, DVec3::Y * side),
    )]);
    let error = atlas::build(&scene, &Options::default(), &|| false).expect_err("350 km");
    let Error::TooLarge { reason } = error else {
        panic!("{error}");
    };
    let words: Vec<&str> = reason.split(' ').collect();
    let option = words
        .iter()
        .position(|&word| word == "--texels-per-metre")
        .expect("the option");
    let density: f64 = words[option + 1].parse().expect("a number");
    let options = Options {
        texels_per_metre: density,
        ..Options::default()
    };
    let atlas = build(&scene, &options);
    assert_eq!(warned(&atlas, "larger than a page"), 2);

    // Nothing helps against a wrong unit.
    let scene = instances(vec![cube()], &[DAffine3::from_scale(DVec3::splat(1e30))]);
    let error = atlas::build(&scene, &Options::default(), &|| false).expect_err("1e30 m");
    assert!(error.to_string().contains("check the units"), "{error}");
}

#[test]
fn broken_and_flat_geometry_is_survived() {
    let mut rng = Rng::new(5);
    let mut point = |spread: f64| {
        DVec3::new(
            rng.range(-1.0, 1.0),
            rng.range(-1.0, 1.0),
            rng.range(-1.0, 1.0),
        ) * spread
    };
    let mut triangles = Vec::new();
    for case in 0..300 {
        let (a, b) = (point(5.0), point(5.0));
        triangles.push(match case % 6 {
            0 => [a, b, point(5.0)],
            1 => [a, a, b],
            2 => [a, b, a.lerp(b, 0.3)],
            3 => [a, a + point(1e-6), a + point(1e-6)],
            4 => [a, b, a.lerp(b, 0.3) + point(1e-5)],
            _ => [a, a + point(2e3), a + point(1e-3)],
        });
    }
    let scene = scene_of(&[(scene::Material::default(), triangles)]);
    build(&scene, &unwrap_always());

    let flat = DAffine3::from_scale(DVec3::new(2.0, 0.0, 1.0));
    let line = DAffine3::from_scale(DVec3::new(2.0, 0.0, 0.0));
    let atlas = build(
        &instances(vec![cube(), hills(5)], &[flat, line]),
        &unwrap_always(),
    );
    assert!(
        atlas
            .placements
            .iter()
            .all(|placement| placement.instance == 0)
    );
    assert_eq!(warned(&atlas, "no area"), 1);

    let nothing = build(&scene_of(&[]), &Options::default());
    assert!(nothing.pages.is_empty() && nothing.placements.is_empty());
}

#[test]
fn thousands_of_small_meshes_do_not_hang() {
    // xatlas misses a wake-up about once in 5,000 instances and then waits for ever.
    let places: Vec<DAffine3> = (0..3000)
        .map(|k| {
            let size = DVec3::new(
                1.0,
                1.0 + 0.05 * f64::from(k % 60),
                1.0 + 0.05 * f64::from(k / 60),
            );
            DAffine3::from_scale_rotation_translation(
                size,
                glam::DQuat::IDENTITY,
                DVec3::X * f64::from(k),
            )
        })
        .collect();
    let scene = instances(vec![cube()], &places);
    let options = Options {
        texels_per_metre: 2.0,
        ..Options::default()
    };
    let atlas = build(&scene, &options);
    assert_eq!(atlas.placements.len(), 3000);
}

#[test]
fn ten_thousand_instances_fit_tightly() {
    let mut rng = Rng::new(1);
    let places: Vec<DAffine3> = (0..10_000)
        .map(|_| DAffine3::from_scale(DVec3::splat(rng.range(0.5, 2.0))))
        .collect();
    let scene = instances(vec![cube()], &places);
    let options = Options {
        texels_per_metre: 4.0,
        ..Options::default()
    };
    let atlas = build(&scene, &options);
    assert!(atlas.unwraps.len() < 200, "{}", atlas.unwraps.len());
    let taken: u64 = atlas
        .placements
        .iter()
        .map(|placement| {
            let [width, height] = atlas.unwraps[placement.unwrap].size;
            u64::from((width + options.padding) * (height + options.padding))
        })
        .sum();
    let all: u64 = atlas
        .pages
        .iter()
        .map(|p| u64::from(p.width * p.height))
        .sum();
    assert!(taken as f64 > 0.9 * all as f64, "{taken} of {all}");
}

#[test]
fn cancelling_stops_between_and_inside_meshes() {
    let scene = instances(vec![hills(60)], &[DAffine3::IDENTITY]);
    let error = atlas::build(&scene, &unwrap_always(), &|| true).expect_err("cancelled");
    assert!(matches!(error, Error::Interrupted));
    // The second question comes from inside the mesh, if xatlas takes longer than the patience of the caller.
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let cancelled = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) > 0;
    match atlas::build(&scene, &unwrap_always(), &cancelled) {
        Ok(_) => assert_eq!(asked.into_inner(), 1),
        Err(error) => assert!(matches!(error, Error::Interrupted)),
    }
}

#[test]
fn options_out_of_range_are_named() {
    let scene = instances(vec![cube()], &[DAffine3::IDENTITY]);
    let default = Options::default;
    for (options, name) in [
        (
            Options {
                texels_per_metre: f64::NAN,
                ..default()
            },
            "texels-per-metre",
        ),
        (
            Options {
                texels_per_metre: 0.0,
                ..default()
            },
            "texels-per-metre",
        ),
        (
            Options {
                page: 63,
                ..default()
            },
            "page",
        ),
        (
            Options {
                page: 20_000,
                ..default()
            },
            "page",
        ),
        (
            Options {
                padding: 1,
                ..default()
            },
            "padding",
        ),
        (
            Options {
                page: 64,
                padding: 40,
                ..default()
            },
            "padding",
        ),
    ] {
        match atlas::build(&scene, &options, &|| false) {
            Err(Error::InvalidOption { option, .. }) => assert_eq!(option, name),
            other => panic!("{name}: {other:?}"),
        }
    }
    let odd = Options {
        page: 127,
        padding: 63,
        ..default()
    };
    assert!(
        build(&scene, &odd)
            .pages
            .iter()
            .all(|page| page.width <= 127)
    );
}

#[test]
fn real_levels_are_laid_out() {
    let Some(folder) = shared_scenes() else {
        println!("skipped: no shared scenes");
        return;
    };
    for (level, density, authored) in [
        ("librequake/lq_e0m1.glb", 2.0, 0),
        ("dive_arena/level.glb", 2.0, 1),
        ("foxtrot2023_level/level.glb", 1.0, 0),
        ("littlest_tokyo/LittlestTokyo-transformed.plain.glb", 0.1, 0),
        ("mindfall_lvl1/lvl1.glb", 2.0, 0),
    ] {
        let path = folder.join("levels").join(level);
        let scene = Scene::open(&path, &scene::Options::default()).expect(level);
        let options = Options {
            texels_per_metre: density,
            page: 1024,
            ..Options::default()
        };
        let atlas = build(&scene, &options);
        let kept = atlas
            .unwraps
            .iter()
            .filter(|unwrap| unwrap.authored)
            .count();
        assert_eq!(kept, authored, "{level}");
        assert!(!atlas.placements.is_empty(), "{level}");
    }
}

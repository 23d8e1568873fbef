//! Emissive surfaces become polygons that have the same outline, area and flux.

use std::collections::BTreeSet;

use glam::{DAffine2, DAffine3, DQuat, DVec3, Vec2, Vec3};
use lumel::lights::{self, Lights, Options, Polygon};
use lumel::scene::{Alpha, Image, Instance, Material, Mesh, Primitive, Scene, Texture, Wrap};

use crate::support::{Rng, emitter, quad, scene_of};

fn collect(scene: &Scene) -> Lights {
    lights::collect(scene, &Options::default())
}

/// The only polygon of one emissive part.
fn only(triangles: Vec<[DVec3; 3]>) -> Polygon {
    let mut lights = collect(&scene_of(&[(emitter(5.0), triangles)]));
    assert_eq!(lights.polygons.len(), 1, "{:?}", lights.polygons);
    lights.polygons.remove(0)
}

/// Twice the vector area within closed contours.
fn area_vector(contours: &[Vec<DVec3>]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for contour in contours {
        for edge in contour.windows(2) {
            sum += (edge[0] - contour[0]).cross(edge[1] - contour[0]);
        }
    }
    sum
}

/// Light vector at `point` of unit radiance within closed contours (math.md §2).
fn light_vector<'a>(contours: impl Iterator<Item = &'a [DVec3]>, point: DVec3) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for contour in contours {
        for (index, &vertex) in contour.iter().enumerate() {
            let a = vertex - point;
            let b = contour[(index + 1) % contour.len()] - point;
            let w = a.cross(b);
            if w.length() > 0.0 {
                sum += 0.5 * w.length().atan2(a.dot(b)) * w / w.length();
            }
        }
    }
    sum
}

/// What must hold of every polygon; `rounding` is the size of a step of the coordinates.
fn check(polygon: &Polygon, rounding: f64) {
    let inside: f64 = polygon
        .triangles
        .iter()
        .map(|&[a, b, c]| (b - a).cross(c - a).length() / 2.0)
        .sum();
    let outline: f64 = polygon
        .contours
        .iter()
        .flatten()
        .zip(polygon.contours.iter().flatten().skip(1))
        .map(|(a, b)| a.distance(*b))
        .sum();
    // Vertices left out are off by at most a few steps, along the whole outline.
    let tolerance = 8.0 * rounding * outline + 1e-12 * inside;
    let within = 0.5 * area_vector(&polygon.contours).dot(polygon.normal);
    assert!(
        (within - inside).abs() <= tolerance,
        "{within} and {inside}"
    );
    assert!((polygon.area - inside).abs() <= 1e-12 * inside);
    assert!((polygon.normal.length() - 1.0).abs() < 1e-14);
    assert!(polygon.radiance.min_element() >= 0.0 && polygon.radiance.max_element() > 0.0);
    assert!(polygon.contours.iter().all(|contour| contour.len() >= 3));
    assert!(polygon.surface.windows(2).all(|pair| pair[0] < pair[1]));
    // Seen from everywhere, the outline is the outline of the triangles.
    let (a, b, c) = polygon.triangles[0].into();
    for point in [
        a + polygon.area.sqrt() * polygon.normal,
        3.0 * b - 2.0 * c + a.distance(b) * polygon.normal,
    ] {
        let want = light_vector(
            polygon.triangles.iter().map(|triangle| &triangle[..]),
            point,
        );
        let got = light_vector(polygon.contours.iter().map(Vec::as_slice), point);
        let size = polygon.area.sqrt();
        assert!(
            got.distance(want) < 1e-10 + 100.0 * rounding / size,
            "got {got}, want {want}"
        );
    }
}

#[test]
fn a_quad_becomes_four_vertices_around_its_front() {
    let polygon = only(quad(
        DVec3::new(1.0, 2.0, 3.0),
        2.0 * DVec3::X,
        3.0 * DVec3::Y,
    ));
    check(&polygon, 0.0);
    assert_eq!(polygon.contours.len(), 1);
    assert_eq!(polygon.contours[0].len(), 4);
    assert_eq!(polygon.normal, DVec3::Z);
    assert_eq!(polygon.area, 6.0);
    assert_eq!(polygon.radiance, DVec3::splat(5.0));
    assert_eq!(polygon.surface, [0, 1]);
    assert!(!polygon.two_sided);
    // Counter-clockwise seen from the front: there the sum points away from the light, so its negative points at it.
    let g_at = |z: f64| {
        let point = DVec3::new(2.0, 3.5, z);
        light_vector(polygon.contours.iter().map(Vec::as_slice), point)
    };
    assert!(g_at(4.0).z > 0.0, "{}", g_at(4.0));
    assert!(g_at(2.0).z > 0.0, "{}", g_at(2.0));
}

#[test]
fn concave_and_holed_surfaces_keep_their_outline() {
    let cell = |x: i32, y: i32| {
        quad(
            DVec3::new(f64::from(x), f64::from(y), 0.0),
            DVec3::X,
            DVec3::Y,
        )
    };
    let corner = [(0, 0), (1, 0), (2, 0), (0, 1)]
        .map(|(x, y)| cell(x, y))
        .concat();
    let polygon = only(corner);
    check(&polygon, 0.0);
    assert_eq!(polygon.contours.len(), 1);
    assert_eq!(polygon.contours[0].len(), 6);

    let ring: Vec<_> = (0..9)
        .filter(|&index| index != 4)
        .flat_map(|index| cell(index % 3, index / 3))
        .collect();
    let polygon = only(ring);
    check(&polygon, 0.0);
    let areas: Vec<f64> = polygon
        .contours
        .iter()
        .map(|contour| 0.5 * area_vector(std::slice::from_ref(contour)).z)
        .collect();
    assert_eq!(areas, [9.0, -1.0]);
}

#[test]
fn outlines_that_touch_at_a_vertex_come_apart_there() {
    let cells = |cells: &[(i32, i32)]| {
        let triangles = cells
            .iter()
            .flat_map(|&(x, y)| {
                quad(
                    DVec3::new(f64::from(x), f64::from(y), 0.0),
                    DVec3::X,
                    DVec3::Y,
                )
            })
            .collect();
        let polygon = only(triangles);
        check(&polygon, 0.0);
        for contour in &polygon.contours {
            let mut seen = BTreeSet::new();
            for vertex in contour {
                let fresh = seen.insert(vertex.to_array().map(f64::to_bits));
                assert!(fresh, "{vertex} twice in {contour:?}");
            }
        }
        let area = |contour| 0.5 * area_vector(std::slice::from_ref(contour)).z;
        polygon.contours.iter().map(area).collect::<Vec<f64>>()
    };
    // A ring whose hole touches the outside at (2, 1).
    let ring = [(0, 0), (1, 0), (2, 1), (0, 1), (0, 2), (1, 2), (2, 2)];
    assert_eq!(cells(&ring), [8.0, -1.0]);
    // Two holes that touch each other at (2, 2).
    let window: Vec<_> = (0..16)
        .map(|index| (index % 4, index / 4))
        .filter(|cell| ![(1, 1), (2, 2)].contains(cell))
        .collect();
    assert_eq!(cells(&window), [16.0, -1.0, -1.0]);
}

#[test]
fn different_emission_stays_apart_and_sides_follow_the_material() {
    let two_sided = Material {
        double_sided: true,
        ..emitter(1.0)
    };
    let lights = collect(&scene_of(&[
        (emitter(1.0), quad(DVec3::ZERO, DVec3::X, DVec3::Y)),
        (emitter(2.0), quad(DVec3::X, DVec3::X, DVec3::Y)),
        (
            Material::default(),
            quad(2.0 * DVec3::X, DVec3::X, DVec3::Y),
        ),
        (two_sided, quad(3.0 * DVec3::X, DVec3::X, DVec3::Y)),
    ]));
    let found: Vec<_> = lights
        .polygons
        .iter()
        .map(|polygon| {
            (
                polygon.radiance.x,
                polygon.two_sided,
                polygon.surface.clone(),
            )
        })
        .collect();
    assert_eq!(
        found,
        [
            (1.0, false, vec![0, 1]),
            (2.0, false, vec![2, 3]),
            (1.0, true, vec![6, 7])
        ]
    );
}

#[test]
fn folded_and_stepped_surfaces_are_not_one_plane() {
    // A card with two fronts, a right angle, and a step.
    let up = quad(DVec3::ZERO, DVec3::X, DVec3::Y);
    let down = quad(DVec3::ZERO, DVec3::Y, DVec3::X);
    let wall = quad(DVec3::X, DVec3::Z, DVec3::Y);
    let lights = collect(&scene_of(&[(emitter(1.0), [up, down, wall].concat())]));
    assert_eq!(lights.polygons.len(), 3);
    assert!(lights.warnings.is_empty());
    for polygon in &lights.polygons {
        check(polygon, 0.0);
        assert_eq!(polygon.area, 1.0);
    }
    assert_eq!(lights.polygons[0].normal, -lights.polygons[1].normal);
}

#[test]
fn triangles_that_are_there_twice_shine_once() {
    let up = quad(DVec3::ZERO, DVec3::X, DVec3::Y);
    let mut twice = up.clone();
    twice.extend(up.iter().map(|&[a, b, c]| [b, c, a]));
    let lights = collect(&scene_of(&[(emitter(1.0), twice.clone())]));
    assert_eq!(lights.polygons.len(), 1);
    assert_eq!(lights.polygons[0].area, 1.0);
    let warning = lights.warnings.iter().next().expect("a warning");
    assert_eq!(warning.count, 2);

    // Turned over it is another light, unless both sides shine anyway.
    let turned: Vec<_> = up.iter().map(|&[a, b, c]| [a, c, b]).collect();
    let both = [up, turned].concat();
    assert_eq!(
        collect(&scene_of(&[(emitter(1.0), both.clone())]))
            .polygons
            .len(),
        2
    );
    let two_sided = Material {
        double_sided: true,
        ..emitter(1.0)
    };
    let lights = collect(&scene_of(&[(two_sided, both)]));
    assert_eq!(lights.polygons.len(), 1);
}

/// One primitive of a mesh, somewhere in the world.
struct Part {
    primitive: Primitive,
    material: Material,
    images: Vec<Image>,
    world_from_local: DAffine3,
}

impl Part {
    fn scene(self) -> Scene {
        Scene::assemble(
            "part",
            vec![Mesh {
                name: "mesh".to_owned(),
                source: 0,
                primitives: vec![self.primitive],
            }],
            vec![Instance {
                name: "node".to_owned(),
                node: 0,
                copy: None,
                mesh: 0,
                world_from_local: self.world_from_local,
                density: 1.0,
            }],
            vec![self.material],
            self.images,
        )
    }
}

/// A grid of n × n quads over `corner`, `u`, `v` with shared vertices and texture coordinates from 0 to 1.
fn grid(n: u32, corner: DVec3, u: DVec3, v: DVec3) -> Primitive {
    let mut positions = Vec::new();
    let mut texcoords = Vec::new();
    for j in 0..=n {
        for i in 0..=n {
            let (s, t) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
            positions.push((corner + s * u + t * v).as_vec3());
            texcoords.push(Vec2::new(s as f32, t as f32));
        }
    }
    let mut triangles = Vec::new();
    for j in 0..n {
        for i in 0..n {
            let a = j * (n + 1) + i;
            let (b, c, d) = (a + 1, a + n + 2, a + n + 1);
            triangles.push([a, b, c]);
            triangles.push([a, c, d]);
        }
    }
    Primitive {
        source: 0,
        material: 0,
        positions,
        normals: Vec::new(),
        texcoords: vec![texcoords],
        vertex_alpha: Vec::new(),
        triangles,
    }
}

#[test]
fn a_tessellated_plane_is_one_quad_wherever_it_stands() {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
    for (case, (scale, offset)) in [
        (1.0, 0.0),
        (1e-4, 0.0),
        (1e5, 0.0),
        (100.0, 1e5),
        (1.0, 37.0),
    ]
    .into_iter()
    .enumerate()
    {
        for through_node in [false, true] {
            let local = if through_node {
                DVec3::ZERO
            } else {
                DVec3::splat(offset)
            };
            let corner = turn * (-0.5 * scale * (DVec3::X + DVec3::Y)) + local;
            let primitive = grid(
                100,
                corner,
                turn * (scale * DVec3::X),
                turn * (scale * DVec3::Y),
            );
            let world_from_local = if through_node {
                DAffine3::from_scale_rotation_translation(
                    DVec3::new(1.0, 1.0, -2.0),
                    DQuat::from_rotation_y(0.3),
                    DVec3::splat(10.0 * offset),
                )
            } else {
                DAffine3::IDENTITY
            };
            let scene = Part {
                primitive,
                material: emitter(1.0),
                images: Vec::new(),
                world_from_local,
            }
            .scene();
            let lights = collect(&scene);
            assert_eq!(lights.polygons.len(), 1, "case {case}, {through_node}");
            let polygon = &lights.polygons[0];
            let local_size = local.x + scale;
            let step = f64::from(f32::EPSILON) * local_size + f64::EPSILON * 10.0 * offset;
            check(polygon, 2.0 * step);
            assert_eq!(polygon.contours.len(), 1);
            // Far from the origin the steps of f32 are coarser than the grid is straight: some vertices on the border stay.
            if local.x <= scale {
                assert_eq!(polygon.contours[0].len(), 4, "case {case}, {through_node}");
            }
            let front = scene.triangles[0].area_vector();
            assert!(polygon.normal.dot(front) > 0.0);
        }
    }
}

/// A closed sphere of `rings` × 2 `rings` quads, as a primitive with shared vertices.
fn sphere(rings: u32) -> Primitive {
    let sectors = 2 * rings;
    let mut primitive = grid(1, DVec3::ZERO, DVec3::X, DVec3::Y);
    primitive.positions = (0..=rings)
        .flat_map(|ring| (0..sectors).map(move |sector| (ring, sector)))
        .map(|(ring, sector)| {
            let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
            let angle = std::f64::consts::TAU * f64::from(sector) / f64::from(sectors);
            DVec3::new(
                polar.sin() * angle.cos(),
                polar.cos(),
                -polar.sin() * angle.sin(),
            )
            .as_vec3()
        })
        .collect();
    primitive.texcoords.clear();
    primitive.triangles.clear();
    for ring in 0..rings {
        for sector in 0..sectors {
            let next = (sector + 1) % sectors;
            let (a, d) = (ring * sectors + sector, ring * sectors + next);
            let (b, c) = (a + sectors, d + sectors);
            if ring > 0 {
                primitive.triangles.push([a, b, d]);
            }
            if ring + 1 < rings {
                primitive.triangles.push([b, c, d]);
            }
        }
    }
    primitive
}

#[test]
fn a_sphere_of_many_triangles_stays_a_sphere() {
    let rings = 200;
    let scene = Part {
        primitive: sphere(rings),
        material: emitter(1.0),
        images: Vec::new(),
        world_from_local: DAffine3::IDENTITY,
    }
    .scene();
    let lights = collect(&scene);
    // The two triangles of a quad of the sphere are coplanar but for rounding; nothing larger is.
    assert!(lights.polygons.len() >= (rings * (rings - 1)) as usize);
    let area: f64 = lights.polygons.iter().map(|polygon| polygon.area).sum();
    assert!((area / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3);
    for polygon in &lights.polygons {
        let radial = polygon.triangles[0][0].normalize();
        assert!(polygon.normal.dot(radial) > 0.99);
    }
    let mut covered: Vec<u32> = lights
        .polygons
        .iter()
        .flat_map(|polygon| polygon.surface.iter().copied())
        .collect();
    covered.sort_unstable();
    assert!(covered.iter().copied().eq(0..scene.triangles.len() as u32));
    assert!(
        lights
            .polygons
            .is_sorted_by_key(|polygon| polygon.surface[0])
    );
}

#[test]
fn random_planar_surfaces_keep_area_and_light_vector() {
    let mut holed = 0;
    for case in 0..300 {
        let mut rng = Rng::new(case);
        let n = 2 + (rng.bits() % 9) as usize;
        let density = rng.range(0.3, 1.0);
        let scale = 10f64.powf(rng.range(-4.0, 5.0));
        let (u, v) = rng.direction().any_orthonormal_pair();
        let origin = scale * rng.range(0.0, 3.0) * rng.direction();
        // A jittered grid with some triangles left out; now and then a vertex within another triangle's edge.
        let mut vertices = Vec::new();
        for j in 0..=n {
            for i in 0..=n {
                let (s, t) = (
                    i as f64 + rng.range(-0.3, 0.3),
                    j as f64 + rng.range(-0.3, 0.3),
                );
                vertices.push(origin + scale / n as f64 * (s * u + t * v));
            }
        }
        let mut triangles = Vec::new();
        for j in 0..n {
            for i in 0..n {
                let a = j * (n + 1) + i;
                let [a, b, c, d] = [a, a + 1, a + n + 2, a + n + 1].map(|k| vertices[k]);
                for triangle in [[a, b, c], [a, c, d]] {
                    if rng.unit() > density {
                        continue;
                    }
                    if case % 2 == 1 && rng.unit() < 0.1 {
                        let [p, q, r] = triangle;
                        let middle = p.lerp(q, 0.5);
                        triangles.extend([[p, middle, r], [middle, q, r]]);
                    } else {
                        triangles.push(triangle);
                    }
                }
            }
        }
        let scene = scene_of(&[(emitter(1.0), triangles.clone())]);
        let lights = collect(&scene);
        let step = f64::from(f32::EPSILON) * 4.0 * scale;
        for polygon in &lights.polygons {
            check(polygon, step);
            holed += usize::from(polygon.contours.len() > 1);
        }
        let area: f64 = lights.polygons.iter().map(|polygon| polygon.area).sum();
        let want: f64 = scene
            .triangles
            .iter()
            .map(|triangle| 0.5 * triangle.area_vector().length())
            .sum();
        assert!((area - want).abs() <= 1e-12 * want, "case {case}");
        assert!(
            density < 0.99 || case % 2 == 1 || lights.polygons.len() == 1,
            "case {case}: {} polygons",
            lights.polygons.len()
        );
    }
    assert!(holed > 50, "only {holed} polygons with several contours");
}

/// An emissive texture over the first texture coordinates.
fn texture() -> Texture {
    Texture {
        image: Some(0),
        texcoord: 0,
        transform: DAffine2::IDENTITY,
        wrap: [Wrap::ClampToEdge; 2],
    }
}

/// A grid of 2 × 2 quads over 4 × 4 m² with a picture.
fn screen(side: u32, pixel: impl Fn(u32, u32) -> [u8; 4]) -> Part {
    Part {
        primitive: grid(2, DVec3::ZERO, 4.0 * DVec3::X, 4.0 * DVec3::Y),
        material: Material {
            emissive: Vec3::new(10.0, 20.0, 30.0),
            emissive_texture: Some(texture()),
            ..Material::default()
        },
        images: vec![Image {
            width: side,
            height: side,
            rgba: (0..side * side)
                .map(|index| pixel(index % side, index / side))
                .collect(),
        }],
        world_from_local: DAffine3::IDENTITY,
    }
}

/// Flux per steradian by looking at `n`² points of every triangle.
fn brute_flux(scene: &Scene, n: u32, visible: impl Fn(u32, [f64; 3]) -> bool) -> DVec3 {
    let mut flux = DVec3::ZERO;
    for (index, triangle) in scene.triangles.iter().enumerate() {
        let mut mean = DVec3::ZERO;
        for i in 0..n {
            for j in 0..n {
                // The lower half of the unit square, the upper one folded onto it.
                let (s, t) = (
                    (f64::from(i) + 0.5) / f64::from(n),
                    (f64::from(j) + 0.25) / f64::from(n),
                );
                let (s, t) = if s + t > 1.0 {
                    (1.0 - s, 1.0 - t)
                } else {
                    (s, t)
                };
                let weights = [1.0 - s - t, s, t];
                if visible(index as u32, weights) {
                    mean += scene.emission(index as u32, weights);
                }
            }
        }
        flux += 0.5 * triangle.area_vector().length() * mean / f64::from(n * n);
    }
    flux
}

fn flux(lights: &Lights) -> DVec3 {
    lights
        .polygons
        .iter()
        .map(|polygon| polygon.area * polygon.radiance)
        .sum()
}

#[test]
fn a_uniform_picture_gives_one_polygon() {
    for side in [1, 16] {
        let scene = screen(side, |_, _| [128, 255, 0, 255]).scene();
        let lights = collect(&scene);
        assert_eq!(lights.polygons.len(), 1);
        let polygon = &lights.polygons[0];
        check(polygon, 0.0);
        assert_eq!(polygon.contours[0].len(), 4);
        let want = scene.emission(0, [0.2, 0.3, 0.5]).as_vec3().as_dvec3();
        assert_eq!(polygon.radiance, want);
        assert_eq!(polygon.radiance.z, 0.0);
    }
}

/// A name and the colour of each pixel.
type Picture<'a> = (&'a str, &'a dyn Fn(u32, u32) -> [u8; 4]);

#[test]
fn textured_emission_keeps_its_flux() {
    let gradient = |x: u32, y: u32| [(8 * x) as u8, (8 * y) as u8, (4 * (x + y)) as u8, 255];
    let checker = |x: u32, y: u32| [[0; 4], [255; 4]][((x / 4 + y / 4) % 2) as usize];
    let spot = |x: u32, y: u32| {
        let inside = (10..14).contains(&x) && (17..23).contains(&y);
        [[0, 0, 0, 255], [255; 4]][usize::from(inside)]
    };
    let noise = |x: u32, y: u32| {
        let bits = Rng::new(u64::from(32 * y + x)).bits();
        [bits as u8, (bits >> 8) as u8, (bits >> 16) as u8, 255]
    };
    let pictures: [Picture<'_>; 4] = [
        ("gradient", &gradient),
        ("checker", &checker),
        ("spot", &spot),
        ("noise", &noise),
    ];
    for (name, picture) in pictures {
        let scene = screen(32, picture).scene();
        let want = brute_flux(&scene, 400, |_, _| true);
        let mut counts = Vec::new();
        for tolerance in [1.0, 0.1, 0.03] {
            let lights = lights::collect(
                &scene,
                &Options {
                    texture_tolerance: tolerance,
                    ..Options::default()
                },
            );
            // A piece has at least 16 samples, one in each of its equal parts, and all pieces together thousands.
            let error = (flux(&lights) - want).abs() / want.max_element();
            assert!(error.max_element() < 0.01, "{name} at {tolerance}: {error}");
            for polygon in &lights.polygons {
                check(polygon, 1e-12);
                assert_eq!(polygon.normal, DVec3::Z);
            }
            counts.push(lights.polygons.len());
        }
        assert!(counts[0] < counts[2], "{name}: {counts:?}");
    }
}

#[test]
fn a_bright_spot_is_found_and_the_dark_rest_left_out() {
    let scene = screen(32, |x, y| {
        let inside = (8..16).contains(&x) && (16..24).contains(&y);
        [[0, 0, 0, 255], [255; 4]][usize::from(inside)]
    })
    .scene();
    let lights = lights::collect(
        &scene,
        &Options {
            texture_tolerance: 0.01,
            ..Options::default()
        },
    );
    // A quarter by a quarter of 4 × 4 m², with a seam of one texel (0.125 m) where the picture is interpolated. What lies farther out
    // is too dim to be worth a split.
    let bright = |polygon: &&Polygon| polygon.radiance.x > 0.1;
    let lit: f64 = lights
        .polygons
        .iter()
        .filter(bright)
        .map(|polygon| polygon.area)
        .sum();
    assert!((1.0..1.7).contains(&lit), "{lit}");
    for vertex in lights
        .polygons
        .iter()
        .filter(bright)
        .flat_map(|polygon| &polygon.contours[0])
    {
        assert!(
            vertex.x > 0.8 && vertex.x < 2.2 && vertex.y > 1.8 && vertex.y < 3.2,
            "{vertex}"
        );
    }
    let dark: f64 = 16.0
        - lights
            .polygons
            .iter()
            .map(|polygon| polygon.area)
            .sum::<f64>();
    assert!(dark > 8.0, "{dark}");
    // The even inside is one polygon, although it was cut into pieces of different sizes.
    let inside: Vec<f64> = lights
        .polygons
        .iter()
        .filter(|polygon| polygon.radiance.x == 10.0)
        .map(|polygon| polygon.area)
        .collect();
    assert_eq!(inside.len(), 1, "{inside:?}");
    assert!(inside[0] > 0.5, "{inside:?}");
}

#[test]
fn the_budget_of_splits_is_kept_and_said() {
    let scene = screen(64, |x, y| {
        let bits = Rng::new(u64::from(64 * y + x)).bits();
        [bits as u8; 4]
    })
    .scene();
    for max_texture_splits in [1, 50] {
        let lights = lights::collect(
            &scene,
            &Options {
                texture_tolerance: 0.001,
                max_texture_splits,
                ..Options::default()
            },
        );
        assert_eq!(lights.polygons.len(), 8 + max_texture_splits);
        assert_eq!(lights.warnings.iter().count(), 1);
    }
}

#[test]
fn what_a_mask_cuts_away_does_not_shine() {
    let half = |x: u32, _: u32| [[255, 255, 255, 0], [255; 4]][usize::from(x >= 16)];
    let mut part = screen(32, half);
    part.material.emissive_texture = None;
    part.material.base_color_texture = Some(texture());
    part.material.alpha = Alpha::Mask { cutoff: 0.5 };
    let scene = part.scene();
    let lights = collect(&scene);
    let want = brute_flux(&scene, 400, |triangle, weights| {
        scene.alpha(triangle, weights) >= 0.5
    });
    assert!(
        (want / DVec3::new(80.0, 160.0, 240.0) - 1.0)
            .abs()
            .max_element()
            < 0.02
    );
    let error = (flux(&lights) - want).abs() / want.max_element();
    assert!(error.max_element() < 0.01, "{error}");
    assert!(lights.polygons.iter().all(|polygon| {
        polygon
            .triangles
            .iter()
            .flatten()
            .all(|vertex| vertex.x > 1.8)
    }));
}

#[test]
fn the_same_scene_gives_the_same_lights() {
    let lights = || {
        let scene = screen(32, |x, y| [(x * y) as u8, x as u8, y as u8, 255]).scene();
        format!("{:?}", collect(&scene))
    };
    assert_eq!(lights(), lights());
}

#[test]
fn scenes_without_emission_have_no_lights() {
    let dark = collect(&scene_of(&[(
        Material::default(),
        quad(DVec3::ZERO, DVec3::X, DVec3::Y),
    )]));
    assert!(dark.polygons.is_empty() && dark.warnings.is_empty());
    assert!(collect(&scene_of(&[])).polygons.is_empty());
}

//! What a coarse lattice misses, a finer one finds.

use glam::{DAffine3, DVec3};

use super::{Outcome, Tile};
use crate::lights::{Lights, Polygon};
use crate::math;
use crate::scene::{Instance, Material, Mesh, Primitive, Scene};
use crate::transport::source::Source;
use crate::transport::{self, Estimator, Options, Receiver, contour};
use crate::visibility::{Occluders, Shaft};

/// Cells of the plate along each side; fine enough for its outlines not to be looked up.
const SIDE: u32 = 48;

/// A plate of 3 × 3 m, 2.5 m up, without one of seven of its blocks of 2 × 2 cells.
fn perforated_plate() -> Scene {
    let per_row = SIDE + 1;
    let place = |index: u32| (3.0 * index as f32 / SIDE as f32) - 1.5;
    let positions: Vec<glam::Vec3> = (0..per_row * per_row)
        .map(|index| glam::Vec3::new(place(index % per_row), 2.5, place(index / per_row)))
        .collect();
    let triangles = (0..SIDE * SIDE)
        .filter(|&cell| {
            let (x, z) = (cell % SIDE / 2, cell / SIDE / 2);
            !math::hash(u64::from(x), u64::from(z), 0).is_multiple_of(7)
        })
        .flat_map(|cell| {
            let a = cell / SIDE * per_row + cell % SIDE;
            let [b, c, d] = [a + 1, a + per_row + 1, a + per_row];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    let primitive = Primitive {
        source: 0,
        material: 0,
        positions,
        normals: Vec::new(),
        texcoords: Vec::new(),
        vertex_alpha: Vec::new(),
        triangles,
    };
    let mesh = Mesh {
        name: "plate".to_owned(),
        source: 0,
        primitives: vec![primitive],
    };
    let instance = Instance {
        name: "plate".to_owned(),
        node: 0,
        copy: None,
        mesh: 0,
        world_from_local: DAffine3::IDENTITY,
        density: 1.0,
    };
    let materials = vec![Material::default()];
    Scene::assemble("plate", vec![mesh], vec![instance], materials, Vec::new())
}

/// A light of 2 × 2 m that looks down from 5 m.
fn light() -> Polygon {
    let corner = |x: f64, z: f64| DVec3::new(x, 5.0, z);
    let [a, b, c, d] = [
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    ];
    Polygon {
        contours: vec![vec![a, b, c, d]],
        triangles: vec![[a, b, c], [a, c, d]],
        normal: -DVec3::Y,
        area: 4.0,
        radiance: DVec3::ONE,
        two_sided: false,
        surface: Vec::new(),
    }
}

/// Mean |ΔG| over some points below the plate with a start lattice of `cells`².
fn error(scene: &Scene, cells: usize) -> f64 {
    let occluders = Occluders::build(scene);
    let lights = Lights {
        polygons: vec![light()],
        ..Lights::default()
    };
    let polygon = &lights.polygons[0];
    let source = Source::new(polygon);
    let exact = Options {
        estimator: Estimator::Exact,
        ..Options::default()
    };
    let n_points = 30;
    let mut sum = 0.0;
    for seed in 0..n_points {
        let [x, z] = math::unit_pair(math::hash(seed, 7, 0));
        let receiver = Receiver {
            position: DVec3::new(x - 0.5, 0.0, z - 0.5),
            normal: DVec3::Y,
            seed,
        };
        let planes = [(receiver.position, receiver.normal)];
        let shaft = Shaft::new(&planes, &polygon.contours[0], polygon.normal);
        let candidates = occluders.in_shaft(&shaft, &|_| false);
        let plane = (polygon.contours[0][0], polygon.normal);
        let tile = Tile::new(&occluders, candidates, plane).expect("the plate is below the light");
        let mut borders = Vec::new();
        assert!(source.outline(&receiver, receiver.position, &mut borders));
        let away = -polygon.normal;
        let (outcome, _) = tile.contour(receiver.position, &borders, away, &[], cells);
        // What is unclear is clipped, without error.
        let Outcome::Contour(pieces) = outcome else {
            continue;
        };
        let traced = contour::sum(&pieces, receiver.normal, false);
        let (samples, _) = transport::gather(&[receiver], &lights, &occluders, &exact);
        sum += (traced.g - samples[0].g[0]).length();
    }
    sum / n_points as f64
}

#[test]
fn holes_between_the_rays_are_found_by_a_finer_lattice() {
    let scene = perforated_plate();
    // The holes appear a quarter of a metre wide on a light of two.
    let errors = [2, 4, 8, 16].map(|cells| error(&scene, cells));
    assert!(errors[0] > 1e-3, "{errors:?}");
    for pair in errors.windows(2) {
        assert!(pair[1] <= pair[0], "{errors:?}");
    }
    assert!(errors[3] < 1e-12, "{errors:?}");
}

//! Draws a baked level as an engine would, from the files of the bake alone: `cargo run --release --example picture -- room.lumel/room.glb
//! docs/room.png`.
//!
//! Per pixel: the surface that is seen, its `TEXCOORD_1`, a bilinear lookup in the three light vector maps, the normal map, and
//! E(n) = max(0, G·n). No light is evaluated here.

use std::error::Error;
use std::path::Path;

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};
use lumel::scene::{Options, Primitive, Scene, Triangle};
use lumel::visibility::{Occluders, Visibility};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde_json::Value;

const EXTENSION: &str = "LUMEL_light_vector_map";
const SIZE: [u32; 2] = [800, 450];
/// Rays per pixel along each axis.
const SUBPIXELS: u32 = 3;
/// The camera stands in the corner of the first room and looks through the doorway.
const EYE: DVec3 = DVec3::new(0.4, 1.8, 4.6);
const LOOK_AT: DVec3 = DVec3::new(5.6, 1.2, 1.7);
/// Half the height of the view at a distance of 1.
const HALF_HEIGHT: f64 = 0.52;
/// Luminance in nit that is drawn at 63 % of white.
const EXPOSURE: f64 = 60.0;

/// A linear RGB picture, row 0 on top.
struct Map {
    size: [usize; 2],
    texels: Vec<DVec3>,
}

/// A bake as it was read.
struct Bake {
    scene: Scene,
    /// Per page, the light vector maps of red, green and blue.
    pages: Vec<[Map; 3]>,
    /// Per material its normal texture.
    normal_maps: Vec<Option<Map>>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [glb, picture] = arguments.as_slice() else {
        return Err("usage: picture BAKED.glb PICTURE.png".into());
    };
    let bake = Bake::read(Path::new(glb))?;
    let occluders = Occluders::build(&bake.scene);
    let rows: Vec<Vec<Rgb<u8>>> = (0..SIZE[1])
        .into_par_iter()
        .map(|y| {
            (0..SIZE[0])
                .map(|x| pixel(&bake, &occluders, x, y))
                .collect()
        })
        .collect();
    let picture_of = RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| rows[y as usize][x as usize]);
    picture_of.save(picture)?;
    Ok(())
}

fn pixel(bake: &Bake, occluders: &impl Visibility, x: u32, y: u32) -> Rgb<u8> {
    let forward = (LOOK_AT - EYE).normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let up = right.cross(forward);
    let [width, height] = SIZE.map(f64::from);
    let mut sum = DVec3::ZERO;
    for sub in 0..SUBPIXELS * SUBPIXELS {
        let [sub_x, sub_y] = [sub % SUBPIXELS, sub / SUBPIXELS]
            .map(|sub| (f64::from(sub) + 0.5) / f64::from(SUBPIXELS));
        let across = (2.0 * (f64::from(x) + sub_x) - width) / height;
        let upwards = 1.0 - 2.0 * (f64::from(y) + sub_y) / height;
        let direction = (forward + (right * across + up * upwards) * HALF_HEIGHT).normalize();
        let luminance = bake.luminance(occluders, direction);
        // Tone-mapped before averaging, so that edges against lamps are smooth.
        sum += DVec3::ONE - (-luminance / EXPOSURE).exp();
    }
    let linear = sum / f64::from(SUBPIXELS * SUBPIXELS);
    Rgb(linear.to_array().map(|value| {
        let encoded = if value <= 0.003_130_8 {
            12.92 * value
        } else {
            1.055 * value.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * encoded).round() as u8
    }))
}

impl Bake {
    fn read(glb: &Path) -> Result<Self, Box<dyn Error>> {
        let scene = Scene::open(glb, &Options::default())?;
        let folder = glb.parent().unwrap_or(Path::new("."));
        let json = &scene.source.json;
        let maps = json["extensions"][EXTENSION]["maps"]
            .as_array()
            .ok_or("the glTF file was not written by a bake")?;
        let mut pages = Vec::new();
        for map in maps {
            let read = |channel: &str| -> Result<Map, Box<dyn Error>> {
                let file = map["lightVector"][channel]
                    .as_str()
                    .ok_or("the bake has no light vectors; bake with --directional")?;
                Map::from_exr(&folder.join(file))
            };
            pages.push([read("r")?, read("g")?, read("b")?]);
        }
        let n_materials = scene.materials.len();
        let normal_maps = (0..n_materials)
            .map(|material| normal_map(&scene, material))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            scene,
            pages,
            normal_maps,
        })
    }

    /// Luminance in nit that reaches the eye from `direction`.
    fn luminance(&self, occluders: &impl Visibility, direction: DVec3) -> DVec3 {
        let Some(hit) = occluders.closest(EYE, direction, f64::INFINITY, &|_| false) else {
            return DVec3::ZERO;
        };
        let triangle = &self.scene.triangles[hit.triangle as usize];
        let weights = barycentric(triangle, EYE + direction * hit.distance);
        let material = &self.scene.materials[triangle.material as usize];
        let emitted = if hit.front || material.double_sided {
            self.scene.emission(hit.triangle, weights)
        } else {
            DVec3::ZERO
        };
        let [r, g, b, _] = material.base_color.map(f64::from);
        let reflected = self.irradiance(triangle, weights) / std::f64::consts::PI;
        emitted + reflected * DVec3::new(r, g, b)
    }

    /// E(n) = max(0, G·n) of a surface point, n from the normal map.
    fn irradiance(&self, triangle: &Triangle, weights: [f64; 3]) -> DVec3 {
        let instance = &self.scene.instances[triangle.instance as usize];
        let node = &self.scene.source.json["nodes"][instance.node]["extensions"][EXTENSION];
        let primitive = &self.scene.meshes[instance.mesh].primitives[triangle.primitive as usize];
        let (Some(page), Some(place)) = (
            node["map"]
                .as_u64()
                .and_then(|page| self.pages.get(page as usize)),
            texcoord(primitive, 1, triangle, weights),
        ) else {
            return DVec3::ZERO;
        };
        let pair = |value: &Value| {
            DVec2::new(
                value[0].as_f64().unwrap_or_default(),
                value[1].as_f64().unwrap_or_default(),
            )
        };
        let place = place * pair(&node["scale"]) + pair(&node["offset"]);
        let normal = self.normal(triangle, primitive, weights);
        let along = page.each_ref().map(|map| map.bilinear(place).dot(normal));
        DVec3::from_array(along).max(DVec3::ZERO)
    }

    /// The shaded normal in world space.
    fn normal(&self, triangle: &Triangle, primitive: &Primitive, weights: [f64; 3]) -> DVec3 {
        let front = triangle.area_vector().normalize();
        let instance = &self.scene.instances[triangle.instance as usize];
        let normal = if primitive.normals.is_empty() {
            front
        } else {
            let normals = triangle
                .corners
                .map(|corner| primitive.normals[corner as usize].as_dvec3());
            let local = weighted(normals, weights);
            (instance.world_from_local.matrix3.inverse().transpose() * local).normalize()
        };
        let (Some(map), Some(place)) = (
            &self.normal_maps[triangle.material as usize],
            texcoord(primitive, 0, triangle, weights),
        ) else {
            return normal;
        };
        // The direction in which u grows, from the edges of the triangle.
        let [a, b, c] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .map(|corner| texcoord(primitive, 0, triangle, corner).unwrap_or_default());
        let (ab, ac) = (b - a, c - a);
        let [origin, end_b, end_c] = triangle.vertices;
        let along_u =
            ((end_b - origin) * ac.y - (end_c - origin) * ab.y) * ab.perp_dot(ac).signum();
        let tangent = (along_u - normal * along_u.dot(normal)).normalize_or_zero();
        // Up in the picture is towards smaller v.
        let upward = normal.cross(tangent) * -ab.perp_dot(ac).signum() * front.dot(normal).signum();
        let tilt = map.bilinear(place - place.floor()) * 2.0 - 1.0;
        (tangent * tilt.x + upward * tilt.y + normal * tilt.z).normalize()
    }
}

impl Map {
    fn from_exr(path: &Path) -> Result<Self, Box<dyn Error>> {
        let image = exr::prelude::read_first_rgba_layer_from_file(
            path,
            |size, _| Self {
                size: [size.width(), size.height()],
                texels: vec![DVec3::ZERO; size.area()],
            },
            |map, place, (r, g, b, _): (f32, f32, f32, f32)| {
                map.texels[place.y() * map.size[0] + place.x()] =
                    DVec3::new(r.into(), g.into(), b.into());
            },
        )?;
        Ok(image.layer_data.channel_data.pixels)
    }

    /// Between the four texels around `place`, which is in 0..1 from the top left corner; the border is continued.
    fn bilinear(&self, place: DVec2) -> DVec3 {
        let at = |column: f64, row: f64| {
            let clamp = |index: f64, size: usize| index.clamp(0.0, size as f64 - 1.0) as usize;
            self.texels[clamp(row, self.size[1]) * self.size[0] + clamp(column, self.size[0])]
        };
        let centre = place * DVec2::new(self.size[0] as f64, self.size[1] as f64) - 0.5;
        let (base, part) = (centre.floor(), centre - centre.floor());
        let row = |y: f64| at(base.x, y).lerp(at(base.x + 1.0, y), part.x);
        row(base.y).lerp(row(base.y + 1.0), part.y)
    }
}

/// The normal texture of a material, when it has one that lies in the file or beside it.
fn normal_map(scene: &Scene, material: usize) -> Result<Option<Map>, Box<dyn Error>> {
    let json = &scene.source.json;
    let Some(texture) = json["materials"][material]["normalTexture"]["index"].as_u64() else {
        return Ok(None);
    };
    let source = json["textures"][texture as usize]["source"].as_u64();
    let image = &json["images"][source.ok_or("the texture has no picture")? as usize];
    let bytes = if let Some(uri) = image["uri"].as_str() {
        std::fs::read(scene.source.folder.join(uri))?
    } else {
        let number = |value: &Value| value.as_u64().unwrap_or_default() as usize;
        let view = &json["bufferViews"][number(&image["bufferView"])];
        let start = number(&view["byteOffset"]);
        scene.source.buffers[number(&view["buffer"])][start..][..number(&view["byteLength"])]
            .to_vec()
    };
    let picture = image::load_from_memory(&bytes)?.to_rgb8();
    Ok(Some(Map {
        size: [picture.width() as usize, picture.height() as usize],
        texels: picture
            .pixels()
            .map(|pixel| DVec3::from_array(pixel.0.map(f64::from)) / 255.0)
            .collect(),
    }))
}

fn texcoord(
    primitive: &Primitive,
    set: usize,
    triangle: &Triangle,
    weights: [f64; 3],
) -> Option<DVec2> {
    let coordinates = primitive.texcoords.get(set).filter(|set| !set.is_empty())?;
    let corners = triangle
        .corners
        .map(|corner| coordinates[corner as usize].as_dvec2());
    Some(corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2])
}

fn weighted([a, b, c]: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    a * weights[0] + b * weights[1] + c * weights[2]
}

/// Weights of the triangle's corners at a point of its plane.
fn barycentric(triangle: &Triangle, point: DVec3) -> [f64; 3] {
    let [a, b, c] = triangle.vertices;
    let normal = triangle.area_vector();
    let part = |from: DVec3, to: DVec3| {
        (to - from).cross(point - from).dot(normal) / normal.length_squared()
    };
    [part(b, c), part(c, a), part(a, b)]
}

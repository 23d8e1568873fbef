//! `lumel view`: what a browser draws of a bake is what Rust computes for the same pixels, and the server gives out the bake and
//! nothing else.

#![expect(clippy::print_stdout, reason = "the agreement is a figure to report")]

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;

use glam::{DVec2, DVec3, Vec3};
use lumel::runtime;
use lumel::scene::{Options, Primitive, Scene, Triangle};
use lumel::visibility::{Occluders, Visibility};
use serde_json::Value;

use crate::output::maps;
use crate::{browser, engine_schema, support};

const EXTENSION: &str = "LUMEL_light_vector_map";
/// Pixels of the picture that is compared.
const SIZE: [usize; 2] = [160, 120];
/// The camera stands in the corner of the first room and looks at brick walls and through the doorway.
const EYE: DVec3 = DVec3::new(0.4, 1.8, 4.6);
const LOOK_AT: DVec3 = DVec3::new(5.6, 1.2, 1.7);
/// Vertical angle of view of the viewer in degrees.
const FIELD_OF_VIEW: f64 = 55.0;

/// A bake of the bundled room with every map that the viewer reads, made once.
static ROOM: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("temporary folder");
    let output = Command::new(env!("CARGO_BIN_EXE_lumel"))
        .arg("bake")
        .arg(support::fixture("room/room.gltf"))
        .arg("-o")
        .arg(folder.path())
        .args(["--texels-per-metre", "4", "--samples", "16"])
        .args(["--outputs", "e,g,phi,error,glb,ktx2,preview"])
        .args(["--export", "bakery-sh,godot-sh,unity-directional,bevy"])
        .output()
        .expect("the command runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    folder
});

/// A picture, row 0 on top.
struct Map {
    size: [usize; 2],
    texels: Vec<DVec3>,
}

impl Map {
    fn from_exr(path: &Path, size: [usize; 2]) -> Self {
        let channels = maps::channels(path);
        let [b, g, r] = [0, 1, 2].map(|k| channels[k].1.values_as_f32().collect::<Vec<f32>>());
        Self {
            size,
            texels: (0..r.len())
                .map(|at| Vec3::new(r[at], g[at], b[at]).as_dvec3())
                .collect(),
        }
    }

    /// Between the four texels around `place`, which is in 0..1 from the top left corner; continued or repeated outside.
    fn bilinear(&self, place: DVec2, repeat: bool) -> DVec3 {
        let index = |x: f64, size: usize| {
            if repeat {
                x.rem_euclid(size as f64) as usize % size
            } else {
                x.clamp(0.0, size as f64 - 1.0) as usize
            }
        };
        let at = |x: f64, y: f64| {
            self.texels[index(y, self.size[1]) * self.size[0] + index(x, self.size[0])]
        };
        let centre = place * DVec2::new(self.size[0] as f64, self.size[1] as f64) - 0.5;
        let (base, part) = (centre.floor(), centre - centre.floor());
        let row = |y: f64| at(base.x, y).lerp(at(base.x + 1.0, y), part.x);
        row(base.y).lerp(row(base.y + 1.0), part.y)
    }
}

/// The bake as an engine reads it.
struct Bake {
    scene: Scene,
    /// Per page: E, G of red, green, blue, and φ.
    pages: Vec<[Map; 5]>,
    bricks: Map,
}

/// Which formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Model {
    Plain,
    Vector,
    SkySun,
}

impl Bake {
    fn read(folder: &Path) -> Self {
        let glb = folder.join("room.glb");
        let scene = Scene::open(&glb, &Options::default()).unwrap_or_else(|e| panic!("{e}"));
        let maps = &scene.source.json["extensions"][EXTENSION]["maps"];
        let pages = maps
            .as_array()
            .expect("pages")
            .iter()
            .map(|map| {
                let size = ["width", "height"].map(|key| map[key].as_u64().unwrap_or(0) as usize);
                let g = &map["lightVector"];
                [
                    &map["irradiance"],
                    &g["r"],
                    &g["g"],
                    &g["b"],
                    &map["fluence"],
                ]
                .map(|uri| Map::from_exr(&folder.join(uri.as_str().expect("a URI")), size))
            })
            .collect();
        let picture = image::open(support::fixture("room/bricks_normal.png"))
            .expect("a PNG")
            .to_rgb8();
        let bricks = Map {
            size: [picture.width() as usize, picture.height() as usize],
            texels: picture
                .pixels()
                .map(|pixel| DVec3::from_array(pixel.0.map(f64::from)) / 255.0)
                .collect(),
        };
        Self {
            scene,
            pages,
            bricks,
        }
    }

    /// E of the surface that a pixel's centre shows; `None` where there is none with light of its own. And whether it is normal-mapped.
    fn pixel(
        &self,
        occluders: &impl Visibility,
        x: usize,
        y: usize,
        model: Model,
    ) -> Option<(DVec3, bool)> {
        let forward = (LOOK_AT - EYE).normalize();
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        let half = (0.5 * FIELD_OF_VIEW).to_radians().tan();
        let [width, height] = SIZE.map(|n| n as f64);
        let across = (2.0 * (x as f64 + 0.5) - width) / height;
        let upwards = 1.0 - 2.0 * (y as f64 + 0.5) / height;
        let direction = (forward + (right * across + up * upwards) * half).normalize();
        let hit = occluders.closest(EYE, direction, f64::INFINITY, &|_| false)?;
        let triangle = &self.scene.triangles[hit.triangle as usize];
        let weights = barycentric(triangle, EYE + direction * hit.distance);
        let instance = &self.scene.instances[triangle.instance as usize];
        let node = &self.scene.source.json["nodes"][instance.node]["extensions"][EXTENSION];
        let primitive = &self.scene.meshes[instance.mesh].primitives[triangle.primitive as usize];
        let page = &self.pages[node["map"].as_u64()? as usize];
        let pair =
            |value: &Value| DVec2::from_array([0, 1].map(|k| value[k].as_f64().unwrap_or(0.0)));
        let place = texcoord(primitive, 1, triangle, weights)? * pair(&node["scale"])
            + pair(&node["offset"]);
        let [e, red, green, blue, phi] = page.each_ref().map(|map| map.bilinear(place, false));
        let (base, n, bumped) = self.normals(triangle, primitive, weights);
        let light = [red, green, blue].map(DVec3::as_vec3);
        let phi = phi.as_vec3().to_array();
        let [base, n] = [base, n].map(DVec3::as_vec3);
        let shown = [0, 1, 2].map(|channel| match model {
            Model::Plain => e.as_vec3()[channel],
            Model::Vector => runtime::irradiance(light[channel], n),
            Model::SkySun => runtime::sky_and_sun(light[channel], phi[channel], base, n),
        });
        Some((Vec3::from_array(shown).as_dvec3(), bumped))
    }

    /// The interpolated normal and the bumped one, from the edges of the triangle instead of its authored tangents; whether they differ.
    fn normals(
        &self,
        triangle: &Triangle,
        primitive: &Primitive,
        weights: [f64; 3],
    ) -> (DVec3, DVec3, bool) {
        let front = triangle.area_vector().normalize();
        let instance = &self.scene.instances[triangle.instance as usize];
        let normals = triangle
            .corners
            .map(|corner| primitive.normals[corner as usize].as_dvec3());
        let local = normals[0] * weights[0] + normals[1] * weights[1] + normals[2] * weights[2];
        let to_world = instance.world_from_local.matrix3.inverse().transpose();
        let base = (to_world * local).normalize();
        let material = &self.scene.materials[triangle.material as usize];
        let place = texcoord(primitive, 0, triangle, weights);
        let Some(place) = place.filter(|_| material.normal_mapped) else {
            return (base, base, false);
        };
        let [a, b, c] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
            .map(|corner| texcoord(primitive, 0, triangle, corner).expect("the same set"));
        let (ab, ac) = (b - a, c - a);
        let [origin, end_b, end_c] = triangle.vertices;
        let along_u =
            ((end_b - origin) * ac.y - (end_c - origin) * ab.y) * ab.perp_dot(ac).signum();
        let tangent = (along_u - base * along_u.dot(base)).normalize();
        // Up in the picture is towards smaller v.
        let upward = base.cross(tangent) * -ab.perp_dot(ac).signum() * front.dot(base).signum();
        let tilt = self.bricks.bilinear(place, true) * 2.0 - 1.0;
        let bumped = (tangent * tilt.x + upward * tilt.y + base * tilt.z).normalize();
        (base, bumped, true)
    }
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

/// Weights of the triangle's corners at a point of its plane.
fn barycentric(triangle: &Triangle, point: DVec3) -> [f64; 3] {
    let [a, b, c] = triangle.vertices;
    let normal = triangle.area_vector();
    let part = |from: DVec3, to: DVec3| {
        (to - from).cross(point - from).dot(normal) / normal.length_squared()
    };
    [part(b, c), part(c, a), part(a, b)]
}

/// Writes the bake with its viewer as one page.
fn page(folder: &Path) -> PathBuf {
    let file = folder.join("room.html");
    let output = Command::new(env!("CARGO_BIN_EXE_lumel"))
        .arg("view")
        .arg(ROOM.path())
        .arg("--html")
        .arg(&file)
        .output()
        .expect("the command runs");
    let problem = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{problem}");
    file
}

/// How far the browser is from Rust: relative to the mean, at the median and at 99 % of the channels.
fn agreement(got: &Value, bake: &Bake, model: Model) -> [f64; 2] {
    assert!(got["error"].is_null(), "{}", got["error"]);
    let occluders = Occluders::build(&bake.scene);
    let pixels = got["pixels"].as_array().expect("pixels");
    let [mut n_bumped, mut n_uncovered] = [0; 2];
    let mut sum = 0.0;
    let mut errors = Vec::new();
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let at = 4 * (y * SIZE[0] + x);
            let shown: Vec<f64> = pixels[at..at + 4]
                .iter()
                .filter_map(Value::as_f64)
                .collect();
            let Some((want, bumped)) = bake.pixel(&occluders, x, y, model) else {
                continue;
            };
            n_bumped += usize::from(bumped);
            // Rasterisers and rays may part ways at an edge.
            n_uncovered += usize::from(shown[3] < 1.0);
            for channel in 0..3 {
                sum += want[channel];
                errors.push((shown[channel] - want[channel]).abs());
            }
        }
    }
    assert!(n_bumped > 2000, "{n_bumped} pixels show a normal map");
    assert!(n_uncovered < 200, "{n_uncovered} pixels show nothing");
    let mean = sum / errors.len() as f64;
    errors.sort_by(f64::total_cmp);
    let quantile = |share: f64| errors[(share * (errors.len() - 1) as f64) as usize] / mean;
    let figures = [quantile(0.5), quantile(0.99)];
    println!(
        "{model:?}: mean {mean:.3} lux, median {:.2e}, 99 % {:.2e} of it",
        figures[0], figures[1]
    );
    figures
}

#[test]
fn a_browser_draws_what_rust_computes() {
    let Some(chromium) = browser::find() else {
        return;
    };
    let bake = Bake::read(ROOM.path());
    let folder = tempfile::tempdir().expect("temporary folder");
    let page = page(folder.path());
    let [eye, at] = [EYE, LOOK_AT].map(|v| format!("{},{},{}", v.x, v.y, v.z));
    for (name, model) in [
        ("plain", Model::Plain),
        ("vector", Model::Vector),
        ("sky-sun", Model::SkySun),
    ] {
        let fragment = format!(
            "camera={eye},{at}&numbers={}x{}&model={name}",
            SIZE[0], SIZE[1]
        );
        let got = browser::result(chromium, &page, &fragment);
        let [median, most] = agreement(&got, &bake, model);
        assert!(median <= 5e-4, "{name}: median {median}");
        assert!(most <= 3e-2, "{name}: 99 % {most}");
    }
}

#[test]
fn a_bake_of_every_kind_says_what_it_wrote() {
    let text = fs::read(ROOM.path().join("room.lumel.json")).expect("a manifest");
    let manifest: Value = serde_json::from_slice(&text).expect("JSON");
    let page = &manifest["pages"][0];
    let planes = |list: &Value| -> Vec<String> {
        let maps = list.as_array().into_iter().flatten();
        maps.filter_map(|map| Some(map["plane"].as_str()?.to_owned()))
            .collect()
    };
    assert_eq!(
        planes(&page["maps"]),
        ["E", "Gr", "Gg", "Gb", "phi", "err", "ktx2", "preview"]
    );
    assert_eq!(
        planes(&page["exports"]),
        [
            "bakery_L0",
            "bakery_L1x",
            "bakery_L1y",
            "bakery_L1z",
            "godot",
            "unity_color",
            "unity_dir",
            "bevy"
        ]
    );
    for file in manifest["files"].as_array().expect("a list") {
        let path = ROOM.path().join(file.as_str().expect("a name"));
        assert!(path.is_file(), "{}", path.display());
    }
    let scene = Scene::open(&ROOM.path().join("room.glb"), &Options::default())
        .unwrap_or_else(|e| panic!("{e}"));
    assert!(engine_schema::check(&scene.source.json) > 0);
}

/// A server that ends with the test.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start() -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_lumel"))
            .arg("view")
            .arg(ROOM.path())
            .arg("--no-open")
            .stdout(Stdio::piped())
            .spawn()
            .expect("the command starts");
        let mut line = String::new();
        let out = child.stdout.take().expect("piped");
        BufReader::new(out)
            .read_line(&mut line)
            .expect("an address");
        let address = line
            .trim()
            .strip_prefix("http://")
            .and_then(|rest| rest.strip_suffix('/'))
            .unwrap_or_else(|| panic!("{line}"));
        Self {
            child,
            address: address.to_owned(),
        }
    }

    /// Sends `path` as it is; the status and the body.
    fn ask(&self, method: &str, path: &str, host: &str) -> (String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).expect("the server listens");
        let request =
            format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("answered");
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n");
        let body = answer.split_off(end.map_or(answer.len(), |end| end + 4));
        let head = String::from_utf8_lossy(&answer);
        let status = head.split(' ').nth(1).unwrap_or_default().to_owned();
        (status, body)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_server_gives_out_the_bake_and_nothing_else() {
    let secret = ROOM.path().join("secret.txt");
    fs::write(&secret, "not part of the bake").expect("writable");
    let server = Server::start();
    assert!(server.address.starts_with("127.0.0.1:"));
    let host = server.address.as_str();
    let (status, body) = server.ask("GET", "/", host);
    assert_eq!(status, "200");
    assert!(String::from_utf8_lossy(&body).contains("{\"manifest\":\"room.lumel.json\"}"));
    for name in [
        "room.glb",
        "room_lm0_light.ktx2",
        "room%5Flm0_E.exr",
        "room.lumel.json?x",
    ] {
        let (status, body) = server.ask("GET", &format!("/files/{name}"), host);
        assert_eq!(status, "200", "{name}");
        let plain = name.replace("%5F", "_").replace("?x", "");
        let want = fs::read(ROOM.path().join(plain)).expect("a file of the bake");
        assert!(body == want, "{name}");
    }
    for path in [
        "/files/secret.txt",
        "/files/../secret.txt",
        "/files/..%2f..%2f..%2fetc%2fpasswd",
        "/files//etc/passwd",
        "/files/./room.glb",
        "/files/%00",
        "/files/",
        "/room.glb",
        "/../../etc/passwd",
        "/files/room.glb%00.png",
    ] {
        let (status, body) = server.ask("GET", path, host);
        assert_eq!(status, "404", "{path}");
        assert_eq!(body, b"no such file", "{path}");
    }
    assert_eq!(server.ask("POST", "/", host).0, "405");
    assert_eq!(server.ask("GET", "/", "evil.example").0, "403");
}

#[test]
fn what_is_no_bake_cannot_be_viewed() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let view = |path: &Path| {
        let output = Command::new(env!("CARGO_BIN_EXE_lumel"))
            .arg("view")
            .arg(path)
            .arg("--no-open")
            .output()
            .expect("the command runs");
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(view(folder.path()).contains("holds no bake"));
    for name in ["a.lumel.json", "b.lumel.json"] {
        fs::write(folder.path().join(name), "{}").expect("writable");
    }
    assert!(view(folder.path()).contains("several bakes"));
    let one = folder.path().join("a.lumel.json");
    assert!(view(&one).contains("lists no files"));
    assert!(view(&folder.path().join("c.lumel.json")).contains("c.lumel.json"));
}

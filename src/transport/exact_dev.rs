//! dev test
use super::contour::{self, Piece};
use super::exact::visible_contour;
use super::outline::Outline;
use crate::math::{Aabb, hash, unit_pair};
use crate::scene::*;
use crate::visibility::Edges;
use glam::{DAffine3, DMat3, DVec3};

fn soup(tris: &[[DVec3; 3]]) -> Scene {
    Scene::assemble(
        "t",
        vec![Mesh {
            name: "m".into(),
            source: 0,
            primitives: vec![Primitive {
                source: 0,
                material: 0,
                positions: tris.iter().flatten().map(|v| v.as_vec3()).collect(),
                normals: vec![],
                texcoords: vec![],
                vertex_alpha: vec![],
                triangles: (0..tris.len() as u32)
                    .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
                    .collect(),
            }],
        }],
        vec![Instance {
            name: "n".into(),
            node: 0,
            copy: None,
            mesh: 0,
            world_from_local: DAffine3::IDENTITY,
            density: 1.0,
        }],
        vec![],
        vec![],
    )
}

/// split convex polygon by plane through origin-rel; returns (inside, outside)
fn split(poly: &[DVec3], n: DVec3, d: f64) -> (Vec<DVec3>, Vec<DVec3>) {
    let mut a = vec![];
    let mut b = vec![];
    for i in 0..poly.len() {
        let (p, q) = (poly[i], poly[(i + 1) % poly.len()]);
        let (hp, hq) = (n.dot(p) - d, n.dot(q) - d);
        if hp >= 0.0 {
            a.push(p)
        } else {
            b.push(p)
        }
        if (hp >= 0.0) != (hq >= 0.0) {
            let x = p + (q - p) * (hp / (hp - hq));
            a.push(x);
            b.push(x);
        }
    }
    if a.len() < 3 {
        a.clear()
    }
    if b.len() < 3 {
        b.clear()
    }
    (a, b)
}

/// reference G, phi by subtracting cones
fn reference(x: DVec3, n: DVec3, light: &[DVec3], tris: &[[DVec3; 3]]) -> (DVec3, f64) {
    let l: Vec<DVec3> = light.iter().map(|v| *v - x).collect();
    let (up, _) = split(&l, n, 0.0);
    let mut pieces = if up.is_empty() { vec![] } else { vec![up] };
    for t in tris {
        let [a, b, c] = t.map(|v| v - x);
        let det = a.dot(b.cross(c));
        if det == 0.0 {
            continue;
        }
        let s = det.signum();
        let pn = (b - a).cross(c - a);
        let pd = pn.dot(a); // plane; beyond side: away from the origin
        let planes = [
            (a.cross(b) * s, 0.0),
            (b.cross(c) * s, 0.0),
            (c.cross(a) * s, 0.0),
            (pn * pd.signum(), pd.abs()),
        ];
        let mut next = vec![];
        for piece in pieces {
            let mut rest = piece;
            for (m, d) in planes {
                let (i, o) = split(&rest, m, d);
                if !o.is_empty() {
                    next.push(o);
                }
                rest = i;
                if rest.is_empty() {
                    break;
                }
            }
        }
        pieces = next;
    }
    let mut g = DVec3::ZERO;
    let mut phi = 0.0;
    for p in &pieces {
        for i in 0..p.len() {
            let (a, b) = (p[i], p[(i + 1) % p.len()]);
            let w = a.cross(b - a);
            let s = w.length();
            if s > 0.0 {
                g -= w * (0.5 * s.atan2(a.dot(b)) / s);
            }
        }
        for i in 1..p.len() - 1 {
            let (a, b, c) = (p[0], p[i], p[i + 1]);
            let (la, lb, lc) = (a.length(), b.length(), c.length());
            phi -= 2.0
                * a.dot((b - a).cross(c - a))
                    .atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
        }
    }
    (g, phi)
}

struct R(u64, u64);
impl R {
    fn u(&mut self) -> f64 {
        self.1 += 1;
        unit_pair(hash(self.0, 1, self.1))[0]
    }
    fn r(&mut self, a: f64, b: f64) -> f64 {
        a + (b - a) * self.u()
    }
    fn v(&mut self, s: f64) -> DVec3 {
        DVec3::new(self.r(-s, s), self.r(-s, s), self.r(-s, s))
    }
}

fn exact(
    x: DVec3,
    n: DVec3,
    light: &[DVec3],
    scene: &Scene,
    edges: &Edges,
    half: f64,
) -> (contour::Sums, usize) {
    let borders = {
        let l: Vec<DVec3> = light.iter().rev().map(|v| *v - x).collect();
        let (up, _) = split(&l, n, 0.0);
        (0..up.len())
            .map(|i| Piece {
                a: up[i],
                b: up[(i + 1) % up.len()],
                horizon: n.dot(up[i]).abs() < 1e-12 && n.dot(up[(i + 1) % up.len()]).abs() < 1e-12,
            })
            .collect::<Vec<_>>()
    };
    let away = -(light[1] - light[0]).cross(light[2] - light[0]).normalize();
    let ids: Vec<u32> = (0..scene.triangles.len() as u32).collect();
    let bx = Aabb {
        min: x - DVec3::splat(half),
        max: x + DVec3::splat(half),
    };
    let outline = Outline::new(edges, &bx, &ids, (light[0], away));
    let mut pieces = vec![];
    visible_contour(x, &borders, away, &outline, &mut pieces);
    (contour::sum(&pieces, n, true), pieces.len())
}

#[test]
fn dev() {
    let mut worst = [0.0f64; 3];
    let mut js = vec![];
    let mut n_partial = 0;
    for case in 0..20000u64 {
        let mut r = R(case, 0);
        let kind = case % 8;
        let count = 1 + (r.u() * 40.0) as usize;
        let light: Vec<DVec3> = vec![
            DVec3::new(-1.0, 5.0, -1.0),
            DVec3::new(1.0, 5.0, -1.0),
            DVec3::new(1.0, 5.0, 1.0),
            DVec3::new(-1.0, 5.0, 1.0),
        ];
        let mut x = DVec3::new(r.r(-3.0, 3.0), 0.0, r.r(-3.0, 3.0));
        let mut n = DVec3::Y;
        if kind == 1 {
            n = (r.v(1.0) + DVec3::new(0.0, 0.2, 0.0)).normalize();
        }
        if kind == 2 {
            x.y = r.r(0.0, 4.5);
        }
        let mut tris = vec![];
        if kind == 3 {
            // closed boxes
            for _ in 0..(1 + count / 10) {
                let c = DVec3::new(r.r(-1.5, 1.5), r.r(0.0, 5.0), r.r(-1.5, 1.5));
                let s = r.r(0.1, 0.6);
                let rot = glam::DQuat::from_euler(
                    glam::EulerRot::XYZ,
                    r.u() * 6.0,
                    r.u() * 6.0,
                    r.u() * 6.0,
                );
                let v: Vec<DVec3> = (0..8)
                    .map(|i| {
                        c + rot
                            * (DVec3::new(
                                (i & 1) as f64,
                                ((i >> 1) & 1) as f64,
                                ((i >> 2) & 1) as f64,
                            ) * 2.0
                                - DVec3::ONE)
                            * s
                    })
                    .collect();
                for f in [
                    [0, 2, 3, 1],
                    [4, 5, 7, 6],
                    [0, 1, 5, 4],
                    [2, 6, 7, 3],
                    [0, 4, 6, 2],
                    [1, 3, 7, 5],
                ] {
                    tris.push([v[f[0]], v[f[1]], v[f[2]]]);
                    tris.push([v[f[0]], v[f[2]], v[f[3]]]);
                }
            }
        } else if kind == 4 {
            // axis aligned grid boxes, touching, duplicates
            for _ in 0..(1 + count / 8) {
                let c = DVec3::new(
                    (r.r(-2.0, 2.0) * 2.0).round() * 0.5,
                    (r.r(0.0, 5.0) * 2.0).round() * 0.5,
                    (r.r(-2.0, 2.0) * 2.0).round() * 0.5,
                );
                let s = 0.25;
                let v: Vec<DVec3> = (0..8)
                    .map(|i| {
                        c + (DVec3::new(
                            (i & 1) as f64,
                            ((i >> 1) & 1) as f64,
                            ((i >> 2) & 1) as f64,
                        ) * 2.0
                            - DVec3::ONE)
                            * s
                    })
                    .collect();
                for f in [
                    [0, 2, 3, 1],
                    [4, 5, 7, 6],
                    [0, 1, 5, 4],
                    [2, 6, 7, 3],
                    [0, 4, 6, 2],
                    [1, 3, 7, 5],
                ] {
                    tris.push([v[f[0]], v[f[1]], v[f[2]]]);
                    tris.push([v[f[0]], v[f[2]], v[f[3]]]);
                }
            }
        } else {
            let spread = if kind == 5 { 6.0 } else { 2.0 };
            for _ in 0..count {
                let c = DVec3::new(r.r(-2.0, 2.0), r.r(-0.5, 5.5), r.r(-2.0, 2.0));
                tris.push([
                    c + r.v(spread * 0.4),
                    c + r.v(spread * 0.4),
                    c + r.v(spread * 0.4),
                ]);
            }
            if kind == 6 {
                let d = tris[0];
                tris.push(d);
                tris.push([d[0], d[2], d[1]]);
            }
        }
        for t in &mut tris {
            for v in t.iter_mut() {
                *v = v.as_vec3().as_dvec3();
            }
        }
        let scene = soup(&tris);
        let edges = Edges::build(&scene);
        let tris: Vec<[DVec3; 3]> = scene.triangles.iter().map(|t| t.vertices).collect();
        let (g, phi) = reference(x, n, &light, &tris);
        let (g0, phi0) = reference(x, n, &light, &[]);
        if phi0 <= 0.0 {
            continue;
        }
        let (s, np) = exact(
            x,
            n,
            &light,
            &scene,
            &edges,
            if case % 3 == 0 { 0.0 } else { 0.05 },
        );
        let eg = (s.g - g).length() / g0.length();
        let ep = (s.phi - phi).abs() / phi0;
        if phi > 1e-9 * phi0 && phi < phi0 * (1.0 - 1e-9) {
            n_partial += 1;
            let h = 1e-5;
            let mut fd = DMat3::ZERO;
            let dx = |d: DVec3| {
                (reference(x + d * h, n, &light, &tris).0
                    - reference(x - d * h, n, &light, &tris).0)
                    / (2.0 * h)
            };
            *fd.col_mut(0) = dx(DVec3::X);
            *fd.col_mut(1) = dx(DVec3::Y);
            *fd.col_mut(2) = dx(DVec3::Z);
            let diff = (0..3)
                .map(|k| (fd.col(k) - s.j.col(k)).length_squared())
                .sum::<f64>()
                .sqrt();
            let norm = (0..3)
                .map(|k| fd.col(k).length_squared())
                .sum::<f64>()
                .sqrt();
            js.push((diff / norm, case));
        }
        worst[0] = worst[0].max(eg);
        worst[1] = worst[1].max(ep);
        if eg > 1e-9 || ep > 1e-9 {
            let rev: Vec<_> = tris.iter().rev().copied().collect();
            let g2 = reference(x, n, &light, &rev).0;
            println!("ref reorder {:e}", (g2 - g).length());
            for k in 0..tris.len() {
                let mut t2 = tris.clone();
                t2.remove(k);
                let sc = soup(&t2);
                let ed = Edges::build(&sc);
                let g2 = reference(x, n, &light, &t2).0;
                let s2 = exact(x, n, &light, &sc, &ed, 0.0).0;
                let e = (s2.g - g2).length();
                if e < 1e-9 {
                    println!("without {k} fine: {:?} x {x} n {n}", tris[k]);
                    let pn = (tris[k][1] - tris[k][0])
                        .cross(tris[k][2] - tris[k][0])
                        .normalize();
                    println!("height {:e}", pn.dot(x - tris[k][0]));
                }
            }
            println!(
                "case {case} kind {kind}: G {eg:e} phi {ep:e} pieces {np} tris {} visible {}",
                tris.len(),
                phi / phi0
            );
        }
    }
    js.sort_by(|a, b| a.0.total_cmp(&b.0));
    println!(
        "worst {worst:?} partial {n_partial} J median {:?} p90 {:?} p99 {:?} max {:?}",
        js[js.len() / 2],
        js[js.len() * 9 / 10],
        js[js.len() * 99 / 100],
        js.last()
    );
}

#[allow(clippy::all)]
fn bench(name: &str, tris: &[[DVec3; 3]], half_floor: f64, res: usize, max_tiles: usize) {
    use crate::visibility::{Occluders, Shaft};
    if std::env::var("ONLY").is_ok_and(|v| v != name) {
        return;
    }
    let scene = soup(tris);
    let edges = Edges::build(&scene);
    let occ = Occluders::build(&scene);
    let light: Vec<DVec3> = vec![
        DVec3::new(-1.0, 5.0, -1.0),
        DVec3::new(1.0, 5.0, -1.0),
        DVec3::new(1.0, 5.0, 1.0),
        DVec3::new(-1.0, 5.0, 1.0),
    ];
    let away = DVec3::Y;
    let n = DVec3::Y;
    let step = 2.0 * half_floor / res as f64;
    let (mut t_shaft, mut t_outline, mut t_eval) = (0.0, 0.0, 0.0);
    let (mut tiles, mut pts, mut cand, mut kept, mut pcs) = (0, 0, 0, 0, 0);
    let mut sum = 0.0;
    for ty in (0..res / 8).step_by(1) {
        for tx in 0..res / 8 {
            if (ty * 131 + tx * 17) % 7 != 0 {
                continue;
            }
            if tiles >= max_tiles {
                continue;
            }
            let rc: Vec<(DVec3, DVec3)> = (0..64)
                .map(|i| {
                    (
                        DVec3::new(
                            -half_floor + step * ((tx * 8 + i % 8) as f64 + 0.5),
                            0.0,
                            -half_floor + step * ((ty * 8 + i / 8) as f64 + 0.5),
                        ),
                        n,
                    )
                })
                .collect();
            let t = std::time::Instant::now();
            let shaft = Shaft::new(&rc, &light, -away);
            let ids = occ.in_shaft(&shaft, &|_| false);
            t_shaft += t.elapsed().as_secs_f64();
            if ids.is_empty() {
                continue;
            }
            tiles += 1;
            cand += ids.len();
            let t = std::time::Instant::now();
            let bx = Aabb::from_points(rc.iter().map(|r| r.0));
            let outline = Outline::new(&edges, &bx, &ids, (light[0], away));
            t_outline += t.elapsed().as_secs_f64();
            kept += outline.n_edges();
            let t = std::time::Instant::now();
            let mut pieces = vec![];
            for (x, n) in &rc {
                let l: Vec<DVec3> = light.iter().rev().map(|v| *v - *x).collect();
                let b: Vec<Piece> = (0..4)
                    .map(|i| Piece {
                        a: l[i],
                        b: l[(i + 1) % 4],
                        horizon: false,
                    })
                    .collect();
                pieces.clear();
                visible_contour(*x, &b, away, &outline, &mut pieces);
                let s = contour::sum(&pieces, *n, true);
                sum += s.phi;
                pcs += pieces.len();
                pts += 1;
            }
            t_eval += t.elapsed().as_secs_f64();
        }
    }
    println!(
        "{name}: tiles {tiles} cand/tile {:.0} kept/tile {:.0} pieces/pt {:.1} | per point us: shaft {:.2} outline {:.2} eval {:.2} sum {sum}",
        cand as f64 / tiles as f64,
        kept as f64 / tiles as f64,
        pcs as f64 / pts as f64,
        t_shaft * 1e6 / pts as f64,
        t_outline * 1e6 / pts as f64,
        t_eval * 1e6 / pts as f64
    );
}

#[test]
fn bench_dev() {
    let mut r = R(5, 0);
    let mut tris = vec![];
    for _ in 0..3000 {
        let c = DVec3::new(r.r(-2.5, 2.5), r.r(1.0, 4.0), r.r(-2.5, 2.5));
        tris.push([c + r.v(0.06), c + r.v(0.06), c + r.v(0.06)]);
    }
    bench("leaves", &tris, 2.5, 40, 10);
    let mut tris = vec![];
    let (m, k) = (100, 100);
    let p = |i: usize, j: usize| {
        let a = std::f64::consts::PI * i as f64 / m as f64;
        let b = std::f64::consts::TAU * (j % k) as f64 / k as f64;
        if i == 0 {
            DVec3::new(0.0, 1.9, 0.0)
        } else if i == m {
            DVec3::new(0.0, 0.7, 0.0)
        } else {
            DVec3::new(
                0.6 * a.sin() * b.cos(),
                1.3 + 0.6 * a.cos(),
                0.6 * a.sin() * b.sin(),
            )
        }
    };
    for i in 0..m {
        for j in 0..k {
            let (a, b, c, d) = (p(i, j), p(i + 1, j), p(i + 1, j + 1), p(i, j + 1));
            tris.push([a, c, b]);
            tris.push([a, d, c]);
        }
    }
    bench("sphere20k", &tris, 5.0, 200, 1000);
    let c = |o: DVec3, s: f64| {
        let mut t = vec![];
        let v: Vec<DVec3> = (0..8)
            .map(|i| {
                o + (DVec3::new((i & 1) as f64, ((i >> 1) & 1) as f64, ((i >> 2) & 1) as f64) * 2.0
                    - DVec3::ONE)
                    * s
            })
            .collect();
        for f in [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ] {
            t.push([v[f[0]], v[f[1]], v[f[2]]]);
            t.push([v[f[0]], v[f[2]], v[f[3]]]);
        }
        t
    };
    bench("box", &c(DVec3::new(0.2, 1.5, 0.3), 0.4), 5.0, 200, 1000);
}

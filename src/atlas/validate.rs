//! Checks everything that must hold for an [`Atlas`].

use std::collections::BTreeMap;

use glam::DVec2;

use crate::scene::Scene;

use super::footprint::each_covered;
use super::{Atlas, NO_CHART, Options, Placement, Unwrap};

/// See [`Atlas::validate`].
pub(super) fn validate(atlas: &Atlas, scene: &Scene, options: &Options) -> Result<(), String> {
    for (index, unwrap) in atlas.unwraps.iter().enumerate() {
        check_unwrap(unwrap, scene).map_err(|what| format!("unwrap {index}: {what}"))?;
    }
    check_order(atlas)?;
    check_triangles(atlas, scene)?;
    for page in 0..atlas.pages.len() {
        check_page(atlas, page, options).map_err(|what| format!("page {page}: {what}"))?;
    }
    Ok(())
}

/// See [`Atlas::utilisation`].
pub(super) fn utilisation(atlas: &Atlas) -> f64 {
    let (mut covered, mut all) = (0, 0);
    for page in 0..atlas.pages.len() {
        let owners = paint(atlas, page, |_, _, _| {});
        covered += owners.iter().filter(|&&owner| owner != EMPTY).count();
        all += owners.len();
    }
    if all == 0 {
        0.0
    } else {
        covered as f64 / all as f64
    }
}

fn check_unwrap(unwrap: &Unwrap, scene: &Scene) -> Result<(), String> {
    let mesh = &scene.meshes[unwrap.mesh];
    if unwrap.primitives.len() != mesh.primitives.len() {
        return Err("number of primitives differs from the mesh".to_owned());
    }
    let size = DVec2::new(f64::from(unwrap.size[0]), f64::from(unwrap.size[1]));
    let mut used = vec![false; unwrap.n_charts as usize];
    for (index, (unwrapped, primitive)) in
        unwrap.primitives.iter().zip(&mesh.primitives).enumerate()
    {
        let err = |what: String| Err(format!("primitive {index}: {what}"));
        if unwrapped.source_vertices.len() != unwrapped.texcoords.len()
            || unwrapped.triangles.len() != unwrapped.source_triangles.len()
            || unwrapped.triangles.len() != unwrapped.charts.len()
        {
            return err("lists differ in length".to_owned());
        }
        if !unwrapped.source_triangles.is_sorted_by(|a, b| a < b) {
            return err("source triangles are not ascending".to_owned());
        }
        for ((triangle, &source), &chart) in unwrapped
            .triangles
            .iter()
            .zip(&unwrapped.source_triangles)
            .zip(&unwrapped.charts)
        {
            let copied = triangle.map(|vertex| unwrapped.source_vertices[vertex as usize]);
            if copied != primitive.triangles[source as usize] {
                return err(format!("triangle {source} copies the vertices {copied:?}"));
            }
            if chart == NO_CHART {
                continue;
            }
            used[chart as usize] = true;
            for vertex in triangle {
                let texcoord = unwrapped.texcoords[*vertex as usize];
                // Authored coordinates may leave the square by 1e-4 of it.
                let slack = if unwrap.authored {
                    1e-4 * size
                } else {
                    DVec2::ZERO
                };
                if !(texcoord.cmpge(-slack).all() && texcoord.cmple(size + slack).all()) {
                    return err(format!("triangle {source} lies outside, at {texcoord}"));
                }
            }
        }
    }
    used.iter().position(|used| !used).map_or(Ok(()), |chart| {
        Err(format!("chart {chart} has no triangle"))
    })
}

fn check_order(atlas: &Atlas) -> Result<(), String> {
    let key = |placement: &Placement| (placement.page, placement.offset[1], placement.offset[0]);
    if !atlas.placements.is_sorted_by_key(key) {
        return Err("placements are not ordered by page, row, column".to_owned());
    }
    for (index, placement) in atlas.placements.iter().enumerate() {
        let page = atlas.pages[placement.page];
        let size = atlas.unwraps[placement.unwrap].size;
        if placement.offset[0] + size[0] > page.width || placement.offset[1] + size[1] > page.height
        {
            return Err(format!("placement {index} leaves its page"));
        }
        if !page.width.is_multiple_of(4) || !page.height.is_multiple_of(4) {
            return Err("a page is not a multiple of 4 wide and high".to_owned());
        }
    }
    Ok(())
}

/// Every triangle of every placed instance once.
fn check_triangles(atlas: &Atlas, scene: &Scene) -> Result<(), String> {
    let mut by_instance: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for placement in &atlas.placements {
        by_instance
            .entry(placement.instance)
            .or_default()
            .push(placement.unwrap);
    }
    for (instance, unwraps) in by_instance {
        let mesh = scene.instances[instance].mesh;
        for (index, primitive) in scene.meshes[mesh].primitives.iter().enumerate() {
            let mut seen = vec![0; primitive.triangles.len()];
            for &unwrap in &unwraps {
                if atlas.unwraps[unwrap].mesh != mesh {
                    return Err(format!("instance {instance} has a layout of another mesh"));
                }
                for &source in &atlas.unwraps[unwrap].primitives[index].source_triangles {
                    seen[source as usize] += 1;
                }
            }
            if let Some(triangle) = seen.iter().position(|&times| times != 1) {
                return Err(format!(
                    "instance {instance}, primitive {index}: triangle {triangle} appears {} times",
                    seen[triangle]
                ));
            }
        }
    }
    Ok(())
}

/// Owner of a texel: placement and chart.
type Owner = (u32, u32);

const EMPTY: Owner = (u32::MAX, u32::MAX);

/// The owner of every texel of a page. Calls `conflict` with both owners and the texel where there are two.
fn paint(
    atlas: &Atlas,
    page: usize,
    mut conflict: impl FnMut(Owner, Owner, [i32; 2]),
) -> Vec<Owner> {
    let [width, height] =
        [atlas.pages[page].width, atlas.pages[page].height].map(|side| side as i32);
    let mut owners = vec![EMPTY; (width * height) as usize];
    for (index, placement) in atlas.placements.iter().enumerate() {
        if placement.page != page {
            continue;
        }
        let offset = placement.offset.map(|corner| corner as i32);
        for primitive in &atlas.unwraps[placement.unwrap].primitives {
            for (triangle, &chart) in primitive.triangles.iter().zip(&primitive.charts) {
                if chart == NO_CHART {
                    continue;
                }
                let flat = triangle.map(|vertex| primitive.texcoords[vertex as usize]);
                each_covered(flat, |x, y| {
                    let (x, y) = (x + offset[0], y + offset[1]);
                    let owner = (index as u32, chart);
                    if x < 0 || y < 0 || x >= width || y >= height {
                        conflict(owner, EMPTY, [x, y]);
                        return;
                    }
                    let texel = &mut owners[(y * width + x) as usize];
                    if *texel != EMPTY && *texel != owner {
                        conflict(*texel, owner, [x, y]);
                    }
                    *texel = owner;
                });
            }
        }
    }
    owners
}

fn check_page(atlas: &Atlas, page: usize, options: &Options) -> Result<(), String> {
    let mut wrong = None;
    let may_touch = |a: Owner, b: Owner| {
        a.0 == b.0 && atlas.unwraps[atlas.placements[a.0 as usize].unwrap].authored
    };
    let owners = paint(atlas, page, |a, b, texel| {
        if !may_touch(a, b) {
            wrong.get_or_insert_with(|| {
                format!("texel {texel:?} is read by {a:?} and by {b:?} (placement, chart; MAX is nothing)")
            });
        }
    });
    if let Some(wrong) = wrong {
        return Err(wrong);
    }
    let [width, height] =
        [atlas.pages[page].width, atlas.pages[page].height].map(|side| side as usize);
    let reach = options.padding as usize;
    for y in 0..height {
        for x in 0..width {
            let owner = owners[y * width + x];
            // Only borders can be too close to another chart.
            if owner == EMPTY
                || (x + 1 < width
                    && y + 1 < height
                    && {
                        let next = [owners[y * width + x + 1], owners[(y + 1) * width + x]];
                        next == [owner; 2]
                    }
                    && x > 0
                    && y > 0
                    && {
                        let before = [owners[y * width + x - 1], owners[(y - 1) * width + x]];
                        before == [owner; 2]
                    })
            {
                continue;
            }
            for row in y.saturating_sub(reach)..(y + reach + 1).min(height) {
                for column in x.saturating_sub(reach)..(x + reach + 1).min(width) {
                    let other = owners[row * width + column];
                    if other != EMPTY && other != owner && !may_touch(owner, other) {
                        return Err(format!(
                            "{owner:?} at [{x}, {y}] and {other:?} at [{column}, {row}] are closer than {reach} texels"
                        ));
                    }
                }
            }
        }
    }
    Ok(())
}

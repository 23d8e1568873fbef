//! The scene with its lightmap: a self-contained `.glb` that any viewer opens and an engine that knows us can light.
//!
//! It is the authored document with as little changed as possible: materials, animations, cameras, unknown extensions, extras and the
//! order of keys stay. Lit primitives get `TEXCOORD_1`; the maps are referred to by relative URIs from the vendor extension
//! `LUMEL_light_vector_map`, never from `images`, because core glTF has no HDR pictures. The extension is listed in `extensionsUsed`
//! and never in `extensionsRequired`: programs that do not know it must open the file.
//!
//! # The document's extension
//!
//! ```json
//! "extensions": {"LUMEL_light_vector_map": {
//!     "version": 1,
//!     "generator": "lumel 0.1.0",
//!     "rowOrder": "top-first",
//!     "texelCenter": [0.5, 0.5],
//!     "maps": [{
//!         "width": 1024, "height": 512,
//!         "texCoord": 1,
//!         "space": "world",
//!         "unit": "lux",
//!         "irradiance": "level_lm0_E.exr",
//!         "lightVector": {"r": "level_lm0_Gr.exr", "g": "level_lm0_Gg.exr", "b": "level_lm0_Gb.exr"},
//!         "fluence": "level_lm0_phi.exr",
//!         "lightVectorDu": {"r": "…", "g": "…", "b": "…"},
//!         "lightVectorDv": {"r": "…", "g": "…", "b": "…"},
//!         "error": "level_lm0_err.exr",
//!         "preview": "level_lm0_preview.png"
//!     }]
//! }}
//! ```
//!
//! There is one entry of `maps` per page, and only the keys whose files were written. `irradiance` is E at the surface's own normal;
//! `lightVector` has one picture per colour channel of the light, whose R, G, B are x, y, z of G in world space (glTF axes), so that
//! `E(n) = max(0, G·n)` for each; `fluence` is φ. The derivatives are per step of one texel to the right (u) and down (v). v = 0 is
//! the upper edge of the top row, and the centre of the top left texel is at (0.5 / width, 0.5 / height), as glTF has it.
//!
//! # A node's extension
//!
//! ```json
//! "extensions": {"LUMEL_light_vector_map": {"map": 0, "scale": [0.25, 0.5], "offset": [0.5, 0.0]}}
//! ```
//!
//! The place on the page is `TEXCOORD_1 * scale + offset`. Instances of a mesh share its coordinates and differ in these numbers. A
//! mesh that stands in the level once has page coordinates right away, with scale 1 and offset 0, so that a viewer that only knows
//! plain lightmaps shows it correctly. A node with `EXT_mesh_gpu_instancing` has `{"instances": [{"map", "scale", "offset"}, …]}`
//! instead, one per copy, in their order. A node whose surfaces lie on several pages keeps its transform and gets one child per part.
//!
//! # The mirror in extras
//!
//! Both objects stand a second time in `extras.lumel.lightVectorMap` of the node and of each scene with a lit node (of the document,
//! when it has no scenes), because editors keep extras and drop extensions they do not know. Other keys of `extras.lumel` are the
//! author's, such as the density multiplier `scale`.

mod document;

mod accessor;

mod texcoord;

mod primitive;

mod mesh;

mod node;

mod extension;

use std::collections::BTreeMap;

use self::document::Document;
use crate::atlas::{Atlas, Placement};
use crate::error::{Result, Warnings};
use crate::output::PageFiles;
use crate::scene::Scene;

/// What the parts of this module work from.
#[derive(Clone, Copy)]
struct Input<'a> {
    scene: &'a Scene,
    atlas: &'a Atlas,
    /// What is drawn where, by index of the node; only nodes with a place in the lightmap.
    nodes: &'a BTreeMap<usize, Vec<Group>>,
    /// By unwrap, its placement when it has page coordinates: when it lies in one place only and nobody else made its coordinates.
    alone: &'a [Option<Placement>],
}

/// The copies of a node that are drawn with the same mesh of the result.
#[derive(Debug)]
struct Group {
    /// Index in [`Atlas::unwraps`]; `None` for copies without a place in the lightmap, which keep the authored mesh.
    unwrap: Option<usize>,
    /// In the order of the instances.
    copies: Vec<Copy>,
}

/// One drawing of a mesh.
#[derive(Clone, Copy, Debug)]
struct Copy {
    /// Number of the copy when the node carries `EXT_mesh_gpu_instancing`.
    number: Option<usize>,
    /// Index in [`Atlas::placements`].
    placement: Option<usize>,
}

impl Input<'_> {
    /// How `TEXCOORD_1` becomes page coordinates: scale and offset.
    fn transform(&self, placement: &Placement) -> [[f64; 2]; 2] {
        let unwrap = &self.atlas.unwraps[placement.unwrap];
        if self.alone[placement.unwrap].is_some() {
            return [[1.0; 2], [0.0; 2]];
        }
        let page = self.atlas.pages[placement.page];
        let page = [f64::from(page.width), f64::from(page.height)];
        let axes = [0, 1];
        [
            axes.map(|axis| f64::from(unwrap.size[axis]) / page[axis]),
            axes.map(|axis| f64::from(placement.offset[axis]) / page[axis]),
        ]
    }
}

/// The bytes of the `.glb` of `scene`, laid out as `atlas` says, with maps named as in `pages`, in two pieces; and what could not be
/// carried over.
pub(super) fn container(
    scene: &Scene,
    atlas: &Atlas,
    pages: &[PageFiles],
) -> Result<([Vec<u8>; 2], Warnings)> {
    let mut warnings = Warnings::default();
    let mut document = Document::new(scene, &mut warnings)?;
    extension::strip(&mut document);
    let nodes = groups(scene, atlas);
    let input = Input {
        scene,
        atlas,
        nodes: &nodes,
        alone: &alone(atlas),
    };
    let meshes = mesh::write(&mut document, input, &mut warnings)?;
    node::place(&mut document, input, &meshes, &mut warnings)?;
    extension::announce(&mut document, input, pages, &mut warnings);
    Ok((document.into_container()?, warnings))
}

/// See [`Input::alone`].
fn alone(atlas: &Atlas) -> Vec<Option<Placement>> {
    let mut n_placements = vec![0; atlas.unwraps.len()];
    let mut alone = vec![None; atlas.unwraps.len()];
    for placement in &atlas.placements {
        let unwrap = placement.unwrap;
        n_placements[unwrap] += 1;
        let sole = n_placements[unwrap] == 1 && !atlas.unwraps[unwrap].authored;
        alone[unwrap] = sole.then_some(*placement);
    }
    alone
}

/// Sorts the instances of every lit node by what they are drawn with: by unwrap, those without one last.
fn groups(scene: &Scene, atlas: &Atlas) -> BTreeMap<usize, Vec<Group>> {
    let mut placements = vec![Vec::new(); scene.instances.len()];
    for (index, placement) in atlas.placements.iter().enumerate() {
        placements[placement.instance].push(index);
    }
    let mut nodes: BTreeMap<usize, BTreeMap<usize, Vec<Copy>>> = BTreeMap::new();
    for (instance, placements) in scene.instances.iter().zip(placements) {
        let groups = nodes.entry(instance.node).or_default();
        let number = instance.copy;
        for &placement in &placements {
            let unwrap = atlas.placements[placement].unwrap;
            groups.entry(unwrap).or_default().push(Copy {
                number,
                placement: Some(placement),
            });
        }
        if placements.is_empty() {
            groups.entry(usize::MAX).or_default().push(Copy {
                number,
                placement: None,
            });
        }
    }
    nodes.retain(|_, groups| groups.keys().any(|&unwrap| unwrap != usize::MAX));
    nodes
        .into_iter()
        .map(|(node, groups)| {
            let groups = groups.into_iter().map(|(unwrap, copies)| Group {
                unwrap: (unwrap != usize::MAX).then_some(unwrap),
                copies,
            });
            (node, groups.collect())
        })
        .collect()
}

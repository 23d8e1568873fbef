//! Nodes with meshes → meshes and instances.
//!
//! A mesh is read once and shared by all nodes that show it as authored; a skin or a morph makes a mesh of its own.

use glam::{DAffine3, DVec3};
use gltf::json;

use super::accessor::Accessor;
use super::deform::{Deformation, Pose};
use super::document::Document;
use super::node;
use super::node::Hierarchy;
use super::primitive;
use super::surface;
use super::{Instance, Mesh};
use crate::error::{Error, Result, Warnings};

/// Most vertices that are read, over all primitives: about 4 GB. Vertices can be shared, so a small file may ask for many.
const MAX_VERTICES: usize = 1 << 26;

/// Most triangles in the world: about 4 GB. A few nodes can ask for any number of copies.
const MAX_TRIANGLES: usize = 1 << 25;

/// The meshes of the scene and where they stand, in the order of the nodes.
pub(super) fn place(
    document: &Document<'_>,
    hierarchy: &Hierarchy,
    warnings: &mut Warnings,
) -> Result<(Vec<Mesh>, Vec<Instance>)> {
    let mut placer = Placer {
        document,
        hierarchy,
        shared: vec![None; document.list("meshes")?.len()],
        meshes: Vec::new(),
        instances: Vec::new(),
        n_vertices: 0,
        n_triangles: 0,
    };
    for &node in &hierarchy.order {
        placer.place(node, warnings)?;
    }
    Ok((placer.meshes, placer.instances))
}

/// Work in progress of [`place`].
struct Placer<'a> {
    document: &'a Document<'a>,
    hierarchy: &'a Hierarchy,
    /// For each mesh of the document, where it is in `meshes` when it was read as authored.
    shared: Vec<Option<usize>>,
    meshes: Vec<Mesh>,
    instances: Vec<Instance>,
    n_vertices: usize,
    n_triangles: usize,
}

impl Placer<'_> {
    /// Reads the mesh of a node, unless it was read before, and puts an instance at each of its places.
    fn place(&mut self, node_index: usize, warnings: &mut Warnings) -> Result<()> {
        let node = &self.hierarchy.nodes[node_index];
        let Some(source) = node.mesh else {
            return Ok(());
        };
        let place = format!("nodes[{node_index}]");
        let as_authored = node.skin.is_none() && node.weights.is_empty();
        let (mesh, pose) = match self.shared.get(source).copied().flatten() {
            Some(mesh) if as_authored => (mesh, None),
            _ => self.read_mesh(node_index, source, &place, warnings)?,
        };
        let places = match (pose, &node.extensions.instancing) {
            // A skinned mesh stands where its joints are, not where its node is.
            (Some(pose), _) => vec![(None, pose.world_from_local)],
            (None, Some(instancing)) => {
                let above = self.hierarchy.world[node_index];
                copies(self.document, instancing, above, &place, warnings)?
            }
            (None, None) => vec![(None, self.hierarchy.world[node_index])],
        };
        self.add_instances(node_index, mesh, places, &place, warnings)
    }

    fn add_instances(
        &mut self,
        node_index: usize,
        mesh: usize,
        places: Vec<(Option<usize>, DAffine3)>,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<()> {
        let node = &self.hierarchy.nodes[node_index];
        let n_triangles: usize = self.meshes[mesh]
            .primitives
            .iter()
            .map(|primitive| primitive.triangles.len())
            .sum();
        if n_triangles == 0 {
            warnings.push("mesh has no triangles, its node is left out", place);
            return Ok(());
        }
        self.n_triangles = n_triangles
            .saturating_mul(places.len())
            .saturating_add(self.n_triangles);
        within("triangles", self.n_triangles, MAX_TRIANGLES)?;
        let density = density(&node.extras, place, warnings);
        for (copy, world_from_local) in places {
            if !world_from_local.is_finite() {
                warnings.push("transform is not finite, its mesh is left out", place);
                continue;
            }
            self.instances.push(Instance {
                name: node.name(node_index),
                node: node_index,
                copy,
                mesh,
                world_from_local,
                density,
            });
        }
        Ok(())
    }

    /// What morph targets and skin do to the mesh of a node.
    fn deformation(
        &self,
        node_index: usize,
        mesh: &json::Mesh,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<Deformation> {
        let node = &self.hierarchy.nodes[node_index];
        let mut deformation = Deformation::default();
        if mesh.primitives.iter().any(|it| it.targets.is_some()) {
            warnings.push("morph targets are baked at their default weights", place);
            let weights = if node.weights.is_empty() {
                let weights = mesh.weights.as_deref().unwrap_or_default();
                weights.iter().map(|weight| f64::from(*weight)).collect()
            } else {
                node.weights.clone()
            };
            if weights.iter().any(|weight| *weight != 0.0) {
                deformation.weights = weights;
            }
        }
        if let Some(skin) = node.skin {
            warnings.push("skin is baked in its rest pose", place);
            deformation.pose = Some(Pose::read(
                self.document,
                skin,
                &self.hierarchy.world,
                self.hierarchy.world[node_index],
                &format!("{place}.skin"),
                warnings,
            )?);
        }
        Ok(deformation)
    }

    /// Reads a mesh as it looks at a node. Returns where it is in `meshes`, and the pose it took.
    fn read_mesh(
        &mut self,
        node_index: usize,
        source: usize,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<(usize, Option<Pose>)> {
        let mesh: json::Mesh = self
            .document
            .get("meshes", source, &format!("{place}.mesh"))?;
        let deformation = self.deformation(node_index, &mesh, place, warnings)?;
        if let (Some(known), true) = (self.shared[source], deformation.is_none()) {
            return Ok((known, None));
        }
        let mut primitives = Vec::new();
        for (index, json) in mesh.primitives.iter().enumerate() {
            let words = format!("meshes[{source}].primitives[{index}]");
            let n_vertices = primitive::count(self.document, json, &words)?;
            self.n_vertices = self.n_vertices.saturating_add(n_vertices);
            within("vertices", self.n_vertices, MAX_VERTICES)?;
            let place = primitive::Place {
                mesh: source,
                primitive: index,
                words: &words,
            };
            let Some(mut primitive) = primitive::read(self.document, json, &place, warnings)?
            else {
                continue;
            };
            deformation.apply(self.document, json, &mut primitive, &words, warnings)?;
            surface::settle(&mut primitive, &words, warnings);
            primitives.push(primitive);
        }
        if deformation.is_none() {
            self.shared[source] = Some(self.meshes.len());
        }
        self.meshes.push(Mesh {
            name: mesh.name.unwrap_or_else(|| format!("mesh{source}")),
            source,
            primitives,
        });
        Ok((self.meshes.len() - 1, deformation.pose))
    }
}

fn within(what: &str, count: usize, limit: usize) -> Result<()> {
    if count <= limit {
        return Ok(());
    }
    Err(Error::TooLarge {
        reason: format!(
            "the scene has {count} {what} or more, at most {limit} are read; bake its parts one by one"
        ),
    })
}

/// `extras.lumel.scale` of a node.
fn density(extras: &serde_json::Value, place: &str, warnings: &mut Warnings) -> f64 {
    match extras.get("lumel").and_then(|lumel| lumel.get("scale")) {
        None => 1.0,
        Some(scale) => match scale.as_f64() {
            Some(scale) if scale >= 0.0 && scale.is_finite() => scale,
            _ => {
                warnings.push(
                    "extras.lumel.scale must be a number from 0 on, taken as 1",
                    place,
                );
                1.0
            }
        },
    }
}

/// The places of `EXT_mesh_gpu_instancing` below a node at `above`.
fn copies(
    document: &Document<'_>,
    instancing: &node::Instancing,
    above: DAffine3,
    place: &str,
    warnings: &mut Warnings,
) -> Result<Vec<(Option<usize>, DAffine3)>> {
    let place = format!("{place}.extensions.EXT_mesh_gpu_instancing.attributes");
    let translations = copy_attribute::<3>(document, instancing, "TRANSLATION", &place)?;
    let rotations = copy_attribute::<4>(document, instancing, "ROTATION", &place)?;
    let scales = copy_attribute::<3>(document, instancing, "SCALE", &place)?;
    let counts = [
        translations.as_ref().map(Vec::len),
        rotations.as_ref().map(Vec::len),
        scales.as_ref().map(Vec::len),
    ];
    let Some(count) = counts.into_iter().flatten().min() else {
        warnings.push("instancing without transforms, taken as one copy", place);
        return Ok(vec![(Some(0), above)]);
    };
    if counts.into_iter().flatten().any(|other| other != count) {
        warnings.push(
            "instancing attributes differ in count, the rest is left out",
            place.clone(),
        );
    }
    let vector = |list: &Option<Vec<[f32; 3]>>, copy: usize, default: DVec3| {
        list.as_ref()
            .map_or(default, |list| DVec3::from_array(list[copy].map(f64::from)))
    };
    Ok((0..count)
        .map(|copy| {
            let rotation = rotations
                .as_ref()
                .map_or([0.0, 0.0, 0.0, 1.0], |list| list[copy].map(f64::from));
            let local = DAffine3::from_scale_rotation_translation(
                vector(&scales, copy, DVec3::ONE),
                node::rotation(rotation, &place, warnings),
                vector(&translations, copy, DVec3::ZERO),
            );
            (Some(copy), above * local)
        })
        .collect())
}

fn copy_attribute<const N: usize>(
    document: &Document<'_>,
    instancing: &node::Instancing,
    name: &str,
    place: &str,
) -> Result<Option<Vec<[f32; N]>>> {
    let Some(index) = instancing.attributes.get(name) else {
        return Ok(None);
    };
    let from = format!("{place}.{name}");
    let accessor = Accessor::open(document, *index, &from)?;
    if accessor.n_components != N {
        return Err(document.invalid(from, format!("must be a VEC{N}")));
    }
    accessor.floats(document).map(Some)
}

//! Morph targets and skins, frozen.
//!
//! A baker needs one pose. Morph targets take their default weights, skins the rest pose: the joints where the nodes put them.

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};
use gltf::json;
use gltf::json::accessor::ComponentType;
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;

use super::Primitive;
use super::accessor::Accessor;
use super::document::Document;
use super::primitive;
use crate::error::{Result, Warnings};

/// Joint sets that are read (four joints each). Engines use one or two.
const MAX_JOINT_SETS: u32 = 4;

/// What becomes of a mesh before it stands anywhere.
#[derive(Default)]
pub(super) struct Deformation {
    /// Weights of the morph targets; empty when all are zero.
    pub(super) weights: Vec<f64>,
    /// The pose of a skin.
    pub(super) pose: Option<Pose>,
}

/// A skin in its rest pose.
pub(super) struct Pose {
    /// Takes a vertex in bind space to where the joint moves it. Space: as [`Pose::world_from_local`] says.
    joints: Vec<DAffine3>,
    /// What happens to a vertex without joints: the transform of its node.
    fallback: DAffine3,
    /// World from the space in which the skinned mesh is kept: the identity, or a reflection when the joints mirror, so that its triangles
    /// turn around as those of any mirrored instance do.
    pub(super) world_from_local: DAffine3,
}

impl Deformation {
    /// Whether the mesh stays as authored, so that instances can share it.
    pub(super) fn is_none(&self) -> bool {
        self.weights.is_empty() && self.pose.is_none()
    }

    /// Deforms `primitive`, which was read from `json`.
    pub(super) fn apply(
        &self,
        document: &Document<'_>,
        json: &json::mesh::Primitive,
        primitive: &mut Primitive,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<()> {
        if !self.weights.is_empty() {
            morph(document, json, &self.weights, primitive, place, warnings)?;
        }
        if let Some(pose) = &self.pose {
            skin(document, json, pose, primitive, place, warnings)?;
        }
        Ok(())
    }
}

impl Pose {
    /// The rest pose of `skins[index]`, which `from` refers to. `world` are the transforms of all nodes.
    pub(super) fn read(
        document: &Document<'_>,
        index: usize,
        world: &[DAffine3],
        fallback: DAffine3,
        from: &str,
        warnings: &mut Warnings,
    ) -> Result<Self> {
        let skin: json::Skin = document.get("skins", index, from)?;
        let place = format!("skins[{index}]");
        let bind = match skin.inverse_bind_matrices {
            Some(accessor) => {
                let from = format!("{place}.inverseBindMatrices");
                let accessor = Accessor::open(document, accessor.value(), &from)?;
                if accessor.n_components != 16 || accessor.component != ComponentType::F32 {
                    return Err(document.invalid(from, "must be MAT4 of floats"));
                }
                if accessor.count < skin.joints.len() {
                    warnings.push("joint has no inverse bind matrix, taken as none", from);
                }
                accessor.floats::<16>(document)?
            }
            None => Vec::new(),
        };
        let joints = skin
            .joints
            .iter()
            .enumerate()
            .map(|(number, joint)| {
                document.value("nodes", joint.value(), &format!("{place}.joints"))?;
                let local_from_bind = bind.get(number).map_or(DAffine3::IDENTITY, affine);
                Ok(world[joint.value()] * local_from_bind)
            })
            .collect::<Result<Vec<_>>>()?;
        let mirrored = joints
            .first()
            .is_some_and(|joint| joint.matrix3.determinant() < 0.0);
        let world_from_local = if mirrored {
            DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0))
        } else {
            DAffine3::IDENTITY
        };
        // A reflection is its own inverse.
        Ok(Self {
            joints: joints
                .into_iter()
                .map(|joint| world_from_local * joint)
                .collect(),
            fallback: world_from_local * fallback,
            world_from_local,
        })
    }
}

fn affine(matrix: &[f32; 16]) -> DAffine3 {
    let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
    DAffine3 {
        matrix3: DMat3::from_mat4(matrix),
        translation: matrix.w_axis.truncate(),
    }
}

/// Adds the weighted morph targets (glTF 2.0 §3.7.2.2).
fn morph(
    document: &Document<'_>,
    json: &json::mesh::Primitive,
    weights: &[f64],
    primitive: &mut Primitive,
    place: &str,
    warnings: &mut Warnings,
) -> Result<()> {
    let n_vertices = primitive.positions.len();
    let targets = json.targets.as_deref().unwrap_or_default();
    for (number, (target, &weight)) in targets.iter().zip(weights).enumerate() {
        if weight == 0.0 {
            continue;
        }
        let mut add = |accessor: &Option<json::Index<json::Accessor>>,
                       name: &str,
                       list: &mut [Vec3]|
         -> Result<()> {
            let Some(accessor) = accessor else {
                return Ok(());
            };
            let from = format!("{place}.targets[{number}].{name}");
            let offsets = primitive::vertex_floats::<3>(
                document,
                accessor.value(),
                n_vertices,
                &from,
                warnings,
            )?;
            for (value, offset) in list.iter_mut().zip(offsets.unwrap_or_default()) {
                *value += Vec3::from_array(offset) * weight as f32;
            }
            Ok(())
        };
        add(&target.positions, "POSITION", &mut primitive.positions)?;
        add(&target.normals, "NORMAL", &mut primitive.normals)?;
    }
    Ok(())
}

/// Moves vertices by the weighted mean of their joints' transforms (glTF 2.0 §3.7.3.3).
fn skin(
    document: &Document<'_>,
    json: &json::mesh::Primitive,
    pose: &Pose,
    primitive: &mut Primitive,
    place: &str,
    warnings: &mut Warnings,
) -> Result<()> {
    let influences = influences(document, json, primitive.positions.len(), place, warnings)?;
    let mut n_free = 0;
    for vertex in 0..primitive.positions.len() {
        let mut matrix = DMat3::ZERO;
        let mut translation = DVec3::ZERO;
        let mut total = 0.0;
        for (joints, weights) in &influences {
            for (joint, weight) in joints[vertex].iter().zip(weights[vertex]) {
                let weight = f64::from(weight);
                // Joints are small whole numbers, exact in f32; casts saturate.
                if let Some(joint) = pose.joints.get(*joint as usize)
                    && weight > 0.0
                    && weight.is_finite()
                {
                    matrix += joint.matrix3 * weight;
                    translation += joint.translation * weight;
                    total += weight;
                }
            }
        }
        let moved = if total > 0.0 {
            DAffine3 {
                matrix3: matrix * (1.0 / total),
                translation: translation / total,
            }
        } else {
            n_free += 1;
            pose.fallback
        };
        let position = &mut primitive.positions[vertex];
        *position = moved.transform_point3(position.as_dvec3()).as_vec3();
        if let Some(normal) = primitive.normals.get_mut(vertex) {
            let turned = inverse_transpose(&moved.matrix3) * normal.as_dvec3();
            *normal = turned.normalize_or_zero().as_vec3();
        }
    }
    warnings.push_many(
        "vertex of a skin has no joints, moved with its node",
        place,
        n_free,
    );
    Ok(())
}

/// A matrix that turns normals as the inverse transpose does, up to a positive factor, and exists for flattening matrices too: the
/// cofactors, with the sign of the determinant.
fn inverse_transpose(matrix: &DMat3) -> DMat3 {
    let DMat3 {
        x_axis: x,
        y_axis: y,
        z_axis: z,
    } = *matrix;
    let sign = if matrix.determinant() < 0.0 {
        -1.0
    } else {
        1.0
    };
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign
}

/// Joints and weights of all vertices, four at a time.
type Influence = (Vec<[f32; 4]>, Vec<[f32; 4]>);

fn influences(
    document: &Document<'_>,
    json: &json::mesh::Primitive,
    n_vertices: usize,
    place: &str,
    warnings: &mut Warnings,
) -> Result<Vec<Influence>> {
    let mut sets = Vec::new();
    for set in 0..MAX_JOINT_SETS {
        let mut read = |semantic: Semantic| match json.attributes.get(&Checked::Valid(semantic)) {
            Some(index) => {
                let from = format!("{place}.attributes.JOINTS_{set}/WEIGHTS_{set}");
                primitive::vertex_floats(document, index.value(), n_vertices, &from, warnings)
            }
            None => Ok(None),
        };
        if let (Some(joints), Some(weights)) =
            (read(Semantic::Joints(set))?, read(Semantic::Weights(set))?)
        {
            sets.push((joints, weights));
        }
    }
    Ok(sets)
}

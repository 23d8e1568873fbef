//! Settles what is odd about the values of a primitive: numbers that are not finite, triangles without area, normals without length.

use glam::{DVec3, Vec2, Vec3};

use super::Primitive;
use super::check;
use crate::error::Warnings;

/// Makes `primitive` keep the promises of its fields. What is changed is counted in `warnings` at `place`.
pub(super) fn settle(primitive: &mut Primitive, place: &str, warnings: &mut Warnings) {
    drop_not_finite(primitive, place, warnings);
    drop_without_area(primitive, place, warnings);
    settle_normals(primitive, place, warnings);
    for (set, texcoords) in primitive.texcoords.iter_mut().enumerate() {
        let mut n_broken = 0;
        for texcoord in texcoords {
            if !texcoord.is_finite() {
                *texcoord = Vec2::ZERO;
                n_broken += 1;
            }
        }
        warnings.push_many(
            "texture coordinate is not finite, taken as 0",
            format!("{place}.attributes.TEXCOORD_{set}"),
            n_broken,
        );
    }
    for alpha in &mut primitive.vertex_alpha {
        *alpha = if alpha.is_nan() {
            1.0
        } else {
            alpha.clamp(0.0, 1.0)
        };
    }
}

/// Drops triangles with a corner that is not finite, and moves such corners to the origin.
fn drop_not_finite(primitive: &mut Primitive, place: &str, warnings: &mut Warnings) {
    let positions = &mut primitive.positions;
    if positions.iter().all(|position| position.is_finite()) {
        return;
    }
    let n_before = primitive.triangles.len();
    primitive.triangles.retain(|corners| {
        corners
            .iter()
            .all(|corner| positions[*corner as usize].is_finite())
    });
    warnings.push_many(
        "triangle has a position that is not finite, dropped",
        place,
        n_before - primitive.triangles.len(),
    );
    for position in positions
        .iter_mut()
        .filter(|position| !position.is_finite())
    {
        *position = Vec3::ZERO;
    }
}

fn drop_without_area(primitive: &mut Primitive, place: &str, warnings: &mut Warnings) {
    let positions = &primitive.positions;
    let n_before = primitive.triangles.len();
    primitive
        .triangles
        .retain(|corners| check::has_area(vertices(positions, corners)));
    warnings.push_many(
        "triangle has no area, dropped",
        place,
        n_before - primitive.triangles.len(),
    );
}

/// Normalises normals. One without a direction becomes the area-weighted mean of the faces around its vertex.
fn settle_normals(primitive: &mut Primitive, place: &str, warnings: &mut Warnings) {
    let mut n_broken = 0;
    for normal in &mut primitive.normals {
        // In f64, because the square of a small f32 is zero.
        *normal = match normal.as_dvec3().try_normalize() {
            Some(unit) => unit.as_vec3(),
            None => {
                n_broken += 1;
                Vec3::ZERO
            }
        };
    }
    if n_broken == 0 {
        return;
    }
    warnings.push_many(
        "normal has no length or is not finite, replaced by that of its faces",
        place,
        n_broken,
    );
    let replacements = face_normals(primitive);
    for (normal, replacement) in primitive.normals.iter_mut().zip(replacements) {
        if *normal == Vec3::ZERO {
            *normal = replacement;
        }
    }
}

/// Unit mean of the area vectors of the faces around each vertex; any unit vector where there are none or where they cancel.
fn face_normals(primitive: &Primitive) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; primitive.positions.len()];
    let mut last = vec![DVec3::Z; primitive.positions.len()];
    for corners in &primitive.triangles {
        let [a, b, c] = vertices(&primitive.positions, corners);
        let area_vector = (b - a).cross(c - a);
        for corner in corners {
            sums[*corner as usize] += area_vector;
            last[*corner as usize] = area_vector;
        }
    }
    sums.into_iter()
        .zip(last)
        .map(|(sum, last)| {
            let unit = sum.try_normalize().or(last.try_normalize());
            unit.unwrap_or(DVec3::Z).as_vec3()
        })
        .collect()
}

fn vertices(positions: &[Vec3], corners: &[u32; 3]) -> [DVec3; 3] {
    corners.map(|corner| positions[corner as usize].as_dvec3())
}

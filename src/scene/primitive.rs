//! Primitives: attributes and triangles, as authored.

use glam::{Vec2, Vec3};
use gltf::json;
use gltf::json::accessor::ComponentType;
use gltf::json::mesh::{Mode, Semantic};
use gltf::json::validation::Checked;

use super::Primitive;
use super::accessor::Accessor;
use super::document::Document;
use super::extension;
use crate::error::{Result, Warnings};

/// Texture coordinate sets that are read. No engine draws with more, and a forged `TEXCOORD_4294967295` must not become a list.
const MAX_TEXCOORD_SETS: u32 = 8;

/// Where a primitive stands in its document, as numbers and in words.
pub(super) struct Place<'a> {
    pub(super) mesh: usize,
    pub(super) primitive: usize,
    /// `meshes[0].primitives[0]`.
    pub(super) words: &'a str,
}

/// Reads the geometry of a primitive; `None` when it has no surface. What is odd about its values is settled later.
pub(super) fn read(
    document: &Document<'_>,
    primitive: &json::mesh::Primitive,
    place: &Place<'_>,
    warnings: &mut Warnings,
) -> Result<Option<Primitive>> {
    let Checked::Valid(mode) = primitive.mode else {
        return Err(document.invalid(format!("{}.mode", place.words), "must be in 0..=6"));
    };
    if !matches!(
        mode,
        Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
    ) {
        warnings.push("points and lines are no surfaces, left out", place.words);
        return Ok(None);
    }
    let Some(positions) = positions(document, primitive, place)? else {
        warnings.push("primitive has no positions, left out", place.words);
        return Ok(None);
    };
    let n_vertices = positions.len();
    let attributes = Attributes {
        document,
        primitive,
        n_vertices,
        place: place.words,
    };
    let normals = attributes
        .read(&Semantic::Normals, warnings)?
        .unwrap_or_default();
    let n_sets = (0..MAX_TEXCOORD_SETS)
        .rev()
        .find(|set| attributes.find(&Semantic::TexCoords(*set)).is_some())
        .map_or(0, |last| last + 1);
    let texcoords = (0..n_sets)
        .map(|set| {
            let list = attributes.read(&Semantic::TexCoords(set), warnings)?;
            Ok(list
                .unwrap_or_default()
                .into_iter()
                .map(Vec2::from_array)
                .collect())
        })
        .collect::<Result<_>>()?;
    let vertex_alpha = attributes.alpha(warnings)?;
    let corners = match primitive.indices {
        Some(index) => {
            let from = format!("{}.indices", place.words);
            Accessor::open(document, index.value(), &from)?.indices(document)?
        }
        None => (0..n_vertices as u32).collect(),
    };
    let material = match primitive.material {
        Some(material) => {
            let from = format!("{}.material", place.words);
            document.value("materials", material.value(), &from)?;
            material.value()
        }
        // The default material stands behind those of the document.
        None => document.list("materials")?.len(),
    };
    Ok(Some(Primitive {
        source: place.primitive,
        material,
        positions,
        normals: normals.into_iter().map(Vec3::from_array).collect(),
        texcoords,
        vertex_alpha,
        triangles: triangles(mode, &corners, n_vertices, place.words, warnings),
    }))
}

/// How many positions a primitive says it has, without reading them.
pub(super) fn count(
    document: &Document<'_>,
    primitive: &json::mesh::Primitive,
    place: &str,
) -> Result<usize> {
    match primitive
        .attributes
        .get(&Checked::Valid(Semantic::Positions))
    {
        Some(index) => Ok(Accessor::open(document, index.value(), place)?.count),
        None => Ok(0),
    }
}

fn positions(
    document: &Document<'_>,
    primitive: &json::mesh::Primitive,
    place: &Place<'_>,
) -> Result<Option<Vec<Vec3>>> {
    let refuse = || extension::refuse_compressed_primitive(document, place.mesh, place.primitive);
    let positions = primitive
        .attributes
        .get(&Checked::Valid(Semantic::Positions));
    let Some(index) = positions else {
        refuse()?;
        return Ok(None);
    };
    let from = format!("{}.attributes.POSITION", place.words);
    let accessor = Accessor::open(document, index.value(), &from)?;
    if accessor.is_empty_shell() {
        refuse()?;
    }
    if accessor.n_components != 3 {
        return Err(document.invalid(from, "must be a VEC3"));
    }
    if u32::try_from(accessor.count).is_err() {
        return Err(document.invalid(from, "must have fewer than 2^32 elements"));
    }
    let positions = accessor.floats(document)?;
    Ok(Some(positions.into_iter().map(Vec3::from_array).collect()))
}

/// The optional attributes of a primitive.
struct Attributes<'a> {
    document: &'a Document<'a>,
    primitive: &'a json::mesh::Primitive,
    n_vertices: usize,
    place: &'a str,
}

impl Attributes<'_> {
    fn find(&self, semantic: &Semantic) -> Option<usize> {
        self.primitive
            .attributes
            .get(&Checked::Valid(semantic.clone()))
            .map(json::Index::value)
    }

    /// The values of an attribute; `None` when it is absent or has an unusable shape.
    fn read<const N: usize>(
        &self,
        semantic: &Semantic,
        warnings: &mut Warnings,
    ) -> Result<Option<Vec<[f32; N]>>> {
        let Some(index) = self.find(semantic) else {
            return Ok(None);
        };
        let from = format!("{}.attributes.{}", self.place, semantic.to_string());
        vertex_floats(self.document, index, self.n_vertices, &from, warnings)
    }

    /// `COLOR_0` alpha; empty when it is 1 everywhere.
    fn alpha(&self, warnings: &mut Warnings) -> Result<Vec<f32>> {
        let semantic = Semantic::Colors(0);
        let Some(index) = self.find(&semantic) else {
            return Ok(Vec::new());
        };
        let from = format!("{}.attributes.COLOR_0", self.place);
        let mut accessor = Accessor::open(self.document, index, &from)?;
        if accessor.n_components != 4 || accessor.count != self.n_vertices {
            // RGB without alpha is as good as any.
            if accessor.n_components != 3 {
                warnings.push(UNUSABLE, from);
            }
            return Ok(Vec::new());
        }
        // Colours in plain integers are forbidden; who writes them means normalised ones.
        accessor.normalized = accessor.component != ComponentType::F32;
        let colors = accessor.floats::<4>(self.document)?;
        if colors.iter().all(|color| color[3] == 1.0) {
            return Ok(Vec::new());
        }
        Ok(colors.into_iter().map(|color| color[3]).collect())
    }
}

/// An attribute that is left out because of its accessor's type or count.
const UNUSABLE: &str = "attribute has the wrong type or not one element per position, left out";

/// `N` numbers per vertex from `accessors[index]`; `None` with a warning when it has another shape.
pub(super) fn vertex_floats<const N: usize>(
    document: &Document<'_>,
    index: usize,
    n_vertices: usize,
    from: &str,
    warnings: &mut Warnings,
) -> Result<Option<Vec<[f32; N]>>> {
    let accessor = Accessor::open(document, index, from)?;
    if accessor.n_components != N || accessor.count != n_vertices {
        warnings.push(UNUSABLE, from);
        return Ok(None);
    }
    accessor.floats(document).map(Some)
}

/// Spells out triangles (glTF 2.0 §3.7.2.1). Those with an index that is out of range are dropped: engines on WebGL and WebGPU do not draw
/// them either.
fn triangles(
    mode: Mode,
    corners: &[u32],
    n_vertices: usize,
    place: &str,
    warnings: &mut Warnings,
) -> Vec<[u32; 3]> {
    let all: Vec<[u32; 3]> = match mode {
        Mode::TriangleStrip => corners
            .windows(3)
            .enumerate()
            .map(|(index, corners)| match index % 2 {
                0 => [corners[0], corners[1], corners[2]],
                _ => [corners[0], corners[2], corners[1]],
            })
            .collect(),
        Mode::TriangleFan => corners
            .windows(2)
            .skip(1)
            .map(|pair| [pair[0], pair[1], corners[0]])
            .collect(),
        _ => {
            if !corners.len().is_multiple_of(3) {
                warnings.push(
                    "number of indices is no multiple of 3, the rest is left out",
                    place,
                );
            }
            corners
                .chunks_exact(3)
                .map(|corners| [corners[0], corners[1], corners[2]])
                .collect()
        }
    };
    let n_all = all.len();
    let kept: Vec<[u32; 3]> = all
        .into_iter()
        .filter(|corners| corners.iter().all(|corner| (*corner as usize) < n_vertices))
        .collect();
    warnings.push_many(
        "triangle has an index that is out of range, dropped",
        place,
        n_all - kept.len(),
    );
    kept
}

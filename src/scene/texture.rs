//! Texture lookups.

use std::sync::LazyLock;

use glam::{DAffine2, DMat2, DVec2, DVec3};
use gltf::json;
use gltf::json::texture::WrappingMode;
use gltf::json::validation::Checked;
use serde::Deserialize;
use serde_json::{Map, Value};

use super::document::Document;
use super::image::Image;
use super::{Primitive, Triangle};
use crate::error::{Result, Warnings};

/// A texture lookup.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Index in [`Scene::images`](super::Scene::images); `None` when the picture was not needed or could not be read (it then counts as
    /// white).
    pub image: Option<usize>,
    /// Which of the primitive's texture coordinate sets. A primitive that lacks it sees white.
    pub texcoord: usize,
    /// `KHR_texture_transform`: authored coordinates to picture coordinates.
    pub transform: DAffine2,
    /// Behaviour outside 0..1 along u and v.
    pub wrap: [Wrap; 2],
}

/// Behaviour of a texture outside 0..1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// Repeats.
    Repeat,
    /// Repeats, every second time mirrored.
    MirroredRepeat,
    /// Continues its border.
    ClampToEdge,
}

/// A texture of which the picture is not yet read.
#[derive(Debug)]
pub(super) struct Pending {
    /// Without its picture.
    pub(super) texture: Texture,
    /// Index in the document's `images`.
    pub(super) source: Option<usize>,
}

/// `KHR_texture_transform`.
#[derive(Deserialize)]
#[serde(default)]
struct Transform {
    offset: [f64; 2],
    rotation: f64,
    scale: [f64; 2],
    #[serde(rename = "texCoord")]
    texcoord: Option<usize>,
}

impl Default for Transform {
    fn default() -> Self {
        Self {
            offset: [0.0; 2],
            rotation: 0.0,
            scale: [1.0; 2],
            texcoord: None,
        }
    }
}

impl Transform {
    /// Scale, then rotation, then offset.
    ///
    /// The matrix follows the worked example of the specification (lower left quadrant for offset (0, 1), rotation π/2, scale ½) and what
    /// engines do; the sign of the sine in its GLSL lines is the other one.
    fn matrix(&self) -> DAffine2 {
        let (sin, cos) = self.rotation.sin_cos();
        let rotation = DMat2::from_cols(DVec2::new(cos, -sin), DVec2::new(sin, cos));
        DAffine2 {
            matrix2: rotation * DMat2::from_diagonal(self.scale.into()),
            translation: self.offset.into(),
        }
    }
}

/// Reads a texture reference that stands at `place`.
pub(super) fn read(
    document: &Document<'_>,
    info: &json::texture::Info,
    place: &str,
    warnings: &mut Warnings,
) -> Result<Pending> {
    let transform = match others(
        info.extensions.as_ref().map(|it| &it.others),
        "KHR_texture_transform",
    ) {
        Some(value) => document.parse(value, || {
            format!("{place}.extensions.KHR_texture_transform")
        })?,
        None => Transform::default(),
    };
    let index = info.index.value();
    let texture: json::Texture = document.get("textures", index, place)?;
    let wrap = match texture.sampler {
        Some(sampler) => {
            let place = format!("textures[{index}].sampler");
            let sampler: json::texture::Sampler =
                document.get("samplers", sampler.value(), &place)?;
            [sampler.wrap_s, sampler.wrap_t].map(|mode| wrap(&mode, &place, warnings))
        }
        None => [Wrap::Repeat; 2],
    };
    let source = source(document, &texture, index)?;
    if source.is_none() {
        warnings.push(
            "texture has no picture, treated as white",
            format!("textures[{index}]"),
        );
    }
    Ok(Pending {
        texture: Texture {
            image: None,
            texcoord: transform.texcoord.unwrap_or(info.tex_coord as usize),
            transform: transform.matrix(),
            wrap,
        },
        source,
    })
}

/// Index in `images`. The plain source comes first: PNG and JPEG are read for certain, what an extension brings may not be.
fn source(document: &Document<'_>, texture: &json::Texture, index: usize) -> Result<Option<usize>> {
    let n_images = document.list("images")?.len();
    let plain = texture.source.value();
    // The `gltf` crate writes a source that is absent as the largest index.
    if plain != u32::MAX as usize {
        let from = format!("textures[{index}].source");
        document.value("images", plain, &from)?;
        return Ok(Some(plain));
    }
    let extended = texture.extensions.as_ref().and_then(|extensions| {
        extensions
            .others
            .values()
            .find_map(|extension| extension.get("source")?.as_u64())
    });
    Ok(extended
        .and_then(|source| usize::try_from(source).ok())
        .filter(|source| *source < n_images))
}

fn wrap(mode: &Checked<WrappingMode>, place: &str, warnings: &mut Warnings) -> Wrap {
    match mode {
        Checked::Valid(WrappingMode::Repeat) => Wrap::Repeat,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::MirroredRepeat,
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::ClampToEdge,
        Checked::Invalid => {
            warnings.push("wrap mode is unknown, taken as repeat", place);
            Wrap::Repeat
        }
    }
}

/// An extension without a type of its own.
pub(super) fn others<'a>(map: Option<&'a Map<String, Value>>, name: &str) -> Option<&'a Value> {
    map?.get(name)
}

impl Texture {
    /// Whether `primitive` has the texture coordinates it asks for.
    pub(super) fn fits(&self, primitive: &Primitive) -> bool {
        primitive
            .texcoords
            .get(self.texcoord)
            .is_some_and(|texcoords| !texcoords.is_empty())
    }

    /// Linear RGB at a point of a triangle, in [0, 1]. Pixels are made linear before they are filtered, as samplers of sRGB textures do.
    pub(super) fn rgb(
        &self,
        images: &[Image],
        primitive: &Primitive,
        triangle: &Triangle,
        weights: [f64; 3],
    ) -> DVec3 {
        let Some((image, taps)) = self.taps(images, primitive, triangle, weights) else {
            return DVec3::ONE;
        };
        taps.into_iter()
            .map(|(pixel, weight)| {
                let [r, g, b, _] = image.rgba[pixel].map(|byte| LINEAR[usize::from(byte)]);
                DVec3::new(r, g, b) * weight
            })
            .sum()
    }

    /// Alpha at a point of a triangle, in [0, 1].
    pub(super) fn alpha(
        &self,
        images: &[Image],
        primitive: &Primitive,
        triangle: &Triangle,
        weights: [f64; 3],
    ) -> f64 {
        let Some((image, taps)) = self.taps(images, primitive, triangle, weights) else {
            return 1.0;
        };
        taps.into_iter()
            .map(|(pixel, weight)| f64::from(image.rgba[pixel][3]) / 255.0 * weight)
            .sum()
    }

    /// The four pixels around a point of a triangle and their bilinear weights; `None` when there is no picture or no coordinates.
    fn taps<'i>(
        &self,
        images: &'i [Image],
        primitive: &Primitive,
        triangle: &Triangle,
        weights: [f64; 3],
    ) -> Option<(&'i Image, [(usize, f64); 4])> {
        let image = images.get(self.image?)?;
        let texcoords = primitive.texcoords.get(self.texcoord)?;
        let mut texcoord = DVec2::ZERO;
        for (corner, weight) in triangle.corners.iter().zip(weights) {
            texcoord += texcoords.get(*corner as usize)?.as_dvec2() * weight;
        }
        let at = self.transform.transform_point2(texcoord);
        let [(left, right, x), (top, bottom, y)] = [
            neighbours(at.x, image.width, self.wrap[0]),
            neighbours(at.y, image.height, self.wrap[1]),
        ];
        let pixel = |column: usize, row: usize| row * image.width as usize + column;
        Some((
            image,
            [
                (pixel(left, top), (1.0 - x) * (1.0 - y)),
                (pixel(right, top), x * (1.0 - y)),
                (pixel(left, bottom), (1.0 - x) * y),
                (pixel(right, bottom), x * y),
            ],
        ))
    }
}

/// The two pixels around `coordinate` (1 is `size` pixels) along one axis, and the weight of the second.
fn neighbours(coordinate: f64, size: u32, wrap: Wrap) -> (usize, usize, f64) {
    // First into one period, so that the casts below are exact for coordinates of any size.
    let reduced = match wrap {
        _ if !coordinate.is_finite() => 0.0,
        Wrap::Repeat => coordinate.rem_euclid(1.0),
        Wrap::MirroredRepeat => coordinate.rem_euclid(2.0),
        Wrap::ClampToEdge => coordinate.clamp(0.0, 1.0),
    };
    let size = i64::from(size);
    // Pixel centres are at halves.
    let at = reduced * size as f64 - 0.5;
    let first = at.floor();
    let pixel = |index: i64| {
        let index = match wrap {
            Wrap::Repeat => index.rem_euclid(size),
            Wrap::MirroredRepeat => {
                let index = index.rem_euclid(2 * size);
                index.min(2 * size - 1 - index)
            }
            Wrap::ClampToEdge => index.clamp(0, size - 1),
        };
        index as usize
    };
    (pixel(first as i64), pixel(first as i64 + 1), at - first)
}

/// The sRGB transfer function (IEC 61966-2-1) of every byte.
static LINEAR: LazyLock<[f64; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let encoded = byte as f64 / 255.0;
        if encoded <= 0.04045 {
            encoded / 12.92
        } else {
            ((encoded + 0.055) / 1.055).powf(2.4)
        }
    })
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worked_example_of_the_specification_shows_the_lower_left_quadrant() {
        let matrix = Transform {
            offset: [0.0, 1.0],
            rotation: std::f64::consts::FRAC_PI_2,
            scale: [0.5, 0.5],
            texcoord: None,
        }
        .matrix();
        // v points down: the quadrant is u in 0..½, v in ½..1.
        for (authored, picture) in [
            (DVec2::new(0.0, 0.0), DVec2::new(0.0, 1.0)),
            (DVec2::new(1.0, 0.0), DVec2::new(0.0, 0.5)),
            (DVec2::new(0.0, 1.0), DVec2::new(0.5, 1.0)),
        ] {
            let got = matrix.transform_point2(authored);
            assert!(got.distance(picture) < 1e-15, "{authored} gives {got}");
        }
    }

    #[test]
    fn neighbours_wrap_at_the_border() {
        // Four pixels; 0 is the left border of pixel 0, which lies half a pixel from its centre.
        assert_eq!(neighbours(0.0, 4, Wrap::Repeat), (3, 0, 0.5));
        assert_eq!(neighbours(0.0, 4, Wrap::MirroredRepeat), (0, 0, 0.5));
        assert_eq!(neighbours(0.0, 4, Wrap::ClampToEdge), (0, 0, 0.5));
        assert_eq!(neighbours(1.125, 4, Wrap::Repeat), (0, 1, 0.0));
        assert_eq!(neighbours(1.125, 4, Wrap::MirroredRepeat), (3, 2, 0.0));
        assert_eq!(neighbours(7.0, 4, Wrap::ClampToEdge), (3, 3, 0.5));
        assert_eq!(neighbours(-0.125, 4, Wrap::Repeat).0, 3);
    }

    #[test]
    fn coordinates_of_any_size_stay_in_the_picture() {
        for coordinate in [1e30, -1e30, f64::MAX, f64::NAN, f64::INFINITY, -1e-300] {
            for wrap in [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge] {
                let (first, second, weight) = neighbours(coordinate, 3, wrap);
                assert!(first < 3 && second < 3, "{coordinate} {wrap:?}");
                assert!((0.0..=1.0).contains(&weight), "{coordinate} {wrap:?}");
            }
        }
    }
}

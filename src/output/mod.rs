//! Field → files: dilation, EXR, glTF, preview, manifest. Nothing appears under its final name before everything is written.

mod names;

mod dilate;

mod exr;

mod ktx2;

mod export;

mod preview;

mod gltf;

mod manifest;

mod staging;

use std::path::Path;

use rayon::iter::{IndexedParallelIterator, IntoParallelRefIterator, ParallelIterator};

use self::export::Picture;
use self::exr::Precision;
use self::preview::Histogram;
use self::staging::Staging;
use crate::atlas::Atlas;
use crate::error::{Error, Result, Warnings};
use crate::refine::{Field, Plane};
use crate::scene::Scene;

pub use self::export::Export;

/// How files are written.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Stores 32-bit floats instead of halves everywhere. Default: false; a map whose values do not fit into halves within the
    /// tolerance is stored in floats all the same, and the manifest says so.
    pub float: bool,
    /// Accepted error relative to the largest magnitude of the map, which decides between half and float: a map is stored in halves
    /// when none of its values is rounded by more. Range: 1e-6..=1. Default: 0.004.
    pub tolerance: f64,
    /// How many texels the borders of charts are continued outwards. Default: 4, the padding between charts.
    pub dilation: u32,
    /// Whether to write the tone-mapped preview of pages that have the plane `E`.
    pub preview: bool,
    /// Whether to write the glTF file.
    pub glb: bool,
    /// Whether to write the texture of pages that have the planes `Gr`, `Gg`, `Gb` and `phi`.
    pub ktx2: bool,
    /// Layouts of engines to write.
    pub exports: Vec<Export>,
    /// Names of planes that only serve other files and get no map of their own.
    pub without_map: Vec<&'static str>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            float: false,
            tolerance: 0.004,
            dilation: 4,
            preview: true,
            glb: true,
            ktx2: false,
            exports: Vec::new(),
            without_map: Vec::new(),
        }
    }
}

/// A lightmap page as it was written.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PageFiles {
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The maps, in the order of the field's planes, then the texture of the planes together, then the preview.
    pub maps: Vec<MapFile>,
    /// The layouts of engines, in the order of [`Options::exports`].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub exports: Vec<MapFile>,
}

/// One file of a page.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MapFile {
    /// Name of the plane, or `ktx2`, `preview`, or of the layout's picture.
    pub plane: String,
    /// File name, relative to the bake's directory.
    pub file: String,
    /// `half`, `float`, `srgb8`, or `unorm16` (0..=1 in 16 bits).
    pub precision: &'static str,
    /// Smallest stored value of a covered texel, over all components. Dilated texels repeat covered ones; empty texels, which are
    /// 0, do not count. 0 when no texel is covered, and for the preview.
    pub min: f32,
    /// Largest stored value of a covered texel. 0 when no texel is covered; 1 for the preview.
    pub max: f32,
}

/// A bake on its way to the disk.
///
/// Files go to a temporary folder: inside the target when that exists, else in the nearest folder above that does, which is on the
/// same file system in both cases. [`Writer::commit`] renames them into place. Dropping the writer removes the temporary folder and
/// leaves the previous bake as it was.
#[derive(Debug)]
pub struct Writer {
    staging: Staging,
    options: Options,
    /// Luminances of all pages so far; they set the exposure of the previews.
    histogram: Histogram,
    /// Map of E and preview of each page so far.
    previews: Vec<[String; 2]>,
}

impl Writer {
    /// Opens a bake of the scene called `name` into `directory`, which need not exist; nothing is created under that name yet.
    ///
    /// Characters of `name` that some file system forbids are replaced by `_` in file names.
    ///
    /// # Errors
    /// `Io` when the temporary folder cannot be made, or when `directory` or something above it is a file.
    pub fn create(directory: &Path, name: &str, options: &Options) -> Result<Self> {
        Ok(Self {
            staging: Staging::open(directory, names::safe(name))?,
            options: options.clone(),
            histogram: Histogram::new(),
            previews: Vec::new(),
        })
    }

    /// Writes all planes of page `index`, dilated, on the threads of the current pool. Its preview follows when the bake is complete.
    ///
    /// # Errors
    /// `Io`, also when the page has been written before.
    pub fn page(&mut self, index: usize, field: &Field) -> Result<PageFiles> {
        let sources = dilate::sources(field, self.options.dilation);
        let scene = self.staging.scene().to_owned();
        let planes: Vec<&Plane> = field
            .planes
            .iter()
            .filter(|plane| !self.options.without_map.contains(&plane.name))
            .collect();
        let files: Vec<String> = planes
            .iter()
            .map(|plane| self.staging.add(names::map(&scene, index, plane.name)))
            .collect();
        let precisions: Vec<Precision> = planes
            .par_iter()
            .zip(&files)
            .map(|(plane, file)| {
                let precision = self.precision(&plane.values);
                exr::write(&self.staging.path(file), field, plane, &sources, precision)?;
                Ok(precision)
            })
            .collect::<Result<_>>()?;
        let mut maps: Vec<MapFile> = planes
            .iter()
            .zip(files)
            .zip(precisions)
            .map(|((plane, file), precision)| {
                map_file(plane.name, &[&plane.values], file, precision)
            })
            .collect();
        maps.extend(self.texture(index, field, &sources)?);
        maps.extend(self.announce_preview(index, field, &scene));
        Ok(PageFiles {
            width: field.width,
            height: field.height,
            maps,
            exports: self.exports(index, field, &sources)?,
        })
    }

    /// Writes the planes of light of a page as one texture, when it is asked for and they are there.
    fn texture(&mut self, index: usize, field: &Field, sources: &[u32]) -> Result<Option<MapFile>> {
        let Some(light) = ktx2::Light::of(field).filter(|_| self.options.ktx2) else {
            return Ok(None);
        };
        let file = names::texture(self.staging.scene(), index);
        let file = self.staging.add(file);
        let [red, green, blue] = light.vectors.map(|plane| plane.values.as_slice());
        let values = [red, green, blue, light.fluence.values.as_slice()];
        let sufficient = values.map(|values| self.precision(values));
        let precision = if sufficient.contains(&Precision::Float) {
            Precision::Float
        } else {
            Precision::Half
        };
        ktx2::write(&self.staging.path(&file), field, &light, sources, precision)?;
        Ok(Some(map_file(ktx2::PLANE, &values, file, precision)))
    }

    /// Writes the layouts of engines.
    fn exports(&mut self, index: usize, field: &Field, sources: &[u32]) -> Result<Vec<MapFile>> {
        let mut files = Vec::new();
        for export in self.options.exports.clone() {
            for picture in export::pictures(export, field).into_iter().flatten() {
                files.push(self.picture(index, field, sources, picture)?);
            }
        }
        Ok(files)
    }

    fn picture(
        &mut self,
        index: usize,
        field: &Field,
        sources: &[u32],
        picture: Picture,
    ) -> Result<MapFile> {
        let scene = self.staging.scene();
        // Slices stand one above the other, and so do their texels.
        let n_slices = picture.slices.len() as u32;
        let n_texels = field.places.len() as u32;
        let page = Field {
            width: field.width,
            height: field.height * n_slices,
            ..Field::default()
        };
        let sources: Vec<u32> = (0..n_slices)
            .flat_map(|slice| {
                sources.iter().map(move |&source| match source {
                    dilate::EMPTY => dilate::EMPTY,
                    source => source + slice * n_texels,
                })
            })
            .collect();
        let plane = Plane {
            name: picture.name,
            components: picture.components,
            values: picture.slices.concat(),
        };
        if picture.kind == export::Kind::Png {
            let file = self.staging.add(names::picture(scene, index, picture.name));
            export::write_png(&self.staging.path(&file), &page, &plane, &sources)?;
            return Ok(MapFile {
                precision: "unorm16",
                ..map_file(plane.name, &[&plane.values], file, Precision::Float)
            });
        }
        let precision = self.precision(&plane.values);
        let file = self.staging.add(names::map(scene, index, picture.name));
        exr::write(
            &self.staging.path(&file),
            &page,
            &plane,
            &sources,
            precision,
        )?;
        Ok(map_file(plane.name, &[&plane.values], file, precision))
    }

    /// Writes `<name>.glb`: the document of `scene` with `TEXCOORD_1`, the extension and its mirror in extras. `pages` holds what
    /// [`Writer::page`] returned, by index of the page. Does nothing when [`Options::glb`] is off.
    ///
    /// Returns what could not be carried over.
    ///
    /// # Errors
    /// `Io`; `InvalidFile` when the document cannot be written again; `TooLarge` when the file would exceed the 4 GiB of a `.glb`.
    pub fn glb(&mut self, scene: &Scene, atlas: &Atlas, pages: &[PageFiles]) -> Result<Warnings> {
        if !self.options.glb {
            return Ok(Warnings::default());
        }
        let (container, warnings) = gltf::container(scene, atlas, pages)?;
        let file = self.staging.add(names::glb(self.staging.scene()));
        self.staging
            .write(&file, &container.each_ref().map(Vec::as_slice))?;
        Ok(warnings)
    }

    /// Writes `<name>.lumel.json`: the object `manifest`, with all files of the bake under the key `files`. Comes last, before
    /// [`Writer::commit`].
    ///
    /// # Errors
    /// `Io`, also when `manifest` is not an object.
    pub fn manifest(&mut self, manifest: &serde_json::Value) -> Result<()> {
        let file = self.staging.add(names::manifest(self.staging.scene()));
        let path = self.staging.path(&file);
        let invalid = |source| Error::Io {
            path: path.clone(),
            source,
        };
        let mut manifest = manifest.clone();
        let object = manifest
            .as_object_mut()
            .ok_or_else(|| invalid(std::io::ErrorKind::InvalidInput.into()))?;
        object.insert(manifest::FILES.to_owned(), self.staging.files().into());
        let mut text =
            serde_json::to_vec_pretty(&manifest).map_err(|error| invalid(error.into()))?;
        text.push(b'\n');
        self.staging.write(&file, &[&text])
    }

    /// Renames everything into place, the manifest last, and removes files of the previous bake that this one no longer has. Returns
    /// the names of the files, sorted.
    ///
    /// # Errors
    /// `Io`.
    pub fn commit(self) -> Result<Vec<String>> {
        let exposure = self.histogram.exposure();
        for [map, preview] in &self.previews {
            let (width, height, pixels) = exr::read_color(&self.staging.path(map))?;
            let path = self.staging.path(preview);
            preview::write(&path, [width, height], &pixels, exposure)?;
        }
        self.staging.commit()
    }

    /// How a map of `values` is stored.
    fn precision(&self, values: &[f32]) -> Precision {
        if self.options.float {
            Precision::Float
        } else {
            Precision::sufficient_for(values, self.options.tolerance)
        }
    }

    /// Counts the luminances of a page and names its preview, when there is to be one.
    fn announce_preview(&mut self, index: usize, field: &Field, scene: &str) -> Option<MapFile> {
        let is_irradiance = |plane: &&Plane| plane.name == "E" && plane.components == 3;
        let irradiance = field.planes.iter().find(is_irradiance)?;
        if !self.options.preview {
            return None;
        }
        self.histogram.add(&irradiance.values);
        let file = self.staging.add(names::preview(scene, index));
        self.previews
            .push([names::map(scene, index, irradiance.name), file.clone()]);
        Some(MapFile {
            plane: "preview".to_owned(),
            file,
            precision: "srgb8",
            min: 0.0,
            max: 1.0,
        })
    }
}

/// What the manifest says of a map. Rounding keeps the order of values, so the stored extremes are the rounded extremes.
fn map_file(plane: &str, values: &[&[f32]], file: String, precision: Precision) -> MapFile {
    let extreme = |pick: fn(f32, f32) -> f32| {
        let extreme = values.iter().copied().flatten().copied().reduce(pick);
        precision.stored(extreme.unwrap_or(0.0))
    };
    MapFile {
        plane: plane.to_owned(),
        file,
        precision: precision.name(),
        min: extreme(f32::min),
        max: extreme(f32::max),
    }
}

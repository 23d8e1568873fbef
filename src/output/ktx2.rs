//! Light vectors and fluence of a page → one KTX 2.0 texture for engines that read it straight into video memory.
//!
//! Three layers for the red, green and blue channel of the light; in each R, G, B hold x, y, z of the light vector in world space (glTF
//! axes) and A the fluence, both in lux. Rows from the top down, v = 0 at the top (`KTXorientation` is `rd`), one level, no
//! supercompression. `R16G16B16A16_SFLOAT`, or `R32G32B32A32_SFLOAT` where halves would overflow or round by too much.
//!
//! Layout: Khronos KTX File Format Specification 2.0, sections 3.1–3.12; the data format descriptor: Khronos Data Format Specification
//! 1.4, section 5. Block-compressed formats are no alternative: those that every engine has are unsigned.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use half::f16;

use crate::error::{Error, Result};
use crate::output::dilate::EMPTY;
use crate::output::exr::Precision;
use crate::refine::{Field, Plane};

/// The first bytes of every file.
const IDENTIFIER: [u8; 12] = *b"\xABKTX 20\xBB\r\n\x1A\n";

/// Numbers of a pixel: x, y, z, fluence.
const COMPONENTS: u32 = 4;

/// One per colour channel of the light.
const LAYERS: u32 = 3;

/// Bytes of identifier, header, index, and the index of the one level.
const HEAD: u32 = 12 + 36 + 32 + 24;

/// Name of the plane of the manifest.
pub(super) const PLANE: &str = "ktx2";

/// Planes that a texture is made of.
pub(super) struct Light<'a> {
    /// Of red, green, blue.
    pub(super) vectors: [&'a Plane; 3],
    pub(super) fluence: &'a Plane,
}

impl<'a> Light<'a> {
    /// The planes of `field`; `None` when one is missing.
    pub(super) fn of(field: &'a Field) -> Option<Self> {
        let plane = |name| field.planes.iter().find(|plane| plane.name == name);
        Some(Self {
            vectors: [plane("Gr")?, plane("Gg")?, plane("Gb")?],
            fluence: plane("phi")?,
        })
    }

    /// The pixel of one covered texel.
    fn pixel(&self, layer: usize, texel: usize) -> [f32; 4] {
        let vector = &self.vectors[layer].values[3 * texel..3 * texel + 3];
        [
            vector[0],
            vector[1],
            vector[2],
            self.fluence.values[3 * texel + layer],
        ]
    }
}

/// Writes the texture of `field` to the file at `path`, which must not exist. Texels without a source are 0.
pub(super) fn write(
    path: &Path,
    field: &Field,
    light: &Light<'_>,
    sources: &[u32],
    precision: Precision,
) -> Result<()> {
    let written = File::create_new(path).and_then(|file| {
        let mut file = BufWriter::new(file);
        file.write_all(&head(field.width, field.height, precision))?;
        for layer in 0..LAYERS as usize {
            for &source in sources {
                let pixel = match source {
                    EMPTY => [0.0; 4],
                    source => light.pixel(layer, source as usize),
                };
                write_pixel(&mut file, pixel, precision)?;
            }
        }
        file.flush()
    });
    written.map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })
}

fn write_pixel(file: &mut impl Write, pixel: [f32; 4], precision: Precision) -> io::Result<()> {
    match precision {
        Precision::Half => {
            let bytes = pixel.map(|value| f16::from_f32(value).to_le_bytes());
            file.write_all(bytes.as_flattened())
        }
        Precision::Float => file.write_all(pixel.map(f32::to_le_bytes).as_flattened()),
    }
}

/// Everything before the pixels.
fn head(width: u32, height: u32, precision: Precision) -> Vec<u8> {
    // The numbers of VkFormat.
    let (format, bytes_per_number) = match precision {
        Precision::Half => (97_u32, 2_u32),
        Precision::Float => (109, 4),
    };
    let descriptor = descriptor(bytes_per_number);
    let notes = notes();
    let descriptor_size = descriptor.len() as u32;
    let notes_start = HEAD + descriptor_size;
    let end = notes_start as usize + notes.len();
    // Pixels start at a multiple of their size.
    let data_start = end.next_multiple_of((COMPONENTS * bytes_per_number) as usize);
    let data_size =
        u64::from(width) * u64::from(height) * u64::from(LAYERS * COMPONENTS * bytes_per_number);

    let mut head = Vec::with_capacity(data_start);
    head.extend(IDENTIFIER);
    let depth = 0_u32;
    let [faces, levels] = [1_u32; 2];
    let supercompression = 0_u32;
    for word in [
        format,
        bytes_per_number,
        width,
        height,
        depth,
        LAYERS,
        faces,
        levels,
        supercompression,
        HEAD,
        descriptor_size,
        notes_start,
        notes.len() as u32,
    ] {
        head.extend(word.to_le_bytes());
    }
    let supercompression_data = [0_u64; 2];
    let level = [data_start as u64, data_size, data_size];
    for word in supercompression_data.into_iter().chain(level) {
        head.extend(word.to_le_bytes());
    }
    head.extend(descriptor);
    head.extend(notes);
    head.resize(data_start, 0);
    head
}

/// The data format descriptor: four signed linear floats. The numbers are no colours, so their primaries are unspecified.
fn descriptor(bytes_per_number: u32) -> Vec<u8> {
    /// Identifiers of the channels R, G, B, A.
    const CHANNELS: [u32; 4] = [0, 1, 2, 15];
    const SIGNED_FLOAT: u32 = 0x80 | 0x40;
    let block_size = 24 + 16 * COMPONENTS;
    let (version, rgbsda, linear) = (2, 1, 1);
    let mut words = vec![
        4 + block_size,
        0,
        version | (block_size << 16),
        rgbsda | (linear << 16),
        0,
        COMPONENTS * bytes_per_number,
        0,
    ];
    for (index, channel) in (0_u32..).zip(CHANNELS) {
        let bits = 8 * bytes_per_number;
        words.extend([
            (index * bits) | ((bits - 1) << 16) | ((channel | SIGNED_FLOAT) << 24),
            0,
            (-1.0_f32).to_bits(),
            1.0_f32.to_bits(),
        ]);
    }
    words.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// The key/value data, in the order of the keys.
fn notes() -> Vec<u8> {
    let about = serde_json::json!({
        "version": 1,
        "layers": ["red", "green", "blue"],
        "rgb": "light vector",
        "a": "fluence",
        "unit": "lux",
        "space": "world",
        "rows": "top first",
    });
    let mut notes = Vec::new();
    for (key, value) in [
        ("KTXorientation", "rd".to_owned()),
        (
            "KTXwriter",
            concat!("lumel ", env!("CARGO_PKG_VERSION")).to_owned(),
        ),
        ("lumel", about.to_string()),
    ] {
        let size = key.len() + value.len() + 2;
        notes.extend((size as u32).to_le_bytes());
        notes.extend(key.bytes().chain([0]).chain(value.bytes()).chain([0]));
        notes.resize(notes.len().next_multiple_of(4), 0);
    }
    notes
}

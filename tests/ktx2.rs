//! The texture of a page, read by a parser that others wrote.

use std::fs;
use std::path::{Path, PathBuf};

use half::f16;
use ktx2::dfd::Basic;
use ktx2::{Format, Reader};
use lumel::output::{Options, PageFiles, Writer};
use lumel::refine::Field;

use crate::output::maps;

fn options() -> Options {
    Options {
        ktx2: true,
        ..Options::default()
    }
}

/// The page and its texture.
fn write(directory: &Path, field: &Field, options: &Options) -> (PageFiles, PathBuf) {
    let page = maps::write(directory, field, options);
    let map = page.maps.iter().find(|map| map.plane == "ktx2");
    let file = directory.join(&map.expect("a texture was written").file);
    (page, file)
}

/// What component `k` of a pixel of `layer` must be.
fn expected(field: &Field, layer: usize, x: u32, y: u32, k: usize) -> f32 {
    let plane = |name| field.planes.iter().find(|plane| plane.name == name);
    let (name, component) = if k < 3 {
        (["Gr", "Gg", "Gb"][layer], k)
    } else {
        ("phi", layer)
    };
    maps::expected(field, plane(name).expect("a plane"), x, y, 4)[component]
}

#[test]
fn the_texture_holds_light_vector_and_fluence() {
    for (scale, float) in [(300.0, false), (6.0e4, false), (1e6, false), (300.0, true)] {
        let field = maps::field(7, 21, 13, scale);
        let folder = tempfile::tempdir().expect("temporary folder");
        let (page, file) = write(folder.path(), &field, &Options { float, ..options() });
        let bytes = fs::read(file).expect("readable");
        let reader = Reader::new(&bytes).expect("valid by the letter");
        let header = reader.header();
        assert_eq!([header.pixel_width, header.pixel_height], [21, 13]);
        assert_eq!([header.pixel_depth, header.layer_count], [0, 3]);
        assert_eq!([header.face_count, header.level_count], [1, 1]);
        assert_eq!(header.supercompression_scheme, None);
        // A million lux does not fit into a half.
        let is_float = float || scale > 65504.0;
        let said = page.maps.iter().find(|map| map.plane == "ktx2");
        let [format, precision, size] = if is_float {
            assert_eq!(header.format, Some(Format::R32G32B32A32_SFLOAT));
            [4, 1, 16]
        } else {
            assert_eq!(header.format, Some(Format::R16G16B16A16_SFLOAT));
            [2, 0, 8]
        };
        assert_eq!(said.expect("said").precision, ["half", "float"][precision]);
        let level = reader.levels().next().expect("a level");
        assert_eq!(level.data.len(), 3 * 21 * 13 * size);
        let mut at = 0;
        for layer in 0..3 {
            for y in 0..13 {
                for x in 0..21 {
                    for k in 0..4 {
                        let stored = &level.data[at..at + format];
                        at += format;
                        let want = expected(&field, layer, x, y, k);
                        let (got, want) = match *stored {
                            [a, b] => (
                                f16::from_le_bytes([a, b]).to_f32(),
                                f16::from_f32(want).to_f32(),
                            ),
                            [a, b, c, d] => (f32::from_le_bytes([a, b, c, d]), want),
                            _ => panic!("{stored:?}"),
                        };
                        assert!(got.is_finite());
                        assert_eq!(got.to_bits(), want.to_bits(), "{layer} {x} {y} {k}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_descriptor_is_that_of_the_format() {
    for (scale, format) in [
        (300.0, Format::R16G16B16A16_SFLOAT),
        (1e6, Format::R32G32B32A32_SFLOAT),
    ] {
        let folder = tempfile::tempdir().expect("temporary folder");
        let (_, file) = write(folder.path(), &maps::field(3, 16, 16, scale), &options());
        let bytes = fs::read(file).expect("readable");
        let reader = Reader::new(&bytes).expect("valid by the letter");
        let (expected, type_size) = Basic::from_format(format).expect("a known format");
        assert_eq!(reader.header().type_size, type_size);
        assert_eq!(reader.dfd_blocks().len(), 1);
        let mut found = reader.basic_dfd().expect("a basic descriptor").clone();
        // Numbers that are no colours have no primaries.
        assert_eq!(found.color_primaries, None);
        found.color_primaries = expected.color_primaries;
        assert_eq!(found, expected);
    }
}

#[test]
fn the_texture_says_which_way_up_it_is() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (_, file) = write(folder.path(), &maps::field(3, 16, 16, 5.0), &options());
    let bytes = fs::read(file).expect("readable");
    let reader = Reader::new(&bytes).expect("valid by the letter");
    let notes: Vec<(&str, &[u8])> = reader.key_value_data().collect();
    let keys: Vec<&str> = notes.iter().map(|(key, _)| *key).collect();
    assert_eq!(keys, ["KTXorientation", "KTXwriter", "lumel"]);
    assert_eq!(notes[0].1, b"rd\0");
}

#[test]
fn planes_without_a_map_still_make_the_texture() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let options = Options {
        without_map: vec!["Gr", "Gg", "Gb", "phi"],
        ..options()
    };
    let mut writer = Writer::create(folder.path(), "test", &options).expect("writable");
    let page = writer
        .page(0, &maps::field(3, 16, 16, 5.0))
        .expect("written");
    let files = writer.commit().expect("committed");
    let planes: Vec<&str> = page.maps.iter().map(|map| map.plane.as_str()).collect();
    assert_eq!(planes, ["E", "err", "ktx2", "preview"]);
    assert_eq!(files.len(), 4);
}

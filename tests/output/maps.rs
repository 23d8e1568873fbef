//! Maps and previews: values, precision, dilation, bytes.

use std::fs;
use std::path::Path;

use exr::image::FlatSamples;
use exr::meta::MetaData;
use exr::prelude::{Compression, LineOrder, ReadChannels, ReadLayers, SampleType, read};
use lumel::output::{Options, PageFiles, Writer};
use lumel::refine::{Field, Plane};

use crate::support::Rng;

/// Planes of a bake with every kind of file.
pub(crate) const PLANES: [(&str, usize); 6] = [
    ("E", 3),
    ("Gr", 3),
    ("Gg", 3),
    ("Gb", 3),
    ("phi", 3),
    ("err", 1),
];

/// Two rectangles of texels with values of every size up to `scale`, signed where the plane has a sign.
pub(crate) fn field(case: u64, width: u32, height: u32, scale: f64) -> Field {
    let mut rng = Rng::new(case);
    let mut places = Vec::new();
    for y in 0..height as u16 {
        for x in 0..width as u16 {
            let left = (2..7).contains(&x) && (1..9).contains(&y);
            let right = (13..18).contains(&x) && y >= 5;
            if left || right {
                places.push([x, y]);
            }
        }
    }
    let planes = PLANES
        .map(|(name, components)| {
            let signed = name.starts_with('G');
            let values = (0..components * places.len())
                .map(|_| {
                    let size = scale * 10.0_f64.powf(rng.range(-9.0, 0.0));
                    let sign = if signed && rng.unit() < 0.5 {
                        -1.0
                    } else {
                        1.0
                    };
                    (sign * size) as f32
                })
                .collect();
            Plane {
                name,
                components,
                values,
            }
        })
        .to_vec();
    Field {
        width,
        height,
        places,
        planes,
    }
}

/// Writes one page below `directory` and returns what was said about it.
pub(crate) fn write(directory: &Path, field: &Field, options: &Options) -> PageFiles {
    let mut writer = Writer::create(directory, "test", options).expect("writable");
    let page = writer.page(0, field).expect("written");
    writer.commit().expect("committed");
    page
}

/// What a texel of the page must hold: the value of the nearest covered texel in reach, else 0. The obvious way.
pub(crate) fn expected(field: &Field, plane: &Plane, x: u32, y: u32, reach: u32) -> Vec<f32> {
    let nearest = (0..field.places.len())
        .filter_map(|index| {
            let [source_x, source_y] = field.places[index].map(u32::from);
            let (dx, dy) = (source_x.abs_diff(x), source_y.abs_diff(y));
            let key = (dx * dx + dy * dy, source_y, source_x);
            (dx.max(dy) <= reach).then_some((key, index))
        })
        .min();
    let components = plane.components;
    nearest.map_or(vec![0.0; components], |(_, index)| {
        plane.values[components * index..components * (index + 1)].to_vec()
    })
}

/// Channels by name, alphabetically, each row by row.
pub(crate) fn channels(path: &Path) -> Vec<(String, FlatSamples)> {
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .expect("readable");
    image
        .layer_data
        .channel_data
        .list
        .into_iter()
        .map(|channel| (channel.name.to_string(), channel.sample_data))
        .collect()
}

fn precision_of(page: &PageFiles, plane: &str) -> &'static str {
    let mut maps = page.maps.iter();
    maps.find(|map| map.plane == plane)
        .expect("plane was written")
        .precision
}

#[test]
fn maps_hold_the_nearest_covered_value() {
    for (case, float) in [(0, false), (1, true)] {
        let field = field(case, 24, 16, 300.0);
        let folder = tempfile::tempdir().expect("temporary folder");
        let options = Options {
            float,
            dilation: 2,
            ..Options::default()
        };
        let page = write(folder.path(), &field, &options);
        for plane in &field.planes {
            let file = folder.path().join(format!("test_lm0_{}.exr", plane.name));
            let channels = channels(&file);
            let names: Vec<&str> = channels.iter().map(|(name, _)| name.as_str()).collect();
            match plane.components {
                1 => assert_eq!(names, ["Y"]),
                _ => assert_eq!(names, ["B", "G", "R"]),
            }
            assert_eq!(
                precision_of(&page, plane.name),
                if float { "float" } else { "half" }
            );
            for y in 0..field.height {
                for x in 0..field.width {
                    let want = expected(&field, plane, x, y, 2);
                    let at = (y * field.width + x) as usize;
                    for (component, want) in want.into_iter().enumerate() {
                        // Channels are stored in alphabetical order: B, G, R.
                        let (_, samples) = &channels[plane.components - 1 - component];
                        let got = match samples {
                            FlatSamples::F16(samples) => samples[at].to_f32(),
                            FlatSamples::F32(samples) => samples[at],
                            FlatSamples::U32(_) => f32::NAN,
                        };
                        let want = if float {
                            want
                        } else {
                            half::f16::from_f32(want).to_f32()
                        };
                        assert_eq!(got.to_bits(), want.to_bits(), "{} at {x}, {y}", plane.name);
                    }
                }
            }
        }
    }
}

#[test]
fn precision_follows_from_the_values() {
    let one = |values: Vec<f32>| Field {
        width: 4,
        height: 4,
        places: (0..values.len() as u16).map(|x| [x, 0]).collect(),
        planes: vec![Plane {
            name: "err",
            components: 1,
            values,
        }],
    };
    // Halves round by at most 2^-11 relative to the largest value, so a tolerance of 2^-11 always holds and 2^-13 seldom does.
    let sufficient = 0.5_f64.powi(11);
    for (values, tolerance, want) in [
        (vec![0.1, 1.0, 3.3], sufficient, "half"),
        (vec![0.1, 1.0, 3.3], sufficient / 4.0, "float"),
        (vec![1.0, 2.0, 0.5], 1e-6, "half"),
        (vec![65504.0], 1e-6, "half"),
        (vec![65505.0], 0.1, "float"),
        (vec![1e30, -1e30], 1.0, "float"),
        (vec![1e-30], 0.004, "float"),
        (vec![0.0, 0.0], 1e-6, "half"),
        (vec![], 1e-6, "half"),
    ] {
        let folder = tempfile::tempdir().expect("temporary folder");
        let options = Options {
            tolerance,
            ..Options::default()
        };
        let page = write(folder.path(), &one(values.clone()), &options);
        assert_eq!(
            precision_of(&page, "err"),
            want,
            "{values:?} at {tolerance}"
        );
    }
}

#[test]
fn page_says_what_its_maps_hold() {
    let field = field(5, 24, 16, 300.0);
    let folder = tempfile::tempdir().expect("temporary folder");
    let page = write(folder.path(), &field, &Options::default());
    let planes: Vec<&str> = page.maps.iter().map(|map| map.plane.as_str()).collect();
    assert_eq!(planes, ["E", "Gr", "Gg", "Gb", "phi", "err", "preview"]);
    for (map, plane) in page.maps.iter().zip(&field.planes) {
        let stored = plane
            .values
            .iter()
            .map(|&value| half::f16::from_f32(value).to_f32());
        let [min, max] =
            [f32::min, f32::max].map(|pick| stored.clone().reduce(pick).expect("not empty"));
        assert_eq!([map.min, map.max], [min, max], "{}", map.plane);
        assert!(folder.path().join(&map.file).is_file(), "{}", map.file);
    }
}

#[test]
fn every_reader_can_open_the_layout() {
    let folder = tempfile::tempdir().expect("temporary folder");
    write(folder.path(), &field(2, 24, 16, 1e6), &Options::default());
    for (plane, components) in PLANES {
        let path = folder.path().join(format!("test_lm0_{plane}.exr"));
        let meta = MetaData::read_from_file(&path, true).expect("valid by the letter");
        let [header] = meta.headers.as_slice() else {
            panic!("{plane} has {} parts", meta.headers.len());
        };
        assert_eq!(header.compression, Compression::ZIP16);
        assert_eq!(header.line_order, LineOrder::Increasing);
        assert!(!meta.requirements.is_multilayer() && !header.deep);
        assert!(!meta.requirements.has_deep_data && !meta.requirements.is_single_layer_and_tiled);
        assert_eq!(header.channels.list.len(), components);
        for channel in &header.channels.list {
            assert_eq!(
                channel.sample_type,
                SampleType::F32,
                "1e6 does not fit a half"
            );
        }
        // Two attributes of our own would come in a random order.
        assert_eq!(header.own_attributes.other.len(), 1);
        assert!(header.own_attributes.capture_date.is_none());
    }
}

#[test]
fn same_values_give_the_same_bytes_on_any_number_of_threads() {
    let field = field(3, 24, 40, 100.0);
    let bytes: Vec<Vec<Vec<u8>>> = [1, 2, 3, 1]
        .map(|threads| {
            let folder = tempfile::tempdir().expect("temporary folder");
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("threads");
            let page = pool.install(|| write(folder.path(), &field, &Options::default()));
            page.maps
                .iter()
                .map(|map| fs::read(folder.path().join(&map.file)).expect("readable"))
                .collect()
        })
        .to_vec();
    for other in &bytes[1..] {
        assert!(*other == bytes[0], "bytes differ");
    }
}

#[test]
fn previews_of_a_bake_share_one_exposure() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let page = |values: Vec<f32>| Field {
        width: 4,
        height: 4,
        places: vec![[1, 0], [2, 0]],
        planes: vec![Plane {
            name: "E",
            components: 3,
            values,
        }],
    };
    let options = Options {
        dilation: 0,
        ..Options::default()
    };
    let mut writer = Writer::create(folder.path(), "test", &options).expect("writable");
    let dim = page(vec![5.0, 5.0, 5.0, 10.0, 10.0, 10.0]);
    let bright = page(vec![10.0, 10.0, 10.0, 200.0, 200.0, 200.0]);
    writer.page(0, &dim).expect("written");
    writer.page(1, &bright).expect("written");
    writer.commit().expect("committed");
    let pixel = |page: usize, x: u32| {
        let path = folder.path().join(format!("test_lm{page}_preview.png"));
        image::open(path)
            .expect("a PNG")
            .to_rgb8()
            .get_pixel(x, 0)
            .0
    };
    assert_eq!(pixel(0, 2), pixel(1, 1), "10 lux on both pages");
    assert!(pixel(0, 1) < pixel(0, 2) && pixel(1, 1) < pixel(1, 2));
    assert_eq!(pixel(0, 0), [0; 3], "nothing there");
}

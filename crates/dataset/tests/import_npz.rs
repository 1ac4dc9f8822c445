//! Blender exports: everything the file tells arrives, and a file that lacks
//! something says what.

use std::f32::consts::FRAC_1_SQRT_2;
use std::path::{Path, PathBuf};

use drape_dataset::SequenceReader;
use drape_dataset::import::{METRES_PER_UV, import_npz};
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::Intersections;
use npyz::WriterBuilder;
use npyz::npz::NpzWriter;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

/// A file under construction: arrays to write, in the source's types.
struct Source {
    numbers: Vec<(&'static str, Vec<u64>, Vec<f32>)>,
    indices: Vec<(&'static str, Vec<u64>, Vec<i32>)>,
    texts: Vec<(&'static str, Vec<String>)>,
}

impl Source {
    /// Two frames: a body of four vertices, a T-shirt of two panels (two
    /// triangles, 1 × 1 unit each half), a skirt; the hips turn by 90° about Z.
    fn new() -> Self {
        let square = [0., 0., 8., 1., 0., 8., 1., 1., 8., 0., 1., 8.];
        let body = [0., 0., 0., 0., 2., 9., 0., 0., 9., 0., 0., 16.];
        let moved = |points: &[f32]| -> Vec<f32> {
            points
                .iter()
                .copied()
                .chain(points.iter().map(|x| x + 0.5))
                .collect()
        };
        let identity = [1., 0., 0., 0., 1., 0., 0., 0., 1.];
        let turned = [0., -1., 0., 1., 0., 0., 0., 0., 1.];
        let material = r#"{"mass": 0.4, "tension": 40, "compression": 35, "shear": 0,
            "bending": 15, "friction": 60, "body_friction": 55, "name": "any"}"#;
        let wind = r#"{"frames": [{"quat_wxyz": [1, 0, 0, 0], "strength": 0},
            {"quat_wxyz": [0, 1, 0, 0], "strength": 250.5}]}"#;
        let settings = r#"{"gravity": [0, 0, -9.81], "blender": "5.0.1",
            "cfg": {"air_damping": 1.0}, "cloth": {"collision": {"use_self_collision": true}}}"#;
        Self {
            numbers: vec![
                ("fps", vec![], vec![30.0]),
                ("scale", vec![], vec![10.0]),
                ("body_vertices", vec![2, 4, 3], moved(&body)),
                // Hips second: the joint is found by name.
                (
                    "pose_rotmats",
                    vec![2, 2, 3, 3],
                    [identity, identity, identity, turned].concat(),
                ),
                ("garment0_rest", vec![4, 3], square.to_vec()),
                ("garment0_vertices", vec![2, 4, 3], moved(&square)),
                (
                    "garment0_uv",
                    vec![6, 2],
                    vec![0., 0., 1., 0., 1., 1., 12., 2., 13., 3., 12., 3.],
                ),
                ("garment1_rest", vec![4, 3], square.to_vec()),
                ("garment1_vertices", vec![2, 4, 3], moved(&square)),
                (
                    "garment1_uv",
                    vec![4, 2],
                    vec![5., 5., 6., 5., 6., 6., 5., 6.],
                ),
            ],
            indices: vec![
                ("body_faces", vec![2, 3], vec![0, 1, 2, 1, 2, 3]),
                ("garment0_faces", vec![2, 3], vec![0, 1, 2, 0, 2, 3]),
                ("garment0_uv_faces", vec![2, 3], vec![0, 1, 2, 3, 4, 5]),
                ("garment1_faces", vec![2, 3], vec![0, 1, 2, 0, 2, 3]),
                ("garment1_uv_faces", vec![2, 3], vec![0, 1, 2, 0, 2, 3]),
                ("garment1_pin", vec![1], vec![0]),
                (
                    "intersections_detail",
                    vec![2, 4],
                    vec![1, 2, 3, 4, 0, 0, 0, 6],
                ),
            ],
            texts: vec![
                ("names", vec!["tshirt".into(), "skirt".into()]),
                ("joint_names", vec!["Spine".into(), "Hips".into()]),
                ("garment0_material", vec![material.into()]),
                ("garment1_material", vec![material.into()]),
                ("wind", vec![wind.into()]),
                ("settings", vec![settings.into()]),
            ],
        }
    }

    /// Writes the file; `body_faces` in column order, as numpy does for some arrays.
    fn write(&self, folder: &Path) -> PathBuf {
        let path = folder.join("seq_t.npz");
        let mut npz = NpzWriter::create(&path).unwrap();
        for (name, shape, values) in &self.numbers {
            let builder = npz.array(name, Default::default()).unwrap();
            let mut writer = builder.default_dtype().shape(shape).begin_nd().unwrap();
            writer.extend(values.iter().copied()).unwrap();
            writer.finish().unwrap();
        }
        for (name, shape, values) in &self.indices {
            let builder = npz.array(name, Default::default()).unwrap().default_dtype();
            let mut writer = if *name == "body_faces" {
                builder
                    .order(npyz::Order::Fortran)
                    .shape(shape)
                    .begin_nd()
                    .unwrap()
            } else {
                builder.shape(shape).begin_nd().unwrap()
            };
            let columns = |i: usize| values[i % 2 * 3 + i / 2];
            if *name == "body_faces" && values.len() == 6 {
                writer.extend((0..6).map(columns)).unwrap();
            } else {
                writer.extend(values.iter().copied()).unwrap();
            }
            writer.finish().unwrap();
        }
        for (name, texts) in &self.texts {
            let width = texts.iter().map(|text| text.chars().count()).max().unwrap();
            let dtype = npyz::DType::Plain(format!("<U{width}").parse().unwrap());
            let shape: &[u64] = if texts.len() == 1 {
                &[]
            } else {
                &[texts.len() as u64]
            };
            let builder = npz.array(name, Default::default()).unwrap();
            let mut writer = builder.dtype(dtype).shape(shape).begin_nd().unwrap();
            writer.extend(texts).unwrap();
            writer.finish().unwrap();
        }
        path
    }

    fn set_text(&mut self, name: &str, text: &str) {
        self.texts
            .iter_mut()
            .find(|(other, _)| *other == name)
            .unwrap()
            .1 = vec![text.into()];
    }

    fn remove(&mut self, name: &str) {
        self.numbers.retain(|(other, ..)| *other != name);
        self.indices.retain(|(other, ..)| *other != name);
        self.texts.retain(|(other, _)| *other != name);
    }
}

#[test]
fn everything_the_file_tells_arrives_and_writes() {
    let folder = TempDir::new().unwrap();
    let imported = import_npz(Source::new().write(folder.path())).unwrap();
    let header = &imported.header;
    assert_eq!(header.name, "seq_t");
    assert_eq!(
        header.body.faces,
        [[0, 1, 2], [1, 2, 3]],
        "column order is undone"
    );
    assert_eq!(
        header.body.rest.len(),
        4,
        "frame 0, where garments are at rest"
    );
    let kinds: Vec<_> = header.garments.iter().map(|garment| garment.kind).collect();
    assert_eq!(kinds, [GarmentKind::TShirt, GarmentKind::Skirt]);
    assert_eq!(header.garments[0].panel_of_face, [0, 1]);
    assert_eq!(header.garments[1].panels.len(), 1);
    assert_eq!(header.garments[1].material.compression, 35.0);
    assert_eq!(header.scene.body_friction, 55.0);
    assert!(
        (header.scene.gravity[2] + 8.829).abs() < 1e-5,
        "{:?}",
        header.scene.gravity
    );
    // No stiffness against shear: no such effect.
    let expected: Vec<_> = Effect::ALL
        .iter()
        .copied()
        .filter(|&effect| effect != Effect::Shear)
        .collect();
    assert_eq!(header.scene.effects, expected);

    // UV and space are equally large in the source: 0.1 m a unit. In ours one
    // UV unit is METRES_PER_UV, and the T-shirt spans 13 units = 1.3 m.
    assert_eq!(header.scene.metres_per_uv, METRES_PER_UV);
    let width = header.garments[0]
        .uv
        .iter()
        .map(|uv| uv[0])
        .fold(0.0, f32::max);
    assert!((width * METRES_PER_UV - 1.3).abs() < 1e-5, "{width}");

    let frame = &imported.frames[1];
    assert_eq!(frame.garments[0][1], [1.5, 0.5, 8.5]);
    assert_eq!(frame.wind.strength, 250.5);
    assert_eq!(
        frame.root.translation,
        [0.5, 1.5, 9.5],
        "centre of the pelvis"
    );
    let turn = [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2];
    let close = frame
        .root
        .rotation
        .iter()
        .zip(turn)
        .all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(close, "{:?}", frame.root.rotation);
    let counts = Intersections {
        between_garments: 3,
        within_garments: 3,
        with_body: 4,
    };
    assert_eq!(imported.frames[0].intersections, Some(counts));

    let file = folder.path().join("seq_t.mcap");
    imported.write(&file).unwrap();
    let reader = SequenceReader::open(&file).unwrap();
    assert_eq!(*reader.header(), imported.header);
    assert_eq!(reader.read_all().unwrap(), imported.frames);
}

#[test]
fn estimates_are_said_in_warnings() {
    let folder = TempDir::new().unwrap();
    let mut source = Source::new();
    // The skirt's UVs twice as large: another texel density.
    source
        .numbers
        .last_mut()
        .unwrap()
        .2
        .iter_mut()
        .for_each(|x| *x *= 2.0);
    source.remove("intersections_detail");
    let imported = import_npz(source.write(folder.path())).unwrap();
    let warnings = imported.header.scene.warnings.join("\n");
    for part in [
        "metres_per_uv",
        "\"skirt\" alone",
        "frame 0",
        "frame time",
        "no intersections",
    ] {
        assert!(warnings.contains(part), "{part:?} is not in: {warnings}");
    }
    assert!(
        imported
            .frames
            .iter()
            .all(|frame| frame.intersections.is_none())
    );
}

#[test]
fn a_file_that_lacks_something_says_what() {
    let folder = TempDir::new().unwrap();
    let refused = |change: &dyn Fn(&mut Source), parts: &[&str]| {
        let mut source = Source::new();
        change(&mut source);
        let message = import_npz(source.write(folder.path()))
            .unwrap_err()
            .to_string();
        for part in ["seq_t.npz"].iter().chain(parts) {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    };
    for name in [
        "fps",
        "body_vertices",
        "garment1_uv",
        "wind",
        "settings",
        "names",
    ] {
        refused(
            &|source| source.remove(name),
            &[&format!("array {name:?}"), "only"],
        );
    }
    refused(
        &|s| s.set_text("names", "cape"),
        &["names", "\"cape\"", "jumpsuit"],
    );
    refused(&|s| s.set_text("wind", "{"), &["wind", "JSON"]);
    refused(
        &|s| s.set_text("wind", r#"{"frames": [1]}"#),
        &["wind", "2 of them", "1 frames"],
    );
    refused(
        &|s| s.set_text("garment1_material", "{}"),
        &["garment1_material", "\"mass\""],
    );
    refused(
        &|s| s.set_text("joint_names", "Neck"),
        &["joint_names", "Hips", "Neck"],
    );
    refused(&|s| s.set_text("settings", "{}"), &["settings", "gravity"]);
    refused(
        &|s| s.numbers[5].1 = vec![4, 2, 3],
        &["garment0_vertices", "4 frames"],
    );
    refused(
        &|s| s.numbers[2].1 = vec![8, 3],
        &["body_vertices", "[8, 3]"],
    );
    refused(&|s| s.numbers[3].2[9] = 7.0, &["pose_rotmats", "frame 0"]);
    refused(
        &|s| s.numbers[5].2[13] = f32::NAN,
        &["frame 1", "\"tshirt\"", "vertex 0", "NaN"],
    );
    refused(
        &|s| s.indices[1].2[0] = 9,
        &["\"tshirt\"", "faces", "below 4"],
    );
    refused(&|s| s.indices[2].2[0] = -1, &["garment0_uv_faces", "-1"]);
    refused(
        &|s| s.indices[2].2[0] = 6,
        &["garment0_uv_faces", "below 6"],
    );
    refused(
        &|s| s.numbers[6].2.fill(0.0),
        &["\"tshirt\"", "areas above 0"],
    );

    let text = folder.path().join("text.npz");
    std::fs::write(&text, "not a zip").unwrap();
    assert!(
        import_npz(&text)
            .unwrap_err()
            .to_string()
            .contains("an .npz file")
    );
    let missing = import_npz(folder.path().join("none.npz"))
        .unwrap_err()
        .to_string();
    assert!(missing.contains("cannot open"), "{missing}");
}

/// Checksums protect the arrays; the zip's own directory has none, but a name
/// that changed there is a missing array.
#[test]
fn a_damaged_file_is_an_error_or_tells_the_same() {
    let folder = TempDir::new().unwrap();
    let path = Source::new().write(folder.path());
    let sound = std::fs::read(&path).unwrap();
    let expected = import_npz(&path).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for trial in 0..600 {
        let mut bytes = sound.clone();
        let at = rng.random_range(0..bytes.len());
        if trial % 3 == 0 {
            bytes.truncate(at);
        } else {
            bytes[at] ^= rng.random_range(1..=255u8);
        }
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(found) = import_npz(&path) {
            assert_eq!(found, expected, "byte {at} changed the content unnoticed");
        }
    }
}

//! What a sequence file guarantees: the same bits back, in any order; damage
//! is never mistaken for data; nothing half-written under the final name.

use std::fs;
use std::path::{Path, PathBuf};

use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{
    BodyTopology, Frame, Garment, Intersections, Material, Root, SceneMeta, SequenceHeader, Wind,
};
use drape_dataset::{DatasetError, SequenceReader, SequenceWriter};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

fn garment(name: &str, layer: u32) -> Garment {
    Garment {
        name: name.into(),
        kind: GarmentKind::Skirt,
        layer,
        rest: vec![
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
            [1.0, 1.0, 1.0],
        ],
        faces: vec![[0, 1, 2], [2, 1, 3]],
        uv: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5], [1.0, 1.0]],
        uv_faces: vec![[0, 1, 2], [2, 3, 4]],
        panel_of_face: vec![0, 1],
        panels: vec!["front".into(), "back".into()],
        material: Material {
            mass: 0.3,
            tension: 20.0,
            compression: 30.0,
            shear: 40.0,
            bending: 50.0,
            friction: 60.0,
        },
    }
}

fn header() -> SequenceHeader {
    SequenceHeader {
        name: "train_0007".into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: u64::MAX,
            engine: "test".into(),
            engine_version: "1".into(),
            effects: vec![Effect::Gravity, Effect::Waistband],
            gravity: [0.0, -0.0, -98.1],
            body_friction: 50.0,
            metres_per_uv: 1.5,
            recipe: "{}".into(),
            warnings: vec!["made up".into()],
        },
        body: BodyTopology {
            rest: vec![[0.5; 3]; 3],
            faces: vec![[0, 1, 2]],
            vertex_count: 3,
        },
        garments: vec![garment("inner", 0), garment("outer", 1)],
    }
}

/// Frames with every kind of finite f32: negative zero, subnormals, extremes.
fn frames(count: usize) -> Vec<Frame> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut position = || {
        std::array::from_fn(|_| {
            loop {
                let x = f32::from_bits(rng.random());
                if x.is_finite() {
                    return x;
                }
            }
        })
    };
    (0..count)
        .map(|i| Frame {
            body: (0..3).map(|_| position()).collect(),
            root: Root {
                translation: position(),
                rotation: [0.6, 0.0, -0.0, 0.8],
            },
            garments: (0..2)
                .map(|_| (0..4).map(|_| position()).collect())
                .collect(),
            wind: if i % 2 == 0 {
                Wind::default()
            } else {
                Wind {
                    rotation: [0.0, 1.0, 0.0, 0.0],
                    strength: 400.0,
                }
            },
            intersections: (i % 3 != 0).then_some(Intersections {
                between_garments: 0,
                within_garments: i as u32,
                with_body: u32::MAX,
            }),
        })
        .collect()
}

fn write(folder: &Path, frames: &[Frame]) -> PathBuf {
    let path = folder.join("s.mcap");
    let mut writer = SequenceWriter::create(&path, &header()).unwrap();
    for frame in frames {
        writer.push(frame).unwrap();
    }
    writer.finish().unwrap();
    path
}

/// Everything a file says, or the first error.
fn decode(path: &Path) -> Result<(SequenceHeader, Vec<Frame>), DatasetError> {
    let reader = SequenceReader::open(path)?;
    let frames = reader.read_all()?;
    Ok((reader.header().clone(), frames))
}

fn bits(frames: &[Frame]) -> Vec<u32> {
    frames
        .iter()
        .flat_map(|f| {
            let positions = f.body.iter().chain(f.garments.iter().flatten()).flatten();
            positions
                .chain(&f.root.translation)
                .chain(&f.root.rotation)
                .map(|x| x.to_bits())
                .collect::<Vec<_>>()
        })
        .collect()
}

#[test]
fn what_is_written_comes_back_bit_for_bit() {
    let folder = TempDir::new().unwrap();
    let written = frames(7);
    let (read_header, read) = decode(&write(folder.path(), &written)).unwrap();
    assert_eq!(read_header, header());
    assert_eq!(read_header.scene.gravity[1].to_bits(), (-0.0f32).to_bits());
    assert_eq!(read, written);
    assert_eq!(
        bits(&read),
        bits(&written),
        "signs of zero and subnormals too"
    );
}

#[test]
fn frames_in_any_order_and_from_several_threads_equal_the_sequential_ones() {
    let folder = TempDir::new().unwrap();
    let written = frames(20);
    let reader = SequenceReader::open(write(folder.path(), &written)).unwrap();
    std::thread::scope(|scope| {
        for seed in 0..4 {
            let (reader, written) = (&reader, &written);
            scope.spawn(move || {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                for _ in 0..100 {
                    let i = rng.random_range(0..written.len());
                    assert_eq!(reader.frame(i).unwrap(), written[i]);
                }
            });
        }
    });
    let window: Vec<_> = reader.frames(5..8).map(Result::unwrap).collect();
    assert_eq!(window, written[5..8]);
    let message = reader.frame(20).unwrap_err().to_string();
    assert!(
        message.contains("frame 20") && message.contains("20 frames"),
        "{message}"
    );
}

#[test]
fn any_changed_byte_is_detected_or_harmless() {
    let folder = TempDir::new().unwrap();
    let path = write(folder.path(), &frames(4));
    let sound = fs::read(&path).unwrap();
    let expected = decode(&path).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut detected = 0;
    let trials = 1500;
    for _ in 0..trials {
        let mut bytes = sound.clone();
        let at = rng.random_range(0..bytes.len());
        bytes[at] ^= rng.random_range(1..=255u8);
        fs::write(&path, &bytes).unwrap();
        match decode(&path) {
            Err(_) => detected += 1,
            Ok(found) => assert_eq!(found, expected, "byte {at} changed the content unnoticed"),
        }
    }
    // What is not used (message indexes, the second copy of the schema) may change.
    assert!(
        detected > trials / 2,
        "{detected} of {trials} changes were detected"
    );
}

#[test]
fn a_file_cut_anywhere_is_an_error_that_says_so() {
    let folder = TempDir::new().unwrap();
    let path = write(folder.path(), &frames(4));
    let sound = fs::read(&path).unwrap();
    for length in (0..sound.len()).step_by(7).chain([sound.len() - 1]) {
        fs::write(&path, &sound[..length]).unwrap();
        let error = decode(&path).expect_err("a cut file must not open");
        let message = error.to_string();
        assert!(message.contains("s.mcap"), "{message}");
        let says_so = matches!(error, DatasetError::Truncated { .. });
        assert!(says_so || length < 8, "cut at {length}: {message}");
    }
}

#[test]
fn a_writer_that_is_dropped_or_fails_leaves_nothing_and_the_old_file_stays() {
    let folder = TempDir::new().unwrap();
    let path = write(folder.path(), &frames(3));
    let before = fs::read(&path).unwrap();
    let mut writer = SequenceWriter::create(&path, &header()).unwrap();
    writer.push(&frames(1)[0]).unwrap();
    drop(writer);
    let empty = SequenceWriter::create(&path, &header()).unwrap();
    assert!(
        empty
            .finish()
            .unwrap_err()
            .to_string()
            .contains("at least one frame")
    );
    assert_eq!(fs::read(&path).unwrap(), before);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no temporary file is left"
    );

    let nowhere = folder.path().join("missing/s.mcap");
    let message = SequenceWriter::create(nowhere, &header())
        .err()
        .unwrap()
        .to_string();
    assert!(message.contains("missing"), "{message}");
}

#[test]
fn what_killed_writers_left_is_taken_away_and_what_others_write_is_not() {
    let folder = TempDir::new().unwrap();
    let hidden = || {
        let names = fs::read_dir(folder.path()).unwrap();
        let names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut hidden: Vec<_> = names.filter(|name| name.starts_with('.')).collect();
        hidden.sort();
        hidden
    };
    let path = folder.path().join("s.mcap");
    let first = SequenceWriter::create(&path, &header()).unwrap();
    let living = hidden();
    assert_eq!(living.len(), 1);
    assert!(living[0].starts_with(".s.mcap-") && living[0].ends_with(".partial"));
    let others = [
        ".s.mcap-notes.partial",
        ".s.mcap-t-abcdef.partial",
        ".t.mcap-abcdef.partial",
    ];
    for name in others.iter().chain(&[".s.mcap-abcdef.partial"]) {
        fs::write(folder.path().join(name), "frames").unwrap();
    }
    let second = SequenceWriter::create(&path, &header()).unwrap();
    let left = hidden();
    assert!(
        others
            .iter()
            .all(|name| left.iter().any(|left| left == name))
    );
    assert!(left.contains(&living[0]), "somebody still writes to it");
    assert!(!left.iter().any(|name| name == ".s.mcap-abcdef.partial"));
    drop(second);
    for writer in [Some(first), None] {
        let mut writer =
            writer.unwrap_or_else(|| SequenceWriter::create(&path, &header()).unwrap());
        writer.push(&frames(1)[0]).unwrap();
        writer.finish().unwrap();
        assert_eq!(decode(&path).unwrap().1.len(), 1);
    }
    assert_eq!(hidden().len(), others.len());
    // Names so long that nothing fits in front of or behind them.
    let long = folder.path().join("n".repeat(255));
    let mut writer = SequenceWriter::create(&long, &header()).unwrap();
    writer.push(&frames(1)[0]).unwrap();
    writer.finish().unwrap();
    assert_eq!(decode(&long).unwrap().1.len(), 1);
}

#[test]
fn frames_in_another_order_are_refused_where_they_stand() {
    let folder = TempDir::new().unwrap();
    let sound = fs::read(write(folder.path(), &frames(4))).unwrap();
    let mut messages: Vec<_> = mcap::MessageStream::new(&sound)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    let swapped = folder.path().join("swapped.mcap");
    let mut refused = |a: usize, b: usize, numbered: bool| {
        // The header is the first message.
        messages.swap(1 + a, 1 + b);
        let mut bytes = std::io::Cursor::new(Vec::new());
        let options = mcap::WriteOptions::new().compression(None);
        let mut writer = options.create(&mut bytes).unwrap();
        for (number, message) in messages.iter().enumerate() {
            let mut message = message.clone();
            if numbered {
                (message.sequence, message.log_time) = (number.max(1) as u32 - 1, number as u64);
            }
            writer.write(&message).unwrap();
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        messages.swap(1 + a, 1 + b);
        fs::write(&swapped, bytes.into_inner()).unwrap();
        let reader = SequenceReader::open(&swapped).unwrap();
        (0..4)
            .filter(|&f| reader.frame(f).is_err())
            .collect::<Vec<_>>()
    };
    assert_eq!(refused(0, 0, false), [0; 0]);
    assert_eq!(refused(1, 3, false), [1, 3]);
    assert_eq!(
        refused(1, 3, true),
        [1, 3],
        "renumbered outside, not inside"
    );
    assert_eq!(refused(0, 1, true), [0, 1]);
}

#[test]
fn the_writer_names_frame_garment_and_vertex_of_bad_data_and_goes_on() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    let mut writer = SequenceWriter::create(&path, &header()).unwrap();
    let good = frames(2);
    writer.push(&good[0]).unwrap();
    let mut refused = |change: &dyn Fn(&mut Frame), parts: &[&str]| {
        let mut frame = good[1].clone();
        change(&mut frame);
        let message = writer.push(&frame).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    };
    refused(
        &|f| f.garments[1][2][0] = f32::NAN,
        &["frame 1", "\"outer\"", "vertex 2", "NaN"],
    );
    refused(
        &|f| f.body[1][2] = f32::INFINITY,
        &["frame 1", "body", "vertex 1", "inf"],
    );
    refused(
        &|f| f.garments[0].truncate(3),
        &["\"inner\"", "expected 4", "found 3"],
    );
    refused(
        &|f| f.garments.truncate(1),
        &["garments", "expected 2", "found 1"],
    );
    refused(
        &|f| f.body.push([0.0; 3]),
        &["body", "expected 3", "found 4"],
    );
    refused(
        &|f| f.root.rotation = [0.0; 4],
        &["root rotation", "unit quaternion"],
    );
    refused(&|f| f.wind.strength = -1.0, &["wind strength", "-1"]);
    refused(&|f| f.wind.rotation = [0.0; 4], &["wind rotation"]);
    writer.push(&good[1]).unwrap();
    writer.finish().unwrap();
    assert_eq!(decode(&path).unwrap().1, good);
}

#[test]
fn a_header_that_breaks_a_rule_is_refused_before_anything_is_written() {
    let folder = TempDir::new().unwrap();
    let refused = |change: &dyn Fn(&mut SequenceHeader), parts: &[&str]| {
        let mut header = header();
        change(&mut header);
        let path = folder.path().join("s.mcap");
        let message = SequenceWriter::create(path, &header)
            .err()
            .unwrap()
            .to_string();
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    };
    refused(
        &|h| h.garments[0].faces[1] = [0, 1, 4],
        &["\"inner\"", "face 1", "below 4"],
    );
    refused(
        &|h| h.garments[0].faces[1] = [0, 1, 1],
        &["face 1", "three different"],
    );
    refused(
        &|h| h.garments[1].uv[3][0] = 1.5,
        &["\"outer\"", "UV coordinate 3", "1.5"],
    );
    refused(
        &|h| h.garments[1].uv_faces[0][0] = 9,
        &["uv_faces", "index 9"],
    );
    refused(
        &|h| h.garments[1].panel_of_face[0] = 2,
        &["panel", "index 2"],
    );
    refused(
        &|h| h.garments[1].panel_of_face.truncate(1),
        &["panel_of_face", "expected 2"],
    );
    refused(&|h| h.garments[0].layer = 2, &["layer 1 after layer 2"]);
    refused(&|h| h.garments[0].name = "outer".into(), &["used twice"]);
    refused(&|h| h.garments.clear(), &["at least one garment"]);
    refused(
        &|h| h.garments[0].material.bending = f32::NAN,
        &["bending", "NaN"],
    );
    refused(&|h| h.scene.fps = 0.0, &["fps"]);
    refused(&|h| h.scene.effects.reverse(), &["effects", "order"]);
    refused(&|h| h.body.faces[0] = [0, 1, 3], &["body", "below 3"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn other_files_are_refused_with_their_reason() {
    let folder = TempDir::new().unwrap();
    let message = |bytes: &[u8]| {
        let path = folder.path().join("x.mcap");
        fs::write(&path, bytes).unwrap();
        SequenceReader::open(&path).unwrap_err().to_string()
    };
    assert!(message(b"").contains("empty file"));
    assert!(message(b"# OBJ file\nv 0 0 0\n").contains("expected an MCAP file"));
    assert!(message(&mcap_with("/imu", "sensor.Imu", b"")).contains("topic /drape/header"));
    let other = mcap_with("/drape/header", "other.Header", b"");
    assert!(message(&other).contains("expected drape.SequenceHeader"));
    assert!(
        SequenceReader::open(folder.path().join("none.mcap"))
            .unwrap_err()
            .to_string()
            .contains("cannot open")
    );
}

#[test]
fn a_newer_major_version_is_refused_and_unknown_fields_of_a_minor_one_pass() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    // format_major = 2 and, as field 3, a number where version 1 has a string.
    fs::write(
        &path,
        mcap_with("/drape/header", "drape.SequenceHeader", &[8, 2, 0x18, 1]),
    )
    .unwrap();
    let error = SequenceReader::open(&path).unwrap_err();
    assert!(matches!(error, DatasetError::NewerFormat { .. }), "{error}");
    assert!(
        error.to_string().contains("2.0") && error.to_string().contains("update"),
        "{error}"
    );

    // A sound file whose header gained fields 100 (number) and 101 (string).
    let written = frames(2);
    let sound = fs::read(write(folder.path(), &written)).unwrap();
    let extra = [&[0xa0, 0x06, 5][..], &[0xaa, 0x06, 2, b'h', b'i']].concat();
    fs::write(&path, copy_with(&sound, "/drape/header", &extra)).unwrap();
    assert_eq!(decode(&path).unwrap(), (header(), written));
}

/// An MCAP file with one header-like message and one frame-like message.
fn mcap_with(topic: &str, schema: &str, message: &[u8]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .create(&mut bytes)
        .unwrap();
    for (topic, schema, data) in [
        (topic, schema, message),
        ("/drape/frame", "drape.Frame", b""),
    ] {
        let schema = writer.add_schema(schema, "protobuf", b"").unwrap();
        let channel_id = writer
            .add_channel(schema, topic, "protobuf", &Default::default())
            .unwrap();
        let head = mcap::records::MessageHeader {
            channel_id,
            sequence: 0,
            log_time: 0,
            publish_time: 0,
        };
        writer.write_to_known_channel(&head, data).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// The same file with `extra` bytes behind each message of `topic`.
fn copy_with(source: &[u8], topic: &str, extra: &[u8]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .create(&mut bytes)
        .unwrap();
    for message in mcap::MessageStream::new(source).unwrap() {
        let mut message = message.unwrap();
        if message.channel.topic == topic {
            message.data.to_mut().extend_from_slice(extra);
        }
        writer.write(&message).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

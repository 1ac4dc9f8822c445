//! The conformance files' contents. Each is as small as can still go wrong.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use drape_dataset::SequenceWriter;
use drape_dataset::file::Storage;
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{
    BodyTopology, Frame, Garment, Intersections, Material, Root, SceneMeta, SequenceHeader, Wind,
};
use serde_json::{Value, json};

use super::json;

/// One file and what a reader must find in it.
pub struct Case {
    /// Name of the file, without ending.
    pub name: &'static str,
    /// The file.
    pub bytes: Vec<u8>,
    /// Canonical JSON.
    pub expected: Value,
}

/// Every case, by name.
pub fn all() -> Vec<Case> {
    let small = written(&one_garment(), &[one_garment_frame()]);
    let (header, frames) = (two_layers(), two_layers_frames());
    let large = written(&header, &frames);
    let expected = json::sequence(&header, &frames);
    let case = |name, bytes, expected| Case {
        name,
        bytes,
        expected,
    };
    let (quantised, quantised_json) = quantised();
    let refused = |name, bytes, class: &str| case(name, bytes, json!({ "error": class }));
    vec![
        refused(
            "cut",
            large[..in_the_last_frame(&large)].to_vec(),
            "truncated",
        ),
        case("extended", extended(&large), expected.clone()),
        refused("flipped", flipped(&large), "damaged"),
        refused("newer_major", newer_major(&small), "newer-format"),
        refused("not_finite", not_finite(&small), "invalid"),
        case(
            "one_garment",
            small,
            json::sequence(&one_garment(), &[one_garment_frame()]),
        ),
        case("quantised", quantised, quantised_json),
        case("two_layers", large, expected),
    ]
}

/// The least that a sequence can be: one triangle, one frame, no body, no effects.
pub fn one_garment() -> SequenceHeader {
    SequenceHeader {
        name: "one_garment".into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 25.0,
            seed: 0,
            engine: String::new(),
            engine_version: String::new(),
            effects: Vec::new(),
            gravity: [0.0; 3],
            body_friction: 0.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            rest: Vec::new(),
            faces: Vec::new(),
            vertex_count: 0,
        },
        garments: vec![Garment {
            name: "skirt".into(),
            kind: GarmentKind::Skirt,
            layer: 0,
            rest: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            faces: vec![[0, 1, 2]],
            uv: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
            uv_faces: vec![[0, 1, 2]],
            panel_of_face: vec![0],
            panels: vec!["all".into()],
            material: Material {
                mass: 0.3,
                tension: 20.0,
                compression: 20.0,
                shear: 20.0,
                bending: 20.0,
                friction: 50.0,
            },
        }],
    }
}

/// The frame of [`one_garment`].
pub fn one_garment_frame() -> Frame {
    Frame {
        garments: vec![vec![
            [0.25, 0.0, -1.0],
            [1.25, 0.0, -1.0],
            [0.25, 1.0, MARK],
        ]],
        ..Frame::default()
    }
}

/// A number that stands once in a file, for [`not_finite`].
const MARK: f32 = 1234.567;

/// Every field in use: a body, two layers, a seam, wind that turns on.
pub fn two_layers() -> SequenceHeader {
    let mut header = one_garment();
    header.name = "two_layers – «Ω»".into();
    header.scene = SceneMeta {
        seed: u64::MAX,
        fps: 30.0,
        engine: "conformance".into(),
        engine_version: "1".into(),
        effects: vec![Effect::Gravity, Effect::Wind, Effect::Waistband],
        gravity: [0.0, -0.0, -98.1],
        body_friction: 50.0,
        metres_per_uv: 1.5,
        recipe: "{\"made\": \"by hand\"}".into(),
        warnings: vec!["made up".into(), "not simulated".into()],
        ..header.scene
    };
    header.body = BodyTopology {
        rest: vec![[0.5; 3], [-0.5, 0.5, 0.5], [0.5, -0.5, 0.1]],
        faces: vec![[0, 1, 2]],
        vertex_count: 3,
    };
    let mut inner = header.garments.remove(0);
    inner.material.bending = 150.0;
    let outer = Garment {
        name: "jacket".into(),
        kind: GarmentKind::JacketHood,
        layer: 3,
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
        material: inner.material,
    };
    header.garments = vec![inner, outer];
    header
}

/// Frames of [`two_layers`]: negative zero, the smallest subnormal, the largest f32,
/// a frame that nobody counted.
pub fn two_layers_frames() -> Vec<Frame> {
    (0..3u8)
        .map(|f| {
            let t = f32::from(f) / 3.0;
            Frame {
                body: vec![[t, 0.0, 0.0], [t, 1.0, 0.0], [t, 0.0, 1.0]],
                root: Root {
                    translation: [t, -0.0, 0.1],
                    rotation: [0.6, 0.0, -0.0, 0.8],
                },
                garments: vec![
                    vec![
                        [-0.0, f32::from_bits(1), t],
                        [f32::MAX, 0.1, t],
                        [1e-3, t, t],
                    ],
                    vec![[t, 2.0, 0.0], [t, 2.0, 1.0], [t, 3.0, 0.0], [t, 3.0, 1.0]],
                ],
                wind: match f {
                    0 => Wind::default(),
                    _ => Wind {
                        rotation: [0.0, 1.0, 0.0, 0.0],
                        strength: 100.0 * f32::from(f),
                    },
                },
                intersections: (f != 1).then_some(Intersections {
                    between_garments: u32::from(f),
                    within_garments: 0,
                    with_body: u32::MAX,
                }),
            }
        })
        .collect()
}

/// The file that [`SequenceWriter`] makes.
pub fn written(header: &SequenceHeader, frames: &[Frame]) -> Vec<u8> {
    written_as(Storage::Exact, header, frames)
}

/// The file that [`SequenceWriter`] makes with a storage.
pub fn written_as(storage: Storage, header: &SequenceHeader, frames: &[Frame]) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("case.mcap");
    let mut writer = SequenceWriter::create_with(&path, header, storage).expect("a sound header");
    for frame in frames {
        writer.push(frame).expect("a sound frame");
    }
    writer.finish().expect("a written file");
    std::fs::read(path).expect("a file")
}

/// The same file with each message's bytes changed by `edit(topic, bytes)`.
pub fn edited(source: &[u8], mut edit: impl FnMut(&str, &mut Vec<u8>)) -> Vec<u8> {
    rewritten(|writer| {
        for message in mcap::MessageStream::new(source).expect("an MCAP file") {
            let mut message = message.expect("a message");
            let mut data = message.data.into_owned();
            edit(&message.channel.topic, &mut data);
            message.data = Cow::Owned(data);
            writer.write(&message).expect("memory");
            writer.flush().expect("memory");
        }
    })
}

fn rewritten(fill: impl FnOnce(&mut mcap::Writer<&mut Cursor<Vec<u8>>>)) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().profile("drape");
    let options = options.library("drape conformance").compression(None);
    let mut writer = options.create(&mut bytes).expect("memory");
    fill(&mut writer);
    writer.finish().expect("memory");
    drop(writer);
    bytes.into_inner()
}

/// What a later minor version and other programs may add: a higher minor, fields
/// that nobody knows, a channel, metadata and an attachment of one's own.
fn extended(source: &[u8]) -> Vec<u8> {
    rewritten(|writer| {
        let imu = Arc::new(mcap::Channel {
            id: 77,
            topic: "/other/imu".into(),
            schema: None,
            message_encoding: "json".into(),
            metadata: BTreeMap::new(),
        });
        for message in mcap::MessageStream::new(source).expect("an MCAP file") {
            let mut message = message.expect("a message");
            // Fields 100 (a number) and 10000 (a string); the last of two
            // `format_minor` counts.
            let mut added = vec![0xa0, 0x06, 5, 0x82, 0xf1, 0x04, 2, b'h', b'i'];
            if message.channel.topic == "/drape/header" {
                added.extend([0x10, 7]);
            }
            message.data.to_mut().extend(added);
            writer.write(&message).expect("memory");
            writer.flush().expect("memory");
            message.channel = Arc::clone(&imu);
            message.data = Cow::Borrowed(b"{}");
            writer.write(&message).expect("memory");
            writer.flush().expect("memory");
        }
        let note = BTreeMap::from([("by".to_owned(), "somebody".to_owned())]);
        let metadata = mcap::records::Metadata {
            name: "other".into(),
            metadata: note,
        };
        writer.write_metadata(&metadata).expect("memory");
        let attachment = mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: "readme.txt".into(),
            media_type: "text/plain".into(),
            data: Cow::Borrowed(b"hello"),
        };
        writer.attach(&attachment).expect("memory");
    })
}

/// Major version 2, with a number where version 1 has the name.
fn newer_major(source: &[u8]) -> Vec<u8> {
    edited(source, |topic, data| {
        if topic == "/drape/header" {
            *data = vec![8, 2, 0x18, 1];
        }
    })
}

/// NaN in place of [`MARK`], under sound checksums.
fn not_finite(source: &[u8]) -> Vec<u8> {
    edited(source, |_, data| {
        if let Some(at) = data.windows(4).position(|four| four == MARK.to_le_bytes()) {
            data[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        }
    })
}

/// 20 frames on a grid of quarters, so that positions between them are their exact
/// selves again: key frames, differences, numbers of one and of two bytes.
fn quantised() -> (Vec<u8>, Value) {
    let header = two_layers();
    // The step is 2 · error · scale / √3 · 0.99.
    let storage = Storage::Quantised {
        max_error_m: 0.25 * 3f32.sqrt() / 2.0 / 0.99 / header.scene.scale,
    };
    let frames: Vec<Frame> = (0..20u8)
        .map(|f| {
            let t = f32::from(f);
            let mut frame = two_layers_frames().remove(usize::from(f % 3));
            frame.body = vec![[t, 0.0, 0.25], [t, 300.0, 0.0], [t, 0.0, -1.5 * t]];
            let inner = vec![[-0.25, t, 0.5], [0.0, 0.25, t], [1.0, t, t]];
            let outer = vec![[t, 2.0, 0.0], [t, 2.0, 1.0], [t, 3.0, 0.0], [t, 3.0, 1.0]];
            frame.garments = vec![inner, outer];
            frame
        })
        .collect();
    let bytes = written_as(storage, &header, &frames);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("case.mcap");
    std::fs::write(&path, &bytes).expect("a written file");
    let reader = drape_dataset::SequenceReader::open(&path).expect("a sound file");
    let found = reader.read_all().expect("sound frames");
    (bytes, json::sequence(&header, &found))
}

/// One bit of the last frame's positions changed.
fn flipped(source: &[u8]) -> Vec<u8> {
    let mut bytes = source.to_vec();
    bytes[in_the_last_frame(source)] ^= 0x10;
    bytes
}

/// A place in the last frame's positions.
fn in_the_last_frame(source: &[u8]) -> usize {
    let largest = f32::MAX.to_le_bytes();
    let at = source.windows(4).rposition(|four| four == largest);
    at.expect("the frame holds it")
}

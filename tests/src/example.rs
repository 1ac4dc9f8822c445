//! A small dressed body for tests: a tube that sways, a T-shirt and a jacket of
//! larger tubes that follow it a little late. Not cloth, but everything that a
//! sequence file holds.

use std::path::Path;

use drape_dataset::{
    DatasetError, SequenceWriter,
    registry::{Effect, GarmentKind},
    sequence::{BodyTopology, Frame, Garment, Material, Root, SceneMeta, SequenceHeader},
    splits::{DatasetIndex, Split},
};

/// Columns around each tube.
const AROUND: u32 = 16;
/// Units between rings.
const RING: f32 = 0.5;
/// Frames of a sequence.
pub const FRAMES: usize = 16;

/// Writes a data set with sequences of the given splits, `sequence_0`, `sequence_1`, …
///
/// # Errors
/// When the folder cannot be written.
pub fn write_dataset(folder: &Path, splits: &[Split]) -> Result<(), DatasetError> {
    let mut index = DatasetIndex::new(folder, "example");
    for (number, split) in splits.iter().enumerate() {
        let name = format!("sequence_{number}");
        let file = format!("{name}.mcap");
        write_sequence(&folder.join(&file), &name, number as f32)?;
        index.add(file, *split)?;
    }
    index.save()
}

/// Writes one sequence; `phase` tells the movements of sequences apart.
///
/// # Errors
/// When the file cannot be written.
pub fn write_sequence(path: &Path, name: &str, phase: f32) -> Result<(), DatasetError> {
    let header = header(name);
    let mut writer = SequenceWriter::create(path, &header)?;
    for frame in 0..FRAMES {
        let sway = |late: f32| {
            [
                0.3 * (0.4 * (frame as f32 - late) + phase).sin(),
                0.05 * frame as f32,
                0.0,
            ]
        };
        let moved = |points: &[[f32; 3]], late: f32| -> Vec<[f32; 3]> {
            let by = sway(late);
            points
                .iter()
                .map(|p| [p[0] + by[0], p[1] + by[1], p[2]])
                .collect()
        };
        writer.push(&Frame {
            body: moved(&header.body.rest, 0.0),
            root: Root {
                translation: sway(0.0),
                ..Root::default()
            },
            garments: header
                .garments
                .iter()
                .map(|garment| moved(&garment.rest, 0.5))
                .collect(),
            ..Frame::default()
        })?;
    }
    writer.finish()
}

fn header(name: &str) -> SequenceHeader {
    let body = tube(1.0, 10);
    SequenceHeader {
        name: name.to_owned(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: "test".to_owned(),
            engine_version: "0".to_owned(),
            effects: vec![Effect::Gravity, Effect::BodyContact, Effect::LayerContact],
            gravity: [0.0, 0.0, -98.1],
            body_friction: 60.0,
            metres_per_uv: 2.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            vertex_count: body.rest.len(),
            rest: body.rest,
            faces: body.faces,
        },
        garments: vec![
            garment("shirt", GarmentKind::TShirt, 0, tube(1.3, 6)),
            garment("jacket", GarmentKind::Jacket, 1, tube(1.6, 6)),
        ],
    }
}

fn garment(name: &str, kind: GarmentKind, layer: u32, tube: Tube) -> Garment {
    Garment {
        name: name.to_owned(),
        kind,
        layer,
        panel_of_face: vec![0; tube.faces.len()],
        rest: tube.rest,
        faces: tube.faces,
        uv: tube.uv,
        uv_faces: tube.uv_faces,
        panels: vec!["around".to_owned()],
        material: Material {
            mass: 0.5,
            tension: 50.0,
            compression: 50.0,
            shear: 50.0,
            bending: 20.0 + 10.0 * layer as f32,
            friction: 60.0,
        },
    }
}

/// An open tube around Z with outward normals, cut along one line in UV space.
struct Tube {
    rest: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
    uv: Vec<[f32; 2]>,
    uv_faces: Vec<[u32; 3]>,
}

fn tube(radius: f32, rings: u32) -> Tube {
    let angle = |column: u32| std::f32::consts::TAU * column as f32 / AROUND as f32;
    let rest = (0..rings)
        .flat_map(|ring| {
            (0..AROUND).map(move |column| {
                [
                    radius * angle(column).cos(),
                    radius * angle(column).sin(),
                    RING * ring as f32,
                ]
            })
        })
        .collect();
    // 20 units are 2 m, one UV unit.
    let uv = (0..rings)
        .flat_map(|ring| {
            (0..=AROUND)
                .map(move |column| [radius * angle(column) / 20.0, RING * ring as f32 / 20.0])
        })
        .collect();
    let quads = |stride: u32, closed: bool| -> Vec<[u32; 3]> {
        (0..rings - 1)
            .flat_map(|ring| {
                (0..AROUND).flat_map(move |column| {
                    let next = if closed {
                        (column + 1) % AROUND
                    } else {
                        column + 1
                    };
                    let [a, b] = [column, next].map(|column| ring * stride + column);
                    [[a, b, b + stride], [a, b + stride, a + stride]]
                })
            })
            .collect()
    };
    Tube {
        rest,
        faces: quads(AROUND, true),
        uv,
        uv_faces: quads(AROUND + 1, false),
    }
}

//! What the examples play with: a square of cloth that swings.

use std::path::Path;

use drape_dataset::file::Storage;
use drape_dataset::obj::GarmentMesh;
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{BodyTopology, Frame, Material, SceneMeta, SequenceHeader};
use drape_dataset::{Result, SequenceWriter};

/// Writes a sequence of `count` frames.
pub fn write(path: &Path, count: usize, storage: Storage) -> Result<()> {
    let (mut obj, n) = (String::new(), 20);
    for (i, j) in (0..n * n).map(|at| (at / n, at % n)) {
        let [x, y] = [i, j].map(|at| at as f32 / (n - 1) as f32);
        obj += &format!("v {} 0 {}\nvt {x} {y}\n", 10.0 * x, 10.0 + 10.0 * y);
        if i > 0 && j > 0 {
            let [a, b, c, d] =
                [(i - 1, j - 1), (i, j - 1), (i, j), (i - 1, j)].map(|(i, j)| i * n + j + 1);
            obj += &format!("f {a}/{a} {b}/{b} {c}/{c}\nf {a}/{a} {c}/{c} {d}/{d}\n");
        }
    }
    let material = Material {
        mass: 0.3,
        tension: 40.0,
        compression: 40.0,
        shear: 40.0,
        bending: 30.0,
        friction: 50.0,
    };
    let garment = GarmentMesh::parse(&obj)?.into_garment("square", GarmentKind::Skirt, 0, material);
    let rest = garment.rest.clone();
    let header = SequenceHeader {
        name: "swing".into(),
        scene: SceneMeta::default(),
        body: BodyTopology::default(),
        garments: vec![garment],
    };
    let mut writer = SequenceWriter::create_with(path, &header, storage)?;
    for f in 0..count {
        let swing = |x: &[f32; 3]| {
            let sway = (f as f32 / 5.0 + x[2] / 3.0).sin();
            [x[0], x[1] + sway, x[2]]
        };
        let garments = vec![rest.iter().map(swing).collect()];
        writer.push(&Frame {
            garments,
            ..Frame::default()
        })?;
    }
    writer.finish()
}

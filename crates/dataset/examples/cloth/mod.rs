//! What the examples play with: a square of cloth that swings.

use std::path::Path;

use drape_dataset::file::Storage;
use drape_dataset::obj::GarmentMesh;
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{BodyTopology, Frame, Material, SceneMeta, SequenceHeader};
use drape_dataset::{Result, SequenceWriter};

/// Writes a sequence of `count` frames.
pub fn write(path: &Path, count: usize, storage: Storage) -> Result<()> {
    let obj = "v 0 0 10\nv 10 0 10\nv 10 0 20\nv 0 0 20\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
               f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
    let material = Material {
        mass: 0.3,
        tension: 40.0,
        compression: 40.0,
        shear: 40.0,
        bending: 30.0,
        friction: 50.0,
    };
    let garment = GarmentMesh::parse(obj)?.into_garment("square", GarmentKind::Skirt, 0, material);
    let rest = garment.rest.clone();
    let header = SequenceHeader {
        name: "swing".into(),
        scene: SceneMeta::default(),
        body: BodyTopology::default(),
        garments: vec![garment],
    };
    let mut writer = SequenceWriter::create_with(path, &header, storage)?;
    for f in 0..count {
        let sway = (f as f32 / 5.0).sin();
        let garments = vec![rest.iter().map(|x| [x[0], x[1] + sway, x[2]]).collect()];
        writer.push(&Frame {
            garments,
            ..Frame::default()
        })?;
    }
    writer.finish()
}

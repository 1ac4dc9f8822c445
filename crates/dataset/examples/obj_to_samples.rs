//! From an OBJ file to the samples that a learned method trains on.

use std::error::Error;

use drape_dataset::SequenceWriter;
use drape_dataset::obj::GarmentMesh;
use drape_dataset::registry::GarmentKind;
use drape_dataset::samples::{SampleOptions, Samples};
use drape_dataset::sequence::{BodyTopology, Frame, Material, SceneMeta, SequenceHeader};
use drape_dataset::splits::{DatasetIndex, Split};

/// A square of 1 m in units of 0.1 m, hanging at 1 to 2 m above the ground.
const OBJ: &str =
    "v 0 0 10\nv 10 0 10\nv 10 0 20\nv 0 0 20\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    // 1. A garment: the mesh, and what an OBJ file cannot tell.
    let mesh = GarmentMesh::parse(OBJ)?;
    for note in &mesh.notes {
        println!("note: {note}");
    }
    let material = Material {
        mass: 0.3,
        tension: 40.0,
        compression: 40.0,
        shear: 40.0,
        bending: 30.0,
        friction: 50.0,
    };
    let skirt = mesh.into_garment("square", GarmentKind::Skirt, 0, material);
    let header = SequenceHeader {
        name: "swing".into(),
        scene: SceneMeta::default(),
        body: BodyTopology::default(),
        garments: vec![skirt],
    };

    // 2. A sequence: one frame after the other.
    let folder = tempfile::tempdir()?;
    let mut writer = SequenceWriter::create(folder.path().join("swing.mcap"), &header)?;
    for f in 0..20 {
        let sway = (f as f32 / 5.0).sin();
        let positions = header.garments[0]
            .rest
            .iter()
            .map(|x| [x[0], x[1] + sway, x[2]]);
        let garments = vec![positions.collect()];
        writer.push(&Frame {
            garments,
            ..Frame::default()
        })?;
    }
    writer.finish()?;

    // 3. A data set, and samples of it: patches of half a metre, two steps each.
    let mut index = DatasetIndex::new(folder.path(), "one swing");
    index.add("swing.mcap", Split::Train)?;
    index.save()?;
    let options = SampleOptions {
        patch_size_m: 0.5,
        steps: 2,
        seed: 1,
    };
    for sample in Samples::open(&index, Split::Train, options)?.take(3) {
        let sample = sample?;
        let (vertices, patches) = (sample.state.len(), sample.outfit.patches.count());
        println!(
            "{vertices} vertices in {patches} patches, {} steps",
            sample.steps.len()
        );
    }
    Ok(())
}

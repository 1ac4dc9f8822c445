//! A data set folder: what its index promises is there, whole and in its split.

use std::fs;
use std::path::Path;

use drape_dataset::SequenceWriter;
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::{BodyTopology, Frame, Garment, Material, SceneMeta, SequenceHeader};
use drape_dataset::splits::{DatasetIndex, INDEX_FILE, Split};
use tempfile::TempDir;

fn write_sequence(folder: &Path, name: &str, frames: usize) {
    let header = SequenceHeader {
        name: name.into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 1,
            engine: "test".into(),
            engine_version: "1".into(),
            effects: vec![],
            gravity: [0.0; 3],
            body_friction: 0.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: vec![],
        },
        body: BodyTopology {
            rest: vec![],
            faces: vec![],
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
    };
    let mut writer = SequenceWriter::create(folder.join(format!("{name}.mcap")), &header).unwrap();
    for _ in 0..frames {
        writer
            .push(&Frame {
                garments: vec![vec![[0.0; 3]; 3]],
                ..Frame::default()
            })
            .unwrap();
    }
    writer.finish().unwrap();
}

fn data_set() -> (TempDir, DatasetIndex) {
    let folder = TempDir::new().unwrap();
    let mut index = DatasetIndex::new(folder.path(), "tiny");
    for (name, frames, split) in [
        ("a", 1, Split::Train),
        ("b", 2, Split::Train),
        ("c", 3, Split::Test),
    ] {
        write_sequence(folder.path(), name, frames);
        index.add(format!("{name}.mcap"), split).unwrap();
    }
    index.save().unwrap();
    (folder, index)
}

#[test]
fn an_index_comes_back_and_opens_its_sequences() {
    let (folder, saved) = data_set();
    let index = DatasetIndex::load(folder.path()).unwrap();
    assert_eq!(index, saved);
    index.verify().unwrap();
    let train = index.split(Split::Train).unwrap();
    assert_eq!(
        train.iter().map(|entry| entry.frames).collect::<Vec<_>>(),
        [1, 2]
    );
    let test = index.split(Split::Test).unwrap();
    assert_eq!(index.open(test[0]).unwrap().frame_count(), 3);
    assert_eq!(test[0].garments, [GarmentKind::Skirt]);
}

#[test]
fn the_data_hash_names_the_contents_and_not_their_order() {
    let (folder, index) = data_set();
    let mut shuffled = DatasetIndex::new(folder.path(), "other name");
    for name in ["c.mcap", "a.mcap", "b.mcap", "a.mcap"] {
        shuffled.add(name, Split::Val).unwrap();
    }
    assert_eq!(shuffled.sequences().len(), 3, "listed anew, not twice");
    assert_eq!(shuffled.data_hash(), index.data_hash());
    write_sequence(folder.path(), "a", 2);
    assert!(index.verify().unwrap_err().to_string().contains("a.mcap"));
    shuffled.add("a.mcap", Split::Train).unwrap();
    assert_ne!(shuffled.data_hash(), index.data_hash());
}

#[test]
fn a_faulty_index_says_what_is_wrong() {
    let (folder, index) = data_set();
    let path = folder.path().join(INDEX_FILE);
    let sound = fs::read_to_string(&path).unwrap();
    let after = |from: &str, to: &str| {
        assert!(sound.contains(from), "{from}");
        fs::write(&path, sound.replacen(from, to, 1)).unwrap();
        DatasetIndex::load(folder.path()).unwrap_err().to_string()
    };
    let message = index.split(Split::Val).unwrap_err().to_string();
    assert!(
        message.contains("split val") && message.contains("train: 2"),
        "{message}"
    );
    let message = after("\"train\"", "\"dev\"");
    assert!(
        message.contains("dev") && message.contains("`val`"),
        "{message}"
    );
    let message = after("\"skirt\"", "\"cape\"");
    assert!(
        message.contains("cape") && message.contains("jacket-hood"),
        "{message}"
    );
    assert!(after("a.mcap", "gone.mcap").contains("no such file"));
    assert!(after("a.mcap", "b.mcap").contains("listed twice"));
    assert!(after("a.mcap", "../a.mcap").contains("without folders"));
    assert!(after("1,\n    0", "2,\n    0").contains("newer"));
    assert!(after("{", "").contains("JSON"));
    let message = "dev".parse::<Split>().unwrap_err().to_string();
    assert!(message.contains("train val test"), "{message}");
    let nowhere = DatasetIndex::load(folder.path().join("none"))
        .unwrap_err()
        .to_string();
    assert!(nowhere.contains("cannot read"), "{nowhere}");
}

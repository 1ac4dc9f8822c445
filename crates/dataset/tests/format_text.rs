//! Text, schema and code of the format say the same, and a file carries its
//! own schema.

use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{BodyTopology, Frame, Garment, Material, SceneMeta, SequenceHeader};
use drape_dataset::{SequenceWriter, file};
use prost_reflect::{DescriptorPool, DynamicMessage};
use tempfile::TempDir;

const TEXT: &str = include_str!("../../../data-spec/README.md");

fn written_file() -> Vec<u8> {
    let header = SequenceHeader {
        name: "s".into(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 25.0,
            seed: 1,
            engine: "test".into(),
            engine_version: "1".into(),
            effects: vec![Effect::Wind],
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
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    let mut writer = SequenceWriter::create(&path, &header).unwrap();
    for _ in 0..2 {
        let garments = vec![vec![[0.25, 0.0, -1.0]; 3]];
        writer
            .push(&Frame {
                garments,
                ..Frame::default()
            })
            .unwrap();
    }
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn any_mcap_reader_can_decode_a_file_by_the_schema_it_carries() {
    let bytes = written_file();
    let messages: Vec<_> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    assert_eq!(messages.len(), 3);
    let decode = |message: &mcap::Message| {
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(
            (schema.encoding.as_str(), &*message.channel.message_encoding),
            ("protobuf", "protobuf")
        );
        let pool = DescriptorPool::decode(&schema.data[..]).unwrap();
        let descriptor = pool.get_message_by_name(&schema.name).unwrap();
        DynamicMessage::decode(descriptor, &message.data[..]).unwrap()
    };
    let header = decode(&messages[0]);
    let version = header.get_field_by_name("format_major").unwrap().as_u32();
    assert_eq!(version, Some(file::FORMAT_MAJOR));
    let frame = decode(&messages[2]);
    assert_eq!(messages[2].log_time, 40_000_000, "25 frames per second");
    assert_eq!(frame.get_field_by_name("index").unwrap().as_u64(), Some(1));
    let garments = frame.get_field_by_name("garments").unwrap().into_owned();
    let positions = garments.as_list().unwrap()[0].as_bytes().unwrap().clone();
    assert_eq!(positions.len(), 3 * 3 * 4);
    assert_eq!(positions[..4], 0.25f32.to_le_bytes());
    assert_eq!(positions[8..12], (-1.0f32).to_le_bytes());
}

#[test]
fn the_text_describes_every_field_of_the_schema_and_no_other() {
    let bytes = written_file();
    let message = mcap::MessageStream::new(&bytes)
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let schema = message.channel.schema.as_ref().unwrap().data.clone();
    let pool = DescriptorPool::decode(&schema[..]).unwrap();
    let mut sections = 0;
    for descriptor in pool.all_messages() {
        let title = format!("### `{}`\n", descriptor.name());
        let section = TEXT
            .split(&title)
            .nth(1)
            .unwrap_or_else(|| panic!("no section {title}"));
        let section = section.split("\n##").next().unwrap();
        let described: Vec<_> = section
            .lines()
            .filter_map(|line| line.strip_prefix("| `")?.split('`').next())
            .collect();
        let fields: Vec<_> = descriptor
            .fields()
            .map(|field| field.name().to_owned())
            .collect();
        assert_eq!(described, fields, "fields of {}", descriptor.name());
        sections += 1;
    }
    assert_eq!(TEXT.matches("### `").count(), sections);
}

#[test]
fn the_text_lists_the_registries_in_order() {
    let table = TEXT
        .split("## Registries")
        .nth(1)
        .unwrap()
        .split("\n## ")
        .next()
        .unwrap();
    let column = |n: usize| -> Vec<&str> {
        table
            .lines()
            .filter_map(|line| {
                line.split('|')
                    .nth(n)?
                    .trim()
                    .strip_prefix('`')?
                    .strip_suffix('`')
            })
            .collect()
    };
    let kinds: Vec<_> = GarmentKind::ALL.iter().map(|kind| kind.name()).collect();
    let effects: Vec<_> = Effect::ALL.iter().map(|effect| effect.name()).collect();
    assert_eq!((column(1), column(3)), (kinds, effects));
    let version = format!("version {}.{}", file::FORMAT_MAJOR, file::FORMAT_MINOR);
    assert!(TEXT.contains(&version), "{version}");
}

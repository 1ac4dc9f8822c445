//! Text, schema and code of the format say the same, and a file carries its
//! own schema.

#[path = "../examples/conformance/cases.rs"]
#[allow(dead_code)]
mod cases;
#[path = "../examples/conformance/json.rs"]
#[allow(dead_code)]
mod json;

use std::collections::BTreeSet;

use drape_dataset::file::{self, Storage};
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sample::{ATTRIBUTE_RANGES, WIND_STRENGTH_SCALE};
use drape_dataset::splits::Split;
use prost_reflect::{Cardinality, DescriptorPool, DynamicMessage, FieldDescriptor, Kind};

const TEXT: &str = include_str!("../../../data-spec/README.md");
const REGISTRY: &str = include_str!("../../../data-spec/registry.md");

fn written_file() -> Vec<u8> {
    let frame = cases::one_garment_frame();
    cases::written(&cases::one_garment(), &[frame.clone(), frame])
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

/// Every schema that files carry: exact frames', quantised frames'.
fn schemas() -> [DescriptorPool; 2] {
    [Storage::Exact, Storage::VIEWING].map(|storage| {
        let frame = cases::one_garment_frame();
        let bytes = cases::written_as(storage, &cases::one_garment(), &[frame]);
        let message = mcap::MessageStream::new(&bytes).unwrap().last().unwrap();
        let schema = message.unwrap().channel.schema.clone().unwrap();
        DescriptorPool::decode(&schema.data[..]).unwrap()
    })
}

#[test]
fn every_message_has_a_table_and_every_table_a_message() {
    let mut sections = BTreeSet::new();
    for descriptor in schemas().iter().flat_map(DescriptorPool::all_messages) {
        let name = descriptor.name().to_owned();
        let rows = rows_under(TEXT, &format!("### `{name}`\n"));
        let mut fields: Vec<_> = descriptor.fields().collect();
        fields.sort_by_key(FieldDescriptor::number);
        assert_eq!(rows.len(), fields.len(), "rows of {name}");
        for (row, field) in rows.iter().zip(&fields) {
            check_row(&name, row, field);
        }
        sections.insert(name);
    }
    assert_eq!(TEXT.matches("### `").count(), sections.len());
}

/// One field's row: `number | name | type | unit | meaning | rule`.
fn check_row(message: &str, row: &[String], field: &FieldDescriptor) {
    let place = format!("{message}.{}", field.name());
    let [number, name, kind, unit, meaning, rule] = row else {
        panic!("{place}: six columns, found {row:?}");
    };
    assert_eq!(number, &field.number().to_string(), "{place}: number");
    assert_eq!(name, &format!("`{}`", field.name()), "{place}: name");
    let repeated = field.cardinality() == Cardinality::Repeated;
    let element = match field.kind() {
        Kind::Message(message) => message.name().to_owned(),
        scalar => format!("{scalar:?}").to_lowercase(),
    };
    let declared = format!("{}{element}", if repeated { "repeated " } else { "" });
    let rest = kind.strip_prefix(&declared);
    let shape = rest.unwrap_or_else(|| panic!("{place}: {declared} in the schema, {kind} here"));
    let number = matches!(field.kind(), Kind::Float | Kind::Sint32);
    if matches!(field.kind(), Kind::Bytes) || (repeated && number) {
        assert!(shape.ends_with(']'), "{place}: {kind} must tell its shape");
    } else {
        assert_eq!(shape, "", "{place}: type");
    }
    if shape.contains("f32 [v") {
        assert_eq!(unit, "units", "{place}: positions have a unit");
    }
    assert!(!meaning.is_empty(), "{place}: no meaning");
    let keyed = ["MUST", "SHOULD"].iter().any(|word| rule.contains(word));
    assert!(keyed, "{place}: the rule says neither MUST nor SHOULD");
}

#[test]
fn the_registries_are_the_codes_in_its_order() {
    let listed = |title: &str| -> Vec<(String, String)> {
        rows_under(REGISTRY, &format!("## {title}\n"))
            .into_iter()
            .map(|row| (row[0].trim_matches('`').to_owned(), row[1].clone()))
            .collect()
    };
    let kinds = GarmentKind::ALL.iter();
    let kinds: Vec<_> = kinds.map(|k| (k.name().into(), k.to_string())).collect();
    assert_eq!(listed("Garment kinds"), kinds);
    let effects = Effect::ALL.iter();
    let effects: Vec<_> = effects.map(|e| (e.name().into(), e.to_string())).collect();
    assert_eq!(listed("Effects"), effects);
    let splits: Vec<_> = listed("Splits").into_iter().map(|row| row.0).collect();
    let names: Vec<_> = Split::ALL.iter().map(|split| split.name()).collect();
    assert_eq!(splits, names);
}

#[test]
fn the_material_attributes_are_the_schemas_and_their_ranges_those_of_samples() {
    let rows = rows_under(REGISTRY, "## Material attributes\n");
    let pool = &schemas()[0];
    let mut fields = BTreeSet::from(["Scene.body_friction".to_owned()]);
    let material = pool.get_message_by_name("drape.Material").unwrap();
    fields.extend(
        material
            .fields()
            .map(|field| format!("Material.{}", field.name())),
    );
    let named: BTreeSet<_> = rows
        .iter()
        .map(|row| row[1].trim_matches('`').to_owned())
        .collect();
    assert_eq!(named, fields);
    let ranged: Vec<_> = rows.iter().filter(|row| row[2] != "–").collect();
    assert_eq!(ranged.len(), ATTRIBUTE_RANGES.len());
    for (row, (name, low, high)) in ranged.into_iter().zip(ATTRIBUTE_RANGES) {
        let written = (row[0].trim_matches('`'), &*row[2], &*row[3]);
        assert_eq!(written, (name, &*low.to_string(), &*high.to_string()));
    }
    let wind = format!("Wind strength is divided by {WIND_STRENGTH_SCALE}.");
    assert!(REGISTRY.contains(&wind), "{wind}");
}

#[test]
fn the_text_tells_the_version_that_the_crate_reads() {
    let version = format!("version {}.{}", file::FORMAT_MAJOR, file::FORMAT_MINOR);
    assert!(
        TEXT.lines().next().unwrap().ends_with(&version),
        "{version}"
    );
}

/// Cells of the table under a heading, without its head.
fn rows_under(text: &str, heading: &str) -> Vec<Vec<String>> {
    let section = text.split(heading).nth(1);
    let section = section.unwrap_or_else(|| panic!("no section {heading}"));
    let lines = section.lines().take_while(|line| !line.starts_with('#'));
    let cells = |line: &str| -> Option<Vec<String>> {
        let inner = line.strip_prefix('|')?.strip_suffix('|')?;
        Some(
            inner
                .split('|')
                .map(|cell| cell.trim().to_owned())
                .collect(),
        )
    };
    lines.filter_map(cells).skip(2).collect()
}

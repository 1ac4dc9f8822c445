//! The conformance files of the format: the program still makes them, our reader
//! finds what their JSON says, and so does a reader that knows only the schema that
//! a file carries.

#[path = "../examples/conformance/cases.rs"]
#[allow(dead_code)]
mod cases;
#[path = "../examples/conformance/json.rs"]
mod json;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use drape_dataset::{DatasetError, SequenceReader};
use prost_reflect::{DescriptorPool, DynamicMessage, Value as Field};
use serde_json::Value;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-spec/conformance")
}

/// What our reader finds in a file.
fn read(path: &Path) -> Value {
    let sequence = SequenceReader::open(path).and_then(|reader| {
        let frames = reader.read_all()?;
        Ok(json::sequence(reader.header(), &frames))
    });
    sequence.unwrap_or_else(|error| refusal(&error))
}

/// Why a file is refused.
fn refusal(error: &DatasetError) -> Value {
    let class = match error {
        DatasetError::InFile { fault, .. } => return refusal(fault),
        DatasetError::NotASequence { .. } => "not-a-sequence",
        DatasetError::Truncated { .. } => "truncated",
        DatasetError::Corrupt { .. } => "damaged",
        DatasetError::NewerFormat { .. } => "newer-format",
        DatasetError::Invalid { .. } => "invalid",
        other => panic!("no class for {other}"),
    };
    serde_json::json!({ "error": class })
}

fn expected(path: &Path) -> Value {
    let text = fs::read_to_string(path.with_extension("json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn the_folder_holds_what_the_program_makes_and_nothing_else() {
    let mut names = BTreeSet::from(["README.md".to_owned()]);
    for case in cases::all() {
        let path = folder().join(case.name).with_extension("mcap");
        assert!(
            fs::read(&path).unwrap() == case.bytes,
            "{} differs",
            path.display()
        );
        assert_eq!(
            fs::read_to_string(path.with_extension("json")).unwrap(),
            json::text(&case.expected)
        );
        names.extend(["mcap", "json"].map(|ending| format!("{}.{ending}", case.name)));
    }
    let there = fs::read_dir(folder()).unwrap();
    let there: BTreeSet<_> = there
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(there, names);
    let text = fs::read_to_string(folder().join("README.md")).unwrap();
    for case in cases::all() {
        assert!(
            text.contains(&format!("| `{}` |", case.name)),
            "{}",
            case.name
        );
    }
}

#[test]
fn our_reader_finds_what_the_json_says() {
    for case in cases::all() {
        let path = folder().join(case.name).with_extension("mcap");
        // As text: serde_json reads decimals to within an ulp only.
        let text = fs::read_to_string(path.with_extension("json")).unwrap();
        assert_eq!(json::text(&read(&path)), text, "{}", case.name);
    }
}

#[test]
fn a_reader_that_knows_only_the_files_own_schema_finds_the_same() {
    let mut compared = 0;
    for case in cases::all() {
        let path = folder().join(case.name).with_extension("mcap");
        let expected = expected(&path);
        // The grid is not in the schema.
        if expected.get("error").is_some() || case.name == "quantised" {
            continue;
        }
        let bytes = fs::read(&path).unwrap();
        let mut frames = expected["frames"].as_array().unwrap().iter();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            let json = match &*message.channel.topic {
                "/drape/header" => &expected["header"],
                "/drape/frame" => frames.next().unwrap(),
                _ => continue,
            };
            let schema = message.channel.schema.as_ref().unwrap();
            let pool = DescriptorPool::decode(&schema.data[..]).unwrap();
            let descriptor = pool.get_message_by_name(&schema.name).unwrap();
            let found = DynamicMessage::decode(descriptor, &message.data[..]).unwrap();
            compared += compare(case.name, json, &found);
        }
        assert!(frames.next().is_none(), "{}: a frame is missing", case.name);
    }
    assert!(compared > 100, "{compared} values were compared");
}

/// Compares every key of `json` with the field of that name; how many values there were.
fn compare(place: &str, json: &Value, message: &DynamicMessage) -> usize {
    let mut compared = 0;
    for (key, value) in json.as_object().unwrap() {
        let place = format!("{place}.{key}");
        let field = message.get_field_by_name(key).expect(&place).into_owned();
        let absent = !message.has_field_by_name(key) && matches!(field, Field::Message(_));
        if value.is_null() || absent {
            assert!(absent && value.is_null(), "{place}: {value}, {field:?}");
            continue;
        }
        compared += compare_value(&place, value, &field);
    }
    compared
}

fn compare_value(place: &str, json: &Value, field: &Field) -> usize {
    match (json, field) {
        (Value::Object(_), Field::Message(message)) => return compare(place, json, message),
        (Value::Array(items), Field::List(fields)) => {
            assert_eq!(items.len(), fields.len(), "{place}");
            let pairs = items.iter().zip(fields);
            return pairs
                .map(|(json, field)| compare_value(place, json, field))
                .sum();
        }
        // Rows of four-byte numbers, whose kind the text tells: any table of faces or panels is u32.
        (Value::Array(_), Field::Bytes(bytes)) => {
            let mut leaves = Vec::new();
            flatten(json, &mut leaves);
            let words: Vec<[u8; 4]> = bytes.chunks(4).map(|w| w.try_into().unwrap()).collect();
            let whole = place.ends_with("faces") || place.ends_with("face");
            let expected = leaves.iter().map(|leaf| match whole {
                true => (leaf.as_u64().unwrap() as u32).to_le_bytes(),
                false => (leaf.as_f64().unwrap() as f32).to_le_bytes(),
            });
            assert_eq!(words, expected.collect::<Vec<_>>(), "{place}");
            return words.len();
        }
        (Value::String(a), Field::String(b)) => assert_eq!(a, b, "{place}"),
        (number, Field::F32(b)) => {
            let a = number.as_f64().unwrap() as f32;
            assert_eq!(a.to_bits(), b.to_bits(), "{place}");
        }
        (number, Field::U32(b)) => assert_eq!(number.as_u64(), Some(u64::from(*b)), "{place}"),
        (number, Field::U64(b)) => assert_eq!(number.as_u64(), Some(*b), "{place}"),
        other => panic!("{place}: {other:?}"),
    }
    1
}

fn flatten<'a>(json: &'a Value, leaves: &mut Vec<&'a Value>) {
    match json {
        Value::Array(items) => items.iter().for_each(|item| flatten(item, leaves)),
        leaf => leaves.push(leaf),
    }
}

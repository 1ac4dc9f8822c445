//! What is done with an input, shared by the fuzz target and the test that replays
//! its corpus. The first byte tells how the rest is taken:
//!
//! - 0: as a sequence file;
//! - 1: the same with its checksums made right, so that what is behind them is tried;
//! - 2: as messages in a sound file: the header's size (u16), the header, frames of
//!   the size that stands before each (u16);
//! - 3: the same with quantised frames;
//! - 4: as the text of an OBJ file.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use drape_dataset::SequenceReader;
use drape_dataset::file::recover;
use drape_dataset::obj::GarmentMesh;
use drape_dataset::patches::Patches;

/// Tries an input; whether anything sound was found in it.
pub fn run(input: &[u8]) -> bool {
    let Some((&way, rest)) = input.split_first() else {
        return false;
    };
    match way % 5 {
        0 => try_file(rest),
        1 => try_file(&with_checksums(rest)),
        2 => try_file(&with_messages(rest, "/drape/frame", "drape.Frame")),
        3 => try_file(&with_messages(
            rest,
            "/drape/quantised_frame",
            "drape.QuantisedFrame",
        )),
        _ => match std::str::from_utf8(rest) {
            Ok(text) => GarmentMesh::parse(text).is_ok(),
            Err(_) => false,
        },
    }
}

fn try_file(bytes: &[u8]) -> bool {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("input.mcap");
    fs::write(&path, bytes).expect("a temporary file");
    let sound = read(&path);
    // Recovery reads without the index, whatever opening said.
    let out = folder.path().join("out.mcap");
    if let Ok(saved) = recover(&path, &out) {
        for saved in saved {
            let reader = SequenceReader::open(&saved.path).expect("what was saved is sound");
            assert_eq!(reader.frame_count(), saved.frames.len());
            reader.check_bytes().expect("a file of our own");
        }
    }
    sound
}

fn read(path: &Path) -> bool {
    let Ok(reader) = SequenceReader::open(path) else {
        return false;
    };
    let _ = reader.check_bytes();
    let header = reader.header();
    header.check().expect("what was opened has been checked");
    let _ = Patches::of_outfit(&header.garments, 0.05 / header.scene.metres_per_uv);
    let count = reader.frame_count().min(64);
    for frame in reader.frames(0..count).flatten() {
        frame.check(header).expect("what was read has been checked");
    }
    reader.frame(count - 1).is_ok()
}

/// Corrects the CRCs of chunks that lie one behind the other, of the data section and
/// of the summary, as far as their places can be told.
fn with_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let word = |bytes: &[u8], at: usize| -> Option<usize> {
        let eight = bytes.get(at..)?.first_chunk()?;
        usize::try_from(u64::from_le_bytes(*eight)).ok()
    };
    let mut at = mcap::MAGIC.len();
    while let Some(length) = word(&bytes, at + 1)
        && let Some(end) = at
            .checked_add(9)
            .and_then(|start| start.checked_add(length))
        && end <= bytes.len()
    {
        let records = at + 49;
        if bytes[at] == mcap::records::op::CHUNK && records <= end {
            let crc = crc32fast::hash(&bytes[records..end]);
            bytes[at + 33..at + 37].copy_from_slice(&crc.to_le_bytes());
        }
        if bytes[at] == mcap::records::op::DATA_END && length == 4 {
            let crc = crc32fast::hash(&bytes[..at]);
            bytes[at + 9..end].copy_from_slice(&crc.to_le_bytes());
        }
        at = end;
    }
    let footer = bytes.len().saturating_sub(mcap::MAGIC.len() + 29);
    if let Some(start) = word(&bytes, footer + 9)
        && start <= footer
        && footer + 29 <= bytes.len()
    {
        let crc = crc32fast::hash(&bytes[start..footer + 25]);
        bytes[footer + 25..footer + 29].copy_from_slice(&crc.to_le_bytes());
    }
    bytes
}

fn with_messages(bytes: &[u8], topic: &str, schema: &str) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .create(&mut file)
        .expect("memory");
    let mut channel = |topic: &str, schema: &str| {
        let schema = writer.add_schema(schema, "protobuf", b"").expect("memory");
        let none = BTreeMap::new();
        writer
            .add_channel(schema, topic, "protobuf", &none)
            .expect("memory")
    };
    let header = channel("/drape/header", "drape.SequenceHeader");
    let frame = channel(topic, schema);
    let mut rest = bytes;
    let mut count = 0;
    while let Some((size, behind)) = rest.split_first_chunk::<2>() {
        let size = usize::from(u16::from_le_bytes(*size)).min(behind.len());
        let (message, behind) = behind.split_at(size);
        rest = behind;
        let head = mcap::records::MessageHeader {
            channel_id: if count == 0 { header } else { frame },
            sequence: u32::saturating_sub(count, 1),
            log_time: 0,
            publish_time: 0,
        };
        writer
            .write_to_known_channel(&head, message)
            .expect("memory");
        writer.flush().expect("memory");
        count += 1;
    }
    writer.finish().expect("memory");
    drop(writer);
    file.into_inner()
}

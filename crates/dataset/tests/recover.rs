//! Damage: every changed bit is found, and what is whole can be saved.

#[path = "../examples/conformance/cases.rs"]
#[allow(dead_code)]
mod cases;
#[path = "../examples/conformance/json.rs"]
#[allow(dead_code)]
mod json;

use std::fs;
use std::path::Path;

use drape_dataset::file::{Saved, recover};
use drape_dataset::sequence::{Frame, SequenceHeader};
use drape_dataset::{DatasetError, SequenceReader, SequenceWriter};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

const FRAMES: usize = 12;

fn frames() -> Vec<Frame> {
    let base = cases::two_layers_frames();
    let frame = |i: usize| {
        let mut frame = base[i % base.len()].clone();
        frame.garments[1][0][0] = i as f32;
        frame
    };
    (0..FRAMES).map(frame).collect()
}

fn sound() -> Vec<u8> {
    cases::written(&cases::two_layers(), &frames())
}

/// Everything that a file says, with the checksum over all of it.
fn decode(path: &Path) -> Result<(SequenceHeader, Vec<Frame>), DatasetError> {
    let reader = SequenceReader::open(path)?;
    reader.check_bytes()?;
    Ok((reader.header().clone(), reader.read_all()?))
}

/// Where each chunk of a file starts and ends: the header's, then the frames'.
fn chunks(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let chunks = summary.chunk_indexes.iter();
    let span = |chunk: &mcap::records::ChunkIndex| {
        let start = chunk.chunk_start_offset as usize;
        start..start + chunk.chunk_length as usize
    };
    chunks.map(span).collect()
}

/// Recovers a file of these bytes; what was saved, and what each saved file holds.
fn recovered(bytes: &[u8]) -> Result<Vec<(Saved, Vec<Frame>)>, DatasetError> {
    let folder = TempDir::new().unwrap();
    let damaged = folder.path().join("damaged.mcap");
    fs::write(&damaged, bytes).unwrap();
    let saved = recover(&damaged, folder.path().join("saved.mcap"))?;
    let read = |saved: Saved| {
        let (header, frames) = decode(&saved.path).unwrap();
        let mut expected = cases::two_layers();
        let last = header.scene.warnings.last().unwrap().clone();
        let (a, b) = (saved.frames.start, saved.frames.end - 1);
        assert!(last.contains("damaged.mcap") && last.ends_with(&format!("{a} to {b}")));
        expected.scene.warnings.push(last);
        assert_eq!(header, expected);
        (saved, frames)
    };
    Ok(saved.into_iter().map(read).collect())
}

#[test]
fn each_of_ten_thousand_flipped_bits_is_found() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    let mut bytes = sound();
    fs::write(&path, &bytes).unwrap();
    let expected = decode(&path).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for trial in 0..10_000 {
        let (at, bit) = (rng.random_range(0..bytes.len()), rng.random_range(0..8));
        bytes[at] ^= 1 << bit;
        fs::write(&path, &bytes).unwrap();
        assert!(
            decode(&path).is_err(),
            "trial {trial}: byte {at}, bit {bit}"
        );
        // Reading alone may pass over bytes that it never uses, but never reads another content.
        let read =
            SequenceReader::open(&path).and_then(|r| Ok((r.header().clone(), r.read_all()?)));
        if let Ok(read) = read {
            assert!(read == expected, "trial {trial}: byte {at}, bit {bit}");
        }
        bytes[at] ^= 1 << bit;
    }
}

#[test]
fn a_cut_file_gives_exactly_its_whole_frames_and_its_error_says_which() {
    let bytes = sound();
    let chunks = chunks(&bytes);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("cut.mcap");
    let mut seen = [0; FRAMES + 1];
    for length in (chunks[0].start..bytes.len()).step_by(41) {
        let whole = chunks.iter().filter(|chunk| chunk.end <= length).count();
        fs::write(&path, &bytes[..length]).unwrap();
        let message = SequenceReader::open(&path).unwrap_err().to_string();
        match (whole, recovered(&bytes[..length])) {
            (0 | 1, Err(error)) => {
                let lost = if whole == 0 {
                    "header is lost"
                } else {
                    "no frame"
                };
                assert!(error.to_string().contains(lost), "{error}");
                assert!(message.contains(lost), "{message}");
            }
            (_, Ok(saved)) => {
                let [(file, found)] = &saved[..] else {
                    panic!("one piece")
                };
                assert_eq!(file.frames, 0..whole - 1, "cut at {length}");
                assert_eq!(found, &frames()[..whole - 1]);
                let last = if whole == 2 {
                    "0".into()
                } else {
                    format!("0 to {}", whole - 2)
                };
                let expected = format!("the frames {last} are whole");
                assert!(message.contains(&expected), "{message}");
                assert!(message.contains("--recover"), "{message}");
                seen[whole - 1] += 1;
            }
            (_, Err(error)) => panic!("cut at {length}: {error}"),
        }
    }
    assert!(
        seen[1..].iter().all(|&cuts| cuts > 0),
        "every count of frames: {seen:?}"
    );
}

#[test]
fn an_unfinished_file_is_recognised_and_saved() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    let mut writer = SequenceWriter::create(&path, &cases::two_layers()).unwrap();
    for frame in frames() {
        writer.push(&frame).unwrap();
    }
    // As a power cut leaves it: under its hidden name, without an end.
    let partial = fs::read_dir(folder.path())
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let bytes = fs::read(partial.path()).unwrap();
    let error = SequenceReader::open(partial.path()).unwrap_err();
    assert!(matches!(error, DatasetError::Truncated { .. }), "{error}");
    let saved = recovered(&bytes).unwrap();
    // The writer's own buffer is lost with the program; here a chunk's end flushes it.
    assert!(
        saved[0].1.len() >= FRAMES - 1,
        "{} frames",
        saved[0].1.len()
    );
    assert_eq!(saved[0].1, frames()[..saved[0].1.len()]);
    drop(writer);
}

#[test]
fn frames_behind_a_damaged_one_are_saved_in_a_file_of_their_own() {
    let sound = sound();
    let chunks = chunks(&sound);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for _ in 0..60 {
        // Two different frames, damaged anywhere: their chunk's head, sizes, CRC or data.
        let mut bytes = sound.clone();
        let broken = rand::seq::index::sample(&mut rng, FRAMES, 2).into_vec();
        for &frame in &broken {
            let at = rng.random_range(chunks[1 + frame].clone());
            // A chunk's times are covered by no CRC of its own; frames do not depend on them.
            let at = if (9..25).contains(&(at - chunks[1 + frame].start)) {
                at + 16
            } else {
                at
            };
            bytes[at] ^= rng.random_range(1..=255u8);
        }
        let saved = recovered(&bytes).unwrap();
        let mut kept = Vec::new();
        for (at, (file, found)) in saved.iter().enumerate() {
            assert_eq!(found, &frames()[file.frames.clone()]);
            let name = file.path.file_name().unwrap().to_str().unwrap();
            match at {
                0 => assert_eq!(name, "saved.mcap"),
                _ => assert_eq!(name, format!("saved.from_{}.mcap", file.frames.start)),
            }
            kept.extend(file.frames.clone());
        }
        let expected: Vec<_> = (0..FRAMES)
            .filter(|frame| !broken.contains(frame))
            .collect();
        assert_eq!(kept, expected, "frames {broken:?} were damaged");
    }
}

#[test]
fn a_lost_index_loses_nothing_and_the_damaged_file_is_never_overwritten() {
    let mut bytes = sound();
    let from = chunks(&bytes).last().unwrap().end;
    bytes[from..].fill(0xa5);
    let saved = recovered(&bytes).unwrap();
    assert_eq!(saved.len(), 1);
    assert_eq!(saved[0].1, frames());

    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.mcap");
    fs::write(&path, &bytes).unwrap();
    let message = recover(&path, &path).unwrap_err().to_string();
    assert!(message.contains("another file"), "{message}");
    assert_eq!(fs::read(&path).unwrap(), bytes);
}

//! `drape-inspect` on broken files: the format's conformance files that must be
//! refused, and what `--recover` saves of them.

use std::path::{Path, PathBuf};
use std::process::Command;

use drape_dataset::SequenceReader;

fn conformance(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-spec/conformance");
    folder.join(name).with_extension("mcap")
}

/// Runs the program; whether it succeeded, and all that it printed.
fn inspect(arguments: &[&Path]) -> (bool, String) {
    let program = env!("CARGO_BIN_EXE_drape-inspect");
    let output = Command::new(program).args(arguments).output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8(text).unwrap())
}

#[test]
fn whole_frames_of_damaged_files_are_saved_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let sound = SequenceReader::open(conformance("two_layers")).unwrap();
    // In both the last frame is broken, and of `cut` the index is missing too.
    for name in ["cut", "flipped"] {
        let out = folder.path().join(name).with_extension("mcap");
        let damaged = conformance(name);
        let (passed, printed) = inspect(&[&damaged, Path::new("--no-pictures")]);
        assert!(!passed && printed.contains("--recover"), "{printed}");
        let (passed, printed) = inspect(&[&damaged, Path::new("--recover"), &out]);
        assert!(passed, "{printed}");
        let saved = SequenceReader::open(&out).unwrap();
        let last = saved.frame_count() - 1;
        let line = format!("frames 0 to {last}  {}", out.display());
        assert_eq!(printed.trim(), line);
        for index in 0..=last {
            assert_eq!(saved.frame(index).unwrap(), sound.frame(index).unwrap());
        }
        assert_eq!(saved.frame_count(), sound.frame_count() - 1);
    }
}

#[test]
fn nothing_is_written_when_nothing_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.mcap");
    let damaged = conformance("newer_major");
    let (passed, printed) = inspect(&[&damaged, Path::new("--recover"), &out]);
    assert!(!passed && printed.contains("header is lost"), "{printed}");
    assert!(!out.exists());
}

#[test]
fn a_changed_byte_that_reading_never_uses_fails_the_inspection() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.mcap");
    let mut bytes = std::fs::read(conformance("two_layers")).unwrap();
    // The name of the library that wrote the file.
    let library = b"drape-dataset";
    let at = bytes
        .windows(library.len())
        .position(|w| w == library)
        .unwrap();
    bytes[at] ^= 0x20;
    std::fs::write(&path, bytes).unwrap();
    let (passed, printed) = inspect(&[&path, Path::new("--no-pictures")]);
    let failed = printed.contains("FAILED every byte");
    assert!(
        !passed && failed && printed.contains("data section"),
        "{printed}"
    );
    let (_, printed) = inspect(&[&conformance("two_layers"), Path::new("--no-pictures")]);
    assert!(printed.contains("ok     every byte"), "{printed}");
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let program = env!("CARGO_BIN_EXE_drape-inspect");
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = Command::new(program)
        .args([&conformance("two_layers"), Path::new("--no-pictures")])
        .stdout(writer)
        .output()
        .unwrap();
    assert!(!output.status.success(), "nobody read what it printed");
    assert_eq!(String::from_utf8(output.stderr).unwrap(), "");
}

//! `drape-import d-layers`: a data set with splits and counts, kept when it is
//! there already, whole files or none when interrupted.

mod d_layers;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use d_layers::{make, python_is_there};
use drape_dataset::SequenceReader;
use drape_dataset::splits::{DatasetIndex, Split};
use serde_json::json;

fn program(root: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_drape-import"));
    command.arg("d-layers").arg(root).arg(out).args(more);
    command
}

fn run(root: &Path, out: &Path, more: &[&str]) -> (Output, String) {
    let output = program(root, out, more).output().unwrap();
    let text = [&output.stdout[..], &output.stderr].concat();
    let text = String::from_utf8(text).unwrap();
    (output, text)
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .map(|entries| entries.map(|entry| entry.unwrap().path()).collect())
        .unwrap_or_default();
    files.sort();
    files
}

#[test]
fn a_folder_becomes_a_data_set_and_what_is_finished_is_kept() {
    if !python_is_there() {
        return;
    }
    let made = make(json!({}));
    let out = made.root.parent().unwrap().join("ours");
    let without = made.root.join("nowhere");
    let (output, text) = run(&made.root, &out, &["--smpl", without.to_str().unwrap()]);
    assert!(
        !output.status.success() && text.contains("no such folder"),
        "{text}"
    );
    assert!(!out.exists());

    let (output, text) = run(&made.root, &out, &[]);
    assert!(output.status.success(), "{text}");
    for part in [
        "SMPL from",
        "[1/3] 00007: 6 frames, Jumpsuit + Jacket + Hood, split val; intersections in",
        "[3/3] 00396:",
        "split train",
        "1 listed sequences are not in",
        "99999",
        "of 18 frames that were counted now",
        "3 sequences, data hash",
    ] {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
    let index = DatasetIndex::load(&out).unwrap();
    index.verify().unwrap();
    assert_eq!(index.split(Split::Train).unwrap()[0].file, "00396.mcap");
    assert_eq!(index.split(Split::Test).unwrap()[0].file, "00100.mcap");
    let reader = SequenceReader::open(out.join("00396.mcap")).unwrap();
    assert_eq!(reader.header().body.vertex_count, 14);
    assert_eq!(made.expected["00396"]["frames"], reader.frame_count());
    assert!(reader.frame(5).unwrap().intersections.is_some());

    // Again: nothing is written. Without the body: a different sequence, written anew.
    let contents = |path: &PathBuf| {
        (
            fs::metadata(path).unwrap().modified().unwrap(),
            path.clone(),
        )
    };
    let before: Vec<_> = files(&out).iter().map(contents).collect();
    let (output, text) = run(&made.root, &out, &[]);
    assert!(output.status.success(), "{text}");
    assert_eq!(text.matches(", kept").count(), 3, "{text}");
    assert_eq!(files(&out).iter().map(contents).collect::<Vec<_>>(), before);
    fs::rename(made.root.join("smpl"), made.root.join("elsewhere")).unwrap();
    let (output, text) = run(
        &made.root,
        &out,
        &["--only", "00100", "--skip-intersections"],
    );
    assert!(output.status.success(), "{text}");
    for part in [
        "bodies: missing",
        "[1/1] 00100:",
        "intersections not counted",
    ] {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
    let reader = SequenceReader::open(out.join("00100.mcap")).unwrap();
    assert_eq!(reader.header().body.vertex_count, 0);
    assert_eq!(reader.frame(0).unwrap().intersections, None);
    DatasetIndex::load(&out).unwrap().verify().unwrap();

    let (output, text) = run(&made.root, &out, &["--only", "12"]);
    assert!(
        !output.status.success() && text.contains("--only 12"),
        "{text}"
    );
}

#[test]
fn a_sequence_that_cannot_be_read_does_not_stop_the_others() {
    if !python_is_there() {
        return;
    }
    let made = make(json!({}));
    let out = made.root.parent().unwrap().join("ours");
    fs::remove_file(made.root.join("data/00100/jacket_hood.pkl")).unwrap();
    let (output, text) = run(&made.root, &out, &[]);
    assert_eq!(output.status.code(), Some(1), "{text}");
    for part in [
        "[2/3] 00100: error: ",
        "jacket_hood.pkl",
        "1 of 3 sequences",
    ] {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
    assert_eq!(DatasetIndex::load(&out).unwrap().sequences().len(), 2);
    assert!(!out.join("00100.mcap").exists());
}

/// The program at work: its first unfinished file is there, frames are being written.
#[cfg(unix)]
fn writing(made: &d_layers::Made, out: &Path) -> std::process::Child {
    use std::time::{Duration, Instant};

    let child = program(&made.root, out, &[])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let started = Instant::now();
    while files(out).is_empty() {
        assert!(
            started.elapsed() < Duration::from_secs(60),
            "nothing is written"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    child
}

/// Crumpled garments: counting takes seconds.
#[cfg(unix)]
fn long_work() -> d_layers::Made {
    make(json!({"grid": 24, "frames": 1000, "light": true, "protocol": 5}))
}

#[cfg(unix)]
#[test]
fn a_killed_import_leaves_no_file_of_its_names_and_the_same_command_tidies_up() {
    if !python_is_there() {
        return;
    }
    let made = long_work();
    let out = made.root.parent().unwrap().join("ours");
    let mut child = writing(&made, &out);
    child.kill().unwrap();
    child.wait().unwrap();
    let left = files(&out);
    let name = left[0].file_name().unwrap().to_str().unwrap();
    assert_eq!(left.len(), 1, "{left:?}");
    assert!(
        name.starts_with('.') && name.ends_with(".partial"),
        "{name}"
    );

    let (output, text) = run(&made.root, &out, &["--skip-intersections"]);
    assert!(output.status.success(), "{text}");
    let names = ["00007.mcap", "00100.mcap", "00396.mcap", "dataset.json"];
    assert_eq!(files(&out), names.map(|name| out.join(name)));
    DatasetIndex::load(&out).unwrap().verify().unwrap();
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_whole_files_only_and_the_same_command_goes_on() {
    if !python_is_there() {
        return;
    }
    let made = long_work();
    let out = made.root.parent().unwrap().join("ours");
    let child = writing(&made, &out);
    let pid = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &pid])
            .status()
            .unwrap()
            .success()
    );
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{text}");
    assert!(
        text.contains("interrupted") && text.contains("same command"),
        "{text}"
    );
    assert_eq!(files(&out), Vec::<PathBuf>::new());

    let (output, text) = run(&made.root, &out, &["--skip-intersections"]);
    assert!(output.status.success(), "{text}");
    assert_eq!(DatasetIndex::load(&out).unwrap().sequences().len(), 3);
}

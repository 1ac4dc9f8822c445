//! The examples of the guide run, and say what they should; the Python one plots what
//! the file holds, where there is a Python with mcap and matplotlib.

// Each example takes its own copy of what they share.
#![allow(clippy::duplicate_mod)]

#[path = "../examples/copy_for_viewing.rs"]
mod copy_for_viewing;
#[allow(dead_code)]
mod d_layers;
#[path = "../examples/go_on_drawing.rs"]
mod go_on_drawing;
#[path = "../examples/obj_to_samples.rs"]
mod obj_to_samples;
#[path = "../examples/read_frames.rs"]
mod read_frames;
#[path = "../examples/save_whole_frames.rs"]
mod save_whole_frames;

use std::path::Path;
use std::process::Command;

use drape_dataset::SequenceReader;

#[test]
fn every_example_runs() {
    copy_for_viewing::main().unwrap();
    go_on_drawing::main().unwrap();
    obj_to_samples::main().unwrap();
    read_frames::main().unwrap();
    save_whole_frames::main().unwrap();
}

#[test]
fn python_plots_the_path_that_the_file_holds() {
    if !["mcap", "numpy", "matplotlib"]
        .iter()
        .all(|module| d_layers::python_has(module))
    {
        return;
    }
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = here.join("../../data-spec/conformance/two_layers.mcap");
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("path.png");
    let output = Command::new("python3")
        .arg(here.join("examples/plot_vertex.py"))
        .args([&file, &picture])
        .args(["1", "3"])
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let reader = SequenceReader::open(&file).unwrap();
    let expected = reader
        .read_all()
        .unwrap()
        .into_iter()
        .map(|frame| frame.garments[1][3]);
    let printed = String::from_utf8(output.stdout).unwrap();
    let read = |line: &str| -> Vec<f32> { line.split(' ').map(|x| x.parse().unwrap()).collect() };
    let found: Vec<_> = printed.lines().map(read).collect();
    assert_eq!(found, expected.map(Vec::from).collect::<Vec<_>>());
    let png = std::fs::read(picture).unwrap();
    assert!(png.starts_with(b"\x89PNG") && png.len() > 1000);
}

//! The programs one after the other on a small data set, as `cargo xtask`
//! starts them: train, eval, rollout, inspect; and Ctrl-C in the middle.

use std::{fs, path::Path, process::Output};

use drape_dataset::{
    SequenceReader,
    splits::{DatasetIndex, Split},
};
use drape_tests::{
    example::{FRAMES, write_dataset, write_frames},
    programs::{printed, run},
};
use serde_json::Value;

const TRAIN: [&str; 8] = [
    "--data",
    "data",
    "--run",
    "runs/small",
    "--epochs",
    "2",
    "--samples-per-epoch",
    "8",
];

fn succeed(name: &str, folder: &Path, arguments: &[&str]) -> Output {
    let output = run(name, folder, arguments);
    assert!(
        output.status.success(),
        "{name} {arguments:?}:\n{}",
        printed(&output)
    );
    output
}

fn with_data() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("data")).unwrap();
    write_dataset(
        &folder.path().join("data"),
        &[Split::Train, Split::Train, Split::Test],
    )
    .unwrap();
    folder
}

#[test]
fn a_run_is_trained_measured_rolled_out_and_inspected() {
    let folder = with_data();
    let folder = folder.path();
    succeed("drape-train", folder, &TRAIN);

    let output = succeed("drape-eval", folder, &["--steps", "8", "--no-engine"]);
    for row in ["reference", "hold", "frozen", "skinned", "LayersNet small"] {
        assert!(
            printed(&output).contains(row),
            "no row {row}:\n{}",
            printed(&output)
        );
    }
    let evaluation = folder.join("runs/small/eval");
    for file in ["table.md", "table.csv", "plot.png", "sheet_sequence_2.png"] {
        assert!(evaluation.join(file).is_file(), "no {file}");
    }
    let table: Value =
        serde_json::from_str(&fs::read_to_string(evaluation.join("table.json")).unwrap()).unwrap();
    for row in table["rows"].as_array().unwrap() {
        assert_eq!(row["groups"]["overall"]["frames"], 8, "{row}");
        assert!(
            row["method"] == "reference" || row["ms_per_frame"].as_f64().unwrap() > 0.0,
            "a row without a time: {row}"
        );
    }
    assert_eq!(
        table["rows"][0]["groups"]["overall"]["error_mm_10x"]["mean"],
        0.0
    );

    succeed(
        "drape-rollout",
        folder,
        &["data/sequence_2.mcap", "--out", "predicted.mcap"],
    );
    let predicted = SequenceReader::open(folder.join("predicted.mcap")).unwrap();
    let source = SequenceReader::open(folder.join("data/sequence_2.mcap")).unwrap();
    assert_eq!(predicted.frame_count(), FRAMES);
    assert_eq!(predicted.header().scene.engine, "layersnet");
    let (given, first) = (source.frame(2).unwrap(), predicted.frame(2).unwrap());
    assert_eq!(given.garments, first.garments, "given frames are copied");
    let (given, first) = (source.frame(3).unwrap(), predicted.frame(3).unwrap());
    assert_eq!(given.body, first.body);
    assert_ne!(given.garments, first.garments);
    assert!(first.intersections.is_some(), "intersections are counted");

    let output = run(
        "drape-inspect",
        folder,
        &["predicted.mcap", "--no-pictures"],
    );
    assert!(
        printed(&output).contains("layersnet") && printed(&output).contains("layer contact"),
        "{}",
        printed(&output)
    );
}

/// Starts a program, waits until `begun` says that work has begun, and interrupts it as a
/// terminal does (other systems have no `kill`). Returns its exit code.
#[cfg(unix)]
fn interrupted(
    name: &str,
    folder: &Path,
    arguments: &[&str],
    begun: impl Fn(&str) -> bool,
) -> Option<i32> {
    use std::{
        process::{Command, Stdio},
        thread::sleep,
        time::Duration,
    };

    let said = folder.join("said.txt");
    let mut child = drape_tests::programs::program(name, folder)
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(fs::File::create(&said).unwrap())
        .spawn()
        .unwrap();
    while !begun(&fs::read_to_string(&said).unwrap()) {
        assert!(
            child.try_wait().unwrap().is_none(),
            "{name} ended before it began"
        );
        sleep(Duration::from_millis(20));
    }
    let id = child.id().to_string();
    let kill = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(kill.success());
    child.wait().unwrap().code()
}

/// The index is written last: a folder without it is not a data set yet.
#[cfg(unix)]
#[test]
fn ctrl_c_ends_generation_with_130_and_whole_sequences_only() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(
        folder.join("tiny.toml"),
        "train_sequences = 3\ntest_sequences = 1\nframes = 3\n[scene]\noutfit_vertices = 300.0\n\
         [scene.lead_in]\nstill = 1\nease = 2\n",
    )
    .unwrap();
    let arguments = ["--config", "tiny.toml", "--out", "made", "--threads", "1"];
    let first = folder.join("made/train_0000.mcap");
    let code = interrupted("drape-generate", folder, &arguments, |_| first.exists());
    assert_eq!(code, Some(130));
    assert!(!folder.join("made/dataset.json").exists());
    for entry in fs::read_dir(folder.join("made")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "mcap") {
            assert_eq!(SequenceReader::open(&path).unwrap().frame_count(), 3);
        }
    }
    let kept = fs::read(&first).unwrap();
    succeed("drape-generate", folder, &arguments);
    assert_eq!(fs::read(&first).unwrap(), kept, "made again");
    assert!(folder.join("made/dataset.json").is_file());
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_training_with_130_and_a_checkpoint() {
    let folder = with_data();
    let folder = folder.path();
    let mut arguments = TRAIN;
    arguments[5] = "4";
    arguments[7] = "400";
    // The record is written when training starts.
    let record = folder.join("runs/small/run.json");
    let code = interrupted("drape-train", folder, &arguments, |_| record.exists());
    assert_eq!(code, Some(130));
    assert!(
        folder
            .join("runs/small/checkpoint/weights.safetensors")
            .is_file()
    );

    let output = run("drape-eval", folder, &["--steps", "8", "--no-engine"]);
    assert!(
        printed(&output).contains("no finished run"),
        "{}",
        printed(&output)
    );
}

/// Tables and predictions are written when all is computed: before, nothing is there.
#[cfg(unix)]
#[test]
fn ctrl_c_ends_evaluation_and_rollout_with_130_and_nothing_written() {
    let folder = with_data();
    let folder = folder.path();
    let mut arguments = TRAIN;
    arguments[7] = "4";
    succeed("drape-train", folder, &arguments);
    // Long enough not to end before the interrupt.
    fs::create_dir(folder.join("long")).unwrap();
    write_frames(&folder.join("long/long.mcap"), "long", 1.0, 1500).unwrap();
    let mut index = DatasetIndex::new(folder.join("long"), "long");
    index.add("long.mcap", Split::Test).unwrap();
    index.save().unwrap();

    let evaluate = ["--data", "long", "--steps", "1400"];
    let code = interrupted("drape-eval", folder, &evaluate, |said| {
        said.contains("1 sequences of long")
    });
    assert_eq!(code, Some(130));
    assert!(!folder.join("runs/small/eval").exists());

    let predict = ["long/long.mcap", "--out", "made/predicted.mcap"];
    let code = interrupted("drape-rollout", folder, &predict, |said| {
        said.contains("predicting 1497 frames of long")
    });
    assert_eq!(code, Some(130));
    assert!(!folder.join("made").exists());
}

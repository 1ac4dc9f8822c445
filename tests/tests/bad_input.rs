//! Bad input to the programs: a clear message that names the file, the key or
//! the folder, a non-zero exit, and nothing lost.

use std::{fs, path::Path};

use drape_dataset::splits::Split;
use drape_tests::{
    example::{write_dataset, write_sequence},
    programs::{printed, run},
};

/// Runs a program that must fail, with a message that holds all of `expected`.
fn refuse(name: &str, folder: &Path, arguments: &[&str], expected: &[&str]) {
    let output = run(name, folder, arguments);
    let printed = printed(&output);
    let code = output.status.code();
    assert!(
        code.is_some_and(|code| code != 0 && code != 101),
        "{name} {arguments:?} exits with {code:?}:\n{printed}"
    );
    for part in expected {
        assert!(
            printed.contains(part),
            "{name} {arguments:?} does not mention {part:?}:\n{printed}"
        );
    }
}

#[test]
fn missing_truncated_and_flipped_sequences_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_sequence(&folder.join("good.mcap"), "good", 1.0).unwrap();
    let bytes = fs::read(folder.join("good.mcap")).unwrap();
    fs::write(folder.join("truncated.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 4;
    fs::write(folder.join("flipped.mcap"), flipped).unwrap();
    fs::write(folder.join("text.mcap"), "not a sequence").unwrap();
    for file in [
        "missing.mcap",
        "truncated.mcap",
        "flipped.mcap",
        "text.mcap",
    ] {
        refuse("drape-inspect", folder, &[file, "--no-pictures"], &[file]);
        refuse("drape-rollout", folder, &[file, "--run", "none"], &[]);
    }
    assert_eq!(fs::read(folder.join("good.mcap")).unwrap(), bytes);
}

#[test]
fn bad_garments_are_named_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let sound = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0.1\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\n\
                 f 1/1 2/2 3/3\nf 3/3 2/2 4/4\n";
    fs::write(folder.join("good.obj"), sound).unwrap();
    let output = run("drape-inspect", folder, &["good.obj"]);
    assert!(output.status.success(), "{}", printed(&output));
    let expected = "4 vertices, 2 faces, 4 UV coordinates, 1 panels";
    assert!(printed(&output).contains(expected), "{}", printed(&output));
    assert!(folder.join("good.panels.png").is_file());
    // A polygon is used, and what was done with it is said with its line.
    let polygon = sound.replace("f 1/1 2/2 3/3\nf 3/3 2/2 4/4", "f 1/1 2/2 4/4 3/3");
    fs::write(folder.join("polygon.obj"), polygon).unwrap();
    let output = run("drape-inspect", folder, &["polygon.obj", "--no-pictures"]);
    assert!(output.status.success(), "{}", printed(&output));
    for part in [
        "4 vertices, 2 faces",
        "line 9: a face of 4 corners",
        "cut into",
    ] {
        assert!(
            printed(&output).contains(part),
            "{part}: {}",
            printed(&output)
        );
    }
    for (name, from, to, part) in [
        ("nan", "v 1 1 0.1", "v 1 NaN 0.1", "line 4"),
        ("inwards", "f 3/3 2/2 4/4", "f 1/1 3/3 2/2 4/4", "line 10"),
        ("no-uv", "f 3/3 2/2 4/4", "f 3 2 4", "line 10"),
        ("flat", "f 3/3 2/2 4/4", "f 3/3 2/2 2/4", "line 10"),
        ("outside", "f 3/3 2/2 4/4", "f 3/3 2/2 5/4", "line 10"),
    ] {
        let file = format!("{name}.obj");
        fs::write(folder.join(&file), sound.replace(from, to)).unwrap();
        refuse("drape-inspect", folder, &[&file], &[&file, part]);
        assert!(!folder.join(format!("{name}.panels.png")).exists());
    }
}

#[test]
fn a_typo_in_a_configuration_is_named_with_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("typo.toml"), "[schedule]\nepohcs = 3\n").unwrap();
    refuse(
        "drape-train",
        folder,
        &["--config", "typo.toml"],
        &["typo.toml", "epohcs", "epochs"],
    );
    fs::write(folder.join("range.toml"), "[schedule]\nbatch = 0\n").unwrap();
    refuse(
        "drape-train",
        folder,
        &["--config", "range.toml"],
        &["schedule.batch", "at least 1"],
    );
    refuse(
        "drape-train",
        folder,
        &["--config", "missing.toml"],
        &["missing.toml"],
    );
    assert!(
        !folder.join("runs").exists(),
        "a run folder was left behind"
    );
}

#[test]
fn an_empty_split_and_missing_data_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("held-out")).unwrap();
    write_dataset(&folder.join("held-out"), &[Split::Test]).unwrap();
    refuse(
        "drape-train",
        folder,
        &["--data", "held-out"],
        &["held-out", "train"],
    );
    refuse("drape-train", folder, &["--data", "nowhere"], &["nowhere"]);
}

#[test]
fn a_run_folder_that_exists_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("data")).unwrap();
    write_dataset(&folder.join("data"), &[Split::Train]).unwrap();
    fs::create_dir_all(folder.join("runs/mine")).unwrap();
    fs::write(folder.join("runs/mine/notes.txt"), "precious").unwrap();
    refuse(
        "drape-train",
        folder,
        &["--data", "data", "--run", "runs/mine"],
        &["runs/mine", "exists"],
    );
    assert_eq!(
        fs::read_to_string(folder.join("runs/mine/notes.txt")).unwrap(),
        "precious"
    );
    assert_eq!(fs::read_dir(folder.join("runs/mine")).unwrap().count(), 1);
}

#[test]
fn evaluation_without_a_run_says_how_to_get_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    refuse(
        "drape-eval",
        folder,
        &[],
        &["no finished run", "cargo xtask train"],
    );
    refuse(
        "drape-eval",
        folder,
        &["--run", "elsewhere"],
        &["elsewhere", "run.json"],
    );
    refuse(
        "drape-eval",
        folder,
        &["--split", "tset"],
        &["tset", "train val test"],
    );
}

#[test]
fn rollouts_that_do_not_fit_a_sequence_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("data")).unwrap();
    write_dataset(&folder.join("data"), &[Split::Train, Split::Test]).unwrap();
    let output = run(
        "drape-train",
        folder,
        &[
            "--data",
            "data",
            "--run",
            "runs/a",
            "--epochs",
            "1",
            "--samples-per-epoch",
            "4",
        ],
    );
    assert!(output.status.success(), "{}", printed(&output));
    refuse(
        "drape-eval",
        folder,
        &["--steps", "35"],
        &["sequence_1", "16 frames", "38"],
    );
    refuse(
        "drape-eval",
        folder,
        &["--steps", "4", "--start", "1"],
        &["--start must be at least 2"],
    );
    refuse("drape-eval", folder, &["--steps", "0"], &["--steps"]);
    refuse(
        "drape-eval",
        folder,
        &["--split", "val", "--steps", "4"],
        &["split val", "dataset.json"],
    );
    refuse(
        "drape-rollout",
        folder,
        &["data/sequence_1.mcap", "--start", "15"],
        &["no frame to predict"],
    );
    refuse(
        "drape-rollout",
        folder,
        &["data/missing.mcap"],
        &["data/missing.mcap"],
    );
    assert!(
        !folder.join("runs/a/eval").exists() && !folder.join("runs/a/rollouts").exists(),
        "half a result was left"
    );
}

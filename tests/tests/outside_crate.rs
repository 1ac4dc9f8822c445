//! The dataset crate alone: a crate outside the workspace depends on it by path,
//! reads a sequence, patches it and prints shapes. Its program is the example in
//! README.md, so that the example is known to work.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use drape_tests::{example::write_sequence, programs::release_folder};

#[test]
fn a_crate_outside_the_workspace_reads_patches_and_prints_a_sequence() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = folder.path().join("example.mcap");
    write_sequence(&sequence, "example", 1.0).unwrap();
    write_crate(folder.path());

    let printed = cargo(
        folder.path(),
        &[
            "run",
            "--release",
            "--offline",
            "--quiet",
            "--",
            sequence.to_str().unwrap(),
        ],
    );
    assert!(
        printed.contains("inner: positions [108, 3], faces [192, 3]"),
        "{printed}"
    );
    assert!(
        printed.contains("16 frames, body [158, 3], 156 patches"),
        "{printed}"
    );

    let tree = cargo(
        folder.path(),
        &["tree", "--offline", "--edges", "normal,build"],
    );
    assert!(tree.contains("drape-dataset"), "{tree}");
    assert!(
        !tree.contains("candle"),
        "the dataset crate must not need tensors:\n{tree}"
    );
}

/// Runs cargo in `folder` with the workspace's build folder, so that nothing is built twice.
fn cargo(folder: &Path, arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .current_dir(folder)
        .env("CARGO_TARGET_DIR", release_folder().parent().unwrap())
        .output()
        .unwrap();
    let messages = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}:\n{messages}");
    String::from_utf8(output.stdout).unwrap()
}

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_path_buf()
}

/// A crate of one file, with the workspace's locked versions and profile.
fn write_crate(folder: &Path) {
    let dataset = workspace().join("crates/dataset");
    let manifest = format!(
        "[package]\nname = \"outside\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n\
         [dependencies]\ndrape-dataset = {{ path = {dataset:?} }}\n\n\
         [workspace]\n\n{}",
        profile()
    );
    fs::write(folder.join("Cargo.toml"), manifest).unwrap();
    fs::copy(workspace().join("Cargo.lock"), folder.join("Cargo.lock")).unwrap();
    fs::create_dir(folder.join("src")).unwrap();
    fs::write(folder.join("src/main.rs"), readme_example()).unwrap();
}

/// The release profile of the workspace: another one would build all dependencies again.
fn profile() -> String {
    let text = fs::read_to_string(workspace().join("Cargo.toml")).unwrap();
    text[text.find("[profile.release]").unwrap()..].to_owned()
}

fn readme_example() -> String {
    let text = fs::read_to_string(workspace().join("README.md")).unwrap();
    let (_, from) = text
        .split_once("```rust\n")
        .expect("README.md has a Rust example");
    from.split_once("```").unwrap().0.to_owned()
}

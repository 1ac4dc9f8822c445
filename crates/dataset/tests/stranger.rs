//! A crate outside the workspace that depends on the *packaged* crate, as a registry
//! would hand it out: D-LAYERS folder in, sequence files out, patched samples, in fewer
//! than forty lines. Its program is the example `d_layers_to_samples`.

#[allow(dead_code)]
mod d_layers;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::json;

/// The workspace's folder.
fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// The folder that this test was built in, so that dependencies are not built twice.
fn target() -> PathBuf {
    let program = std::env::current_exe().unwrap();
    let release = program.ancestors().find(|path| path.ends_with("release"));
    release
        .expect("tests run in the release profile")
        .parent()
        .unwrap()
        .to_path_buf()
}

fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}:\n{errors}");
    output
}

#[test]
fn a_strangers_crate_turns_d_layers_into_samples_in_fewer_than_forty_lines() {
    let program = include_str!("../examples/d_layers_to_samples.rs");
    let lines = program
        .lines()
        .filter(|line| !line.trim().is_empty() && !line.starts_with("//!"));
    assert!(lines.count() < 40);
    if !d_layers::python_is_there() {
        return;
    }
    let made = d_layers::make(json!({ "frames": 8 }));
    let folder = tempfile::tempdir().unwrap();
    let packages = folder.path().join("packages");
    let flags = [
        "--no-verify",
        "--allow-dirty",
        "--offline",
        "--quiet",
        "--target-dir",
    ];
    run(Command::new(env!("CARGO"))
        .args(["package", "-p", "drape-geometry", "-p", "drape-dataset"])
        .args(flags)
        .arg(&packages)
        .current_dir(workspace()));
    let unpacked = |name: &str| {
        let folder = packages.join("package");
        run(Command::new("tar")
            .arg("xzf")
            .arg(format!("{name}-0.1.0.crate"))
            .current_dir(&folder));
        folder.join(format!("{name}-0.1.0"))
    };
    let (dataset, geometry) = (unpacked("drape-dataset"), unpacked("drape-geometry"));
    let schema = fs::read_to_string(dataset.join("proto/drape.proto")).unwrap();
    assert_eq!(
        schema,
        fs::read_to_string(workspace().join("data-spec/drape.proto")).unwrap()
    );

    let stranger = folder.path().join("stranger");
    fs::create_dir_all(stranger.join("src")).unwrap();
    let profile = fs::read_to_string(workspace().join("Cargo.toml")).unwrap();
    let profile = &profile[profile.find("[profile.release]").unwrap()..];
    let manifest = format!(
        "[package]\nname = \"stranger\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n\
         [dependencies]\ndrape-dataset = {{ path = {dataset:?} }}\n\n\
         [patch.crates-io]\ndrape-geometry = {{ path = {geometry:?} }}\n\n[workspace]\n\n{profile}"
    );
    fs::write(stranger.join("Cargo.toml"), manifest).unwrap();
    fs::copy(workspace().join("Cargo.lock"), stranger.join("Cargo.lock")).unwrap();
    fs::write(stranger.join("src/main.rs"), program).unwrap();
    let out = folder.path().join("data");
    let output = run(Command::new(env!("CARGO"))
        .args(["run", "--release", "--offline", "--quiet", "--"])
        .args([&made.root, &out])
        .current_dir(&stranger)
        .env("CARGO_TARGET_DIR", target()));
    let printed = String::from_utf8(output.stdout).unwrap();
    assert_eq!(printed.lines().count(), 3, "{printed}");
    for line in printed.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        assert!(
            matches!(words[..], [v, "vertices,", p, "patches"]
            if v.parse::<usize>().unwrap() > 0 && p.parse::<usize>().unwrap() > 0),
            "{line}"
        );
    }
    let index = drape_dataset::splits::DatasetIndex::load(&out).unwrap();
    assert_eq!(index.sequences().len(), 3);
    index.verify().unwrap();
}

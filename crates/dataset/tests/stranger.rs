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

/// Crates of this repository as the stranger builds them: what they compute is the other
/// tests' matter, and optimising them takes most of the time. Dependencies are built as the
/// workspace builds them, so that both use the same.
const UNOPTIMISED: [&str; 3] = ["stranger", "drape-dataset", "drape-geometry"];

/// Where packages are unpacked. It outlives the test, so that what has not changed is not
/// built again.
fn packages() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("stranger")
}

/// Packages crates of this workspace; folders that hold what the packages hold.
fn packaged<const N: usize>(names: [&str; N]) -> [PathBuf; N] {
    let folder = packages();
    let mut command = Command::new(env!("CARGO"));
    command
        .args(["package", "--no-verify", "--allow-dirty", "--offline"])
        .args(["--quiet", "--target-dir"])
        .arg(&folder)
        .current_dir(workspace());
    for name in names {
        command.args(["-p", name]);
    }
    run(&mut command);
    let fresh = tempfile::tempdir().unwrap();
    names.map(|name| {
        let package = folder.join(format!("package/{name}-0.1.0.crate"));
        run(Command::new("tar")
            .arg("xzf")
            .arg(package)
            .current_dir(fresh.path()));
        mirror(
            &fresh.path().join(format!("{name}-0.1.0")),
            &folder.join(name),
        );
        folder.join(name)
    })
}

/// Makes a folder hold what another holds. What is the same already keeps its time, by
/// which cargo tells what is to be built.
fn mirror(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    let names = |folder: &Path| -> Vec<_> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name()).collect()
    };
    for gone in names(to).iter().filter(|name| !from.join(name).exists()) {
        let gone = to.join(gone);
        if gone.is_dir() {
            fs::remove_dir_all(gone).unwrap();
        } else {
            fs::remove_file(gone).unwrap();
        }
    }
    for name in names(from) {
        let (from, to) = (from.join(&name), to.join(&name));
        if from.is_dir() {
            mirror(&from, &to);
        } else {
            write_if_changed(&to, &fs::read(from).unwrap());
        }
    }
}

fn write_if_changed(path: &Path, bytes: &[u8]) {
    if !fs::read(path).is_ok_and(|there| there == bytes) {
        fs::write(path, bytes).unwrap();
    }
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
    let [geometry, dataset] = packaged(["drape-geometry", "drape-dataset"]);
    let schema = fs::read_to_string(dataset.join("proto/drape.proto")).unwrap();
    assert_eq!(
        schema,
        fs::read_to_string(workspace().join("data-spec/drape.proto")).unwrap()
    );

    let stranger = packages().join("stranger");
    fs::create_dir_all(stranger.join("src")).unwrap();
    let profile = fs::read_to_string(workspace().join("Cargo.toml")).unwrap();
    let profile = &profile[profile.find("[profile.release]").unwrap()..];
    let manifest = format!(
        "[package]\nname = \"stranger\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n\
         [dependencies]\ndrape-dataset = {{ path = {dataset:?} }}\n\n\
         [patch.crates-io]\ndrape-geometry = {{ path = {geometry:?} }}\n\n[workspace]\n\n\
         {profile}\n{}",
        UNOPTIMISED
            .map(|name| format!("[profile.release.package.{name}]\nopt-level = 0\n"))
            .concat()
    );
    write_if_changed(&stranger.join("Cargo.toml"), manifest.as_bytes());
    fs::copy(workspace().join("Cargo.lock"), stranger.join("Cargo.lock")).unwrap();
    write_if_changed(&stranger.join("src/main.rs"), program.as_bytes());
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

//! The dataset crate alone: a crate outside the workspace depends on it by path,
//! reads a sequence, patches it and prints shapes. Its program is the example in
//! README.md, so that the example is known to work.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use drape_dataset::{
    SequenceWriter,
    registry::GarmentKind,
    sequence::{BodyTopology, Frame, Garment, Material, SceneMeta, SequenceHeader},
};

#[test]
fn a_crate_outside_the_workspace_reads_patches_and_prints_a_sequence() {
    let folder = tempfile::tempdir().unwrap();
    let sequence = folder.path().join("example.mcap");
    write_sequence(&sequence);
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
        printed.contains("square: positions [121, 3], faces [200, 3]"),
        "{printed}"
    );
    // One metre of cloth in patches of 5 cm, but faces of 10 cm: each face's centre has its own cell.
    assert!(
        printed.contains("1 frames, body [4, 3], 200 patches"),
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
        .env("CARGO_TARGET_DIR", target_folder())
        .output()
        .unwrap();
    let messages = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}:\n{messages}");
    String::from_utf8(output.stdout).unwrap()
}

/// The build folder that this test runs from: `TARGET/release/deps/outside_crate-…`.
fn target_folder() -> PathBuf {
    env::current_exe()
        .unwrap()
        .ancestors()
        .nth(3)
        .unwrap()
        .to_path_buf()
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

/// One frame of a square metre of cloth (11 × 11 vertices) over a square body.
fn write_sequence(path: &Path) {
    let side = 11_u32;
    let grid = |i: u32| [(i % side) as f32, (i / side) as f32];
    let rest: Vec<[f32; 3]> = (0..side * side)
        .map(|i| [grid(i)[0], grid(i)[1], 10.0])
        .collect();
    let uv: Vec<[f32; 2]> = (0..side * side)
        .map(|i| grid(i).map(|x| x / 10.0))
        .collect();
    let corners = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
    let faces: Vec<[u32; 3]> = corners
        .flat_map(|i| [[i, i + 1, i + side + 1], [i, i + side + 1, i + side]])
        .collect();
    let body = vec![
        [-5.0, -5.0, 9.0],
        [15.0, -5.0, 9.0],
        [15.0, 15.0, 9.0],
        [-5.0, 15.0, 9.0],
    ];
    let header = SequenceHeader {
        name: "example".to_owned(),
        scene: SceneMeta {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: "test".to_owned(),
            engine_version: "0".to_owned(),
            effects: Vec::new(),
            gravity: [0.0, 0.0, -98.1],
            body_friction: 60.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        },
        body: BodyTopology {
            rest: body.clone(),
            faces: vec![[0, 1, 2], [0, 2, 3]],
            vertex_count: 4,
        },
        garments: vec![Garment {
            name: "square".to_owned(),
            kind: GarmentKind::Skirt,
            layer: 0,
            rest: rest.clone(),
            panel_of_face: vec![0; faces.len()],
            uv_faces: faces.clone(),
            faces,
            uv,
            panels: vec!["front".to_owned()],
            material: Material {
                mass: 0.5,
                tension: 50.0,
                compression: 50.0,
                shear: 50.0,
                bending: 50.0,
                friction: 60.0,
            },
        }],
    };
    let mut writer = SequenceWriter::create(path, &header).unwrap();
    writer
        .push(&Frame {
            body,
            garments: vec![rest],
            ..Frame::default()
        })
        .unwrap();
    writer.finish().unwrap();
}

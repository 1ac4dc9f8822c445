//! An effect that a user forces off: the sequence says so, and so does what reads it.

use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Command, Output};

use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::{SequenceReader, SequenceWriter};
use drape_sim::engine::EngineSettings;
use drape_sim::motion::LeadIn;
use drape_sim::scene::{Recipe, SceneRanges, active_effects, simulate};
use drape_view::inspection::Inspection;

/// Pants and skirt, coarse and short, in wind: every effect there is.
fn recipe(without: &[Effect]) -> Recipe {
    let ranges = SceneRanges {
        outfits: vec![vec![GarmentKind::Pants, GarmentKind::Skirt]],
        outfit_vertices: 500.0,
        calm_share: 0.0,
        lead_in: LeadIn { still: 1, ease: 2 },
        ..SceneRanges::default()
    };
    let engine = EngineSettings {
        without: without.iter().copied().collect(),
        ..EngineSettings::default()
    };
    ranges.sample("tiny", 0, 3, 2, &engine)
}

#[test]
fn each_effect_can_be_forced_off_and_no_other_goes_with_it() {
    let all: Vec<Effect> = active_effects(&recipe(&[])).into_iter().collect();
    assert_eq!(all, Effect::ALL, "a scene that calls for everything");
    for &off in Effect::ALL {
        let left: Vec<Effect> = all.iter().copied().filter(|&e| e != off).collect();
        let found: Vec<Effect> = active_effects(&recipe(&[off])).into_iter().collect();
        assert_eq!(found, left);
    }
}

#[test]
fn a_sequence_and_its_inspection_say_what_was_forced_off() {
    let off = [Effect::Wind, Effect::Bending];
    let made = |without: &[Effect]| {
        let recipe = recipe(without);
        let (header, frames) = simulate(&recipe, None, |_| ControlFlow::Continue(())).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tiny.mcap");
        let mut writer = SequenceWriter::create(&path, &header).unwrap();
        for frame in &frames {
            writer.push(frame).unwrap();
        }
        writer.finish().unwrap();
        let reader = SequenceReader::open(&path).unwrap();
        let stored = Recipe::from_json(&reader.header().scene.recipe).unwrap();
        assert_eq!(stored, recipe);
        let said = Inspection::of(&reader, &[0]).to_string();
        (reader.header().scene.clone(), said, frames)
    };
    let (scene, said, frames) = made(&off);
    assert!(off.iter().all(|effect| !scene.effects.contains(effect)));
    let sentence = "forced off by the settings: wind, bending";
    assert_eq!(scene.warnings, [sentence]);
    assert!(said.contains(sentence), "{said}");
    let absent = "absent    wind, bending";
    assert!(said.contains(absent), "{said}");

    let (scene, said, all_frames) = made(&[]);
    assert_eq!(scene.effects, Effect::ALL);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert!(!said.contains("forced off"), "{said}");
    assert_ne!(frames[1].garments, all_frames[1].garments);
}

fn generate(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_drape-generate"))
        .current_dir(folder)
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn an_unknown_effect_is_refused_with_the_names_of_the_known_ones() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |arguments: &[&str]| {
        let output = generate(folder.path(), arguments);
        assert!(!output.status.success());
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains("air-dragg"), "{said}");
        for effect in Effect::ALL {
            assert!(said.contains(effect.name()), "no {effect} in: {said}");
        }
    };
    refused(&["--without", "air-dragg"]);
    let file = folder.path().join("config.toml");
    std::fs::write(&file, "[engine]\nwithout = [\"air-dragg\"]\n").unwrap();
    refused(&["--config", "config.toml"]);
    assert!(!folder.path().join("data").exists());
}

#[test]
fn the_command_line_adds_to_the_configuration_and_blender_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("config.toml");
    std::fs::write(&file, "[engine]\nwithout = [\"friction\"]\n").unwrap();
    let off = ["--config", "config.toml", "--without", "air-drag"];
    let output = generate(folder.path(), &[&off[..], &["--print-config"]].concat());
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let table: toml::Table = said.parse().unwrap();
    let expected: Vec<toml::Value> = vec!["air-drag".into(), "friction".into()];
    assert_eq!(table["engine"]["without"].as_array(), Some(&expected));

    let output = generate(
        folder.path(),
        &[&off[..], &["--engine", "blender"]].concat(),
    );
    assert!(!output.status.success());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("--engine drape"), "{said}");
}

//! Our counts of intersections against those of PyPI's ipctk, read from the file
//! by a script that shares no code with us (`tests/ipctk_check.py`).
//!
//! Runs where the Python named by `DRAPE_PYTHON`, or else `python3`, has ipctk,
//! mcap, protobuf and numpy; prints why not elsewhere.

use std::ops::ControlFlow;
use std::path::Path;
use std::process::Command;

use drape_dataset::SequenceWriter;
use drape_dataset::intersections::count_intersections;
use drape_dataset::random::stream;
use drape_dataset::sequence::{Frame, Intersections, SequenceHeader};
use drape_sim::engine::EngineSettings;
use drape_sim::motion::LeadIn;
use drape_sim::scene::{SceneRanges, simulate};
use rand::Rng;

/// A Python with everything that the script needs, or why there is none.
fn python() -> Result<String, String> {
    let name = std::env::var("DRAPE_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&name)
        .args(["-c", "import ipctk, mcap, google.protobuf, numpy"])
        .output()
        .map_err(|error| format!("{name} does not start: {error}"))?;
    if found.status.success() {
        return Ok(name);
    }
    let message = String::from_utf8_lossy(&found.stderr);
    Err(format!(
        "{name}: {}",
        message.lines().last().unwrap_or("no reason given")
    ))
}

/// Runs the script on one file: whether it agreed, and what it printed.
fn check(python: &str, path: &Path) -> (bool, String) {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/ipctk_check.py");
    let run = Command::new(python).arg(script).arg(path).output().unwrap();
    let text = [run.stdout, run.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    (run.status.success(), text.concat())
}

fn write(path: &Path, header: &SequenceHeader, frames: &[Frame]) {
    let mut writer = SequenceWriter::create(path, header).unwrap();
    frames.iter().for_each(|frame| writer.push(frame).unwrap());
    writer.finish().unwrap();
}

/// A dressed body, and the same with every vertex of the cloth thrown about.
fn clean_and_crumpled() -> (SequenceHeader, Vec<Frame>) {
    let ranges = SceneRanges {
        outfit_vertices: 900.0,
        lead_in: LeadIn { still: 0, ease: 0 },
        ..SceneRanges::default()
    };
    let recipe = ranges.sample("check", 0, 3, 2, &EngineSettings::default());
    let (header, mut frames) = simulate(&recipe, None, |_| ControlFlow::Continue(())).unwrap();
    let mut rng = stream(1, "crumple");
    for (number, size) in [0.05f32, 0.4, 1.5].into_iter().enumerate() {
        let mut frame = frames[0].clone();
        for x in frame.garments.iter_mut().flatten().flatten() {
            *x += rng.random_range(-size..size);
        }
        let counts = count_intersections(&header, &frame);
        let all = counts.between_garments > 0 && counts.within_garments > 0 && counts.with_body > 0;
        assert!(all || number == 0, "too tidy to tell: {counts:?}");
        frame.intersections = Some(counts);
        frames.push(frame);
    }
    (header, frames)
}

#[test]
fn ipctk_counts_the_same_intersections_in_every_frame_and_notices_a_wrong_count() {
    let python = match python() {
        Ok(python) => python,
        Err(reason) => {
            println!("not compared with ipctk: {reason}");
            return;
        }
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("check.mcap");
    let (header, mut frames) = clean_and_crumpled();
    write(&path, &header, &frames);
    let (agrees, text) = check(&python, &path);
    assert!(agrees && text.contains("5 of 5 frames agree"), "{text}");
    println!("{text}");
    frames[1].intersections = Some(Intersections {
        with_body: 1,
        ..frames[1].intersections.unwrap()
    });
    write(&path, &header, &frames);
    let (agrees, text) = check(&python, &path);
    assert!(!agrees && text.contains("frame 1"), "{text}");
}

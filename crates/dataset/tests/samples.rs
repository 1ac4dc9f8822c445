//! Samples: equal to the published program's batch, and their invariances.

#[allow(dead_code)]
mod reference;

use std::sync::Arc;

use drape_dataset::sample::{FrameStates, Outfit, Sample, rotation_matrix, turned};
use drape_dataset::sequence::Frame;
use drape_dataset::statistics::{ColumnStatistics, Statistics, Trend};
use reference::{PATCH_SIZE, Reference};

fn statistics(file: &Reference) -> Statistics {
    let columns = |name: &str| {
        let table = file.values(name);
        ColumnStatistics {
            mean: std::array::from_fn(|i| table[i] as f32),
            std: std::array::from_fn(|i| table[9 + i] as f32),
            trend: Trend::default(),
        }
    };
    Statistics {
        vertices: columns("stat"),
        root: columns("trans_stat"),
    }
}

fn states(frames: &[Frame]) -> Vec<FrameStates> {
    (0..frames.len())
        .map(|f| {
            let older = |back: usize| f.checked_sub(back).map(|at| &frames[at]);
            FrameStates::new(&frames[f], older(1), older(2))
        })
        .collect()
}

/// Sample at the frame of the published batch, with the published gravity.
fn sample(file: &Reference, frames: &[Frame]) -> Sample {
    let outfit = Arc::new(Outfit::new(&file.header(), PATCH_SIZE).unwrap());
    let t = file.values("frame_index")[0] as usize;
    let states = states(frames);
    Sample::new(
        outfit,
        &states[t - 1..t + 2],
        &statistics(file),
        [0.0, 0.0, -9.8 / 30.0],
    )
}

fn close(what: &str, found: &[f32], expected: &[f64], bar: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let size = expected.iter().fold(0f64, |top, x| top.max(x.abs()));
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!(
            (f64::from(*a) - b).abs() <= bar * size,
            "{what}[{i}]: {a}, expected {b}"
        );
    }
}

/// A tensor `[features, rows]` as rows.
fn transposed(values: &[f64], features: usize) -> Vec<f64> {
    let rows = values.len() / features;
    (0..rows)
        .flat_map(|row| (0..features).map(move |f| values[f * rows + row]))
        .collect()
}

#[test]
fn a_sample_is_the_published_batch() {
    let file = Reference::read("tiny_preprocess");
    let batch = Reference::read("tiny_inputs");
    let sample = sample(&file, &file.frames("00001"));
    let step = &sample.steps[0];
    // Absolute positions in f32 cost 1e-7 of 2 units, at velocities of 0.05.
    close(
        "state",
        sample.state.as_flattened(),
        &transposed(&batch.values("state"), 12),
        1e-6,
    );
    close(
        "body",
        step.body.as_flattened(),
        &transposed(&batch.values("h_state"), 12),
        1e-6,
    );
    let reference = transposed(&batch.values("gt_vertices"), 6);
    close(
        "reference",
        sample.reference[0].as_flattened(),
        &reference,
        1e-6,
    );
    close("wind", &step.wind, &batch.values("invisable_force"), 1e-4);
    close("gravity", &step.gravity, &batch.values("gravity"), 1e-4);
    let rotations = step.wind_rotations.as_flattened().as_flattened();
    close(
        "wind's rotations",
        rotations,
        &batch.values("invisable_rotation"),
        1e-6,
    );
    let attributes = transposed(&batch.values("attr"), 5);
    close(
        "attributes",
        sample.outfit.attributes.as_flattened(),
        &attributes,
        1e-5,
    );
}

#[test]
fn moving_the_whole_scene_changes_nothing_but_rounding() {
    let file = Reference::read("tiny_preprocess");
    let frames = file.frames("00001");
    let mut moved = frames.clone();
    for frame in &mut moved {
        let shift = |x: &mut [f32; 3]| *x = [x[0] + 4.0, x[1] - 8.0, x[2] + 2.0];
        frame
            .body
            .iter_mut()
            .chain(frame.garments.iter_mut().flatten())
            .for_each(shift);
        shift(&mut frame.root.translation);
    }
    let (a, b) = (sample(&file, &frames), sample(&file, &moved));
    let wide: Vec<f64> = a
        .state
        .as_flattened()
        .iter()
        .map(|&x| f64::from(x))
        .collect();
    close("state", b.state.as_flattened(), &wide, 2e-6);
}

#[test]
fn turning_frames_turns_states_and_wind() {
    let file = Reference::read("tiny_preprocess");
    let frames = file.frames("00001");
    let angle = 0.7f64;
    let (sin, cos) = (angle.sin() as f32, angle.cos() as f32);
    let all: Vec<Frame> = frames.iter().map(|frame| turned(frame, angle)).collect();
    let (plain, other) = (states(&frames), states(&all));
    for (a, b) in plain[9].garments.iter().zip(&other[9].garments) {
        for at in [0, 3] {
            assert!((cos * a[at] - sin * a[at + 1] - b[at]).abs() < 1e-5);
            assert!((sin * a[at] + cos * a[at + 1] - b[at + 1]).abs() < 1e-5);
            assert!((a[at + 2] - b[at + 2]).abs() < 1e-5);
        }
    }
    // The wind's matrix is turned from the left.
    let (before, after) = (
        rotation_matrix(frames[9].wind.rotation),
        rotation_matrix(all[9].wind.rotation),
    );
    for column in 0..3 {
        let expected = cos * before[0][column] - sin * before[1][column];
        assert!((expected - after[0][column]).abs() < 1e-6);
    }
    assert_eq!(turned(&frames[9], 0.0), frames[9]);
}

#[test]
fn equal_materials_share_an_attribute_row() {
    let file = Reference::read("tiny_preprocess");
    let mut header = file.header();
    assert_eq!(
        Outfit::new(&header, PATCH_SIZE).unwrap().attributes.len(),
        2
    );
    header.garments[1].material = header.garments[0].material;
    let outfit = Outfit::new(&header, PATCH_SIZE).unwrap();
    assert_eq!(outfit.attributes.len(), 1);
    assert!(outfit.patch_attributes.iter().all(|rows| rows == [0]));
}

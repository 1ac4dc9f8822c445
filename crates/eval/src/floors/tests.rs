//! What each floor promises, on a small outfit that moves in known ways.

use drape_dataset::{
    registry::GarmentKind,
    sequence::{Frame, Root},
};
use drape_geometry::rigid::{Rigid, matrix_from_quaternion};

use super::{Frozen, Hold, Skinned};
use crate::{
    example::{header, tube},
    method::{Method, roll_out},
    task::{Clip, Positions, Task},
};

const STEPS: usize = 4;

/// A body and a garment around it; frame `f` is the rest moved by `motion(f)`,
/// with the garment's vertices moved by `slip(f)` in the root's frame.
fn clip(root: impl Fn(usize) -> Root, slip: impl Fn(usize) -> [f64; 3]) -> Clip {
    let mut header = header(&[(GarmentKind::Skirt, 0)]);
    (header.body.rest, header.body.faces) = tube(1.0, 12, 9);
    header.body.vertex_count = header.body.rest.len();
    (header.garments[0].rest, header.garments[0].faces) = tube(1.3, 12, 5);
    let frames = (0..STEPS + 3)
        .map(|f| {
            let root = root(f);
            let motion = rigid(&root);
            let slip = slip(f);
            let moved = |points: &[[f32; 3]], slip: [f64; 3]| -> Positions {
                let at = |p: &[f32; 3]| {
                    motion
                        .apply([0, 1, 2].map(|k| f64::from(p[k]) + slip[k]))
                        .map(|x| x as f32)
                };
                points.iter().map(at).collect()
            };
            Frame {
                body: moved(&header.body.rest, [0.0; 3]),
                garments: vec![moved(&header.garments[0].rest, slip)],
                root,
                ..Frame::default()
            }
        })
        .collect();
    Clip { header, frames }
}

fn rigid(root: &Root) -> Rigid {
    Rigid {
        rotation: matrix_from_quaternion(root.rotation.map(f64::from)),
        translation: root.translation.map(f64::from),
    }
}

/// A root that walks and turns.
fn moving(f: usize) -> Root {
    let angle = 0.2 * f as f32;
    Root {
        translation: [0.3 * f as f32, 0.1 * (f * f) as f32, 9.0],
        rotation: [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()],
    }
}

/// Largest distance between a rollout and the reference.
fn worst(method: &mut dyn Method, clip: Clip) -> f32 {
    let (task, reference) = clip.split(2, STEPS).unwrap();
    let rollout = roll_out(method, &task, &mut || Ok(())).unwrap();
    assert_eq!(rollout.frames.len(), STEPS);
    assert_eq!(rollout.step_ms.len(), STEPS);
    let predicted = rollout.frames.iter().flatten().flatten().flatten();
    let truth = reference.frames.iter().flatten().flatten().flatten();
    predicted
        .zip(truth)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}

#[test]
fn frozen_is_exact_when_the_garment_moves_and_turns_with_the_root() {
    assert!(worst(&mut Frozen::default(), clip(moving, |_| [0.5, 0.0, 0.0])) < 1e-5);
    assert!(
        worst(
            &mut Frozen::default(),
            clip(moving, |f| [0.1 * f as f64, 0.0, 0.0])
        ) > 0.3
    );
}

#[test]
fn hold_is_exact_when_the_garment_keeps_its_velocity_in_the_frame_of_the_root() {
    assert!(
        worst(
            &mut Hold::default(),
            clip(moving, |f| [0.1 * f as f64, 0.0, -0.05 * f as f64])
        ) < 2e-5
    );
    // A constant acceleration of 0.1 is missed by 0.1·(1 + 2 + 3 + 4).
    let accelerated = clip(|_| Root::default(), |f| [0.05 * (f * f) as f64, 0.0, 0.0]);
    let missed = worst(&mut Hold::default(), accelerated);
    assert!((missed - 1.0).abs() < 1e-4, "missed by {missed}");
}

#[test]
fn skinned_gives_the_rest_garment_on_a_body_at_rest_and_moves_rigidly_with_a_rigid_body() {
    assert!(
        worst(
            &mut Skinned::default(),
            clip(|_| Root::default(), |_| [0.0; 3])
        ) < 1e-6
    );
    assert!(worst(&mut Skinned::default(), clip(moving, |_| [0.0; 3])) < 1e-5);
}

#[test]
fn skinned_binds_at_the_first_frame_when_the_file_has_no_rest_body() {
    let mut without = clip(moving, |_| [0.0; 3]);
    without.header.body.rest.clear();
    assert!(worst(&mut Skinned::default(), without) < 1e-5);
}

#[test]
fn methods_never_see_the_frames_they_are_measured_against() {
    let (task, _) = clip(moving, |_| [0.0; 3]).split(2, STEPS).unwrap();
    for frame in &task.frames[3..] {
        assert!(frame.garments.is_empty());
        assert!(!frame.body.is_empty());
    }
}

#[test]
fn rollouts_without_history_or_beyond_the_end_are_refused() {
    let clip = || clip(moving, |_| [0.0; 3]);
    assert!(
        clip()
            .split(1, STEPS)
            .unwrap_err()
            .to_string()
            .contains("--start must be at least 2")
    );
    let error = clip().split(2, STEPS + 1).unwrap_err().to_string();
    assert!(
        error.contains("has 7 frames") && error.contains("needs 8"),
        "{error}"
    );
}

#[test]
fn a_prediction_that_is_not_a_number_names_its_place() {
    struct Broken;
    impl Method for Broken {
        fn name(&self) -> &str {
            "broken"
        }
        fn threads(&self) -> usize {
            1
        }
        fn begin(&mut self, _: &Task) -> Result<(), crate::EvalError> {
            Ok(())
        }
        fn step(&mut self, task: &Task, _: usize) -> Result<Vec<Positions>, crate::EvalError> {
            let mut garments = task.frames[task.start].garments.clone();
            garments[0][5][1] = f32::NAN;
            Ok(garments)
        }
    }
    let (task, _) = clip(moving, |_| [0.0; 3]).split(2, STEPS).unwrap();
    let error = roll_out(&mut Broken, &task, &mut || Ok(()))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("frame 3") && error.contains("vertex 5") && error.contains("garment0"),
        "{error}"
    );
}

//! The way back of a state that strayed.

use drape_dataset::sample::{State, StatePair, pair};
use drape_train::losses::returning;
use drape_train::step::advance;

/// A vertex that moves along a parabola: its state at a frame.
fn reference(frame: i32) -> State {
    let x = |t: f32| [0.3 * t, -0.1 * t * t, 0.02 * t * t];
    let (now, before) = (x(frame as f32), x(frame as f32 - 1.0));
    let v = [0, 1, 2].map(|axis| now[axis] - before[axis]);
    [now[0], now[1], now[2], v[0], v[1], v[2]]
}

/// Errors of position along an axis, frame by frame, when the target is reached each time.
fn errors(frames: f64, shift: f32, drift: f32) -> Vec<f32> {
    let mut strayed = reference(0);
    strayed[1] += shift;
    strayed[4] += drift;
    let mut state: Vec<StatePair> = vec![pair(&strayed, &strayed)];
    (1..40)
        .map(|frame| {
            let (recorded, before) = ([reference(frame)], [reference(frame - 1)]);
            let target = returning(frames, &recorded, &before, &state)
                .next()
                .unwrap();
            let a: Vec<f32> = (0..3)
                .map(|axis| target[axis] - state[0][axis] - state[0][3 + axis])
                .collect();
            let next = advance(&state, &a)[0];
            state = vec![pair(&next, &next)];
            next[1] - recorded[0][1]
        })
        .collect()
}

#[test]
fn one_frame_asks_for_the_recorded_position() {
    let state = [pair(&[5.0; 6], &[4.0; 6])];
    let recorded = [reference(3)];
    let before = [reference(2)];
    let found: Vec<State> = returning(1.0, &recorded, &before, &state).collect();
    assert_eq!(found, recorded);
}

#[test]
fn a_state_that_did_not_stray_is_led_to_the_recorded_position() {
    let state = [pair(&reference(2), &reference(1))];
    let recorded = [reference(3)];
    for frames in [1.0, 2.5, 5.0, 100.0] {
        let before = [reference(2)];
        let found: Vec<State> = returning(frames, &recorded, &before, &state).collect();
        assert_eq!(found, recorded, "{frames} frames");
    }
}

#[test]
fn an_error_dies_out_without_overshoot_at_the_rate_of_its_frames() {
    for frames in [2.0f64, 5.0] {
        let left = 1.0 - 1.0 / frames;
        // A shift that moves with (λ − 1) of itself per frame decays by λ each frame.
        let found = errors(frames, 1.0, (1.0 - 1.0 / left) as f32);
        for (frame, error) in found.iter().enumerate() {
            let expected = left.powi(frame as i32 + 1);
            assert!(
                (f64::from(*error) - expected).abs() < 1e-4,
                "{frames} frames, step {frame}: {error}, expected {expected}"
            );
        }
        // A shift at rest comes back from one side.
        let found = errors(frames, 1.0, 0.0);
        assert!(found.iter().all(|error| *error > -1e-4), "{found:?}");
        assert!(found.last().unwrap().abs() < 0.01, "{found:?}");
    }
}

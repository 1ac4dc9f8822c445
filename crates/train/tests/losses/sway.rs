//! Start states that have swayed.

use drape_dataset::random::stream;
use drape_dataset::sample::StatePair;
use drape_train::sway::sway;

use crate::outfit;

/// Two garments of 30 vertices each, standing apart; all at rest.
fn swayed(size: f32, seed: u64) -> Vec<StatePair> {
    let mut state = resting();
    sway(
        &mut state,
        &outfit(30, 30, Vec::new()),
        size,
        &mut stream(seed, "sway"),
    );
    state
}

fn resting() -> Vec<StatePair> {
    (0..60)
        .map(|vertex| {
            let x = [0.1 * vertex as f32, 0.0, 3.0];
            [
                x[0], x[1], x[2], 0.0, 0.0, 0.0, x[0], x[1], x[2], 0.0, 0.0, 0.0,
            ]
        })
        .collect()
}

#[test]
fn velocity_is_the_difference_of_the_frames() {
    let (state, rest) = (swayed(0.3, 1), resting());
    let mut largest = 0f32;
    for (row, rest) in state.iter().zip(&rest) {
        for axis in 0..3 {
            assert!((row[axis] - row[6 + axis] - row[3 + axis]).abs() < 1e-6);
            assert_eq!(row[3 + axis], row[9 + axis], "no acceleration is added");
            largest = largest.max((row[axis] - rest[axis]).abs());
        }
    }
    assert!(
        largest > 0.01,
        "nothing moved: the largest shift is {largest}"
    );
}

#[test]
fn shifts_are_smooth_and_stay_below_their_bound() {
    // One garment's neighbours are 0.1 units apart; waves are 3 units and longer.
    let steepest = 0.3 * 2.0 * 0.5 * std::f32::consts::TAU / 3.0 * 0.1;
    for seed in 0..20 {
        let (state, rest) = (swayed(0.3, seed), resting());
        let shift = |vertex: usize, axis: usize| state[vertex][axis] - rest[vertex][axis];
        for vertex in 0..60 {
            for axis in 0..3 {
                // Common 1, own 0.5, two waves of 0.5 each.
                assert!(shift(vertex, axis).abs() <= 0.3 * 2.5 + 1e-6);
                if vertex % 30 != 0 {
                    let step = (shift(vertex, axis) - shift(vertex - 1, axis)).abs();
                    assert!(step <= steepest + 1e-5, "{step} between neighbours");
                }
            }
        }
    }
}

#[test]
fn a_size_of_zero_moves_nothing_and_a_seed_gives_the_same_bits() {
    assert_eq!(swayed(0.0, 3), resting());
    assert_eq!(swayed(0.3, 3), swayed(0.3, 3));
    assert_ne!(swayed(0.3, 3), swayed(0.3, 4));
}

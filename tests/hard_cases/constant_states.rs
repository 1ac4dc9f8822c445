//! Constant and nearly constant states.
//!
//! Symptom: a column that never changes has standard deviation 0; one that nearly
//! never does turns rounding into inputs of any size.
//! Guarantee: a constant column is scaled by 1; with nearly constant ones the
//! network's output stays within a few standard deviations of the mean acceleration.

use drape_tests::scene::{Scene, SceneConfig};

#[test]
fn a_scene_at_rest_has_unit_scale_and_runs() {
    let (sample, statistics) = Scene::new(SceneConfig {
        motion: 0.0,
        ..SceneConfig::default()
    })
    .sample(4);
    assert_eq!(
        statistics.vertices.std[3..],
        [1.0; 6],
        "velocity and acceleration never change"
    );
    assert_eq!(statistics.vertices.mean[3..], [0.0; 6]);
    assert_eq!(statistics.root.std, [1.0; 9]);
    // The reference stays where it is, so the acceleration that leads back in five frames is
    // −(drift/25 + 0.36 v); the position loss is the mean square of what a differs from it.
    let run = super::run(&sample, &statistics);
    let target = sample.reference.last().unwrap();
    let mut expected = 0.0;
    let mut acceleration = Vec::new();
    run.trained.evaluation.accelerations(&mut acceleration);
    for ((state, target), a) in run
        .rolled
        .iter()
        .zip(target)
        .zip(acceleration.chunks_exact(3))
    {
        for axis in 0..3 {
            let drift = state[axis] - target[axis];
            expected += f64::from(0.04 * drift + 0.36 * state[3 + axis] + a[axis]).powi(2);
        }
    }
    expected /= target.len() as f64;
    let found = run.trained.losses.position;
    assert!(
        (found - expected).abs() < 1e-4 * expected,
        "{found}, expected {expected}"
    );
}

#[test]
fn a_nearly_constant_scene_gives_outputs_of_its_own_scale() {
    // Motion of 1e-5 units is 20 steps of f32 at the root's height: mostly rounding.
    let (sample, statistics) = Scene::new(SceneConfig {
        motion: 1e-5,
        ..SceneConfig::default()
    })
    .sample(4);
    let columns = &statistics.vertices;
    assert!(
        columns.std[6..].iter().all(|&std| std > 0.0 && std < 1e-5),
        "{:?}",
        columns.std
    );
    assert!(
        sample.steps[0].gravity[2].abs() > 1e3,
        "normalised gravity is huge: {:?}",
        sample.steps[0].gravity
    );
    let run = super::run(&sample, &statistics);
    let scale = columns.std[6..].iter().fold(0f32, |top, &std| top.max(std));
    let mean = columns.mean[6..]
        .iter()
        .fold(0f32, |top, &mean| top.max(mean.abs()));
    let largest = run.first.iter().fold(0f32, |top, a| top.max(a.abs()));
    assert!(
        largest < 2.0 * mean + 20.0 * scale,
        "{largest} with std {scale}, mean {mean}"
    );
}

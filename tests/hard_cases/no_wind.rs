//! No wind and zero quaternion.
//!
//! Symptom: normalising the quaternion (0, 0, 0, 0) divides by zero.
//! Guarantee: no wind gives the identity as rotation and zeros as input; the wind
//! token stays, because it also carries the root's motion.

use drape_dataset::sample::rotation_matrix;
use drape_model::frames::IDENTITY;
use drape_tests::scene::{Scene, SceneConfig};

#[test]
fn the_zero_quaternion_is_the_identity() {
    assert_eq!(rotation_matrix([0.0; 4]), IDENTITY);
    // Its neighbours: tiny quaternions still have a direction.
    let tiny = rotation_matrix([0.0, 1e-30, 0.0, 0.0]);
    assert_eq!(
        tiny,
        [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
        "half a turn about x"
    );
}

#[test]
fn a_scene_without_wind_runs_and_the_token_still_matters() {
    let (mut sample, statistics) = Scene::new(SceneConfig {
        wind: false,
        ..SceneConfig::default()
    })
    .sample(4);
    for step in &sample.steps {
        assert_eq!(step.wind_rotations, [IDENTITY; 2]);
        assert_eq!(step.wind[6..11], [0.0; 5]);
        assert_eq!(step.wind[17..22], [0.0; 5]);
    }
    let still = super::run(&sample, &statistics).first;
    sample.steps[0].wind[0] += 1.0;
    assert_ne!(
        super::run(&sample, &statistics).first,
        still,
        "the root's velocity is part of the token"
    );
}

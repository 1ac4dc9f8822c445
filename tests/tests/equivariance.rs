//! How equivariant the whole model is when the scene turns about the vertical.
//!
//! Only the body's messages and the decoder's frames turn along; states enter the
//! encoders as world coordinates, so exact equivariance is not expected. Statistics
//! as collected add a mean and a scale per axis that stay behind; level ones (no
//! horizontal mean, one horizontal scale) leave what the network itself does.
//! The test prints what it finds (`cargo test … -- --nocapture`) and asserts only
//! what holds for certain: a turn by 0 changes nothing, results are finite.

use drape_dataset::sample::{FrameStates, Sample, gravity_per_frame, turned};
use drape_dataset::statistics::{ColumnStatistics, Statistics};
use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig, states_of};

/// Statistics without a preferred horizontal direction.
fn level(statistics: &Statistics) -> Statistics {
    let columns = |columns: &ColumnStatistics| {
        let mut level = *columns;
        for x in [0, 3, 6] {
            let std = (0.5 * (columns.std[x].powi(2) + columns.std[x + 1].powi(2))).sqrt();
            (level.mean[x], level.mean[x + 1]) = (0.0, 0.0);
            (level.std[x], level.std[x + 1]) = (std, std);
        }
        level
    };
    Statistics {
        vertices: columns(&statistics.vertices),
        root: columns(&statistics.root),
    }
}

/// RMS of `R a(x) − a(R x)` over the RMS of `a(x)`.
fn difference(config: &ModelConfig, angle_rad: f64, level_statistics: bool) -> f64 {
    let scene = Scene::new(SceneConfig::default());
    let frames = scene.frames(12);
    let (states, collected) = states_of(&frames);
    let statistics = if level_statistics {
        level(&collected)
    } else {
        collected
    };
    let turned_frames: Vec<_> = frames
        .iter()
        .map(|frame| turned(frame, angle_rad))
        .collect();
    let parameters = Parameters::new(config, 5).unwrap();
    let net = LayersNet::frozen(config, &parameters).unwrap();
    let run = |states: &[FrameStates]| -> Vec<f32> {
        let gravity = gravity_per_frame(&scene.header);
        let sample = Sample::new(scene.outfit(), &states[2..5], &statistics, gravity);
        let step = &sample.steps[0];
        let prediction = net.forward(&sample.outfit, &statistics.vertices, &sample.state, step);
        prediction
            .unwrap()
            .acceleration
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap()
    };
    let (plain, other) = (run(&states), run(&states_of(&turned_frames).0));
    let (sin, cos) = angle_rad.sin_cos();
    let (mut error, mut size) = (0.0, 0.0);
    for (a, b) in plain.chunks_exact(3).zip(other.chunks_exact(3)) {
        let (a, b) = (
            [0, 1, 2].map(|i| f64::from(a[i])),
            [0, 1, 2].map(|i| f64::from(b[i])),
        );
        let expected = [cos * a[0] - sin * a[1], sin * a[0] + cos * a[1], a[2]];
        for axis in 0..3 {
            error += (expected[axis] - b[axis]).powi(2);
            size += a[axis].powi(2);
        }
    }
    (error / size).sqrt()
}

#[test]
fn turning_the_scene_turns_the_prediction_only_in_part() {
    for (name, config) in [
        ("default", ModelConfig::default()),
        ("released", ModelConfig::released()),
    ] {
        assert_eq!(
            difference(&config, 0.0, false),
            0.0,
            "{name}: no turn, no difference"
        );
        for degrees in [15.0, 45.0, 90.0, 180.0] {
            let [collected, level] =
                [false, true].map(|level| difference(&config, f64::to_radians(degrees), level));
            println!(
                "{name}, untrained, turned by {degrees:>3}°: difference {:5.1} % of the acceleration's RMS with \
                 statistics as collected, {:5.1} % with level ones",
                100.0 * collected,
                100.0 * level
            );
            assert!(collected.is_finite() && level.is_finite());
        }
    }
}

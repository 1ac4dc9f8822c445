//! Hard cases: inputs on which a learned garment model breaks in practice. One
//! file each, opening with the symptom and the guarantee; each asserts a value or
//! a message, not only finite numbers.

mod body_far_away;
mod coincident_vertices;
mod constant_states;
mod empty_attention_row;
mod long_rollout;
mod no_wind;
mod normal_along_frame_seed;
mod receiver_is_sender;
mod single_garment;
mod zero_area_face;

use drape_dataset::sample::{Sample, StatePair};
use drape_dataset::statistics::Statistics;
use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_train::losses::LossConfig;
use drape_train::step::{SampleGradient, roll_in, sample_gradient};

/// What a case yields when the default model runs on it.
struct Run {
    /// Accelerations of the first step, `[vertex · 3]`.
    first: Vec<f32>,
    /// State after all steps but the last, predictions fed back.
    rolled: Vec<StatePair>,
    /// Losses and gradients of the last step from that state.
    trained: SampleGradient,
}

/// Forward, rollout and backward; every number that comes out is finite.
fn run_with(parameters: &Parameters, sample: &Sample, statistics: &Statistics) -> Run {
    let config = ModelConfig::default();
    let net = LayersNet::trainable(&config, parameters).unwrap();
    let columns = &statistics.vertices;
    let first = net
        .forward(&sample.outfit, columns, &sample.state, &sample.steps[0])
        .unwrap();
    let first: Vec<f32> = first.acceleration.flatten_all().unwrap().to_vec1().unwrap();
    let mut rolled = Vec::new();
    roll_in(&net, columns, sample, 0, &mut rolled).unwrap();
    let losses = LossConfig::default();
    let trained =
        sample_gradient(&net, parameters, columns, &losses, sample, &rolled, true).unwrap();
    assert!(first.iter().all(|value| value.is_finite()), "accelerations");
    assert!(
        rolled.as_flattened().iter().all(|value| value.is_finite()),
        "rollout"
    );
    assert_eq!(trained.losses.not_finite(), None);
    for (name, gradient) in &trained.gradients {
        assert!(
            gradient.iter().all(|value| value.is_finite()),
            "gradient of {name}"
        );
    }
    Run {
        first,
        rolled,
        trained,
    }
}

/// [`run_with`] on fresh weights.
fn run(sample: &Sample, statistics: &Statistics) -> Run {
    run_with(
        &Parameters::new(&ModelConfig::default(), 2).unwrap(),
        sample,
        statistics,
    )
}

//! One backward pass of the default preset reaches every weight that influences
//! the prediction, and none other.

use drape_model::parameters::is_idle;
use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};
use drape_train::losses::LossConfig;
use drape_train::step::sample_gradient;

#[test]
fn every_weight_gets_a_finite_gradient_that_is_not_zero() {
    for config in [ModelConfig::default(), ModelConfig::released()] {
        let (sample, statistics) = Scene::new(SceneConfig::default()).sample(1);
        let parameters = Parameters::new(&config, 1).unwrap();
        let net = LayersNet::trainable(&config, &parameters).unwrap();
        let result = sample_gradient(
            &net,
            &parameters,
            &statistics.vertices,
            &LossConfig::default(),
            &sample,
            &sample.state,
            true,
        )
        .unwrap();
        assert!(
            result.evaluation.graph().body_tokens > 10,
            "the scene has a body in reach"
        );
        assert!(
            !result.evaluation.graph().edges.world.items.is_empty(),
            "and layers in reach"
        );
        assert!(result.losses.not_finite().is_none());
        for (name, variable) in parameters.iter() {
            match result.gradients.get(name) {
                None => assert!(is_idle(name, &config), "{name} gets no gradient"),
                Some(gradient) => {
                    assert!(
                        !is_idle(name, &config),
                        "{name} is said to influence nothing"
                    );
                    assert_eq!(gradient.len(), variable.elem_count(), "{name}");
                    assert!(gradient.iter().all(|value| value.is_finite()), "{name}");
                    assert!(
                        gradient.iter().any(|value| *value != 0.0),
                        "{name}: all zeros"
                    );
                }
            }
        }
    }
}

#[test]
fn the_default_has_the_published_number_of_weights() {
    let parameters = Parameters::new(&ModelConfig::default(), 0).unwrap();
    assert_eq!(parameters.count(), 1_018_719);
}

/// Two frames of `[pos, vel]`: what a layer says to a velocity held over both
/// frames, and to a change of it, against what it says to a position.
#[test]
fn weights_start_as_wide_as_the_states_they_read_are_narrow() {
    let parameters = Parameters::new(&ModelConfig::default(), 0).unwrap();
    let layers = [
        ("backbone.input_projection.layers.0.0.weight", 1.0, 4.0),
        ("decode_head.proj.layers.0.0.weight", 30.0, 100.0),
    ];
    for (name, velocity, change) in layers {
        let rows: Vec<Vec<f32>> = parameters.get(name).unwrap().to_vec2().unwrap();
        let spread = |of: &dyn Fn(&[f32], usize) -> f32| {
            let squares = rows
                .iter()
                .flat_map(|row| (0..3).map(move |axis| of(row, axis).powi(2)));
            (squares.sum::<f32>() / (3 * rows.len()) as f32).sqrt()
        };
        let position = spread(&|row, axis| row[axis]);
        let held = spread(&|row, axis| row[3 + axis] + row[9 + axis]) / position;
        let older = spread(&|row, axis| row[9 + axis]) / position;
        assert!((held / velocity - 1.0).abs() < 0.2, "{name}: {held}");
        assert!((older / change - 1.0).abs() < 0.2, "{name}: {older}");
    }
}

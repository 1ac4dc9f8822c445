//! Adam: the first step's size, and a resumed state that continues bit for bit.

use candle_core::DType;
use drape_model::{ModelConfig, Parameters};
use drape_train::adam::{Adam, Gradients};

const NAME: &str = "decode_head.proj.layers.2.bias";

fn values(parameters: &Parameters) -> Vec<f32> {
    parameters
        .get(NAME)
        .unwrap()
        .to_dtype(DType::F32)
        .unwrap()
        .to_vec1()
        .unwrap()
}

fn gradients(values: [f32; 3]) -> Gradients {
    [(NAME.to_string(), values.to_vec())].into()
}

#[test]
fn the_first_step_is_the_learning_rate_against_the_sign() {
    let parameters = Parameters::new(&ModelConfig::default(), 0).unwrap();
    let before = values(&parameters);
    Adam::default()
        .update(&parameters, &gradients([3.0, -1e-3, 0.0]), 0.01)
        .unwrap();
    for ((after, before), expected) in values(&parameters)
        .iter()
        .zip(&before)
        .zip([-0.01, 0.01, 0.0])
    {
        assert!(
            (after - before - expected).abs() < 1e-6,
            "{before} → {after}"
        );
    }
}

#[test]
fn a_saved_state_continues_bit_for_bit() {
    let steps = [[0.1, -2.0, 1e-6], [0.3, 0.5, -1e-6], [-0.2, 0.0, 4e-7]].map(gradients);
    let run = |saved_after: Option<usize>| {
        let parameters = Parameters::new(&ModelConfig::default(), 0).unwrap();
        let mut adam = Adam::default();
        for (index, step) in steps.iter().enumerate() {
            if saved_after == Some(index) {
                adam = Adam::from_tensors(adam.updates, &adam.to_tensors().unwrap()).unwrap();
            }
            adam.update(&parameters, step, 0.01).unwrap();
        }
        values(&parameters)
            .into_iter()
            .map(f32::to_bits)
            .collect::<Vec<_>>()
    };
    assert_eq!(run(Some(2)), run(None));
}

#[test]
fn half_a_state_is_refused_by_name() {
    let parameters = Parameters::new(&ModelConfig::default(), 0).unwrap();
    let mut adam = Adam::default();
    adam.update(&parameters, &gradients([1.0, 1.0, 1.0]), 0.01)
        .unwrap();
    let mut tensors = adam.to_tensors().unwrap();
    tensors.remove(&format!("v/{NAME}")).unwrap();
    let message = Adam::from_tensors(1, &tensors).unwrap_err().to_string();
    assert!(
        message.contains(&format!("v/{NAME} is missing")),
        "{message}"
    );
}

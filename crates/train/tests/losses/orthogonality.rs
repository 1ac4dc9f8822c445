//! The regulariser of rotation weights: its constant, and its gradient.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};
use drape_model::parameters::{group_rotation_name, rotation_name};
use drape_model::{ModelConfig, Parameters};
use drape_train::losses::orthogonality::orthogonality;

/// Fresh weights in f64, rotation weights pushed off orthogonality.
fn parameters(config: &ModelConfig, noise: f64) -> Parameters {
    let tensors: BTreeMap<String, Tensor> = Parameters::new(config, 9)
        .unwrap()
        .iter()
        .map(|(name, variable)| {
            let mut values: Vec<f64> = variable
                .to_dtype(DType::F64)
                .unwrap()
                .flatten_all()
                .unwrap()
                .to_vec1()
                .unwrap();
            for (i, value) in values.iter_mut().enumerate() {
                *value += noise * (0.7 * i as f64 + 0.2).sin();
            }
            (
                name.to_string(),
                Tensor::from_vec(values, variable.shape(), &Device::Cpu).unwrap(),
            )
        })
        .collect();
    Parameters::from_tensors(tensors, config, DType::F64).unwrap()
}

#[test]
fn fresh_weights_have_only_the_constant_of_333() {
    let config = ModelConfig::default();
    let all = orthogonality(&config, &parameters(&config, 0.0)).unwrap();
    // 16 head groups of 16 − 3, and 128 − 3.
    assert_eq!(all.constant, 333.0);
    assert!(all.value < 1e-10, "{}", all.value);
    assert_eq!(all.gradients.len(), 17);
}

#[test]
fn value_and_constant_together_are_the_published_formula() {
    let config = ModelConfig {
        blocks: 1,
        ..ModelConfig::default()
    };
    let parameters = parameters(&config, 0.2);
    let all = orthogonality(&config, &parameters).unwrap();
    let names = (0..4)
        .map(|group| group_rotation_name(0, group))
        .chain([rotation_name()]);
    let excess = |a: &Tensor, b: &Tensor| -> f64 {
        let product = a
            .contiguous()
            .unwrap()
            .matmul(&b.contiguous().unwrap())
            .unwrap();
        let identity = Tensor::eye(product.dim(0).unwrap(), DType::F64, &Device::Cpu).unwrap();
        (product - identity)
            .unwrap()
            .sqr()
            .unwrap()
            .sum_all()
            .unwrap()
            .to_scalar()
            .unwrap()
    };
    let expected: f64 = names
        .map(|name| {
            let w = parameters.get(&name).unwrap().as_tensor().clone();
            let t = w.t().unwrap();
            excess(&w, &t) + excess(&t, &w)
        })
        .sum();
    assert!(
        (all.value + all.constant - expected).abs() < 1e-10 * expected,
        "{} + {}",
        all.value,
        all.constant
    );
}

#[test]
fn gradient_equals_finite_differences() {
    let config = ModelConfig {
        blocks: 1,
        ..ModelConfig::default()
    };
    let parameters = parameters(&config, 0.2);
    let all = orthogonality(&config, &parameters).unwrap();
    for (name, gradient) in &all.gradients {
        let variable = parameters.get(name).unwrap();
        let values: Vec<f64> = variable.flatten_all().unwrap().to_vec1().unwrap();
        for entry in (0..values.len()).step_by(7) {
            let at = |shift: f64| {
                let mut moved = values.clone();
                moved[entry] += shift;
                variable
                    .set(&Tensor::from_vec(moved, variable.shape(), &Device::Cpu).unwrap())
                    .unwrap();
                orthogonality(&config, &parameters).unwrap().value
            };
            let expected = (at(1e-6) - at(-1e-6)) / 2e-6;
            at(0.0);
            assert!(
                (gradient[entry] - expected).abs() < 1e-6,
                "{name}[{entry}]: {}, expected {expected}",
                gradient[entry]
            );
        }
    }
}

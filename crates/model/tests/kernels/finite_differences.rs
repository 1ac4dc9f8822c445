//! Gradients against central differences in f64: with step h = 1e-6 their error is
//! of order h² f''' + 1e-16 f/h, about 1e-10 for functions of size 1.

use candle_core::{Device, Result, Tensor, Var};

use crate::{flat, random};

const STEP: f64 = 1e-6;

/// Compares the gradient of `Σ cotangent · f(inputs)` by every entry of every input.
pub fn check(inputs: &[Tensor], f: impl Fn(&[Tensor]) -> Result<Tensor>, bar: f64) {
    check_every(&vec![1; inputs.len()], inputs, f, bar);
}

/// [`check`] for one entry in so many of each input.
pub fn check_every(
    strides: &[usize],
    inputs: &[Tensor],
    f: impl Fn(&[Tensor]) -> Result<Tensor>,
    bar: f64,
) {
    let variables: Vec<Var> = inputs
        .iter()
        .map(|x| Var::from_tensor(x).unwrap())
        .collect();
    let tensors: Vec<Tensor> = variables.iter().map(|x| x.as_tensor().clone()).collect();
    let out = f(&tensors).unwrap();
    let cotangent = random("cotangent", out.shape().clone());
    let loss = |out: &Tensor| (out * &cotangent).unwrap().sum_all().unwrap();
    let gradients = loss(&out).backward().unwrap();
    for (which, variable) in variables.iter().enumerate() {
        let gradient = flat(
            gradients
                .get(variable)
                .unwrap_or_else(|| panic!("input {which} gets no gradient")),
        );
        let size = gradient
            .iter()
            .fold(1f64, |top, value| top.max(value.abs()));
        let values = flat(&inputs[which]);
        for (entry, found) in gradient.iter().enumerate().step_by(strides[which]) {
            let at = |shift: f64| -> f64 {
                let mut moved = values.clone();
                moved[entry] += shift;
                let mut all: Vec<Tensor> = inputs.to_vec();
                all[which] = Tensor::from_vec(moved, inputs[which].shape(), &Device::Cpu).unwrap();
                flat(&loss(&f(&all).unwrap()))[0]
            };
            let expected = (at(STEP) - at(-STEP)) / (2.0 * STEP);
            assert!(
                (found - expected).abs() <= bar * size,
                "input {which}, entry {entry}: {found}, expected {expected}"
            );
        }
    }
}

//! One gradient step's work for one sample: steps without gradient, then forward,
//! losses and backward.
//!
//! With n steps before the gradient and a switch u ≤ n, the state is the
//! reference up to step u and the model's own prediction after it. A prediction
//! that would be replaced by the reference is not computed.

use drape_dataset::sample::{Sample, State, StatePair, pair};
use drape_dataset::statistics::ColumnStatistics;
use drape_model::parameters::is_idle;
use drape_model::{LayersNet, Parameters, Prediction};

use crate::adam::Gradients;
use crate::error::Result;
use crate::losses::{LossConfig, LossValues, all_terms, integrate, returning, squared_error};

/// Predicted states `[pos, vel]` of a step, and the accelerations `[vertex · 3]`.
pub fn advance(states: &[StatePair], accelerations: &[f32]) -> Vec<State> {
    states
        .iter()
        .zip(accelerations.chunks_exact(3))
        .map(|(s, a)| {
            let v = [0, 1, 2].map(|axis| a[axis] + s[3 + axis]);
            [v[0] + s[0], v[1] + s[1], v[2] + s[2], v[0], v[1], v[2]]
        })
        .collect()
}

/// State fed to the gradient step: the reference before step `switch`, predictions from there on.
///
/// # Errors
/// If the model refuses a state.
pub fn roll_in(
    net: &LayersNet,
    statistics: &ColumnStatistics,
    sample: &Sample,
    switch: usize,
) -> Result<Vec<StatePair>> {
    let mut state = sample.state.clone();
    for (k, step) in sample.steps[..sample.steps.len() - 1].iter().enumerate() {
        let next = if k < switch {
            sample.reference[k].clone()
        } else {
            let prediction = net.forward(&sample.outfit, statistics, &state, step)?;
            advance(&state, &prediction.acceleration.flatten_all()?.to_vec1()?)
        };
        for (state, next) in state.iter_mut().zip(&next) {
            *state = pair(next, &std::array::from_fn(|column| state[column]));
        }
    }
    Ok(state)
}

/// What one sample contributes.
pub struct SampleGradient {
    /// Loss terms.
    pub losses: LossValues,
    /// Gradient of every weight that influences the loss, without the orthogonality regulariser.
    pub gradients: Gradients,
    /// What the network predicted.
    pub prediction: Prediction,
}

/// Forward, losses and backward from `state` over the sample's last step.
///
/// # Errors
/// If the model refuses the state or a product fails.
pub fn sample_gradient(
    net: &LayersNet,
    parameters: &Parameters,
    statistics: &ColumnStatistics,
    losses: &LossConfig,
    sample: &Sample,
    state: &[StatePair],
    with_collisions: bool,
) -> Result<SampleGradient> {
    let step = sample.steps.last().expect("a sample has a step");
    let reference = sample.reference.last().expect("a sample has a reference");
    let prediction = net.forward(&sample.outfit, statistics, state, step)?;
    let dtype = prediction.acceleration.dtype();
    let values = |tensor: &candle_core::Tensor| -> Result<Vec<f32>> {
        Ok(tensor
            .to_dtype(candle_core::DType::F32)?
            .flatten_all()?
            .to_vec1()?)
    };
    let predicted = integrate(state, &values(&prediction.acceleration)?);
    let patches = integrate(
        &prediction.graph.patch_states,
        &values(&prediction.patch_acceleration)?,
    );
    let before: Vec<State> = match sample.reference.as_slice() {
        [.., before, _] => before.clone(),
        _ => sample
            .state
            .iter()
            .map(|row| std::array::from_fn(|column| row[column]))
            .collect(),
    };
    let reference = &returning(losses.return_frames, reference, &before, state);
    let weight = losses.position;
    let (mut losses, by_vertex, by_patch) = all_terms(
        losses,
        &sample.outfit,
        step,
        &predicted,
        &patches,
        reference,
        with_collisions,
    );
    let truth: Vec<[f64; 3]> = reference
        .iter()
        .map(|row| [0, 1, 2].map(|axis| f64::from(row[axis])))
        .collect();
    let held = integrate(state, &vec![0.0; 3 * state.len()]);
    losses.hold = weight * squared_error(&held, &truth).value;
    // The losses' gradients are known, so a linear form with these coefficients
    // carries them into the graph.
    let form = |output: &candle_core::Tensor,
                gradient: &[[f64; 3]]|
     -> Result<candle_core::Tensor> {
        let flat: Vec<f64> = gradient.as_flattened().to_vec();
        let coefficients = candle_core::Tensor::from_vec(flat, output.shape(), output.device())?
            .to_dtype(dtype)?;
        Ok((output * coefficients)?.sum_all()?)
    };
    let total = (form(&prediction.acceleration, &by_vertex)?
        + form(&prediction.patch_acceleration, &by_patch)?)?;
    let store = total.backward()?;
    let mut gradients = Gradients::new();
    for (name, variable) in parameters.iter() {
        if is_idle(name, net.config()) {
            continue;
        }
        if let Some(gradient) = store.get(variable) {
            gradients.insert(name.to_string(), values(gradient)?);
        }
    }
    Ok(SampleGradient {
        losses,
        gradients,
        prediction,
    })
}

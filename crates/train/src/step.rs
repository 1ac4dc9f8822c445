//! One gradient step's work for one sample: steps without gradient, then forward,
//! losses and backward.
//!
//! With n steps before the gradient and a switch u ≤ n, the state is the
//! reference up to step u and the model's own prediction after it. A prediction
//! that would be replaced by the reference is not computed.

use std::sync::Mutex;
use std::time::Instant;

use drape_dataset::sample::{Sample, State, StatePair, pair};
use drape_dataset::statistics::ColumnStatistics;
use drape_model::kernels::Shelved;
use drape_model::parameters::is_idle;
use drape_model::{Evaluation, LayersNet, Parameters};

use crate::adam::Gradients;
use crate::error::Result;
use crate::losses::terms::Terms;
use crate::losses::{
    LossConfig, LossValues, Vector, integrate, mean_square, returning, stray_factors,
};

/// What a sample's steps are computed in, beside the network's buffers; the next sample uses it again.
#[derive(Default)]
struct Room {
    accelerations: Vec<f32>,
    /// Positions without acceleration.
    held: Vec<Vector>,
    terms: Terms,
}

impl Shelved for Room {
    fn shelf() -> &'static Mutex<Vec<Self>> {
        static SHELF: Mutex<Vec<Room>> = Mutex::new(Vec::new());
        &SHELF
    }
}

/// Predicted states `[pos, vel]` of a step, and the accelerations `[vertex · 3]`.
pub fn advance(states: &[StatePair], accelerations: &[f32]) -> Vec<State> {
    states
        .iter()
        .zip(accelerations.chunks_exact(3))
        .map(|(s, a)| moved(s, a))
        .collect()
}

/// [`advance`] in place: the states become the predicted ones, with those they were before.
pub fn advance_pairs(states: &mut [StatePair], accelerations: &[f32]) {
    for (state, a) in states.iter_mut().zip(accelerations.chunks_exact(3)) {
        let older: State = std::array::from_fn(|column| state[column]);
        *state = pair(&moved(&older, a), &older);
    }
}

/// `[pos, vel]` after a step.
fn moved(s: &[f32], a: &[f32]) -> State {
    let v = [0, 1, 2].map(|axis| a[axis] + s[3 + axis]);
    [v[0] + s[0], v[1] + s[1], v[2] + s[2], v[0], v[1], v[2]]
}

/// State fed to the gradient step, into a buffer: the reference before step `switch`, predictions
/// from there on.
///
/// # Errors
/// If the model refuses a state.
pub fn roll_in(
    net: &LayersNet,
    statistics: &ColumnStatistics,
    sample: &Sample,
    switch: usize,
    state: &mut Vec<StatePair>,
) -> Result<()> {
    state.clone_from(&sample.state);
    let mut room = Room::take();
    for (k, step) in sample.steps[..sample.steps.len() - 1].iter().enumerate() {
        if k < switch {
            for (state, next) in state.iter_mut().zip(&sample.reference[k]) {
                *state = pair(next, &std::array::from_fn(|column| state[column]));
            }
        } else {
            let evaluation = net.evaluate(&sample.outfit, statistics, state, step)?;
            evaluation.accelerations(&mut room.accelerations);
            advance_pairs(state, &room.accelerations);
        }
    }
    room.put_back();
    Ok(())
}

/// What the last step of a sample shall reach from `state`; see [`returning`].
pub fn target<'a>(
    return_frames: f64,
    sample: &'a Sample,
    state: &'a [StatePair],
) -> impl Iterator<Item = State> {
    let (reference, earlier) = match sample.reference.as_slice() {
        [.., before, reference] => (reference, Some(before)),
        [reference] => (reference, None),
        [] => unreachable!("a sample has a reference"),
    };
    let before = (0..reference.len()).map(move |vertex| match earlier {
        Some(before) => &before[vertex],
        None => sample.state[vertex]
            .first_chunk()
            .expect("six of twelve columns"),
    });
    returning(return_frames, reference, before, state)
}

/// What one sample contributes.
pub struct SampleGradient {
    /// Loss terms.
    pub losses: LossValues,
    /// Gradient of every weight that influences the loss, without the orthogonality regulariser.
    pub gradients: Gradients,
    /// What the network says about the sample's last step.
    pub evaluation: Evaluation,
    /// Seconds of the losses, and of the backward pass.
    pub seconds: [f64; 2],
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
    let mut evaluation = net.evaluate(&sample.outfit, statistics, state, step)?;
    let started = Instant::now();
    let mut room = Room::take();
    let Room {
        accelerations,
        held,
        terms,
    } = &mut room;
    evaluation.accelerations(accelerations);
    refill(&mut terms.predicted, integrate(state, rows(accelerations)));
    evaluation.patch_accelerations(accelerations);
    let patches = integrate(&evaluation.graph().patch_states, rows(accelerations));
    refill(&mut terms.predicted_patches, patches);
    let reference = target(losses.return_frames, sample, state);
    refill(&mut terms.reference, reference);
    let (weight, discount) = (losses.position, losses.stray_discount);
    let mut losses = terms.evaluate(losses, &sample.outfit, step, with_collisions);
    refill(held, integrate(state, std::iter::repeat([0.0; 3])));
    losses.hold = weight * mean_square(held, &terms.truth);
    let (by_vertex, by_patch) = (&mut terms.by_vertex, &mut terms.by_patch);
    if discount > 0.0 {
        let squared = statistics.std[6..9].iter().map(|s| f64::from(*s).powi(2));
        let outfit = &sample.outfit;
        let factors = stray_factors(discount, squared.sum(), outfit, held, &terms.truth);
        let starts = &outfit.garment_offsets;
        let garment_of = |vertex: usize| starts.partition_point(|&start| start <= vertex) - 1;
        let scale = |gradient: &mut Vector, vertex: usize| {
            *gradient = gradient.map(|value| value * factors[garment_of(vertex)]);
        };
        for (vertex, gradient) in by_vertex.iter_mut().enumerate() {
            scale(gradient, vertex);
        }
        for (members, gradient) in outfit.patches.members.iter().zip(&mut *by_patch) {
            scale(gradient, members[0] as usize);
        }
    }
    let losses_s = started.elapsed().as_secs_f64();
    let started = Instant::now();
    let mut gradients = Gradients::new();
    let all = net.gradients(parameters, &mut evaluation, by_vertex, by_patch)?;
    room.put_back();
    for (name, gradient) in all {
        if !is_idle(&name, net.config()) {
            let gradient = gradient.to_dtype(candle_core::DType::F32)?;
            gradients.insert(name, gradient.flatten_all()?.to_vec1()?);
        }
    }
    Ok(SampleGradient {
        losses,
        gradients,
        evaluation,
        seconds: [losses_s, started.elapsed().as_secs_f64()],
    })
}

/// Other items into a list's memory.
fn refill<I>(list: &mut Vec<I>, items: impl IntoIterator<Item = I>) {
    list.clear();
    list.extend(items);
}

/// Vectors of a flat list.
fn rows(values: &[f32]) -> impl Iterator<Item = [f32; 3]> {
    values.as_chunks().0.iter().copied()
}

//! The paper's losses, on positions relative to the root, with their gradients.
//!
//! | term | formula | default weight |
//! |---|---|---|
//! | position | 1/N Σ |x̂ − x|² | 1 |
//! | patch | 1/P Σ |x̂_p − mean of members|² | 1 |
//! | normal | 1/N Σ |n̂ − n|² of vertex normals | 1 |
//! | body collision | nearest-vertex planes of the body, [`collision`] | 1.0 |
//! | layer collision | the same between layers | 0.1 |
//! | orthogonality | Σ_W ‖WWᵀ−I‖² + ‖WᵀW−I‖² of the rotation weights | 1 |
//!
//! The reference x of a gradient step that follows steps without gradient is not
//! the recorded position but a way back to it, see [`returning`].
//! Since x̂ = x + v + a, the gradient by position is the gradient by the
//! network's acceleration; terms are computed in f64 outside the tensor graph, in
//! memory that the next sample uses again ([`terms`]).
//! Source: the published program's description, section 10.

pub mod collision;
pub mod normal;
pub mod orthogonality;
pub mod terms;

use serde::{Deserialize, Serialize};

use drape_dataset::sample::{Outfit, State, StatePair};

use collision::{CollisionConfig, CollisionMean};

/// A vector in f64.
pub type Vector = [f64; 3];

/// A term's value and its gradient by position, `[vertex, 3]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Term {
    /// Value.
    pub value: f64,
    /// Gradient by position.
    pub gradient: Vec<Vector>,
}

impl Term {
    /// Becomes zero, in the same memory.
    fn clear(&mut self, vertices: usize) {
        self.value = 0.0;
        zeros(&mut self.gradient, vertices);
    }

    /// Adds the weighted gradient to `gradient`; returns the weighted value.
    fn add_to(&self, gradient: &mut [Vector], weight: f64) -> f64 {
        for (sum, value) in gradient.iter_mut().zip(&self.gradient) {
            for axis in 0..3 {
                sum[axis] += weight * value[axis];
            }
        }
        weight * self.value
    }
}

/// Weights and choices of the losses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Weight of the position loss. Default 1.
    pub position: f64,
    /// Weight of the patch loss. Default 1.
    pub patch: f64,
    /// Weight of the normal loss. Default 1.
    pub normal: f64,
    /// Weight of the body collision loss after the warm-up. Default 1; the released program uses 1.3.
    pub body_collision: f64,
    /// Weight of the layer collision loss after the warm-up. Default 0.1.
    pub layer_collision: f64,
    /// Weight of the orthogonality regulariser. Default 1.
    pub orthogonality: f64,
    /// Frames in which a state that strayed shall return to the reference, see
    /// [`returning`]. Default 5; 1, at once, is the published program's.
    pub return_frames: f64,
    /// How much less a garment counts the farther it strayed, see [`stray_factors`]. Default 5;
    /// 0, all count alike, is the published program's.
    pub stray_discount: f64,
    /// How collisions are found and averaged.
    pub collision: CollisionConfig,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            position: 1.0,
            patch: 1.0,
            normal: 1.0,
            body_collision: 1.0,
            layer_collision: 0.1,
            orthogonality: 1.0,
            return_frames: 5.0,
            stray_discount: 5.0,
            collision: CollisionConfig::default(),
        }
    }
}

impl LossConfig {
    /// The published program's choices.
    pub fn released() -> Self {
        Self {
            body_collision: 1.3,
            return_frames: 1.0,
            stray_discount: 0.0,
            collision: CollisionConfig {
                threshold: 1e-3,
                reach: None,
                skip_borders: false,
                mean: CollisionMean::Hits,
            },
            ..Self::default()
        }
    }
}

/// Values of all terms of one sample; collision terms are weighted, the others have weight 1 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossValues {
    /// Position, weighted.
    pub position: f64,
    /// Patch, weighted.
    pub patch: f64,
    /// Normal, weighted.
    pub normal: f64,
    /// Body collision, weighted.
    pub body_collision: f64,
    /// Layer collision, weighted.
    pub layer_collision: f64,
    /// Position loss of predicting no acceleration (x + v), with the position
    /// loss's weight: not part of the total, but what it has to beat.
    pub hold: f64,
}

impl LossValues {
    /// Sum of the terms, without the orthogonality regulariser.
    pub fn total(&self) -> f64 {
        self.position + self.patch + self.normal + self.body_collision + self.layer_collision
    }

    /// Adds another sample's terms times `weight`.
    pub fn add(&mut self, other: &Self, weight: f64) {
        self.position += weight * other.position;
        self.patch += weight * other.patch;
        self.normal += weight * other.normal;
        self.body_collision += weight * other.body_collision;
        self.layer_collision += weight * other.layer_collision;
        self.hold += weight * other.hold;
    }

    /// Name of the first term that is not finite.
    pub fn not_finite(&self) -> Option<&'static str> {
        let terms = [
            ("loss position", self.position),
            ("loss patch", self.patch),
            ("loss normal", self.normal),
            ("loss body collision", self.body_collision),
            ("loss layer collision", self.layer_collision),
        ];
        terms
            .into_iter()
            .find(|(_, value)| !value.is_finite())
            .map(|(name, _)| name)
    }
}

/// Zero vectors, in the same memory.
fn zeros(list: &mut Vec<Vector>, len: usize) {
    list.clear();
    list.resize(len, [0.0; 3]);
}

/// Mean squared distance of rows, without its gradient.
pub fn mean_square(predicted: &[Vector], reference: &[Vector]) -> f64 {
    let n = predicted.len().max(1) as f64;
    let mut sum = 0.0;
    for (x, y) in predicted.iter().zip(reference) {
        for axis in 0..3 {
            let d = x[axis] - y[axis];
            sum += d * d / n;
        }
    }
    sum
}

/// Mean squared distance of rows.
pub fn squared_error(predicted: &[Vector], reference: &[Vector], term: &mut Term) {
    let n = predicted.len().max(1) as f64;
    term.clear(predicted.len());
    term.value = mean_square(predicted, reference);
    for ((x, y), gradient) in predicted.iter().zip(reference).zip(&mut term.gradient) {
        for axis in 0..3 {
            gradient[axis] = 2.0 * (x[axis] - y[axis]) / n;
        }
    }
}

/// The reference after a step for a state that strayed: a critically damped return.
///
/// With Δx and Δv what the state lacks to the reference before the step, the
/// network's acceleration shall be the reference's plus `(1−λ)² Δx + (1−λ²) Δv`,
/// λ = 1 − 1/`frames`: what is left of the error falls by λ a frame, without
/// overshoot. The result is `x − (1 − (1−λ)²) Δx − λ² Δv`, x the recorded position.
/// `frames` = 1 gives x itself, the published loss: then all of the error is to be
/// made up for in one frame, and since little of it can be told from the state, its
/// size drowns what can be learnt.
pub fn returning<'a>(
    frames: f64,
    recorded: &'a [State],
    recorded_before: impl IntoIterator<Item = &'a State>,
    state: &'a [StatePair],
) -> impl Iterator<Item = State> {
    let left = 1.0 - 1.0 / frames;
    let keep_x = (1.0 - (1.0 - left).powi(2)) as f32;
    let keep_v = left.powi(2) as f32;
    let rows = recorded.iter().zip(recorded_before).zip(state);
    rows.map(move |((recorded, before), state)| {
        let mut target = *recorded;
        if left > 0.0 {
            for axis in 0..3 {
                target[axis] -= keep_x * (before[axis] - state[axis])
                    + keep_v * (before[3 + axis] - state[3 + axis]);
            }
        }
        target
    })
}

/// What each garment's gradient is multiplied with: `a²/(a² + discount · h)`.
///
/// a² is the mean squared acceleration of the training set, h the garment's position loss if it
/// were predicted no acceleration (`held`, positions x + v). After steps without gradient, h is mostly the
/// error of those steps, little of which the state tells: with equal weights this noise drowns
/// what can be learnt, and Adam's second moment keeps the rate down after.
pub fn stray_factors(
    discount: f64,
    squared_acceleration: f64,
    outfit: &Outfit,
    held: &[Vector],
    truth: &[Vector],
) -> Vec<f64> {
    let garments = outfit.garment_offsets.windows(2);
    garments
        .map(|ends| {
            let range = ends[0]..ends[1];
            let h = mean_square(&held[range.clone()], &truth[range]);
            squared_acceleration / (squared_acceleration + discount * h)
        })
        .collect()
}

/// Positions after a step: x + v + a, in f64.
pub fn integrate(
    states: &[StatePair],
    accelerations: impl IntoIterator<Item = [f32; 3]>,
) -> impl Iterator<Item = Vector> {
    states
        .iter()
        .zip(accelerations)
        .map(|(s, a)| [0, 1, 2].map(|axis| f64::from((a[axis] + s[3 + axis]) + s[axis])))
}

/// A state's position in f64.
pub fn position(row: &State) -> Vector {
    [f64::from(row[0]), f64::from(row[1]), f64::from(row[2])]
}

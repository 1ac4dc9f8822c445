//! Adam with its moments in the open, so that a resumed run continues bit for bit.
//!
//! `m ← β₁m + (1−β₁)g`, `v ← β₂v + (1−β₂)g²`,
//! `w ← w − lr · m/(1−β₁ᵗ) / (sqrt(v/(1−β₂ᵗ)) + 1e-8)`, β = (0.9, 0.999).

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};
use drape_model::Parameters;

use crate::error::{Result, TrainError};

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// Gradients by weight name.
pub type Gradients = BTreeMap<String, Vec<f32>>;

/// The optimiser's state.
#[derive(Clone, Debug, Default)]
pub struct Adam {
    /// Updates done.
    pub updates: u64,
    moments: BTreeMap<String, [Vec<f32>; 2]>,
}

impl Adam {
    /// Updates the weights that have a gradient.
    ///
    /// # Errors
    /// If a gradient does not fit its weight.
    pub fn update(
        &mut self,
        parameters: &Parameters,
        gradients: &Gradients,
        learning_rate: f64,
    ) -> Result<()> {
        self.updates += 1;
        let steps = i32::try_from(self.updates).unwrap_or(i32::MAX);
        let (fix1, fix2) = (1.0 - BETA1.powi(steps), 1.0 - BETA2.powi(steps));
        let step = (learning_rate / fix1) as f32;
        let root = (1.0 / fix2.sqrt()) as f32;
        let (b1, b2) = (BETA1 as f32, BETA2 as f32);
        for (name, gradient) in gradients {
            let variable = parameters.get(name)?;
            let mut weights: Vec<f32> = variable.as_tensor().flatten_all()?.to_vec1()?;
            let [m, v] = self
                .moments
                .entry(name.clone())
                .or_insert_with(|| [vec![0.0; weights.len()], vec![0.0; weights.len()]]);
            assert!(
                gradient.len() == weights.len() && m.len() == weights.len(),
                "gradient of {name} fits"
            );
            for (((w, &g), m), v) in weights.iter_mut().zip(gradient).zip(m).zip(v) {
                *m = b1 * *m + (1.0 - b1) * g;
                *v = b2 * *v + (1.0 - b2) * g * g;
                *w -= step * *m / (v.sqrt() * root + EPSILON as f32);
            }
            variable.set(&Tensor::from_vec(weights, variable.shape(), &Device::Cpu)?)?;
        }
        Ok(())
    }

    /// Moments as tensors named `m/<weight>` and `v/<weight>`.
    ///
    /// # Errors
    /// If candle cannot make a tensor.
    pub fn to_tensors(&self) -> Result<BTreeMap<String, Tensor>> {
        let mut tensors = BTreeMap::new();
        for (name, moments) in &self.moments {
            for (kind, values) in ["m", "v"].iter().zip(moments) {
                tensors.insert(
                    format!("{kind}/{name}"),
                    Tensor::new(values.as_slice(), &Device::Cpu)?,
                );
            }
        }
        Ok(tensors)
    }

    /// The state saved by [`Adam::to_tensors`].
    ///
    /// # Errors
    /// [`TrainError::Run`] if a moment lacks its pair.
    pub fn from_tensors(updates: u64, tensors: &BTreeMap<String, Tensor>) -> Result<Self> {
        let mut moments = BTreeMap::new();
        for (name, tensor) in tensors {
            let Some(weight) = name.strip_prefix("m/") else {
                continue;
            };
            let second = tensors
                .get(&format!("v/{weight}"))
                .ok_or_else(|| TrainError::Run {
                    path: "optimiser state".into(),
                    cause: format!("moment v/{weight} is missing: the checkpoint is not whole"),
                })?;
            let read = |tensor: &Tensor| -> Result<Vec<f32>> {
                Ok(tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?)
            };
            moments.insert(weight.to_string(), [read(tensor)?, read(second)?]);
        }
        Ok(Self { updates, moments })
    }
}

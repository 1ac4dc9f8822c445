//! Orthogonality regulariser of the rotation weights W `[d, 3]`.
//!
//! `‖WWᵀ − I_d‖² + ‖WᵀW − I₃‖² = 2‖G − I₃‖² + (d − 3)` with G = WᵀW, so its
//! gradient is `8 W (G − I₃)`. The constant d − 3 (333 for the whole model) cannot
//! be trained away; it is reported apart.

use drape_model::parameters::{group_rotation_name, rotation_name};
use drape_model::{ModelConfig, Parameters};

use crate::error::Result;

/// Value without the constant, the constant, and the gradient of each rotation weight.
pub struct Orthogonality {
    /// Σ 2‖WᵀW − I‖².
    pub value: f64,
    /// Σ (d − 3).
    pub constant: f64,
    /// Gradient by name, row-major `[d, 3]`.
    pub gradients: Vec<(String, Vec<f64>)>,
}

/// The regulariser of all rotation weights.
///
/// # Errors
/// If a weight is missing.
pub fn orthogonality(config: &ModelConfig, parameters: &Parameters) -> Result<Orthogonality> {
    let mut names = vec![rotation_name()];
    for block in 0..config.blocks {
        names.extend(
            (0..drape_model::kernels::attention::GROUPS)
                .map(|group| group_rotation_name(block, group)),
        );
    }
    let mut all = Orthogonality {
        value: 0.0,
        constant: 0.0,
        gradients: Vec::new(),
    };
    for name in names {
        let weight = parameters
            .get(&name)?
            .as_tensor()
            .to_dtype(candle_core::DType::F64)?;
        let w: Vec<f64> = weight.flatten_all()?.to_vec1()?;
        let mut excess = [[0f64; 3]; 3];
        for row in w.chunks_exact(3) {
            for i in 0..3 {
                for j in 0..3 {
                    excess[i][j] += row[i] * row[j];
                }
            }
        }
        for (axis, row) in excess.iter_mut().enumerate() {
            row[axis] -= 1.0;
        }
        all.value += 2.0
            * excess
                .iter()
                .flatten()
                .map(|value| value * value)
                .sum::<f64>();
        all.constant += (w.len() / 3) as f64 - 3.0;
        let gradient = w.chunks_exact(3).flat_map(|row| {
            [0, 1, 2].map(|j| 8.0 * (0..3).map(|i| row[i] * excess[i][j]).sum::<f64>())
        });
        all.gradients.push((name, gradient.collect()));
    }
    Ok(all)
}

//! The trend of accelerations ([`Trend`]): weighted least squares over the draws of the first epoch.
//!
//! Each draw's start state is swayed and shall come back as in training, so the fit says how much
//! damping long rollouts want, not only how the data move. Garments count as their gradients do
//! ([`stray_factors`]). Normal equations in f64, summed in the order of the draws: same bits at any
//! number of threads.

use drape_dataset::statistics::Trend;
use drape_model::FrameGraph;
use rayon::prelude::*;

use crate::config::TrainConfig;
use crate::data::TrainingSet;
use crate::error::Result;
use crate::losses::{integrate, position, stray_factors};
use crate::step::target;
use crate::sway::sway_of_draw;

const TERMS: usize = Trend::TERMS;

/// `Xᵀ W X` with `Xᵀ W y` as last column.
type Equations = [[f64; TERMS + 1]; TERMS];

/// Fits the trend of a training set.
///
/// # Errors
/// If a frame cannot be read or does not fit.
pub fn fit_trend(set: &TrainingSet, config: &TrainConfig) -> Result<Trend> {
    let draws = set.draws(config, 0);
    let parts: Vec<Equations> = draws
        .par_iter()
        .enumerate()
        .map(|(index, draw)| {
            let sample = set.sample(draw, config.model.gravity)?;
            let mut state = sample.state.clone();
            let label = format!("trend/draw {index}");
            sway_of_draw(config, &mut state, &sample.outfit, &label);
            let step = sample.steps.last().expect("a sample has a step");
            let graph = FrameGraph::new(&config.model, &sample.outfit, &state, step)?;
            let target = target(config.losses.return_frames, &sample, &state);
            let truth: Vec<_> = target.map(|row| position(&row)).collect();
            let held: Vec<_> = integrate(&state, std::iter::repeat([0.0; 3])).collect();
            let squared = set.statistics.vertices.std[6..9].iter();
            let squared = squared.map(|std| f64::from(*std).powi(2)).sum();
            let discount = config.losses.stray_discount;
            let factors = stray_factors(discount, squared, &sample.outfit, &held, &truth);
            let mut sums = [[0.0; TERMS + 1]; TERMS];
            let garments = sample.outfit.garment_offsets.windows(2);
            for (ends, factor) in garments.zip(factors) {
                for vertex in ends[0]..ends[1] {
                    let motion = graph.vertex_motion(&sample.outfit, vertex, &state[vertex], step);
                    let terms = Trend::terms(&motion);
                    for axis in 0..3 {
                        let wanted = truth[vertex][axis] - held[vertex][axis];
                        for (row, left) in sums.iter_mut().zip(&terms) {
                            let left = factor * f64::from(left[axis]);
                            for (sum, right) in row.iter_mut().zip(&terms) {
                                *sum += left * f64::from(right[axis]);
                            }
                            row[TERMS] += left * wanted;
                        }
                    }
                }
            }
            Ok(sums)
        })
        .collect::<Result<_>>()?;
    let mut total = [[0.0; TERMS + 1]; TERMS];
    for part in parts {
        for (sum, value) in total.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
            *sum += value;
        }
    }
    Ok(Trend::of_weights(solve(total).map(|value| value as f32)))
}

/// Solves symmetric equations by elimination; a term that never occurs (no wind in the data) or
/// that others make up gets 0.
fn solve<const TERMS: usize, const COLUMNS: usize>(
    mut equations: [[f64; COLUMNS]; TERMS],
) -> [f64; TERMS] {
    let scale: [f64; TERMS] = std::array::from_fn(|i| equations[i][i]);
    let usable = |equations: &[[f64; COLUMNS]; TERMS], i: usize| equations[i][i] > 1e-9 * scale[i];
    for i in 0..TERMS {
        if !usable(&equations, i) {
            equations[i] = [0.0; COLUMNS];
            continue;
        }
        let pivot = equations[i];
        for row in &mut equations[i + 1..] {
            let factor = row[i] / pivot[i];
            for (value, pivot) in row.iter_mut().zip(pivot) {
                *value -= factor * pivot;
            }
        }
    }
    let mut solution = [0.0; TERMS];
    for i in (0..TERMS).rev() {
        if usable(&equations, i) {
            let known: f64 = (i + 1..TERMS).map(|j| equations[i][j] * solution[j]).sum();
            solution[i] = (equations[i][TERMS] - known) / equations[i][i];
        }
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_and_leaves_out_what_cannot_be_told() {
        // Terms 1 and 3 are the same, term 2 never occurs: y = 2 x0 + 5 x1.
        let rows = [
            [1.0, 2.0, 0.0, 2.0],
            [0.5, -1.0, 0.0, -1.0],
            [3.0, 1.0, 0.0, 1.0],
        ];
        let mut equations = [[0.0; 5]; 4];
        for row in rows {
            let y = 2.0 * row[0] + 5.0 * row[1];
            for i in 0..4 {
                for j in 0..4 {
                    equations[i][j] += row[i] * row[j];
                }
                equations[i][4] += row[i] * y;
            }
        }
        for (found, expected) in solve(equations).into_iter().zip([2.0, 5.0, 0.0, 0.0]) {
            assert!(
                (found - expected).abs() < 1e-9,
                "{found} against {expected}"
            );
        }
    }
}

//! Compares the port with reference numbers of the published program.
//!
//! Files are safetensors in the layout of the oracle's manifest; tensors keep the
//! program's axes (batch first, features before vertices). Only the `tiesafe`
//! variant is compared: it selects decoder patches by a defined rule.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use candle_core::{DType, Device, Tensor};
use drape_dataset::patches::{Csr, Patches};
use drape_dataset::registry::GarmentKind;
use drape_dataset::sample::{Outfit, Sample, State, StatePair, Step, pair};
use drape_dataset::statistics::{ColumnStatistics, Trend};
use drape_geometry::mesh::on_border;
use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_train::adam::{Adam, Gradients};
use drape_train::losses::orthogonality::orthogonality;
use drape_train::losses::{LossConfig, LossValues};
use drape_train::step::{SampleGradient, advance, roll_in, sample_gradient};
use serde_json::{Value, json};

/// Tensors of one file by name.
pub struct Tensors(BTreeMap<String, Tensor>);

impl Tensors {
    /// Reads `dir/name.safetensors`.
    ///
    /// # Errors
    /// If the file is missing or not safetensors.
    pub fn read(dir: &Path, name: &str) -> Result<Self> {
        let path = dir.join(format!("{name}.safetensors"));
        let tensors = candle_core::safetensors::load(&path, &Device::Cpu)
            .with_context(|| format!("cannot read {}", path.display()))?;
        Ok(Self(tensors.into_iter().collect()))
    }

    /// One tensor.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn get(&self, name: &str) -> Result<&Tensor> {
        self.0
            .get(name)
            .with_context(|| format!("the file has no tensor '{name}'"))
    }

    /// A tensor's values as f64.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn values(&self, name: &str) -> Result<Vec<f64>> {
        Ok(self
            .get(name)?
            .to_dtype(DType::F64)?
            .flatten_all()?
            .to_vec1()?)
    }

    /// A tensor's values as integers.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn indices(&self, name: &str) -> Result<Vec<usize>> {
        Ok(self
            .values(name)?
            .into_iter()
            .map(|value| value as usize)
            .collect())
    }

    /// Names that start with a prefix, without it.
    pub fn names<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = &'a str> {
        self.0
            .keys()
            .filter_map(move |name| name.strip_prefix(prefix))
    }

    /// Rows of a tensor `[…, W, rows]` that keeps features before rows.
    fn columns<const W: usize>(&self, name: &str, step: usize) -> Result<Vec<[f32; W]>> {
        let tensor = self.get(name)?;
        let rows = tensor.dim(tensor.rank() - 1)?;
        let all: Vec<f32> = tensor.flatten_all()?.to_vec1()?;
        ensure!(
            all.len() >= (step + 1) * W * rows,
            "{name} has {} values, too few",
            all.len()
        );
        let block = &all[step * W * rows..][..W * rows];
        Ok((0..rows)
            .map(|row| std::array::from_fn(|column| block[column * rows + row]))
            .collect())
    }
}

/// Largest difference over the largest entry of the reference.
pub fn relative(found: &[f64], reference: &[f64]) -> f64 {
    if found.len() != reference.len() {
        return f64::INFINITY;
    }
    let largest = reference
        .iter()
        .fold(0f64, |top, value| top.max(value.abs()));
    let worst = found.iter().zip(reference).fold(0f64, |top, (a, b)| {
        let difference = (a - b).abs();
        if difference.is_nan() {
            f64::INFINITY
        } else {
            top.max(difference)
        }
    });
    if worst == 0.0 {
        0.0
    } else {
        worst / largest.max(f64::MIN_POSITIVE)
    }
}

/// A case's fixed part.
struct Case {
    outfit: Arc<Outfit>,
    statistics: ColumnStatistics,
    config: ModelConfig,
}

impl Case {
    fn new(inputs: &Tensors, prefix: &str, parameters: &Tensors) -> Result<Self> {
        let name = |name: &str| format!("{prefix}{name}");
        let mask = inputs.get(&name("g2p_mask"))?;
        let (patches, vertices) = (mask.dim(2)?, mask.dim(3)?);
        let dense = |name: &str, columns: usize| -> Result<Vec<(u32, u32)>> {
            let values = inputs.values(name)?;
            let entries = values.iter().enumerate().filter(|(_, value)| **value > 0.0);
            Ok(entries
                .map(|(at, _)| ((at / columns) as u32, (at % columns) as u32))
                .collect())
        };
        let membership = dense(&name("g2p_mask"), vertices)?;
        let attribute_pairs = dense(&name("attr_mask"), vertices)?;
        let of_vertex =
            Csr::from_pairs(vertices, membership.iter().map(|&(p, v)| (v, p)).collect());
        let attributes: Vec<[f32; 5]> = inputs.columns(&name("attr"), 0)?;
        let patch_attributes = attribute_pairs
            .iter()
            .flat_map(|&(a, v)| of_vertex.row(v as usize).iter().map(move |&p| (p, a)))
            .collect();
        let faces = |name: &str| -> Result<Vec<[u32; 3]>> {
            let all = inputs.indices(name)?;
            let count = all.len() / 3;
            Ok((0..count)
                .map(|face| std::array::from_fn(|corner| all[corner * count + face] as u32))
                .collect())
        };
        let garment_offsets = inputs.indices(&name("indices"))?;
        let body_vertices = match inputs.indices(&name("h_indices"))?.as_slice() {
            [first, .., last] => last - first,
            other => {
                anyhow::bail!("h_indices is {other:?}, expected the body's first row and its end")
            }
        };
        let (faces, body_faces) = (faces(&name("faces"))?, faces(&name("h_faces"))?);
        let kinds = vec![GarmentKind::Dress; garment_offsets.len() - 1];
        let vertices = of_vertex.rows();
        let outfit = Outfit {
            on_border: on_border(vertices, &faces),
            garment_offsets,
            faces,
            body_vertices,
            body_on_border: on_border(body_vertices, &body_faces),
            body_faces,
            patches: Patches {
                members: Csr::from_pairs(patches, membership),
                of_vertex,
                neighbours: Csr::from_pairs(patches, dense(&name("pmesh_mask"), patches)?),
            },
            attributes,
            patch_attributes: Csr::from_pairs(patches, patch_attributes),
            supports: vec![None; kinds.len()],
            rest: vec![[0.0; 3]; vertices],
            patch_rest: vec![[0.0; 3]; patches],
            kinds,
        };
        let table = inputs.values(&name("mean_std"))?;
        let mut statistics = ColumnStatistics {
            mean: [0.0; 9],
            std: [1.0; 9],
            trend: Trend::default(),
        };
        for column in 0..6 {
            statistics.mean[column] = table[column] as f32;
            statistics.std[column] = table[6 + column] as f32;
        }
        let blocks = (0..)
            .take_while(|block| {
                parameters
                    .names(&format!("backbone.encoder.layers.{block}."))
                    .next()
                    .is_some()
            })
            .count();
        let config = ModelConfig {
            blocks,
            layer_radius: inputs.values(&name("radius"))?[0] as f32,
            body_radius: inputs.values(&name("human_radius"))?[0] as f32,
            ..ModelConfig::released()
        };
        Ok(Self {
            outfit: Arc::new(outfit),
            statistics,
            config,
        })
    }

    /// The step of sub-step `k` from tensors with the given prefix.
    fn step(&self, inputs: &Tensors, prefix: &str, k: usize) -> Result<Step> {
        let part = |name: &str, width: usize| -> Result<Vec<f32>> {
            let all = inputs.values(&format!("{prefix}{name}"))?;
            Ok(all[k * width..(k + 1) * width]
                .iter()
                .map(|&value| value as f32)
                .collect())
        };
        let wind = part("invisable_force", 22)?;
        let rotations = part("invisable_rotation", 18)?;
        let gravity = part("gravity", 6)?;
        Ok(Step {
            body: inputs.columns(&format!("{prefix}h_state"), k)?,
            wind: std::array::from_fn(|i| wind[i]),
            wind_rotations: std::array::from_fn(|f| {
                std::array::from_fn(|row| {
                    std::array::from_fn(|column| rotations[9 * f + 3 * row + column])
                })
            }),
            gravity: std::array::from_fn(|i| gravity[i]),
        })
    }
}

fn all_f64(tensor: &Tensor) -> Result<Vec<f64>> {
    Ok(tensor.to_dtype(DType::F64)?.flatten_all()?.to_vec1()?)
}

/// Columns `from..to` of a `[1, rows, width]` reference.
fn part(values: &[f64], width: usize, from: usize, to: usize) -> Vec<f64> {
    values
        .chunks_exact(width)
        .flat_map(|row| row[from..to].to_vec())
        .collect()
}

/// Worst relative difference of the five losses; `prefix` stands before `loss_l2` and so on.
fn loss_difference(
    losses: &LossValues,
    orthogonality: f64,
    reference: &Tensors,
    prefix: &str,
) -> Result<f64> {
    let mut worst = 0f64;
    for (name, found) in [
        ("loss_l2", losses.position),
        ("loss_normal", losses.normal),
        (
            "loss_collision",
            losses.body_collision + losses.layer_collision,
        ),
        ("loss_l2_patch", losses.patch),
        ("loss_l2_orth", orthogonality),
    ] {
        worst = worst.max(relative(
            &[found],
            &reference.values(&format!("{prefix}{name}"))?,
        ));
    }
    Ok(worst)
}

/// Compares everything in `dir` with the given prefix; see the package's binary `oracle`.
///
/// # Errors
/// If a file or tensor is missing or does not fit.
pub fn compare(dir: &Path, prefix: &str) -> Result<Value> {
    let weights = Tensors::read(dir, "weights")?;
    let inputs = Tensors::read(dir, &format!("{prefix}_inputs"))?;
    let case = Case::new(&inputs, "", &weights)?;
    let fresh = || Parameters::from_tensors(weights.0.clone(), &case.config, DType::F32);
    let parameters = fresh()?;
    let net = LayersNet::trainable(&case.config, &parameters)?;
    let loss_config = LossConfig::released();

    // Forward.
    let state: Vec<StatePair> = inputs.columns("state", 0)?;
    let step = case.step(&inputs, "", 0)?;
    let target: Vec<State> = inputs.columns("gt_vertices", 0)?;
    let sample = Sample {
        outfit: case.outfit.clone(),
        state: state.clone(),
        steps: vec![step],
        reference: vec![target],
    };
    let gradient = |sample: &Sample, state: &[StatePair]| -> Result<SampleGradient> {
        Ok(sample_gradient(
            &net,
            &parameters,
            &case.statistics,
            &loss_config,
            sample,
            state,
            true,
        )?)
    };
    let result = gradient(&sample, &state)?;
    let forward = Tensors::read(dir, &format!("{prefix}_forward_f32_tiesafe"))?;
    let reference = part(&forward.values("pred")?, 9, 6, 9);
    let found = result.evaluation.prediction()?.acceleration;
    let prediction = relative(&all_f64(&found)?, &reference);
    let mut blocks = Vec::new();
    for index in 0..case.config.blocks {
        let reference =
            forward.values(&format!("hook.backbone.encoder.layers.{index}.call0.out0"))?;
        // A network gives what comes out of its last block: this one ends here.
        let config = ModelConfig {
            blocks: index + 1,
            ..case.config.clone()
        };
        let short = LayersNet::frozen(&config, &parameters)?;
        let prediction = short.forward(&case.outfit, &case.statistics, &state, &sample.steps[0])?;
        let found = all_f64(&prediction.blocks[0])?;
        blocks.push(relative(&found, &reference[..found.len()]));
    }

    // Training.
    let train = Tensors::read(dir, &format!("{prefix}_train_f32_tiesafe"))?;
    let regulariser = orthogonality(&case.config, &parameters)?;
    let orth = regulariser.value + regulariser.constant;
    let losses = loss_difference(&result.losses, orth, &train, "loss.decode.")?;
    let mut gradients = 0f64;
    let wide = |values: &[f32]| {
        values
            .iter()
            .map(|&value| f64::from(value))
            .collect::<Vec<_>>()
    };
    for name in train.names("grad_without_orth.") {
        let found = result
            .gradients
            .get(name)
            .with_context(|| format!("no gradient for {name}"))?;
        gradients = gradients.max(relative(
            &wide(found),
            &train.values(&format!("grad_without_orth.{name}"))?,
        ));
    }
    let mut total: Gradients = result.gradients.clone();
    for (name, gradient) in &regulariser.gradients {
        let sum = total
            .get_mut(name)
            .with_context(|| format!("no gradient for {name}"))?;
        sum.iter_mut()
            .zip(gradient)
            .for_each(|(sum, value)| *sum += *value as f32);
    }
    for name in train.names("grad.") {
        let found = total
            .get(name)
            .with_context(|| format!("no gradient for {name}"))?;
        gradients = gradients.max(relative(
            &wide(found),
            &train.values(&format!("grad.{name}"))?,
        ));
    }
    let updated = fresh()?;
    Adam::default().update(&updated, &total, 1e-3)?;
    let mut adam = 0f64;
    for name in train.names("adam1.") {
        let found = all_f64(updated.get(name)?.as_tensor())?;
        adam = adam.max(relative(&found, &train.values(&format!("adam1.{name}"))?));
    }

    // Rollout.
    let rollout_file = Tensors::read(dir, &format!("{prefix}_rollout_tiesafe"))?;
    let frozen = LayersNet::frozen(&case.config, &parameters)?;
    let rollout_case = Case::new(&rollout_file, "static.", &weights)?;
    let mut current: Vec<StatePair> = rollout_file.columns("step0.in.state", 0)?;
    let mut rollout = Vec::new();
    for k in 0.. {
        if rollout_file.get(&format!("step{k}.pred")).is_err() {
            break;
        }
        let step = rollout_case.step(&rollout_file, &format!("step{k}.in."), 0)?;
        let prediction = frozen.forward(
            &rollout_case.outfit,
            &rollout_case.statistics,
            &current,
            &step,
        )?;
        let reference = part(&rollout_file.values(&format!("step{k}.pred"))?, 9, 6, 9);
        rollout.push(relative(&all_f64(&prediction.acceleration)?, &reference));
        let next = advance(&current, &prediction.acceleration.flatten_all()?.to_vec1()?);
        for (state, next) in current.iter_mut().zip(&next) {
            let old: State = std::array::from_fn(|i| state[i]);
            *state = pair(next, &old);
        }
    }

    let multistep = multistep(dir, prefix, &weights, &parameters, &loss_config, orth)?;
    Ok(json!({
        "prediction": prediction,
        "blocks": blocks,
        "losses": losses,
        "gradients": gradients,
        "adam": adam,
        "rollout": rollout,
        "multistep": multistep,
    }))
}

/// Worst difference of the training step with steps before the gradient, over the switches.
fn multistep(
    dir: &Path,
    prefix: &str,
    weights: &Tensors,
    parameters: &Parameters,
    loss_config: &LossConfig,
    orth: f64,
) -> Result<f64> {
    let file = Tensors::read(dir, &format!("{prefix}_multistep_train"))?;
    let case = Case::new(&file, "", weights)?;
    let net = LayersNet::trainable(&case.config, parameters)?;
    let frozen = LayersNet::frozen(&case.config, parameters)?;
    let count = file.get("state")?.dim(1)?;
    let states: Vec<Vec<StatePair>> = (0..count)
        .map(|k| file.columns("state", k))
        .collect::<Result<_>>()?;
    let newer = |state: &Vec<StatePair>| {
        state
            .iter()
            .map(|row| std::array::from_fn(|i| row[i]))
            .collect::<Vec<State>>()
    };
    let mut reference: Vec<Vec<State>> = states[1..].iter().map(newer).collect();
    reference.push(file.columns("gt_vertices", 0)?);
    let steps = (0..count)
        .map(|k| case.step(&file, "", k))
        .collect::<Result<_>>()?;
    let sample = Sample {
        outfit: case.outfit.clone(),
        state: states[0].clone(),
        steps,
        reference,
    };
    let mut worst = 0f64;
    for switch in 0.. {
        let base = format!("tiesafe.sel{switch}.");
        if file.names(&base).next().is_none() {
            ensure!(switch > 0, "{prefix}_multistep_train has no tiesafe.sel0");
            break;
        }
        let mut state = Vec::new();
        roll_in(&frozen, &case.statistics, &sample, switch, &mut state)?;
        let expected: Vec<StatePair> = file.columns(&format!("{base}final_state_in"), 0)?;
        let flat = |rows: &[StatePair]| {
            rows.as_flattened()
                .iter()
                .map(|&value| f64::from(value))
                .collect::<Vec<_>>()
        };
        worst = worst.max(relative(&flat(&state), &flat(&expected)));
        let result = sample_gradient(
            &net,
            parameters,
            &case.statistics,
            loss_config,
            &sample,
            &state,
            true,
        )?;
        worst = worst.max(loss_difference(
            &result.losses,
            orth,
            &file,
            &format!("{base}decode."),
        )?);
        let name = "decode_head.proj.layers.2.weight";
        let found: Vec<f64> = result.gradients[name]
            .iter()
            .map(|&value| f64::from(value))
            .collect();
        worst = worst.max(relative(
            &found,
            &file.values(&format!("{base}grad.{name}"))?,
        ));
        // The vertex branch alone: state and acceleration relative to the own patch.
        let prediction = result.evaluation.prediction()?;
        let graph = &prediction.graph;
        let own_states: Vec<StatePair> = state
            .iter()
            .zip(&graph.own_patch)
            .map(|(row, &own)| {
                std::array::from_fn(|i| row[i] - graph.patch_states[own as usize][i])
            })
            .collect();
        let acceleration: Vec<f32> = prediction.relative.flatten_all()?.to_vec1()?;
        let next = advance(&own_states, &acceleration);
        let found: Vec<f64> = next
            .iter()
            .zip(acceleration.chunks_exact(3))
            .flat_map(|(state, a)| {
                state
                    .iter()
                    .chain(a)
                    .map(|&value| f64::from(value))
                    .collect::<Vec<_>>()
            })
            .collect();
        worst = worst.max(relative(&found, &file.values(&format!("{base}pred"))?));
    }
    Ok(worst)
}

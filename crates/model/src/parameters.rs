//! LayersNet's named weights: names of the published program, sorted.
//!
//! Initialisation: weights and biases uniform in ±1/√fan_in (PyTorch's default,
//! which the published program uses throughout), but ±√(6/fan_in) for weights of
//! encoders and decoder that feed a ReLU: with the smaller range the output
//! hardly depends on the input at first, and training waits on a plateau. The two
//! layers that read states also start with weights that fit the sizes of position,
//! velocity and change of velocity: a cloth vertex accelerates by a quarter of the
//! spread of velocities, and within a patch velocities differ by hundredths of
//! positions. The last layer's weights start ten times smaller, so that the first
//! predictions are the mean or the trend of the data. Layer norms 1 and 0; n_weight 1; rotation weights with orthonormal
//! columns. Each tensor has its own named random stream.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::{DType, Device, Tensor, Var};
use drape_dataset::random::stream;
use rand::Rng;

use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::kernels::attention::{GROUPS, HEAD, WIDTH};

/// Width of the decoder: relative state, patch embedding, body embedding.
pub const DECODER_WIDTH: usize = 12 + 2 * WIDTH;
/// Numbers that the decoder's first layer depends on: relative state, and three
/// each of patch and body.
const DECODER_INPUTS: usize = 12 + 3 + 3;
/// Hidden width of a block's feed-forward layer.
pub const FEED_FORWARD: usize = 2 * WIDTH;

/// How a tensor starts.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Start {
    /// Uniform in ±1/√fan_in.
    Uniform(usize),
    /// Uniform in ±√(6/fan_in), which keeps the spread through a ReLU.
    Relu(usize),
    /// Twelve leading columns that read a state of two frames, see [`state_columns`];
    /// the others as [`Start::Relu`] of this fan-in.
    States {
        fan_in: usize,
        /// Spread of the weights on velocity, as a multiple of those on position.
        velocity: f32,
        /// The same on its change.
        change: f32,
    },
    Constant(f32),
    /// Orthonormal columns.
    Orthonormal,
}

/// Names, shapes and starts of all weights.
fn inventory(config: &ModelConfig) -> BTreeMap<String, (Vec<usize>, Start)> {
    let mut all = BTreeMap::new();
    let mut linear = |name: &str, out: usize, inner: usize, bias: bool| {
        all.insert(
            format!("{name}.weight"),
            (vec![out, inner], Start::Uniform(inner)),
        );
        if bias {
            all.insert(format!("{name}.bias"), (vec![out], Start::Uniform(inner)));
        }
    };
    for (name, inner) in [
        ("invisible_force_encoder", 22),
        ("gravity_encoder", 6),
        ("attr_encoder", 5),
        ("input_projection", 12),
        ("receiver_proj", WIDTH),
        ("sender_proj", WIDTH),
    ] {
        linear(&format!("backbone.{name}.layers.0.0"), WIDTH, inner, true);
        linear(&format!("backbone.{name}.layers.1"), WIDTH, WIDTH, true);
    }
    for block in 0..config.blocks {
        let base = format!("backbone.encoder.layers.{block}");
        for name in [
            "receiver_weight",
            "sender_weight",
            "memory_weight",
            "q_proj.layers.0",
        ] {
            linear(
                &format!("{base}.self_attn.attn.{name}"),
                WIDTH,
                WIDTH,
                false,
            );
        }
        for name in ["proj", "r_proj", "s_proj"] {
            linear(
                &format!("{base}.self_attn.attn.{name}.layers.0"),
                WIDTH,
                WIDTH,
                true,
            );
        }
        for group in 0..GROUPS {
            linear(
                &format!("{base}.self_attn.attn.rs_mlp.group_layers.{group}.layers.0"),
                HEAD,
                HEAD,
                true,
            );
        }
        linear(&format!("{base}.ffn.layers.0.0"), FEED_FORWARD, WIDTH, true);
        linear(&format!("{base}.ffn.layers.1"), WIDTH, FEED_FORWARD, true);
    }
    for (layer, out) in [("0.0", DECODER_WIDTH), ("1.0", DECODER_WIDTH), ("2", 3)] {
        linear(
            &format!("decode_head.proj.layers.{layer}"),
            out,
            DECODER_WIDTH,
            true,
        );
    }
    for (name, (shape, start)) in &mut all {
        let encoder = [
            "_encoder.",
            "_projection.",
            "receiver_proj.",
            "sender_proj.",
        ];
        if !name.ends_with(".weight") {
            continue;
        }
        if name == "decode_head.proj.layers.0.0.weight" {
            *start = Start::States {
                fan_in: DECODER_INPUTS,
                velocity: 30.0,
                change: 100.0,
            };
        } else if name == "backbone.input_projection.layers.0.0.weight" {
            *start = Start::States {
                fan_in: 12,
                velocity: 1.0,
                change: 4.0,
            };
        } else if name == "decode_head.proj.layers.2.weight" {
            *start = Start::Uniform(100 * DECODER_WIDTH);
        } else if name == "decode_head.proj.layers.1.0.weight"
            || encoder.iter().any(|part| name.contains(part))
        {
            *start = Start::Relu(shape[1]);
        }
    }
    let mut norm = |name: &str| {
        all.insert(
            format!("{name}.weight"),
            (vec![WIDTH], Start::Constant(1.0)),
        );
        all.insert(format!("{name}.bias"), (vec![WIDTH], Start::Constant(0.0)));
    };
    for name in ["receiver_norm", "sender_norm", "particle_norm"] {
        norm(&format!("backbone.{name}"));
    }
    for block in 0..config.blocks {
        for name in ["norms.0", "norms.1", "res_norms.0", "res_norms.1"] {
            norm(&format!("backbone.encoder.layers.{block}.{name}"));
        }
    }
    all.insert(rotation_name(), (vec![WIDTH, 3], Start::Orthonormal));
    for block in 0..config.blocks {
        let base = format!("backbone.encoder.layers.{block}.self_attn.attn");
        all.insert(
            format!("{base}.n_weight"),
            (vec![1, 1, WIDTH], Start::Constant(1.0)),
        );
        all.insert(
            format!("{base}.n_bias"),
            (vec![1, 1, WIDTH], Start::Constant(0.0)),
        );
        for group in 0..GROUPS {
            all.insert(
                group_rotation_name(block, group),
                (vec![HEAD, 3], Start::Orthonormal),
            );
        }
    }
    all
}

/// Name of the decoder's rotation weight `[128, 3]`.
pub fn rotation_name() -> String {
    "backbone.rot_mapping.group_layers.0.0.model.weight".into()
}

/// Name of a head group's rotation weight `[16, 3]`.
pub fn group_rotation_name(block: usize, group: usize) -> String {
    format!(
        "backbone.encoder.layers.{block}.self_attn.attn.rot_mapping.group_layers.{group}.0.model.weight"
    )
}

/// Whether a weight influences nothing: the last block's receiver and sender updates.
pub fn is_idle(name: &str, config: &ModelConfig) -> bool {
    let base = format!("backbone.encoder.layers.{}.", config.blocks - 1);
    name.strip_prefix(&base).is_some_and(|rest| {
        rest.starts_with("self_attn.attn.r_proj")
            || rest.starts_with("self_attn.attn.s_proj")
            || rest.starts_with("res_norms")
    })
}

/// All weights by name, as trainable variables.
#[derive(Clone, Debug)]
pub struct Parameters {
    variables: BTreeMap<String, Var>,
}

impl Parameters {
    /// Fresh weights of a seed.
    ///
    /// # Errors
    /// If candle cannot make a tensor.
    pub fn new(config: &ModelConfig, seed: u64) -> Result<Self> {
        let mut variables = BTreeMap::new();
        for (name, (shape, start)) in inventory(config) {
            let count: usize = shape.iter().product();
            let mut rng = stream(seed, &format!("weights/{name}"));
            let values: Vec<f32> = match start {
                Start::Constant(value) => vec![value; count],
                Start::Uniform(fan_in) => uniform(count, 1.0 / (fan_in as f32).sqrt(), &mut rng),
                Start::Relu(fan_in) => uniform(count, (6.0 / fan_in as f32).sqrt(), &mut rng),
                Start::States {
                    fan_in,
                    velocity,
                    change,
                } => {
                    let bound = (6.0 / fan_in as f32).sqrt();
                    let mut values = uniform(count, bound, &mut rng);
                    for row in values.chunks_exact_mut(shape[1]) {
                        state_columns(row, velocity, change);
                    }
                    values
                }
                Start::Orthonormal => orthonormal_columns(shape[0], &mut rng),
            };
            variables.insert(name, Var::from_vec(values, shape, &Device::Cpu)?);
        }
        Ok(Self { variables })
    }

    /// Weights from a safetensors file, in the given type. Every tensor of the
    /// configuration must be there with its shape, and no other.
    ///
    /// # Errors
    /// [`ModelError::File`] and [`ModelError::Weights`].
    pub fn load(path: &Path, config: &ModelConfig, dtype: DType) -> Result<Self> {
        let tensors = candle_core::safetensors::load(path, &Device::Cpu).map_err(|cause| {
            ModelError::File {
                path: path.into(),
                cause: cause.to_string(),
            }
        })?;
        Self::from_tensors(tensors.into_iter().collect(), config, dtype)
    }

    /// Weights from named tensors; see [`Parameters::load`].
    ///
    /// # Errors
    /// [`ModelError::Weights`].
    pub fn from_tensors(
        mut tensors: BTreeMap<String, Tensor>,
        config: &ModelConfig,
        dtype: DType,
    ) -> Result<Self> {
        let mut variables = BTreeMap::new();
        for (name, (shape, _)) in inventory(config) {
            let Some(tensor) = tensors.remove(&name) else {
                return Err(ModelError::Weights {
                    name,
                    expected: format!("shape {shape:?}"),
                    found: "nothing".into(),
                });
            };
            if tensor.dims() != shape {
                let found = format!("shape {:?}", tensor.dims());
                return Err(ModelError::Weights {
                    name,
                    expected: format!("shape {shape:?}"),
                    found,
                });
            }
            variables.insert(name, Var::from_tensor(&tensor.to_dtype(dtype)?)?);
        }
        if let Some((name, tensor)) = tensors.into_iter().next() {
            let found = format!("shape {:?}: made for another configuration?", tensor.dims());
            return Err(ModelError::Weights {
                name,
                expected: "no such tensor".into(),
                found,
            });
        }
        Ok(Self { variables })
    }

    /// Names and variables, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Var)> {
        self.variables
            .iter()
            .map(|(name, variable)| (name.as_str(), variable))
    }

    /// One variable.
    ///
    /// # Errors
    /// [`ModelError::Weights`] if there is none of that name.
    pub fn get(&self, name: &str) -> Result<&Var> {
        self.variables.get(name).ok_or_else(|| ModelError::Weights {
            name: name.into(),
            expected: "a tensor of this name".into(),
            found: "none".into(),
        })
    }

    /// Number of scalars.
    pub fn count(&self) -> usize {
        self.variables
            .values()
            .map(|variable| variable.elem_count())
            .sum()
    }
}

/// Turns twelve weights of equal spread into weights for `[pos, vel]` of the
/// newer and the older frame that respond alike to position, velocity and
/// change of velocity, which are of very different size.
fn state_columns(row: &mut [f32], velocity: f32, change: f32) {
    for axis in 0..3 {
        let (of_velocity, of_change) = (velocity * row[3 + axis], change * row[9 + axis]);
        row[3 + axis] = of_velocity + of_change;
        row[6 + axis] = 0.0;
        row[9 + axis] = -of_change;
    }
}

fn uniform(count: usize, bound: f32, rng: &mut impl Rng) -> Vec<f32> {
    (0..count)
        .map(|_| rng.random_range(-bound..bound))
        .collect()
}

/// Random matrix `[rows, 3]` with orthonormal columns (Gram–Schmidt), row-major.
fn orthonormal_columns(rows: usize, rng: &mut impl Rng) -> Vec<f32> {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    while columns.len() < 3 {
        let mut column: Vec<f64> = (0..rows).map(|_| rng.random_range(-1.0..1.0)).collect();
        for done in &columns {
            let along: f64 = column.iter().zip(done).map(|(a, b)| a * b).sum();
            column
                .iter_mut()
                .zip(done)
                .for_each(|(a, b)| *a -= along * b);
        }
        let length = column.iter().map(|a| a * a).sum::<f64>().sqrt();
        if length > 1e-3 {
            columns.push(column.iter().map(|a| a / length).collect());
        }
    }
    (0..rows)
        .flat_map(|row| columns.iter().map(move |column| column[row] as f32))
        .collect()
}

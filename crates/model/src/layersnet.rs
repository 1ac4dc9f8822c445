//! LayersNet: patches as particles, rotation-equivalent attention, decoder.
//!
//! Source: "Towards Multi-Layered 3D Garments Animation" (ICCV 2023); equations
//! of the published program in its description, sections 7 to 9, evaluated with
//! the exact simplifications of section 16: sparse edges, one token per distinct
//! body vertex, rank-3 rotations, an 18-wide decoder input.
//! Shapes: P patches, A attribute rows, G body tokens (vertices, wind, gravity),
//! N vertices, width 128.

use std::collections::BTreeMap;
use std::time::Instant;

use candle_core::{DType, Device, Tensor, WithDType};
use drape_dataset::sample::{Outfit, StatePair, Step};
use drape_dataset::statistics::ColumnStatistics;

use crate::block::Blocks;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::evaluation::{Evaluation, Prediction, with_pass};
use crate::kernels::linear::{Activation, Passed, affine_rows};
use crate::kernels::{Real, values};
use crate::parameters::{Parameters, rotation_name};

/// Weight and bias of a linear layer.
pub(crate) struct Affine {
    name: String,
    weight: Tensor,
    transposed: Tensor,
    bias: Tensor,
    activation: Activation,
}

impl Affine {
    /// Width of the rows that go in.
    pub(crate) fn inner(&self) -> Result<usize> {
        Ok(self.weight.dim(1)?)
    }

    /// The layer's rows.
    pub(crate) fn forward<T: Real>(&self, x: &[T], y: &mut [T]) -> Result<()> {
        let (w, b) = (values::<T>(&self.transposed)?, values::<T>(&self.bias)?);
        affine_rows(x, &w, Some(&b), self.inner()?, self.activation, y);
        Ok(())
    }

    /// The layer's gradients, and that of x where `dx` asks for it, from that of y, which is masked.
    pub(crate) fn backward<T: Real>(
        &self,
        x: &[T],
        y: &[T],
        g: &mut [T],
        dx: Option<&mut [T]>,
        gradients: &mut Gradients,
    ) -> Result<()> {
        let (out, inner) = self.weight.dims2()?;
        let weight = &values::<T>(&self.weight)?;
        let (mut dw, mut db) = (vec![T::zero(); out * inner], vec![T::zero(); out]);
        let passed = Passed {
            x,
            weight,
            y,
            inner,
            out,
            activation: self.activation,
        };
        passed.backward(g, dx, Some(&mut dw), Some(&mut db));
        gradients.add(&self.name, "weight", dw, (out, inner))?;
        gradients.add(&self.name, "bias", db, out)
    }
}

/// Weight and bias of a layer norm.
pub(crate) struct Norm {
    pub(crate) name: String,
    pub(crate) weight: Tensor,
    pub(crate) bias: Tensor,
}

/// Two linear layers with ReLU after each.
pub(crate) struct Encoder {
    pub(crate) first: Affine,
    pub(crate) second: Affine,
}

impl Encoder {
    /// Width of the rows that go in.
    pub(crate) fn inner(&self) -> Result<usize> {
        self.first.inner()
    }
}

/// Gradients by weight, as a backward pass finds them.
pub(crate) struct Gradients<'a> {
    /// The weights that the network was made of.
    pub(crate) parameters: &'a Parameters,
    pub(crate) all: BTreeMap<String, Tensor>,
}

/// Where weights come from: trainable, or detached for prediction.
pub(crate) struct Source<'a> {
    pub(crate) parameters: &'a Parameters,
    pub(crate) trainable: bool,
}

impl Source<'_> {
    /// A weight's values; candle follows nothing that is made of them.
    fn tensor(&self, name: &str) -> Result<Tensor> {
        Ok(self.parameters.get(name)?.as_detached_tensor())
    }

    fn affine(&self, name: String, activation: Activation) -> Result<Affine> {
        let weight = self.tensor(&format!("{name}.weight"))?;
        Ok(Affine {
            transposed: weight.t()?.contiguous()?,
            weight,
            bias: self.tensor(&format!("{name}.bias"))?,
            name,
            activation,
        })
    }

    fn norm(&self, name: &str) -> Result<Norm> {
        Ok(Norm {
            weight: self.tensor(&format!("{name}.weight"))?,
            bias: self.tensor(&format!("{name}.bias"))?,
            name: name.into(),
        })
    }

    fn encoder(&self, name: &str) -> Result<Encoder> {
        let layer = |index: &str| {
            let name = format!("backbone.{name}.layers.{index}");
            self.affine(name, Activation::Relu)
        };
        Ok(Encoder {
            first: layer("0.0")?,
            second: layer("1")?,
        })
    }
}

/// LayersNet with its weights arranged for evaluation. Made anew after each
/// change of the weights; products of weights are computed once here.
pub struct LayersNet {
    pub(crate) config: ModelConfig,
    states: Encoder,
    pub(crate) attributes: Encoder,
    wind: Encoder,
    gravity: Encoder,
    pub(crate) receiver: Encoder,
    pub(crate) sender: Encoder,
    pub(crate) particle_norm: Norm,
    pub(crate) receiver_norm: Norm,
    pub(crate) sender_norm: Norm,
    pub(crate) blocks: Blocks,
    /// Decoder's rotation weight R `[128, 3]`, transposed: as a layer's weight; and itself.
    pub(crate) rotation: Tensor,
    pub(crate) rotation_transposed: Tensor,
    /// First decoder layer on the 18 numbers it depends on, and the others: weight,
    /// then bias of each.
    pub(crate) decoder: [Tensor; 2],
    /// Whether passes keep what their backward passes need.
    pub(crate) trainable: bool,
    dtype: DType,
}

impl LayersNet {
    /// The network whose weights receive gradients, see [`LayersNet::gradients`].
    ///
    /// # Errors
    /// If a weight is missing.
    pub fn trainable(config: &ModelConfig, parameters: &Parameters) -> Result<Self> {
        Self::new(
            config,
            &Source {
                parameters,
                trainable: true,
            },
        )
    }

    /// The network for prediction only: no graph is kept.
    ///
    /// # Errors
    /// If a weight is missing.
    pub fn frozen(config: &ModelConfig, parameters: &Parameters) -> Result<Self> {
        Self::new(
            config,
            &Source {
                parameters,
                trainable: false,
            },
        )
    }

    fn new(config: &ModelConfig, source: &Source) -> Result<Self> {
        config.validate()?;
        let rotation = source.tensor(&rotation_name())?;
        let weight = |layer: &str, kind: &str| -> Result<Tensor> {
            source.tensor(&format!("{}.{kind}", decoder_layer(layer)))
        };
        let wide = weight(WIDE, "weight")?;
        let [patch, body] = wide_columns(&wide)?;
        let columns = [
            wide.narrow(1, 0, 12)?.contiguous()?,
            patch.matmul(&rotation)?,
            body.matmul(&rotation)?,
        ];
        let mut others = Vec::new();
        for layer in OTHERS {
            others.push(weight(layer, "weight")?.flatten_all()?);
            others.push(weight(layer, "bias")?);
        }
        Ok(Self {
            dtype: rotation.dtype(),
            config: config.clone(),
            states: source.encoder("input_projection")?,
            attributes: source.encoder("attr_encoder")?,
            wind: source.encoder("invisible_force_encoder")?,
            gravity: source.encoder("gravity_encoder")?,
            receiver: source.encoder("receiver_proj")?,
            sender: source.encoder("sender_proj")?,
            particle_norm: source.norm("backbone.particle_norm")?,
            receiver_norm: source.norm("backbone.receiver_norm")?,
            sender_norm: source.norm("backbone.sender_norm")?,
            blocks: Blocks::new(config, source)?,
            decoder: [
                Tensor::cat(
                    &[
                        &Tensor::cat(&columns, 1)?.flatten_all()?,
                        &weight(WIDE, "bias")?,
                    ],
                    0,
                )?,
                Tensor::cat(&others, 0)?,
            ],
            trainable: source.trainable,
            rotation: rotation.t()?.contiguous()?,
            rotation_transposed: rotation,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// States', attributes', wind's and gravity's.
    pub(crate) fn encoders(&self) -> [&Encoder; 4] {
        [&self.states, &self.attributes, &self.wind, &self.gravity]
    }

    /// Evaluates one frame, in memory that the next frame uses again.
    ///
    /// `state` `[N, 12]` and `step` as in [`drape_dataset::sample`]; `statistics`
    /// of the training set's vertices.
    ///
    /// # Errors
    /// [`crate::ModelError::Input`] for input that does not fit or is not finite.
    pub fn evaluate(
        &self,
        outfit: &Outfit,
        statistics: &ColumnStatistics,
        state: &[StatePair],
        step: &Step,
    ) -> Result<Evaluation> {
        let mut clock = Instant::now();
        let mut lap = || {
            let now = Instant::now();
            (now - std::mem::replace(&mut clock, now)).as_secs_f64()
        };
        let mut evaluation = Evaluation::new(self.dtype)?;
        evaluation.seconds = with_pass!(&mut evaluation.pass, pass => {
            pass.forward(self, outfit, statistics, state, step, &mut lap)?
        });
        Ok(evaluation)
    }

    /// Accelerations of one frame as tensors; arguments and errors as of [`LayersNet::evaluate`].
    ///
    /// # Errors
    /// As of [`LayersNet::evaluate`].
    pub fn forward(
        &self,
        outfit: &Outfit,
        statistics: &ColumnStatistics,
        state: &[StatePair],
        step: &Step,
    ) -> Result<Prediction> {
        self.evaluate(outfit, statistics, state, step)?.prediction()
    }

    /// Gradients by name of a loss, from those by the evaluated accelerations of vertices `[N, 3]`
    /// and of patches `[P, 3]`; `parameters` are those that this network was made of.
    ///
    /// # Errors
    /// If a weight is missing.
    ///
    /// # Panics
    /// If the network is frozen, or another one evaluated the frame.
    pub fn gradients(
        &self,
        parameters: &Parameters,
        evaluation: &mut Evaluation,
        by_vertex: &[[f64; 3]],
        by_patch: &[[f64; 3]],
    ) -> Result<BTreeMap<String, Tensor>> {
        assert!(self.trainable, "a frozen network keeps nothing to go back");
        let mut gradients = Gradients {
            parameters,
            all: BTreeMap::new(),
        };
        with_pass!(&mut evaluation.pass, pass => {
            pass.backward(self, by_vertex, by_patch, &mut gradients)?
        });
        Ok(gradients.all)
    }

    /// Gradients of the decoder's layers and of R from those of `decoder` and of Rᵀ.
    pub(crate) fn decoder_gradients<T: WithDType>(
        &self,
        d: [Vec<T>; 3],
        gradients: &mut Gradients,
    ) -> Result<()> {
        let [d_first, d_others, d_rotation] = d.map(|d| {
            let len = d.len();
            Tensor::from_vec(d, len, &Device::Cpu)
        });
        let (d_first, d_others) = (d_first?, d_others?);
        let get = |name: &str| -> Result<Tensor> {
            Ok(gradients.parameters.get(name)?.as_detached_tensor())
        };
        let rotation = get(&rotation_name())?;
        let wide = get(&format!("{}.weight", decoder_layer(WIDE)))?;
        let hidden = wide.dim(0)?;
        let inner = d_first.elem_count() / hidden - 1;
        let d_columns = d_first.narrow(0, 0, hidden * inner)?;
        let d_columns = d_columns.reshape((hidden, inner))?;
        let [d_patch, d_body] = [12, 15].map(|at| d_columns.narrow(1, at, 3)?.contiguous());
        let (d_patch, d_body) = (d_patch?, d_body?);
        let back = rotation.t()?.contiguous()?;
        let d_wide = [
            d_columns.narrow(1, 0, 12)?.contiguous()?,
            d_patch.matmul(&back)?,
            d_body.matmul(&back)?,
        ];
        let [patch, body] = wide_columns(&wide)?;
        let own = d_rotation?.reshape(back.shape())?.t()?.contiguous()?;
        let d_rotation = (own + patch.t()?.contiguous()?.matmul(&d_patch)?)?;
        let d_rotation = (d_rotation + body.t()?.contiguous()?.matmul(&d_body)?)?;
        let mut found = vec![
            (rotation_name(), d_rotation),
            (
                format!("{}.weight", decoder_layer(WIDE)),
                Tensor::cat(&d_wide, 1)?,
            ),
            (
                format!("{}.bias", decoder_layer(WIDE)),
                d_first.narrow(0, hidden * inner, hidden)?,
            ),
        ];
        let mut start = 0;
        for layer in OTHERS {
            for kind in ["weight", "bias"] {
                let name = format!("{}.{kind}", decoder_layer(layer));
                let shape = gradients.parameters.get(&name)?.shape();
                let own = d_others.narrow(0, start, shape.elem_count())?;
                start += shape.elem_count();
                found.push((name, own.reshape(shape)?));
            }
        }
        gradients.all.extend(found);
        Ok(())
    }
}

/// The decoder's first layer, and the others.
const WIDE: &str = "0.0";
const OTHERS: [&str; 2] = ["1.0", "2"];

fn decoder_layer(layer: &str) -> String {
    format!("decode_head.proj.layers.{layer}")
}

/// Columns of the decoder's first layer for what patch and body pass on: `[h, 128]` each.
fn wide_columns(wide: &Tensor) -> Result<[Tensor; 2]> {
    Ok([
        wide.narrow(1, 12, 128)?.contiguous()?,
        wide.narrow(1, 140, 128)?.contiguous()?,
    ])
}

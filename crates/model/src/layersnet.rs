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

use candle_core::backprop::GradStore;
use candle_core::{DType, Device, Tensor};
use drape_dataset::sample::{Outfit, StatePair, Step};
use drape_dataset::statistics::ColumnStatistics;

use crate::block::{Blocks, Tokens};
use crate::config::{ModelConfig, OutputScale};
use crate::error::Result;
use crate::frames::transposed;
use crate::graph::{FrameGraph, turned};
use crate::kernels::decoder::{Segments, decode};
use crate::kernels::features::{FeatureRow, features};
use crate::kernels::for_all;
use crate::kernels::layer_norm::{layer_norm, layer_norm_first};
use crate::kernels::linear::{Activation, linear};
use crate::kernels::row_map::{RowMap, map_rows};
use crate::kernels::rows::take_rows;
use crate::parameters::{Parameters, rotation_name};

/// Decoder rows that one thread puts together at a time.
const PIECE: usize = 512;

/// Weight and bias of a linear layer.
pub(crate) struct Affine {
    weight: Tensor,
    bias: Tensor,
}

impl Affine {
    pub(crate) fn apply(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        Ok(linear(x, &self.weight, &self.bias, activation)?)
    }
}

/// Weight and bias of a layer norm.
pub(crate) struct Norm {
    weight: Tensor,
    bias: Tensor,
}

impl Norm {
    pub(crate) fn apply(&self, x: &Tensor) -> Result<Tensor> {
        Ok(layer_norm(x, &self.weight, &self.bias)?)
    }

    fn apply_first(&self, x: &Tensor, rows: usize) -> Result<Tensor> {
        Ok(layer_norm_first(x, rows, &self.weight, &self.bias)?)
    }
}

/// Two linear layers with ReLU after each.
struct Encoder {
    first: Affine,
    second: Affine,
}

impl Encoder {
    fn apply(&self, x: &Tensor) -> Result<Tensor> {
        self.second
            .apply(&self.first.apply(x, Activation::Relu)?, Activation::Relu)
    }
}

/// Where weights come from: trainable, or detached for prediction.
pub(crate) struct Source<'a> {
    pub(crate) parameters: &'a Parameters,
    pub(crate) trainable: bool,
}

impl Source<'_> {
    pub(crate) fn tensor(&self, name: &str) -> Result<Tensor> {
        let variable = self.parameters.get(name)?.as_tensor();
        Ok(if self.trainable {
            variable.clone()
        } else {
            variable.detach()
        })
    }

    pub(crate) fn affine(&self, name: &str) -> Result<Affine> {
        Ok(Affine {
            weight: self.tensor(&format!("{name}.weight"))?,
            bias: self.tensor(&format!("{name}.bias"))?,
        })
    }

    pub(crate) fn norm(&self, name: &str) -> Result<Norm> {
        Ok(Norm {
            weight: self.tensor(&format!("{name}.weight"))?,
            bias: self.tensor(&format!("{name}.bias"))?,
        })
    }

    fn encoder(&self, name: &str) -> Result<Encoder> {
        Ok(Encoder {
            first: self.affine(&format!("backbone.{name}.layers.0.0"))?,
            second: self.affine(&format!("backbone.{name}.layers.1"))?,
        })
    }
}

/// LayersNet with its weights arranged for evaluation. Made anew after each
/// change of the weights; products of weights are computed once here.
pub struct LayersNet {
    config: ModelConfig,
    states: Encoder,
    attributes: Encoder,
    wind: Encoder,
    gravity: Encoder,
    receiver: Encoder,
    sender: Encoder,
    particle_norm: Norm,
    receiver_norm: Norm,
    sender_norm: Norm,
    blocks: Blocks,
    /// Decoder's rotation weight, transposed for a product: `[3, 128]`.
    rotation: Tensor,
    /// First decoder layer on the 18 numbers it depends on, and the others: weight,
    /// then bias of each.
    decoder: [Tensor; 2],
    /// Whether weights receive gradients.
    trainable: bool,
    dtype: DType,
}

/// What the network says about one frame, in units/frame².
pub struct Prediction {
    /// Acceleration of each vertex, `[N, 3]`: its own patch's plus its own.
    pub acceleration: Tensor,
    /// The vertex's own part of it, `[N, 3]`.
    pub relative: Tensor,
    /// Acceleration of each patch, `[P, 3]`.
    pub patch_acceleration: Tensor,
    /// Patch tokens `[P, 128]` after each block of the reference path; [`LayersNet`] gives the last only.
    pub blocks: Vec<Tensor>,
    /// The structure it was computed on.
    pub graph: FrameGraph,
    /// Where the time went.
    pub seconds: ForwardSeconds,
}

/// Seconds of the parts of a forward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForwardSeconds {
    /// Neighbours, normals, frames: [`FrameGraph`].
    pub graph: f64,
    /// Encoders, receivers and senders.
    pub encoders: f64,
    /// Transformer blocks.
    pub blocks: f64,
    /// Decoder and integration.
    pub decoder: f64,
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
        let wide = source.affine("decode_head.proj.layers.0.0")?;
        let columns = [
            wide.weight.narrow(1, 0, 12)?.contiguous()?,
            wide.weight
                .narrow(1, 12, 128)?
                .contiguous()?
                .matmul(&rotation)?,
            wide.weight
                .narrow(1, 140, 128)?
                .contiguous()?
                .matmul(&rotation)?,
        ];
        let second = source.affine("decode_head.proj.layers.1.0")?;
        let last = source.affine("decode_head.proj.layers.2")?;
        let others = [
            &second.weight.flatten_all()?,
            &second.bias,
            &last.weight.flatten_all()?,
            &last.bias,
        ];
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
                Tensor::cat(&[&Tensor::cat(&columns, 1)?.flatten_all()?, &wide.bias], 0)?,
                Tensor::cat(&others, 0)?,
            ],
            trainable: source.trainable,
            rotation: rotation.t()?.contiguous()?,
        })
    }

    /// The configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// Gradients by name of the weights that a backward pass through this network reached;
    /// `parameters` are those that it was made of.
    ///
    /// # Errors
    /// If a weight is missing.
    pub fn gradients(
        &self,
        parameters: &Parameters,
        store: &GradStore,
    ) -> Result<BTreeMap<String, Tensor>> {
        let mut all = self.blocks.gradients(parameters, store)?;
        for (name, variable) in parameters.iter() {
            if let Some(gradient) = store.get(variable) {
                all.insert(name.into(), gradient.clone());
            }
        }
        Ok(all)
    }

    fn constant<const W: usize>(&self, rows: &[[f32; W]]) -> Result<Tensor> {
        let flat = rows.as_flattened().to_vec();
        Ok(Tensor::from_vec(flat, (rows.len(), W), &Device::Cpu)?.to_dtype(self.dtype)?)
    }

    /// Accelerations of one frame.
    ///
    /// `state` `[N, 12]` and `step` as in [`drape_dataset::sample`]; `statistics`
    /// of the training set's vertices.
    ///
    /// # Errors
    /// [`crate::ModelError::Input`] for input that does not fit or is not finite.
    pub fn forward(
        &self,
        outfit: &Outfit,
        statistics: &ColumnStatistics,
        state: &[StatePair],
        step: &Step,
    ) -> Result<Prediction> {
        let mut clock = Instant::now();
        let mut lap = || {
            let now = Instant::now();
            (now - std::mem::replace(&mut clock, now)).as_secs_f64()
        };
        let mut seconds = ForwardSeconds::default();
        let graph = FrameGraph::new(&self.config, outfit, state, step)?;
        seconds.graph = lap();
        let patches = outfit.patches.count();

        // Encoders. Patches and body vertices share one; both are rows of one product.
        let normalise = |row: &StatePair| -> StatePair {
            std::array::from_fn(|i| (row[i] - statistics.mean[i % 6]) / statistics.std[i % 6])
        };
        let mut rows: Vec<StatePair> = graph.patch_states.iter().map(normalise).collect();
        rows.extend(
            graph
                .body_rows
                .iter()
                .map(|&vertex| normalise(&step.body[vertex as usize])),
        );
        let encoded = self.states.apply(&self.constant(&rows)?)?;
        let attribute_tokens = self.attributes.apply(&self.constant(&outfit.attributes)?)?;
        let wind_token = self.wind.apply(&self.constant(&[step.wind])?)?;
        let gravity_token = self.gravity.apply(&self.constant(&[step.gravity])?)?;

        // Receivers, and senders: patches, attributes, then body tokens.
        let others = Tensor::cat(&[&attribute_tokens, &wind_token, &gravity_token], 0)?;
        let attributes = outfit.attributes.len();
        let particles = (0..patches).chain(rows.len()..rows.len() + attributes);
        let forces = rows.len() + attributes..rows.len() + attributes + 2;
        let body = (patches..patches + graph.body_tokens).chain(forces);
        let order = particles.chain(body).map(|row| row as u32).collect();
        let all = take_rows(&encoded, &others, order)?;
        let receivers = self.receiver.apply(&all.narrow(0, 0, patches)?)?;
        let tokens = Tokens {
            state: self.particle_norm.apply_first(&all, patches + attributes)?,
            receiver: self.receiver_norm.apply(&receivers)?,
            sender: self.sender_norm.apply(&self.sender.apply(&all)?)?,
        };
        seconds.encoders = lap();
        let embedding = self.blocks.patches(&tokens, &graph.edges)?;
        seconds.blocks = lap();
        let mut prediction = self.decode(statistics, state, step, &encoded, graph, embedding)?;
        seconds.decoder = lap();
        prediction.seconds = seconds;
        Ok(prediction)
    }

    /// Decoder and integration, for patches and for vertices.
    fn decode(
        &self,
        statistics: &ColumnStatistics,
        state: &[StatePair],
        step: &Step,
        encoded: &Tensor,
        graph: FrameGraph,
        embedding: Tensor,
    ) -> Result<Prediction> {
        let (patches, vertices) = (graph.patch_states.len(), state.len());
        let pairs = graph.slots.len();
        // Three numbers per patch and per body vertex, turned into each receiver's frame.
        let patch_numbers = crate::kernels::linear::product(&embedding, &self.rotation)?;
        let row = |index: usize| -> FeatureRow {
            let (patch, anchor, state) = match graph.slots.get(index) {
                Some(slot) => {
                    let anchor = &graph.vertex_anchors[slot.vertex as usize];
                    let vertex = &state[slot.vertex as usize];
                    let patch = &graph.patch_states[slot.patch as usize];
                    let relative = std::array::from_fn(|i| vertex[i] - patch[i]);
                    (slot.patch, anchor, turned(&relative, anchor))
                }
                None => {
                    let patch = index - pairs;
                    let relative = graph.patch_on_body(patch, step);
                    (patch as u32, &graph.patch_anchors[patch], relative)
                }
            };
            FeatureRow {
                state,
                frame: anchor.frame,
                patch,
                body: anchor.row.map(|row| patches as u32 + row),
            }
        };
        let mut rows = vec![FeatureRow::default(); pairs + patches];
        for_all(
            rows.chunks_mut(PIECE).enumerate().collect(),
            |(piece, rows): (usize, &mut [FeatureRow])| {
                for (index, to) in (piece * PIECE..).zip(rows) {
                    *to = row(index);
                }
            },
        );
        // Of all rows: cheaper than cutting out the body's, which come after the patches'.
        let body_numbers = crate::kernels::linear::product(encoded, &self.rotation)?;
        let features = features(&patch_numbers, &body_numbers, rows)?;
        // The last layer is linear, so the mean over a vertex's patches is taken before it;
        // a patch has one row of its own.
        let own_rows = (1..=patches).map(|patch| (pairs + patch) as u32);
        let segments = Segments {
            offsets: graph.slot_offsets.iter().copied().chain(own_rows).collect(),
            means: vertices,
        };
        let [first, others] = &self.decoder;
        let local = decode(&features, first, others, segments, self.trainable)?;
        let columns = match self.config.output_scale {
            OutputScale::Velocity => 3,
            OutputScale::Acceleration => 6,
        };
        let mean = [0, 1, 2].map(|axis| statistics.mean[columns + axis]);
        let std = [0, 1, 2].map(|axis| statistics.std[columns + axis]);
        let trend = graph.trend(&statistics.trend, state, step);
        let anchors = graph.vertex_anchors.iter().chain(&graph.patch_anchors);
        let back = anchors
            .zip(trend)
            .enumerate()
            .map(|(index, (anchor, trend))| {
                let r = transposed(&anchor.frame);
                // A vertex whose four candidates are all refused (coincident centres) takes its
                // own patch's motion only: no mean, so not the last layer's bias either.
                let refused =
                    index < vertices && graph.slot_offsets[index] == graph.slot_offsets[index + 1];
                let scale = |axis: usize| if refused { 0.0 } else { std[axis] };
                let matrix = [0, 1, 2].map(|axis| r[axis].map(|value| value * scale(axis)));
                RowMap {
                    index: index as u32,
                    matrix,
                    offset: [0, 1, 2].map(|axis| mean[axis] + trend[axis]),
                }
            })
            .collect();
        let world = map_rows(&local, back)?;
        let relative = world.narrow(0, 0, vertices)?;
        let patch_acceleration = world.narrow(0, vertices, patches)?;
        let own = Tensor::new(graph.own_patch.as_slice(), &Device::Cpu)?;
        let acceleration = (&relative + patch_acceleration.contiguous()?.index_select(&own, 0)?)?;
        Ok(Prediction {
            acceleration,
            relative,
            patch_acceleration,
            blocks: vec![embedding],
            graph,
            seconds: ForwardSeconds::default(),
        })
    }
}

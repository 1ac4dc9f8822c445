//! LayersNet written out in candle's own tensor operations, one formula after the other.
//!
//! [`forward`] computes what [`LayersNet::forward`](crate::LayersNet::forward) computes,
//! from the same [`FrameGraph`], without the kernels and without the products of weights
//! made ahead for them: rotations act as `W (R (Wᵀ x))`, attention gathers the rows of a
//! list of edges, a softmax over one receiver's edges is the exponential over its sum by
//! receiver, and every vector of 268 numbers that the decoder reads is there. It is what
//! the kernels are checked against, and what runs where they cannot: on a GPU (feature
//! `cuda`), with gradients through everything by candle. On a CPU it takes longer than the
//! kernels: 2 to 3 times on a scene of 64 patches and 216 vertices, one thread, f32.
//!
//! Arithmetic is in the weights' type. States, patch means and frames come in f32 from
//! the host, as in `LayersNet`. The floor of |r − s|² and the epsilons need the range of
//! f32: f64, f32 and bf16 have it, f16 has not.
//!
//! Untested: every GPU. The tests run on the CPU, in f32 and f64, predictions also in bf16;
//! the feature `cuda` was never built, and nothing here ever ran on CUDA or Metal.
//! `Parameters` and `FrameGraph` stay on the CPU: each call copies the weights and the
//! frame's lists to the device, and gradients of the weights are meant to come back.
//!
//! Source: "Towards Multi-Layered 3D Garments Animation" (ICCV 2023); equations of the
//! published program in its description, sections 7 to 9, each body token once (16).
//! P patches, A attribute rows, G body tokens (vertices, wind, gravity), N vertices,
//! E edges, width 128 = 4 groups of a world head and a mesh head of 16 channels.

use candle_core::{D, DType, Device, Tensor};
use drape_dataset::sample::{Outfit, StatePair, Step};
use drape_dataset::statistics::ColumnStatistics;

use crate::config::{BodyMessages, ModelConfig, OutputScale};
use crate::error::Result;
use crate::evaluation::{ForwardSeconds, Prediction};
use crate::frames::Matrix;
use crate::graph::{FrameGraph, turned};
use crate::kernels::attention::{Edges, GROUPS, HEAD, WIDTH};
use crate::parameters::{DECODER_WIDTH, Parameters, group_rotation_name, rotation_name};

/// The published program's EPS.
const EPSILON: f64 = 1e-7;
const SQUARED_DISTANCE_FLOOR: f64 = 1e-12;
/// 1/√16.
const KAPPA: f64 = 0.25;
const LAYER_NORM_EPSILON: f64 = 1e-5;

/// Accelerations of one frame, computed on `device`; arguments, result and errors as of
/// [`LayersNet::forward`](crate::LayersNet::forward). The weights receive gradients.
///
/// # Errors
/// [`crate::ModelError::Input`] for input that does not fit or is not finite,
/// [`crate::ModelError::Weights`] for a missing weight, [`crate::ModelError::Candle`] if
/// the device lacks an operation or the type of the weights.
pub fn forward(
    config: &ModelConfig,
    parameters: &Parameters,
    outfit: &Outfit,
    statistics: &ColumnStatistics,
    state: &[StatePair],
    step: &Step,
    device: &Device,
) -> Result<Prediction> {
    config.validate()?;
    let graph = FrameGraph::new(config, outfit, state, step)?;
    let weights = Weights {
        dtype: parameters.get(&rotation_name())?.dtype(),
        parameters,
        device,
    };
    let patches = graph.patch_states.len();

    let normalise = |row: &StatePair| -> StatePair {
        std::array::from_fn(|i| (row[i] - statistics.mean[i % 6]) / statistics.std[i % 6])
    };
    let encode_states = |rows: Vec<StatePair>| -> Result<Tensor> {
        weights.encoder("input_projection", &weights.constant(&rows)?)
    };
    let patch_tokens = encode_states(graph.patch_states.iter().map(normalise).collect())?;
    // Without a body there is nothing to encode: candle's devices refuse empty products.
    let body_rows = match graph.body_rows.as_slice() {
        [] => None,
        rows => Some(encode_states(
            rows.iter()
                .map(|&vertex| normalise(&step.body[vertex as usize]))
                .collect(),
        )?),
    };
    let attributes = weights.encoder("attr_encoder", &weights.constant(&outfit.attributes)?)?;
    let wind = weights.encoder("invisible_force_encoder", &weights.constant(&[step.wind])?)?;
    let gravity = weights.encoder("gravity_encoder", &weights.constant(&[step.gravity])?)?;

    let particles = Tensor::cat(&[&patch_tokens, &attributes], 0)?;
    let mut body = vec![wind, gravity];
    if let (Some(rows), 1..) = (&body_rows, graph.body_tokens) {
        body.insert(0, rows.narrow(0, 0, graph.body_tokens)?);
    }
    let body = Tensor::cat(&body, 0)?;
    let senders = weights.encoder("sender_proj", &Tensor::cat(&[&particles, &body], 0)?)?;
    let mut tokens = Tokens {
        state: Tensor::cat(
            &[
                &weights.norm("backbone.particle_norm", &particles)?,
                &body, // never normalised
            ],
            0,
        )?,
        receiver: weights.norm(
            "backbone.receiver_norm",
            &weights.encoder("receiver_proj", &patch_tokens)?,
        )?,
        sender: weights.norm("backbone.sender_norm", &senders)?,
    };
    let mut blocks = Vec::new();
    for index in 0..config.blocks {
        let last = index + 1 == config.blocks;
        tokens = block(config, &weights, index, &tokens, &graph.edges, last)?;
        blocks.push(tokens.state.narrow(0, 0, patches)?.contiguous()?);
    }

    let embedding = blocks.last().expect("at least one block");
    let features = decoder_features(
        &weights,
        &graph,
        (state, step),
        embedding,
        body_rows.as_ref(),
    )?;
    let local = decode(&weights, &graph, &features)?;
    let columns = match config.output_scale {
        OutputScale::Velocity => 3,
        OutputScale::Acceleration => 6,
    };
    let anchors = graph.vertex_anchors.iter().chain(&graph.patch_anchors);
    let frames = weights.matrices(anchors.map(|anchor| anchor.frame).collect())?;
    let mut offsets = graph.trend(&statistics.trend, outfit, state, step);
    for offset in &mut offsets {
        *offset = [0, 1, 2].map(|axis| statistics.mean[columns + axis] + offset[axis]);
    }
    let std = weights.constant(&[[0, 1, 2].map(|axis| statistics.std[columns + axis])])?;
    let world = turn_back(&frames, &local)?
        .broadcast_mul(&std)?
        .add(&weights.constant(&offsets)?)?;
    let relative = world.narrow(0, 0, state.len())?.contiguous()?;
    let patch_acceleration = world.narrow(0, state.len(), patches)?.contiguous()?;
    let own = weights.indices(graph.own_patch.clone())?;
    Ok(Prediction {
        acceleration: (&relative + patch_acceleration.index_select(&own, 0)?)?,
        relative,
        patch_acceleration,
        blocks,
        graph,
        seconds: ForwardSeconds::default(),
    })
}

/// Named weights on the device, and what is made of them.
struct Weights<'a> {
    parameters: &'a Parameters,
    device: &'a Device,
    dtype: DType,
}

impl Weights<'_> {
    fn tensor(&self, name: &str) -> Result<Tensor> {
        Ok(self
            .parameters
            .get(name)?
            .as_tensor()
            .to_device(self.device)?)
    }

    /// Host numbers `[rows, W]`.
    fn constant<const W: usize>(&self, rows: &[[f32; W]]) -> Result<Tensor> {
        let flat = rows.as_flattened().to_vec();
        Ok(Tensor::from_vec(flat, (rows.len(), W), self.device)?.to_dtype(self.dtype)?)
    }

    /// Rotations `[rows, 3, 3]`.
    fn matrices(&self, all: Vec<Matrix>) -> Result<Tensor> {
        let flat: Vec<[f32; 9]> = all
            .iter()
            .map(|rows| std::array::from_fn(|i| rows[i / 3][i % 3]))
            .collect();
        Ok(self.constant(&flat)?.reshape((all.len(), 3, 3))?)
    }

    fn indices(&self, rows: Vec<u32>) -> Result<Tensor> {
        Ok(Tensor::new(rows, self.device)?)
    }

    /// `x Wᵀ`.
    fn product(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        Ok(x.matmul(&self.tensor(&format!("{name}.weight"))?.t()?)?)
    }

    /// `x Wᵀ + b`.
    fn affine(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        let bias = self.tensor(&format!("{name}.bias"))?;
        Ok(self.product(name, x)?.broadcast_add(&bias)?)
    }

    /// Linear, ReLU, linear, ReLU.
    fn encoder(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        let first = format!("backbone.{name}.layers.0.0");
        let second = format!("backbone.{name}.layers.1");
        Ok(self
            .affine(&second, &self.affine(&first, x)?.relu()?)?
            .relu()?)
    }

    /// Layer norm. candle's stock one returns no gradient.
    fn norm(&self, name: &str, x: &Tensor) -> Result<Tensor> {
        let centred = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
        let variance = centred.sqr()?.mean_keepdim(D::Minus1)?;
        Ok(centred
            .broadcast_div(&(variance + LAYER_NORM_EPSILON)?.sqrt()?)?
            .broadcast_mul(&self.tensor(&format!("{name}.weight"))?)?
            .broadcast_add(&self.tensor(&format!("{name}.bias"))?)?)
    }
}

/// What flows through the blocks: patches, attribute rows, body tokens, one below the other.
struct Tokens {
    /// `[P + A + G, 128]`; patches only after the last block.
    state: Tensor,
    /// Receivers' memory `[P, 128]`.
    receiver: Tensor,
    /// Senders' memory `[P + A + G, 128]`.
    sender: Tensor,
}

/// One Transformer block; see [`crate::block`]. The last one leaves the memories as they were.
fn block(
    config: &ModelConfig,
    weights: &Weights,
    index: usize,
    tokens: &Tokens,
    edges: &Edges,
    last: bool,
) -> Result<Tokens> {
    let base = format!("backbone.encoder.layers.{index}");
    let attention = |name: &str| format!("{base}.self_attn.attn.{name}");
    let patches = tokens.receiver.dim(0)?;
    let others = tokens.state.dim(0)? - patches;
    let patch_states = tokens.state.narrow(0, 0, patches)?;

    let remembered = |memory: &Tensor| -> Result<Tensor> {
        Ok((weights.product(&attention("memory_weight"), memory)? + memory)?)
    };
    let r = (weights.product(&attention("receiver_weight"), &patch_states)?
        + remembered(&tokens.receiver)?)?;
    let s = (weights.product(&attention("sender_weight"), &tokens.state)?
        + remembered(&tokens.sender)?)?;
    let q = weights.product(&attention("q_proj.layers.0"), &patch_states)?;

    let mut groups = Vec::new();
    for group in 0..GROUPS {
        let mlp = attention(&format!("rs_mlp.group_layers.{group}.layers.0"));
        groups.push(Group {
            w: weights.tensor(&group_rotation_name(index, group))?,
            m: weights.tensor(&format!("{mlp}.weight"))?,
            c: weights.tensor(&format!("{mlp}.bias"))?,
        });
    }
    let own_slots = config.body_messages == BodyMessages::Own;
    let attended = attend([&r, &q, &s], &groups, edges, own_slots)?
        .broadcast_mul(&weights.tensor(&attention("n_weight"))?.flatten_all()?)?
        .broadcast_add(&weights.tensor(&attention("n_bias"))?.flatten_all()?)?;
    let output = weights.affine(&attention("proj.layers.0"), &attended)?;

    let residual = if last {
        (patch_states + output)?
    } else {
        let unchanged = tokens.state.narrow(0, patches, others)?;
        (&tokens.state + Tensor::cat(&[&output, &unchanged], 0)?)?
    };
    let first = weights.norm(&format!("{base}.norms.0"), &residual)?;
    let hidden = weights
        .affine(&format!("{base}.ffn.layers.0.0"), &first)?
        .relu()?;
    let fed = weights
        .affine(&format!("{base}.ffn.layers.1"), &hidden)?
        .relu()?;
    let state = weights.norm(&format!("{base}.norms.1"), &(first + fed)?)?;
    if last {
        let (receiver, sender) = (tokens.receiver.clone(), tokens.sender.clone());
        return Ok(Tokens {
            state,
            receiver,
            sender,
        });
    }
    let memory = |norm: &str, name: &str, x: &Tensor| {
        weights.norm(
            &format!("{base}.{norm}"),
            &weights.affine(&attention(name), x)?,
        )
    };
    Ok(Tokens {
        state,
        receiver: memory("res_norms.0", "r_proj.layers.0", &r)?,
        sender: memory("res_norms.1", "s_proj.layers.0", &s)?,
    })
}

/// What a group's body messages are made with.
pub struct Group {
    /// Rotation weight `[16, 3]`.
    pub w: Tensor,
    /// `[16, 16]`.
    pub m: Tensor,
    /// `[16]`.
    pub c: Tensor,
}

/// Attention over sparse edges with rotated body messages, before n_weight and n_bias:
/// the formula at the top of [`crate::kernels::attention`]. Takes r `[P, 128]`,
/// q `[P, 128]`, s `[T + G, 128]`, returns `[P, 128]`. A head without edges gives 0.
///
/// # Errors
/// If shapes do not fit the edges.
pub fn attend(
    [r, q, s]: [&Tensor; 3],
    groups: &[Group],
    edges: &Edges,
    own_slots: bool,
) -> Result<Tensor> {
    let (device, dtype) = (r.device(), r.dtype());
    let patches = edges.mesh.rows();
    let zeros = Tensor::zeros((patches, GROUPS, HEAD), dtype, device)?;
    let heads = |x: &Tensor, mesh: usize| -> Result<Tensor> {
        let heads = x.reshape((x.dim(0)?, GROUPS, 2, HEAD))?;
        Ok(heads.narrow(2, mesh, 1)?.squeeze(2)?.contiguous()?)
    };

    let mesh_pairs: Vec<(u32, u32)> = edges.mesh.pairs().collect();
    let mesh = match EdgeList::new(patches, &mesh_pairs, device)? {
        None => zeros.clone(),
        Some(list) => {
            let scored = list.score(&heads(r, 1)?, &heads(q, 1)?, &heads(s, 1)?, None)?;
            sum_by(
                &scored.pair.broadcast_mul(&scored.weight.unsqueeze(2)?)?,
                &list.receivers,
                patches,
            )?
        }
    };

    // One softmax for world neighbours, then body tokens.
    let body_pairs: Vec<(u32, u32)> = edges.body.pairs().collect();
    let world_pairs: Vec<(u32, u32)> = edges
        .world
        .pairs()
        .chain(
            body_pairs
                .iter()
                .map(|&(row, token)| (row, token + edges.senders as u32)),
        )
        .collect();
    let (mut world, mut body) = (zeros.clone(), zeros.clone());
    if let Some(list) = EdgeList::new(patches, &world_pairs, device)? {
        let (plain, turned) = (edges.world.items.len(), body_pairs.len());
        let mut bias = vec![0f32; plain];
        bias.extend(&edges.body_log_count);
        let bias = Tensor::from_vec(bias, (plain + turned, 1), device)?.to_dtype(dtype)?;
        let scored = list.score(&heads(r, 0)?, &heads(q, 0)?, &heads(s, 0)?, Some(&bias))?;
        if plain > 0 {
            let weight = scored.weight.narrow(0, 0, plain)?.unsqueeze(2)?;
            world = sum_by(
                &scored.pair.narrow(0, 0, plain)?.broadcast_mul(&weight)?,
                &list.receivers.narrow(0, 0, plain)?,
                patches,
            )?;
        }
        if turned > 0 {
            let pair = scored.pair.narrow(0, plain, turned)?;
            let weight = scored.weight.narrow(0, plain, turned)?;
            let tokens: Vec<u32> = body_pairs.iter().map(|&(_, token)| token).collect();
            let flat: Vec<f32> = edges.rotations.as_flattened().as_flattened().to_vec();
            let rotations = Tensor::from_vec(flat, (edges.rotations.len(), 3, 3), device)?
                .to_dtype(dtype)?
                .index_select(&Tensor::new(tokens, device)?, 0)?;
            let mut messages = Vec::new();
            for (index, group) in groups.iter().enumerate() {
                let x = pair.narrow(1, index, 1)?.squeeze(1)?.contiguous()?;
                messages.push(body_message(group, &rotations, &x)?);
            }
            body = sum_by(
                &Tensor::stack(&messages, 1)?.broadcast_mul(&weight.unsqueeze(2)?)?,
                &list.receivers.narrow(0, plain, turned)?,
                patches,
            )?;
        }
    }
    let body = if own_slots {
        Tensor::stack(&[&body, &zeros], 2)?.reshape((patches, WIDTH))?
    } else {
        Tensor::cat(&[&body, &zeros], 1)?.reshape((patches, WIDTH))?
    };
    let own = Tensor::stack(&[&world, &mesh], 2)?.reshape((patches, WIDTH))?;
    Ok((own + body)?)
}

/// `R̂ᵀ relu(M R̂ x + c)` with `R̂ = W R Wᵀ`, for rows x `[E, 16]` and R `[E, 3, 3]`.
fn body_message(group: &Group, rotations: &Tensor, x: &Tensor) -> Result<Tensor> {
    let lift = group.w.t()?;
    let local = turn(rotations, &x.matmul(&group.w)?)?.matmul(&lift)?;
    let y = local
        .matmul(&group.m.t()?)?
        .broadcast_add(&group.c)?
        .relu()?;
    Ok(turn_back(rotations, &y.matmul(&group.w)?)?.matmul(&lift)?)
}

/// The edges of one kind of head; none is no list.
struct EdgeList {
    /// Receiver of each edge, `[E]`.
    receivers: Tensor,
    /// Sender's row of each edge, `[E]`.
    senders: Tensor,
    /// Edges of each receiver, `[P · degree]`, E where it has fewer.
    of_receiver: Tensor,
    patches: usize,
    degree: usize,
}

/// Of each edge and head:
struct Scored {
    /// Probability over |r − s|, `[E, 4]`.
    weight: Tensor,
    /// r + s, `[E, 4, 16]`.
    pair: Tensor,
}

impl EdgeList {
    fn new(patches: usize, pairs: &[(u32, u32)], device: &Device) -> Result<Option<Self>> {
        if pairs.is_empty() {
            return Ok(None);
        }
        let mut of_receiver = vec![Vec::new(); patches];
        for (edge, &(receiver, _)) in pairs.iter().enumerate() {
            of_receiver[receiver as usize].push(edge as u32);
        }
        let degree = of_receiver.iter().map(Vec::len).max().unwrap_or(0);
        for edges in &mut of_receiver {
            edges.resize(degree, pairs.len() as u32);
        }
        let [receivers, senders]: [Vec<u32>; 2] = [
            pairs.iter().map(|pair| pair.0).collect(),
            pairs.iter().map(|pair| pair.1).collect(),
        ];
        Ok(Some(Self {
            receivers: Tensor::new(receivers, device)?,
            senders: Tensor::new(senders, device)?,
            of_receiver: Tensor::new(of_receiver.concat(), device)?,
            patches,
            degree,
        }))
    }

    /// Weights and sums of heads r, q `[P, 4, 16]` and s `[T + G, 4, 16]`; `bias` `[E, 1]`
    /// is added to the logits.
    fn score(&self, r: &Tensor, q: &Tensor, s: &Tensor, bias: Option<&Tensor>) -> Result<Scored> {
        let r = r.index_select(&self.receivers, 0)?;
        let q = q.index_select(&self.receivers, 0)?;
        let s = s.index_select(&self.senders, 0)?;
        let squared = (&r - &s)?.sqr()?.sum(D::Minus1)?;
        // Before the root, which has no slope at 0.
        let distance = squared.maximum(SQUARED_DISTANCE_FLOOR)?.sqrt()?;
        let pair = (r + s)?;
        let aligned = (q * &pair)?.sum(D::Minus1)?;
        let mut logit = ((aligned * (2.0 * KAPPA))? / (&distance + 2.0 * EPSILON)?)?;
        if let Some(bias) = bias {
            logit = logit.broadcast_add(bias)?;
        }
        let top = self.largest(&logit)?.index_select(&self.receivers, 0)?;
        let weight = (logit - top)?.exp()?;
        let total = sum_by(&weight, &self.receivers, self.patches)?;
        let probability = (weight / total.index_select(&self.receivers, 0)?)?;
        Ok(Scored {
            weight: (probability / distance)?,
            pair,
        })
    }

    /// Largest value of each receiver's edges, `[P, 4]`, detached: a softmax does not depend
    /// on what is subtracted. A receiver without edges has −∞, which no edge reads.
    fn largest(&self, values: &Tensor) -> Result<Tensor> {
        let values = values.detach();
        let none = Tensor::full(f32::NEG_INFINITY, (1, GROUPS), values.device())?
            .to_dtype(values.dtype())?;
        Ok(Tensor::cat(&[&values, &none], 0)?
            .index_select(&self.of_receiver, 0)?
            .reshape((self.patches, self.degree, GROUPS))?
            .max(1)?)
    }
}

/// Sums of the rows of equal index, `[rows, …]`; 0 for an index that does not occur.
fn sum_by(values: &Tensor, index: &Tensor, rows: usize) -> Result<Tensor> {
    let mut shape = values.dims().to_vec();
    shape[0] = rows;
    let zeros = Tensor::zeros(shape, values.dtype(), values.device())?;
    Ok(zeros.index_add(&index.contiguous()?, &values.contiguous()?, 0)?)
}

/// `R x` for R `[rows, 3, 3]`, x `[rows, 3]`.
fn turn(rotations: &Tensor, x: &Tensor) -> Result<Tensor> {
    Ok(rotations.broadcast_mul(&x.unsqueeze(1)?)?.sum(2)?)
}

/// `Rᵀ x` for R `[rows, 3, 3]`, x `[rows, 3]`.
fn turn_back(rotations: &Tensor, x: &Tensor) -> Result<Tensor> {
    Ok(rotations.broadcast_mul(&x.unsqueeze(2)?)?.sum(1)?)
}

/// The decoder's rows `[rel | R̂ E | R̂ b]` with `R̂ = W R Wᵀ`, `[slots + P, 268]`: of every
/// (vertex, patch) pair, then of every patch.
fn decoder_features(
    weights: &Weights,
    graph: &FrameGraph,
    (state, step): (&[StatePair], &Step),
    embedding: &Tensor,
    body_rows: Option<&Tensor>,
) -> Result<Tensor> {
    let (mut relative, mut patch_of_row, mut anchors) = (Vec::new(), Vec::new(), Vec::new());
    for slot in &graph.slots {
        let patch = &graph.patch_states[slot.patch as usize];
        let vertex = &state[slot.vertex as usize];
        let anchor = &graph.vertex_anchors[slot.vertex as usize];
        let difference = std::array::from_fn(|i| vertex[i] - patch[i]);
        relative.push(turned(&difference, anchor));
        patch_of_row.push(slot.patch);
        anchors.push(anchor);
    }
    for (patch, anchor) in graph.patch_anchors.iter().enumerate() {
        relative.push(graph.patch_on_body(patch, step));
        patch_of_row.push(patch as u32);
        anchors.push(anchor);
    }
    let w = weights.tensor(&rotation_name())?;
    let frames = weights.matrices(anchors.iter().map(|anchor| anchor.frame).collect())?;
    let rotated = |rows: &Tensor| -> Result<Tensor> {
        Ok(turn(&frames, &rows.matmul(&w)?)?.matmul(&w.t()?)?)
    };
    let from_patch = rotated(&embedding.index_select(&weights.indices(patch_of_row)?, 0)?)?;
    let from_body = match body_rows {
        None => from_patch.zeros_like()?.detach(),
        Some(body) => {
            let rows = anchors.iter().map(|anchor| anchor.row.unwrap_or(0));
            let seen: Vec<[f32; 1]> = anchors
                .iter()
                .map(|anchor| [if anchor.row.is_some() { 1.0 } else { 0.0 }])
                .collect();
            let rows = body.index_select(&weights.indices(rows.collect())?, 0)?;
            rotated(&rows.broadcast_mul(&weights.constant(&seen)?)?)?
        }
    };
    Ok(Tensor::cat(
        &[&weights.constant(&relative)?, &from_patch, &from_body],
        1,
    )?)
}

/// Three numbers of each vertex and of each patch, in their frames, `[N + P, 3]`.
///
/// A vertex takes the mean over its pairs. As in `LayersNet` it is taken of the hidden rows,
/// `d = W Σh/(n + 1e-7) + b`, so the bias counts in full; the published program averages
/// after the last layer and shrinks it by 1e-7. A vertex without pairs has d = 0.
fn decode(weights: &Weights, graph: &FrameGraph, features: &Tensor) -> Result<Tensor> {
    let (vertices, pairs) = (graph.vertex_anchors.len(), graph.slots.len());
    let layer = |name: &str| format!("decode_head.proj.layers.{name}");
    let hidden = weights.affine(&layer("0.0"), features)?.relu()?;
    let hidden = weights.affine(&layer("1.0"), &hidden)?.relu()?;
    let of_patches = weights.affine(
        &layer("2"),
        &hidden.narrow(0, pairs, graph.patch_states.len())?,
    )?;
    let counts: Vec<[f32; 1]> = graph
        .slot_offsets
        .windows(2)
        .map(|ends| [(ends[1] - ends[0]) as f32])
        .collect();
    let taken: Vec<[f32; 1]> = counts.iter().map(|[count]| [count.min(1.0)]).collect();
    let sums = if pairs > 0 {
        let vertex_of_pair = graph.slots.iter().map(|slot| slot.vertex).collect();
        sum_by(
            &hidden.narrow(0, 0, pairs)?,
            &weights.indices(vertex_of_pair)?,
            vertices,
        )?
    } else {
        Tensor::zeros((vertices, DECODER_WIDTH), hidden.dtype(), hidden.device())?
    };
    let mean = sums.broadcast_div(&(weights.constant(&counts)? + EPSILON)?)?;
    let of_vertices = weights
        .affine(&layer("2"), &mean)?
        .broadcast_mul(&weights.constant(&taken)?)?;
    Ok(Tensor::cat(&[&of_vertices, &of_patches], 0)?)
}

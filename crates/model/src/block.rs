//! One Transformer block: attention, receiver and sender streams, feed-forward.
//!
//! All tokens share the weights, so patches, attribute tokens and body tokens are
//! rows of one matrix, one below the other. With Z the states, R the receivers'
//! and S the senders' memory:
//! `r = Z_P W_rᵀ + R W_mᵀ + R`, `s = Z W_sᵀ + S W_mᵀ + S`, `q = Z_P W_qᵀ`;
//! `Z₁ = LN₀(Z + Z')` with Z' the attention's output for patches and Z itself for
//! all other rows; `Z ← LN₁(Z₁ + relu(W₂ relu(W₁ Z₁)))`; `R ← LN_r(r_proj(r))`,
//! `S ← LN_s(s_proj(s))`. The last block computes its patch rows only.

use std::sync::Arc;

use candle_core::Tensor;

use crate::config::{BodyMessages, ModelConfig};
use crate::error::Result;
use crate::kernels::attention::{Edges, GROUPS, attend};
use crate::kernels::linear::{Activation, linear, product};
use crate::layersnet::{Affine, Norm, Source};
use crate::parameters::{Parameters, group_rotation_name};

/// What flows through the blocks.
pub struct Tokens {
    /// States `[P + A + G, 128]`.
    pub state: Tensor,
    /// Receivers' memory `[P, 128]`.
    pub receiver: Tensor,
    /// Senders' memory `[P + A + G, 128]`.
    pub sender: Tensor,
    /// P.
    pub patches: usize,
    /// P + A.
    pub particles: usize,
}

/// A block's weights.
pub struct Block {
    /// Receiver and query weights of the patches, stacked `[256, 128]`.
    receiver_query: Tensor,
    sender: Tensor,
    /// `W_m + I`: memories are kept beside what is made of them.
    memory: Tensor,
    /// The four groups' W, M, c.
    groups: Tensor,
    /// Output projection with n_weight and n_bias multiplied in.
    output_weight: Tensor,
    output_bias: Tensor,
    receiver_out: Affine,
    sender_out: Affine,
    feed_forward: [Affine; 2],
    norms: [Norm; 2],
    receiver_norm: Norm,
    sender_norm: Norm,
    own_slots: bool,
}

impl Block {
    /// Block `index` of the parameters, with weights that receive gradients.
    ///
    /// # Errors
    /// If a weight is missing.
    pub fn trainable(config: &ModelConfig, parameters: &Parameters, index: usize) -> Result<Self> {
        Self::new(
            config,
            &Source {
                parameters,
                trainable: true,
            },
            index,
        )
    }

    pub(crate) fn new(config: &ModelConfig, source: &Source, index: usize) -> Result<Self> {
        let base = format!("backbone.encoder.layers.{index}");
        let attention = |name: &str| format!("{base}.self_attn.attn.{name}");
        let mut groups = Vec::new();
        for group in 0..GROUPS {
            let mlp = attention(&format!("rs_mlp.group_layers.{group}.layers.0"));
            groups.push(
                source
                    .tensor(&group_rotation_name(index, group))?
                    .flatten_all()?,
            );
            groups.push(source.tensor(&format!("{mlp}.weight"))?.flatten_all()?);
            groups.push(source.tensor(&format!("{mlp}.bias"))?);
        }
        let memory = source.tensor(&attention("memory_weight.weight"))?;
        let output = source.tensor(&attention("proj.layers.0.weight"))?;
        let n_weight = source.tensor(&attention("n_weight"))?.flatten_all()?;
        let n_bias = source.tensor(&attention("n_bias"))?.reshape((1, ()))?;
        let bias = source.tensor(&attention("proj.layers.0.bias"))?;
        Ok(Self {
            receiver_query: Tensor::cat(
                &[
                    source.tensor(&attention("receiver_weight.weight"))?,
                    source.tensor(&attention("q_proj.layers.0.weight"))?,
                ],
                0,
            )?,
            sender: source.tensor(&attention("sender_weight.weight"))?,
            memory: (&memory + Tensor::eye(memory.dim(0)?, memory.dtype(), memory.device())?)?,
            groups: Tensor::cat(&groups, 0)?,
            output_bias: linear(&n_bias, &output, &bias, Activation::None)?.flatten_all()?,
            output_weight: output.broadcast_mul(&n_weight)?,
            receiver_out: source.affine(&attention("r_proj.layers.0"))?,
            sender_out: source.affine(&attention("s_proj.layers.0"))?,
            feed_forward: [
                source.affine(&format!("{base}.ffn.layers.0.0"))?,
                source.affine(&format!("{base}.ffn.layers.1"))?,
            ],
            norms: [
                source.norm(&format!("{base}.norms.0"))?,
                source.norm(&format!("{base}.norms.1"))?,
            ],
            receiver_norm: source.norm(&format!("{base}.res_norms.0"))?,
            sender_norm: source.norm(&format!("{base}.res_norms.1"))?,
            own_slots: config.body_messages == BodyMessages::Own,
        })
    }

    /// Runs the block; the last one returns patch rows and leaves the memories as they were.
    ///
    /// # Errors
    /// If tokens do not fit the edges.
    pub fn apply(&self, tokens: &Tokens, edges: &Arc<Edges>, last: bool) -> Result<Tokens> {
        let attended = self.attention(tokens, edges, last)?;
        let rows = attended.state.dim(0)?;
        let first = self.norms[0].apply(&(tokens.state.narrow(0, 0, rows)? + attended.state)?)?;
        let hidden = self.feed_forward[0].apply(&first, Activation::Relu)?;
        let state = self.norms[1]
            .apply(&(&first + self.feed_forward[1].apply(&hidden, Activation::Relu)?)?)?;
        let (receiver, sender) = if last {
            (attended.receiver, attended.sender)
        } else {
            (
                self.receiver_norm.apply(&attended.receiver)?,
                self.sender_norm.apply(&attended.sender)?,
            )
        };
        Ok(Tokens {
            state,
            receiver,
            sender,
            ..*tokens
        })
    }

    /// The attention alone, before residuals and norms: Z', `r_proj(r)`, `s_proj(s)`.
    ///
    /// # Errors
    /// As [`Block::apply`].
    pub fn attention(&self, tokens: &Tokens, edges: &Arc<Edges>, last: bool) -> Result<Tokens> {
        let &Tokens { patches, .. } = tokens;
        let rows = tokens.state.dim(0)?;
        let patch_states = tokens.state.narrow(0, 0, patches)?;
        let receiver_query = product(&patch_states, &self.receiver_query)?;
        let memories = product(
            &Tensor::cat(&[&tokens.receiver, &tokens.sender], 0)?,
            &self.memory,
        )?;
        let r = (receiver_query.narrow(1, 0, 128)? + memories.narrow(0, 0, patches)?)?;
        let q = receiver_query.narrow(1, 128, 128)?;
        let s = (product(&tokens.state, &self.sender)? + memories.narrow(0, patches, rows)?)?;
        let attended = attend(
            &Tensor::cat(&[&r, &q.contiguous()?, &s], 0)?,
            &self.groups,
            edges.clone(),
            self.own_slots,
        )?;
        let output = linear(
            &attended,
            &self.output_weight,
            &self.output_bias,
            Activation::None,
        )?;
        if last {
            let (receiver, sender) = (tokens.receiver.clone(), tokens.sender.clone());
            return Ok(Tokens {
                state: output,
                receiver,
                sender,
                ..*tokens
            });
        }
        let others = tokens.state.narrow(0, patches, rows - patches)?;
        Ok(Tokens {
            state: Tensor::cat(&[&output, &others], 0)?,
            receiver: self.receiver_out.apply(&r, Activation::None)?,
            sender: self.sender_out.apply(&s, Activation::None)?,
            ..*tokens
        })
    }
}

//! The Transformer blocks' weights, arranged for [`crate::kernels::blocks`].

use std::sync::Arc;

use candle_core::Tensor;

use crate::config::{BodyMessages, ModelConfig};
use crate::error::Result;
use crate::kernels::attention::{Edges, GROUPS};
use crate::kernels::blocks::{Ends, Stack, Transposes, apply};
use crate::kernels::linear::{Activation, linear};
use crate::layersnet::Source;
use crate::parameters::{Parameters, group_rotation_name};

/// What goes through the blocks.
pub struct Tokens {
    /// States of patches, attribute rows and body tokens: `[P + A + G, 128]`.
    pub state: Tensor,
    /// Receivers' memory `[P, 128]`.
    pub receiver: Tensor,
    /// Senders' memory `[P + A + G, 128]`.
    pub sender: Tensor,
}

/// All blocks.
pub struct Blocks {
    count: usize,
    /// One block's weights behind the other's, in the kernel's order.
    weights: Tensor,
    transposes: Arc<Transposes>,
    own_slots: bool,
    trainable: bool,
}

impl Blocks {
    /// Blocks of the parameters, with weights that receive gradients.
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

    pub(crate) fn new(config: &ModelConfig, source: &Source) -> Result<Self> {
        let mut weights = Vec::new();
        for index in 0..config.blocks {
            push_block(source, index, &mut weights)?;
        }
        Ok(Self {
            count: config.blocks,
            weights: Tensor::cat(&weights, 0)?,
            transposes: Arc::default(),
            own_slots: config.body_messages == BodyMessages::Own,
            trainable: source.trainable,
        })
    }

    /// Patches' states `[P, 128]` after the last block.
    ///
    /// # Errors
    /// If tokens do not fit the edges.
    pub fn patches(&self, tokens: &Tokens, edges: &Arc<Edges>) -> Result<Tensor> {
        self.apply(tokens, edges, Ends::Patches)
    }

    /// All that comes out of the last block.
    ///
    /// # Errors
    /// If tokens do not fit the edges.
    pub fn everything(&self, tokens: &Tokens, edges: &Arc<Edges>) -> Result<Tokens> {
        let all = self.apply(tokens, edges, Ends::Everything)?;
        let (rows, patches) = (tokens.state.dim(0)?, tokens.receiver.dim(0)?);
        Ok(Tokens {
            state: all.narrow(0, 0, rows)?,
            receiver: all.narrow(0, rows, patches)?,
            sender: all.narrow(0, rows + patches, rows)?,
        })
    }

    fn apply(&self, tokens: &Tokens, edges: &Arc<Edges>, ends: Ends) -> Result<Tensor> {
        let all = Tensor::cat(&[&tokens.state, &tokens.receiver, &tokens.sender], 0)?;
        let stack = Stack {
            edges: edges.clone(),
            blocks: self.count,
            own_slots: self.own_slots,
            ends,
            keep: self.trainable,
            transposes: self.transposes.clone(),
        };
        Ok(apply(&all, &self.weights, stack)?)
    }
}

/// A block's weights in the kernel's order.
fn push_block(source: &Source, index: usize, weights: &mut Vec<Tensor>) -> Result<()> {
    let base = format!("backbone.encoder.layers.{index}");
    let attention = |name: &str| format!("{base}.self_attn.attn.{name}");
    let mut push = |tensor: &Tensor| -> Result<()> {
        weights.push(tensor.flatten_all()?);
        Ok(())
    };
    for name in ["receiver_weight", "q_proj.layers.0", "sender_weight"] {
        push(&source.tensor(&attention(&format!("{name}.weight")))?)?;
    }
    // Memories are kept beside what is made of them.
    let memory = source.tensor(&attention("memory_weight.weight"))?;
    push(&(&memory + Tensor::eye(memory.dim(0)?, memory.dtype(), memory.device())?)?)?;
    for group in 0..GROUPS {
        let mlp = attention(&format!("rs_mlp.group_layers.{group}.layers.0"));
        push(&source.tensor(&group_rotation_name(index, group))?)?;
        push(&source.tensor(&format!("{mlp}.weight"))?)?;
        push(&source.tensor(&format!("{mlp}.bias"))?)?;
    }
    // n_weight and n_bias multiplied into the output projection.
    let output = source.tensor(&attention("proj.layers.0.weight"))?;
    let bias = source.tensor(&attention("proj.layers.0.bias"))?;
    let n_weight = source.tensor(&attention("n_weight"))?.flatten_all()?;
    let n_bias = source.tensor(&attention("n_bias"))?.reshape((1, ()))?;
    push(&output.broadcast_mul(&n_weight)?)?;
    push(&linear(&n_bias, &output, &bias, Activation::None)?)?;
    for name in [
        attention("r_proj.layers.0"),
        attention("s_proj.layers.0"),
        format!("{base}.ffn.layers.0.0"),
        format!("{base}.ffn.layers.1"),
        format!("{base}.norms.0"),
        format!("{base}.norms.1"),
        format!("{base}.res_norms.0"),
        format!("{base}.res_norms.1"),
    ] {
        push(&source.tensor(&format!("{name}.weight"))?)?;
        push(&source.tensor(&format!("{name}.bias"))?)?;
    }
    Ok(())
}

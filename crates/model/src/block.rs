//! The Transformer blocks' weights, arranged for [`crate::kernels::blocks`].

use std::collections::BTreeMap;
use std::sync::Arc;

use candle_core::backprop::GradStore;
use candle_core::{Tensor, Var};

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
    /// One block's weights behind the other's, in the kernel's order. Of trainable blocks a variable
    /// of its own, where a backward pass ends: candle would copy the gradients once more for each
    /// step between the arranged weights and the parameters.
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
            let names = Names::new(index);
            let [output, output_bias] = Output::new(source.parameters, index)?.product()?;
            for name in &names.all {
                let weight = source.parameters.get(name)?.as_detached_tensor();
                let weight = if *name == names.memory {
                    // Memories are kept beside what is made of them.
                    (&weight + Tensor::eye(weight.dim(0)?, weight.dtype(), weight.device())?)?
                } else if *name == names.output[0] {
                    output.clone()
                } else if *name == names.output[1] {
                    output_bias.clone()
                } else {
                    weight
                };
                weights.push(weight.flatten_all()?);
            }
        }
        let weights = Tensor::cat(&weights, 0)?;
        Ok(Self {
            count: config.blocks,
            weights: match source.trainable {
                true => Var::from_tensor(&weights)?.into_inner(),
                false => weights,
            },
            transposes: Arc::default(),
            own_slots: config.body_messages == BodyMessages::Own,
            trainable: source.trainable,
        })
    }

    /// Gradients of the blocks' weights by name, from a backward pass through these blocks;
    /// `parameters` are those that the blocks were made of. None if it did not reach them.
    ///
    /// # Errors
    /// If a weight is missing.
    pub fn gradients(
        &self,
        parameters: &Parameters,
        store: &GradStore,
    ) -> Result<BTreeMap<String, Tensor>> {
        match store.get(&self.weights) {
            Some(gradient) => self.by_name(parameters, gradient),
            None => Ok(BTreeMap::new()),
        }
    }

    /// Gradients by name from that of the arranged weights.
    pub(crate) fn by_name(
        &self,
        parameters: &Parameters,
        gradient: &Tensor,
    ) -> Result<BTreeMap<String, Tensor>> {
        let mut all = BTreeMap::new();
        let mut start = 0;
        for index in 0..self.count {
            let names = Names::new(index);
            for name in &names.all {
                let shape = parameters.get(name)?.shape();
                let own = gradient.narrow(0, start, shape.elem_count())?;
                start += shape.elem_count();
                all.insert(name.clone(), own.reshape(shape)?);
            }
            let output = Output::new(parameters, index)?;
            let [weight, bias] = names.output.each_ref().map(|name| &all[name]);
            let [weight, scale, shift] = output.gradients(weight, bias)?;
            all.insert(names.output[0].clone(), weight);
            for (name, gradient) in output.names.iter().zip([scale, shift]) {
                let shape = parameters.get(name)?.shape();
                all.insert(name.clone(), gradient.reshape(shape)?);
            }
        }
        Ok(all)
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
        Ok(apply(&all, &self.weights, self.stack(edges, ends))?)
    }

    /// The blocks over a frame's edges.
    pub(crate) fn stack(&self, edges: &Arc<Edges>, ends: Ends) -> Stack {
        Stack {
            edges: edges.clone(),
            blocks: self.count,
            own_slots: self.own_slots,
            ends,
            keep: self.trainable,
            transposes: self.transposes.clone(),
        }
    }

    /// One block's weights behind the other's, in the kernel's order.
    pub(crate) fn weights(&self) -> &Tensor {
        &self.weights
    }
}

/// Names of a block's weights in the kernel's order; of the weight of memories, M = W_m + I is
/// taken, of the output projection what [`Output`] makes of it.
struct Names {
    all: Vec<String>,
    memory: String,
    output: [String; 2],
}

impl Names {
    fn new(index: usize) -> Self {
        let base = format!("backbone.encoder.layers.{index}");
        let attention = |name: &str| format!("{base}.self_attn.attn.{name}");
        let memory = attention("memory_weight.weight");
        let mut all = ["receiver_weight", "q_proj.layers.0", "sender_weight"]
            .map(|name| attention(&format!("{name}.weight")))
            .to_vec();
        all.push(memory.clone());
        for group in 0..GROUPS {
            let mlp = attention(&format!("rs_mlp.group_layers.{group}.layers.0"));
            all.push(group_rotation_name(index, group));
            all.extend([format!("{mlp}.weight"), format!("{mlp}.bias")]);
        }
        let output = ["weight", "bias"].map(|kind| attention(&format!("proj.layers.0.{kind}")));
        all.extend(output.clone());
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
            all.extend([format!("{name}.weight"), format!("{name}.bias")]);
        }
        Self {
            all,
            memory,
            output,
        }
    }
}

/// The output projection O, b, with the layer n (scale) and m (shift) before it multiplied into it:
/// O' = O diag(n), b' = b + O m.
struct Output {
    weight: Tensor,
    bias: Tensor,
    /// n and m, `[1, 128]`, and their names.
    scale: Tensor,
    shift: Tensor,
    names: [String; 2],
}

impl Output {
    fn new(parameters: &Parameters, index: usize) -> Result<Self> {
        let of = |name: &str| format!("backbone.encoder.layers.{index}.self_attn.attn.{name}");
        let get = |name: &str| -> Result<Tensor> { Ok(parameters.get(name)?.as_detached_tensor()) };
        let names = ["n_weight", "n_bias"].map(of);
        Ok(Self {
            weight: get(&of("proj.layers.0.weight"))?,
            bias: get(&of("proj.layers.0.bias"))?,
            scale: get(&names[0])?.reshape((1, ()))?,
            shift: get(&names[1])?.reshape((1, ()))?,
            names,
        })
    }

    /// O' and b'.
    fn product(&self) -> Result<[Tensor; 2]> {
        Ok([
            self.weight.broadcast_mul(&self.scale)?,
            linear(&self.shift, &self.weight, &self.bias, Activation::None)?,
        ])
    }

    /// Gradients of O, n and m from those of O' and b'; that of b is that of b'.
    fn gradients(&self, weight: &Tensor, bias: &Tensor) -> Result<[Tensor; 3]> {
        let row = bias.reshape((1, ()))?;
        Ok([
            (weight.broadcast_mul(&self.scale)? + row.t()?.matmul(&self.shift)?)?,
            (weight * &self.weight)?.sum(0)?,
            row.matmul(&self.weight)?,
        ])
    }
}

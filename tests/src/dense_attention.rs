//! The attention's formula written out densely with candle's stock operations:
//! every pair is computed and masked afterwards, every rotation is a 16×16 matrix,
//! and the backward pass is candle's own. Slow, and shares nothing with the kernel.
//!
//! σ = |r − s|/2, logit κ q·(r + s)/(σ + 1e-7) with κ = 1/4, weight p/(2σ) with p
//! the softmax over unmasked entries; a row without entries gets weights 0.

use anyhow::Result;
use candle_core::{D, DType, Device, Tensor};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, HEAD, WIDTH};

const MASKED: f64 = -1e30;

/// Weights p/(2σ) of all pairs.
pub struct DenseWeights {
    /// Of senders that are no body tokens, `[4, 2, P, T]`: groups, (world, mesh).
    pub senders: Tensor,
    /// Of body slots in world heads, `[4, P, K]`.
    pub body: Tensor,
}

/// Twice σ and the logits of r `[.., P, 1, 16]` against s `[.., P or 1, T, 16]`.
fn logits(r: &Tensor, q: &Tensor, s: &Tensor) -> Result<(Tensor, Tensor)> {
    let distance = r.broadcast_sub(s)?.sqr()?.sum(D::Minus1)?.sqrt()?;
    let aligned = r.broadcast_add(s)?.broadcast_mul(q)?.sum(D::Minus1)?;
    let logit = ((aligned * 0.25)? / ((&distance * 0.5)? + 1e-7)?)?;
    Ok((distance, logit))
}

/// Softmax over the last axis of unmasked entries; `mask` of the same shape, 0 or 1.
fn masked_softmax(logit: &Tensor, mask: &Tensor) -> Result<Tensor> {
    let hidden = (Tensor::ones_like(mask)? - mask)?;
    let logit = ((logit * mask)? + (&hidden * MASKED)?)?;
    let top = logit.max_keepdim(D::Minus1)?.detach();
    let weight = (logit.broadcast_sub(&top)?.exp()? * mask)?;
    let total = weight.sum_keepdim(D::Minus1)?;
    let empty = total.le(0.0)?.to_dtype(total.dtype())?;
    Ok(weight.broadcast_div(&(total + empty)?)?)
}

/// Weights of r, q `[4, 2, P, 16]` and s `[4, 2, T, 16]`, body `[4, P, K, 16]`, with
/// masks `[2, P, T]` (world, mesh) and `[P, K]`, and what is added to body logits `[P, K]`.
///
/// # Errors
/// If the shapes do not fit.
pub fn dense_weights(
    [r, q, s]: [&Tensor; 3],
    body: &Tensor,
    mask: &Tensor,
    body_mask: &Tensor,
    body_bias: &Tensor,
) -> Result<DenseWeights> {
    let (r, q) = (r.unsqueeze(3)?, q.unsqueeze(3)?);
    let (distance, logit) = logits(&r, &q, &s.unsqueeze(2)?)?;
    let senders = s.dim(2)?;
    let pick = |tensor: &Tensor, which: usize| -> Result<Tensor> {
        Ok(tensor.narrow(1, which, 1)?.squeeze(1)?)
    };
    let (body_distance, body_logit) = logits(&pick(&r, 0)?, &pick(&q, 0)?, body)?;
    let body_logit = body_logit.broadcast_add(body_bias)?;
    let slots = body.dim(2)?;

    let groups = |mask: &Tensor| -> Result<Tensor> {
        Ok(mask
            .unsqueeze(0)?
            .broadcast_as((GROUPS, mask.dim(0)?, mask.dim(1)?))?
            .contiguous()?)
    };
    let world_mask = Tensor::cat(&[&mask.get(0)?, body_mask], 1)?;
    let world = masked_softmax(
        &Tensor::cat(&[&pick(&logit, 0)?, &body_logit], 2)?,
        &groups(&world_mask)?,
    )?;
    let mesh = masked_softmax(&pick(&logit, 1)?, &groups(&mask.get(1)?)?)?;
    let p = Tensor::stack(&[&world.narrow(2, 0, senders)?, &mesh], 1)?;
    Ok(DenseWeights {
        senders: (p / distance)?,
        body: (world.narrow(2, senders, slots)? / body_distance)?,
    })
}

/// A list of indices as a 0/1 matrix.
fn dense(list: &Csr, columns: usize, dtype: DType) -> Result<Tensor> {
    let mut all = vec![0f64; list.rows() * columns];
    for (row, item) in list.pairs() {
        all[row as usize * columns + item as usize] = 1.0;
    }
    Ok(Tensor::from_vec(all, (list.rows(), columns), &Device::Cpu)?.to_dtype(dtype)?)
}

/// What [`drape_model::kernels::attention::attend`] computes.
///
/// # Errors
/// If the shapes do not fit.
pub fn dense_attend(
    tokens: &Tensor,
    parameters: &Tensor,
    edges: &Edges,
    own_slots: bool,
) -> Result<Tensor> {
    let dtype = tokens.dtype();
    let (receivers, senders, slots) = (edges.mesh.rows(), edges.senders, edges.rotations.len());
    let heads = |start: usize, rows: usize| -> Result<Tensor> {
        Ok(tokens
            .narrow(0, start, rows)?
            .reshape((rows, GROUPS, 2, HEAD))?
            .permute((1, 2, 0, 3))?
            .contiguous()?)
    };
    let (r, q) = (heads(0, receivers)?, heads(receivers, receivers)?);
    let (s, g) = (
        heads(2 * receivers, senders)?,
        heads(2 * receivers + senders, slots)?,
    );
    let g = g.narrow(1, 0, 1)?.squeeze(1)?;
    let body = g
        .unsqueeze(1)?
        .broadcast_as((GROUPS, receivers, slots, HEAD))?
        .contiguous()?;
    let mut bias = vec![0f64; receivers * slots];
    for ((row, item), &count) in edges.body.pairs().zip(&edges.body_log_count) {
        bias[row as usize * slots + item as usize] = f64::from(count);
    }
    let bias = Tensor::from_vec(bias, (receivers, slots), &Device::Cpu)?.to_dtype(dtype)?;
    let mask = Tensor::stack(
        &[
            dense(&edges.world, senders, dtype)?,
            dense(&edges.mesh, senders, dtype)?,
        ],
        0,
    )?;
    let weights = dense_weights(
        [&r, &q, &s],
        &body,
        &mask,
        &dense(&edges.body, slots, dtype)?,
        &bias,
    )?;

    // Σ_j w_ij (r_i + s_j), by heads.
    let pairs = r.unsqueeze(3)?.broadcast_add(&s.unsqueeze(2)?)?;
    let own = pairs
        .broadcast_mul(&weights.senders.unsqueeze(4)?)?
        .sum(3)?;
    let own = own.permute((2, 0, 1, 3))?.reshape((receivers, WIDTH))?;

    let rotations: Vec<f32> = edges
        .rotations
        .iter()
        .flatten()
        .flatten()
        .copied()
        .collect();
    let rotations = Tensor::from_vec(rotations, (slots, 3, 3), &Device::Cpu)?.to_dtype(dtype)?;
    let mut messages = Vec::new();
    for group in 0..GROUPS {
        let all = parameters.narrow(0, group * GROUP_PARAMETERS, GROUP_PARAMETERS)?;
        let w = all.narrow(0, 0, HEAD * 3)?.reshape((HEAD, 3))?;
        let m = all
            .narrow(0, HEAD * 3, HEAD * HEAD)?
            .reshape((HEAD, HEAD))?;
        let c = all.narrow(0, HEAD * 3 + HEAD * HEAD, HEAD)?;
        let w_each = w
            .unsqueeze(0)?
            .broadcast_as((slots, HEAD, 3))?
            .contiguous()?;
        let turn = w_each
            .matmul(&rotations)?
            .matmul(&w_each.transpose(1, 2)?.contiguous()?)?;
        let apply = |matrix: &Tensor, x: &Tensor| -> Result<Tensor> {
            Ok(matrix
                .unsqueeze(0)?
                .broadcast_mul(&x.unsqueeze(2)?)?
                .sum(3)?)
        };
        let world = r.get(group)?.get(0)?;
        let u = world
            .unsqueeze(1)?
            .broadcast_add(&g.get(group)?.unsqueeze(0)?)?;
        let inner = apply(
            &m.unsqueeze(0)?
                .broadcast_as((slots, HEAD, HEAD))?
                .contiguous()?,
            &apply(&turn, &u)?,
        )?;
        let inner = inner.broadcast_add(&c)?.relu()?;
        let o = apply(&turn.transpose(1, 2)?.contiguous()?, &inner)?;
        messages.push(
            o.broadcast_mul(&weights.body.get(group)?.unsqueeze(2)?)?
                .sum(1)?,
        );
    }
    let zero = messages[0].zeros_like()?;
    let order: Vec<&Tensor> = if own_slots {
        messages
            .iter()
            .flat_map(|message| [message, &zero])
            .collect()
    } else {
        messages
            .iter()
            .chain(std::iter::repeat_n(&zero, GROUPS))
            .collect()
    };
    Ok((own + Tensor::cat(&order, 1)?)?)
}

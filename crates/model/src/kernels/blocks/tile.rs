//! What a block does to one tile, forward and back; names as in the formula of [`super`].

use std::ops::Range;

use super::super::attention::{Gradient, token_gradient};
use super::super::product::{add, mask, relu, sum};
use super::super::{Real, fit};
use super::weights::{
    FEED, MEMORY, OUTPUT, QUERY, RECEIVER, RECEIVER_OUT, SENDER, SENDER_OUT, Weights,
};

/// What one tile keeps of a block; names as in the module's formula.
#[derive(Clone, Default)]
pub(super) struct Tile<T> {
    /// Z, R (patches only) and S as they come in.
    pub(super) z: Vec<T>,
    pub(super) receiver: Vec<T>,
    pub(super) sender: Vec<T>,
    /// Z + o, before LN₀.
    pub(super) residual: Vec<T>,
    pub(super) z1: Vec<T>,
    /// relu(W₁ Z₁ + b₁), and relu(W₂ · + b₂).
    pub(super) hidden: Vec<T>,
    pub(super) fed: Vec<T>,
    /// r W_Rᵀ + b_R and s W_Sᵀ + b_S, before their norms.
    pub(super) receiver_out: Vec<T>,
    pub(super) sender_out: Vec<T>,
    /// Z₁ + fed, before LN₁; not kept.
    pub(super) scratch: Vec<T>,
}

impl<T: Real> Tile<T> {
    /// r, q and s of the tile's rows.
    pub(super) fn send(&self, weights: &Weights<T>, [r, q, s]: [&mut [T]; 3]) {
        if !r.is_empty() {
            weights.forward(RECEIVER, &self.z, r);
            weights.forward_add(MEMORY, &self.receiver, r);
            weights.forward(QUERY, &self.z, q);
        }
        weights.forward(SENDER, &self.z, s);
        weights.forward_add(MEMORY, &self.sender, s);
    }

    /// The rest of the block after the attention; `next` gets Z and, unless the block is the last, R and S.
    pub(super) fn update(
        &mut self,
        weights: &Weights<T>,
        attended: &[T],
        [r, _, s]: [&[T]; 3],
        z: &mut [T],
        memories: Option<(&mut [T], &mut [T])>,
    ) {
        let len = self.z.len();
        let residual = fit(&mut self.residual, len);
        if attended.is_empty() {
            sum(&self.z, &self.z, residual);
        } else {
            weights.forward(OUTPUT, attended, residual);
            add(&self.z, residual);
        }
        let z1 = fit(&mut self.z1, len);
        weights.norm_forward(0, residual, z1);
        let hidden = fit(&mut self.hidden, 2 * len);
        weights.forward(FEED[0], z1, hidden);
        relu(hidden);
        let fed = fit(&mut self.fed, len);
        weights.forward(FEED[1], hidden, fed);
        relu(fed);
        let scratch = fit(&mut self.scratch, len);
        sum(z1, fed, scratch);
        weights.norm_forward(1, scratch, z);
        if let Some((next_receiver, next_sender)) = memories {
            let receiver_out = fit(&mut self.receiver_out, r.len());
            if !r.is_empty() {
                weights.forward(RECEIVER_OUT, r, receiver_out);
                weights.norm_forward(2, receiver_out, next_receiver);
            }
            let sender_out = fit(&mut self.sender_out, len);
            weights.forward(SENDER_OUT, s, sender_out);
            weights.norm_forward(3, sender_out, next_sender);
        }
    }
}

/// A tile's gradients and room for work.
#[derive(Clone, Default)]
pub(super) struct TileGradient<T> {
    /// Of Z, R and S: of what comes out before a block, of what came in after it.
    pub(super) z: Vec<T>,
    pub(super) receiver: Vec<T>,
    pub(super) sender: Vec<T>,
    /// Of the layers' outputs.
    pub(super) fed: Vec<T>,
    pub(super) hidden: Vec<T>,
    pub(super) output: Vec<T>,
    pub(super) receiver_out: Vec<T>,
    pub(super) sender_out: Vec<T>,
    pub(super) r: Vec<T>,
    pub(super) q: Vec<T>,
    pub(super) s: Vec<T>,
    pub(super) scratch: Vec<T>,
    /// Of the norms' weights.
    pub(super) norms: Vec<T>,
}

impl<T: Real> TileGradient<T> {
    /// Back through [`Tile::update`]: from the gradients of what came out to those of the layers'
    /// outputs, of the attention's output, and the parts of Z, r and s that do not pass it.
    pub(super) fn update(
        &mut self,
        weights: &Weights<T>,
        tile: &mut Tile<T>,
        [r, _, s]: [&[T]; 3],
        attended: &mut [T],
        memories: bool,
    ) {
        let len = tile.z.len();
        let scratch = fit(&mut tile.scratch, len);
        sum(&tile.z1, &tile.fed, scratch);
        let dz1 = fit(&mut self.scratch, len);
        weights.norm_backward(1, scratch, &self.z, dz1, &mut self.norms);
        let fed = fit(&mut self.fed, len);
        fed.copy_from_slice(dz1);
        mask(&tile.fed, fed);
        let hidden = fit(&mut self.hidden, 2 * len);
        weights.backward(FEED[1], fed, hidden, false);
        mask(&tile.hidden, hidden);
        weights.backward(FEED[0], hidden, dz1, true);
        let output = fit(&mut self.output, len);
        weights.norm_backward(0, &tile.residual, dz1, output, &mut self.norms);
        self.z.copy_from_slice(output);
        if attended.is_empty() {
            add(output, &mut self.z);
        } else {
            weights.backward(OUTPUT, output, attended, false);
        }
        let d_s = fit(&mut self.s, s.len());
        let d_r = fit(&mut self.r, r.len());
        if memories {
            if !r.is_empty() {
                let out = fit(&mut self.receiver_out, r.len());
                weights.norm_backward(2, &tile.receiver_out, &self.receiver, out, &mut self.norms);
                weights.backward(RECEIVER_OUT, out, d_r, false);
            }
            let out = fit(&mut self.sender_out, s.len());
            weights.norm_backward(3, &tile.sender_out, &self.sender, out, &mut self.norms);
            weights.backward(SENDER_OUT, out, d_s, false);
        } else {
            d_r.fill(T::zero());
            d_s.fill(T::zero());
        }
    }

    /// Back through [`Tile::send`]: Z, R and S as they came in.
    pub(super) fn send(
        &mut self,
        weights: &Weights<T>,
        attention: &Gradient<T>,
        rows: &Range<usize>,
        patches: usize,
    ) {
        let mut take = |first: usize, to: &mut [T]| {
            let from = fit(&mut self.scratch, to.len());
            token_gradient(attention, patches, first, from);
            add(from, to);
        };
        take(2 * patches + rows.start, &mut self.s);
        if !self.r.is_empty() {
            take(rows.start, &mut self.r);
            let q = fit(&mut self.q, self.r.len());
            token_gradient(attention, patches, patches + rows.start, q);
            weights.backward(RECEIVER, &self.r, &mut self.z, true);
            weights.backward(QUERY, q, &mut self.z, true);
            let receiver = fit(&mut self.receiver, self.r.len());
            weights.backward(MEMORY, &self.r, receiver, false);
        }
        weights.backward(SENDER, &self.s, &mut self.z, true);
        let sender = fit(&mut self.sender, self.s.len());
        weights.backward(MEMORY, &self.s, sender, false);
    }
}

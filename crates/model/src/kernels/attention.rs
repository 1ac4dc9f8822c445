//! Rotation-invariant attention over sparse edges, with rotated body messages.
//!
//! Per head of 16 channels, receiver r, query q and sender s (patch, attribute or
//! body token): `f = (r + s)/|r − s|`, logit `ℓ = 2κ q·(r + s)/(|r − s| + 2e-7)`,
//! κ = 1/4. Heads come in four groups of two, a world head and a mesh head. The
//! mesh head attends to mesh neighbours and attribute tokens and returns Σ p f.
//! The world head attends jointly to world neighbours, whose messages are f, and
//! to body tokens, whose messages are, with the token's rotation R and the
//! group's W `[16, 3]`, M `[16, 16]`, c `[16]`:
//! `o = W Rᵀ Wᵀ relu(M W R Wᵀ (r + s) + c)/|r − s|`.
//! A body token that occurs n times adds log n to its logit. Rows without entries
//! give 0. Only listed entries are computed, so nothing is masked after dividing;
//! |r − s|² is summed directly and kept above 1e-12.
//!
//! Inside, a token's channels are in another order (`place_of`): world heads, then mesh
//! heads; of each kind channel by channel the numbers of the four groups. A pass takes one
//! sender after the other, all groups at once, and never turns rows into columns.
//!
//! Source: equations 2 and 3 of the paper's supplement; the published program's
//! factors (its description, section 8). Backward by hand; the probabilities are
//! computed again instead of being stored.

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};

use super::{Real, by_dtype, fit, for_all, for_all_with, operand, simd_dispatch, values};
use drape_dataset::patches::Csr;
use rayon::prelude::*;

/// Channels of one head.
pub const HEAD: usize = 16;
/// Groups of a world head and a mesh head.
pub const GROUPS: usize = 4;
/// Width of a token.
pub const WIDTH: usize = 2 * GROUPS * HEAD;
/// Parameters of one group: W, M, c.
pub const GROUP_PARAMETERS: usize = HEAD * 3 + HEAD * HEAD + HEAD;

/// Kinds of heads: world, then mesh.
const KINDS: usize = 2;
/// Numbers of a vector: four channels of four groups.
const LANES: usize = 4 * GROUPS;
/// Channels of one kind's heads.
const KIND_WIDTH: usize = GROUPS * HEAD;
/// Parts of the receivers whose gradients are summed apart; fixed, so that bits do not depend on threads.
const PARTS: usize = 2;
const EPSILON: f64 = 1e-7;
const SQUARED_DISTANCE_FLOOR: f64 = 1e-12;
const KAPPA: f64 = 0.25;
/// Receivers of one block of the forward pass; fixed, so that bits do not depend on threads.
const BLOCK_ROWS: usize = 64;

/// Who attends to whom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Edges {
    /// Sender tokens of each receiver's mesh heads: patches, then attribute tokens.
    pub mesh: Csr,
    /// Sender tokens of each receiver's world heads.
    pub world: Csr,
    /// Body tokens of each receiver's world heads.
    pub body: Csr,
    /// Logarithm of how often each entry of `body` counts.
    pub body_log_count: Vec<f32>,
    /// Rotation (rows) of each body token.
    pub rotations: Vec<[[f32; 3]; 3]>,
    /// Number of sender tokens that are not body tokens.
    pub senders: usize,
}

/// Joint attention; returns `[receivers, 128]`.
///
/// `tokens` holds r `[P, 128]`, q `[P, 128]` and the senders `[T + G, 128]` one
/// below the other; `parameters` the four groups' W, M, c, `[4 · 320]`.
/// With `own_slots`, body messages are added to the world head they were attended
/// with; without, group g's go to head slot g, as the published program does.
///
/// # Errors
/// Shapes that do not fit the edges, or a type other than f32 and f64.
pub fn attend(
    tokens: &Tensor,
    parameters: &Tensor,
    edges: Arc<Edges>,
    own_slots: bool,
) -> Result<Tensor> {
    tokens
        .contiguous()?
        .apply_op2(&parameters.contiguous()?, Attention { edges, own_slots })
}

/// The attention of one frame's edges.
pub(super) struct Attention {
    pub(super) edges: Arc<Edges>,
    /// See [`attend`].
    pub(super) own_slots: bool,
}

/// Where channel `channel` of a token is in the order of the passes.
pub(super) const fn place_of(channel: usize) -> usize {
    let (slot, c) = (channel / HEAD, channel % HEAD);
    (slot % KINDS) * KIND_WIDTH + c * GROUPS + slot / KINDS
}

/// Where the published program adds number `at` of a row's body messages: group g's go to head slot g.
const fn shared_place(at: usize) -> usize {
    place_of((at % GROUPS) * HEAD + at / GROUPS)
}

/// One number of each group.
type Four<T> = [T; GROUPS];

/// A head of each group: channel c of group g is lane 4 (c mod 4) + g of vector c / 4.
type Heads<T> = [[T; LANES]; HEAD * GROUPS / LANES];

/// `Wᵀ s` of every body token, axis by axis of each group.
pub(super) type Projected<T> = Vec<[Four<T>; 3]>;

/// Three axes' numbers of each group, beside each channel.
type Turn<T> = [[T; LANES]; 3];

#[inline(always)]
fn zeros<T: Real>() -> Heads<T> {
    [[T::zero(); LANES]; HEAD * GROUPS / LANES]
}

/// The heads at a slice's start.
#[inline(always)]
fn heads<T: Real>(values: &[T]) -> &Heads<T> {
    let (vectors, _) = values[..KIND_WIDTH].as_chunks::<LANES>();
    vectors.try_into().expect("as many as heads have")
}

#[inline(always)]
fn heads_mut<T: Real>(values: &mut [T]) -> &mut Heads<T> {
    let (vectors, _) = values[..KIND_WIDTH].as_chunks_mut::<LANES>();
    vectors.try_into().expect("as many as heads have")
}

#[inline(always)]
fn four<T: Real>(values: &[T], entry: usize) -> Four<T> {
    values[entry * GROUPS..(entry + 1) * GROUPS]
        .try_into()
        .expect("one of each group")
}

/// Each group's number beside each of its channels. To be written to memory and read from there: a
/// compiler that knows of the repetition makes other vectors than these.
#[inline(always)]
fn tile<T: Real>(x: Four<T>) -> [T; LANES] {
    std::array::from_fn(|lane| x[lane % GROUPS])
}

/// [`tile`] for numbers that are needed at once.
#[inline(always)]
fn tiled<T: Real>(x: [Four<T>; 3]) -> Turn<T> {
    std::hint::black_box(x.map(tile))
}

/// [`tile`] of each entry's numbers.
#[inline(always)]
fn tile_all<T: Real>(values: &[T], out: &mut Vec<[T; LANES]>) {
    let (fours, _) = values.as_chunks::<GROUPS>();
    out.clear();
    out.extend(fours.iter().map(|&four| tile(four)));
}

/// Each group's sum over a vector's channels.
#[inline(always)]
fn fold<T: Real>(x: [T; LANES]) -> Four<T> {
    // The compiler would carry four lanes through all sums that lead here: it shall not look ahead.
    let mut x = std::hint::black_box(x);
    for i in 0..LANES / 2 {
        x[i] += x[i + LANES / 2];
    }
    std::array::from_fn(|group| x[group] + x[group + GROUPS])
}

/// `to += x·y`, lane by lane.
#[inline(always)]
fn add_product<T: Real>(to: &mut [T; LANES], x: &[T; LANES], y: &[T; LANES]) {
    let mut sum = *to;
    for lane in 0..LANES {
        sum[lane] += x[lane] * y[lane];
    }
    *to = sum;
}

/// Each group's `Wᵀ x`, axis by axis.
#[inline(always)]
fn project<T: Real>(w: &[Heads<T>; 3], x: &Heads<T>) -> [Four<T>; 3] {
    // No closure: one that is not inlined is compiled without vector units.
    let mut out = [[T::zero(); GROUPS]; 3];
    for axis in 0..3 {
        let mut sum = [T::zero(); LANES];
        for (w, x) in w[axis].iter().zip(x) {
            add_product(&mut sum, w, x);
        }
        out[axis] = fold(sum);
    }
    out
}

/// Each group's `W z`, added to x.
#[inline(always)]
fn lift<T: Real>(w: &[Heads<T>; 3], z: &Turn<T>, x: &mut Heads<T>) {
    for (vector, x) in x.iter_mut().enumerate() {
        for axis in 0..3 {
            add_product(x, &w[axis][vector], &z[axis]);
        }
    }
}

#[inline(always)]
fn turn<T: Real>(r: &[[f32; 3]; 3], x: [Four<T>; 3]) -> [Four<T>; 3] {
    let mut y = [[T::zero(); GROUPS]; 3];
    for (row, out) in r.iter().zip(&mut y) {
        for axis in 0..3 {
            let factor = T::of(f64::from(row[axis]));
            for group in 0..GROUPS {
                out[group] += factor * x[axis][group];
            }
        }
    }
    y
}

#[inline(always)]
fn turn_back<T: Real>(r: &[[f32; 3]; 3], x: [Four<T>; 3]) -> [Four<T>; 3] {
    let mut y = [[T::zero(); GROUPS]; 3];
    for (row, x) in r.iter().zip(&x) {
        for axis in 0..3 {
            let factor = T::of(f64::from(row[axis]));
            for group in 0..GROUPS {
                y[axis][group] += factor * x[group];
            }
        }
    }
    y
}

/// The groups' parameters, with M W multiplied out, in the order of the passes.
struct Groups<'a, T> {
    parameters: &'a [T],
    w: [Heads<T>; 3],
    mw: [Heads<T>; 3],
    c: Heads<T>,
}

/// W, M and c of one group.
fn split<T>(parameters: &[T]) -> [&[T]; 3] {
    let (w, rest) = parameters.split_at(HEAD * 3);
    let (m, c) = rest.split_at(HEAD * HEAD);
    [w, m, c]
}

impl<'a, T: Real> Groups<'a, T> {
    fn new(parameters: &'a [T]) -> Self {
        let mut groups = Self {
            parameters,
            w: [zeros(); 3],
            mw: [zeros(); 3],
            c: zeros(),
        };
        for (group, all) in parameters.chunks_exact(GROUP_PARAMETERS).enumerate() {
            let [w, m, c] = split(all);
            for channel in 0..HEAD {
                let at = channel * GROUPS + group;
                groups.c.as_flattened_mut()[at] = c[channel];
                for axis in 0..3 {
                    groups.w[axis].as_flattened_mut()[at] = w[3 * channel + axis];
                    let mut mw = T::zero();
                    for inner in 0..HEAD {
                        mw += m[channel * HEAD + inner] * w[3 * inner + axis];
                    }
                    groups.mw[axis].as_flattened_mut()[at] = mw;
                }
            }
        }
        groups
    }
}

/// What the passes read; tokens in their order.
struct Input<'a, T> {
    edges: &'a Edges,
    tokens: &'a [T],
    receivers: usize,
    groups: &'a Groups<'a, T>,
    /// `Wᵀ s` of every body token.
    body_projected: &'a [[Four<T>; 3]],
    own_slots: bool,
}

/// The entries of one receiver's heads of a kind, and their softmax. All but `rows` hold four numbers
/// of each entry, one a group, and have room for whole vectors; what is beyond the entries means nothing.
#[derive(Default)]
struct Softmax<T> {
    /// Number of entries; those from `body_from` on are body tokens.
    count: usize,
    body_from: usize,
    /// Rows of the senders in the token matrix, and what is added to their logits.
    rows: Vec<usize>,
    bias: Vec<T>,
    /// |r − s|, (r + s)·q, the probability p, and p/|r − s|.
    distance: Vec<T>,
    alignment: Vec<T>,
    weight: Vec<T>,
    value: Vec<T>,
}

impl<'a, T: Real> Input<'a, T> {
    /// The heads of a kind of a row.
    #[inline(always)]
    fn heads(&self, row: usize, kind: usize) -> &'a Heads<T> {
        heads(&self.tokens[row * WIDTH + kind * KIND_WIDTH..])
    }

    /// Row of the first body token.
    fn first_body(&self) -> usize {
        2 * self.receivers + self.edges.senders
    }

    /// Lists the entries of a receiver's heads of a kind.
    #[inline(always)]
    fn list(&self, receiver: usize, kind: usize, out: &mut Softmax<T>) {
        let edges = self.edges;
        out.rows.clear();
        out.bias.clear();
        let list = if kind == 0 { &edges.world } else { &edges.mesh };
        let senders = list.row(receiver).iter();
        out.rows
            .extend(senders.map(|&sender| 2 * self.receivers + sender as usize));
        out.body_from = out.rows.len();
        out.bias.resize(out.body_from * GROUPS, T::zero());
        if kind == 0 {
            let range =
                edges.body.offsets[receiver] as usize..edges.body.offsets[receiver + 1] as usize;
            let counts = &edges.body_log_count[range.clone()];
            let tokens = edges.body.items[range].iter();
            out.rows
                .extend(tokens.map(|&token| self.first_body() + token as usize));
            for &count in counts {
                out.bias.extend([T::of(f64::from(count)); GROUPS]);
            }
        }
        out.count = out.rows.len();
        let room = (out.count * GROUPS).next_multiple_of(LANES);
        for buffer in [
            &mut out.bias,
            &mut out.distance,
            &mut out.alignment,
            &mut out.weight,
            &mut out.value,
        ] {
            buffer.resize(room, T::zero());
        }
    }

    /// Distances, alignments and probabilities of the listed entries.
    #[inline(always)]
    fn weigh(&self, receiver: usize, kind: usize, list: &mut Softmax<T>) {
        let r = self.heads(receiver, kind);
        let q = self.heads(self.receivers + receiver, kind);
        for (entry, &row) in list.rows.iter().enumerate() {
            let s = self.heads(row, kind);
            let (mut squared, mut along) = ([T::zero(); LANES], [T::zero(); LANES]);
            for ((r, q), s) in r.iter().zip(q).zip(s) {
                for lane in 0..LANES {
                    let d = r[lane] - s[lane];
                    squared[lane] += d * d;
                    along[lane] += q[lane] * (r[lane] + s[lane]);
                }
            }
            list.distance[entry * GROUPS..][..GROUPS].copy_from_slice(&fold(squared));
            list.alignment[entry * GROUPS..][..GROUPS].copy_from_slice(&fold(along));
        }
        let floor = T::of(SQUARED_DISTANCE_FLOOR);
        let (distance, _) = list.distance.as_chunks_mut::<LANES>();
        let (alignment, _) = list.alignment.as_chunks::<LANES>();
        let (bias, _) = list.bias.as_chunks::<LANES>();
        let (weight, _) = list.weight.as_chunks_mut::<LANES>();
        for ((distance, along), (weight, bias)) in
            (distance.iter_mut().zip(alignment)).zip(weight.iter_mut().zip(bias))
        {
            // Written so that a NaN stays a NaN and is found.
            let d = distance.map(|squared| if squared < floor { floor } else { squared }.sqrt());
            *weight = std::array::from_fn(|lane| {
                T::of(2.0 * KAPPA) * along[lane] / (d[lane] + T::of(2.0 * EPSILON)) + bias[lane]
            });
            *distance = d;
        }
        list.weight[list.count * GROUPS..].fill(T::neg_infinity());
        let larger = |top: T, weight: T| {
            if weight > top || weight.is_nan() {
                weight
            } else {
                top
            }
        };
        let (weight, _) = list.weight.as_chunks_mut::<LANES>();
        let mut largest = [T::neg_infinity(); LANES];
        for weight in weight.iter() {
            for lane in 0..LANES {
                largest[lane] = larger(largest[lane], weight[lane]);
            }
        }
        for i in 0..LANES / 2 {
            largest[i] = larger(largest[i], largest[i + LANES / 2]);
        }
        let largest: Four<T> =
            std::array::from_fn(|group| larger(largest[group], largest[group + GROUPS]));
        let largest = std::hint::black_box(tile(largest));
        for weight in weight.iter_mut() {
            for lane in 0..LANES {
                weight[lane] = (weight[lane] - largest[lane]).exp_of_negative();
            }
        }
        list.weight[list.count * GROUPS..].fill(T::zero());
        let (weight, _) = list.weight.as_chunks_mut::<LANES>();
        let mut total = [T::zero(); LANES];
        for weight in weight.iter() {
            for lane in 0..LANES {
                total[lane] += weight[lane];
            }
        }
        let share = std::hint::black_box(tile(fold(total).map(|total| T::one() / total)));
        let (value, _) = list.value.as_chunks_mut::<LANES>();
        let (distance, _) = list.distance.as_chunks::<LANES>();
        for ((weight, value), distance) in weight.iter_mut().zip(value).zip(distance) {
            let p: [T; LANES] = std::array::from_fn(|lane| weight[lane] * share[lane]);
            *value = std::array::from_fn(|lane| p[lane] / distance[lane]);
            *weight = p;
        }
    }

    /// `R Wᵀ(r + s)` of the body entries, from `Wᵀ r`.
    #[inline(always)]
    fn turns(&self, list: &Softmax<T>, a: &[Four<T>; 3], out: &mut Vec<Turn<T>>) {
        out.clear();
        for &row in &list.rows[list.body_from..] {
            let token = row - self.first_body();
            let b = &self.body_projected[token];
            let both = std::array::from_fn(|axis| {
                std::array::from_fn(|group| a[axis][group] + b[axis][group])
            });
            out.push(turn(&self.edges.rotations[token], both).map(tile));
        }
    }

    /// `y = relu(M W t + c)` of a body entry, and `Rᵀ Wᵀ y`.
    #[inline(always)]
    fn message(&self, token: usize, t: &Turn<T>) -> (Heads<T>, [Four<T>; 3]) {
        let mut y = self.groups.c;
        lift(&self.groups.mw, t, &mut y);
        for y in &mut y {
            for lane in 0..LANES {
                y[lane] = if y[lane] < T::zero() {
                    T::zero()
                } else {
                    y[lane]
                };
            }
        }
        let o = turn_back(&self.edges.rotations[token], project(&self.groups.w, &y));
        (y, o)
    }
}

/// `Wᵀ s` of the world heads of each row.
#[inline(always)]
fn project_rows<T: Real>(w: &[Heads<T>; 3], rows: &[T], out: &mut [[Four<T>; 3]]) {
    for (row, out) in rows.chunks_exact(WIDTH).zip(out) {
        *out = project(w, heads(row));
    }
}

/// Room for the receivers of the forward pass, one after the other.
#[derive(Default)]
struct Room<T> {
    list: Softmax<T>,
    values: Vec<[T; LANES]>,
    turns: Vec<Turn<T>>,
}

#[inline(always)]
fn forward_rows<T: Real>(input: &Input<T>, first: usize, room: &mut Room<T>, out: &mut [T]) {
    let Room {
        list,
        values,
        turns,
    } = room;
    let w = &input.groups.w;
    for (offset, out) in out.chunks_exact_mut(WIDTH).enumerate() {
        let receiver = first + offset;
        for kind in 0..KINDS {
            input.list(receiver, kind, list);
            if list.count == 0 {
                continue;
            }
            input.weigh(receiver, kind, list);
            let r = input.heads(receiver, kind);
            // Σ v (r + s) = r Σ v + Σ v s.
            tile_all(&list.value[..list.body_from * GROUPS], values);
            let mut all = [T::zero(); LANES];
            for value in values.iter() {
                for lane in 0..LANES {
                    all[lane] += value[lane];
                }
            }
            // Vector by vector, or the compiler makes vectors across them.
            for (vector, own) in (heads_mut(&mut out[kind * KIND_WIDTH..]).iter_mut()).enumerate() {
                let mut sum = *own;
                for (value, &row) in values.iter().zip(&list.rows) {
                    add_product(&mut sum, value, &input.heads(row, kind)[vector]);
                }
                add_product(&mut sum, &all, &r[vector]);
                *own = sum;
            }
            if list.body_from < list.count {
                input.turns(list, &project(w, r), turns);
                let mut turned = [[T::zero(); GROUPS]; 3];
                for (entry, t) in (list.body_from..).zip(turns.iter()) {
                    let value = four(&list.value, entry);
                    let (_, o) = input.message(list.rows[entry] - input.first_body(), t);
                    for axis in 0..3 {
                        for group in 0..GROUPS {
                            turned[axis][group] += value[group] * o[axis][group];
                        }
                    }
                }
                let turned = tiled(turned);
                if input.own_slots {
                    lift(w, &turned, heads_mut(out));
                } else {
                    let mut message = zeros();
                    lift(w, &turned, &mut message);
                    for (at, &message) in message.as_flattened().iter().enumerate() {
                        out[shared_place(at)] += message;
                    }
                }
            }
        }
    }
}

/// Gradients of one kind's heads that come from some receivers.
#[derive(Clone, Default)]
struct PartGradient<T> {
    /// Of r and of q of those receivers, then of all senders: `[rows, 64]`.
    r: Vec<T>,
    q: Vec<T>,
    senders: Vec<T>,
    /// Of the body tokens' projections `Wᵀ s`.
    projected: Vec<[Four<T>; 3]>,
    /// Of the groups' W, M, c.
    parameters: Vec<T>,
}

/// Gradients of tokens and parameters: of each part of the receivers world heads and mesh heads.
#[derive(Clone, Default)]
pub(super) struct Gradient<T> {
    parts: [[PartGradient<T>; KINDS]; PARTS],
}

/// What the parameters' gradients are made of: of W as lifts see it and of M W, axis by axis, and of c.
struct Lifts<T> {
    w: [Heads<T>; 3],
    mw: [Heads<T>; 3],
    c: Heads<T>,
}

#[inline(always)]
fn backward_part<T: Real>(
    input: &Input<T>,
    (first, kind): (usize, usize),
    grad: &[T],
    out: &mut PartGradient<T>,
    lifts: &mut Lifts<T>,
) {
    let w = &input.groups.w;
    let two_kappa = T::of(2.0 * KAPPA);
    let mut list = Softmax::default();
    // Gradients of the weights; factors of q and (r + s), and of r − s; the body entries' messages.
    let (mut d_weight, mut scales, mut pulls) = (Vec::new(), Vec::new(), Vec::new());
    let mut tiles = [Vec::new(), Vec::new(), Vec::new()];
    let (mut turns, mut d_turns) = (Vec::new(), Vec::new());
    let mut messages: Vec<Heads<T>> = Vec::new();
    for (offset, grad) in grad.chunks_exact(WIDTH).enumerate() {
        let receiver = first + offset;
        input.list(receiver, kind, &mut list);
        if list.count == 0 {
            continue;
        }
        input.weigh(receiver, kind, &mut list);
        let r = input.heads(receiver, kind);
        let q = input.heads(input.receivers + receiver, kind);
        let g = heads(&grad[kind * KIND_WIDTH..]);
        for buffer in [&mut d_weight, &mut scales, &mut pulls] {
            buffer.resize(list.weight.len(), T::zero());
        }
        for (entry, &row) in list.rows[..list.body_from].iter().enumerate() {
            let s = input.heads(row, kind);
            let mut along = [T::zero(); LANES];
            for ((g, r), s) in g.iter().zip(r).zip(s) {
                for lane in 0..LANES {
                    along[lane] += g[lane] * (r[lane] + s[lane]);
                }
            }
            d_weight[entry * GROUPS..][..GROUPS].copy_from_slice(&fold(along));
        }
        messages.clear();
        let mut body_g = zeros();
        let (mut turned, mut lifted_g) = ([[T::zero(); GROUPS]; 3], [[T::zero(); GROUPS]; 3]);
        if list.body_from < list.count {
            input.turns(&list, &project(w, r), &mut turns);
            if input.own_slots {
                body_g = *heads(grad);
            } else {
                for (at, g) in body_g.as_flattened_mut().iter_mut().enumerate() {
                    *g = grad[shared_place(at)];
                }
            }
            lifted_g = project(w, &body_g);
            for (entry, t) in (list.body_from..).zip(&turns) {
                let value = four(&list.value, entry);
                let (y, o) = input.message(list.rows[entry] - input.first_body(), t);
                for group in 0..GROUPS {
                    let mut along = T::zero();
                    for axis in 0..3 {
                        turned[axis][group] += value[group] * o[axis][group];
                        along += lifted_g[axis][group] * o[axis][group];
                    }
                    d_weight[entry * GROUPS + group] = along;
                }
                messages.push(y);
            }
        }
        d_weight[list.count * GROUPS..].fill(T::zero());
        list.distance[list.count * GROUPS..].fill(T::one());
        let (d_weights, _) = d_weight.as_chunks_mut::<LANES>();
        let (weights, _) = list.weight.as_chunks::<LANES>();
        let (values, _) = list.value.as_chunks::<LANES>();
        let (distances, _) = list.distance.as_chunks::<LANES>();
        let (alignments, _) = list.alignment.as_chunks::<LANES>();
        let mut mean = [T::zero(); LANES];
        for ((d_weight, weight), distance) in d_weights.iter_mut().zip(weights).zip(distances) {
            *d_weight = std::array::from_fn(|lane| d_weight[lane] / distance[lane]);
            add_product(&mut mean, weight, d_weight);
        }
        let mean = std::hint::black_box(tile(fold(mean)));
        let outputs = (scales.as_chunks_mut::<LANES>().0.iter_mut())
            .zip(pulls.as_chunks_mut::<LANES>().0.iter_mut());
        let inputs = (d_weights.iter().zip(weights)).zip(values);
        for (((scales, pulls), ((d_weight, weight), value)), (distance, alignment)) in
            outputs.zip(inputs).zip(distances.iter().zip(alignments))
        {
            let soft = distance.map(|distance| distance + T::of(2.0 * EPSILON));
            let scale: [T; LANES] = std::array::from_fn(|lane| {
                weight[lane] * (d_weight[lane] - mean[lane]) * two_kappa / soft[lane]
            });
            // Both the logit and the message fall with the distance; below its floor it is constant.
            *pulls = std::array::from_fn(|lane| {
                let distance = distance[lane];
                let falls =
                    -(scale[lane] * alignment[lane] / soft[lane] + value[lane] * d_weight[lane]);
                let floored = distance * distance <= T::of(SQUARED_DISTANCE_FLOOR);
                if floored { T::zero() } else { falls / distance }
            });
            *scales = scale;
        }
        let [scale_tiles, pull_tiles, value_tiles] = &mut tiles;
        tile_all(&scales, scale_tiles);
        tile_all(&pulls, pull_tiles);
        tile_all(&list.value[..list.body_from * GROUPS], value_tiles);
        value_tiles.resize(scale_tiles.len(), [T::zero(); LANES]);
        let (mut dr, mut dq) = (zeros(), zeros());
        for vector in 0..dr.len() {
            let (r, q, g) = (&r[vector], &q[vector], &g[vector]);
            let (mut d_r, mut d_q) = (dr[vector], dq[vector]);
            for (entry, &row) in list.rows.iter().enumerate() {
                let (scale, pull) = (&scale_tiles[entry], &pull_tiles[entry]);
                let plain = &value_tiles[entry];
                let s = &input.heads(row, kind)[vector];
                let ds = heads_mut(&mut out.senders[(row - 2 * input.receivers) * KIND_WIDTH..]);
                let mut d_s = ds[vector];
                for lane in 0..LANES {
                    let both = scale[lane] * q[lane] + plain[lane] * g[lane];
                    let apart = pull[lane] * (r[lane] - s[lane]);
                    d_r[lane] += both + apart;
                    d_s[lane] += both - apart;
                    d_q[lane] += scale[lane] * (r[lane] + s[lane]);
                }
                ds[vector] = d_s;
            }
            (dr[vector], dq[vector]) = (d_r, d_q);
        }
        if list.body_from < list.count {
            // d(Wᵀ y), turned into the tokens' frames.
            d_turns.clear();
            for entry in list.body_from..list.count {
                let token = list.rows[entry] - input.first_body();
                let value = four(&list.value, entry);
                let scaled = std::array::from_fn(|axis| {
                    std::array::from_fn(|group| lifted_g[axis][group] * value[group])
                });
                d_turns.push(turn(&input.edges.rotations[token], scaled).map(tile));
            }
            let mut da = [[T::zero(); GROUPS]; 3];
            for (entry, (t, dz)) in (list.body_from..).zip(turns.iter().zip(&d_turns)) {
                let token = list.rows[entry] - input.first_body();
                let y = &messages[entry - list.body_from];
                let db = input.message_gradient(token, (t, dz, y), lifts);
                for axis in 0..3 {
                    for group in 0..GROUPS {
                        da[axis][group] += db[axis][group];
                        out.projected[token][axis][group] += db[axis][group];
                    }
                }
            }
            // The lift of the summed messages, and the projection of r.
            let (turned, da) = (tiled(turned), tiled(da));
            for axis in 0..3 {
                let (turned, da) = (&turned[axis], &da[axis]);
                for ((dw, g), r) in lifts.w[axis].iter_mut().zip(&body_g).zip(r) {
                    add_product(dw, g, turned);
                    add_product(dw, r, da);
                }
            }
            lift(w, &da, &mut dr);
        }
        *heads_mut(&mut out.r[offset * KIND_WIDTH..]) = dr;
        *heads_mut(&mut out.q[offset * KIND_WIDTH..]) = dq;
    }
}

impl<T: Real> Input<'_, T> {
    /// Back through a body entry's message: adds to the gradients of W, M W and c, returns that of
    /// `Wᵀ(r + s)`. `dz` is the gradient of `Wᵀ y`.
    #[inline(always)]
    fn message_gradient(
        &self,
        token: usize,
        (t, dz, y): (&Turn<T>, &Turn<T>, &Heads<T>),
        lifts: &mut Lifts<T>,
    ) -> [Four<T>; 3] {
        let mut dy = zeros();
        lift(&self.groups.w, dz, &mut dy);
        for ((dy, y), c) in dy.iter_mut().zip(y).zip(&mut lifts.c) {
            for lane in 0..LANES {
                dy[lane] = if y[lane] > T::zero() {
                    dy[lane]
                } else {
                    T::zero()
                };
                c[lane] += dy[lane];
            }
        }
        for axis in 0..3 {
            for vector in 0..y.len() {
                let (y, dy) = (&y[vector], &dy[vector]);
                add_product(&mut lifts.w[axis][vector], y, &dz[axis]);
                add_product(&mut lifts.mw[axis][vector], dy, &t[axis]);
            }
        }
        turn_back(&self.edges.rotations[token], project(&self.groups.mw, &dy))
    }

    /// Back through the body tokens' projections and the product M W.
    #[inline(always)]
    fn finish(&self, out: &mut PartGradient<T>, lifts: &mut Lifts<T>) {
        let first = self.edges.senders;
        for (token, d) in out.projected.iter().enumerate() {
            let ds = heads_mut(&mut out.senders[(first + token) * KIND_WIDTH..]);
            let d = tiled(*d);
            lift(&self.groups.w, &d, ds);
            let s = self.heads(self.first_body() + token, 0);
            for axis in 0..3 {
                for (dw, s) in lifts.w[axis].iter_mut().zip(s) {
                    add_product(dw, s, &d[axis]);
                }
            }
        }
        let all = out.parameters.chunks_exact_mut(GROUP_PARAMETERS);
        for (group, out) in all.enumerate() {
            let [w, m, _] = split(&self.groups.parameters[group * GROUP_PARAMETERS..]);
            let (d_w, rest) = out.split_at_mut(HEAD * 3);
            let (d_m, d_c) = rest.split_at_mut(HEAD * HEAD);
            for channel in 0..HEAD {
                let at = channel * GROUPS + group;
                d_c[channel] = lifts.c.as_flattened()[at];
                for axis in 0..3 {
                    d_w[3 * channel + axis] += lifts.w[axis].as_flattened()[at];
                    let mw = lifts.mw[axis].as_flattened()[at];
                    for inner in 0..HEAD {
                        d_m[channel * HEAD + inner] += mw * w[3 * inner + axis];
                        d_w[3 * inner + axis] += mw * m[channel * HEAD + inner];
                    }
                }
            }
        }
    }
}

simd_dispatch!(fn run_project => project_rows<T>(w: &[Heads<T>; 3], rows: &[T], out: &mut [[Four<T>; 3]]));
simd_dispatch!(fn run_forward => forward_rows<T>(input: &Input<T>, first: usize, room: &mut Room<T>, out: &mut [T]));
simd_dispatch!(fn run_backward => backward_part<T>(input: &Input<T>, part: (usize, usize), grad: &[T], out: &mut PartGradient<T>, lifts: &mut Lifts<T>));

impl Attention {
    fn check(&self, tokens: &Layout, parameters: &Layout) -> Result<()> {
        let (rows, width) = tokens.shape().dims2()?;
        let edges = &self.edges;
        let receivers = edges.mesh.rows();
        let expected = 2 * receivers + edges.senders + edges.rotations.len();
        if rows != expected || width != WIDTH {
            candle_core::bail!(
                "attention: tokens [{rows}, {width}], edges expect [{expected}, {WIDTH}]"
            );
        }
        if parameters.shape().elem_count() != GROUPS * GROUP_PARAMETERS {
            candle_core::bail!(
                "attention: {:?} parameters, expected {}",
                parameters.shape(),
                GROUPS * GROUP_PARAMETERS
            );
        }
        self.check_edges()
    }

    /// Whether the lists fit each other and lead to tokens that exist.
    pub(super) fn check_edges(&self) -> Result<()> {
        let edges = &self.edges;
        let receivers = edges.mesh.rows();
        if edges.world.rows() != receivers
            || edges.body.rows() != receivers
            || edges.body_log_count.len() != edges.body.items.len()
        {
            candle_core::bail!(
                "attention: mesh, world and body lists differ in their number of receivers"
            );
        }
        let lists = [
            ("mesh", &edges.mesh, edges.senders),
            ("world", &edges.world, edges.senders),
            ("body", &edges.body, edges.rotations.len()),
        ];
        for (name, list, tokens) in lists {
            if let Some(item) = list.items.iter().find(|&&item| item as usize >= tokens) {
                candle_core::bail!(
                    "attention: a {name} edge leads to token {item}, beyond the last of {tokens}"
                );
            }
        }
        Ok(())
    }

    fn input<'a, T: Real>(
        &'a self,
        tokens: &'a [T],
        groups: &'a Groups<'a, T>,
        body_projected: &'a [[Four<T>; 3]],
    ) -> Input<'a, T> {
        Input {
            edges: &self.edges,
            tokens,
            receivers: self.edges.mesh.rows(),
            groups,
            body_projected,
            own_slots: self.own_slots,
        }
    }

    fn body_projected<T: Real>(&self, tokens: &[T], groups: &Groups<T>, out: &mut Projected<T>) {
        let first = 2 * self.edges.mesh.rows() + self.edges.senders;
        let tokens = tokens[first * WIDTH..].par_chunks(BLOCK_ROWS * WIDTH);
        let out = fit(out, self.edges.rotations.len());
        let blocks = tokens.zip(out.par_chunks_mut(BLOCK_ROWS));
        for_all(blocks, |(tokens, out): (&[T], &mut [[Four<T>; 3]])| {
            run_project(&groups.w, tokens, out);
        });
    }

    /// Attention's output `[receivers, 128]` from tokens and parameters of [`attend`]; the channels of
    /// tokens and output are in the order of the passes. `projected` is room.
    pub(super) fn forward<T: Real>(
        &self,
        tokens: &[T],
        parameters: &[T],
        projected: &mut Projected<T>,
        out: &mut [T],
    ) {
        let groups = Groups::new(parameters);
        self.body_projected(tokens, &groups, projected);
        let input = self.input(tokens, &groups, projected);
        let blocks = out.par_chunks_mut(BLOCK_ROWS * WIDTH).enumerate();
        for_all_with(
            blocks,
            |room: &mut Room<T>, (index, out): (usize, &mut [T])| {
                out.fill(T::zero());
                run_forward(&input, index * BLOCK_ROWS, room, out);
            },
        );
    }

    /// Gradients of tokens and parameters, as [`Attention::forward`] has them.
    pub(super) fn backward<T: Real>(
        &self,
        tokens: &[T],
        parameters: &[T],
        grad: &[T],
        projected: &mut Projected<T>,
        gradient: &mut Gradient<T>,
    ) {
        let groups = Groups::new(parameters);
        self.body_projected(tokens, &groups, projected);
        let input = self.input(tokens, &groups, projected);
        let rows = part_rows(input.receivers);
        let senders = self.edges.senders + self.edges.rotations.len();
        let mut pieces = Vec::new();
        for (part, kinds) in gradient.parts.iter_mut().enumerate() {
            let first = (part * rows).min(input.receivers);
            let last = (first + rows).min(input.receivers);
            for (kind, out) in kinds.iter_mut().enumerate() {
                pieces.push((first, kind, &grad[first * WIDTH..last * WIDTH], out));
            }
        }
        for_all(pieces.into_par_iter(), |(first, kind, grad, out)| {
            let zeroed = |buffer: &mut Vec<T>, len| {
                buffer.clear();
                buffer.resize(len, T::zero());
            };
            zeroed(&mut out.r, grad.len() / KINDS);
            zeroed(&mut out.q, grad.len() / KINDS);
            zeroed(&mut out.senders, senders * KIND_WIDTH);
            if kind == 0 {
                zeroed(&mut out.parameters, GROUPS * GROUP_PARAMETERS);
                out.projected.clear();
                out.projected
                    .resize(input.body_projected.len(), [[T::zero(); GROUPS]; 3]);
            }
            let mut lifts = Lifts {
                w: [zeros(); 3],
                mw: [zeros(); 3],
                c: zeros(),
            };
            run_backward(&input, (first, kind), grad, out, &mut lifts);
            if kind == 0 {
                input.finish(out, &mut lifts);
            }
        });
    }
}

/// Receivers of a part.
fn part_rows(receivers: usize) -> usize {
    receivers.div_ceil(PARTS).max(1)
}

/// Rows of the token matrix's gradient `[rows, 128]`, from row `first` on, in the order of the passes.
pub(super) fn token_gradient<T: Real>(
    gradient: &Gradient<T>,
    receivers: usize,
    first: usize,
    out: &mut [T],
) {
    let part_rows = part_rows(receivers);
    for (row, out) in (first..).zip(out.chunks_exact_mut(WIDTH)) {
        for (kind, out) in out.chunks_exact_mut(KIND_WIDTH).enumerate() {
            if row < 2 * receivers {
                let receiver = row % receivers;
                let part = &gradient.parts[receiver / part_rows][kind];
                let from = if row < receivers { &part.r } else { &part.q };
                out.copy_from_slice(&from[receiver % part_rows * KIND_WIDTH..][..KIND_WIDTH]);
            } else {
                let at = (row - 2 * receivers) * KIND_WIDTH;
                let [one, other] = [0, 1].map(|part| &gradient.parts[part][kind].senders[at..]);
                for ((out, &x), &y) in out.iter_mut().zip(one).zip(other) {
                    *out = x + y;
                }
            }
        }
    }
}

/// Gradient of the parameters, groups one behind the other.
pub(super) fn parameter_gradient<T: Real>(gradient: &Gradient<T>, out: &mut [T]) {
    out.fill(T::zero());
    for [world, _] in &gradient.parts {
        for (out, &d) in out.iter_mut().zip(&world.parameters) {
            *out += d;
        }
    }
}

/// Rows with their channels in the order of the passes, or (`back`) out of it.
fn reordered<T: Real>(rows: &[T], back: bool) -> Vec<T> {
    let mut out = vec![T::zero(); rows.len()];
    for (row, out) in rows.chunks_exact(WIDTH).zip(out.chunks_exact_mut(WIDTH)) {
        for channel in 0..WIDTH {
            let place = place_of(channel);
            let (from, to) = if back {
                (place, channel)
            } else {
                (channel, place)
            };
            out[to] = row[from];
        }
    }
    out
}

impl CustomOp2 for Attention {
    fn name(&self) -> &'static str {
        "rotation-invariant-attention"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        self.check(l1, l2)?;
        by_dtype!(super::dtype_of(s1), T => {
            let receivers = self.edges.mesh.rows();
            let mut out = vec![<T as num_traits::Zero>::zero(); receivers * WIDTH];
            let tokens = reordered::<T>(operand(s1, l1)?, false);
            self.forward::<T>(&tokens, operand(s2, l2)?, &mut Vec::new(), &mut out);
            let out = reordered(&out, true);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(out), (receivers, WIDTH).into()))
        })
    }

    fn bwd(
        &self,
        tokens: &Tensor,
        parameters: &Tensor,
        _res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        by_dtype!(tokens.dtype(), T => {
            let mut gradient = Gradient::default();
            let read = reordered::<T>(&values(tokens)?, false);
            let g = reordered::<T>(&values(grad)?, false);
            self.backward::<T>(&read, &values(parameters)?, &g, &mut Vec::new(), &mut gradient);
            let mut d_tokens = vec![<T as num_traits::Zero>::zero(); tokens.elem_count()];
            token_gradient(&gradient, self.edges.mesh.rows(), 0, &mut d_tokens);
            let d_tokens = reordered(&d_tokens, true);
            let mut d_parameters = vec![<T as num_traits::Zero>::zero(); parameters.elem_count()];
            parameter_gradient(&gradient, &mut d_parameters);
            let device = tokens.device();
            Ok((
                Some(Tensor::from_vec(d_tokens, tokens.shape(), device)?),
                Some(Tensor::from_vec(d_parameters, parameters.shape(), device)?),
            ))
        })
    }
}

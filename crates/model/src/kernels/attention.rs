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
//! Source: equations 2 and 3 of the paper's supplement; the published program's
//! factors (its description, section 8). Backward by hand; the probabilities are
//! computed again instead of being stored.

use std::sync::Arc;

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};

use super::{Real, by_dtype, for_all, operand, simd_dispatch, values};
use drape_dataset::patches::Csr;

/// Channels of one head.
pub const HEAD: usize = 16;
/// Groups of a world head and a mesh head.
pub const GROUPS: usize = 4;
/// Width of a token.
pub const WIDTH: usize = 2 * GROUPS * HEAD;
/// Parameters of one group: W, M, c.
pub const GROUP_PARAMETERS: usize = HEAD * 3 + HEAD * HEAD + HEAD;

/// Rows whose scores are computed at once.
const LANES: usize = 16;
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

/// Channels of one group: its world head, then its mesh head.
const GROUP_WIDTH: usize = 2 * HEAD;

/// Gradients of one group: it has its own channels of every token and its own parameters.
#[derive(Clone, Default)]
pub(super) struct GroupGradient<T> {
    /// Of r, q and senders, one below the other: `[rows, 32]`.
    tokens: Vec<T>,
    /// Of W, M, c.
    parameters: Vec<T>,
    /// Of the body tokens' projections `Wᵀ s`.
    projected: Vec<[T; 3]>,
}

/// One group's parameters, with M W multiplied out; `[16, 3]` matrices column by column.
struct Group<'a, T> {
    w: [[T; HEAD]; 3],
    m: &'a [T],
    c: &'a [T; HEAD],
    mw: [[T; HEAD]; 3],
}

impl<'a, T: Real> Group<'a, T> {
    fn all(parameters: &'a [T]) -> Vec<Self> {
        parameters
            .chunks_exact(GROUP_PARAMETERS)
            .map(|all| {
                let (rows, rest) = all.split_at(HEAD * 3);
                let (m, c) = rest.split_at(HEAD * HEAD);
                let w = std::array::from_fn(|axis| std::array::from_fn(|i| rows[3 * i + axis]));
                let mut mw = [[T::zero(); HEAD]; 3];
                for (out, w) in mw.iter_mut().zip(&w) {
                    for (row, value) in out.iter_mut().enumerate() {
                        for (inner, &w) in w.iter().enumerate() {
                            *value += m[row * HEAD + inner] * w;
                        }
                    }
                }
                Group {
                    w,
                    m,
                    c: head(c, 0),
                    mw,
                }
            })
            .collect()
    }
}

#[inline(always)]
fn head<T: Real>(row: &[T], start: usize) -> &[T; HEAD] {
    row[start..start + HEAD]
        .try_into()
        .expect("a head is 16 wide")
}

#[inline(always)]
fn tree_sum<T: Real>(mut v: [T; HEAD]) -> T {
    for i in 0..8 {
        v[i] += v[i + 8];
    }
    for i in 0..4 {
        v[i] += v[i + 4];
    }
    (v[0] + v[2]) + (v[1] + v[3])
}

/// One head of up to sixteen rows, channel by channel: sums over channels are then sums of
/// vectors, one lane a row.
struct Lanes<T>([[T; LANES]; HEAD]);

impl<T: Real> Lanes<T> {
    fn new() -> Self {
        Self([[T::zero(); LANES]; HEAD])
    }

    /// Fills the first lanes; the others keep what they held.
    #[inline(always)]
    fn load(&mut self, input: &Input<T>, rows: &[usize], start: usize) {
        for (lane, &row) in rows.iter().enumerate() {
            let s = head(input.row(row), start);
            for i in 0..HEAD {
                self.0[i][lane] = s[i];
            }
        }
    }

    /// `|r − s|²`.
    #[inline(always)]
    fn squared_distance(&self, r: &[T; HEAD]) -> [T; LANES] {
        let mut sum = [T::zero(); LANES];
        for i in 0..HEAD {
            for lane in 0..LANES {
                let d = r[i] - self.0[i][lane];
                sum[lane] += d * d;
            }
        }
        sum
    }

    /// `x·(r + s)`.
    #[inline(always)]
    fn along(&self, x: &[T; HEAD], r: &[T; HEAD]) -> [T; LANES] {
        let mut sum = [T::zero(); LANES];
        for i in 0..HEAD {
            for lane in 0..LANES {
                sum[lane] += x[i] * (r[i] + self.0[i][lane]);
            }
        }
        sum
    }
}

/// `Wᵀ x`.
#[inline(always)]
fn project<T: Real>(w: &[[T; HEAD]; 3], x: &[T; HEAD]) -> [T; 3] {
    [dot(&w[0], x), dot(&w[1], x), dot(&w[2], x)]
}

#[inline(always)]
fn dot<T: Real>(x: &[T; HEAD], y: &[T; HEAD]) -> T {
    let mut v = [T::zero(); HEAD];
    for i in 0..HEAD {
        v[i] = x[i] * y[i];
    }
    tree_sum(v)
}

/// `W z`, added to x.
#[inline(always)]
fn lift<T: Real>(w: &[[T; HEAD]; 3], z: [T; 3], x: &mut [T]) {
    let x: &mut [T; HEAD] = x.try_into().expect("a head is 16 wide");
    for i in 0..HEAD {
        x[i] += w[0][i] * z[0] + w[1][i] * z[1] + w[2][i] * z[2];
    }
}

#[inline(always)]
fn turn<T: Real>(r: &[[f32; 3]; 3], x: [T; 3]) -> [T; 3] {
    let mut y = [T::zero(); 3];
    for (row, out) in r.iter().zip(&mut y) {
        for axis in 0..3 {
            *out += T::of(f64::from(row[axis])) * x[axis];
        }
    }
    y
}

#[inline(always)]
fn turn_back<T: Real>(r: &[[f32; 3]; 3], x: [T; 3]) -> [T; 3] {
    let mut y = [T::zero(); 3];
    for (row, &value) in r.iter().zip(&x) {
        for axis in 0..3 {
            y[axis] += T::of(f64::from(row[axis])) * value;
        }
    }
    y
}

/// What the passes read.
struct Input<'a, T> {
    edges: &'a Edges,
    tokens: &'a [T],
    receivers: usize,
    groups: &'a [Group<'a, T>],
    /// `Wᵀ s` of every body token and group.
    body_projected: &'a [[[T; 3]; GROUPS]],
    own_slots: bool,
}

/// The entries of one receiver's head, and their softmax. All but `rows` have room for whole
/// [`LANES`]; what is beyond `count` means nothing.
#[derive(Default)]
struct Softmax<T> {
    /// Number of entries; those from `body_from` on are body tokens.
    count: usize,
    body_from: usize,
    /// Rows of the senders in the token matrix, and what is added to their logits.
    rows: Vec<usize>,
    bias: Vec<T>,
    /// |r − s|, (r + s)·q, and the probability.
    distance: Vec<T>,
    alignment: Vec<T>,
    weight: Vec<T>,
}

impl<'a, T: Real> Input<'a, T> {
    #[inline(always)]
    fn row(&self, row: usize) -> &'a [T] {
        &self.tokens[row * WIDTH..(row + 1) * WIDTH]
    }

    /// Row of the first body token.
    fn first_body(&self) -> usize {
        2 * self.receivers + self.edges.senders
    }

    /// Lists the entries of a receiver's mesh or world heads.
    #[inline(always)]
    fn list(&self, receiver: usize, mesh: bool, out: &mut Softmax<T>) {
        let edges = self.edges;
        out.rows.clear();
        out.bias.clear();
        let list = if mesh { &edges.mesh } else { &edges.world };
        let senders = list.row(receiver).iter();
        out.rows
            .extend(senders.map(|&sender| 2 * self.receivers + sender as usize));
        out.body_from = out.rows.len();
        out.bias.resize(out.body_from, T::zero());
        if !mesh {
            let range =
                edges.body.offsets[receiver] as usize..edges.body.offsets[receiver + 1] as usize;
            let counts = &edges.body_log_count[range.clone()];
            let tokens = edges.body.items[range].iter();
            out.rows
                .extend(tokens.map(|&token| self.first_body() + token as usize));
            out.bias
                .extend(counts.iter().map(|&count| T::of(f64::from(count))));
        }
        out.count = out.rows.len();
        let room = out.count.next_multiple_of(LANES);
        for buffer in [
            &mut out.bias,
            &mut out.distance,
            &mut out.alignment,
            &mut out.weight,
        ] {
            buffer.resize(room, T::zero());
        }
    }

    /// Distances, alignments and probabilities of the listed entries for the head at channel `start`.
    #[inline(always)]
    fn weigh(&self, receiver: usize, start: usize, list: &mut Softmax<T>) {
        let r = head(self.row(receiver), start);
        let q = head(self.row(self.receivers + receiver), start);
        let floor = T::of(SQUARED_DISTANCE_FLOOR);
        let mut lanes = Lanes::new();
        let outputs = (list.distance.chunks_exact_mut(LANES))
            .zip(list.alignment.chunks_exact_mut(LANES))
            .zip(list.weight.chunks_exact_mut(LANES));
        for ((rows, bias), ((distance, alignment), weight)) in list
            .rows
            .chunks(LANES)
            .zip(list.bias.chunks_exact(LANES))
            .zip(outputs)
        {
            lanes.load(self, rows, start);
            let squared = lanes.squared_distance(r);
            let along = lanes.along(q, r);
            for lane in 0..LANES {
                // Written so that a NaN stays a NaN and is found.
                let kept = if squared[lane] < floor {
                    floor
                } else {
                    squared[lane]
                };
                let d = kept.sqrt();
                distance[lane] = d;
                alignment[lane] = along[lane];
                weight[lane] =
                    T::of(2.0 * KAPPA) * along[lane] / (d + T::of(2.0 * EPSILON)) + bias[lane];
            }
        }
        let weights = &mut list.weight[..list.count];
        let largest = weights.iter().fold(T::neg_infinity(), |top, &weight| {
            if weight > top || weight.is_nan() {
                weight
            } else {
                top
            }
        });
        for weight in weights.iter_mut() {
            *weight = (*weight - largest).exp_of_negative();
        }
        let mut total = T::zero();
        for &weight in weights.iter() {
            total += weight;
        }
        let share = T::one() / total;
        for weight in weights {
            *weight *= share;
        }
    }

    #[inline(always)]
    fn body_start(&self, group: usize) -> usize {
        if self.own_slots {
            2 * group * HEAD
        } else {
            group * HEAD
        }
    }

    /// `R Wᵀ(r + s)` and `relu(M W ·  + c)` of a body entry.
    #[inline(always)]
    fn body_inner(&self, group: usize, token: usize, a: [T; 3]) -> ([T; 3], [T; HEAD]) {
        let g = &self.groups[group];
        let b = self.body_projected[token][group];
        let t = turn(
            &self.edges.rotations[token],
            [a[0] + b[0], a[1] + b[1], a[2] + b[2]],
        );
        let mut y = [T::zero(); HEAD];
        for i in 0..HEAD {
            let value = g.mw[0][i] * t[0] + g.mw[1][i] * t[1] + g.mw[2][i] * t[2] + g.c[i];
            y[i] = if value < T::zero() { T::zero() } else { value };
        }
        (t, y)
    }
}

#[inline(always)]
fn forward_rows<T: Real>(input: &Input<T>, first: usize, out: &mut [T]) {
    let mut list = Softmax::default();
    for (offset, out) in out.chunks_exact_mut(WIDTH).enumerate() {
        let receiver = first + offset;
        for mesh in [false, true] {
            input.list(receiver, mesh, &mut list);
            if list.count == 0 {
                continue;
            }
            for group in 0..GROUPS {
                let start = (2 * group + usize::from(mesh)) * HEAD;
                input.weigh(receiver, start, &mut list);
                let r = head(input.row(receiver), start);
                // Σ v (r + s) = r Σ v + Σ v s.
                let (mut sum, mut all) = ([T::zero(); HEAD], T::zero());
                for entry in 0..list.body_from {
                    let value = list.weight[entry] / list.distance[entry];
                    let s = head(input.row(list.rows[entry]), start);
                    all += value;
                    for i in 0..HEAD {
                        sum[i] += value * s[i];
                    }
                }
                for i in 0..HEAD {
                    out[start + i] += all * r[i] + sum[i];
                }
                if !mesh {
                    let w = &input.groups[group].w;
                    let a = project(w, r);
                    let mut turned = [T::zero(); 3];
                    for entry in list.body_from..list.count {
                        let value = list.weight[entry] / list.distance[entry];
                        let token = list.rows[entry] - input.first_body();
                        let (_, y) = input.body_inner(group, token, a);
                        let o = turn_back(&input.edges.rotations[token], project(w, &y));
                        for axis in 0..3 {
                            turned[axis] += value * o[axis];
                        }
                    }
                    lift(w, turned, &mut out[input.body_start(group)..][..HEAD]);
                }
            }
        }
    }
}

/// What the backward pass of one group adds to; `[16, 3]` matrices column by column, M W as a product.
struct Output<'a, T> {
    tokens: &'a mut [T],
    parameters: &'a mut [T],
    w: [[T; HEAD]; 3],
    mw: [[T; HEAD]; 3],
    c: [T; HEAD],
    projected: &'a mut [[T; 3]],
}

/// Of a body entry: `R Wᵀ(r + s)`, `relu(M W · + c)`, and `Rᵀ Wᵀ` of that.
type Message<T> = ([T; 3], [T; HEAD], [T; 3]);

#[inline(always)]
fn backward_group<T: Real>(input: &Input<T>, group: usize, grad: &[T], out: &mut Output<T>) {
    let w = &input.groups[group].w;
    let mut list = Softmax::default();
    // Gradients of the weights, and the body entries' messages.
    let mut d_weight: Vec<T> = Vec::new();
    let mut messages: Vec<Message<T>> = Vec::new();
    let mut lanes = Lanes::new();
    for (receiver, grad) in grad.chunks_exact(WIDTH).enumerate() {
        for mesh in [false, true] {
            input.list(receiver, mesh, &mut list);
            if list.count == 0 {
                continue;
            }
            let own = if mesh { HEAD } else { 0 };
            let start = group * GROUP_WIDTH + own;
            input.weigh(receiver, start, &mut list);
            let r = head(input.row(receiver), start);
            let q = head(input.row(input.receivers + receiver), start);
            let g = head(grad, start);
            let body_g = head(grad, input.body_start(group));
            d_weight.resize(list.weight.len(), T::zero());
            messages.clear();
            let outputs = d_weight.chunks_exact_mut(LANES);
            for ((rows, out), distance) in (list.rows[..list.body_from].chunks(LANES))
                .zip(outputs)
                .zip(list.distance.chunks_exact(LANES))
            {
                lanes.load(input, rows, start);
                let along = lanes.along(g, r);
                for lane in 0..LANES {
                    out[lane] = along[lane] / distance[lane];
                }
            }
            let (mut turned, mut lifted_g) = ([T::zero(); 3], [T::zero(); 3]);
            if !mesh {
                let a = project(w, r);
                lifted_g = project(w, body_g);
                for entry in list.body_from..list.count {
                    let token = list.rows[entry] - input.first_body();
                    let value = list.weight[entry] / list.distance[entry];
                    let (t, y) = input.body_inner(group, token, a);
                    let o = turn_back(&input.edges.rotations[token], project(w, &y));
                    for axis in 0..3 {
                        turned[axis] += value * o[axis];
                    }
                    let along = lifted_g[0] * o[0] + lifted_g[1] * o[1] + lifted_g[2] * o[2];
                    d_weight[entry] = along / list.distance[entry];
                    messages.push((t, y, o));
                }
            }
            let mut mean = T::zero();
            for entry in 0..list.count {
                mean += list.weight[entry] * d_weight[entry];
            }
            let mut dr = [T::zero(); HEAD];
            let mut dq = [T::zero(); HEAD];
            let mut da = [T::zero(); 3];
            for entry in 0..list.count {
                let (row, distance) = (list.rows[entry], list.distance[entry]);
                let s = head(input.row(row), start);
                let soft = distance + T::of(2.0 * EPSILON);
                let dl = list.weight[entry] * (d_weight[entry] - mean);
                let scale = dl * T::of(2.0 * KAPPA) / soft;
                let value = list.weight[entry] / distance;
                // Both the logit and the message fall with the distance; below its floor it is constant.
                let floored = distance * distance <= T::of(SQUARED_DISTANCE_FLOOR);
                let d_distance = if floored {
                    T::zero()
                } else {
                    -(scale * list.alignment[entry] / soft + value * d_weight[entry])
                };
                let along = d_distance / distance;
                let is_body = entry >= list.body_from;
                let plain = if is_body { T::zero() } else { value };
                let ds: &mut [T; HEAD] = (&mut out.tokens[row * GROUP_WIDTH + own..][..HEAD])
                    .try_into()
                    .expect("a head is 16 wide");
                for i in 0..HEAD {
                    let both = scale * q[i] + plain * g[i];
                    let apart = along * (r[i] - s[i]);
                    dr[i] += both + apart;
                    ds[i] += both - apart;
                    dq[i] += scale * (r[i] + s[i]);
                }
                if is_body {
                    let token = row - input.first_body();
                    let (t, y, _) = &messages[entry - list.body_from];
                    let db = input.message_gradient(group, token, value, lifted_g, (t, y), out);
                    for axis in 0..3 {
                        da[axis] += db[axis];
                        out.projected[token][axis] += db[axis];
                    }
                }
            }
            if !mesh {
                // The lift of the summed messages, and the projection of r.
                let dw = &mut out.parameters[..HEAD * 3];
                for i in 0..HEAD {
                    for axis in 0..3 {
                        dw[3 * i + axis] += body_g[i] * turned[axis] + r[i] * da[axis];
                    }
                }
                lift(w, da, &mut dr);
            }
            let row = &mut out.tokens[receiver * GROUP_WIDTH + own..][..HEAD];
            for i in 0..HEAD {
                row[i] += dr[i];
            }
            let row = &mut out.tokens[(input.receivers + receiver) * GROUP_WIDTH + own..][..HEAD];
            for i in 0..HEAD {
                row[i] += dq[i];
            }
        }
    }
}

impl<T: Real> Input<'_, T> {
    /// Back through a body entry's message: adds to the gradients of W, M W and c, returns that of
    /// `Wᵀ(r + s)`.
    #[inline(always)]
    fn message_gradient(
        &self,
        group: usize,
        token: usize,
        value: T,
        lifted_g: [T; 3],
        (t, y): (&[T; 3], &[T; HEAD]),
        out: &mut Output<T>,
    ) -> [T; 3] {
        let rotation = &self.edges.rotations[token];
        let Group { w, mw, .. } = &self.groups[group];
        // d(Wᵀ y), turned into the token's frame.
        let dz = turn(rotation, lifted_g.map(|x| x * value));
        let mut dy = [T::zero(); HEAD];
        lift(w, dz, &mut dy);
        for i in 0..HEAD {
            dy[i] = if y[i] > T::zero() { dy[i] } else { T::zero() };
        }
        for axis in 0..3 {
            for i in 0..HEAD {
                out.w[axis][i] += y[i] * dz[axis];
                out.mw[axis][i] += dy[i] * t[axis];
            }
        }
        for i in 0..HEAD {
            out.c[i] += dy[i];
        }
        turn_back(rotation, project(mw, &dy))
    }
}

simd_dispatch!(fn run_forward => forward_rows<T>(input: &Input<T>, first: usize, out: &mut [T]));
simd_dispatch!(fn run_backward => backward_group<T>(input: &Input<T>, group: usize, grad: &[T], out: &mut Output<T>));

impl Attention {
    fn body_projected<T: Real>(&self, tokens: &[T], groups: &[Group<T>]) -> Vec<[[T; 3]; GROUPS]> {
        let first = 2 * self.edges.mesh.rows() + self.edges.senders;
        tokens[first * WIDTH..]
            .chunks_exact(WIDTH)
            .map(|row| {
                std::array::from_fn(|group| project(&groups[group].w, head(row, 2 * group * HEAD)))
            })
            .collect()
    }

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

    /// Rows of the token matrix.
    fn rows(&self) -> usize {
        2 * self.edges.mesh.rows() + self.edges.senders + self.edges.rotations.len()
    }

    /// Attention's output `[receivers, 128]` from tokens and parameters of [`attend`].
    pub(super) fn forward<T: Real>(&self, tokens: &[T], parameters: &[T], out: &mut [T]) {
        let groups = Group::all(parameters);
        let projected = self.body_projected(tokens, &groups);
        let input = Input {
            edges: &self.edges,
            tokens,
            receivers: self.edges.mesh.rows(),
            groups: &groups,
            body_projected: &projected,
            own_slots: self.own_slots,
        };
        let blocks = out.chunks_mut(BLOCK_ROWS * WIDTH).enumerate().collect();
        for_all(blocks, |(index, out): (usize, &mut [T])| {
            out.fill(T::zero());
            run_forward(&input, index * BLOCK_ROWS, out);
        });
    }

    /// Gradients of tokens and parameters; the groups are independent, so they run side by side.
    pub(super) fn backward<T: Real>(
        &self,
        tokens: &[T],
        parameters: &[T],
        grad: &[T],
        gradients: &mut [GroupGradient<T>; GROUPS],
    ) {
        let groups = Group::all(parameters);
        let projected = self.body_projected(tokens, &groups);
        let receivers = self.edges.mesh.rows();
        let input = Input {
            edges: &self.edges,
            tokens,
            receivers,
            groups: &groups,
            body_projected: &projected,
            own_slots: self.own_slots,
        };
        let first = 2 * receivers + self.edges.senders;
        let pieces = gradients.iter_mut().enumerate().collect();
        for_all(pieces, |(group, out): (usize, &mut GroupGradient<T>)| {
            let zeroed = |buffer: &mut Vec<T>, len| {
                buffer.clear();
                buffer.resize(len, T::zero());
            };
            zeroed(&mut out.tokens, self.rows() * GROUP_WIDTH);
            zeroed(&mut out.parameters, GROUP_PARAMETERS);
            out.projected.clear();
            out.projected.resize(projected.len(), [T::zero(); 3]);
            let mut output = Output {
                tokens: &mut out.tokens,
                parameters: &mut out.parameters,
                w: [[T::zero(); HEAD]; 3],
                mw: [[T::zero(); HEAD]; 3],
                c: [T::zero(); HEAD],
                projected: &mut out.projected,
            };
            run_backward(&input, group, grad, &mut output);
            let Output { w: d_w, mw, c, .. } = output;
            let Group { w, m, .. } = &groups[group];
            let (d_rows, rest) = out.parameters.split_at_mut(HEAD * 3);
            let (d_m, d_c) = rest.split_at_mut(HEAD * HEAD);
            d_c.copy_from_slice(&c);
            // Projections Wᵀ s of the body tokens.
            for (token, d) in out.projected.iter().enumerate() {
                lift(
                    w,
                    *d,
                    &mut out.tokens[(first + token) * GROUP_WIDTH..][..HEAD],
                );
                let s = head(input.row(first + token), group * GROUP_WIDTH);
                for i in 0..HEAD {
                    for axis in 0..3 {
                        d_rows[3 * i + axis] += s[i] * d[axis];
                    }
                }
            }
            // The product M W.
            for axis in 0..3 {
                for row in 0..HEAD {
                    d_rows[3 * row + axis] += d_w[axis][row];
                    for inner in 0..HEAD {
                        d_m[row * HEAD + inner] += mw[axis][row] * w[axis][inner];
                        d_rows[3 * inner + axis] += mw[axis][row] * m[row * HEAD + inner];
                    }
                }
            }
        });
    }
}

/// Rows of the token matrix's gradient `[rows, 128]`, from row `first` on, out of the groups'.
pub(super) fn token_gradient<T: Real>(
    gradients: &[GroupGradient<T>; GROUPS],
    first: usize,
    out: &mut [T],
) {
    for (offset, out) in out.chunks_exact_mut(WIDTH).enumerate() {
        let row = (first + offset) * GROUP_WIDTH;
        for (gradient, out) in gradients.iter().zip(out.chunks_exact_mut(GROUP_WIDTH)) {
            out.copy_from_slice(&gradient.tokens[row..row + GROUP_WIDTH]);
        }
    }
}

/// Gradient of the parameters, groups one behind the other.
pub(super) fn parameter_gradient<T: Real>(gradients: &[GroupGradient<T>; GROUPS], out: &mut [T]) {
    for (gradient, out) in gradients.iter().zip(out.chunks_exact_mut(GROUP_PARAMETERS)) {
        out.copy_from_slice(&gradient.parameters);
    }
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
            self.forward::<T>(operand(s1, l1)?, operand(s2, l2)?, &mut out);
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
            let mut gradients: [GroupGradient<T>; GROUPS] = Default::default();
            self.backward::<T>(&values(tokens)?, &values(parameters)?, &values(grad)?, &mut gradients);
            let mut d_tokens = vec![<T as num_traits::Zero>::zero(); tokens.elem_count()];
            token_gradient(&gradients, 0, &mut d_tokens);
            let mut d_parameters = vec![<T as num_traits::Zero>::zero(); parameters.elem_count()];
            parameter_gradient(&gradients, &mut d_parameters);
            let device = tokens.device();
            Ok((
                Some(Tensor::from_vec(d_tokens, tokens.shape(), device)?),
                Some(Tensor::from_vec(d_parameters, parameters.shape(), device)?),
            ))
        })
    }
}

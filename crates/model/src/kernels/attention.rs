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

/// One group's parameters, with M W multiplied out.
struct Group<'a, T> {
    w: &'a [T],
    m: &'a [T],
    c: &'a [T],
    mw: [[T; 3]; HEAD],
}

impl<'a, T: Real> Group<'a, T> {
    fn all(parameters: &'a [T]) -> Vec<Self> {
        parameters
            .chunks_exact(GROUP_PARAMETERS)
            .map(|all| {
                let (w, rest) = all.split_at(HEAD * 3);
                let (m, c) = rest.split_at(HEAD * HEAD);
                let mut mw = [[T::zero(); 3]; HEAD];
                for (row, out) in mw.iter_mut().enumerate() {
                    for inner in 0..HEAD {
                        for (axis, value) in out.iter_mut().enumerate() {
                            *value += m[row * HEAD + inner] * w[inner * 3 + axis];
                        }
                    }
                }
                Group { w, m, c, mw }
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

/// `Wᵀ x`.
#[inline(always)]
fn project<T: Real>(w: &[T], x: &[T; HEAD]) -> [T; 3] {
    let mut z = [T::zero(); 3];
    for i in 0..HEAD {
        for axis in 0..3 {
            z[axis] += w[i * 3 + axis] * x[i];
        }
    }
    z
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

/// One entry's share of a softmax.
#[derive(Clone, Copy)]
struct Entry<T> {
    /// Row of the sender in the token matrix.
    row: usize,
    /// Body token, if it is one.
    body: Option<usize>,
    /// |r − s|.
    distance: T,
    /// (r + s)·q.
    alignment: T,
    /// Logit, then probability.
    weight: T,
}

/// Distance, alignment and logit of an entry. A function of its own, so that it is
/// compiled for the caller's vector units.
#[inline(always)]
fn score<T: Real>(
    r: &[T; HEAD],
    q: &[T; HEAD],
    s: &[T; HEAD],
    (row, body): (usize, Option<usize>),
    bias: T,
) -> Entry<T> {
    let (mut squares, mut products) = ([T::zero(); HEAD], [T::zero(); HEAD]);
    for i in 0..HEAD {
        let d = r[i] - s[i];
        squares[i] = d * d;
        products[i] = q[i] * (r[i] + s[i]);
    }
    let squared = tree_sum(squares);
    let floor = T::of(SQUARED_DISTANCE_FLOOR);
    // Written so that a NaN stays a NaN and is found.
    let distance = if squared < floor {
        floor.sqrt()
    } else {
        squared.sqrt()
    };
    let alignment = tree_sum(products);
    let weight = T::of(2.0 * KAPPA) * alignment / (distance + T::of(2.0 * EPSILON)) + bias;
    Entry {
        row,
        body,
        distance,
        alignment,
        weight,
    }
}

impl<'a, T: Real> Input<'a, T> {
    #[inline(always)]
    fn row(&self, row: usize) -> &'a [T] {
        &self.tokens[row * WIDTH..(row + 1) * WIDTH]
    }

    /// Probabilities of one head of one receiver. `start` is the head's first channel.
    #[inline(always)]
    fn entries(&self, receiver: usize, mesh: bool, start: usize, out: &mut Vec<Entry<T>>) {
        out.clear();
        let edges = self.edges;
        let r = head(self.row(receiver), start);
        let q = head(self.row(self.receivers + receiver), start);
        let list = if mesh { &edges.mesh } else { &edges.world };
        let first = 2 * self.receivers;
        for &sender in list.row(receiver) {
            let row = first + sender as usize;
            let s = head(self.row(row), start);
            out.push(score(r, q, s, (row, None), T::zero()));
        }
        if !mesh {
            let range =
                edges.body.offsets[receiver] as usize..edges.body.offsets[receiver + 1] as usize;
            let counts = &edges.body_log_count[range.clone()];
            for (&token, &count) in edges.body.items[range].iter().zip(counts) {
                let row = first + edges.senders + token as usize;
                let s = head(self.row(row), start);
                let bias = T::of(f64::from(count));
                out.push(score(r, q, s, (row, Some(token as usize)), bias));
            }
        }
        let largest = out.iter().fold(T::neg_infinity(), |top, entry| {
            if entry.weight > top || entry.weight.is_nan() {
                entry.weight
            } else {
                top
            }
        });
        let mut total = T::zero();
        for entry in out.iter_mut() {
            entry.weight = (entry.weight - largest).exp();
            total += entry.weight;
        }
        for entry in out.iter_mut() {
            entry.weight /= total;
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
            let value = g.mw[i][0] * t[0] + g.mw[i][1] * t[1] + g.mw[i][2] * t[2] + g.c[i];
            y[i] = if value < T::zero() { T::zero() } else { value };
        }
        (t, y)
    }
}

#[inline(always)]
fn forward_rows<T: Real>(input: &Input<T>, first: usize, out: &mut [T]) {
    let mut entries = Vec::new();
    for (offset, out) in out.chunks_exact_mut(WIDTH).enumerate() {
        let receiver = first + offset;
        for group in 0..GROUPS {
            for mesh in [false, true] {
                let start = (2 * group + usize::from(mesh)) * HEAD;
                input.entries(receiver, mesh, start, &mut entries);
                let r = head(input.row(receiver), start);
                let mut sum = [T::zero(); HEAD];
                let mut turned = [T::zero(); 3];
                let a = project(input.groups[group].w, r);
                for entry in &entries {
                    let value = entry.weight / entry.distance;
                    if let Some(token) = entry.body {
                        let (_, y) = input.body_inner(group, token, a);
                        let o = turn_back(
                            &input.edges.rotations[token],
                            project(input.groups[group].w, &y),
                        );
                        for axis in 0..3 {
                            turned[axis] += value * o[axis];
                        }
                    } else {
                        let s = head(input.row(entry.row), start);
                        for i in 0..HEAD {
                            sum[i] += value * (r[i] + s[i]);
                        }
                    }
                }
                for i in 0..HEAD {
                    out[start + i] += sum[i];
                }
                if !mesh {
                    let w = input.groups[group].w;
                    let body = input.body_start(group);
                    for i in 0..HEAD {
                        out[body + i] += w[3 * i] * turned[0]
                            + w[3 * i + 1] * turned[1]
                            + w[3 * i + 2] * turned[2];
                    }
                }
            }
        }
    }
}

/// What the backward pass of one group adds to; `mw` collects dM W products.
struct Output<'a, T> {
    tokens: &'a mut [T],
    parameters: &'a mut [T],
    mw: &'a mut [[T; 3]; HEAD],
    projected: &'a mut [[T; 3]],
}

/// Gradient of an entry's weight, and of a body entry the message's parts:
/// `R Wᵀ(r + s)`, `relu(M W · + c)`, `Rᵀ Wᵀ` of that, and `Wᵀ` of that.
type Message<T> = (T, [T; 3], [T; HEAD], [T; 3], [T; 3]);

#[inline(always)]
fn backward_group<T: Real>(input: &Input<T>, group: usize, grad: &[T], out: &mut Output<T>) {
    let mut entries = Vec::new();
    // Per entry: gradient of the weight, and for body entries the message's parts.
    let mut inner: Vec<Message<T>> = Vec::new();
    let zero3 = [T::zero(); 3];
    for (receiver, grad) in grad.chunks_exact(WIDTH).enumerate() {
        {
            let w = input.groups[group].w;
            for mesh in [false, true] {
                let own = if mesh { HEAD } else { 0 };
                let start = (2 * group + usize::from(mesh)) * HEAD;
                input.entries(receiver, mesh, start, &mut entries);
                if entries.is_empty() {
                    continue;
                }
                let r = head(input.row(receiver), start);
                let q = head(input.row(input.receivers + receiver), start);
                let g = head(grad, start);
                let body_g = head(grad, input.body_start(group));
                let a = if mesh { zero3 } else { project(w, r) };
                let lifted_g = if mesh { zero3 } else { project(w, body_g) };
                let mut turned = zero3;
                inner.clear();
                let mut mean = T::zero();
                for entry in &entries {
                    let value = entry.weight / entry.distance;
                    let parts = if let Some(token) = entry.body {
                        let (t, y) = input.body_inner(group, token, a);
                        let wy = project(w, &y);
                        let o = turn_back(&input.edges.rotations[token], wy);
                        for axis in 0..3 {
                            turned[axis] += value * o[axis];
                        }
                        let dp = lifted_g[0] * o[0] + lifted_g[1] * o[1] + lifted_g[2] * o[2];
                        (dp / entry.distance, t, y, o, wy)
                    } else {
                        let s = head(input.row(entry.row), start);
                        let mut sum = [T::zero(); HEAD];
                        for i in 0..HEAD {
                            sum[i] = g[i] * (r[i] + s[i]);
                        }
                        (
                            tree_sum(sum) / entry.distance,
                            zero3,
                            [T::zero(); HEAD],
                            zero3,
                            zero3,
                        )
                    };
                    mean += entry.weight * parts.0;
                    inner.push(parts);
                }
                let mut dr = [T::zero(); HEAD];
                let mut dq = [T::zero(); HEAD];
                let mut da = zero3;
                for (entry, &(dp, t, y, _, _)) in entries.iter().zip(&inner) {
                    let s = head(input.row(entry.row), start);
                    let soft = entry.distance + T::of(2.0 * EPSILON);
                    let dl = entry.weight * (dp - mean);
                    let scale = dl * T::of(2.0 * KAPPA) / soft;
                    let value = entry.weight / entry.distance;
                    // Both the logit and the message fall with the distance; below its floor it is constant.
                    let floored = entry.distance * entry.distance <= T::of(SQUARED_DISTANCE_FLOOR);
                    let d_distance = if floored {
                        T::zero()
                    } else {
                        -(scale * entry.alignment / soft + value * dp)
                    };
                    let along = d_distance / entry.distance;
                    let plain = if entry.body.is_some() {
                        T::zero()
                    } else {
                        value
                    };
                    let ds = &mut out.tokens[entry.row * GROUP_WIDTH + own..][..HEAD];
                    for i in 0..HEAD {
                        let both = scale * q[i] + plain * g[i];
                        let apart = along * (r[i] - s[i]);
                        dr[i] += both + apart;
                        ds[i] += both - apart;
                        dq[i] += scale * (r[i] + s[i]);
                    }
                    if let Some(token) = entry.body {
                        let rotation = &input.edges.rotations[token];
                        // d(Wᵀ y), turned into the token's frame.
                        let dz = turn(rotation, lifted_g.map(|x| x * value));
                        let dw = &mut out.parameters[..HEAD * 3];
                        let mut dt = zero3;
                        let mut dy = [T::zero(); HEAD];
                        for i in 0..HEAD {
                            for axis in 0..3 {
                                dw[3 * i + axis] += y[i] * dz[axis];
                            }
                            let raw =
                                w[3 * i] * dz[0] + w[3 * i + 1] * dz[1] + w[3 * i + 2] * dz[2];
                            dy[i] = if y[i] > T::zero() { raw } else { T::zero() };
                        }
                        let dc = &mut out.parameters[HEAD * 3 + HEAD * HEAD..];
                        let (mw, dmw) = (&input.groups[group].mw, &mut *out.mw);
                        for i in 0..HEAD {
                            dc[i] += dy[i];
                            for axis in 0..3 {
                                dt[axis] += mw[i][axis] * dy[i];
                                dmw[i][axis] += dy[i] * t[axis];
                            }
                        }
                        let db = turn_back(rotation, dt);
                        for axis in 0..3 {
                            da[axis] += db[axis];
                            out.projected[token][axis] += db[axis];
                        }
                    }
                }
                if !mesh {
                    let dw = &mut out.parameters[..HEAD * 3];
                    for i in 0..HEAD {
                        for axis in 0..3 {
                            // The lift of the summed messages, and the projection of r.
                            dw[3 * i + axis] += body_g[i] * turned[axis] + r[i] * da[axis];
                            dr[i] += w[3 * i + axis] * da[axis];
                        }
                    }
                }
                let row = &mut out.tokens[receiver * GROUP_WIDTH + own..][..HEAD];
                for i in 0..HEAD {
                    row[i] += dr[i];
                }
                let row =
                    &mut out.tokens[(input.receivers + receiver) * GROUP_WIDTH + own..][..HEAD];
                for i in 0..HEAD {
                    row[i] += dq[i];
                }
            }
        }
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
                std::array::from_fn(|group| project(groups[group].w, head(row, 2 * group * HEAD)))
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
            let mut d_mw = [[T::zero(); 3]; HEAD];
            let mut output = Output {
                tokens: &mut out.tokens,
                parameters: &mut out.parameters,
                mw: &mut d_mw,
                projected: &mut out.projected,
            };
            run_backward(&input, group, grad, &mut output);
            let (w, m) = (groups[group].w, groups[group].m);
            // Projections Wᵀ s of the body tokens.
            for (token, d) in out.projected.iter().enumerate() {
                let row = &mut out.tokens[(first + token) * GROUP_WIDTH..][..HEAD];
                let s = head(input.row(first + token), group * GROUP_WIDTH);
                for i in 0..HEAD {
                    for axis in 0..3 {
                        row[i] += w[3 * i + axis] * d[axis];
                        out.parameters[3 * i + axis] += s[i] * d[axis];
                    }
                }
            }
            // The product M W.
            for row in 0..HEAD {
                for inner in 0..HEAD {
                    for axis in 0..3 {
                        out.parameters[HEAD * 3 + row * HEAD + inner] +=
                            d_mw[row][axis] * w[3 * inner + axis];
                        out.parameters[3 * inner + axis] += d_mw[row][axis] * m[row * HEAD + inner];
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

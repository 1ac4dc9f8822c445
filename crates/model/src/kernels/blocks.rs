//! The Transformer blocks, one after the other, in one operation.
//!
//! P patches receive; T particles (patches, then attribute tokens) and G body tokens
//! send. States Z `[T + G, 128]`, receivers' memory R `[P, 128]`, senders' memory
//! S `[T + G, 128]`. A block, with Z_P the patches' rows:
//! `r = Z_P W_rᵀ + R M`, `q = Z_P W_qᵀ`, `s = Z W_sᵀ + S M`, M = (W_m + I)ᵀ;
//! `y = attend(r, q, s)` ([`super::attention`]);
//! `Z₁ = LN₀(Z + o)`, o = `y W_oᵀ + b_o` for patches and Z itself for other rows;
//! `Z ← LN₁(Z₁ + relu(W₂ relu(W₁ Z₁ + b₁) + b₂))`;
//! `R ← LN_r(r W_Rᵀ + b_R)`, `S ← LN_s(s W_Sᵀ + b_S)`.
//! Nobody needs the last block's memories, nor its rows that are not patches.
//!
//! All but the attention works row by row, so rows go through in tiles that stay in a
//! core's cache. Tiles and their order are fixed: bits do not depend on threads. The
//! backward pass mirrors the forward one on the same tiles; a weight's gradient is
//! summed over tiles by one thread, several weights side by side.

use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};

use super::attention::{
    Attention, Edges, GROUP_PARAMETERS, GROUPS, GroupGradient, WIDTH, parameter_gradient,
    token_gradient,
};
use super::layer_norm;
use super::product::{
    add, add_outer, add_rows, fill_rows, mask, push_transposed, relu, rows_times, sum,
};
use super::{Real, by_dtype, for_all, operand, values};

/// Rows of a tile, at most.
const TILE: usize = 96;
/// Width of the feed-forward layer.
const HIDDEN: usize = 2 * WIDTH;

/// A layer's place among a block's weights.
#[derive(Clone, Copy)]
struct Layer {
    start: usize,
    inner: usize,
    out: usize,
    bias: bool,
}

impl Layer {
    const fn len(self) -> usize {
        self.inner * self.out + if self.bias { self.out } else { 0 }
    }
}

const fn layer(start: usize, inner: usize, out: usize, bias: bool) -> Layer {
    Layer {
        start,
        inner,
        out,
        bias,
    }
}

const fn end(layer: Layer) -> usize {
    layer.start + layer.len()
}

/// The order of a block's weights, one behind the other: W_r, W_q, W_s, W_m + I without
/// biases, the four groups' W, M, c, then (weight, bias) of output, receiver and sender
/// projections and both feed-forward layers, then (weight, bias) of LN₀, LN₁, LN_r, LN_s.
const RECEIVER: Layer = layer(0, WIDTH, WIDTH, false);
const QUERY: Layer = layer(end(RECEIVER), WIDTH, WIDTH, false);
const SENDER: Layer = layer(end(QUERY), WIDTH, WIDTH, false);
const MEMORY: Layer = layer(end(SENDER), WIDTH, WIDTH, false);
const GROUPS_START: usize = end(MEMORY);
const OUTPUT: Layer = layer(GROUPS_START + GROUPS * GROUP_PARAMETERS, WIDTH, WIDTH, true);
const RECEIVER_OUT: Layer = layer(end(OUTPUT), WIDTH, WIDTH, true);
const SENDER_OUT: Layer = layer(end(RECEIVER_OUT), WIDTH, WIDTH, true);
const FEED: [Layer; 2] = [
    layer(end(SENDER_OUT), WIDTH, HIDDEN, true),
    layer(end(SENDER_OUT) + (WIDTH + 1) * HIDDEN, HIDDEN, WIDTH, true),
];
const NORMS_START: usize = end(FEED[1]);
const NORMS: usize = 4;
/// Numbers of one block.
pub const BLOCK_PARAMETERS: usize = NORMS_START + NORMS * 2 * WIDTH;

const LAYERS: [Layer; 9] = [
    RECEIVER,
    QUERY,
    SENDER,
    MEMORY,
    OUTPUT,
    RECEIVER_OUT,
    SENDER_OUT,
    FEED[0],
    FEED[1],
];

/// What the blocks are applied to and what is asked of them.
#[derive(Clone, Debug)]
pub struct Stack {
    /// Who attends to whom.
    pub edges: Arc<Edges>,
    /// Number of blocks.
    pub blocks: usize,
    /// Whether body messages go to the head they were attended with, see [`super::attention::attend`].
    pub own_slots: bool,
    /// What is returned.
    pub ends: Ends,
    /// Whether to keep what the backward pass needs.
    pub keep: bool,
    /// The transposes of the weights that the blocks are applied with.
    pub transposes: Arc<Transposes>,
}

/// What the blocks return.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// The patches' states after each block, one below the other: `[blocks · P, 128]`.
    Patches,
    /// The patches' states after the last block: `[P, 128]`.
    LastPatches,
    /// All of the last block, memories too: Z, R and S one below the other.
    Everything,
}

/// Applies the blocks.
///
/// `tokens` holds Z `[T + G, 128]`, R `[P, 128]` and S `[T + G, 128]` one below the other;
/// `parameters` the blocks' weights in the order above, `[blocks · BLOCK_PARAMETERS]`.
///
/// # Errors
/// Shapes that do not fit the edges, or a type other than f32 and f64.
pub fn apply(tokens: &Tensor, parameters: &Tensor, stack: Stack) -> Result<Tensor> {
    tokens.contiguous()?.apply_op2(
        &parameters.contiguous()?,
        Blocks {
            stack,
            f32s: Mutex::new(None),
            f64s: Mutex::new(None),
        },
    )
}

struct Blocks {
    stack: Stack,
    f32s: Mutex<Option<Workshop<f32>>>,
    f64s: Mutex<Option<Workshop<f64>>>,
}

/// Transposes of the blocks' weights, made once for as many calls as share them.
#[derive(Debug, Default)]
pub struct Transposes {
    f32s: OnceLock<Vec<f32>>,
    f64s: OnceLock<Vec<f64>>,
}

/// One block's weights with their transposes at the same places.
struct Weights<'a, T> {
    all: &'a [T],
    transposed: &'a [T],
}

impl<'a, T: Real> Weights<'a, T> {
    fn groups(&self) -> &'a [T] {
        &self.all[GROUPS_START..OUTPUT.start]
    }

    /// `y = x Wᵀ + b`.
    fn forward(&self, layer: Layer, x: &[T], y: &mut [T]) {
        if layer.bias {
            let start = layer.start + layer.inner * layer.out;
            fill_rows(&self.all[start..start + layer.out], y);
        }
        self.product(layer, x, y, layer.bias);
    }

    /// `y += x Wᵀ`.
    fn forward_add(&self, layer: Layer, x: &[T], y: &mut [T]) {
        self.product(layer, x, y, true);
    }

    fn product(&self, layer: Layer, x: &[T], y: &mut [T], keep: bool) {
        let size = layer.inner * layer.out;
        rows_times(
            x,
            &self.transposed[layer.start..][..size],
            layer.out,
            y,
            keep,
        );
    }

    /// `dx = dx·keep + g W`.
    fn backward(&self, layer: Layer, g: &[T], dx: &mut [T], keep: bool) {
        let size = layer.inner * layer.out;
        rows_times(g, &self.all[layer.start..][..size], layer.inner, dx, keep);
    }

    fn norm(&self, index: usize) -> (&[T], &[T]) {
        self.all[NORMS_START + index * 2 * WIDTH..][..2 * WIDTH].split_at(WIDTH)
    }

    fn norm_forward(&self, index: usize, x: &[T], y: &mut [T]) {
        let (w, b) = self.norm(index);
        layer_norm::run_forward(x, w, b, y);
    }

    /// `dx` from the norm's input x and its output's gradient; weight and bias gradients are added to `d`.
    fn norm_backward(&self, index: usize, x: &[T], g: &[T], dx: &mut [T], d: &mut [T]) {
        let (dw, db) = d[index * 2 * WIDTH..][..2 * WIDTH].split_at_mut(WIDTH);
        layer_norm::run_backward(x, self.norm(index).0, g, dx, dw, db);
    }
}

/// What one tile keeps of a block; names as in the module's formula.
#[derive(Clone, Default)]
struct Tile<T> {
    /// Z, R (patches only) and S as they come in.
    z: Vec<T>,
    receiver: Vec<T>,
    sender: Vec<T>,
    /// Z + o, before LN₀.
    residual: Vec<T>,
    z1: Vec<T>,
    /// relu(W₁ Z₁ + b₁), and relu(W₂ · + b₂).
    hidden: Vec<T>,
    fed: Vec<T>,
    /// r W_Rᵀ + b_R and s W_Sᵀ + b_S, before their norms.
    receiver_out: Vec<T>,
    sender_out: Vec<T>,
    /// Z₁ + fed, before LN₁; not kept.
    scratch: Vec<T>,
}

/// What a block keeps.
#[derive(Default)]
struct Block<T> {
    /// r, q, s one below the other, as the attention reads them.
    tokens: Vec<T>,
    /// The attention's output.
    attended: Vec<T>,
    tiles: Vec<Tile<T>>,
}

/// Buffers of a pass. What the forward pass leaves in `blocks` is what the backward pass needs.
/// Workshops are used again, so that passes over outfits of one size allocate nothing but results.
#[derive(Default)]
struct Workshop<T> {
    blocks: Vec<Block<T>>,
    gradients: Vec<TileGradient<T>>,
    groups: [GroupGradient<T>; GROUPS],
    d_attended: Vec<T>,
}

impl<T: Keep> Workshop<T> {
    /// One that nobody uses, or a new one.
    fn take() -> Self {
        let shelf = T::shelf().lock();
        let free = shelf.expect("nobody panics with it").pop();
        free.unwrap_or_default()
    }

    fn put_back(self) {
        let shelf = T::shelf().lock();
        shelf.expect("nobody panics with it").push(self);
    }
}

/// Fits a buffer's length; what is in it is to be overwritten.
fn fit<T: Real>(buffer: &mut Vec<T>, len: usize) -> &mut [T] {
    buffer.resize(len, T::zero());
    buffer
}

/// A tile's gradients and room for work.
#[derive(Clone, Default)]
struct TileGradient<T> {
    /// Of Z, R and S: of what comes out before a block, of what came in after it.
    z: Vec<T>,
    receiver: Vec<T>,
    sender: Vec<T>,
    /// Of the layers' outputs.
    fed: Vec<T>,
    hidden: Vec<T>,
    output: Vec<T>,
    receiver_out: Vec<T>,
    sender_out: Vec<T>,
    r: Vec<T>,
    q: Vec<T>,
    s: Vec<T>,
    scratch: Vec<T>,
    /// Of the norms' weights.
    norms: Vec<T>,
}

/// Rows of the tokens, cut into tiles: patches first, no tile holds both kinds.
struct Plan {
    patches: usize,
    rows: usize,
    tiles: Vec<Range<usize>>,
}

impl Plan {
    fn new(edges: &Edges) -> Self {
        let patches = edges.mesh.rows();
        let rows = edges.senders + edges.rotations.len();
        let mut tiles = Vec::new();
        for part in [0..patches, patches..rows] {
            let mut start = part.start;
            while start < part.end {
                let end = (start + TILE).min(part.end);
                tiles.push(start..end);
                start = end;
            }
        }
        Self {
            patches,
            rows,
            tiles,
        }
    }

    /// Tiles of patches.
    fn receiving(&self) -> usize {
        self.patches.div_ceil(TILE)
    }

    /// Cuts `values` `[rows, 128]` (or patches only) at the tiles.
    fn cut<'a, T>(&self, mut values: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut parts = Vec::new();
        for tile in &self.tiles {
            if values.is_empty() {
                break;
            }
            let (part, rest) = values.split_at_mut(tile.len() * WIDTH);
            parts.push(part);
            values = rest;
        }
        parts
    }

    /// r, q and s of each tile out of the attention's tokens; r and q are empty where nothing receives.
    fn cut_tokens<'a, T>(&self, tokens: &'a mut [T]) -> Vec<[&'a mut [T]; 3]> {
        let (r, rest) = tokens.split_at_mut(self.patches * WIDTH);
        let (q, s) = rest.split_at_mut(self.patches * WIDTH);
        let (mut r, mut q) = (self.cut(r).into_iter(), self.cut(q).into_iter());
        self.cut(s)
            .into_iter()
            .map(|s| {
                [
                    r.next().unwrap_or_default(),
                    q.next().unwrap_or_default(),
                    s,
                ]
            })
            .collect()
    }

    /// A tile's rows of r, q and s.
    fn rows_of<'a, T>(&self, tokens: &'a [T], tile: usize) -> [&'a [T]; 3] {
        let rows = &self.tiles[tile];
        let at = |first: usize| &tokens[(first + rows.start) * WIDTH..(first + rows.end) * WIDTH];
        if tile < self.receiving() {
            [at(0), at(self.patches), at(2 * self.patches)]
        } else {
            [&[], &[], at(2 * self.patches)]
        }
    }
}

impl<T: Real> Tile<T> {
    /// r, q and s of the tile's rows.
    fn send(&self, weights: &Weights<T>, [r, q, s]: [&mut [T]; 3]) {
        if !r.is_empty() {
            weights.forward(RECEIVER, &self.z, r);
            weights.forward_add(MEMORY, &self.receiver, r);
            weights.forward(QUERY, &self.z, q);
        }
        weights.forward(SENDER, &self.z, s);
        weights.forward_add(MEMORY, &self.sender, s);
    }

    /// The rest of the block after the attention; `next` gets Z and, unless the block is the last, R and S.
    fn update(
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

impl<T: Real> TileGradient<T> {
    /// Back through [`Tile::update`]: from the gradients of what came out to those of the layers'
    /// outputs, of the attention's output, and the parts of Z, r and s that do not pass it.
    fn update(
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
    fn send(
        &mut self,
        weights: &Weights<T>,
        attention: &[GroupGradient<T>; GROUPS],
        rows: &Range<usize>,
        patches: usize,
    ) {
        let mut take = |first: usize, to: &mut [T]| {
            let from = fit(&mut self.scratch, to.len());
            token_gradient(attention, first, from);
            add(from, to);
        };
        take(2 * patches + rows.start, &mut self.s);
        if !self.r.is_empty() {
            take(rows.start, &mut self.r);
            let q = fit(&mut self.q, self.r.len());
            token_gradient(attention, patches + rows.start, q);
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

impl Blocks {
    fn attention(&self) -> Attention {
        Attention {
            edges: self.stack.edges.clone(),
            own_slots: self.stack.own_slots,
        }
    }

    fn check(&self, tokens: &Shape, parameters: &Shape) -> Result<()> {
        let plan = Plan::new(&self.stack.edges);
        let (rows, width) = tokens.dims2()?;
        let expected = 2 * plan.rows + plan.patches;
        if rows != expected || width != WIDTH {
            candle_core::bail!(
                "blocks: tokens [{rows}, {width}], edges expect [{expected}, {WIDTH}]"
            );
        }
        let count = self.stack.blocks * BLOCK_PARAMETERS;
        if parameters.elem_count() != count || count == 0 {
            candle_core::bail!(
                "blocks: {} weights for {} blocks, expected {count}, at least one block",
                parameters.elem_count(),
                self.stack.blocks
            );
        }
        if plan.patches > self.stack.edges.senders {
            candle_core::bail!(
                "blocks: {} patches among {} senders: every patch sends too",
                plan.patches,
                self.stack.edges.senders
            );
        }
        self.attention().check_edges()
    }

    fn weights<'a, T: Keep>(&'a self, parameters: &'a [T]) -> Vec<Weights<'a, T>> {
        let transposed = T::transposes(&self.stack.transposes).get_or_init(|| {
            let mut transposed = Vec::with_capacity(parameters.len());
            for (index, all) in parameters.chunks_exact(BLOCK_PARAMETERS).enumerate() {
                for layer in LAYERS {
                    transposed.resize(index * BLOCK_PARAMETERS + layer.start, T::zero());
                    let weight = &all[layer.start..][..layer.inner * layer.out];
                    push_transposed(weight, layer.inner, &mut transposed);
                }
            }
            transposed.resize(parameters.len(), T::zero());
            transposed
        });
        parameters
            .chunks_exact(BLOCK_PARAMETERS)
            .zip(transposed.chunks_exact(BLOCK_PARAMETERS))
            .map(|(all, transposed)| Weights { all, transposed })
            .collect()
    }

    fn forward<T: Keep>(&self, tokens: &[T], parameters: &[T]) -> (Vec<T>, Workshop<T>) {
        let plan = Plan::new(&self.stack.edges);
        let attention = self.attention();
        let everything = self.stack.ends == Ends::Everything;
        let weights = self.weights(parameters);
        let mut workshop = Workshop::<T>::take();
        let blocks = &mut workshop.blocks;
        // Without a backward pass two blocks' buffers serve in turn.
        let kept = if self.stack.keep {
            self.stack.blocks
        } else {
            self.stack.blocks.min(2)
        };
        blocks.resize_with(kept, Block::default);
        blocks.iter_mut().for_each(|block| block.fit(&plan));
        let (z, rest) = tokens.split_at(plan.rows * WIDTH);
        let (receiver, sender) = rest.split_at(plan.patches * WIDTH);
        for (tile, rows) in blocks[0].tiles.iter_mut().zip(&plan.tiles) {
            let at = rows.start * WIDTH..rows.end * WIDTH;
            fit(&mut tile.z, at.len()).copy_from_slice(&z[at.clone()]);
            if rows.end <= plan.patches {
                fit(&mut tile.receiver, at.len()).copy_from_slice(&receiver[at.clone()]);
            } else {
                tile.receiver.clear();
            }
            fit(&mut tile.sender, at.len()).copy_from_slice(&sender[at]);
        }
        let out_rows = match self.stack.ends {
            Ends::Patches => self.stack.blocks * plan.patches,
            Ends::LastPatches => plan.patches,
            Ends::Everything => 2 * plan.rows + plan.patches,
        };
        let mut out = vec![T::zero(); out_rows * WIDTH];
        for (index, weights) in weights.iter().enumerate() {
            let last = index + 1 == self.stack.blocks;
            let count = blocks.len();
            let block = &mut blocks[index % count];
            let pieces = block
                .tiles
                .iter_mut()
                .zip(plan.cut_tokens(&mut block.tokens))
                .collect();
            for_all(pieces, |(tile, tokens)| tile.send(weights, tokens));
            attention.forward(&block.tokens, weights.groups(), &mut block.attended);
            // What comes out goes into the next block's tiles, or, of the last, into the output.
            let Block {
                tokens,
                attended,
                mut tiles,
            } = std::mem::take(block);
            let part = |tile: usize| -> &[T] {
                let rows = &plan.tiles[tile];
                if tile < plan.receiving() {
                    &attended[rows.start * WIDTH..rows.end * WIDTH]
                } else {
                    &[]
                }
            };
            if last {
                let out = match self.stack.ends {
                    Ends::Patches => &mut out[index * plan.patches * WIDTH..],
                    _ => &mut out[..],
                };
                let (z, rest) = if everything {
                    out.split_at_mut(plan.rows * WIDTH)
                } else {
                    (out, Default::default())
                };
                let z = plan
                    .cut(z)
                    .into_iter()
                    .map(Some)
                    .chain(std::iter::repeat_with(|| None));
                let mut pieces = Vec::new();
                if everything {
                    let (receiver, sender) = rest.split_at_mut(plan.patches * WIDTH);
                    let mut receiver = plan.cut(receiver).into_iter();
                    for ((number, tile), (z, sender)) in
                        tiles.iter_mut().enumerate().zip(z.zip(plan.cut(sender)))
                    {
                        pieces.push((
                            number,
                            tile,
                            z,
                            Some((receiver.next().unwrap_or_default(), sender)),
                        ));
                    }
                } else {
                    for ((number, tile), z) in
                        tiles.iter_mut().enumerate().zip(z).take(plan.receiving())
                    {
                        pieces.push((number, tile, z, None));
                    }
                }
                for_all(pieces, |(number, tile, z, memories)| {
                    let z = z.expect("every tile that is computed has a place in the output");
                    tile.update(
                        weights,
                        part(number),
                        plan.rows_of(&tokens, number),
                        z,
                        memories,
                    );
                });
            } else {
                let next = &mut blocks[(index + 1) % count];
                let pieces = tiles.iter_mut().zip(&mut next.tiles).enumerate().collect();
                for_all(
                    pieces,
                    |(number, (tile, next)): (usize, (&mut Tile<T>, &mut Tile<T>))| {
                        let rows = plan.rows_of(&tokens, number);
                        let z = fit(&mut next.z, tile.z.len());
                        let receiver = fit(&mut next.receiver, rows[0].len());
                        let sender = fit(&mut next.sender, tile.sender.len());
                        tile.update(weights, part(number), rows, z, Some((receiver, sender)));
                    },
                );
                if self.stack.ends == Ends::Patches {
                    let all = &mut out[index * plan.patches * WIDTH..][..plan.patches * WIDTH];
                    for (out, tile) in plan.cut(all).into_iter().zip(&next.tiles) {
                        out.copy_from_slice(&tile.z);
                    }
                }
            }
            blocks[index % count] = Block {
                tokens,
                attended,
                tiles,
            };
        }
        (out, workshop)
    }

    /// Gradients of tokens and parameters.
    fn backward<T: Keep>(
        &self,
        parameters: &[T],
        workshop: &mut Workshop<T>,
        grad: &[T],
    ) -> [Vec<T>; 2] {
        let plan = Plan::new(&self.stack.edges);
        let attention = self.attention();
        let everything = self.stack.ends == Ends::Everything;
        let weights = self.weights(parameters);
        let mut d_parameters = vec![T::zero(); parameters.len()];
        let Workshop {
            blocks,
            gradients: tiles,
            groups,
            d_attended,
        } = workshop;
        tiles.resize_with(plan.tiles.len(), TileGradient::default);
        fit(d_attended, plan.patches * WIDTH);
        let (d_z, rest) = grad.split_at(if everything { plan.rows * WIDTH } else { 0 });
        for (tile, rows) in tiles.iter_mut().zip(&plan.tiles) {
            let at = rows.start * WIDTH..rows.end * WIDTH;
            let receiving = if rows.end <= plan.patches {
                at.len()
            } else {
                0
            };
            let z = fit(&mut tile.z, at.len());
            let receiver = fit(&mut tile.receiver, receiving);
            let sender = fit(&mut tile.sender, at.len());
            if everything {
                let (d_receiver, d_sender) = rest.split_at(plan.patches * WIDTH);
                z.copy_from_slice(&d_z[at.clone()]);
                if receiving > 0 {
                    receiver.copy_from_slice(&d_receiver[at.clone()]);
                }
                sender.copy_from_slice(&d_sender[at]);
            } else {
                z.fill(T::zero());
            }
        }
        for index in (0..self.stack.blocks).rev() {
            let last = index + 1 == self.stack.blocks;
            let weights = &weights[index];
            let Block {
                tokens,
                attended,
                tiles: kept_tiles,
            } = &mut blocks[index];
            // Gradients of the patches' states after this block that come from outside.
            let from_outside = match self.stack.ends {
                Ends::Patches => &grad[index * plan.patches * WIDTH..][..plan.patches * WIDTH],
                Ends::LastPatches if last => grad,
                _ => &[],
            };
            let updated = if last && !everything {
                plan.receiving()
            } else {
                plan.tiles.len()
            };
            let mut parts = plan.cut(d_attended).into_iter();
            let pieces: Vec<_> = tiles
                .iter_mut()
                .zip(kept_tiles.iter_mut())
                .enumerate()
                .map(|(number, (gradient, tile))| {
                    (number, gradient, tile, parts.next().unwrap_or_default())
                })
                .collect();
            for_all(pieces, |(number, gradient, tile, part)| {
                let rows = plan.rows_of(tokens, number);
                gradient.norms.clear();
                gradient.norms.resize(NORMS * 2 * WIDTH, T::zero());
                if number < updated {
                    if !from_outside.is_empty() && number < plan.receiving() {
                        let at = &plan.tiles[number];
                        add(
                            &from_outside[at.start * WIDTH..at.end * WIDTH],
                            &mut gradient.z,
                        );
                    }
                    gradient.update(weights, tile, rows, part, !last || everything);
                } else {
                    fit(&mut gradient.s, rows[2].len()).fill(T::zero());
                    gradient.r.clear();
                }
            });
            attention.backward(tokens, weights.groups(), d_attended, groups);
            let pieces = tiles.iter_mut().zip(&plan.tiles).collect();
            for_all(pieces, |(gradient, rows)| {
                gradient.send(weights, groups, rows, plan.patches)
            });

            let mut d_block = &mut d_parameters[index * BLOCK_PARAMETERS..][..BLOCK_PARAMETERS];
            let norms = d_block
                .split_off_mut(NORMS_START..)
                .expect("norms come last");
            for tile in tiles.iter() {
                add(&tile.norms, norms);
            }
            parameter_gradient(groups, &mut d_block[GROUPS_START..OUTPUT.start]);
            let mut rest = d_block;
            let mut start = 0;
            let mut jobs = Vec::new();
            for (number, layer) in LAYERS.into_iter().enumerate() {
                let _ = rest.split_off_mut(..layer.start - start);
                jobs.push((
                    number,
                    layer,
                    rest.split_off_mut(..layer.len()).expect("layers fit"),
                ));
                start = layer.start + layer.len();
            }
            // The largest first, so that no thread is left alone with one.
            jobs.sort_by_key(|(_, layer, _)| std::cmp::Reverse(layer.len()));
            let memories = !last || everything;
            for_all(jobs, |(number, layer, d)| {
                let (dw, db) = d.split_at_mut(layer.inner * layer.out);
                for (tile, (kept, g)) in kept_tiles.iter().zip(tiles.iter()).enumerate() {
                    let [r, _, s] = plan.rows_of(tokens, tile);
                    let receives = tile < plan.receiving();
                    let part = if receives {
                        &attended[plan.tiles[tile].start * WIDTH..plan.tiles[tile].end * WIDTH]
                    } else {
                        &[]
                    };
                    let pairs: [(&[T], &[T]); 2] = match number {
                        0 if receives => [(&g.r, &kept.z), (&[], &[])],
                        1 if receives => [(&g.q, &kept.z), (&[], &[])],
                        2 => [(&g.s, &kept.z), (&[], &[])],
                        3 if receives => [(&g.r, &kept.receiver), (&g.s, &kept.sender)],
                        3 => [(&[], &[]), (&g.s, &kept.sender)],
                        4 if receives => [(&g.output, part), (&[], &[])],
                        5 if receives && memories => [(&g.receiver_out, r), (&[], &[])],
                        6 if memories => [(&g.sender_out, s), (&[], &[])],
                        7 if tile < updated => [(&g.hidden, &kept.z1), (&[], &[])],
                        8 if tile < updated => [(&g.fed, &kept.hidden), (&[], &[])],
                        _ => [(&[], &[]), (&[], &[])],
                    };
                    for (g, x) in pairs {
                        if !g.is_empty() {
                            add_outer(g, x, layer.inner, dw);
                            if layer.bias {
                                add_rows(g, db);
                            }
                        }
                    }
                }
            });
        }
        let mut d_tokens = Vec::with_capacity((2 * plan.rows + plan.patches) * WIDTH);
        for tile in tiles.iter() {
            d_tokens.extend_from_slice(&tile.z);
        }
        for tile in tiles.iter() {
            d_tokens.extend_from_slice(&tile.receiver);
        }
        for tile in tiles.iter() {
            d_tokens.extend_from_slice(&tile.sender);
        }
        [d_tokens, d_parameters]
    }
}

impl<T: Real> Block<T> {
    fn fit(&mut self, plan: &Plan) {
        fit(&mut self.tokens, (2 * plan.patches + plan.rows) * WIDTH);
        fit(&mut self.attended, plan.patches * WIDTH);
        self.tiles.resize_with(plan.tiles.len(), Tile::default);
    }
}

/// Scalars with places for what is kept.
trait Keep: Real {
    /// A call's workshop between its forward and its backward pass.
    fn place(blocks: &Blocks) -> &Mutex<Option<Workshop<Self>>>;
    /// Workshops that nobody uses at the moment.
    fn shelf() -> &'static Mutex<Vec<Workshop<Self>>>;
    fn transposes(transposes: &Transposes) -> &OnceLock<Vec<Self>>;
}

macro_rules! keep {
    ($T:ty, $field:ident) => {
        impl Keep for $T {
            fn place(blocks: &Blocks) -> &Mutex<Option<Workshop<Self>>> {
                &blocks.$field
            }

            fn shelf() -> &'static Mutex<Vec<Workshop<Self>>> {
                static SHELF: Mutex<Vec<Workshop<$T>>> = Mutex::new(Vec::new());
                &SHELF
            }

            fn transposes(transposes: &Transposes) -> &OnceLock<Vec<Self>> {
                &transposes.$field
            }
        }
    };
}

keep!(f32, f32s);
keep!(f64, f64s);

impl CustomOp2 for Blocks {
    fn name(&self) -> &'static str {
        "transformer-blocks"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        self.check(l1.shape(), l2.shape())?;
        by_dtype!(super::dtype_of(s1), T => {
            let (out, workshop) = self.forward::<T>(operand(s1, l1)?, operand(s2, l2)?);
            if self.stack.keep {
                *<T as Keep>::place(self).lock().expect("nobody panics with it") = Some(workshop);
            } else {
                workshop.put_back();
            }
            let shape = (out.len() / WIDTH, WIDTH);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(out), shape.into()))
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
            let kept = <T as Keep>::place(self).lock().expect("nobody panics with it").take();
            let Some(mut workshop) = kept else {
                candle_core::bail!("blocks: a backward pass, but nothing was kept for it (or it was used already)");
            };
            let [d_tokens, d_parameters] = self.backward::<T>(&values(parameters)?, &mut workshop, &values(grad)?);
            workshop.put_back();
            let device = tokens.device();
            Ok((
                Some(Tensor::from_vec(d_tokens, tokens.shape(), device)?),
                Some(Tensor::from_vec(d_parameters, parameters.shape(), device)?),
            ))
        })
    }
}

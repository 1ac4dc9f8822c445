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

mod plan;
mod tile;
mod weights;
mod workshop;

use std::sync::{Arc, Mutex};

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use self::tile::{Tile, TileGradient};
use self::weights::{GROUPS_START, LAYERS, NORMS, NORMS_START, OUTPUT, Weights, Which};
use self::workshop::Block;
use super::attention::{Attention, Edges, WIDTH, parameter_gradient};
use super::product::{add, add_outer, add_rows};
use super::{Shelved, by_dtype, fit, for_all, operand, recycled, values};

pub use self::weights::{BLOCK_PARAMETERS, Transposes};
pub(crate) use self::workshop::{Keep, Workshop};

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

/// What the blocks return of what comes out of the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// The patches' states: `[P, 128]`.
    Patches,
    /// Everything, memories too: Z, R and S one below the other.
    Everything,
}

/// Applies the blocks.
///
/// `tokens` holds Z `[T + G, 128]`, R `[P, 128]` and S `[T + G, 128]` one below the other;
/// `parameters` the blocks' weights, `[blocks · BLOCK_PARAMETERS]`: of each block W_r, W_q, W_s and
/// W_m + I without biases, the four groups' W, M, c, then (weight, bias) of output, receiver and
/// sender projections, of both feed-forward layers, and of LN₀, LN₁, LN_r, LN_s.
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

pub(crate) struct Blocks {
    stack: Stack,
    f32s: Mutex<Option<Workshop<f32>>>,
    f64s: Mutex<Option<Workshop<f64>>>,
}

impl Stack {
    fn attention(&self) -> Attention {
        Attention {
            edges: self.edges.clone(),
            own_slots: self.own_slots,
        }
    }

    /// Numbers of Z, R and S.
    fn token_sizes(&self) -> [usize; 3] {
        let rows = self.edges.senders + self.edges.rotations.len();
        [rows, self.edges.mesh.rows(), rows].map(|rows| rows * WIDTH)
    }

    fn check(&self, tokens: &Shape, parameters: &Shape) -> Result<()> {
        let (rows, width) = tokens.dims2()?;
        let expected = self.token_sizes().iter().sum::<usize>() / WIDTH;
        if rows != expected || width != WIDTH {
            candle_core::bail!(
                "blocks: tokens [{rows}, {width}], edges expect [{expected}, {WIDTH}]"
            );
        }
        let count = self.blocks * BLOCK_PARAMETERS;
        if parameters.elem_count() != count || count == 0 {
            candle_core::bail!(
                "blocks: {} weights for {} blocks, expected {count}, at least one block",
                parameters.elem_count(),
                self.blocks
            );
        }
        let patches = self.edges.mesh.rows();
        if patches > self.edges.senders {
            candle_core::bail!(
                "blocks: {patches} patches among {} senders: every patch sends too",
                self.edges.senders
            );
        }
        self.attention().check_edges()
    }

    /// What [`apply`] returns, from Z, R and S; what the backward pass needs stays in the workshop.
    pub(crate) fn forward<T: Keep>(
        &self,
        [z, receiver, sender]: [&[T]; 3],
        parameters: &[T],
        workshop: &mut Workshop<T>,
        out: &mut Vec<T>,
    ) {
        let attention = self.attention();
        let everything = self.ends == Ends::Everything;
        let weights = Weights::all(parameters, &self.transposes);
        let Workshop {
            plan,
            blocks,
            projected,
            parts,
            ..
        } = workshop;
        plan.lay(&self.edges);
        // Without a backward pass two blocks' buffers serve in turn.
        let kept = if self.keep {
            self.blocks
        } else {
            self.blocks.min(2)
        };
        blocks.resize_with(kept, Block::default);
        blocks.iter_mut().for_each(|block| block.fit(plan));
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
        let out_rows = match self.ends {
            Ends::Patches => plan.patches,
            Ends::Everything => 2 * plan.rows + plan.patches,
        };
        let out = fit(out, out_rows * WIDTH);
        for (index, weights) in weights.iter().enumerate() {
            let last = index + 1 == self.blocks;
            let count = blocks.len();
            let block = &mut blocks[index % count];
            let mut places = recycled(std::mem::take(parts));
            places.extend(plan.cut_three(plan.split_tokens(&mut block.tokens)));
            for_all(
                block.tiles.par_iter_mut().zip(places.par_drain(..)),
                |(tile, tokens): (&mut Tile<T>, [&mut [T]; 3])| tile.send(weights, tokens),
            );
            *parts = recycled(places);
            attention.forward(
                &block.tokens,
                weights.groups(),
                projected,
                &mut block.attended,
            );
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
                let (z, rest) = out.split_at_mut(out.len().min(plan.rows * WIDTH));
                let (receiver, sender) = rest.split_at_mut(rest.len().min(plan.patches * WIDTH));
                let computed = if everything {
                    tiles.len()
                } else {
                    plan.receiving()
                };
                let mut places = recycled(std::mem::take(parts));
                places.extend(plan.cut_three([z, receiver, sender]).take(computed));
                let pieces = tiles.par_iter_mut().zip(places.par_drain(..)).enumerate();
                for_all(
                    pieces,
                    |(number, (tile, [z, receiver, sender])): (
                        usize,
                        (&mut Tile<T>, [&mut [T]; 3]),
                    )| {
                        let rows = plan.rows_of(&tokens, number);
                        let memories = everything.then_some((receiver, sender));
                        tile.update(weights, part(number), rows, z, memories);
                    },
                );
                *parts = recycled(places);
            } else {
                let next = &mut blocks[(index + 1) % count];
                let pieces = tiles.par_iter_mut().zip(&mut next.tiles).enumerate();
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
            }
            blocks[index % count] = Block {
                tokens,
                attended,
                tiles,
            };
        }
    }

    /// Gradients of Z, R, S and of the parameters.
    pub(crate) fn backward<T: Keep>(
        &self,
        parameters: &[T],
        workshop: &mut Workshop<T>,
        grad: &[T],
        [d_z, d_receiver, d_sender]: [&mut [T]; 3],
        d_parameters: &mut [T],
    ) {
        let attention = self.attention();
        let everything = self.ends == Ends::Everything;
        let weights = Weights::all(parameters, &self.transposes);
        d_parameters.fill(T::zero());
        let Workshop {
            plan,
            blocks,
            projected,
            gradients: tiles,
            attention: d_attention,
            d_attended,
            parts,
        } = workshop;
        tiles.resize_with(plan.tiles.len(), TileGradient::default);
        fit(d_attended, plan.patches * WIDTH);
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
                let (d_z, rest) = grad.split_at(plan.rows * WIDTH);
                let (d_receiver, d_sender) = rest.split_at(plan.patches * WIDTH);
                z.copy_from_slice(&d_z[at.clone()]);
                if receiving > 0 {
                    receiver.copy_from_slice(&d_receiver[at.clone()]);
                }
                sender.copy_from_slice(&d_sender[at]);
            } else if receiving > 0 {
                z.copy_from_slice(&grad[at]);
            } else {
                z.fill(T::zero());
            }
        }
        for index in (0..self.blocks).rev() {
            let last = index + 1 == self.blocks;
            let weights = &weights[index];
            let Block {
                tokens,
                attended,
                tiles: kept_tiles,
            } = &mut blocks[index];
            let updated = if last && !everything {
                plan.receiving()
            } else {
                plan.tiles.len()
            };
            let mut places = recycled(std::mem::take(parts));
            places.extend(plan.cut(d_attended).map(|part| [part, &mut [], &mut []]));
            let pieces = (tiles.par_iter_mut().zip(kept_tiles.par_iter_mut()))
                .zip(places.par_drain(..))
                .enumerate();
            type Piece<'a, T> = ((&'a mut TileGradient<T>, &'a mut Tile<T>), [&'a mut [T]; 3]);
            let work = |(number, ((gradient, tile), [part, ..])): (usize, Piece<T>)| {
                let rows = plan.rows_of(tokens, number);
                gradient.norms.clear();
                gradient.norms.resize(NORMS * 2 * WIDTH, T::zero());
                if number < updated {
                    gradient.update(weights, tile, rows, part, !last || everything);
                } else {
                    fit(&mut gradient.s, rows[2].len()).fill(T::zero());
                    gradient.r.clear();
                }
            };
            for_all(pieces, work);
            *parts = recycled(places);
            attention.backward(tokens, weights.groups(), d_attended, projected, d_attention);
            let pieces = tiles.par_iter_mut().zip(&plan.tiles);
            for_all(pieces, |(gradient, rows)| {
                gradient.send(weights, d_attention, rows, plan.patches)
            });

            let mut d_block = &mut d_parameters[index * BLOCK_PARAMETERS..][..BLOCK_PARAMETERS];
            let norms = d_block
                .split_off_mut(NORMS_START..)
                .expect("norms come last");
            for tile in tiles.iter() {
                add(&tile.norms, norms);
            }
            parameter_gradient(d_attention, &mut d_block[GROUPS_START..OUTPUT.start]);
            let mut rest = d_block;
            let mut start = 0;
            let mut jobs = Vec::new();
            for (which, layer) in LAYERS {
                let _ = rest.split_off_mut(..layer.start - start);
                jobs.push((
                    which,
                    layer,
                    rest.split_off_mut(..layer.len()).expect("layers fit"),
                ));
                start = layer.start + layer.len();
            }
            // The largest first, so that no thread is left alone with one.
            jobs.sort_by_key(|(_, layer, _)| std::cmp::Reverse(layer.len()));
            let memories = !last || everything;
            for_all(jobs.into_par_iter(), |(which, layer, d)| {
                let (dw, db) = d.split_at_mut(layer.inner * layer.out);
                for (tile, (kept, g)) in kept_tiles.iter().zip(tiles.iter()).enumerate() {
                    let [r, _, s] = plan.rows_of(tokens, tile);
                    let receives = tile < plan.receiving();
                    let part = if receives {
                        &attended[plan.tiles[tile].start * WIDTH..plan.tiles[tile].end * WIDTH]
                    } else {
                        &[]
                    };
                    // Gradients of the layer's output with its input; the memories' layer has two.
                    let none: (&[T], &[T]) = (&[], &[]);
                    let pairs: [(&[T], &[T]); 2] = match which {
                        Which::Receiver if receives => [(&g.r, &kept.z), none],
                        Which::Query if receives => [(&g.q, &kept.z), none],
                        Which::Sender => [(&g.s, &kept.z), none],
                        Which::Memory if receives => [(&g.r, &kept.receiver), (&g.s, &kept.sender)],
                        Which::Memory => [none, (&g.s, &kept.sender)],
                        Which::Output if receives => [(&g.output, part), none],
                        Which::ReceiverOut if receives && memories => [(&g.receiver_out, r), none],
                        Which::SenderOut if memories => [(&g.sender_out, s), none],
                        Which::Hidden if tile < updated => [(&g.hidden, &kept.z1), none],
                        Which::Fed if tile < updated => [(&g.fed, &kept.hidden), none],
                        _ => [none, none],
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
                layer.put_back(dw);
            });
        }
        for (tile, rows) in tiles.iter().zip(&plan.tiles) {
            let at = rows.start * WIDTH..rows.end * WIDTH;
            d_z[at.clone()].copy_from_slice(&tile.z);
            if !tile.receiver.is_empty() {
                d_receiver[at.clone()].copy_from_slice(&tile.receiver);
            }
            d_sender[at].copy_from_slice(&tile.sender);
        }
    }
}

/// Z, R and S of a token matrix.
fn three<T>(tokens: &[T], sizes: [usize; 3]) -> [&[T]; 3] {
    let (z, rest) = tokens.split_at(sizes[0]);
    let (receiver, sender) = rest.split_at(sizes[1]);
    [z, receiver, sender]
}

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
        self.stack.check(l1.shape(), l2.shape())?;
        by_dtype!(super::dtype_of(s1), T => {
            let (mut workshop, mut out) = (Workshop::<T>::take(), Vec::new());
            let tokens = three(operand::<T>(s1, l1)?, self.stack.token_sizes());
            self.stack.forward(tokens, operand(s2, l2)?, &mut workshop, &mut out);
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
            let zeros = |len| vec![<T as num_traits::Zero>::zero(); len];
            let (mut d_tokens, mut d_parameters) = (zeros(tokens.elem_count()), zeros(parameters.elem_count()));
            let sizes = self.stack.token_sizes();
            let (z, rest) = d_tokens.split_at_mut(sizes[0]);
            let (receiver, sender) = rest.split_at_mut(sizes[1]);
            let (weights, grad) = (values::<T>(parameters)?, values::<T>(grad)?);
            let to = [z, receiver, sender];
            self.stack.backward(&weights, &mut workshop, &grad, to, &mut d_parameters);
            workshop.put_back();
            let device = tokens.device();
            Ok((
                Some(Tensor::from_vec(d_tokens, tokens.shape(), device)?),
                Some(Tensor::from_vec(d_parameters, parameters.shape(), device)?),
            ))
        })
    }
}

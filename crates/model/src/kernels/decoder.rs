//! The decoder's layers: two per row, their mean per segment, the last on that:
//! `m_s = Σ_{i in s} relu(W₂ relu(W₁ x_i + b₁) + b₂) / (n_s + 1e-7)`, `y_s = W₃ m_s + b₃`.
//!
//! `x [rows, in]`; W₁ and b₁ one behind the other, `[h · in + h]`, and W₂, b₂, W₃, b₃,
//! `[h · h + h + out · h + out]`; `y [segments, out]`. Segment s is the rows
//! `offsets[s]..offsets[s+1]`; those from `means` on are not divided, only summed. Of an
//! empty segment m is 0. Rows go through in blocks of whole segments, so that what lies
//! between the layers stays in the cache. Backward: `dW₃ = Σ g_s m_sᵀ`; with g_i = W₃ᵀ g_s
//! over the segment's divisor where the outer ReLU passes: `dW₂ = Σ g_i h_iᵀ`,
//! `dh_i = W₂ᵀ g_i` where the inner ReLU passes, `dW₁ = Σ dh_i x_iᵀ`, `dx_i = W₁ᵀ dh_i`;
//! h is computed again; m and which outer ReLUs pass are kept from the forward pass.

use std::ops::Range;
use std::sync::OnceLock;

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::product::{
    add, add_outer, add_rows, fill_rows, mask, relu, rows_times, transpose, transposed,
};
use super::{Real, by_dtype, fit, for_all_with, operand, recycled, simd_dispatch, values};

const EPSILON: f64 = 1e-7;
/// Rows of a block, about: a few arrays of this many rows fit a core's cache.
const BLOCK_ROWS: usize = 128;
/// Parts of the backward pass that can run side by side; fixed, so that bits do not depend on threads.
const LANES: usize = 8;

/// What the decoder's layers are applied to.
#[derive(Clone, Debug, Default)]
pub struct Segments {
    /// First row of each segment, and the number of rows.
    pub offsets: Vec<u32>,
    /// Number of leading segments that are divided by their length.
    pub means: usize,
}

/// All layers and the mean; see the module's formula. `keep` keeps what the
/// backward pass needs.
///
/// # Errors
/// Shapes that do not fit each other or the segments, or a type other than f32 and f64.
pub fn decode(
    x: &Tensor,
    first: &Tensor,
    second: &Tensor,
    segments: Segments,
    keep: bool,
) -> Result<Tensor> {
    let op = Decoder {
        segments,
        kept: keep.then(OnceLock::new),
    };
    x.contiguous()?
        .apply_op3(&first.contiguous()?, &second.contiguous()?, op)
}

struct Decoder {
    segments: Segments,
    kept: Option<OnceLock<Kept>>,
}

/// What the backward pass needs of the forward pass.
struct Kept {
    /// Of each row and channel, whether the outer ReLU passes (1) or not (0).
    passes: Vec<u8>,
    /// m of each segment.
    means: CpuStorage,
}

/// `y += relu(x)` per row of x, and where it passes.
#[inline(always)]
fn add_relu<T: Real>(x: &[T], y: &mut [T], passes: Option<&mut [u8]>) {
    for x in x.chunks_exact(y.len()) {
        for (y, &x) in y.iter_mut().zip(x) {
            *y += if x < T::zero() { T::zero() } else { x };
        }
    }
    if let Some(passes) = passes {
        for (pass, &x) in passes.iter_mut().zip(x) {
            *pass = u8::from(x > T::zero());
        }
    }
}

/// Scales a row.
#[inline(always)]
fn scale<T: Real>(row: &mut [T], factor: T) {
    row.iter_mut().for_each(|value| *value *= factor);
}

/// `out = factor · g` where it passes, else 0; `sum += out`.
#[inline(always)]
fn masked_row<T: Real>(g: &[T], factor: T, passes: &[u8], out: &mut [T], sum: &mut [T]) {
    for (((out, &g), &pass), sum) in out.iter_mut().zip(g).zip(passes).zip(sum) {
        *out = if pass != 0 { g * factor } else { T::zero() };
        *sum += *out;
    }
}

simd_dispatch!(fn run_add_relu => add_relu<T>(x: &[T], y: &mut [T], passes: Option<&mut [u8]>));
simd_dispatch!(fn run_scale => scale<T>(row: &mut [T], factor: T));
simd_dispatch!(fn run_masked_row => masked_row<T>(g: &[T], factor: T, passes: &[u8], out: &mut [T], sum: &mut [T]));

/// Widths of a call.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    rows: usize,
    inner: usize,
    hidden: usize,
    out: usize,
}

/// Places of a block's output, means and passes, and its segments.
type Piece<'a, T> = (&'a mut [T], &'a mut [T], &'a mut [u8], Range<usize>);

/// Buffers of a forward pass that the next one may use again.
#[derive(Default)]
pub(crate) struct Room<T: 'static> {
    /// Of each row and channel, whether the outer ReLU passes (1) or not (0).
    passes: Vec<u8>,
    /// m of each segment.
    means: Vec<T>,
    transposed: [Vec<T>; 3],
    work: Vec<Piece<'static, T>>,
}

/// `rows` rows of a block in a buffer that has room for most blocks from the start.
fn block<T: Real>(buffer: &mut Vec<T>, rows: usize, width: usize) -> &mut [T] {
    if buffer.is_empty() {
        buffer.reserve_exact(BLOCK_ROWS.max(rows) * width);
    }
    fit(buffer, rows * width)
}

/// Cuts off the first `len`.
fn cut<'a, T>(left: &mut &'a mut [T], len: usize) -> &'a mut [T] {
    left.split_off_mut(..len).expect("as many as are left")
}

/// Weight and bias of a layer of `out` rows.
fn split<T>(layer: &[T], out: usize) -> (&[T], &[T]) {
    layer.split_at(layer.len() - out)
}

/// Weights and biases of the second and the last layer.
fn split_second<T>(layers: &[T], sizes: Sizes) -> [&[T]; 4] {
    let (second, last) = layers.split_at(sizes.hidden * (sizes.hidden + 1));
    let ((w2, b2), (w3, b3)) = (split(second, sizes.hidden), split(last, sizes.out));
    [w2, b2, w3, b3]
}

/// `out = b + x Wᵀ` with the layer's `Wᵀ`.
fn affine<T: Real>(x: &[T], transposed: &[T], bias: &[T], y: &mut [T]) {
    fill_rows(bias, y);
    rows_times(x, transposed, bias.len(), y, true);
}

impl<T> Room<T> {
    /// What the backward pass needs: which ReLUs pass, and m.
    pub(crate) fn kept(&self) -> (&[u8], &[T]) {
        (&self.passes, &self.means)
    }
}

impl Segments {
    pub(crate) fn sizes(&self, x: &Shape, first: usize, second: usize) -> Result<Sizes> {
        let (rows, inner) = x.dims2()?;
        let hidden = first / (inner + 1);
        let offsets = &self.offsets;
        let last = second.saturating_sub(hidden * (hidden + 1));
        let out = last / (hidden + 1);
        if first != hidden * (inner + 1)
            || second != (hidden + out) * (hidden + 1)
            || hidden == 0
            || out == 0
        {
            candle_core::bail!(
                "decoder: rows of {inner}, layers of {first} and {second} numbers: expected \
                 h·{inner} + h and h·h + h + out·h + out"
            );
        }
        if offsets.first() != Some(&0)
            || !offsets.is_sorted()
            || offsets.last().map(|&last| last as usize) != Some(rows)
            || self.means >= offsets.len()
        {
            candle_core::bail!(
                "decoder: {rows} rows, {} offsets that end at {:?}, {} means: expected offsets \
                 that ascend from 0 to the number of rows",
                offsets.len(),
                offsets.last(),
                self.means
            );
        }
        Ok(Sizes {
            rows,
            inner,
            hidden,
            out,
        })
    }

    /// Ranges of segments with about [`BLOCK_ROWS`] rows each.
    fn blocks(&self) -> impl Iterator<Item = Range<usize>> {
        let (offsets, mut start) = (&self.offsets, 0);
        std::iter::from_fn(move || {
            if start + 1 >= offsets.len() {
                return None;
            }
            let mut end = start + 1;
            while end + 1 < offsets.len()
                && (offsets[end + 1] - offsets[start]) as usize <= BLOCK_ROWS
            {
                end += 1;
            }
            Some(std::mem::replace(&mut start, end)..end)
        })
    }

    fn rows(&self, segments: &Range<usize>) -> Range<usize> {
        self.offsets[segments.start] as usize..self.offsets[segments.end] as usize
    }

    fn divisor<T: Real>(&self, segment: usize) -> T {
        let offsets = &self.offsets;
        let length = f64::from(offsets[segment + 1] - offsets[segment]);
        if segment < self.means {
            T::of(1.0 / (length + EPSILON))
        } else {
            T::one()
        }
    }

    /// `y [segments, out]`; with `keep` the room holds what the backward pass needs.
    pub(crate) fn forward<T: Real>(
        &self,
        x: &[T],
        (first, second): (&[T], &[T]),
        sizes: Sizes,
        keep: bool,
        room: &mut Room<T>,
        y: &mut Vec<T>,
    ) {
        let Sizes {
            rows,
            inner,
            hidden,
            out,
        } = sizes;
        let segments = self.offsets.len() - 1;
        let kept = if keep { hidden } else { 0 };
        let means = fit(&mut room.means, segments * hidden);
        let mut left = (
            fit(y, segments * out),
            &mut *means,
            fit(&mut room.passes, rows * kept),
        );
        let mut work = recycled(std::mem::take(&mut room.work));
        work.extend(self.blocks().map(|segments| -> Piece<T> {
            let rows = self.rows(&segments);
            let count = segments.len();
            (
                cut(&mut left.0, count * out),
                cut(&mut left.1, count * hidden),
                cut(&mut left.2, rows.len() * kept),
                segments,
            )
        }));
        let ((w1, b1), [w2, b2, w3, b3]) = (split(first, hidden), split_second(second, sizes));
        let layers = [(w1, inner), (w2, hidden), (w3, hidden)];
        for ((w, inner), to) in layers.into_iter().zip(&mut room.transposed) {
            transpose(w, inner, fit(to, w.len()));
        }
        let [w1, w2, w3] = &room.transposed;
        for_all_with(
            work.par_drain(..),
            |[one, two]: &mut [Vec<T>; 2], (y, means, passes, segments)| {
                let rows = self.rows(&segments);
                let [one, two] = [one, two].map(|buffer| block(buffer, rows.len(), hidden));
                affine(&x[rows.start * inner..rows.end * inner], w1, b1, one);
                relu(one);
                affine(one, w2, b2, two);
                means.fill(T::zero());
                for (mean, segment) in means.chunks_exact_mut(hidden).zip(segments) {
                    let own = self.rows(&(segment..segment + 1));
                    let own = (own.start - rows.start) * hidden..(own.end - rows.start) * hidden;
                    let passes = match passes.is_empty() {
                        true => None,
                        false => Some(&mut passes[own.clone()]),
                    };
                    run_add_relu(&two[own], mean, passes);
                    run_scale(mean, self.divisor(segment));
                }
                affine(means, w3, b3, y);
            },
        );
        room.work = recycled(work);
    }

    /// Gradients of x and of all layers. The blocks are dealt to [`LANES`] lanes, which sum the
    /// layers' gradients apart.
    pub(crate) fn backward<T: Real>(
        &self,
        (x, first, second): (&[T], &[T], &[T]),
        sizes: Sizes,
        g: &[T],
        (passes, means): (&[u8], &[T]),
        [dx, d_first, d_second]: [&mut [T]; 3],
    ) {
        let Sizes {
            inner, hidden, out, ..
        } = sizes;
        let blocks: Vec<_> = self.blocks().collect();
        let ((w1, b1), [w2, _, w3, _]) = (split(first, hidden), split_second(second, sizes));
        let w1t = transposed(w1, inner);
        let mut lanes: Vec<[Vec<T>; 2]> = (0..LANES.min(blocks.len()))
            .map(|_| [first.len(), second.len()].map(|len| vec![T::zero(); len]))
            .collect();
        let (mut work, mut dx_left) = (Vec::new(), dx);
        let per_lane = blocks.len().div_ceil(lanes.len().max(1));
        for (blocks, lane) in blocks.chunks(per_lane.max(1)).zip(&mut lanes) {
            let rows = self.rows(&(blocks[0].start..blocks[blocks.len() - 1].end));
            let dx = cut(&mut dx_left, rows.len() * inner);
            work.push((blocks, dx, lane));
        }
        for_all_with(
            work.into_par_iter(),
            |room: &mut [Vec<T>; 4], (blocks, mut dx, [d_first, d_second])| {
                let (dw1, db1) = d_first.split_at_mut(hidden * inner);
                let (dw2, rest) = d_second.split_at_mut(hidden * hidden);
                let (db2, rest) = rest.split_at_mut(hidden);
                let (dw3, db3) = rest.split_at_mut(out * hidden);
                for segments in blocks {
                    let rows = self.rows(segments);
                    let [one, outer, inward, d_means] = &mut *room;
                    let [one, outer, inward] =
                        [one, outer, inward].map(|buffer| block(buffer, rows.len(), hidden));
                    let d_means = block(d_means, segments.len(), hidden);
                    let x = &x[rows.start * inner..rows.end * inner];
                    affine(x, &w1t, b1, one);
                    relu(one);
                    let g = &g[segments.start * out..segments.end * out];
                    let means = &means[segments.start * hidden..segments.end * hidden];
                    add_outer(g, means, hidden, dw3);
                    add_rows(g, db3);
                    rows_times(g, w3, hidden, d_means, false);
                    for (segment, g) in segments.clone().zip(d_means.chunks_exact(hidden)) {
                        let factor = self.divisor(segment);
                        for row in self.rows(&(segment..segment + 1)) {
                            let at = (row - rows.start) * hidden;
                            let passes = &passes[row * hidden..(row + 1) * hidden];
                            run_masked_row(g, factor, passes, &mut outer[at..at + hidden], db2);
                        }
                    }
                    add_outer(outer, one, hidden, dw2);
                    rows_times(outer, w2, hidden, inward, false);
                    mask(one, inward);
                    add_rows(inward, db1);
                    add_outer(inward, x, inner, dw1);
                    let own = dx
                        .split_off_mut(..rows.len() * inner)
                        .expect("cut to the lane's rows");
                    rows_times(inward, w1, inner, own, false);
                }
            },
        );
        d_first.fill(T::zero());
        d_second.fill(T::zero());
        for [lane_first, lane_second] in &lanes {
            add(lane_first, d_first);
            add(lane_second, d_second);
        }
    }
}

impl CustomOp3 for Decoder {
    fn name(&self) -> &'static str {
        "decoder"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let sizes =
            self.segments
                .sizes(l1.shape(), l2.shape().elem_count(), l3.shape().elem_count())?;
        by_dtype!(super::dtype_of(s1), T => {
            let layers = (operand(s2, l2)?, operand(s3, l3)?);
            let (mut room, mut y) = (Room::<T>::default(), Vec::new());
            let keep = self.kept.is_some();
            self.segments.forward(operand(s1, l1)?, layers, sizes, keep, &mut room, &mut y);
            if let Some(kept) = &self.kept {
                kept.get_or_init(|| Kept {
                    passes: room.passes,
                    means: <T as candle_core::WithDType>::to_cpu_storage_owned(room.means),
                });
            }
            let shape = (y.len() / sizes.out, sizes.out);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), shape.into()))
        })
    }

    fn bwd(
        &self,
        x: &Tensor,
        first: &Tensor,
        second: &Tensor,
        _res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let sizes = self
            .segments
            .sizes(x.shape(), first.elem_count(), second.elem_count())?;
        let Some(kept) = self.kept.as_ref().and_then(OnceLock::get) else {
            candle_core::bail!("decoder: made without keeping what the backward pass needs");
        };
        by_dtype!(x.dtype(), T => {
            let (input, w1, w2, g) = (values::<T>(x)?, values::<T>(first)?, values::<T>(second)?, values::<T>(grad)?);
            let kept = (kept.passes.as_slice(), kept.means.as_slice::<T>()?);
            let [mut dx, mut d_first, mut d_second] = [x, first, second]
                .map(|input| vec![<T as num_traits::Zero>::zero(); input.elem_count()]);
            let to = [&mut dx[..], &mut d_first[..], &mut d_second[..]];
            self.segments.backward::<T>((&input, &w1, &w2), sizes, &g, kept, to);
            let device = x.device();
            Ok((
                Some(Tensor::from_vec(dx, x.shape(), device)?),
                Some(Tensor::from_vec(d_first, first.shape(), device)?),
                Some(Tensor::from_vec(d_second, second.shape(), device)?),
            ))
        })
    }
}

//! Layer norm over the last axis: `y = (x − mean)/sqrt(var + 1e-5) · w + b`.
//!
//! `x [rows, width]`, biased variance. Backward per row, with n = (x − mean)/s,
//! h = g·w: `dx = (h − mean(h) − n·mean(h·n))/s`, `dw = Σ g·n`, `db = Σ g`.

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::product::add;
use super::{Real, by_dtype, fit, for_all, operand, simd_dispatch, values};

const EPSILON: f64 = 1e-5;
/// Rows of one piece; fixed, so that bits do not depend on threads.
const BLOCK_ROWS: usize = 256;
const LANES: usize = 16;

/// Layer norm of each row.
///
/// # Errors
/// Shapes that do not fit, or a type other than f32 and f64.
pub fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    layer_norm_first(x, x.dim(0)?, weight, bias)
}

/// Layer norm of each of the first `rows` rows; the others pass as they are.
///
/// # Errors
/// As [`layer_norm`], or fewer rows.
pub fn layer_norm_first(x: &Tensor, rows: usize, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op3(
        &weight.contiguous()?,
        &bias.contiguous()?,
        LayerNorm { rows },
    )
}

struct LayerNorm {
    rows: usize,
}

/// Sum of `term(i)` over `0..width` in sixteen interleaved lanes: a fixed order that vectorises.
#[inline(always)]
fn lane_sum<T: Real>(width: usize, term: impl Fn(usize) -> T) -> T {
    let mut lanes = [T::zero(); LANES];
    let whole = width / LANES * LANES;
    for start in (0..whole).step_by(LANES) {
        for (lane, sum) in lanes.iter_mut().enumerate() {
            *sum += term(start + lane);
        }
    }
    for (lane, index) in (whole..width).enumerate() {
        lanes[lane] += term(index);
    }
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            let other = lanes[lane + half];
            lanes[lane] += other;
        }
        half /= 2;
    }
    lanes[0]
}

#[inline(always)]
fn moments<T: Real>(row: &[T]) -> (T, T) {
    let n = T::of(row.len() as f64);
    let mean = lane_sum(row.len(), |i| row[i]) / n;
    let variance = lane_sum(row.len(), |i| (row[i] - mean) * (row[i] - mean)) / n;
    (mean, T::one() / (variance + T::of(EPSILON)).sqrt())
}

#[inline(always)]
fn forward_rows<T: Real>(x: &[T], w: &[T], b: &[T], y: &mut [T]) {
    for (x, y) in x.chunks_exact(w.len()).zip(y.chunks_exact_mut(w.len())) {
        let (mean, inverse) = moments(x);
        for ((y, &x), (&w, &b)) in y.iter_mut().zip(x).zip(w.iter().zip(b)) {
            *y = (x - mean) * inverse * w + b;
        }
    }
}

#[inline(always)]
fn backward_rows<T: Real>(x: &[T], w: &[T], g: &[T], dx: &mut [T], dw: &mut [T], db: &mut [T]) {
    let width = w.len();
    let n = T::of(width as f64);
    for ((x, g), dx) in x
        .chunks_exact(width)
        .zip(g.chunks_exact(width))
        .zip(dx.chunks_exact_mut(width))
    {
        let (mean, inverse) = moments(x);
        let (x, g, dx) = (&x[..width], &g[..width], &mut dx[..width]);
        let mean_h = lane_sum(width, |i| g[i] * w[i]) / n;
        let mean_hn = lane_sum(width, |i| g[i] * w[i] * (x[i] - mean) * inverse) / n;
        for i in 0..width {
            let normal = (x[i] - mean) * inverse;
            dx[i] = (g[i] * w[i] - mean_h - normal * mean_hn) * inverse;
            dw[i] += g[i] * normal;
            db[i] += g[i];
        }
    }
}

simd_dispatch!(pub(super) fn run_forward => forward_rows<T>(x: &[T], w: &[T], b: &[T], y: &mut [T]));
simd_dispatch!(pub(super) fn run_backward => backward_rows<T>(x: &[T], w: &[T], g: &[T], dx: &mut [T], dw: &mut [T], db: &mut [T]));

/// The norm of the first `rows` rows into `y`; the others are copied.
pub(crate) fn norm_first<T: Real>(x: &[T], rows: usize, w: &[T], b: &[T], y: &mut [T]) {
    let (x, others) = x.split_at(rows * w.len());
    let (y, passed) = y.split_at_mut(rows * w.len());
    passed.copy_from_slice(others);
    let block = (BLOCK_ROWS * w.len()).max(1);
    let blocks = x.par_chunks(block).zip(y.par_chunks_mut(block));
    for_all(blocks, |(x, y): (&[T], &mut [T])| {
        run_forward::<T>(x, w, b, y)
    });
}

/// Gradients of x, w and b for [`norm_first`]; `parts` is room.
pub(crate) fn norm_first_backward<T: Real>(
    (x, rows, w): (&[T], usize, &[T]),
    g: &[T],
    parts: &mut Vec<T>,
    [dx, dw, db]: [&mut [T]; 3],
) {
    let width = w.len();
    let block = (BLOCK_ROWS * width).max(1);
    let (g, others) = g.split_at(rows * width);
    let (normed, passed) = dx.split_at_mut(rows * width);
    passed.copy_from_slice(others);
    // Each block sums its own part of dw and db; the parts are added in order.
    let parts = fit(parts, 2 * width * g.len().div_ceil(block));
    let blocks = x.par_chunks(block).zip(g.par_chunks(block));
    let blocks = blocks.zip(normed.par_chunks_mut(block));
    let blocks = blocks.zip(parts.par_chunks_mut((2 * width).max(1)));
    type Piece<'a, T> = (((&'a [T], &'a [T]), &'a mut [T]), &'a mut [T]);
    for_all(blocks, |(((x, g), dx), part): Piece<T>| {
        part.fill(T::zero());
        let (dw, db) = part.split_at_mut(width);
        // The last block may have rows that pass beyond it.
        run_backward::<T>(&x[..g.len()], w, g, dx, dw, db);
    });
    dw.fill(T::zero());
    db.fill(T::zero());
    for part in parts.chunks_exact((2 * width).max(1)) {
        add(&part[..width], dw);
        add(&part[width..], db);
    }
}

impl CustomOp3 for LayerNorm {
    fn name(&self) -> &'static str {
        "layer-norm"
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
        let (rows, width) = l1.shape().dims2()?;
        if self.rows > rows {
            candle_core::bail!("layer norm: {rows} rows, expected at least {}", self.rows);
        }
        if l2.shape().elem_count() != width || l3.shape().elem_count() != width {
            candle_core::bail!(
                "layer norm: rows of {width}, weight {:?}, bias {:?}",
                l2.shape(),
                l3.shape()
            );
        }
        by_dtype!(super::dtype_of(s1), T => {
            let x = operand::<T>(s1, l1)?;
            let mut y = vec![<T as num_traits::Zero>::zero(); x.len()];
            let (w, b) = (operand::<T>(s2, l2)?, operand::<T>(s3, l3)?);
            norm_first(x, self.rows, w, b, &mut y);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), l1.shape().clone()))
        })
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _bias: &Tensor,
        _res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        by_dtype!(x.dtype(), T => {
            let zero = <T as num_traits::Zero>::zero();
            let (w, g, input) = (values::<T>(weight)?, values::<T>(grad)?, values::<T>(x)?);
            let (w, g, input): (&[T], &[T], &[T]) = (&w, &g, &input);
            let mut dx = vec![zero; g.len()];
            let (mut dw, mut db) = (vec![zero; w.len()], vec![zero; w.len()]);
            let gradients = [&mut dx[..], &mut dw[..], &mut db[..]];
            norm_first_backward((input, self.rows, w), g, &mut Vec::new(), gradients);
            let device = x.device();
            Ok((
                Some(Tensor::from_vec(dx, x.shape(), device)?),
                Some(Tensor::from_vec(dw, w.len(), device)?),
                Some(Tensor::from_vec(db, w.len(), device)?),
            ))
        })
    }
}

//! Linear layer with bias and optional ReLU: `y = act(x Wᵀ + b)`.
//!
//! `x [rows, in]`, `W [out, in]`, `b [out]`, `y [rows, out]`.
//! Backward, with g masked by y > 0 under ReLU: `dx = g W`, `dW = gᵀ x`, `db = Σ_rows g`.

use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor};

use super::product::{add_rows, fill_rows, mask, multiply_columns, relu, rows_times, transposed};
use super::{Real, by_dtype, for_all, operand, values};

/// Rows of one block of the forward product. Fixed, so that results do not
/// depend on how many threads share the blocks.
const BLOCK_ROWS: usize = 256;
/// Rows of dW of one piece.
const BLOCK_OUT: usize = 64;

/// What follows the affine map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    None,
    /// `max(0, ·)`.
    Relu,
}

/// `act(x Wᵀ + b)`.
///
/// # Errors
/// Shapes that do not fit, or a type other than f32 and f64.
pub fn linear(
    x: &Tensor,
    weight: &Tensor,
    bias: &Tensor,
    activation: Activation,
) -> Result<Tensor> {
    x.contiguous()?.apply_op3(
        &weight.contiguous()?,
        &bias.contiguous()?,
        Linear { activation },
    )
}

/// `x Wᵀ`.
///
/// # Errors
/// As [`linear`].
pub fn product(x: &Tensor, weight: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op2(
        &weight.contiguous()?,
        Linear {
            activation: Activation::None,
        },
    )
}

struct Linear {
    activation: Activation,
}

fn sizes(x: &Layout, weight: &Layout) -> Result<(usize, usize, usize)> {
    let (rows, inner) = x.shape().dims2()?;
    let (out, inner_w) = weight.shape().dims2()?;
    if inner != inner_w {
        candle_core::bail!(
            "linear: x is [{rows}, {inner}], weight [{out}, {inner_w}]: expected equal widths"
        );
    }
    Ok((rows, inner, out))
}

fn forward<T: Real>(
    x: &[T],
    weight: &[T],
    bias: Option<&[T]>,
    (rows, inner, out): (usize, usize, usize),
    activation: Activation,
) -> Vec<T> {
    let mut y = vec![T::zero(); rows * out];
    if y.is_empty() {
        return y;
    }
    let transposed = transposed(weight, inner);
    let x = x.chunks(BLOCK_ROWS * inner);
    let blocks = x.zip(y.chunks_mut(BLOCK_ROWS * out)).collect();
    for_all(blocks, |(x, y): (&[T], &mut [T])| {
        if let Some(bias) = bias {
            fill_rows(bias, y);
        }
        rows_times(x, &transposed, out, y, bias.is_some());
        if activation == Activation::Relu {
            relu(y);
        }
    });
    y
}

/// Gradient and output of some rows, and the place for their input's gradient.
type Piece<'a, T> = ((&'a mut [T], &'a [T]), Option<&'a mut [T]>);
type Gradients = (Option<Tensor>, Option<Tensor>, Option<Tensor>);

fn backward<T: Real>(
    activation: Activation,
    x: &Tensor,
    weight: &Tensor,
    res: &Tensor,
    grad: &Tensor,
    with_bias: bool,
) -> Result<Gradients> {
    let ((rows, inner), out) = (x.dims2()?, weight.dim(0)?);
    let mut g = values::<T>(grad)?.to_vec();
    let (y, w, input) = (values::<T>(res)?, values::<T>(weight)?, values::<T>(x)?);
    let (y, w, input): (&[T], &[T], &[T]) = (&y, &w, &input);
    let mut dx = vec![T::zero(); if x.track_op() { rows * inner } else { 0 }];
    if out > 0 && inner > 0 {
        let mut parts = dx.chunks_mut(BLOCK_ROWS * inner);
        let g = g.chunks_mut(BLOCK_ROWS * out);
        let blocks = g.zip(y.chunks(BLOCK_ROWS * out));
        let blocks = blocks.map(|block| (block, parts.next())).collect();
        for_all(blocks, |((g, y), dx): Piece<T>| {
            if activation == Activation::Relu {
                mask(y, g);
            }
            if let Some(dx) = dx {
                rows_times(g, w, inner, dx, false);
            }
        });
    }
    let device = x.device();
    let dw = if weight.track_op() {
        let g: &[T] = &g;
        let mut dw = vec![T::zero(); out * inner];
        // Each piece makes rows of dW, over all rows of x in one product.
        let pieces = dw
            .chunks_mut((BLOCK_OUT * inner).max(1))
            .enumerate()
            .collect();
        for_all(pieces, |(piece, dw): (usize, &mut [T])| {
            let first = piece * BLOCK_OUT;
            let count = dw.len() / inner;
            multiply_columns(g, (first, count, out), input, inner, dw);
        });
        Some(Tensor::from_vec(dw, (out, inner), device)?)
    } else {
        None
    };
    let dx = match x.track_op() {
        true => Some(Tensor::from_vec(dx, (rows, inner), device)?),
        false => None,
    };
    let db = if with_bias {
        let mut db = vec![T::zero(); out];
        add_rows(&g, &mut db);
        Some(Tensor::from_vec(db, out, device)?)
    } else {
        None
    };
    Ok((dx, dw, db))
}

impl CustomOp3 for Linear {
    fn name(&self) -> &'static str {
        "linear"
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
        let (rows, inner, out) = sizes(l1, l2)?;
        if l3.shape().elem_count() != out {
            candle_core::bail!(
                "linear: bias has {} entries, expected {out}",
                l3.shape().elem_count()
            );
        }
        by_dtype!(super::dtype_of(s1), T => {
            let (x, w, b) = (operand::<T>(s1, l1)?, operand::<T>(s2, l2)?, operand::<T>(s3, l3)?);
            let y = forward::<T>(x, w, Some(b), (rows, inner, out), self.activation);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), (rows, out).into()))
        })
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _bias: &Tensor,
        res: &Tensor,
        grad: &Tensor,
    ) -> Result<Gradients> {
        by_dtype!(x.dtype(), T => backward::<T>(self.activation, x, weight, res, grad, true))
    }
}

impl CustomOp2 for Linear {
    fn name(&self) -> &'static str {
        "product"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (rows, inner, out) = sizes(l1, l2)?;
        by_dtype!(super::dtype_of(s1), T => {
            let y = forward::<T>(operand(s1, l1)?, operand(s2, l2)?, None, (rows, inner, out), self.activation);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), (rows, out).into()))
        })
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        by_dtype!(x.dtype(), T => {
            let (dx, dw, _) = backward::<T>(self.activation, x, weight, res, grad, false)?;
            Ok((dx, dw))
        })
    }
}

//! Linear layer with bias and optional ReLU: `y = act(x Wᵀ + b)`.
//!
//! `x [rows, in]`, `W [out, in]`, `b [out]`, `y [rows, out]`.
//! Backward, with g masked by y > 0 under ReLU: `dx = g W`, `dW = gᵀ x`, `db = Σ_rows g`.

use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

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

/// The layer's rows into `y`, with `Wᵀ [in, out]`.
pub(crate) fn affine_rows<T: Real>(
    x: &[T],
    transposed: &[T],
    bias: Option<&[T]>,
    inner: usize,
    activation: Activation,
    y: &mut [T],
) {
    if y.is_empty() {
        return;
    }
    let out = transposed.len() / inner;
    let blocks = (x.par_chunks(BLOCK_ROWS * inner)).zip(y.par_chunks_mut(BLOCK_ROWS * out));
    for_all(blocks, |(x, y): (&[T], &mut [T])| {
        if let Some(bias) = bias {
            fill_rows(bias, y);
        }
        rows_times(x, transposed, out, y, bias.is_some());
        if activation == Activation::Relu {
            relu(y);
        }
    });
}

fn forward<T: Real>(
    x: &[T],
    weight: &[T],
    bias: Option<&[T]>,
    (rows, inner, out): (usize, usize, usize),
    activation: Activation,
) -> Vec<T> {
    let mut y = vec![T::zero(); rows * out];
    if !y.is_empty() {
        let transposed = transposed(weight, inner);
        affine_rows(x, &transposed, bias, inner, activation, &mut y);
    }
    y
}

/// What goes into a layer, its weight `W [out, in]`, and what comes out.
pub(crate) struct Passed<'a, T> {
    pub(crate) x: &'a [T],
    pub(crate) weight: &'a [T],
    pub(crate) y: &'a [T],
    /// Width of a row of x, and of y.
    pub(crate) inner: usize,
    pub(crate) out: usize,
    pub(crate) activation: Activation,
}

impl<T: Real> Passed<'_, T> {
    /// From the gradient of y, which is masked, those of W and, where they are asked for, of x and b.
    pub(crate) fn backward(
        &self,
        g: &mut [T],
        dx: Option<&mut [T]>,
        dw: Option<&mut [T]>,
        db: Option<&mut [T]>,
    ) {
        let Self { inner, out, .. } = *self;
        if self.activation == Activation::Relu && out > 0 {
            let blocks = g.par_chunks_mut(BLOCK_ROWS * out);
            let blocks = blocks.zip(self.y.par_chunks(BLOCK_ROWS * out));
            for_all(blocks, |(g, y): (&mut [T], &[T])| mask(y, g));
        }
        let g = &*g;
        if let Some(dx) = dx.filter(|dx| !dx.is_empty()) {
            if out == 0 {
                dx.fill(T::zero());
            } else {
                let blocks = g.par_chunks(BLOCK_ROWS * out);
                let blocks = blocks.zip(dx.par_chunks_mut(BLOCK_ROWS * inner));
                for_all(blocks, |(g, dx): (&[T], &mut [T])| {
                    rows_times(g, self.weight, inner, dx, false);
                });
            }
        }
        if let Some(dw) = dw.filter(|dw| !dw.is_empty()) {
            // Each piece makes rows of dW, over all rows of x in one product.
            let pieces = dw.par_chunks_mut(BLOCK_OUT * inner).enumerate();
            for_all(pieces, |(piece, dw): (usize, &mut [T])| {
                let rows = (piece * BLOCK_OUT, dw.len() / inner, out);
                multiply_columns(g, rows, self.x, inner, dw);
            });
        }
        if let Some(db) = db.filter(|db| !db.is_empty()) {
            db.fill(T::zero());
            add_rows(g, db);
        }
    }
}

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
    let passed = Passed {
        x: &input,
        weight: &w,
        y: &y,
        inner,
        out,
        activation,
    };
    let zeros = |wanted: bool, len: usize| wanted.then(|| vec![T::zero(); len]);
    let mut dx = zeros(x.track_op(), rows * inner);
    let mut dw = zeros(weight.track_op(), out * inner);
    let mut db = zeros(with_bias, out);
    passed.backward(
        &mut g,
        dx.as_deref_mut(),
        dw.as_deref_mut(),
        db.as_deref_mut(),
    );
    let tensor = |values: Option<Vec<T>>, shape: Shape| {
        let made = values.map(|values| Tensor::from_vec(values, shape, x.device()));
        made.transpose()
    };
    Ok((
        tensor(dx, (rows, inner).into())?,
        tensor(dw, (out, inner).into())?,
        tensor(db, out.into())?,
    ))
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

//! Linear layer with bias and optional ReLU: `y = act(x Wᵀ + b)`.
//!
//! `x [rows, in]`, `W [out, in]`, `b [out]`, `y [rows, out]`.
//! Backward, with g masked by y > 0 under ReLU: `dx = g W`, `dW = gᵀ x`, `db = Σ_rows g`.

use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor};
use gemm::Parallelism;
use rayon::prelude::*;

use super::{Real, by_dtype, operand, values};

/// Rows of one block of the forward product. Fixed, so that results do not
/// depend on how many threads share the blocks.
const BLOCK_ROWS: usize = 256;

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

/// `dst[m, n] = dst·keep + a·b` for matrices given by (column stride, row stride).
#[allow(clippy::too_many_arguments)]
pub(super) fn multiply<T: Real>(
    m: usize,
    n: usize,
    k: usize,
    dst: &mut [T],
    keep: bool,
    (a, a_col, a_row): (&[T], usize, usize),
    (b, b_col, b_row): (&[T], usize, usize),
) {
    assert_eq!(dst.len(), m * n);
    assert!(a.len() == m * k && b.len() == k * n);
    if m == 0 || n == 0 {
        return;
    }
    // SAFETY: the strides address exactly the lengths asserted above, and `dst` is borrowed mutably.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            dst.as_mut_ptr(),
            1,
            n as isize,
            keep,
            a.as_ptr(),
            a_col as isize,
            a_row as isize,
            b.as_ptr(),
            b_col as isize,
            b_row as isize,
            T::one(),
            T::one(),
            false,
            false,
            false,
            Parallelism::None,
        );
    }
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
    // Rows start as the bias, which the product is added to.
    let mut y = match bias {
        Some(bias) => bias.repeat(rows),
        None => vec![T::zero(); rows * out],
    };
    let block = |(x, y): (&[T], &mut [T])| {
        multiply(
            y.len() / out,
            out,
            inner,
            y,
            bias.is_some(),
            (x, 1, inner),
            (weight, inner, 1),
        );
        if activation == Activation::Relu {
            for value in y {
                // A NaN passes.
                *value = if *value < T::zero() {
                    T::zero()
                } else {
                    *value
                };
            }
        }
    };
    let blocks = (
        x.chunks(BLOCK_ROWS * inner.max(1)),
        y.chunks_mut(BLOCK_ROWS * out.max(1)),
    );
    if rows <= BLOCK_ROWS || rayon::current_thread_index().is_some() {
        blocks.0.zip(blocks.1).for_each(block);
    } else {
        x.par_chunks(BLOCK_ROWS * inner)
            .zip(y.par_chunks_mut(BLOCK_ROWS * out))
            .for_each(block);
    }
    y
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
    let grad = values::<T>(grad)?;
    let masked: Vec<T>;
    let g: &[T] = if activation == Activation::Relu {
        let y = values::<T>(res)?;
        masked = grad
            .iter()
            .zip(y.iter())
            .map(|(&g, &y)| if y > T::zero() { g } else { T::zero() })
            .collect();
        &masked
    } else {
        &grad
    };
    let device = x.device();
    let dx = if x.track_op() {
        let w = values::<T>(weight)?;
        let mut dx = vec![T::zero(); rows * inner];
        multiply(
            rows,
            inner,
            out,
            &mut dx,
            false,
            (g, 1, out),
            (&w, 1, inner),
        );
        Some(Tensor::from_vec(dx, (rows, inner), device)?)
    } else {
        None
    };
    let dw = if weight.track_op() {
        let x = values::<T>(x)?;
        let mut dw = vec![T::zero(); out * inner];
        multiply(
            out,
            inner,
            rows,
            &mut dw,
            false,
            (g, out, 1),
            (&x, 1, inner),
        );
        Some(Tensor::from_vec(dw, (out, inner), device)?)
    } else {
        None
    };
    let db = if with_bias {
        let mut db = vec![T::zero(); out];
        for row in g.chunks_exact(out) {
            for (sum, value) in db.iter_mut().zip(row) {
                *sum += *value;
            }
        }
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

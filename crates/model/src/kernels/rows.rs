//! Rows of two tensors in a new order: `y_i = [a; b]_{index(i)}`, b's rows counted on from a's.
//!
//! `a [m, width]`, `b [n, width]`, `y [indices, width]`; no row is taken twice. Backward: a row that
//! was taken gets its gradient, one that was not zeros.

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};

use super::{Real, by_dtype, operand, values};

/// Takes the rows; see the module's formula.
///
/// # Errors
/// Widths that differ, an index past the last row or one that comes twice, or a type other than f32
/// and f64.
pub fn take_rows(a: &Tensor, b: &Tensor, index: Vec<u32>) -> Result<Tensor> {
    a.contiguous()?
        .apply_op2(&b.contiguous()?, TakeRows { index })
}

/// The rows of a and b into `y`.
pub(crate) fn take<T: Real>([a, b]: [&[T]; 2], index: &[u32], width: usize, y: &mut [T]) {
    for (&row, y) in index.iter().zip(y.chunks_exact_mut(width.max(1))) {
        let start = row as usize * width;
        let from = match start.checked_sub(a.len()) {
            None => &a[start..],
            Some(start) => &b[start..],
        };
        y.copy_from_slice(&from[..width]);
    }
}

struct TakeRows {
    index: Vec<u32>,
}

impl CustomOp2 for TakeRows {
    fn name(&self) -> &'static str {
        "take-rows"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let ((m, width), (n, width_b)) = (l1.shape().dims2()?, l2.shape().dims2()?);
        let mut taken = vec![false; m + n];
        let once = |&row: &u32| {
            let taken = taken.get_mut(row as usize);
            taken.is_some_and(|taken| !std::mem::replace(taken, true))
        };
        if width != width_b || !self.index.iter().all(once) {
            candle_core::bail!(
                "take-rows: inputs [{m}, {width}] and [{n}, {width_b}], expected one width, and \
                 every index once at most and below {}",
                m + n
            );
        }
        by_dtype!(super::dtype_of(s1), T => {
            let (a, b) = (operand::<T>(s1, l1)?, operand::<T>(s2, l2)?);
            let mut y = vec![<T as num_traits::Zero>::zero(); self.index.len() * width];
            take([a, b], &self.index, width, &mut y);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), (self.index.len(), width).into()))
        })
    }

    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        _res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let width = a.dim(1)?;
        by_dtype!(a.dtype(), T => {
            let g = values::<T>(grad)?;
            let [mut da, mut db] =
                [a, b].map(|input| vec![<T as num_traits::Zero>::zero(); input.elem_count()]);
            for (&row, g) in self.index.iter().zip(g.chunks_exact(width.max(1))) {
                let start = row as usize * width;
                let to = match start.checked_sub(da.len()) {
                    None => &mut da[start..],
                    Some(start) => &mut db[start..],
                };
                to[..width].copy_from_slice(g);
            }
            Ok((
                Some(Tensor::from_vec(da, a.shape(), a.device())?),
                Some(Tensor::from_vec(db, b.shape(), b.device())?),
            ))
        })
    }
}

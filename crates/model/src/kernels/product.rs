//! Matrix products on slices, row-major: the inside of the other kernels.
//!
//! A layer's weight is `W [out, in]`, its transpose `Wᵀ [in, out]` is kept beside it:
//! products are fastest when the right factor's rows are contiguous, which is Wᵀ
//! forward (`y = x Wᵀ`) and W backward (`dx = g W`).

use gemm::Parallelism;

use super::{Real, simd_dispatch};

/// `dst[m, n] = dst·keep + a·b` for matrices given by (column stride, row stride).
///
/// # Panics
/// If the strides lead beyond a matrix's values.
#[allow(clippy::too_many_arguments)]
fn multiply<T: Real>(
    m: usize,
    n: usize,
    k: usize,
    dst: &mut [T],
    keep: bool,
    (a, a_col, a_row): (&[T], usize, usize),
    (b, b_col, b_row): (&[T], usize, usize),
) {
    assert_eq!(dst.len(), m * n);
    if m == 0 || n == 0 {
        return;
    }
    let reach = |rows: usize, columns: usize, row: usize, column: usize| match rows * columns {
        0 => 0,
        _ => (rows - 1) * row + (columns - 1) * column + 1,
    };
    assert!(a.len() >= reach(m, k, a_row, a_col) && b.len() >= reach(k, n, b_row, b_col));
    // SAFETY: the strides stay within the lengths asserted above, and `dst` is borrowed mutably.
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

/// `dst [rows, out] = dst·keep + x [rows, in] · m [in, out]`.
pub(super) fn rows_times<T: Real>(x: &[T], m: &[T], out: usize, dst: &mut [T], keep: bool) {
    let (rows, inner) = (dst.len() / out, m.len() / out);
    multiply(rows, out, inner, dst, keep, (x, 1, inner), (m, 1, out));
}

/// `dw [out, in] += gᵀ x` for `g [rows, out]`, `x [rows, in]`.
pub(super) fn add_outer<T: Real>(g: &[T], x: &[T], inner: usize, dw: &mut [T]) {
    let out = dw.len() / inner;
    let rows = x.len() / inner;
    multiply(out, inner, rows, dw, true, (g, out, 1), (x, 1, inner));
}

/// Rows `first..first + count` of `gᵀ x`, for `g [rows, out]` and `x [rows, in]`: `dw [count, in]`.
pub(super) fn multiply_columns<T: Real>(
    g: &[T],
    (first, count, out): (usize, usize, usize),
    x: &[T],
    inner: usize,
    dw: &mut [T],
) {
    let rows = g.len() / out;
    let g = g.get(first..).unwrap_or_default();
    multiply(count, inner, rows, dw, false, (g, out, 1), (x, 1, inner));
}

/// `to = wᵀ` for `w [out, in]`.
pub(super) fn transpose<T: Real>(w: &[T], inner: usize, to: &mut [T]) {
    let out = w.len() / inner;
    // In squares that stay in the cache.
    const SIDE: usize = 16;
    for row in (0..out).step_by(SIDE) {
        for column in (0..inner).step_by(SIDE) {
            for i in row..out.min(row + SIDE) {
                for j in column..inner.min(column + SIDE) {
                    to[j * out + i] = w[i * inner + j];
                }
            }
        }
    }
}

/// `wᵀ` for `w [out, in]`.
pub(super) fn transposed<T: Real>(w: &[T], inner: usize) -> Vec<T> {
    let mut to = vec![T::zero(); w.len()];
    transpose(w, inner, &mut to);
    to
}

/// Rows become copies of the bias, which a product is added to.
#[inline(always)]
fn fill_rows_inner<T: Real>(bias: &[T], rows: &mut [T]) {
    for row in rows.chunks_exact_mut(bias.len()) {
        row.copy_from_slice(bias);
    }
}

/// max(0, ·); a NaN passes.
#[inline(always)]
fn relu_inner<T: Real>(values: &mut [T]) {
    for value in values {
        *value = if *value < T::zero() {
            T::zero()
        } else {
            *value
        };
    }
}

#[inline(always)]
fn mask_inner<T: Real>(y: &[T], g: &mut [T]) {
    for (&y, g) in y.iter().zip(g) {
        *g = if y > T::zero() { *g } else { T::zero() };
    }
}

#[inline(always)]
fn add_rows_inner<T: Real>(rows: &[T], sum: &mut [T]) {
    for row in rows.chunks_exact(sum.len()) {
        for (sum, &value) in sum.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

#[inline(always)]
fn add_inner<T: Real>(x: &[T], to: &mut [T]) {
    for (to, &x) in to.iter_mut().zip(x) {
        *to += x;
    }
}

#[inline(always)]
fn sum_inner<T: Real>(x: &[T], y: &[T], out: &mut [T]) {
    for ((out, &x), &y) in out.iter_mut().zip(x).zip(y) {
        *out = x + y;
    }
}

simd_dispatch! {
    /// Rows become copies of `bias`.
    pub(super) fn fill_rows => fill_rows_inner<T>(bias: &[T], rows: &mut [T])
}
simd_dispatch! {
    /// max(0, ·) in place; a NaN passes.
    pub(super) fn relu => relu_inner<T>(values: &mut [T])
}
simd_dispatch! {
    /// Zeroes gradients where the layer's output is not positive.
    pub(super) fn mask => mask_inner<T>(y: &[T], g: &mut [T])
}
simd_dispatch! {
    /// Adds every row to `sum`.
    pub(super) fn add_rows => add_rows_inner<T>(rows: &[T], sum: &mut [T])
}
simd_dispatch! {
    /// `to += x`.
    pub(crate) fn add => add_inner<T>(x: &[T], to: &mut [T])
}
simd_dispatch! {
    /// `out = x + y`.
    pub(super) fn sum => sum_inner<T>(x: &[T], y: &[T], out: &mut [T])
}

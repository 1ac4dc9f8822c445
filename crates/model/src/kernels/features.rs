//! The decoder's rows, put together: `y_i = [h_i | F_i a_{p(i)} | F_i b_{q(i)}]`.
//!
//! `a [patches, 3]` and `b [body rows, 3]` are what patches and body vertices pass on, h_i
//! twelve constants (a state relative to another) and F_i a frame's rows; a row that nobody on
//! the body passes anything to has zeros there. `y [rows, 18]`. Backward:
//! `da_j = Σ_{p(i)=j} F_iᵀ g_i`, and so for b, summed in the order of i.

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::{Real, by_dtype, for_all, operand, values};

/// Constants of a row, and numbers of a row.
const STATE: usize = 12;
pub(crate) const WIDTH: usize = STATE + 6;
/// Rows of one piece.
const BLOCK_ROWS: usize = 256;

/// Constants of one row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeatureRow {
    /// h.
    pub state: [f32; STATE],
    /// F, rows.
    pub frame: [[f32; 3]; 3],
    /// Row of a.
    pub patch: u32,
    /// Row of b.
    pub body: Option<u32>,
}

/// Puts the rows together; see the module's formula.
///
/// # Errors
/// An index past the last row, or a type other than f32 and f64.
pub fn features(patches: &Tensor, body: &Tensor, rows: Vec<FeatureRow>) -> Result<Tensor> {
    patches
        .contiguous()?
        .apply_op2(&body.contiguous()?, Features { rows })
}

struct Features {
    rows: Vec<FeatureRow>,
}

#[inline(always)]
fn turned<T: Real>(frame: &[[f32; 3]; 3], v: &[T]) -> [T; 3] {
    frame.map(|row| {
        let [x, y, z] = row.map(|value| T::of(f64::from(value)));
        x * v[0] + y * v[1] + z * v[2]
    })
}

fn add_turned_back<T: Real>(frame: &[[f32; 3]; 3], g: &[T], d: &mut [T]) {
    for (row, &g) in frame.iter().zip(g) {
        for axis in 0..3 {
            d[axis] += T::of(f64::from(row[axis])) * g;
        }
    }
}

/// The rows into `y`.
pub(crate) fn put_together<T: Real>(rows: &[FeatureRow], patches: &[T], body: &[T], y: &mut [T]) {
    let pieces = (rows.par_chunks(BLOCK_ROWS)).zip(y.par_chunks_mut(BLOCK_ROWS * WIDTH));
    for_all(pieces, |(rows, y): (&[FeatureRow], &mut [T])| {
        for (row, y) in rows.iter().zip(y.chunks_exact_mut(WIDTH)) {
            for (y, &h) in y.iter_mut().zip(&row.state) {
                *y = T::of(f64::from(h));
            }
            let from = &patches[3 * row.patch as usize..][..3];
            y[STATE..STATE + 3].copy_from_slice(&turned(&row.frame, from));
            match row.body {
                Some(vertex) => {
                    let from = &body[3 * vertex as usize..][..3];
                    y[STATE + 3..].copy_from_slice(&turned(&row.frame, from));
                }
                None => y[STATE + 3..].fill(T::zero()),
            }
        }
    });
}

/// Adds the gradients of a and b that belong to the rows' gradient.
pub(crate) fn take_apart<T: Real>(
    rows: &[FeatureRow],
    g: &[T],
    d_patches: &mut [T],
    d_body: &mut [T],
) {
    for (row, g) in rows.iter().zip(g.chunks_exact(WIDTH)) {
        let to = &mut d_patches[3 * row.patch as usize..][..3];
        add_turned_back(&row.frame, &g[STATE..STATE + 3], to);
        if let Some(vertex) = row.body {
            let to = &mut d_body[3 * vertex as usize..][..3];
            add_turned_back(&row.frame, &g[STATE + 3..], to);
        }
    }
}

impl CustomOp2 for Features {
    fn name(&self) -> &'static str {
        "decoder-rows"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let ((patches, three), (body, width)) = (l1.shape().dims2()?, l2.shape().dims2()?);
        let beyond = |row: &FeatureRow| {
            row.patch as usize >= patches || row.body.is_some_and(|row| row as usize >= body)
        };
        if three != 3 || width != 3 || self.rows.iter().any(beyond) {
            candle_core::bail!(
                "decoder-rows: inputs [{patches}, {three}] and [{body}, {width}], expected width 3 \
                 and every index below the number of rows"
            );
        }
        by_dtype!(super::dtype_of(s1), T => {
            let mut y = vec![<T as num_traits::Zero>::zero(); self.rows.len() * WIDTH];
            put_together::<T>(&self.rows, operand(s1, l1)?, operand(s2, l2)?, &mut y);
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), (self.rows.len(), WIDTH).into()))
        })
    }

    fn bwd(
        &self,
        patches: &Tensor,
        body: &Tensor,
        _res: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        by_dtype!(patches.dtype(), T => {
            let g = values::<T>(grad)?;
            let [mut d_patches, mut d_body] = [patches, body]
                .map(|input| vec![<T as num_traits::Zero>::zero(); input.elem_count()]);
            take_apart(&self.rows, &g, &mut d_patches, &mut d_body);
            let device = patches.device();
            Ok((
                Some(Tensor::from_vec(d_patches, patches.shape(), device)?),
                Some(Tensor::from_vec(d_body, body.shape(), device)?),
            ))
        })
    }
}

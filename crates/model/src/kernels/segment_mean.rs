//! Means over consecutive rows: `y_i = Σ_{j in segment i} x_j / (n_i + 1e-7)`.
//!
//! `x [rows, width]`, `y [segments, width]`; segment i is the rows
//! `offsets[i]..offsets[i+1]`. An empty segment gives 0.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};

use super::{Real, by_dtype, operand, values};

const EPSILON: f64 = 1e-7;

/// Means of consecutive rows; `offsets` has one entry more than segments.
///
/// # Errors
/// Offsets that do not ascend from 0 to the number of rows, or a type other than f32 and f64.
pub fn segment_mean(x: &Tensor, offsets: Vec<u32>) -> Result<Tensor> {
    x.contiguous()?.apply_op1(SegmentMean { offsets })
}

struct SegmentMean {
    offsets: Vec<u32>,
}

impl SegmentMean {
    fn segments(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        self.offsets
            .windows(2)
            .map(|two| two[0] as usize..two[1] as usize)
    }
}

impl CustomOp1 for SegmentMean {
    fn name(&self) -> &'static str {
        "segment-mean"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rows, width) = layout.shape().dims2()?;
        if self.offsets.first() != Some(&0) || !self.offsets.is_sorted() {
            candle_core::bail!(
                "segment-mean: offsets {:?}, expected them to start at 0 and ascend",
                self.offsets
            );
        }
        if self.offsets.last().map(|&last| last as usize) != Some(rows) {
            candle_core::bail!(
                "segment-mean: {rows} rows, offsets end at {:?}",
                self.offsets.last()
            );
        }
        by_dtype!(super::dtype_of(storage), T => {
            let x = operand::<T>(storage, layout)?;
            let mut y = vec![<T as num_traits::Zero>::zero(); (self.offsets.len() - 1) * width];
            for (segment, y) in self.segments().zip(y.chunks_exact_mut(width)) {
                let scale = <T as Real>::of(1.0 / (segment.len() as f64 + EPSILON));
                for row in x[segment.start * width..segment.end * width].chunks_exact(width) {
                    for (sum, &value) in y.iter_mut().zip(row) {
                        *sum += value;
                    }
                }
                y.iter_mut().for_each(|value| *value *= scale);
            }
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), (self.offsets.len() - 1, width).into()))
        })
    }

    fn bwd(&self, arg: &Tensor, _res: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        by_dtype!(arg.dtype(), T => {
            let (g, width) = (values::<T>(grad)?, arg.dim(1)?);
            let mut dx = Vec::with_capacity(arg.elem_count());
            for (segment, g) in self.segments().zip(g.chunks_exact(width)) {
                let scale = <T as Real>::of(1.0 / (segment.len() as f64 + EPSILON));
                for _ in segment {
                    dx.extend(g.iter().map(|&value| value * scale));
                }
            }
            Ok(Some(Tensor::from_vec(dx, arg.shape(), arg.device())?))
        })
    }
}

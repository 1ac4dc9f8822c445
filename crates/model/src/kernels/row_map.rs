//! A fixed affine map of 3-vectors per row: `y_i = A_i x_{index(i)} + c_i`.
//!
//! `x [rows, 3]`, `y [maps, 3]`; A, c and the index are constants. It rotates
//! what a patch passes to its vertices into their frames and turns decoder
//! outputs back into world accelerations. Backward: `dx_j = Σ_{index(i)=j} A_iᵀ g_i`,
//! summed in the order of i.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};

use super::{Real, by_dtype, operand, values};

/// One row's map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowMap {
    /// Row of the input.
    pub index: u32,
    /// Matrix, rows.
    pub matrix: [[f32; 3]; 3],
    /// Constant added.
    pub offset: [f32; 3],
}

impl RowMap {
    /// `d += Aᵀ g`.
    pub(crate) fn add_back<T: Real>(&self, g: &[T], d: &mut [T]) {
        for (row, &g) in self.matrix.iter().zip(g) {
            for axis in 0..3 {
                d[axis] += T::of(f64::from(row[axis])) * g;
            }
        }
    }

    /// `A v + c`.
    pub(crate) fn apply<T: Real>(&self, v: &[T]) -> [T; 3] {
        [0, 1, 2].map(|axis| {
            let [a, b, d] = self.matrix[axis].map(|value| T::of(f64::from(value)));
            a * v[0] + b * v[1] + d * v[2] + T::of(f64::from(self.offset[axis]))
        })
    }
}

/// Applies the maps; see the module's formula.
///
/// # Errors
/// An index past the last row, or a type other than f32 and f64.
pub fn map_rows(x: &Tensor, maps: Vec<RowMap>) -> Result<Tensor> {
    x.contiguous()?.apply_op1(MapRows { maps })
}

struct MapRows {
    maps: Vec<RowMap>,
}

impl CustomOp1 for MapRows {
    fn name(&self) -> &'static str {
        "map-rows"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rows, width) = layout.shape().dims2()?;
        if width != 3 || self.maps.iter().any(|map| map.index as usize >= rows) {
            candle_core::bail!(
                "map-rows: input [{rows}, {width}], expected width 3 and every index below {rows}"
            );
        }
        by_dtype!(super::dtype_of(storage), T => {
            let x = operand::<T>(storage, layout)?;
            let mut y = vec![<T as num_traits::Zero>::zero(); self.maps.len() * 3];
            for (map, y) in self.maps.iter().zip(y.chunks_exact_mut(3)) {
                y.copy_from_slice(&map.apply(&x[3 * map.index as usize..][..3]));
            }
            Ok((<T as candle_core::WithDType>::to_cpu_storage_owned(y), (self.maps.len(), 3).into()))
        })
    }

    fn bwd(&self, arg: &Tensor, _res: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        by_dtype!(arg.dtype(), T => {
            let g = values::<T>(grad)?;
            let mut dx = vec![<T as num_traits::Zero>::zero(); arg.elem_count()];
            for (map, g) in self.maps.iter().zip(g.chunks_exact(3)) {
                map.add_back(g, &mut dx[3 * map.index as usize..][..3]);
            }
            Ok(Some(Tensor::from_vec(dx, arg.shape(), arg.device())?))
        })
    }
}

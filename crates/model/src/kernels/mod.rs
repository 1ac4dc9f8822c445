//! Fused operations with hand-written backward passes, as candle custom ops.
//!
//! candle's stock layer norm and softmax return no gradient, and gathering
//! attention from stock ops costs ten times the time. Each kernel file states its
//! formula, works in f32 and f64 (finite differences are checked in f64), and
//! is serial inside: training runs samples in parallel, inference splits rows
//! into fixed chunks, so results do not depend on the number of threads.

pub mod attention;
pub mod blocks;
pub mod decoder;
pub mod layer_norm;
pub mod linear;
mod product;
pub mod row_map;

use candle_core::{CpuStorage, Layout, Result, Tensor, WithDType};
use rayon::prelude::*;

/// Does independent pieces of work: in parallel, unless this thread already is one of a
/// pool's (training then runs samples side by side). What a piece computes must not depend
/// on who does it.
pub(crate) fn for_all<I: Send>(pieces: Vec<I>, work: impl Fn(I) + Send + Sync) {
    if rayon::current_thread_index().is_some() {
        pieces.into_iter().for_each(work);
    } else {
        pieces.into_par_iter().for_each(work);
    }
}

/// Scalars the kernels run in.
pub trait Real:
    WithDType + num_traits::Float + Default + Send + Sync + std::ops::AddAssign + 'static
{
    /// Converts a constant.
    fn of(value: f64) -> Self;
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
}

/// The values of a contiguous operand.
pub(crate) fn operand<'a, T: Real>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [T]> {
    let values = storage.as_slice::<T>()?;
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&values[start..end]),
        None => candle_core::bail!(
            "kernel operand of shape {:?} is not contiguous",
            layout.shape()
        ),
    }
}

/// Element type of a storage.
pub(crate) fn dtype_of(storage: &CpuStorage) -> candle_core::DType {
    candle_core::backend::BackendStorage::dtype(storage)
}

/// A tensor's values in row-major order, borrowed where they are contiguous.
pub(crate) enum Values<'a, T> {
    /// Borrowed from the tensor's storage.
    Borrowed(
        Box<dyn std::ops::Deref<Target = candle_core::Storage> + 'a>,
        std::ops::Range<usize>,
        std::marker::PhantomData<T>,
    ),
    /// Copied into order.
    Owned(Vec<T>),
}

impl<T: Real> std::ops::Deref for Values<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match self {
            Self::Owned(values) => values,
            Self::Borrowed(storage, range, _) => match &***storage {
                candle_core::Storage::Cpu(storage) => &storage
                    .as_slice::<T>()
                    .expect("type was checked when borrowing")[range.clone()],
                _ => unreachable!("device was checked when borrowing"),
            },
        }
    }
}

/// The values of a tensor on the CPU.
pub(crate) fn values<T: Real>(tensor: &Tensor) -> Result<Values<'_, T>> {
    if let Some((start, end)) = tensor.layout().contiguous_offsets()
        && tensor.device().is_cpu()
        && tensor.dtype() == T::DTYPE
    {
        let (storage, _) = tensor.storage_and_layout();
        return Ok(Values::Borrowed(
            Box::new(storage),
            start..end,
            std::marker::PhantomData,
        ));
    }
    Ok(Values::Owned(tensor.flatten_all()?.to_vec1::<T>()?))
}

/// Runs `$body` for the element type of `$dtype`, named `$T` inside.
macro_rules! by_dtype {
    ($dtype:expr, $T:ident => $body:expr) => {
        match $dtype {
            candle_core::DType::F32 => {
                type $T = f32;
                $body
            }
            candle_core::DType::F64 => {
                type $T = f64;
                $body
            }
            other => candle_core::bail!("kernels run in f32 or f64, got {other:?}"),
        }
    };
}
pub(crate) use by_dtype;

/// Defines `$name`, which runs the `#[inline(always)]` function `$inner` compiled
/// for the widest vector units found at run time.
macro_rules! simd_dispatch {
    ($(#[$doc:meta])* $vis:vis fn $name:ident => $inner:ident<$T:ident>($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$doc])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name<$T: $crate::kernels::Real>($($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq,avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn wide<$T: $crate::kernels::Real>($($arg: $ty),*) {
                    $inner::<$T>($($arg),*)
                }
                #[target_feature(enable = "avx2,fma")]
                #[allow(clippy::too_many_arguments)]
                fn medium<$T: $crate::kernels::Real>($($arg: $ty),*) {
                    $inner::<$T>($($arg),*)
                }
                if is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                {
                    // SAFETY: the features were detected on this machine.
                    return unsafe { wide::<$T>($($arg),*) };
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    // SAFETY: the features were detected on this machine.
                    return unsafe { medium::<$T>($($arg),*) };
                }
            }
            $inner::<$T>($($arg),*)
        }
    };
}
pub(crate) use simd_dispatch;

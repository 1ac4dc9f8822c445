//! Fused operations with hand-written backward passes.
//!
//! [`LayersNet`](crate::LayersNet) runs them on memory of its own; as candle custom ops, which is
//! how they are checked, they allocate what they return.
//! candle's stock layer norm and softmax return no gradient, and gathering
//! attention from stock ops costs ten times the time. Each kernel file states its
//! formula, works in f32 and f64 (finite differences are checked in f64), and cuts its
//! work into fixed pieces, forward and backward: threads share the pieces where a single
//! sample is at hand, one thread does them all where training runs samples side by side,
//! and results do not depend on which. [`crate::reference`] is the network without them.

pub mod attention;
pub mod blocks;
pub mod decoder;
pub mod features;
pub mod layer_norm;
pub mod linear;
pub(crate) mod product;
pub mod row_map;
pub mod rows;

use std::sync::Mutex;

use candle_core::{CpuStorage, Layout, Result, Tensor, WithDType};
use rayon::prelude::*;

/// [`for_all_with`] without room for work.
pub(crate) fn for_all<I: Send>(
    pieces: impl IndexedParallelIterator<Item = I>,
    work: impl Fn(I) + Send + Sync,
) {
    for_all_with(pieces, |(): &mut (), piece| work(piece));
}

/// Does independent pieces of work: in parallel, unless this thread already is one of a
/// pool's (training then runs samples side by side). What a piece computes must not depend
/// on who does it. Pieces leave room for work to each other, in any state.
pub fn for_all_with<I: Send, R: Default>(
    pieces: impl IndexedParallelIterator<Item = I>,
    work: impl Fn(&mut R, I) + Send + Sync,
) {
    let alone = rayon::current_thread_index().is_some();
    // An iterator that is never cut stays on its thread.
    let least = if alone { usize::MAX } else { 1 };
    pieces
        .with_min_len(least)
        .for_each_init(R::default, |room, piece| work(room, piece));
}

/// An empty list in the memory of one whose items' borrows have ended.
pub(crate) fn recycled<A, B>(mut list: Vec<A>) -> Vec<B> {
    list.clear();
    let none = list.into_iter().map(|_| unreachable!("the list is empty"));
    // Collecting from a list's own iterator stays in its memory.
    none.collect()
}

/// Buffers that are used again: who needs some takes them from the shelf and puts them back.
pub trait Shelved: Default + Send + 'static {
    /// Those that nobody uses at the moment.
    fn shelf() -> &'static Mutex<Vec<Self>>;

    /// Some that nobody uses, or new ones.
    fn take() -> Self {
        let free = Self::shelf().lock().expect("nobody panics with it").pop();
        free.unwrap_or_default()
    }

    /// Leaves them to the next.
    fn put_back(self) {
        let mut shelf = Self::shelf().lock().expect("nobody panics with it");
        shelf.push(self);
    }
}

/// Makes a shelf for buffers of a type.
macro_rules! shelved {
    ($Buffers:ty) => {
        impl $crate::kernels::Shelved for $Buffers {
            fn shelf() -> &'static std::sync::Mutex<Vec<Self>> {
                static SHELF: std::sync::Mutex<Vec<$Buffers>> = std::sync::Mutex::new(Vec::new());
                &SHELF
            }
        }
    };
}
pub(crate) use shelved;

/// Fits a buffer's length; what is in it is to be overwritten.
pub(crate) fn fit<T: Clone + Default>(buffer: &mut Vec<T>, len: usize) -> &mut [T] {
    buffer.resize(len, T::default());
    buffer
}

/// Scalars the kernels run in.
pub trait Real:
    WithDType + num_traits::Float + Default + Send + Sync + std::ops::AddAssign + 'static
{
    /// Converts a constant.
    fn of(value: f64) -> Self;
    /// e^x of x ≤ 0, in a form that vectorises.
    fn exp_of_negative(self) -> Self;
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }

    /// `e^x = 2^n e^y` with n the nearest integer to x log₂e; e^y, |y| ≤ ln 2 / 2, by its series up to
    /// y⁷. Relative error below 2e-7; what is smaller than e^-87 becomes that; a NaN passes.
    #[inline(always)]
    fn exp_of_negative(self) -> Self {
        // Adding it leaves an integer in the low bits.
        const ROUND: f32 = 12_582_912.0;
        // ln 2 in two parts, the first with few digits, so that its multiples are exact.
        const LN2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
        let x = if self < -87.0 { -87.0 } else { self };
        let shifted = x * std::f32::consts::LOG2_E + ROUND;
        let n = shifted - ROUND;
        let y = (x - n * LN2[0]) - n * LN2[1];
        let mut series = 1.0 / 5040.0;
        for factor in [
            1.0 / 720.0,
            1.0 / 120.0,
            1.0 / 24.0,
            1.0 / 6.0,
            0.5,
            1.0,
            1.0,
        ] {
            series = series * y + factor;
        }
        let power = f32::from_bits((shifted.to_bits().wrapping_add(127)) << 23);
        // Written so that a NaN stays one.
        if x <= 0.0 {
            series * power
        } else {
            x * f32::NAN
        }
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }

    fn exp_of_negative(self) -> Self {
        self.exp()
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

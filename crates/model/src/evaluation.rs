//! What the network says about one frame.
//!
//! An [`Evaluation`] holds the frame's buffers and gives them back to the next frame when it is
//! dropped; a [`Prediction`] holds tensors of its own.

use candle_core::{DType, Device, Tensor, WithDType};

use crate::error::Result;
use crate::graph::{FrameGraph, refill};
use crate::kernels::Shelved;
use crate::pass::Pass;

/// What the network says about one frame, in units/frame².
pub struct Prediction {
    /// Acceleration of each vertex, `[N, 3]`: its own patch's plus its own.
    pub acceleration: Tensor,
    /// The vertex's own part of it, `[N, 3]`.
    pub relative: Tensor,
    /// Acceleration of each patch, `[P, 3]`.
    pub patch_acceleration: Tensor,
    /// Patch tokens `[P, 128]` after each block of the reference path; [`crate::LayersNet`] gives
    /// the last only.
    pub blocks: Vec<Tensor>,
    /// The structure it was computed on.
    pub graph: FrameGraph,
    /// Where the time went.
    pub seconds: ForwardSeconds,
}

/// Seconds of the parts of a forward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForwardSeconds {
    /// Neighbours, normals, frames: [`FrameGraph`].
    pub graph: f64,
    /// Encoders, receivers and senders.
    pub encoders: f64,
    /// Transformer blocks.
    pub blocks: f64,
    /// Decoder and integration.
    pub decoder: f64,
}

/// A frame's buffers, of the weights' type.
pub(crate) enum Buffers {
    F32(Box<Pass<f32>>),
    F64(Box<Pass<f64>>),
    /// Given back.
    Gone,
}

/// Runs `$body` for the buffers of either type.
macro_rules! with_pass {
    ($buffers:expr, $pass:ident => $body:expr) => {
        match $buffers {
            $crate::evaluation::Buffers::F32($pass) => $body,
            $crate::evaluation::Buffers::F64($pass) => $body,
            $crate::evaluation::Buffers::Gone => unreachable!("only dropping gives them back"),
        }
    };
}
pub(crate) use with_pass;

/// One evaluated frame; see [`crate::LayersNet::evaluate`].
pub struct Evaluation {
    pub(crate) pass: Buffers,
    /// Where the time went.
    pub seconds: ForwardSeconds,
}

impl Drop for Evaluation {
    fn drop(&mut self) {
        match std::mem::replace(&mut self.pass, Buffers::Gone) {
            Buffers::F32(pass) => pass.put_back(),
            Buffers::F64(pass) => pass.put_back(),
            Buffers::Gone => (),
        }
    }
}

impl Evaluation {
    pub(crate) fn new(dtype: DType) -> Result<Self> {
        let pass = match dtype {
            DType::F32 => Buffers::F32(Shelved::take()),
            DType::F64 => Buffers::F64(Shelved::take()),
            other => Err(candle_core::Error::Msg(format!(
                "kernels run in f32 or f64, got {other:?}"
            )))?,
        };
        Ok(Self {
            pass,
            seconds: ForwardSeconds::default(),
        })
    }

    /// The structure it was computed on.
    pub fn graph(&self) -> &FrameGraph {
        with_pass!(&self.pass, pass => &pass.graph)
    }

    /// Acceleration of each vertex, `[3 N]` in units/frame², into a buffer.
    pub fn accelerations(&self, to: &mut Vec<f32>) {
        with_pass!(&self.pass, pass => narrow(&pass.acceleration, to));
    }

    /// Acceleration of each patch, `[3 P]` in units/frame², into a buffer.
    pub fn patch_accelerations(&self, to: &mut Vec<f32>) {
        with_pass!(&self.pass, pass => narrow(&pass.patch_acceleration, to));
    }

    /// All of it as tensors.
    ///
    /// # Errors
    /// If candle cannot make one.
    pub fn prediction(&self) -> Result<Prediction> {
        with_pass!(&self.pass, pass => {
            let tensor = |values: &[_], width: usize| {
                Tensor::from_slice(values, (values.len() / width, width), &Device::Cpu)
            };
            Ok(Prediction {
                acceleration: tensor(&pass.acceleration, 3)?,
                relative: tensor(&pass.relative, 3)?,
                patch_acceleration: tensor(&pass.patch_acceleration, 3)?,
                blocks: vec![tensor(&pass.embedding, crate::kernels::attention::WIDTH)?],
                graph: pass.graph.clone(),
                seconds: self.seconds,
            })
        })
    }
}

fn narrow<T: WithDType>(values: &[T], to: &mut Vec<f32>) {
    refill(
        to,
        values.iter().map(|&value| WithDType::to_f64(value) as f32),
    );
}

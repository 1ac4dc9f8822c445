//! LayersNet on candle.
//!
//! [`Parameters`] holds named weights, [`ModelConfig`] the choices,
//! [`LayersNet`] evaluates one frame: garment state, body, wind and gravity in,
//! accelerations out. [`FrameGraph`] is the discrete structure of a frame.
//! Losses and training live in `drape-train`; nothing here reads sequence files.

pub mod block;
mod config;
mod error;
mod evaluation;
pub mod frames;
mod graph;
pub mod kernels;
mod layersnet;
pub mod parameters;
mod pass;
pub mod reference;

pub use config::{
    BodyMessages, BodySlots, ForceFrames, FrameAxis, GravitySource, ModelConfig, OutputScale,
};
pub use error::{ModelError, Result};
pub use evaluation::{Evaluation, ForwardSeconds, Prediction};
pub use graph::{Anchor, FrameGraph, Slot};
pub use layersnet::LayersNet;
pub use parameters::Parameters;

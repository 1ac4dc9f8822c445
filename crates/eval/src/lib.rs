//! Honest measuring: rollouts of every method on held-out sequences, metrics in
//! f64 that share no code with the training losses, floors, and one table in
//! which every row carries its time.
//!
//! The pipeline: a [`task::Clip`] is split into what a method may see and what
//! it is measured against; [`method::roll_out`] runs and times a
//! [`method::Method`]; [`metrics`] measures each frame; [`tally`] turns frames
//! into statistics; [`contest`] does so for methods side by side; [`table`] prints
//! and writes them; [`plot`] and [`pictures`] draw.

pub mod contest;
pub mod engine;
pub mod error;
#[cfg(test)]
mod example;
pub mod floors;

pub mod layersnet;
pub mod method;
pub mod metrics;
pub mod nearest;
pub mod pictures;
pub mod plot;
pub mod table;
pub mod tally;
pub mod task;

pub use error::EvalError;

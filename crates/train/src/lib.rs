//! Training of LayersNet.

pub mod adam;
mod error;
pub mod losses;
pub mod step;

pub use error::{Result, TrainError};

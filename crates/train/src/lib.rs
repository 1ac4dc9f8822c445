//! Training of LayersNet: the paper's losses and schedule on any data set of
//! sequences, with run folders that resume bit for bit.
//!
//! [`data`] draws samples, [`step`] does one sample's forward and backward pass,
//! [`trend`] fits what accelerations are predicted around, [`losses`] are the paper's terms, [`trainer`] is the loop, [`run`] the folder.

pub mod adam;
pub mod config;
pub mod curves;
pub mod data;
mod error;
pub mod losses;
pub mod run;
pub mod step;
pub mod sway;
pub mod trainer;
pub mod trend;

pub use error::{Result, TrainError};

//! Placeholder header, replaced by the crate's own.

mod atomic;
mod check;
mod error;
pub mod file;
pub mod import;
pub mod obj;
pub mod panels;
pub mod patches;
pub mod random;
pub mod registry;
pub mod sample;
pub mod sequence;
pub mod splits;
pub mod statistics;

pub use error::{DatasetError, Result};
pub use file::{SequenceReader, SequenceWriter};

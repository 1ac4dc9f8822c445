//! Placeholder header, replaced by the crate's own.

mod check;
mod error;
pub mod file;
pub mod registry;
pub mod sequence;

pub use error::{DatasetError, Result};
pub use file::{SequenceReader, SequenceWriter};

//! Sequences that other programs made, turned into ours.
//!
//! Only what a source really tells is taken over; what had to be estimated or
//! assumed is written into the sequence's warnings.

mod array;
pub mod d_layers;
mod density;
#[cfg(feature = "npz")]
mod npz;
mod pickle;
pub mod smpl;

pub use d_layers::DLayers;
#[cfg(feature = "npz")]
pub use npz::{METRES_PER_UV, import_npz};

use std::path::Path;

use crate::error::Result;
use crate::file::SequenceWriter;
use crate::sequence::{Frame, SequenceHeader};

/// An imported sequence, in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// What is fixed; its warnings tell what was estimated.
    pub header: SequenceHeader,
    /// All frames.
    pub frames: Vec<Frame>,
}

impl Imported {
    /// Writes the sequence to a file.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut writer = SequenceWriter::create(path, &self.header)?;
        for frame in &self.frames {
            writer.push(frame)?;
        }
        writer.finish()
    }
}

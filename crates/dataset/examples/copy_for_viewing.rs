//! A smaller copy of a sequence, for viewing: positions on a grid, the error stated.

use std::error::Error;
use std::fs;

use drape_dataset::file::Storage;
use drape_dataset::{SequenceReader, SequenceWriter};

mod cloth;

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let (exact, copy) = (
        folder.path().join("exact.mcap"),
        folder.path().join("view.mcap"),
    );
    cloth::write(&exact, 300, Storage::Exact)?;

    let source = SequenceReader::open(&exact)?;
    let mut writer = SequenceWriter::create_with(&copy, source.header(), Storage::VIEWING)?;
    for frame in source.frames(0..source.frame_count()) {
        writer.push(&frame?)?;
    }
    writer.finish()?;
    let (before, after) = (fs::metadata(&exact)?.len(), fs::metadata(&copy)?.len());
    println!(
        "{before} bytes, {after} as a copy: {}",
        SequenceReader::open(&copy)?.storage()
    );
    Ok(())
}

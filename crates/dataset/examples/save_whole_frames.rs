//! A file whose end is missing: what the error says, and what can be saved.

use std::error::Error;
use std::fs;

use drape_dataset::SequenceReader;
use drape_dataset::file::{Storage, recover};

mod cloth;

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("cut.mcap");
    cloth::write(&path, 30, Storage::Exact)?;
    let bytes = fs::read(&path)?;
    fs::write(&path, &bytes[..bytes.len() / 2])?;

    let error = SequenceReader::open(&path).expect_err("half a file");
    println!("{error}");
    for saved in recover(&path, folder.path().join("saved.mcap"))? {
        let frames = SequenceReader::open(&saved.path)?.frame_count();
        println!(
            "saved frames {:?}: {frames} in {}",
            saved.frames,
            saved.path.display()
        );
    }
    Ok(())
}

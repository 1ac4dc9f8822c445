//! A sequence file: open it, read any frame, read a window, find damage.

use std::error::Error;

use drape_dataset::SequenceReader;
use drape_dataset::file::Storage;

mod cloth;

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("swing.mcap");
    cloth::write(&path, 30, Storage::Exact)?;

    let sequence = SequenceReader::open(&path)?;
    println!(
        "{}: {} frames",
        sequence.header().name,
        sequence.frame_count()
    );
    println!(
        "frame 17, vertex 2: {:?}",
        sequence.frame(17)?.garments[0][2]
    );
    for frame in sequence.frames(10..13) {
        println!("y of vertex 0: {}", frame?.garments[0][0][1]);
    }
    sequence.check_bytes()?;
    println!("not a bit has changed since it was written");
    Ok(())
}

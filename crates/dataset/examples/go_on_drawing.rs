//! Samples in a shuffled order that is left and taken up again.

use std::error::Error;

use drape_dataset::file::Storage;
use drape_dataset::samples::{SampleOptions, Samples};
use drape_dataset::splits::{DatasetIndex, Split};

mod cloth;

/// Runs the example.
pub fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let mut index = DatasetIndex::new(folder.path(), "two swings");
    for file in ["a.mcap", "b.mcap"] {
        cloth::write(&folder.path().join(file), 12, Storage::Exact)?;
        index.add(file, Split::Train)?;
    }

    let mut samples = Samples::open(&index, Split::Train, SampleOptions::default())?;
    for sample in samples.by_ref().take(5) {
        sample?;
    }
    let progress = samples.order.progress();
    let next = samples.next().expect("endless")?;

    let mut resumed = Samples::open(&index, Split::Train, SampleOptions::default())?;
    resumed.order.resume(progress)?;
    let same = resumed.next().expect("endless")?.state == next.state;
    println!(
        "after {} samples of epoch {}: the same sample {same}",
        progress.drawn, progress.epoch
    );
    assert!(same);
    Ok(())
}

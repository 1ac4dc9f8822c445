//! The synthetic [`Scene`] as files: sequences and small data sets on disk.

use std::path::Path;

use drape_dataset::{
    DatasetError, SequenceWriter,
    splits::{DatasetIndex, Split},
};

use crate::scene::{Scene, SceneConfig};

/// Frames of a sequence.
pub const FRAMES: usize = 16;

/// Writes a data set with sequences of the given splits, `sequence_0`, `sequence_1`, …
///
/// # Errors
/// When the folder cannot be written.
pub fn write_dataset(folder: &Path, splits: &[Split]) -> Result<(), DatasetError> {
    let mut index = DatasetIndex::new(folder, "example");
    for (number, split) in splits.iter().enumerate() {
        let name = format!("sequence_{number}");
        let file = format!("{name}.mcap");
        write_sequence(&folder.join(&file), &name, 1.0 + 0.2 * number as f64)?;
        index.add(file, *split)?;
    }
    index.save()
}

/// Writes one sequence; sequences differ by the strength of their motion.
///
/// # Errors
/// When the file cannot be written.
pub fn write_sequence(path: &Path, name: &str, motion: f64) -> Result<(), DatasetError> {
    write_frames(path, name, motion, FRAMES)
}

/// [`write_sequence`] with another number of frames.
///
/// # Errors
/// As [`write_sequence`].
pub fn write_frames(
    path: &Path,
    name: &str,
    motion: f64,
    frames: usize,
) -> Result<(), DatasetError> {
    let mut scene = Scene::new(SceneConfig {
        motion,
        ..SceneConfig::default()
    });
    scene.header.name = name.to_owned();
    let mut writer = SequenceWriter::create(path, &scene.header)?;
    for frame in scene.frames(frames) {
        writer.push(&frame)?;
    }
    writer.finish()
}

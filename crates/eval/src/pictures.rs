//! Contact sheets of the reference and of predictions of it, below each other.

use drape_dataset::sequence::Frame;
use drape_view::{
    Picture, ViewError,
    sheet::{Clip, SheetOptions, contact_sheet, spread},
};

use crate::task::{Positions, Task};

/// Columns of a sheet.
const COLUMNS: usize = 6;

/// One row of a sheet: a name and `[frame][garment][vertex, 3]` from frame `start + 1` on.
pub struct Strip<'a> {
    /// Name beside the row.
    pub label: &'a str,
    /// Garments of each frame.
    pub frames: &'a [Vec<Positions>],
}

/// Draws strips of one rollout.
///
/// # Errors
/// When a strip does not fit the sequence's meshes.
pub fn sheet(task: &Task, strips: &[Strip]) -> Result<Picture, ViewError> {
    let columns = spread(task.steps, COLUMNS);
    let frames: Vec<Vec<Frame>> = strips
        .iter()
        .map(|strip| {
            columns
                .iter()
                .map(|column| task.frame_with(*column, strip.frames[*column].clone()))
                .collect()
        })
        .collect();
    let clips: Vec<Clip> = strips
        .iter()
        .zip(&frames)
        .map(|(strip, frames)| Clip {
            label: strip.label,
            header: &task.header,
            frames: columns
                .iter()
                .map(|column| task.start + 1 + column)
                .zip(frames)
                .collect(),
        })
        .collect();
    contact_sheet(&clips, &SheetOptions::default())
}

//! Frozen: the garments of the start frame, fixed in the root's moving frame
//! (they move and turn rigidly with the pelvis).

use super::root_frame::{to_root, to_world};
use crate::{
    EvalError,
    method::Method,
    task::{Positions, Task},
};

/// Garments that follow the root rigidly.
#[derive(Default)]
pub struct Frozen {
    local: Vec<Vec<[f64; 3]>>,
}

impl Method for Frozen {
    fn name(&self) -> &str {
        "frozen"
    }

    fn threads(&self) -> usize {
        1
    }

    fn begin(&mut self, task: &Task) -> Result<(), EvalError> {
        let start = &task.frames[task.start];
        self.local = to_root(&start.root, &start.garments);
        Ok(())
    }

    fn step(&mut self, task: &Task, frame: usize) -> Result<Vec<Positions>, EvalError> {
        Ok(to_world(&task.frames[frame].root, &self.local))
    }
}

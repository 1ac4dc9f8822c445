//! Methods side by side on the same rollouts: each [`Entry`] collects what one
//! method predicted and becomes one row of the table.

use crate::{
    EvalError,
    method::{Method, Rollout, roll_out},
    metrics::score_frame,
    table::Row,
    tally::Tally,
    task::{Reference, Task},
};

/// Steps before anything is timed: memory, thread pool and caches warm up.
const WARM_UP_STEPS: usize = 3;

/// One method and what is known about it so far.
pub struct Entry {
    method: Box<dyn Method>,
    tally: Tally,
    /// Median time of a step in each rollout.
    ms: Vec<f64>,
    warm: bool,
    sequences: usize,
    /// Why it could not run on some sequences.
    refusals: Vec<String>,
    /// Why its numbers are worth nothing.
    failure: Option<String>,
}

impl Entry {
    /// A method that has not run yet.
    pub fn new(method: Box<dyn Method>) -> Self {
        Self {
            method,
            tally: Tally::default(),
            ms: Vec::new(),
            warm: false,
            sequences: 0,
            refusals: Vec::new(),
            failure: None,
        }
    }

    /// The method's name.
    pub fn name(&self) -> &str {
        self.method.name()
    }

    /// Lets the method predict and measures it. `None` when it cannot run on this
    /// sequence or predicts something that is not a number; the row says so.
    ///
    /// # Errors
    /// When the method fails otherwise or `after_step` stops.
    pub fn run(
        &mut self,
        task: &Task,
        reference: &Reference,
        after_step: &mut dyn FnMut() -> Result<(), EvalError>,
    ) -> Result<Option<Rollout>, EvalError> {
        match self.try_run(task, after_step) {
            Ok(rollout) => {
                self.sequences += 1;
                self.ms.push(rollout.ms_per_frame());
                add_frames(&mut self.tally, task, &rollout.frames, reference);
                Ok(Some(rollout))
            }
            Err(error @ EvalError::NotApplicable { .. }) => {
                self.refusals.push(error.to_string());
                Ok(None)
            }
            Err(error @ EvalError::NotFinite { .. }) => {
                self.failure.get_or_insert(error.to_string());
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// The method's row; notes about it are added to `notes`.
    pub fn row(&self, notes: &mut Vec<String>) -> Row {
        let note = self.failure.clone().or_else(|| {
            let first = self.refusals.first()?;
            let total = self.refusals.len() + self.sequences;
            Some(format!(
                "{} of {total} sequences only: {first}",
                self.sequences
            ))
        });
        let measured = self.failure.is_none() && self.sequences > 0;
        Row {
            method: self.name().to_owned(),
            threads: measured.then(|| self.method.threads()),
            ms_per_frame: measured.then(|| self.ms.iter().sum::<f64>() / self.ms.len() as f64),
            summary: measured.then(|| self.tally.summary()),
            note: note.map(|note| add_note(notes, note)),
        }
    }

    fn try_run(
        &mut self,
        task: &Task,
        after_step: &mut dyn FnMut() -> Result<(), EvalError>,
    ) -> Result<Rollout, EvalError> {
        if !self.warm {
            roll_out(
                self.method.as_mut(),
                &task.shortened(WARM_UP_STEPS),
                &mut || Ok(()),
            )?;
            self.warm = true;
        }
        roll_out(self.method.as_mut(), task, after_step)
    }
}

/// Measures predicted frames (`start + 1`, `start + 2`, …) against the reference.
pub fn add_frames(
    tally: &mut Tally,
    task: &Task,
    predicted: &[Vec<crate::task::Positions>],
    reference: &Reference,
) {
    for (step, (predicted, truth)) in predicted.iter().zip(&reference.frames).enumerate() {
        let body = &task.frames[task.start + 1 + step].body;
        tally.add(&score_frame(&task.header, predicted, truth, body));
    }
}

/// Index of a note, added if it is new.
pub fn add_note(notes: &mut Vec<String>, note: String) -> usize {
    notes
        .iter()
        .position(|known| *known == note)
        .unwrap_or_else(|| {
            notes.push(note);
            notes.len() - 1
        })
}

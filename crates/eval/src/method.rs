//! The trait that every method implements, and the one loop that runs and times
//! all of them alike: batch 1, warm, one wall clock around each step.
//!
//! What counts as time per frame: everything from the positions of one frame
//! and the body of the next to the positions of the next. What does not: what a
//! method prepares once per sequence (patches, skinning weights, reading files).

use std::time::Instant;

use crate::{
    EvalError,
    task::{Positions, Task},
};

/// Something that predicts garments.
pub trait Method {
    /// Name in tables.
    fn name(&self) -> &str;

    /// Threads that a step uses.
    fn threads(&self) -> usize;

    /// Prepares for a sequence and goes to its start frame. Not timed.
    ///
    /// # Errors
    /// When the method cannot run on this sequence.
    fn begin(&mut self, task: &Task) -> Result<(), EvalError>;

    /// Predicts `frame` from the method's own prediction of the frame before
    /// (from the given history at first): `[garment][vertex, 3]`, absolute.
    /// Called with `start + 1`, `start + 2`, …
    ///
    /// # Errors
    /// When the prediction fails.
    fn step(&mut self, task: &Task, frame: usize) -> Result<Vec<Positions>, EvalError>;
}

/// What a method predicted.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// `frames[k]` is frame `start + 1 + k`, `[garment][vertex, 3]`, absolute.
    pub frames: Vec<Vec<Positions>>,
    /// Wall-clock time of each step in milliseconds.
    pub step_ms: Vec<f64>,
}

impl Rollout {
    /// Median time of a step in milliseconds (a mean would report other programs' hiccups).
    pub fn ms_per_frame(&self) -> f64 {
        let mut times = self.step_ms.clone();
        times.sort_by(f64::total_cmp);
        let middle = times.len() / 2;
        match times.len() {
            0 => 0.0,
            even if even % 2 == 0 => (times[middle - 1] + times[middle]) / 2.0,
            _ => times[middle],
        }
    }
}

/// Runs a whole rollout; `after_step` is called after each step and may stop it.
///
/// # Errors
/// When a step fails, predicts another number of vertices or something that is
/// not a number, or `after_step` stops.
pub fn roll_out(
    method: &mut dyn Method,
    task: &Task,
    after_step: &mut dyn FnMut() -> Result<(), EvalError>,
) -> Result<Rollout, EvalError> {
    method.begin(task)?;
    let mut rollout = Rollout {
        frames: Vec::with_capacity(task.steps),
        step_ms: Vec::with_capacity(task.steps),
    };
    for frame in task.start + 1..=task.start + task.steps {
        let clock = Instant::now();
        let garments = method.step(task, frame)?;
        rollout.step_ms.push(clock.elapsed().as_secs_f64() * 1e3);
        check(method.name(), task, frame, &garments)?;
        rollout.frames.push(garments);
        after_step()?;
    }
    Ok(rollout)
}

fn check(method: &str, task: &Task, frame: usize, garments: &[Positions]) -> Result<(), EvalError> {
    for (number, garment) in task.header.garments.iter().enumerate() {
        let found = garments.get(number).map_or(&[][..], Vec::as_slice);
        if found.len() != garment.rest.len() {
            return Err(EvalError::VertexCount {
                sequence: task.header.name.clone(),
                frame,
                place: format!("garment `{}` predicted by {method}", garment.name),
                expected: garment.rest.len(),
                found: found.len(),
            });
        }
        if let Some(vertex) = found
            .iter()
            .position(|point| !point.iter().all(|x| x.is_finite()))
        {
            return Err(EvalError::NotFinite {
                method: method.to_owned(),
                sequence: task.header.name.clone(),
                frame,
                garment: garment.name.clone(),
                vertex,
            });
        }
    }
    Ok(())
}

//! The engine at lower cost: sequences are simulated again from their recipes
//! at three substep counts, and compared with the finest of four runs.
//!
//! The runs start from rest like the recording did, not from the start frame's
//! positions, so their error is not that of the other rows: it says how far a
//! cheaper simulation is from the finest one over the same frames. Time is the
//! wall clock of whole recorded frames, less the time that counting their
//! intersections takes (measured by counting them again): a simulation has to
//! simulate, the count is for the file.

use std::{ops::ControlFlow, time::Instant};

use drape_dataset::{intersections::count_intersections, sequence::Frame};
use drape_sim::{
    SimError,
    scene::{Recipe, simulate},
};

use crate::{
    EvalError, contest::add_note, metrics::score_frame, table::Row, tally::Tally, task::Task,
};

/// Substeps of the compared runs, in quarters of the recipe's.
const QUARTERS: [u32; 3] = [1, 2, 4];
/// Substeps of the finest run, in quarters of the recipe's.
const FINEST_QUARTERS: u32 = 8;

/// Runs at the three substep counts so far.
#[derive(Default)]
pub struct EngineSeries {
    runs: [Run; QUARTERS.len()],
    sequences: usize,
}

#[derive(Default)]
struct Run {
    /// Smallest and largest substep count.
    substeps: Option<(u32, u32)>,
    tally: Tally,
    ms: Vec<f64>,
    failure: Option<String>,
}

impl EngineSeries {
    /// Whether a sequence holds a recipe of this engine.
    pub fn can_repeat(task: &Task) -> bool {
        Recipe::from_json(&task.header.scene.recipe).is_ok()
    }

    /// Simulates a sequence four times. `after_frame` is called after each frame and may stop.
    ///
    /// # Errors
    /// No recipe, a recipe that cannot be repeated, or `after_frame` stops.
    pub fn add(
        &mut self,
        task: &Task,
        after_frame: &mut dyn FnMut() -> Result<(), EvalError>,
    ) -> Result<(), EvalError> {
        let failed = |error: SimError| EvalError::NotApplicable {
            method: "engine".to_owned(),
            sequence: task.header.name.clone(),
            reason: error.to_string(),
        };
        let recipe = Recipe::from_json(&task.header.scene.recipe).map_err(failed)?;
        let mut run = |quarters: u32| {
            let substeps = (recipe.engine.substeps * quarters / QUARTERS[2]).max(1);
            (substeps, repeat(&recipe, substeps, task, after_frame))
        };
        let finest = run(FINEST_QUARTERS).1?.map_err(failed)?.0;
        for (number, quarters) in QUARTERS.into_iter().enumerate() {
            let (substeps, result) = run(quarters);
            let compared = &mut self.runs[number];
            let range = compared.substeps.get_or_insert((substeps, substeps));
            *range = (range.0.min(substeps), range.1.max(substeps));
            match result? {
                Ok((frames, ms)) => {
                    compared.ms.push(ms);
                    for (frame, truth) in frames.iter().zip(&finest) {
                        let score = score_frame(
                            &task.header,
                            &frame.garments,
                            &truth.garments,
                            &truth.body,
                        );
                        compared.tally.add(&score);
                    }
                }
                Err(error) => {
                    compared.failure.get_or_insert(error.to_string());
                }
            }
        }
        self.sequences += 1;
        Ok(())
    }

    /// Milliseconds per frame with the recipes' own substeps.
    pub fn recipe_ms(&self) -> Option<f64> {
        self.runs[2].milliseconds()
    }

    /// One row per substep count; empty when nothing was simulated.
    pub fn rows(&self, notes: &mut Vec<String>) -> Vec<Row> {
        let row = |run: &Run| {
            let (low, high) = run.substeps?;
            let substeps = if low == high {
                low.to_string()
            } else {
                format!("{low}–{high}")
            };
            let note = run.failure.clone().unwrap_or_else(|| {
                format!(
                    "simulated again from rest, {} sequence(s); error against a run of {} times the recipe's substeps, \
                     not against the recording",
                    self.sequences,
                    FINEST_QUARTERS / QUARTERS[2]
                )
            });
            let measured = run.failure.is_none();
            Some(Row {
                method: format!("engine, {substeps} substeps"),
                threads: measured.then_some(1),
                ms_per_frame: run.milliseconds().filter(|_| measured),
                summary: measured.then(|| run.tally.summary()),
                note: Some(add_note(notes, note)),
            })
        };
        self.runs.iter().filter_map(row).collect()
    }
}

impl Run {
    fn milliseconds(&self) -> Option<f64> {
        (!self.ms.is_empty()).then(|| self.ms.iter().sum::<f64>() / self.ms.len() as f64)
    }
}

/// Frames `start + 1 ..= start + steps` and milliseconds per frame.
type Repeated = Result<(Vec<Frame>, f64), SimError>;

/// Simulates a recipe as far as the task reaches. The outer error is a stop.
fn repeat(
    recipe: &Recipe,
    substeps: u32,
    task: &Task,
    after_frame: &mut dyn FnMut() -> Result<(), EvalError>,
) -> Result<Repeated, EvalError> {
    let mut recipe = recipe.clone();
    recipe.frames = recipe.frames.min(task.frames.len());
    let mut stopped = None;
    let mut clock = None;
    let result = simulate(&recipe, Some(substeps), |progress| {
        // The clock starts when the first recorded frame is done.
        if progress.done + recipe.frames == progress.of + 1 {
            clock = Some(Instant::now());
        }
        match after_frame() {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                stopped = Some(error);
                ControlFlow::Break(())
            }
        }
    });
    if let Some(stop) = stopped {
        return Err(stop);
    }
    let total = clock.map_or(0.0, |clock| clock.elapsed().as_secs_f64());
    Ok(result.map(|(header, mut frames)| {
        let clock = Instant::now();
        for frame in &frames[1..] {
            count_intersections(&header, frame);
        }
        let ms = (total - clock.elapsed().as_secs_f64()).max(0.0) * 1e3
            / (frames.len() - 1).max(1) as f64;
        (frames.split_off(task.start + 1), ms)
    }))
}

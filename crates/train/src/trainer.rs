//! The training loop: warm-up without collision losses, then with them.
//!
//! The samples of a batch run in parallel; their gradients are summed in the
//! batch's order, so a run's bits do not depend on the number of threads.

use std::io::Write;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use drape_model::{LayersNet, ModelError, Parameters};
use serde::Serialize;

use crate::adam::{Adam, Gradients};
use crate::config::TrainConfig;
use crate::data::{Draw, TrainingSet};
use crate::error::{Result, TrainError};
use crate::losses::LossValues;
use crate::losses::orthogonality::orthogonality;
use crate::run::{Position, RunFolder, RunRecord};
use crate::step::{roll_in, sample_gradient};
use crate::sway::sway_of_draw;

/// Time between two checkpoints.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(60);
/// Updates averaged for one line of the log.
const LOG_EVERY: usize = 10;

/// A line of `log.jsonl`: means over the updates since the line before.
#[derive(Clone, Debug, Serialize)]
pub struct LogLine {
    /// `warm-up` or `collisions`.
    pub phase: &'static str,
    /// Epoch (from 1).
    pub epoch: usize,
    /// Updates done in all.
    pub update: u64,
    /// Adam's rate.
    pub learning_rate: f64,
    /// Most steps without gradient.
    pub steps_without_gradient: usize,
    /// Loss terms, weighted.
    pub losses: LossValues,
    /// Orthogonality regulariser without its constant, weighted.
    pub orthogonality: f64,
    /// Samples per second since the line before.
    pub samples_per_s: f64,
    /// Seconds since the run (or its continuation) began.
    pub seconds: f64,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The schedule is done.
    Finished,
    /// Stopped on request; the checkpoint is saved.
    Interrupted,
}

/// What a caller is told while training.
pub trait Progress {
    /// After each update.
    fn update(
        &mut self,
        config: &TrainConfig,
        position: Position,
        losses: &LossValues,
        samples_per_s: f64,
    );
    /// After each epoch.
    fn epoch(&mut self, _epoch: usize) {}
}

/// Trains from a position to the schedule's end or until `stop` is set.
pub struct Trainer<'a> {
    /// Configuration.
    pub config: &'a TrainConfig,
    /// Data.
    pub set: &'a TrainingSet,
    /// Folder.
    pub folder: &'a RunFolder,
    /// Weights.
    pub parameters: Parameters,
    /// Optimiser.
    pub adam: Adam,
    /// Where training stands.
    pub position: Position,
}

impl Trainer<'_> {
    /// One update from the draws of a batch; returns the mean losses and the regulariser's value.
    fn update(&mut self, batch: &[Draw]) -> Result<(LossValues, f64)> {
        let (config, set, epoch) = (self.config, self.set, self.position.epoch);
        let frozen = LayersNet::frozen(&config.model, &self.parameters)?;
        let trainable = LayersNet::trainable(&config.model, &self.parameters)?;
        let with_collisions = config.schedule.with_collisions(epoch);
        let columns = &set.statistics.vertices;
        let update = self.position.updates as usize + 1;
        let not_finite = |tensor: String, draw: &Draw| TrainError::NotFinite {
            tensor,
            sequence: set.name(draw).into(),
            frame: draw.frame,
            update,
        };
        let work = |draw: &Draw| -> Result<(LossValues, Gradients)> {
            let sample = set.sample(draw, config.model.gravity)?;
            // A state that overflowed while rolling in is refused by the model.
            let overflowed = |cause: TrainError| match cause {
                TrainError::Model(ModelError::Input { what, found, .. }) => {
                    not_finite(format!("rolled-in {what}: {found}"), draw)
                }
                other => other,
            };
            let mut state = Vec::new();
            roll_in(&frozen, columns, &sample, 0, &mut state).map_err(overflowed)?;
            let (name, frame) = (set.name(draw), draw.frame);
            let label = format!("sway/update {update}, {name}, frame {frame}");
            sway_of_draw(config, &mut state, &sample.outfit, &label);
            let result = sample_gradient(
                &trainable,
                &self.parameters,
                columns,
                &config.losses,
                &sample,
                &state,
                with_collisions,
            )
            .map_err(overflowed)?;
            if let Some(name) = result.losses.not_finite() {
                return Err(not_finite(name.into(), draw));
            }
            for (name, gradient) in &result.gradients {
                if !gradient.iter().all(|value| value.is_finite()) {
                    return Err(not_finite(format!("gradient of {name}"), draw));
                }
            }
            Ok((result.losses, result.gradients))
        };
        // Samples with many steps first: no thread is left alone with a long one.
        let mut order: Vec<usize> = (0..batch.len()).collect();
        order.sort_by_key(|&index| std::cmp::Reverse(batch[index].rolled));
        let slots: Vec<OnceLock<Result<(LossValues, Gradients)>>> =
            batch.iter().map(|_| OnceLock::new()).collect();
        rayon::scope_fifo(|scope| {
            for index in order {
                let (work, slot, draw) = (&work, &slots[index], &batch[index]);
                scope.spawn_fifo(move |_| {
                    let _ = slot.set(work(draw));
                });
            }
        });
        let parts: Vec<(LossValues, Gradients)> = slots
            .into_iter()
            .map(|slot| slot.into_inner().expect("every sample was worked on"))
            .collect::<Result<_>>()?;
        let share = 1.0 / batch.len() as f64;
        let mut losses = LossValues::default();
        let mut total = Gradients::new();
        for (part, gradients) in parts {
            losses.add(&part, share);
            for (name, gradient) in gradients {
                let sum = total
                    .entry(name)
                    .or_insert_with(|| vec![0.0; gradient.len()]);
                sum.iter_mut()
                    .zip(&gradient)
                    .for_each(|(sum, value)| *sum += value * share as f32);
            }
        }
        let weight = config.losses.orthogonality;
        let regulariser = orthogonality(&config.model, &self.parameters)?;
        for (name, gradient) in &regulariser.gradients {
            if let Some(sum) = total.get_mut(name) {
                sum.iter_mut()
                    .zip(gradient)
                    .for_each(|(sum, value)| *sum += (weight * value) as f32);
            }
        }
        self.adam.update(
            &self.parameters,
            &total,
            config.schedule.learning_rate_of(epoch),
        )?;
        self.position.updates += 1;
        self.position.updates_in_epoch += 1;
        Ok((losses, weight * regulariser.value))
    }

    /// Runs the schedule.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] keeps the last good checkpoint; others name their cause.
    pub fn run(
        &mut self,
        record: &mut RunRecord,
        stop: &AtomicBool,
        progress: &mut impl Progress,
    ) -> Result<Outcome> {
        let started = Instant::now();
        let seconds_before = record.seconds;
        let schedule = &self.config.schedule;
        let mut log = LogWriter::open(self.folder.path())?;
        let mut window = Window::new();
        let mut last_save = Instant::now();
        while self.position.epoch < schedule.epochs {
            let epoch = self.position.epoch;
            let draws = self.set.draws(self.config, epoch);
            let done = self.position.updates_in_epoch * schedule.batch;
            for batch in draws[done..].chunks(schedule.batch) {
                if stop.load(Ordering::Relaxed) {
                    self.folder
                        .save(&self.parameters, &self.adam, self.position)?;
                    record.seconds = seconds_before + started.elapsed().as_secs_f64();
                    self.folder.write_record(record)?;
                    return Ok(Outcome::Interrupted);
                }
                let (losses, regulariser) = self.update(batch)?;
                window.add(&losses, regulariser, batch.len());
                progress.update(
                    self.config,
                    self.position,
                    &window.mean(),
                    window.samples_per_s(),
                );
                if window.updates == LOG_EVERY
                    || self.position.updates_in_epoch == schedule.updates_per_epoch()
                {
                    log.write(&LogLine {
                        phase: if schedule.with_collisions(epoch) {
                            "collisions"
                        } else {
                            "warm-up"
                        },
                        epoch: epoch + 1,
                        update: self.position.updates,
                        learning_rate: schedule.learning_rate_of(epoch),
                        steps_without_gradient: schedule.steps_without_gradient(epoch),
                        losses: window.mean(),
                        orthogonality: window.regulariser / window.updates as f64,
                        samples_per_s: window.samples_per_s(),
                        seconds: seconds_before + started.elapsed().as_secs_f64(),
                    })?;
                    window = Window::new();
                }
                if last_save.elapsed() > CHECKPOINT_EVERY {
                    self.folder
                        .save(&self.parameters, &self.adam, self.position)?;
                    record.seconds = seconds_before + started.elapsed().as_secs_f64();
                    self.folder.write_record(record)?;
                    last_save = Instant::now();
                }
            }
            self.position.epoch += 1;
            self.position.updates_in_epoch = 0;
            self.folder
                .save(&self.parameters, &self.adam, self.position)?;
            record.seconds = seconds_before + started.elapsed().as_secs_f64();
            record.finished = self.position.epoch == schedule.epochs;
            self.folder.write_record(record)?;
            last_save = Instant::now();
            progress.epoch(self.position.epoch);
        }
        Ok(Outcome::Finished)
    }
}

/// Sums since the last line of the log.
struct Window {
    sum: LossValues,
    regulariser: f64,
    updates: usize,
    samples: usize,
    since: Instant,
}

impl Window {
    fn new() -> Self {
        Self {
            sum: LossValues::default(),
            regulariser: 0.0,
            updates: 0,
            samples: 0,
            since: Instant::now(),
        }
    }

    fn add(&mut self, losses: &LossValues, regulariser: f64, samples: usize) {
        self.sum.add(losses, 1.0);
        self.regulariser += regulariser;
        self.updates += 1;
        self.samples += samples;
    }

    fn mean(&self) -> LossValues {
        let mut mean = LossValues::default();
        mean.add(&self.sum, 1.0 / self.updates.max(1) as f64);
        mean
    }

    fn samples_per_s(&self) -> f64 {
        self.samples as f64 / self.since.elapsed().as_secs_f64().max(1e-9)
    }
}

struct LogWriter {
    file: std::fs::File,
    path: std::path::PathBuf,
}

impl LogWriter {
    fn open(folder: &Path) -> Result<Self> {
        let path = folder.join("log.jsonl");
        let file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path);
        match file {
            Ok(file) => Ok(Self { file, path }),
            Err(cause) => Err(TrainError::Run {
                path,
                cause: cause.to_string(),
            }),
        }
    }

    fn write(&mut self, line: &LogLine) -> Result<()> {
        let text = serde_json::to_string(line).expect("a log line is plain data");
        writeln!(self.file, "{text}").map_err(|cause| TrainError::Run {
            path: self.path.clone(),
            cause: cause.to_string(),
        })
    }
}

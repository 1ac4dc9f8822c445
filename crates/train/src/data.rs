//! The training set: sequences, their outfits, statistics, and samples drawn
//! from named random streams.
//!
//! Frames are read from the files when a sample is drawn, so memory does not
//! grow with the data set.
//!
//! Training draws with replacement, and draws the number of steps and a heading with each
//! place, which leaves it less places the more steps there are. [`drape_dataset::order`]
//! deals out every place once for one number of steps; reading, statistics and samples are
//! the same code for both.

use std::path::Path;
use std::sync::Arc;

use drape_dataset::SequenceReader;
use drape_dataset::random::stream;
use drape_dataset::sample::{Outfit, Sample, gravity_per_frame};
use drape_dataset::samples::{read_states, training_statistics};
use drape_dataset::splits::{DatasetIndex, Split};
use drape_dataset::statistics::{ColumnStatistics, Statistics};
use drape_model::GravitySource;
use rand::Rng;

use crate::config::TrainConfig;
use crate::error::{Result, TrainError};
use crate::trend::fit_trend;

/// One sequence to train on.
pub struct TrainingSequence {
    /// Its file.
    pub reader: SequenceReader,
    /// Its outfit.
    pub outfit: Arc<Outfit>,
}

/// The training split.
pub struct TrainingSet {
    /// Sequences in the index's order.
    pub sequences: Vec<TrainingSequence>,
    /// Statistics of the split.
    pub statistics: Statistics,
    /// Hash of the whole data set.
    pub data_hash: String,
}

/// One draw: where a sample starts and how many steps it makes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// Index of the sequence.
    pub sequence: usize,
    /// Frame of the start state.
    pub frame: usize,
    /// Steps without gradient before the gradient step.
    pub rolled: usize,
    /// Heading by which the scene is turned.
    pub heading_rad: f64,
}

/// Gravity that enters the samples of a sequence, units/frame².
pub fn sample_gravity(source: GravitySource, reader: &SequenceReader) -> [f32; 3] {
    match source {
        GravitySource::Released => [0.0, 0.0, -9.8 / 30.0],
        GravitySource::Scene => gravity_per_frame(reader.header()),
    }
}

/// Statistics that do not depend on the heading: x and y share their spread and have mean 0.
pub fn without_heading(statistics: Statistics) -> Statistics {
    let symmetric = |mut columns: ColumnStatistics| {
        for block in [0, 3, 6] {
            let second = |axis: usize| columns.mean[axis].powi(2) + columns.std[axis].powi(2);
            let spread = ((second(block) + second(block + 1)) / 2.0).sqrt();
            for axis in [block, block + 1] {
                columns.mean[axis] = 0.0;
                columns.std[axis] = spread;
            }
        }
        columns
    };
    Statistics {
        vertices: symmetric(statistics.vertices),
        root: symmetric(statistics.root),
    }
}

impl TrainingSet {
    /// Opens the training split of a data set and computes its statistics.
    ///
    /// # Errors
    /// If the data set, a file or a frame cannot be used.
    pub fn open(config: &TrainConfig) -> Result<Self> {
        let index = DatasetIndex::load(&config.data)?;
        let sequences = index
            .split(Split::Train)?
            .into_iter()
            .map(|entry| {
                let reader = index.open(entry)?;
                let outfit = Arc::new(Outfit::new(reader.header(), config.patch_size_m)?);
                Ok(TrainingSequence { reader, outfit })
            })
            .collect::<Result<Vec<_>>>()?;
        let needed = config.schedule.first_frame + config.schedule.max_steps_without_gradient + 2;
        for sequence in &sequences {
            if sequence.reader.frame_count() < needed {
                return Err(TrainError::Data {
                    path: sequence.reader.path().into(),
                    cause: format!(
                        "{} frames, expected at least {needed} for {} steps without gradient: \
                         make longer sequences or lower schedule.max_steps_without_gradient",
                        sequence.reader.frame_count(),
                        config.schedule.max_steps_without_gradient
                    ),
                });
            }
        }
        let statistics = training_statistics(&index, config.schedule.first_frame)?;
        let statistics = if config.random_heading {
            without_heading(statistics)
        } else {
            statistics
        };
        let mut set = Self {
            sequences,
            statistics,
            data_hash: index.data_hash(),
        };
        if config.model.trend {
            set.statistics.vertices.trend = fit_trend(&set, config)?;
        }
        Ok(set)
    }

    /// The draws of an epoch (from 0), a function of the seed alone.
    pub fn draws(&self, config: &TrainConfig, epoch: usize) -> Vec<Draw> {
        let schedule = &config.schedule;
        let mut rng = stream(config.seed, &format!("draws/epoch {epoch}"));
        let steps = schedule.steps_without_gradient(epoch);
        (0..schedule.updates_per_epoch() * schedule.batch)
            .map(|_| {
                let sequence = rng.random_range(0..self.sequences.len());
                let frames = self.sequences[sequence].reader.frame_count();
                // The gradient step leads from frame + steps to the frame after it.
                let frame = rng.random_range(schedule.first_frame..frames - steps - 1);
                // The first `switch` steps would be replaced by the reference: start after them.
                let switch = rng.random_range(0..=steps);
                let heading = rng.random_range(0.0..std::f64::consts::TAU);
                Draw {
                    sequence,
                    frame: frame + switch,
                    rolled: steps - switch,
                    heading_rad: if config.random_heading { heading } else { 0.0 },
                }
            })
            .collect()
    }

    /// The sample of a draw.
    ///
    /// # Errors
    /// If a frame cannot be read.
    pub fn sample(&self, draw: &Draw, gravity: GravitySource) -> Result<Sample> {
        let sequence = &self.sequences[draw.sequence];
        let frames = draw.frame - 1..draw.frame + draw.rolled + 2;
        let states = read_states(&sequence.reader, frames, draw.heading_rad)?;
        let gravity = sample_gravity(gravity, &sequence.reader);
        Ok(Sample::new(
            sequence.outfit.clone(),
            &states,
            &self.statistics,
            gravity,
        ))
    }

    /// Name of a draw's sequence.
    pub fn name(&self, draw: &Draw) -> &str {
        &self.sequences[draw.sequence].reader.header().name
    }
}

/// Reads statistics saved beside a checkpoint.
///
/// # Errors
/// If the file is missing or not what [`serde_json`] wrote.
pub fn read_statistics(path: &Path) -> Result<Statistics> {
    let fail = |cause: String| TrainError::Run {
        path: path.into(),
        cause,
    };
    let text = std::fs::read_to_string(path).map_err(|cause| fail(cause.to_string()))?;
    serde_json::from_str(&text).map_err(|cause| fail(cause.to_string()))
}

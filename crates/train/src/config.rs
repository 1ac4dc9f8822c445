//! Configuration of a training run, loadable from TOML.

use std::path::{Path, PathBuf};

use drape_model::ModelConfig;
use serde::{Deserialize, Serialize};

use crate::error::{Result, TrainError};
use crate::losses::LossConfig;

/// A training run's choices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Seed of weights, draws and headings. Default 1.
    pub seed: u64,
    /// Folder of the data set. Default `data/default`.
    pub data: PathBuf,
    /// Side of a patch in metres, real size. Smaller: finer motion, slower. Default 0.06.
    pub patch_size_m: f32,
    /// Turn each sample about the vertical axis by a random angle, so that the
    /// model does not depend on where people face. Default false: people in one
    /// data set face mostly one way, and a model that may use it learns faster.
    pub random_heading: bool,
    /// Epochs, rates and phases.
    pub schedule: Schedule,
    /// The network.
    pub model: ModelConfig,
    /// The losses.
    pub losses: LossConfig,
}

/// Epochs, rates and phases.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// Epochs. Default 12.
    pub epochs: usize,
    /// Draws of one epoch. Default 200.
    pub samples_per_epoch: usize,
    /// Samples whose gradients are averaged for one update. Default 4.
    pub batch: usize,
    /// Adam's rate at the start. Default 1e-3.
    pub learning_rate: f64,
    /// The rate is halved each time this many epochs have passed. Default 4.
    pub halve_every_epochs: usize,
    /// First epochs without collision losses (warm-up). Default 1.
    pub warm_up_epochs: usize,
    /// Most steps without gradient before the gradient step; epoch e (from 0)
    /// uses up to min(e, this). Default 9.
    pub max_steps_without_gradient: usize,
    /// Largest smooth shift of a sample's start state, see [`crate::sway`], in units.
    /// Default 0.03; the published program: 0.
    pub sway: f32,
    /// First frame a sample may start from; two older frames are its history. Default 2.
    pub first_frame: usize,
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            epochs: 12,
            samples_per_epoch: 200,
            batch: 4,
            learning_rate: 1e-3,
            halve_every_epochs: 4,
            warm_up_epochs: 1,
            max_steps_without_gradient: 9,
            sway: 0.03,
            first_frame: 2,
        }
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            data: PathBuf::from("data/default"),
            patch_size_m: 0.06,
            random_heading: false,
            schedule: Schedule::default(),
            model: ModelConfig::default(),
            losses: LossConfig::default(),
        }
    }
}

impl Schedule {
    /// Adam's rate in an epoch (from 0).
    pub fn learning_rate_of(&self, epoch: usize) -> f64 {
        self.learning_rate * 0.5f64.powi((epoch / self.halve_every_epochs) as i32)
    }

    /// Most steps without gradient in an epoch (from 0).
    pub fn steps_without_gradient(&self, epoch: usize) -> usize {
        epoch.min(self.max_steps_without_gradient)
    }

    /// Whether collision losses are on in an epoch (from 0).
    pub fn with_collisions(&self, epoch: usize) -> bool {
        epoch >= self.warm_up_epochs
    }

    /// Updates of one epoch.
    pub fn updates_per_epoch(&self) -> usize {
        self.samples_per_epoch / self.batch
    }
}

impl TrainConfig {
    /// Reads a TOML file.
    ///
    /// # Errors
    /// [`TrainError::ConfigFile`] with line and key, or a value out of range.
    pub fn load(path: &Path) -> Result<Self> {
        let fail = |cause: String| TrainError::ConfigFile {
            path: path.into(),
            cause,
        };
        let text = std::fs::read_to_string(path).map_err(|cause| fail(cause.to_string()))?;
        let config: Self = toml::from_str(&text).map_err(|cause| fail(cause.to_string()))?;
        config.validate()?;
        Ok(config)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`TrainError::Config`] naming the field.
    pub fn validate(&self) -> Result<()> {
        self.model.validate()?;
        let s = &self.schedule;
        let fail = |field, found: String, expected| {
            Err(TrainError::Config {
                field,
                found,
                expected,
            })
        };
        if !(self.patch_size_m.is_finite() && self.patch_size_m > 0.0) {
            return fail(
                "patch_size_m",
                self.patch_size_m.to_string(),
                "a positive length in metres",
            );
        }
        for (field, value) in [
            ("schedule.epochs", s.epochs),
            ("schedule.batch", s.batch),
            ("schedule.halve_every_epochs", s.halve_every_epochs),
        ] {
            if value == 0 {
                return fail(field, value.to_string(), "at least 1");
            }
        }
        if s.samples_per_epoch < s.batch {
            return fail(
                "schedule.samples_per_epoch",
                s.samples_per_epoch.to_string(),
                "at least one batch",
            );
        }
        if s.first_frame < 2 {
            return fail(
                "schedule.first_frame",
                s.first_frame.to_string(),
                "at least 2: velocities need two older frames",
            );
        }
        if !(s.sway.is_finite() && s.sway >= 0.0) {
            return fail(
                "schedule.sway",
                s.sway.to_string(),
                "zero or a length in units",
            );
        }
        if !(self.losses.return_frames.is_finite() && self.losses.return_frames >= 1.0) {
            return fail(
                "losses.return_frames",
                self.losses.return_frames.to_string(),
                "at least 1 frame",
            );
        }
        if !(s.learning_rate.is_finite() && s.learning_rate > 0.0) {
            return fail(
                "schedule.learning_rate",
                s.learning_rate.to_string(),
                "a positive number",
            );
        }
        let losses = [
            ("losses.position", self.losses.position),
            ("losses.patch", self.losses.patch),
            ("losses.normal", self.losses.normal),
            ("losses.body_collision", self.losses.body_collision),
            ("losses.layer_collision", self.losses.layer_collision),
            ("losses.orthogonality", self.losses.orthogonality),
        ];
        for (field, value) in losses {
            if !(value.is_finite() && value >= 0.0) {
                return fail(field, value.to_string(), "zero or a positive number");
            }
        }
        Ok(())
    }
}

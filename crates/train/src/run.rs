//! A run folder: everything that tells what a training run was and how it went.
//!
//! ```text
//! RUN/config.toml        resolved configuration
//! RUN/run.json           seed, commit, data hash, number of updates, finished or not
//! RUN/statistics.json    normalisation statistics of the training set
//! RUN/log.jsonl          one line per logged update
//! RUN/losses.png         loss curves
//! RUN/checkpoint/        weights, optimiser and position of the last checkpoint
//! ```
//! A checkpoint is one folder, written beside the old one and renamed over it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use candle_core::{DType, Tensor};
use drape_dataset::statistics::Statistics;
use drape_model::Parameters;
use serde::{Deserialize, Serialize};

use crate::adam::Adam;
use crate::config::TrainConfig;
use crate::data::read_statistics;
use crate::error::{Result, TrainError};

/// What `run.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Program and version.
    pub program: String,
    /// Commit of the source, or `unknown`.
    pub commit: String,
    /// Seed.
    pub seed: u64,
    /// Hash of the data set.
    pub data_hash: String,
    /// Number of training sequences.
    pub sequences: usize,
    /// Scalars of the model.
    pub parameters: usize,
    /// Gradient updates planned.
    pub updates: usize,
    /// Threads used.
    pub threads: usize,
    /// Seconds of training so far.
    pub seconds: f64,
    /// Whether the schedule has ended.
    pub finished: bool,
}

/// Where training stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Position {
    /// Epoch (from 0).
    pub epoch: usize,
    /// Updates done in that epoch.
    pub updates_in_epoch: usize,
    /// Updates done in all.
    pub updates: u64,
}

/// A run folder.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

/// A trained model with all that its evaluation needs.
pub struct TrainedModel {
    /// Folder's name.
    pub name: String,
    /// Configuration.
    pub config: TrainConfig,
    /// Record.
    pub record: RunRecord,
    /// Statistics.
    pub statistics: Statistics,
    /// Weights.
    pub parameters: Parameters,
}

fn run_error(path: &Path) -> impl Fn(std::io::Error) -> TrainError + '_ {
    move |cause| TrainError::Run {
        path: path.into(),
        cause: cause.to_string(),
    }
}

/// Writes a file beside its final name, then renames it.
///
/// # Errors
/// If the folder cannot be written.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    let temporary = path.with_extension("tmp");
    let write = || -> std::io::Result<()> {
        let mut file = fs::File::create(&temporary)?;
        std::io::Write::write_all(&mut file, bytes)?;
        file.sync_all()?;
        fs::rename(&temporary, path)
    };
    write().map_err(run_error(path))
}

impl RunFolder {
    /// Makes a new run folder.
    ///
    /// # Errors
    /// If it exists and is not empty, or cannot be made.
    pub fn create(path: &Path) -> Result<Self> {
        if path.exists()
            && fs::read_dir(path)
                .map_err(run_error(path))?
                .next()
                .is_some()
        {
            return Err(TrainError::Run {
                path: path.into(),
                cause: "exists already: continue it with `--resume`, or choose another folder with `--run`".into(),
            });
        }
        fs::create_dir_all(path).map_err(run_error(path))?;
        Ok(Self { path: path.into() })
    }

    /// Opens an existing run folder.
    ///
    /// # Errors
    /// If there is no run in it.
    pub fn open(path: &Path) -> Result<Self> {
        if !path.join("run.json").is_file() {
            let cause =
                "is not a run folder (no run.json): expected what `cargo xtask train` writes"
                    .into();
            return Err(TrainError::Run {
                path: path.into(),
                cause,
            });
        }
        Ok(Self { path: path.into() })
    }

    /// The newest run below `runs` (by record time) that has a checkpoint; `finished` restricts to ended or unended ones.
    ///
    /// # Errors
    /// If there is none.
    pub fn latest(runs: &Path, finished: Option<bool>) -> Result<Self> {
        let mut found: Vec<(std::time::SystemTime, PathBuf)> = Vec::new();
        if let Ok(entries) = fs::read_dir(runs) {
            for path in entries.flatten().map(|entry| entry.path()) {
                let folder = Self { path: path.clone() };
                let Ok(record) = folder.record() else {
                    continue;
                };
                if !folder.checkpoint().is_dir()
                    || finished.is_some_and(|wanted| wanted != record.finished)
                {
                    continue;
                }
                let time = fs::metadata(path.join("run.json")).and_then(|meta| meta.modified());
                found.push((time.map_err(run_error(&path))?, path));
            }
        }
        found.sort();
        found
            .pop()
            .map(|(_, path)| Self { path })
            .ok_or_else(|| TrainError::Run {
                path: runs.into(),
                cause: match finished {
                    Some(true) => {
                        "holds no finished run: train one with `cargo xtask train`".into()
                    }
                    Some(false) => "holds no unfinished run to resume".into(),
                    None => "holds no run: train one with `cargo xtask train`".into(),
                },
            })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint")
    }

    /// Reads the resolved configuration.
    ///
    /// # Errors
    /// If it is missing or does not parse.
    pub fn config(&self) -> Result<TrainConfig> {
        TrainConfig::load(&self.path.join("config.toml"))
    }

    /// Reads the record.
    ///
    /// # Errors
    /// If it is missing or does not parse.
    pub fn record(&self) -> Result<RunRecord> {
        let path = self.path.join("run.json");
        let text = fs::read_to_string(&path).map_err(run_error(&path))?;
        serde_json::from_str(&text).map_err(|cause| TrainError::Run {
            path,
            cause: cause.to_string(),
        })
    }

    /// Writes the record.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write_record(&self, record: &RunRecord) -> Result<()> {
        let text = serde_json::to_string_pretty(record).expect("a record is plain data");
        write_atomic(&self.path.join("run.json"), text.as_bytes())
    }

    /// Writes configuration and statistics at the start of a run.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write_start(&self, config: &TrainConfig, statistics: &Statistics) -> Result<()> {
        let text = toml::to_string(config).expect("a config is plain data");
        write_atomic(&self.path.join("config.toml"), text.as_bytes())?;
        let text = serde_json::to_string_pretty(statistics).expect("statistics are plain data");
        write_atomic(&self.path.join("statistics.json"), text.as_bytes())
    }

    /// Saves weights, optimiser and position.
    ///
    /// # Errors
    /// If the folder cannot be written; the old checkpoint is then still whole.
    pub fn save(&self, parameters: &Parameters, adam: &Adam, position: Position) -> Result<()> {
        let (new, old, current) = (
            self.path.join("checkpoint.new"),
            self.path.join("checkpoint.old"),
            self.checkpoint(),
        );
        for stale in [&new, &old] {
            if stale.exists() {
                fs::remove_dir_all(stale).map_err(run_error(stale))?;
            }
        }
        fs::create_dir(&new).map_err(run_error(&new))?;
        let weights: BTreeMap<String, Tensor> = parameters
            .iter()
            .map(|(name, variable)| (name.to_string(), variable.as_tensor().clone()))
            .collect();
        for (name, tensors) in [("weights", weights), ("adam", adam.to_tensors()?)] {
            let path = new.join(format!("{name}.safetensors"));
            safetensors::serialize_to_file(tensors, None, &path).map_err(|cause| {
                TrainError::Run {
                    path: path.clone(),
                    cause: cause.to_string(),
                }
            })?;
        }
        let text = serde_json::to_string(&position).expect("a position is plain data");
        write_atomic(&new.join("position.json"), text.as_bytes())?;
        if current.exists() {
            fs::rename(&current, &old).map_err(run_error(&current))?;
        }
        fs::rename(&new, &current).map_err(run_error(&new))?;
        if old.exists() {
            fs::remove_dir_all(&old).map_err(run_error(&old))?;
        }
        Ok(())
    }

    /// Loads weights, optimiser and position.
    ///
    /// # Errors
    /// If the checkpoint is missing, not whole, or made for another configuration.
    pub fn load(&self, config: &TrainConfig) -> Result<(Parameters, Adam, Position)> {
        let folder = self.whole_checkpoint()?;
        let parameters = Parameters::load(
            &folder.join("weights.safetensors"),
            &config.model,
            DType::F32,
        )?;
        let path = folder.join("position.json");
        let text = fs::read_to_string(&path).map_err(run_error(&path))?;
        let position: Position = serde_json::from_str(&text).map_err(|cause| TrainError::Run {
            path,
            cause: cause.to_string(),
        })?;
        let moments = candle_core::safetensors::load(
            folder.join("adam.safetensors"),
            &candle_core::Device::Cpu,
        )?;
        let adam = Adam::from_tensors(position.updates, &moments.into_iter().collect())?;
        Ok((parameters, adam, position))
    }

    /// The current checkpoint, or the old one if the program was killed between two renames.
    fn whole_checkpoint(&self) -> Result<PathBuf> {
        for name in ["checkpoint", "checkpoint.old"] {
            let folder = self.path.join(name);
            if folder.join("position.json").is_file() {
                return Ok(folder);
            }
        }
        Err(TrainError::Run {
            path: self.checkpoint(),
            cause: "no whole checkpoint: the run was stopped before its first one; start it anew"
                .into(),
        })
    }

    /// Reads the trained model.
    ///
    /// # Errors
    /// If a part of the run folder is missing.
    pub fn trained(&self) -> Result<TrainedModel> {
        let config = self.config()?;
        let weights = self.whole_checkpoint()?.join("weights.safetensors");
        Ok(TrainedModel {
            name: self
                .path
                .file_name()
                .map_or_else(|| "run".into(), |name| name.to_string_lossy().into_owned()),
            record: self.record()?,
            statistics: read_statistics(&self.path.join("statistics.json"))?,
            parameters: Parameters::load(&weights, &config.model, DType::F32)?,
            config,
        })
    }
}

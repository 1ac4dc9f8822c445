//! The crate's error type.

use std::path::PathBuf;

/// What can go wrong in training.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A config value is out of range.
    #[error("config: {field} is {found}, expected {expected}")]
    Config {
        /// Field.
        field: &'static str,
        /// Found.
        found: String,
        /// Allowed.
        expected: &'static str,
    },
    /// A config file does not parse.
    #[error("config {}: {cause}", path.display())]
    ConfigFile {
        /// File.
        path: PathBuf,
        /// Parser's message, with line and key.
        cause: String,
    },
    /// Data that cannot be trained on.
    #[error("data {}: {cause}", path.display())]
    Data {
        /// Folder or file.
        path: PathBuf,
        /// Cause.
        cause: String,
    },
    /// A run folder that cannot be used.
    #[error("run {}: {cause}", path.display())]
    Run {
        /// Folder or file.
        path: PathBuf,
        /// Cause, and how to fix it.
        cause: String,
    },
    /// NaN or infinity.
    #[error(
        "training stopped: {tensor} is not finite (sequence {sequence}, frame {frame}, update {update}); \
         the last good checkpoint is kept: lower `learning_rate` or look at the sequence with `cargo xtask inspect`"
    )]
    NotFinite {
        /// Which loss or gradient.
        tensor: String,
        /// Sequence of the sample.
        sequence: String,
        /// Frame of the sample.
        frame: usize,
        /// Update at which it happened.
        update: usize,
    },
    /// Reading sequences failed.
    #[error(transparent)]
    Dataset(#[from] drape_dataset::DatasetError),
    /// The model failed.
    #[error(transparent)]
    Model(#[from] drape_model::ModelError),
    /// candle failed.
    #[error(transparent)]
    Candle(#[from] candle_core::Error),
}

/// Result of this crate.
pub type Result<T, E = TrainError> = std::result::Result<T, E>;

//! The crate's error type.

/// What can go wrong in the model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A config value is out of range.
    #[error("model.{field} is {found}, expected {expected}")]
    Config {
        /// Field.
        field: &'static str,
        /// Value found.
        found: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// Input that does not fit the outfit.
    #[error("model input '{what}': expected {expected}, found {found}")]
    Input {
        /// Which input.
        what: &'static str,
        /// Expected.
        expected: String,
        /// Found.
        found: String,
    },
    /// Weights that do not fit the configuration.
    #[error("weights, tensor '{name}': expected {expected}, found {found}")]
    Weights {
        /// Tensor name.
        name: String,
        /// Expected.
        expected: String,
        /// Found.
        found: String,
    },
    /// A file of weights cannot be read or written.
    #[error("weights file {}: {cause}", path.display())]
    File {
        /// File.
        path: std::path::PathBuf,
        /// Cause.
        cause: String,
    },
    /// candle failed.
    #[error(transparent)]
    Candle(#[from] candle_core::Error),
}

/// Result of this crate.
pub type Result<T, E = ModelError> = std::result::Result<T, E>;

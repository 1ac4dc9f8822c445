//! What can go wrong while evaluating.

use std::path::PathBuf;

/// Errors of this crate: what, where, expected and found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvalError {
    /// A sequence has too few frames for the rollout asked for.
    #[error(
        "sequence `{sequence}` has {found} frames, but a rollout of {steps} steps from frame {start} needs {needed}: \
         lower --steps or --start, or use longer sequences"
    )]
    TooShort {
        /// Sequence.
        sequence: String,
        /// Its number of frames.
        found: usize,
        /// Frames needed.
        needed: usize,
        /// First frame.
        start: usize,
        /// Steps asked for.
        steps: usize,
    },
    /// A rollout starts before there is a history.
    #[error(
        "a rollout cannot start at frame {start}: two velocities are needed, so --start must be at least {least}"
    )]
    TooEarly {
        /// Frame asked for.
        start: usize,
        /// First possible frame.
        least: usize,
    },
    /// Two sets of positions that must match do not.
    #[error(
        "sequence `{sequence}`, frame {frame}, {place}: expected {expected} vertices, found {found}"
    )]
    VertexCount {
        /// Sequence.
        sequence: String,
        /// Frame.
        frame: usize,
        /// Garment name or `body`.
        place: String,
        /// Vertices expected.
        expected: usize,
        /// Vertices found.
        found: usize,
    },
    /// A method cannot run on a sequence.
    #[error("{method} cannot run on sequence `{sequence}`: {reason}")]
    NotApplicable {
        /// Method.
        method: String,
        /// Sequence.
        sequence: String,
        /// Why.
        reason: String,
    },
    /// A prediction is not a number.
    #[error(
        "{method} predicts NaN or infinity in sequence `{sequence}`, frame {frame}, garment `{garment}`, vertex {vertex}"
    )]
    NotFinite {
        /// Method.
        method: String,
        /// Sequence.
        sequence: String,
        /// Frame.
        frame: usize,
        /// Garment.
        garment: String,
        /// Vertex.
        vertex: usize,
    },
    /// A method failed inside.
    #[error("{method} failed on sequence `{sequence}`, frame {frame}: {reason}")]
    Method {
        /// Method.
        method: String,
        /// Sequence.
        sequence: String,
        /// Frame.
        frame: usize,
        /// Cause.
        reason: String,
    },
    /// A file of the data set cannot be used.
    #[error(transparent)]
    Dataset(#[from] drape_dataset::DatasetError),
    /// A person stopped the program.
    #[error("stopped by Ctrl-C")]
    Stopped,
    /// A file could not be written.
    #[error("cannot write {path}: {reason}")]
    Write {
        /// File.
        path: PathBuf,
        /// Cause.
        reason: String,
    },
}

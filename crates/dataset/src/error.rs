//! The crate's one error type. Each message says where (file, frame, garment,
//! vertex), what was expected, what was found, and what to do about it. The
//! message is whole: no variant has a `source()` that would repeat a part.

use std::io;
use std::path::{Path, PathBuf};

/// Result of this crate's functions.
pub type Result<T, E = DatasetError> = std::result::Result<T, E>;

/// What can be wrong with a data set, a sequence file or a garment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The operating system refused: missing file, no permission, disk full.
    #[error("cannot {action} {}: {reason}", path.display())]
    Io {
        /// What was tried: "open", "read", "write".
        action: &'static str,
        /// On which file or folder.
        path: PathBuf,
        /// The system's reason.
        reason: io::Error,
    },
    /// The file is something else.
    #[error("{}: not a drape sequence: expected {expected}, found {found}", path.display())]
    NotASequence {
        /// The file.
        path: PathBuf,
        /// What a sequence file has.
        expected: String,
        /// What this file has.
        found: String,
    },
    /// The file stops before its end.
    #[error(
        "{}: truncated: {reason}; the copy or the program that wrote it was interrupted: \
         copy or generate the file again{saveable}", path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Which part is missing.
        reason: String,
        /// What can be saved and how, as the tail of a sentence; empty when nothing can.
        saveable: String,
    },
    /// Bytes changed since the file was written.
    #[error(
        "{}: damaged in {place}: expected {expected}, found {found}; \
         restore or generate the file again, or save its whole frames with \
         `cargo xtask inspect FILE --recover OUT`", path.display()
    )]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// Which part: the index, the header, frame 12.
        place: String,
        /// What the part's checksum or shape should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// Written by a later drape whose major format version this one does not know.
    #[error(
        "{}: format version {found} is newer than this program reads ({supported}.x): \
         update drape", path.display()
    )]
    NewerFormat {
        /// The file.
        path: PathBuf,
        /// The file's version.
        found: String,
        /// The highest major version understood.
        supported: u32,
    },
    /// A garment cannot be cut into patches.
    #[error("garment '{garment}' cannot be cut into patches: {found}")]
    Patches {
        /// The garment.
        garment: String,
        /// What is wrong.
        found: String,
    },
    /// No such frame.
    #[error("{}: frame {frame} was asked for, but the sequence has {frame_count} frames (0 to {})",
        path.display(), frame_count.saturating_sub(1))]
    FrameOutOfRange {
        /// The file.
        path: PathBuf,
        /// The frame asked for.
        frame: usize,
        /// Frames in the file.
        frame_count: usize,
    },
    /// A value that breaks a rule of the format.
    #[error("{place}: expected {expected}, found {found}")]
    Invalid {
        /// Where: `garment "skirt", vertex 12`.
        place: String,
        /// The rule.
        expected: String,
        /// The value.
        found: String,
    },
    /// Any of the above, in a named file.
    #[error("{}: {fault}", path.display())]
    InFile {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        fault: Box<DatasetError>,
    },
}

impl DatasetError {
    /// A value that breaks a rule: where, the rule, the value.
    pub fn invalid(
        place: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Invalid {
            place: place.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }

    /// Says in which file the fault is.
    #[must_use]
    pub fn in_file(self, path: impl AsRef<Path>) -> Self {
        Self::InFile {
            path: path.as_ref().to_path_buf(),
            fault: Box::new(self),
        }
    }

    pub(crate) fn io(
        action: &'static str,
        path: impl AsRef<Path>,
    ) -> impl FnOnce(io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |reason| Self::Io {
            action,
            path,
            reason,
        }
    }
}

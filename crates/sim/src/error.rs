//! The crate's one error type: what, where, expected, found, what to do.

/// Result of this crate's functions.
pub type Result<T, E = SimError> = std::result::Result<T, E>;

/// What can be wrong with a body asset, a scene or a simulation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// The packed body is not what the program expects.
    #[error("body asset: {0}; pack it again with assets/pack_body.py")]
    BodyAsset(String),
    /// A value does not make sense.
    #[error("{name}: expected {expected}, found {found}")]
    Value {
        /// Which value.
        name: String,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A garment does not fit on this body with these parameters.
    #[error(
        "{garment} does not fit: {reason}; give it more ease or another length, or choose another body shape"
    )]
    Fit {
        /// Garment's name.
        garment: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A file with a motion is not what it should be.
    #[error(
        "{}{}: expected {expected}, found {found}; a BVH file as the CMU recordings have it works",
        path.display(),
        if *line > 0 { format!(", line {line}") } else { String::new() }
    )]
    MotionFile {
        /// The file.
        path: std::path::PathBuf,
        /// Line, from 1; 0 for the file as a whole.
        line: usize,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// Whoever started the simulation asked it to stop.
    #[error("stopped at frame {frame}, as asked")]
    Stopped {
        /// Frame that was not simulated any more, lead-in included.
        frame: usize,
    },
    /// A position is NaN or infinite.
    #[error("{surface}, vertex {vertex}: expected finite coordinates, found {found:?}")]
    NotFinite {
        /// Body or garment, by name.
        surface: String,
        /// Vertex on it.
        vertex: usize,
        /// The coordinates.
        found: [f32; 3],
    },
    /// There is no Blender to simulate with.
    #[error(
        "no Blender: {reason}; get one with `cargo xtask setup blender` (once, about 1 GB), or let DRAPE_BLENDER_PYTHON name a Python that has bpy"
    )]
    NoBlender {
        /// Where it was looked for.
        reason: String,
    },
    /// Blender did not do what it was told.
    #[error("Blender: {reason}")]
    Blender {
        /// What went wrong.
        reason: String,
    },
}

impl SimError {
    /// A [`SimError::Fit`].
    pub fn fit(garment: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Fit {
            garment: garment.into(),
            reason: reason.into(),
        }
    }

    /// A [`SimError::Blender`].
    pub(crate) fn blender(reason: impl Into<String>) -> Self {
        Self::Blender {
            reason: reason.into(),
        }
    }

    /// A [`SimError::Value`].
    pub fn value(
        name: impl Into<String>,
        expected: impl Into<String>,
        found: impl std::fmt::Display,
    ) -> Self {
        Self::Value {
            name: name.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }
}

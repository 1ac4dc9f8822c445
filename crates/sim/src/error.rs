//! The crate's one error type: what, where, expected, found, what to do.

use drape_dataset::sequence::Intersections;

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
    /// Too few frames are free of intersections.
    #[error(
        "frame {frame}: {} hits between garments, {} within garments, {} with the body; expected the first {needed} of {of} frames clean",
        found.between_garments, found.within_garments, found.with_body
    )]
    NotClean {
        /// First recorded frame that is not clean.
        frame: usize,
        /// What was counted in it.
        found: Intersections,
        /// Recorded frames.
        of: usize,
        /// How many of them have to be clean.
        needed: usize,
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

//! Why a picture could not be made.

use std::path::PathBuf;

use thiserror::Error;

/// What can go wrong while drawing or writing a picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewError {
    /// Nothing to draw.
    #[error("{what}: expected at least one {item}, found none")]
    Empty {
        /// The picture.
        what: &'static str,
        /// What it needs.
        item: &'static str,
    },
    /// A value of a plot is NaN or infinite.
    #[error(
        "{plot}, series \"{series}\", point {index}: ({x}, {y}) cannot be drawn; expected finite numbers"
    )]
    NotFinite {
        /// The plot.
        plot: String,
        /// The series.
        series: String,
        /// Point of the series, from 0.
        index: usize,
        /// Its first coordinate.
        x: f64,
        /// Its second coordinate.
        y: f64,
    },
    /// A value on a logarithmic axis is not positive.
    #[error(
        "{plot}, point \"{point}\": {value} {axis} cannot be on a logarithmic axis; expected a positive number"
    )]
    NotPositive {
        /// The plot.
        plot: String,
        /// The point.
        point: String,
        /// The axis.
        axis: &'static str,
        /// The value.
        value: f64,
    },
    /// Positions, faces or patch numbers do not fit together.
    #[error("{place}: expected {expected}, found {found}")]
    Mismatch {
        /// Garment, frame or row.
        place: String,
        /// What would fit.
        expected: String,
        /// What was given.
        found: String,
    },
    /// A mesh that cannot be drawn.
    #[error("{place}: {defect}")]
    Mesh {
        /// Garment, frame or row.
        place: String,
        /// The defect.
        defect: drape_geometry::GeometryError,
    },
    /// The plotting library refused.
    #[error("cannot draw {what}: {reason}")]
    Drawing {
        /// Picture or text.
        what: &'static str,
        /// What the library said.
        reason: String,
    },
    /// The file could not be written.
    #[error("cannot write {}: {reason}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        reason: png::EncodingError,
    },
}

impl ViewError {
    pub(crate) fn drawing(what: &'static str, reason: impl std::fmt::Display) -> Self {
        Self::Drawing {
            what,
            reason: reason.to_string(),
        }
    }
}

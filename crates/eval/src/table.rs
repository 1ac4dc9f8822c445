//! One table of methods and its four forms: console, Markdown, CSV, JSON.
//!
//! The console and Markdown forms hold what a person compares: error per kind
//! and overall, L- and H-collision, milliseconds per frame. CSV and JSON hold
//! everything, per kind as well, with units in the column names.

mod text;
mod values;

use serde::Serialize;

pub use text::{console, markdown};
pub use values::{csv, json};

use crate::tally::Summary;

/// Millimetres at the 10× scale in one real metre: the paper's unit of errors.
pub const MM_10X_PER_METRE: f64 = 10_000.0;
/// Millimetres in one real metre.
pub const MM_PER_METRE: f64 = 1_000.0;

/// A table of methods on the same rollouts.
#[derive(Clone, Debug)]
pub struct Table {
    /// What was measured.
    pub conditions: Conditions,
    /// Methods.
    pub rows: Vec<Row>,
}

/// What was measured and how.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// Folder of the data set.
    pub data: String,
    /// Hash of the data set; empty when it has no index.
    pub data_hash: String,
    /// Split.
    pub split: String,
    /// Sequences measured.
    pub sequences: usize,
    /// Frame whose garments are the last ones given.
    pub start: usize,
    /// Frames predicted per sequence.
    pub steps: usize,
    /// Things to know about rows, in the order of their marks.
    pub notes: Vec<String>,
}

/// One method.
#[derive(Clone, Debug)]
pub struct Row {
    /// Name.
    pub method: String,
    /// Threads used; `None` when nothing was timed.
    pub threads: Option<usize>,
    /// Milliseconds per frame: batch 1, warm; `None` when nothing was timed.
    pub ms_per_frame: Option<f64>,
    /// Measures; `None` when the method could not run (a note says why).
    pub summary: Option<Summary>,
    /// Index into [`Conditions::notes`].
    pub note: Option<usize>,
}

#[cfg(test)]
mod tests;

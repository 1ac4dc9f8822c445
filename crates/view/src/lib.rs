//! Pictures for people: contact sheets of shaded frames, patches in colour,
//! plots, and what a sequence file holds in words.
//!
//! | module | draws |
//! |---|---|
//! | [`raster`] | meshes, shaded |
//! | [`sheet`] | frames of one clip, or of several below each other |
//! | [`patches`] | patches as colours on the garments and in UV space |
//! | [`plot`] | loss curves; error against time |
//! | [`inspection`] | contents and checks of a sequence file, as text |
//! | [`picture`] | pixels, text, PNG |
//!
//! Everything is drawn on the processor without system fonts or a window; the
//! same input gives the same bytes. Nothing here computes a metric: numbers in
//! pictures come from the callers.

pub mod error;

pub mod inspection;
pub mod patches;
pub mod picture;
pub mod plot;
pub mod raster;
pub mod sheet;

pub use error::ViewError;
pub use picture::Picture;

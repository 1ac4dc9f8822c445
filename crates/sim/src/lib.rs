//! Bodies, motions, garments and the cloth engine that makes sequences.
//!
//! Pipeline: [`body`] gives a posed human, [`garment`] fits an outfit on it in
//! the fitting pose, [`motion`] moves it, [`engine`] drapes the garments on it
//! (or [`blender`], where it is installed), and [`scene`] puts them together: a
//! recipe in, a sequence out.
//! Units: scale 10 (1 unit = 0.1 m), Z up, the body faces −Y.

pub mod blender;
pub mod body;
pub mod engine;
pub mod error;
pub mod garment;
pub mod motion;
pub mod scene;

pub use error::{Result, SimError};

//! Layered garment sequences: files, data sets, patches, statistics, samples.
//!
//! Usable on its own: no tensors and no simulation in its tree. Three steps
//! from a file to numbers:
//!
//! ```no_run
//! use drape_dataset::SequenceReader;
//! use drape_dataset::patches::Patches;
//!
//! # fn main() -> drape_dataset::Result<()> {
//! // 1. Open: what is fixed for the whole sequence is in the header.
//! let sequence = SequenceReader::open("train_0007.mcap")?;
//! let header = sequence.header();
//! println!("{}: {} frames, {} fps", header.name, sequence.frame_count(), header.scene.fps);
//!
//! // 2. Read frames, in any order: positions are `[vertex, 3]`, absolute.
//! let frame = sequence.frame(12)?;
//! for (garment, positions) in header.garments.iter().zip(&frame.garments) {
//!     println!("{} (layer {}): [{}, 3]", garment.kind, garment.layer, positions.len());
//! }
//!
//! // 3. Cut the garments into patches of 5 cm, the particles of LayersNet.
//! let patches = Patches::of_outfit(&header.garments, 0.05 / header.scene.metres_per_uv)?;
//! println!("{} patches", patches.count());
//! # Ok(())
//! # }
//! ```
//!
//! Lengths are in scene units (10 to a metre by default), Z up. Everything that
//! is read has been checked: checksums, shapes, indices, finite numbers. An
//! error says in which file, frame, garment and vertex, what was expected and
//! what was found.
//!
//! | to … | use |
//! |---|---|
//! | write a sequence | [`SequenceWriter`] |
//! | read a sequence | [`SequenceReader`] |
//! | know the fields | [`sequence`], [`registry`] |
//! | keep sequences as a data set with splits | [`splits::DatasetIndex`] |
//! | take a garment from or to OBJ | [`obj`] |
//! | import D-LAYERS, with SMPL bodies | [`import::d_layers`], [`import::smpl`] |
//! | import Blender cloth exports | [`import`] (feature `npz`), program `drape-import` (feature `cli`) for both |
//! | count intersections of a frame | [`intersections`] |
//! | cut garments into patches | [`patches`] |
//! | normalise, and draw training samples | [`statistics`], [`sample`] |
//!
//! The files' format is normative in `data-spec/README.md` of the repository.

mod atomic;
mod check;
mod error;
pub mod file;
pub mod import;
pub mod intersections;
pub mod obj;
pub mod order;
pub mod panels;
pub mod patches;
pub mod random;
pub mod registry;
pub mod sample;
pub mod samples;
pub mod sequence;
pub mod splits;
pub mod statistics;

pub use error::{DatasetError, Result};
pub use file::{SequenceReader, SequenceWriter};

//! Layered garment sequences: files, data sets, patches, statistics, samples.
//!
//! Usable on its own: no tensors and no simulation in its tree.
//!
//! # From an OBJ file to patched samples
//!
//! The whole way, as a program that runs (`examples/obj_to_samples.rs`): a garment from
//! an OBJ file, a sequence of frames written to a file, the file listed in a data set,
//! samples with the garment cut into patches, the particles of LayersNet.
//!
//! ```
#![doc = include_str!("../examples/obj_to_samples.rs")]
//! ```
//!
//! What happened on the way:
//!
//! - Reading the OBJ refused what cannot be a garment, with its line, and noted what may
//!   not be meant so: here, that a face of four corners was cut in two.
//! - The file got its name when it was complete, and not before. Reading it compares
//!   checksums, shapes, indices and numbers, so what you get needs no check of its own.
//! - [`samples::Samples`] gathered the statistics that states are normalised by, and
//!   draws every place of every sequence once an epoch, in an order that depends on the
//!   seed alone. A checkpoint keeps `order.progress()`.
//! - A [`sample::Sample`] has the start state relative to the body's root, what drives
//!   each step (body, wind, gravity) and the reference after it; [`sample::Outfit`] has
//!   faces, patches, their neighbours and their material attributes;
//!   [`world_edges::WorldEdges`] is who else is near whom at one instant.
//!
//! More examples: `read_frames`, `copy_for_viewing`, `save_whole_frames`,
//! `go_on_drawing`, `d_layers_to_samples`; and `plot_vertex.py`, which reads a file with
//! Python.
//!
//! # Conventions
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
//! | make a smaller copy for viewing | [`file::Storage`] |
//! | save what is whole of a broken file | [`file::recover`] |
//! | know the fields | [`sequence`], [`registry`] |
//! | keep sequences as a data set with splits | [`splits::DatasetIndex`] |
//! | take a garment from or to OBJ | [`obj`] |
//! | import D-LAYERS, with SMPL bodies | [`import::d_layers`], [`import::smpl`] |
//! | import Blender cloth exports | [`import`] (feature `npz`), program `drape-import` (feature `cli`) for both |
//! | count intersections of a frame | [`intersections`] |
//! | cut garments into patches | [`patches`] |
//! | know which patches see each other, or the body, across a gap | [`world_edges`] |
//! | draw training samples, shuffled, and go on later | [`samples`], [`order`] |
//! | know what a sample holds, and how it is normalised | [`sample`], [`statistics`] |
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
pub mod support;
pub mod world_edges;

pub use error::{DatasetError, Result};
pub use file::{SequenceReader, SequenceWriter};

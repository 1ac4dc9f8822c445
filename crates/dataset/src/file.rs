//! Sequence files: one MCAP file a sequence, format 1 (`data-spec/README.md`).
//!
//! [`SequenceWriter`] streams frames into a file that appears under its name
//! only when it is complete; [`SequenceReader`] opens one, checks it and hands
//! out frames in any order, from any thread, without holding more than one
//! frame's bytes; [`recover`] saves what is whole in a broken one.

mod container;
mod messages;
mod positional;
mod reader;
mod recover;
mod writer;

pub use reader::SequenceReader;
pub use recover::{Saved, recover};
pub use writer::SequenceWriter;

/// Major version of the format: readers refuse a higher one.
pub const FORMAT_MAJOR: u32 = 1;
/// Minor version of the format: grows when fields are added.
pub const FORMAT_MINOR: u32 = 0;

/// Topic of the one header message.
const HEADER_TOPIC: &str = "/drape/header";
/// Topic of the frame messages.
const FRAME_TOPIC: &str = "/drape/frame";
/// Protobuf message of each topic.
const HEADER_SCHEMA: &str = "drape.SequenceHeader";
const FRAME_SCHEMA: &str = "drape.Frame";
/// MCAP names of the encodings.
const PROTOBUF: &str = "protobuf";
/// Serialised `FileDescriptorSet` of `drape.proto`, stored in the schema records.
const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/drape.binpb"));

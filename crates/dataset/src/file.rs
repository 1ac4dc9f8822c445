//! Sequence files: one MCAP file a sequence, format 1 (`data-spec/README.md`).
//!
//! [`SequenceWriter`] streams frames into a file that appears under its name
//! only when it is complete; [`SequenceReader`] opens one, checks it and hands
//! out frames in any order, from any thread, without holding more than one
//! frame's bytes, exact or, for viewing, quantised ([`Storage`]); [`recover`] saves what is whole in a broken one.

mod container;
mod messages;
mod positional;
mod quantised;
mod reader;
mod records;
mod recover;
mod writer;

pub use quantised::Storage;
pub use reader::SequenceReader;
pub use recover::{Saved, recover};
pub use writer::SequenceWriter;

/// Major version of the format: readers refuse a higher one.
pub const FORMAT_MAJOR: u32 = 1;
/// Minor version of the format: grows when fields are added.
pub const FORMAT_MINOR: u32 = 1;
/// Minor version that exact files and indexes of data sets need; 1 has quantised ones.
pub(crate) const EXACT_MINOR: u32 = 0;

/// MCAP's name of the encoding.
const PROTOBUF: &str = "protobuf";

/// What stands on a topic.
struct MessageKind {
    topic: &'static str,
    /// Protobuf message.
    schema: &'static str,
    /// Serialised `FileDescriptorSet`, stored in the schema record.
    descriptors: &'static [u8],
}

/// The one header message.
const HEADER: MessageKind = MessageKind {
    topic: "/drape/header",
    schema: "drape.SequenceHeader",
    descriptors: include_bytes!(concat!(env!("OUT_DIR"), "/drape.binpb")),
};
/// A frame, exact.
const FRAME: MessageKind = MessageKind {
    topic: "/drape/frame",
    schema: "drape.Frame",
    ..HEADER
};
/// A frame, quantised.
const QUANTISED_FRAME: MessageKind = MessageKind {
    topic: "/drape/quantised_frame",
    schema: "drape.QuantisedFrame",
    descriptors: include_bytes!(concat!(env!("OUT_DIR"), "/quantised.binpb")),
};

//! Reading a sequence file: every byte that is used has been checked.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap::records::ChunkIndex;
use prost::Message;
use prost::bytes::Bytes;

use super::container::{Summary, check_data, corrupt, read_message};
use super::messages::{self, proto};
use super::recover::Whole;
use super::{FORMAT_MAJOR, FRAME_SCHEMA, FRAME_TOPIC, HEADER_SCHEMA, HEADER_TOPIC};
use crate::error::{DatasetError, Result};
use crate::sequence::{Frame, SequenceHeader};

/// An open sequence file.
///
/// Reads by position: all methods take `&self` and may be called from many
/// threads at once; memory is one frame a call.
#[derive(Debug)]
pub struct SequenceReader {
    path: PathBuf,
    file: File,
    header: SequenceHeader,
    /// Where the data section ends and the summary begins.
    summary_start: u64,
    frame_channel: u16,
    frames: Vec<ChunkIndex>,
}

impl SequenceReader {
    /// Opens a file, checks its index and its header.
    ///
    /// # Errors
    /// Missing file, not a sequence, truncated, damaged, written by a newer
    /// major version, or a header that breaks a rule.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref().to_path_buf();
        let file = File::open(&path).map_err(DatasetError::io("open", &path))?;
        let summary = Summary::read(&path, &file).map_err(|error| saveable(error, &file))?;
        let header_channel = summary.channel(&path, HEADER_TOPIC, HEADER_SCHEMA)?;
        let frame_channel = summary.channel(&path, FRAME_TOPIC, FRAME_SCHEMA)?;
        let mut headers = Vec::new();
        let mut frames = Vec::new();
        for chunk in summary.chunks {
            if chunk.message_index_offsets.contains_key(&frame_channel) {
                frames.push(chunk);
            } else if chunk.message_index_offsets.contains_key(&header_channel) {
                headers.push(chunk);
            }
        }
        let [header_chunk] = headers.as_slice() else {
            return Err(DatasetError::NotASequence {
                path,
                expected: format!("one message on {HEADER_TOPIC}"),
                found: format!("{} chunks with such messages", headers.len()),
            });
        };
        if frames.is_empty() {
            return Err(DatasetError::NotASequence {
                path,
                expected: format!("messages on {FRAME_TOPIC}"),
                found: "none".into(),
            });
        }
        let (_, bytes) = read_message(&path, &file, header_chunk, header_channel, "the header")?;
        let header = decode_header(&path, bytes)?;
        Ok(Self {
            path,
            file,
            header,
            summary_start: summary.start,
            frame_channel,
            frames,
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is fixed for the whole sequence.
    pub fn header(&self) -> &SequenceHeader {
        &self.header
    }

    /// Number of frames.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// Reads frame `index`, in any order; its checksum and shapes are checked.
    pub fn frame(&self, index: usize) -> Result<Frame> {
        let chunk = self
            .frames
            .get(index)
            .ok_or_else(|| DatasetError::FrameOutOfRange {
                path: self.path.clone(),
                frame: index,
                frame_count: self.frames.len(),
            })?;
        let place = format!("frame {index}");
        let (head, bytes) =
            read_message(&self.path, &self.file, chunk, self.frame_channel, &place)?;
        let message = proto::Frame::decode(bytes)
            .map_err(|error| corrupt(&self.path, &place, "a Frame message", error.to_string()))?;
        if message.index != index as u64 || head.sequence as usize != index {
            let found = format!("index {}, sequence {}", message.index, head.sequence);
            return Err(corrupt(&self.path, &place, format!("index {index}"), found));
        }
        messages::frame_from_message(message)
            .and_then(|frame| frame.check(&self.header).map(|()| frame))
            .map_err(|error| error.at(&place).in_file(&self.path))
    }

    /// Reads the frames of `range` one after the other.
    pub fn frames(&self, range: Range<usize>) -> impl Iterator<Item = Result<Frame>> + '_ {
        range.map(|index| self.frame(index))
    }

    /// Compares the checksum over all bytes of the file, those that reading never
    /// uses included: any changed bit is found. Reads the whole file; frames are
    /// checked against the format's rules as they are read, not here.
    ///
    /// # Errors
    /// Something changed since the file was written, or its writer left the checksum out.
    pub fn check_bytes(&self) -> Result<()> {
        check_data(&self.path, &self.file, self.summary_start)
    }

    /// Reads all frames into memory.
    pub fn read_all(&self) -> Result<Vec<Frame>> {
        self.frames(0..self.frame_count()).collect()
    }
}

/// Says what of a truncated file can be saved.
fn saveable(error: DatasetError, file: &File) -> DatasetError {
    let DatasetError::Truncated { path, reason, .. } = error else {
        return error;
    };
    let saveable = match Whole::find(&path, file) {
        Err(_) => String::new(),
        Ok(whole) if !whole.saves_something() => format!("; {}", whole.summary()),
        Ok(whole) => format!(
            "; {}, `cargo xtask inspect FILE --recover OUT` saves them",
            whole.summary()
        ),
    };
    DatasetError::Truncated {
        path,
        reason,
        saveable,
    }
}

pub(super) fn decode_header(path: &Path, bytes: Bytes) -> Result<SequenceHeader> {
    let undecodable = |error: prost::DecodeError| {
        corrupt(
            path,
            "the header",
            "a SequenceHeader message",
            error.to_string(),
        )
    };
    // The version alone first: the rest of a newer major may not even decode.
    let version = proto::FormatVersion::decode(bytes.clone()).map_err(undecodable)?;
    let found = format!("{}.{}", version.format_major, version.format_minor);
    if version.format_major > FORMAT_MAJOR {
        let path = path.into();
        return Err(DatasetError::NewerFormat {
            path,
            found,
            supported: FORMAT_MAJOR,
        });
    }
    if version.format_major == 0 {
        return Err(corrupt(
            path,
            "the header",
            "a format version from 1.0 on",
            found,
        ));
    }
    let message = proto::SequenceHeader::decode(bytes).map_err(undecodable)?;
    messages::header_from_message(message)
        .and_then(|header| header.check().map(|()| header))
        .map_err(|error| error.at("header").in_file(path))
}

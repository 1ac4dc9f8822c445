//! Reading a sequence file: every byte that is used has been checked.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use prost::Message;
use prost::bytes::Bytes;

use super::container::{Summary, check_data, corrupt, read_message};
use super::messages::{self, proto};
use super::quantised::{Dequantiser, MAX_SINCE_KEY, Storage};
use super::records::ChunkPlace;
use super::recover::Whole;
use super::{FORMAT_MAJOR, FRAME, HEADER, QUANTISED_FRAME};
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
    storage: Storage,
    /// Where the data section ends and the summary begins.
    summary_start: u64,
    frame_channel: u16,
    frames: Vec<ChunkPlace>,
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
        let header_channel = summary.channel(&path, &HEADER)?;
        // A file with neither kind of frames is told of the exact one.
        let quantised = summary.has(&QUANTISED_FRAME) && !summary.has(&FRAME);
        let kind = if quantised { &QUANTISED_FRAME } else { &FRAME };
        let frame_channel = summary.channel(&path, kind)?;
        let mut headers = Vec::new();
        let mut frames = Vec::new();
        for chunk in summary.chunks {
            if chunk.channels.contains(&frame_channel) {
                frames.push(chunk);
            } else if chunk.channels.contains(&header_channel) {
                headers.push(chunk);
            }
        }
        let [header_chunk] = headers.as_slice() else {
            return Err(DatasetError::NotASequence {
                path,
                expected: format!("one message on {}", HEADER.topic),
                found: format!("{} chunks with such messages", headers.len()),
            });
        };
        if frames.is_empty() {
            return Err(DatasetError::NotASequence {
                path,
                expected: format!("messages on {}", kind.topic),
                found: "none".into(),
            });
        }
        let (_, bytes) = read_message(&path, &file, header_chunk, header_channel, "the header")?;
        let header = decode_header(&path, bytes)?;
        let mut reader = Self {
            path,
            file,
            header,
            storage: Storage::Exact,
            summary_start: summary.start,
            frame_channel,
            frames,
        };
        if quantised {
            let max_error_m = reader.message::<proto::QuantisedFrame>(0)?.max_error_m;
            if !(max_error_m.is_finite() && max_error_m > 0.0) {
                let found = max_error_m.to_string();
                return Err(
                    DatasetError::invalid("max_error_m", "a number above 0", found)
                        .at("frame 0")
                        .in_file(&reader.path),
                );
            }
            reader.storage = Storage::Quantised { max_error_m };
        }
        Ok(reader)
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

    /// How positions are stored, and how far they may be off.
    pub fn storage(&self) -> Storage {
        self.storage
    }

    /// Reads frame `index`, in any order; its checksum and shapes are checked.
    ///
    /// Of a quantised file this reads the frames since the last key frame too; frames
    /// in order come at one read each from [`frames`](Self::frames).
    pub fn frame(&self, index: usize) -> Result<Frame> {
        self.frame_after(index, &mut Dequantiser::new(&self.header))
    }

    /// Reads the frames of `range` one after the other.
    pub fn frames(&self, range: Range<usize>) -> impl Iterator<Item = Result<Frame>> + '_ {
        let mut last = Dequantiser::new(&self.header);
        range.map(move |index| self.frame_after(index, &mut last))
    }

    /// Frame `index`; `last` may hold the frame before, and holds this one afterwards.
    fn frame_after(&self, index: usize, last: &mut Dequantiser) -> Result<Frame> {
        let named = |error: DatasetError| {
            let place = format!("frame {index}");
            error.at(&place).in_file(&self.path)
        };
        if self.storage == Storage::Exact {
            let message: proto::Frame = self.message(index)?;
            return messages::frame_from_message(message)
                .and_then(|frame| frame.check(&self.header).map(|()| frame))
                .map_err(named);
        }
        let message: proto::QuantisedFrame = self.message(index)?;
        if !last.follows(index, &message) {
            let since_key = message.since_key.min(MAX_SINCE_KEY) as usize;
            for before in index.saturating_sub(since_key)..index {
                last.take(before, &self.message(before)?).map_err(named)?;
            }
        }
        last.take(index, &message)
            .and_then(|()| last.frame(message))
            .map_err(named)
    }

    /// The message of frame `index`, whose checksum and index are right.
    fn message<M: FrameMessage>(&self, index: usize) -> Result<M> {
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
        let message = M::decode(bytes)
            .map_err(|error| corrupt(&self.path, &place, "a frame message", error.to_string()))?;
        if message.index() != index as u64 || head.sequence as usize != index {
            let found = format!("index {}, sequence {}", message.index(), head.sequence);
            return Err(corrupt(&self.path, &place, format!("index {index}"), found));
        }
        Ok(message)
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

/// The two kinds of frames.
trait FrameMessage: Message + Default {
    fn index(&self) -> u64;
}

impl FrameMessage for proto::Frame {
    fn index(&self) -> u64 {
        self.index
    }
}

impl FrameMessage for proto::QuantisedFrame {
    fn index(&self) -> u64 {
        self.index
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

//! Reading a sequence file: every byte that is used has been checked.
//!
//! MCAP readers do not compare checksums unless asked, so this one goes
//! through the index itself: the summary's CRC when opening, the chunk's CRC at
//! every access. Bytes that no checksum covers (message indexes, chunk times)
//! are never used.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap::records::{ChunkIndex, MessageHeader, Record, op};
use prost::Message;
use prost::bytes::Bytes;

use super::messages::{self, proto};
use super::positional::read_at;
use super::{FORMAT_MAJOR, FRAME_SCHEMA, FRAME_TOPIC, HEADER_SCHEMA, HEADER_TOPIC, PROTOBUF};
use crate::error::{DatasetError, Result};
use crate::sequence::{Frame, SequenceHeader};

/// Opcode and length before each record.
const RECORD_HEAD: usize = 9;
/// Footer record: head, summary start, summary offset start, CRC.
const FOOTER: usize = RECORD_HEAD + 8 + 8 + 4;

/// An open sequence file.
///
/// Reads by position: all methods take `&self` and may be called from many
/// threads at once; memory is one frame a call.
#[derive(Debug)]
pub struct SequenceReader {
    path: PathBuf,
    file: File,
    header: SequenceHeader,
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
        let summary = Summary::read(&path, &file)?;
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

    /// Reads all frames into memory.
    pub fn read_all(&self) -> Result<Vec<Frame>> {
        self.frames(0..self.frame_count()).collect()
    }
}

/// The file's index, from the summary section at its end.
struct Summary {
    channels: Vec<mcap::records::Channel>,
    schemas: Vec<mcap::records::SchemaHeader>,
    chunks: Vec<ChunkIndex>,
}

impl Summary {
    fn read(path: &Path, file: &File) -> Result<Self> {
        let read = |offset: u64, length: usize| {
            read_at(file, offset, length).map_err(DatasetError::io("read", path))
        };
        let size = file
            .metadata()
            .map_err(DatasetError::io("read", path))?
            .len();
        let magic = mcap::MAGIC;
        let start = read(0, magic.len().min(size as usize))?;
        if start.is_empty() || !magic.starts_with(&start) {
            return Err(DatasetError::NotASequence {
                path: path.into(),
                expected: "an MCAP file".into(),
                found: match start.len() {
                    0 => "an empty file".into(),
                    _ => format!("a file that starts with {start:02x?}"),
                },
            });
        }
        let truncated = |reason: &str| DatasetError::Truncated {
            path: path.into(),
            reason: format!("{reason} ({size} bytes are there)"),
        };
        let tail_len = FOOTER + magic.len();
        if size < (magic.len() + tail_len) as u64 {
            return Err(truncated("the index at the end is missing"));
        }
        let footer_start = size - tail_len as u64;
        let tail = read(footer_start, tail_len)?;
        if tail[FOOTER..] != *magic {
            return Err(truncated("the end mark and the index are missing"));
        }
        let Ok(Record::Footer(footer)) = mcap::parse_record(op::FOOTER, &tail[RECORD_HEAD..FOOTER])
        else {
            return Err(truncated("the footer is missing"));
        };
        if footer.summary_start == 0 || footer.summary_start > footer_start {
            let found = format!("an offset of {}", footer.summary_start);
            return Err(corrupt(
                path,
                "the footer",
                "an index inside the file",
                found,
            ));
        }
        let length = (footer_start - footer.summary_start) as usize;
        let summary = read(footer.summary_start, length)?;
        let mut crc = crc32fast::Hasher::new();
        crc.update(&summary);
        crc.update(&tail[..FOOTER - 4]);
        check_crc(path, "the index", footer.summary_crc, crc.finalize())?;

        let mut index = Self {
            channels: Vec::new(),
            schemas: Vec::new(),
            chunks: Vec::new(),
        };
        let mut rest = summary.as_slice();
        while !rest.is_empty() {
            match next_record(&mut rest) {
                Some(Record::Channel(channel)) => index.channels.push(channel),
                Some(Record::Schema { header, .. }) => index.schemas.push(header),
                Some(Record::ChunkIndex(chunk)) => index.chunks.push(chunk),
                Some(_) => {}
                None => return Err(corrupt(path, "the index", "MCAP records", "other bytes")),
            }
        }
        index.chunks.sort_by_key(|chunk| chunk.chunk_start_offset);
        Ok(index)
    }

    /// Id of the channel of `topic`, which must carry `schema` as protobuf.
    fn channel(&self, path: &Path, topic: &str, schema: &str) -> Result<u16> {
        let error = |expected: String, found: String| DatasetError::NotASequence {
            path: path.into(),
            expected,
            found,
        };
        let Some(channel) = self.channels.iter().find(|channel| channel.topic == topic) else {
            let topics: Vec<_> = self.channels.iter().map(|c| c.topic.as_str()).collect();
            return Err(error(
                format!("topic {topic}"),
                format!("topics {topics:?}"),
            ));
        };
        let found = self
            .schemas
            .iter()
            .find(|header| header.id == channel.schema_id)
            .map_or("no schema", |header| header.name.as_str());
        if found != schema || channel.message_encoding != PROTOBUF {
            return Err(error(
                format!("{schema} in {PROTOBUF} on {topic}"),
                format!("{found} in {}", channel.message_encoding),
            ));
        }
        Ok(channel.id)
    }
}

/// Reads the one message of a chunk and compares the chunk's CRC.
fn read_message(
    path: &Path,
    file: &File,
    chunk: &ChunkIndex,
    channel: u16,
    place: &str,
) -> Result<(MessageHeader, Bytes)> {
    let size = file
        .metadata()
        .map_err(DatasetError::io("read", path))?
        .len();
    let end = chunk.chunk_start_offset.checked_add(chunk.chunk_length);
    if chunk.chunk_length < RECORD_HEAD as u64 || end.is_none_or(|end| end > size) {
        let found = format!(
            "{} bytes at {}",
            chunk.chunk_length, chunk.chunk_start_offset
        );
        return Err(corrupt(path, place, "a chunk inside the file", found));
    }
    let bytes = read_at(file, chunk.chunk_start_offset, chunk.chunk_length as usize)
        .map_err(DatasetError::io("read", path))?;
    let bytes = Bytes::from(bytes);
    let mut rest = &bytes[..];
    let (Some(Record::Chunk { header, data }), true) = (next_record(&mut rest), rest.is_empty())
    else {
        return Err(corrupt(path, place, "one MCAP chunk", "other bytes"));
    };
    if !header.compression.is_empty() {
        return Err(DatasetError::NotASequence {
            path: path.into(),
            expected: "uncompressed chunks".into(),
            found: format!("compression {:?}", header.compression),
        });
    }
    check_crc(path, place, header.uncompressed_crc, crc32fast::hash(&data))?;
    let mut found = None;
    let mut records: &[u8] = &data;
    while !records.is_empty() {
        match next_record(&mut records) {
            Some(Record::Message { header, data }) if header.channel_id == channel => {
                if found.replace((header, bytes.slice_ref(&data))).is_some() {
                    return Err(corrupt(path, place, "one message a chunk", "several"));
                }
            }
            Some(_) => {}
            None => return Err(corrupt(path, place, "MCAP records", "other bytes")),
        }
    }
    found.ok_or_else(|| corrupt(path, place, "a message", "none"))
}

/// Takes the first record off `bytes`; `None` when there is none.
fn next_record<'a>(bytes: &mut &'a [u8]) -> Option<Record<'a>> {
    let (&opcode, rest) = bytes.split_first()?;
    let (length, rest) = rest.split_first_chunk::<8>()?;
    let (body, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    *bytes = rest;
    match opcode {
        // The parser assumes that an attachment has at least its four CRC bytes.
        op::ATTACHMENT => Some(Record::Unknown {
            opcode,
            data: body.into(),
        }),
        _ => mcap::parse_record(opcode, body).ok(),
    }
}

fn decode_header(path: &Path, bytes: Bytes) -> Result<SequenceHeader> {
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

fn check_crc(path: &Path, place: &str, stored: u32, computed: u32) -> Result<()> {
    if stored == computed {
        return Ok(());
    }
    Err(corrupt(
        path,
        place,
        format!("CRC {stored:08x}"),
        format!("{computed:08x}"),
    ))
}

fn corrupt(
    path: &Path,
    place: &str,
    expected: impl Into<String>,
    found: impl Into<String>,
) -> DatasetError {
    DatasetError::Corrupt {
        path: path.into(),
        place: place.into(),
        expected: expected.into(),
        found: found.into(),
    }
}

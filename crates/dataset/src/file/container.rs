//! The MCAP container, as far as sequences use it: the index at the end of the
//! file and the chunks of one message each.
//!
//! MCAP readers do not compare checksums unless asked, so this file goes
//! through the index itself: the summary's CRC when opening, the chunk's CRC at
//! every access. Bytes that no checksum covers (message indexes, chunk times)
//! are never used.

use std::fs::File;
use std::io;
use std::path::Path;

use mcap::records::op;
use prost::bytes::Bytes;

use super::positional::read_at;
use super::records::{ChunkPlace, MessageHead, RECORD_HEAD, Record, next_record};
use super::{MessageKind, PROTOBUF};
use crate::error::{DatasetError, Result};

/// Head of an uncompressed chunk: record head, two times, size, CRC, empty
/// name of a compression, size again.
pub(super) const CHUNK_HEAD: usize = RECORD_HEAD + 8 + 8 + 8 + 4 + 4 + 8;
/// How much is hashed at once.
const BLOCK: u64 = 1 << 20;
/// End of the data section: record head, CRC of all before it.
const DATA_END: usize = RECORD_HEAD + 4;
/// Footer record: head, summary start, summary offset start, CRC.
const FOOTER: usize = RECORD_HEAD + 8 + 8 + 4;

#[derive(Debug)]
struct Channel {
    id: u16,
    schema_id: u16,
    topic: String,
    encoding: String,
}

/// The file's index, from the summary section at its end.
#[derive(Debug)]
pub(super) struct Summary {
    channels: Vec<Channel>,
    /// Ids and names.
    schemas: Vec<(u16, String)>,
    /// Chunks in the file's order.
    pub(super) chunks: Vec<ChunkPlace>,
    /// Where the data section ends and the summary begins.
    pub(super) start: u64,
}

impl Summary {
    /// Reads and checks the summary section.
    pub(super) fn read(path: &Path, file: &File) -> Result<Self> {
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
            saveable: String::new(),
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
        let Some(Record::Footer { summary_start, crc }) = next_record(&mut &tail[..FOOTER]) else {
            return Err(truncated("the footer is missing"));
        };
        if summary_start == 0 || summary_start > footer_start {
            let found = format!("an offset of {}", summary_start);
            return Err(corrupt(
                path,
                "the footer",
                "an index inside the file",
                found,
            ));
        }
        let length = (footer_start - summary_start) as usize;
        let summary = read(summary_start, length)?;
        let mut computed = crc32fast::Hasher::new();
        computed.update(&summary);
        computed.update(&tail[..FOOTER - 4]);
        check_crc(path, "the index", crc, computed.finalize())?;

        let mut index = Self {
            channels: Vec::new(),
            schemas: Vec::new(),
            chunks: Vec::new(),
            start: summary_start,
        };
        let mut rest = summary.as_slice();
        while !rest.is_empty() {
            match next_record(&mut rest) {
                Some(Record::Channel {
                    id,
                    schema_id,
                    topic,
                    encoding,
                }) => index.channels.push(Channel {
                    id,
                    schema_id,
                    topic: topic.to_owned(),
                    encoding: encoding.to_owned(),
                }),
                Some(Record::Schema { id, name }) => index.schemas.push((id, name.to_owned())),
                Some(Record::ChunkIndex(chunk)) => index.chunks.push(chunk),
                Some(_) => {}
                None => return Err(corrupt(path, "the index", "MCAP records", "other bytes")),
            }
        }
        index.chunks.sort_by_key(|chunk| chunk.start);
        Ok(index)
    }

    /// Whether there is a channel of this topic.
    pub(super) fn has(&self, kind: &MessageKind) -> bool {
        self.channels
            .iter()
            .any(|channel| channel.topic == kind.topic)
    }

    /// Id of the channel of a topic, which must carry its schema as protobuf.
    pub(super) fn channel(&self, path: &Path, kind: &MessageKind) -> Result<u16> {
        let MessageKind { topic, schema, .. } = *kind;
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
            .find(|(id, _)| *id == channel.schema_id)
            .map_or("no schema", |(_, name)| name.as_str());
        if found != schema || channel.encoding != PROTOBUF {
            return Err(error(
                format!("{schema} in {PROTOBUF} on {topic}"),
                format!("{found} in {}", channel.encoding),
            ));
        }
        Ok(channel.id)
    }
}

/// Compares the checksum over the data section, which covers every byte before
/// the summary at `summary_start`; the summary's own was compared when it was read.
pub(super) fn check_data(path: &Path, file: &File, summary_start: u64) -> Result<()> {
    let place = "the data section";
    let end = summary_start.checked_sub(DATA_END as u64);
    let end = end.ok_or_else(|| corrupt(path, place, "records", "none"))?;
    let io = DatasetError::io("read", path);
    let hash = || -> io::Result<(u32, Vec<u8>)> {
        let mut crc = crc32fast::Hasher::new();
        let mut at = 0;
        while at < end {
            let block = read_at(file, at, (end - at).min(BLOCK) as usize)?;
            crc.update(&block);
            at += block.len() as u64;
        }
        Ok((crc.finalize(), read_at(file, end, DATA_END)?))
    };
    let (computed, last) = hash().map_err(io)?;
    let head = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
    let (found, stored) = last.split_at(RECORD_HEAD);
    if found != head {
        let found = format!("{found:02x?}");
        return Err(corrupt(
            path,
            place,
            "its end right before the index",
            found,
        ));
    }
    let stored = stored
        .try_into()
        .map(u32::from_le_bytes)
        .unwrap_or_default();
    if stored == 0 {
        return Err(corrupt(path, place, "a CRC", "none"));
    }
    check_crc(path, place, stored, computed)
}

/// Reads the one message of a chunk and compares the chunk's CRC.
pub(super) fn read_message(
    path: &Path,
    file: &File,
    chunk: &ChunkPlace,
    channel: u16,
    place: &str,
) -> Result<(MessageHead, Bytes)> {
    let size = file
        .metadata()
        .map_err(DatasetError::io("read", path))?
        .len();
    let end = chunk.start.checked_add(chunk.length);
    if chunk.length < RECORD_HEAD as u64 || end.is_none_or(|end| end > size) {
        let found = format!("{} bytes at {}", chunk.length, chunk.start);
        return Err(corrupt(path, place, "a chunk inside the file", found));
    }
    let bytes = read_at(file, chunk.start, chunk.length as usize)
        .map_err(DatasetError::io("read", path))?;
    let bytes = Bytes::from(bytes);
    let mut rest = &bytes[..];
    let (
        Some(Record::Chunk {
            crc,
            compression,
            records,
        }),
        true,
    ) = (next_record(&mut rest), rest.is_empty())
    else {
        return Err(corrupt(path, place, "one MCAP chunk", "other bytes"));
    };
    if !compression.is_empty() {
        return Err(DatasetError::NotASequence {
            path: path.into(),
            expected: "uncompressed chunks".into(),
            found: format!("compression {compression:?}"),
        });
    }
    check_crc(path, place, crc, crc32fast::hash(records))?;
    let Some(messages) = messages_in(&bytes, records) else {
        return Err(corrupt(path, place, "MCAP records", "other bytes"));
    };
    let mut messages = messages
        .into_iter()
        .filter(|(head, _)| head.channel == channel);
    let found = messages.next();
    if messages.next().is_some() {
        return Err(corrupt(path, place, "one message a chunk", "several"));
    }
    found.ok_or_else(|| corrupt(path, place, "a message", "none"))
}

/// Messages of an uncompressed chunk; `None` if its structure or its CRC is broken.
pub(super) fn messages_of_chunk(chunk: &Bytes) -> Option<Vec<(MessageHead, Bytes)>> {
    let mut rest = &chunk[..];
    let Record::Chunk {
        crc,
        compression,
        records,
    } = next_record(&mut rest)?
    else {
        return None;
    };
    let sound = rest.is_empty() && compression.is_empty() && crc == crc32fast::hash(records);
    sound.then(|| messages_in(chunk, records))?
}

/// Messages of the records `data`, which are a part of `chunk`.
fn messages_in(chunk: &Bytes, data: &[u8]) -> Option<Vec<(MessageHead, Bytes)>> {
    let mut messages = Vec::new();
    let mut records = data;
    while !records.is_empty() {
        if let Record::Message { head, data } = next_record(&mut records)? {
            messages.push((head, chunk.slice_ref(data)));
        }
    }
    Some(messages)
}

/// Length of the uncompressed chunk that starts with `head`, if one can start so:
/// its three sizes must agree, which other bytes hardly do.
pub(super) fn plausible_chunk(head: &[u8]) -> Option<u64> {
    let word = |at: usize| Some(u64::from_le_bytes(*head.get(at..)?.first_chunk()?));
    let (length, size) = (word(1)?, word(RECORD_HEAD + 16)?);
    let uncompressed = head[RECORD_HEAD + 28..RECORD_HEAD + 32] == [0; 4];
    let body = length.checked_sub((CHUNK_HEAD - RECORD_HEAD) as u64)?;
    let sound =
        head[0] == op::CHUNK && uncompressed && body == size && word(RECORD_HEAD + 32)? == size;
    sound.then(|| length.checked_add(RECORD_HEAD as u64))?
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

/// Damage in a part of the file.
pub(super) fn corrupt(
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

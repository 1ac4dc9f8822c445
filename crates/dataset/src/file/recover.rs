//! Saving what is whole in a file that is cut, unfinished or damaged.
//!
//! Nothing here trusts the index: the file is searched from its start for chunks
//! whose structure and CRC are sound, and what they hold is told by decoding it: the
//! first sound header, then every frame that fits it. A damaged place costs the
//! chunks that it touches, not those behind it.

use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use prost::Message;
use prost::bytes::Bytes;

use super::container::{CHUNK_HEAD, messages_of_chunk, plausible_chunk};
use super::messages::{self, proto};
use super::positional::read_at;
use super::reader::decode_header;
use super::writer::SequenceWriter;
use crate::error::{DatasetError, Result};
use crate::sequence::{Frame, SequenceHeader};

/// How far the search for the next chunk reads at once.
const BLOCK: usize = 1 << 16;

/// A file that [`recover`] wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Saved {
    /// The file.
    pub path: PathBuf,
    /// Frames of the damaged file that it holds; its own count from 0.
    pub frames: Range<usize>,
}

/// Writes all whole frames of `damaged` to `out`.
///
/// A sequence has no gaps: frames behind a lost one go to a file of their own,
/// `NAME.from_N.mcap` beside `out`. Each file's warnings say where its frames are from.
///
/// # Errors
/// The header or all frames are lost, `out` is `damaged` itself, or the disk fails.
pub fn recover(damaged: impl AsRef<Path>, out: impl AsRef<Path>) -> Result<Vec<Saved>> {
    let (damaged, out) = (damaged.as_ref(), out.as_ref());
    let file = File::open(damaged).map_err(DatasetError::io("open", damaged))?;
    let same = |a: &Path, b: &Path| Some(a.canonicalize().ok()? == b.canonicalize().ok()?);
    if same(damaged, out) == Some(true) {
        let expected = "another file than the damaged one";
        return Err(DatasetError::invalid("output", expected, "the same file").in_file(out));
    }
    let whole = Whole::find(damaged, &file)?;
    let Some(header) = whole.header.as_ref().filter(|_| !whole.frames.is_empty()) else {
        let found = whole.summary();
        let expected = "a whole header and at least one whole frame";
        return Err(DatasetError::invalid("recovery", expected, found).in_file(damaged));
    };
    let mut saved = Vec::new();
    for run in whole.runs() {
        let path = match saved.is_empty() {
            true => out.to_path_buf(),
            false => out.with_extension(format!("from_{}.mcap", run.start)),
        };
        let mut header = header.clone();
        let name = damaged.file_name().unwrap_or_default().to_string_lossy();
        let (first, last) = (run.start, run.end - 1);
        let warning =
            format!("recovered from the damaged file {name}: its frames {first} to {last}");
        header.scene.warnings.push(warning);
        let mut writer = SequenceWriter::create(&path, &header)?;
        for found in &whole.frames[whole.position(run.start)..whole.position(run.end)] {
            let chunk = read_chunk(damaged, &file, &found.chunk)?;
            let frames = messages_of_chunk(&chunk).into_iter().flatten();
            let frame = frames.filter_map(|(_, bytes)| decode_frame(bytes, &header));
            let frame = frame.into_iter().find(|(index, _)| *index == found.index);
            let changed =
                || DatasetError::invalid("recovery", "a file that nobody writes to", "a change");
            writer.push(&frame.ok_or_else(changed)?.1)?;
        }
        writer.finish()?;
        saved.push(Saved { path, frames: run });
    }
    Ok(saved)
}

/// Where a whole frame is.
struct Found {
    index: usize,
    chunk: Range<u64>,
}

/// What of a file is whole.
pub(super) struct Whole {
    header: Option<SequenceHeader>,
    /// By index, each once.
    frames: Vec<Found>,
}

impl Whole {
    /// Searches a file; memory: one chunk.
    pub(super) fn find(path: &Path, file: &File) -> Result<Self> {
        let size = file
            .metadata()
            .map_err(DatasetError::io("read", path))?
            .len();
        let mut whole = Self {
            header: None,
            frames: Vec::new(),
        };
        let mut at = 0;
        while let Some(span) = next_chunk(path, file, at, size)? {
            let chunk = read_chunk(path, file, &span)?;
            let Some(messages) = messages_of_chunk(&chunk) else {
                at = span.start + 1;
                continue;
            };
            for (_, bytes) in messages {
                whole.take(path, bytes, &span);
            }
            at = span.end;
        }
        // Of two frames with one index the first in the file counts.
        whole.frames.sort_by_key(|found| found.index);
        whole.frames.dedup_by_key(|found| found.index);
        Ok(whole)
    }

    fn take(&mut self, path: &Path, bytes: Bytes, span: &Range<u64>) {
        match &self.header {
            None => self.header = decode_header(path, bytes).ok(),
            Some(header) => {
                if let Some((index, _)) = decode_frame(bytes, header) {
                    let chunk = span.clone();
                    self.frames.push(Found { index, chunk });
                }
            }
        }
    }

    /// Frames without a gap between them.
    fn runs(&self) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for found in &self.frames {
            match runs.last_mut() {
                Some(run) if run.end == found.index => run.end += 1,
                _ => runs.push(found.index..found.index + 1),
            }
        }
        runs
    }

    /// Place in `frames` of the first that is not before `index`.
    fn position(&self, index: usize) -> usize {
        self.frames.partition_point(|found| found.index < index)
    }

    /// What can be saved, in words.
    pub(super) fn summary(&self) -> String {
        if self.header.is_none() {
            return "the header is lost, without which no frame can be read".into();
        }
        let ranges: Vec<String> = (self.runs().iter())
            .map(|run| match run.len() {
                1 => run.start.to_string(),
                _ => format!("{} to {}", run.start, run.end - 1),
            })
            .collect();
        match ranges.len() {
            0 => "the header is whole, but no frame".into(),
            // A hostile file may have many gaps; a message should not.
            1..=8 => format!("the header and the frames {} are whole", ranges.join(", ")),
            more => format!(
                "the header and {} frames in {more} pieces are whole",
                self.frames.len()
            ),
        }
    }

    /// Whether there is anything to save.
    pub(super) fn saves_something(&self) -> bool {
        self.header.is_some() && !self.frames.is_empty()
    }
}

/// The next place from `at` on that looks like a chunk and ends inside the file.
fn next_chunk(path: &Path, file: &File, mut at: u64, size: u64) -> Result<Option<Range<u64>>> {
    while size.saturating_sub(at) >= CHUNK_HEAD as u64 {
        let length = BLOCK.min((size - at) as usize);
        let block = read_at(file, at, length).map_err(DatasetError::io("read", path))?;
        for (offset, head) in block.windows(CHUNK_HEAD).enumerate() {
            let start = at + offset as u64;
            if let Some(length) = plausible_chunk(head)
                && let Some(end) = start.checked_add(length).filter(|&end| end <= size)
            {
                return Ok(Some(start..end));
            }
        }
        // The last windows of this block are the first of the next.
        at += (length - CHUNK_HEAD + 1) as u64;
    }
    Ok(None)
}

fn read_chunk(path: &Path, file: &File, span: &Range<u64>) -> Result<Bytes> {
    read_at(file, span.start, (span.end - span.start) as usize)
        .map(Bytes::from)
        .map_err(DatasetError::io("read", path))
}

/// The frame of a message, if it is one and fits the header.
fn decode_frame(bytes: Bytes, header: &SequenceHeader) -> Option<(usize, Frame)> {
    let message = proto::Frame::decode(bytes).ok()?;
    let index = usize::try_from(message.index).ok()?;
    let frame = messages::frame_from_message(message).ok()?;
    frame.check(header).ok()?;
    Some((index, frame))
}

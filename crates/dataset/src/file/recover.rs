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
use super::quantised::{Dequantiser, Storage};
use super::reader::decode_header;
use super::records::MessageHead;
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
        let mut writer = SequenceWriter::create_with(&path, &header, whole.storage)?;
        let mut decoder = Decoder::new(&header);
        for found in &whole.frames[whole.position(run.start)..whole.position(run.end)] {
            let chunk = read_chunk(damaged, &file, &found.chunk)?;
            let messages = messages_of_chunk(&chunk).into_iter().flatten();
            let mut frames = messages.filter_map(|(_, bytes)| decoder.frame(bytes));
            let Some((.., frame)) = frames.find(|(index, ..)| *index == found.index) else {
                let expected = "a file that nobody writes to meanwhile";
                return Err(
                    DatasetError::invalid("recovery", expected, "a change").in_file(damaged)
                );
            };
            writer.push(&frame)?;
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
    storage: Storage,
    /// By index, each once.
    frames: Vec<Found>,
}

impl Whole {
    /// Searches a file; memory: one chunk.
    pub(super) fn find(path: &Path, file: &File) -> Result<Self> {
        let size = file.metadata();
        let size = size.map_err(DatasetError::io("read", path))?.len();
        let mut chunks = Chunks {
            path,
            file,
            size,
            at: 0,
        };
        let mut whole = Self {
            header: None,
            storage: Storage::Exact,
            frames: Vec::new(),
        };
        while whole.header.is_none()
            && let Some((_, messages)) = chunks.next()?
        {
            let mut headers = messages.into_iter();
            whole.header = headers.find_map(|(_, bytes)| decode_header(path, bytes).ok());
        }
        let Some(header) = &whole.header else {
            return Ok(whole);
        };
        let mut decoder = Decoder::new(header);
        while let Some((chunk, messages)) = chunks.next()? {
            for (_, bytes) in messages {
                if let Some((index, storage, _)) = decoder.frame(bytes) {
                    whole.storage = storage;
                    let chunk = chunk.clone();
                    whole.frames.push(Found { index, chunk });
                }
            }
        }
        // Of two frames with one index the first in the file counts.
        whole.frames.sort_by_key(|found| found.index);
        whole.frames.dedup_by_key(|found| found.index);
        Ok(whole)
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

/// A chunk's place and messages.
type Chunk = (Range<u64>, Vec<(MessageHead, Bytes)>);

/// Sound chunks of a file, in its order.
struct Chunks<'a> {
    path: &'a Path,
    file: &'a File,
    size: u64,
    at: u64,
}

impl Chunks<'_> {
    fn next(&mut self) -> Result<Option<Chunk>> {
        while let Some(span) = self.next_plausible()? {
            let chunk = read_chunk(self.path, self.file, &span)?;
            if let Some(messages) = messages_of_chunk(&chunk) {
                self.at = span.end;
                return Ok(Some((span, messages)));
            }
            self.at = span.start + 1;
        }
        Ok(None)
    }

    /// The next place that looks like a chunk and ends inside the file.
    fn next_plausible(&mut self) -> Result<Option<Range<u64>>> {
        while self.size.saturating_sub(self.at) >= CHUNK_HEAD as u64 {
            let length = BLOCK.min((self.size - self.at) as usize);
            let block = read_at(self.file, self.at, length);
            let block = block.map_err(DatasetError::io("read", self.path))?;
            for (offset, head) in block.windows(CHUNK_HEAD).enumerate() {
                let start = self.at + offset as u64;
                if let Some(length) = plausible_chunk(head)
                    && let Some(end) = start.checked_add(length).filter(|&end| end <= self.size)
                {
                    return Ok(Some(start..end));
                }
            }
            // The last windows of this block are the first of the next.
            self.at += (length - CHUNK_HEAD + 1) as u64;
        }
        Ok(None)
    }
}

fn read_chunk(path: &Path, file: &File, span: &Range<u64>) -> Result<Bytes> {
    read_at(file, span.start, (span.end - span.start) as usize)
        .map(Bytes::from)
        .map_err(DatasetError::io("read", path))
}

/// Decodes frames of either kind, one after the other.
struct Decoder<'a> {
    header: &'a SequenceHeader,
    last: Dequantiser<'a>,
}

impl<'a> Decoder<'a> {
    fn new(header: &'a SequenceHeader) -> Self {
        let last = Dequantiser::new(header);
        Self { header, last }
    }

    /// Index, storage and content of a message, if it is a frame and fits the header.
    fn frame(&mut self, bytes: Bytes) -> Option<(usize, Storage, Frame)> {
        if let Ok(message) = proto::Frame::decode(bytes.clone())
            && let Ok(index) = usize::try_from(message.index)
            && let Ok(frame) = messages::frame_from_message(message)
            && frame.check(self.header).is_ok()
        {
            return Some((index, Storage::Exact, frame));
        }
        let message = proto::QuantisedFrame::decode(bytes).ok()?;
        let index = usize::try_from(message.index).ok()?;
        let max_error_m = message.max_error_m;
        self.last.take(index, &message).ok()?;
        let frame = self.last.frame(message).ok()?;
        Some((index, Storage::Quantised { max_error_m }, frame))
    }
}

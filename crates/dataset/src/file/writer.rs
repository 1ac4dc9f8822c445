//! Writing a sequence file: streaming, checked, all or nothing.

use std::collections::BTreeMap;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use prost::Message;
use tempfile::NamedTempFile;

use super::quantised::{Quantiser, Storage};
use super::{
    EXACT_MINOR, FORMAT_MINOR, FRAME, HEADER, MessageKind, PROTOBUF, QUANTISED_FRAME, messages,
};
use crate::atomic::{persist, temporary_beside};
use crate::error::{DatasetError, Result};
use crate::sequence::{Frame, SequenceHeader};

/// Writes one sequence file, frame by frame.
///
/// Frames go to a hidden temporary file in the same folder; [`finish`] makes
/// it durable and gives it its name, replacing a file of that name. A writer
/// that is dropped before that leaves nothing behind.
///
/// [`finish`]: SequenceWriter::finish
pub struct SequenceWriter {
    mcap: mcap::Writer<BufWriter<NamedTempFile>>,
    header: SequenceHeader,
    path: PathBuf,
    frame_channel: u16,
    /// None: exact.
    quantiser: Option<Quantiser>,
    frames: usize,
    /// A write failed: part of a chunk may be in the file, which must not be finished.
    failed: bool,
}

impl SequenceWriter {
    /// Starts the file that will be called `path` once finished.
    ///
    /// # Errors
    /// A header that breaks a rule ([`SequenceHeader::check`]); a folder that
    /// does not exist or cannot be written.
    pub fn create(path: impl AsRef<Path>, header: &SequenceHeader) -> Result<Self> {
        Self::create_with(path, header, Storage::Exact)
    }

    /// Like [`create`](Self::create), with another storage of positions.
    ///
    /// # Errors
    /// As [`create`](Self::create); an error that is not above 0; more than 2^24
    /// vertices in one mesh of a quantised file.
    pub fn create_with(
        path: impl AsRef<Path>,
        header: &SequenceHeader,
        storage: Storage,
    ) -> Result<Self> {
        let path = path.as_ref().to_path_buf();
        header.check().map_err(|error| error.in_file(&path))?;
        let quantiser = match storage {
            Storage::Exact => None,
            Storage::Quantised { max_error_m } => {
                Some(Quantiser::new(header, max_error_m).map_err(|error| error.in_file(&path))?)
            }
        };
        let file = temporary_beside(&path)?;
        let mut mcap = mcap::WriteOptions::new()
            .profile("drape")
            .library(concat!("drape-dataset ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            // Chunks end where `write` flushes: one message each.
            .chunk_size(None)
            .create(BufWriter::with_capacity(1 << 20, file))
            .map_err(|error| write_error(&path, error))?;
        let mut channel = |kind: &MessageKind| {
            let schema = mcap.add_schema(kind.schema, PROTOBUF, kind.descriptors)?;
            mcap.add_channel(schema, kind.topic, PROTOBUF, &BTreeMap::new())
        };
        let (frame_kind, minor) = match storage {
            Storage::Exact => (&FRAME, EXACT_MINOR),
            Storage::Quantised { .. } => (&QUANTISED_FRAME, FORMAT_MINOR),
        };
        let channels = channel(&HEADER).and_then(|header| Ok((header, channel(frame_kind)?)));
        let (header_channel, frame_channel) =
            channels.map_err(|error| write_error(&path, error))?;
        let mut writer = Self {
            mcap,
            header: header.clone(),
            path,
            frame_channel,
            quantiser,
            frames: 0,
            failed: false,
        };
        let message = messages::header_to_message(header, minor).encode_to_vec();
        writer.write(header_channel, 0, &message)?;
        Ok(writer)
    }

    /// Appends the next frame.
    ///
    /// # Errors
    /// Shapes that differ from the header's, a number that is not finite (the
    /// error names frame, garment and vertex; nothing is written and the
    /// writer stays usable), or a failing disk.
    pub fn push(&mut self, frame: &Frame) -> Result<()> {
        let index = self.frames as u64;
        let bytes = frame
            .check(&self.header)
            .and_then(|()| match &mut self.quantiser {
                None => Ok(messages::frame_to_message(index, frame).encode_to_vec()),
                Some(quantiser) => Ok(quantiser.message(index, frame)?.encode_to_vec()),
            });
        let place = || format!("frame {index}");
        let message = bytes.map_err(|error| error.at(&place()).in_file(&self.path))?;
        self.write(self.frame_channel, self.frames, &message)?;
        self.frames += 1;
        Ok(())
    }

    /// Number of frames pushed so far.
    pub fn frame_count(&self) -> usize {
        self.frames
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// No frame was pushed, or the disk fails or failed before; then no file appears.
    pub fn finish(mut self) -> Result<()> {
        self.refuse_after_failure()?;
        if self.frames == 0 {
            return Err(
                DatasetError::invalid("sequence", "at least one frame", "none").in_file(&self.path),
            );
        }
        self.mcap
            .finish()
            .map_err(|error| write_error(&self.path, error))?;
        let io = |error| DatasetError::io("write", &self.path)(error);
        let file = self
            .mcap
            .into_inner()
            .into_inner()
            .map_err(|error| io(error.into_error()))?;
        persist(file, &self.path)
    }

    fn write(&mut self, channel_id: u16, index: usize, message: &[u8]) -> Result<()> {
        let time_ns = (index as f64 * 1e9 / f64::from(self.header.scene.fps)).round() as u64;
        let header = MessageHeader {
            channel_id,
            sequence: index as u32,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.refuse_after_failure()?;
        let written = self
            .mcap
            .write_to_known_channel(&header, message)
            .and_then(|()| self.mcap.flush());
        self.failed = written.is_err();
        written.map_err(|error| write_error(&self.path, error))
    }

    fn refuse_after_failure(&self) -> Result<()> {
        if self.failed {
            let reason = io::Error::other("an earlier write to this file failed");
            return Err(DatasetError::io("write", &self.path)(reason));
        }
        Ok(())
    }
}

fn write_error(path: &Path, error: mcap::McapError) -> DatasetError {
    let source = match error {
        mcap::McapError::Io(source) => source,
        other => io::Error::other(other),
    };
    DatasetError::io("write", path)(source)
}

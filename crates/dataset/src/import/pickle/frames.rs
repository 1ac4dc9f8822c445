//! An array of frames, one at a time.

use std::io::{self, Read};

use super::globals::Dtype;
use super::source::Stored;
use super::{ArrayNode, Pickle};
use crate::error::{DatasetError, Result};
use crate::import::array::Array;

/// Positions `[frame, vertex, 3]`, read in order.
pub(in crate::import) struct Frames {
    path: std::path::PathBuf,
    place: String,
    frames: usize,
    vertices: usize,
    next: usize,
    source: FrameSource,
}

enum FrameSource {
    /// Where the bytes are, until the first frame is wanted.
    Unopened {
        stored: Stored,
        dtype: Dtype,
    },
    Open {
        reader: Box<dyn Read>,
        dtype: Dtype,
    },
    /// The whole array: its frames are not one after the other in the file.
    Memory(Array),
}

impl Frames {
    pub(super) fn streaming(
        pickle: &Pickle,
        place: &str,
        [frames, vertices]: [usize; 2],
        array: &ArrayNode,
        stored: &Stored,
    ) -> Self {
        Self {
            path: pickle.path.clone(),
            place: place.into(),
            frames,
            vertices,
            next: 0,
            source: FrameSource::Unopened {
                stored: stored.clone(),
                dtype: array.dtype.clone(),
            },
        }
    }

    pub(super) fn in_memory(pickle: &Pickle, place: &str, vertices: usize, array: Array) -> Self {
        Self {
            path: pickle.path.clone(),
            place: place.into(),
            frames: array.shape[0],
            vertices,
            next: 0,
            source: FrameSource::Memory(array),
        }
    }

    pub fn frame_count(&self) -> usize {
        self.frames
    }

    pub fn vertex_count(&self) -> usize {
        self.vertices
    }

    /// The next frame, `[vertex, 3]`.
    ///
    /// # Errors
    /// The file changed or cannot be read; there is no further frame.
    pub fn next(&mut self) -> Result<Vec<[f32; 3]>> {
        let positions = self.read().map_err(|error| {
            let place = format!("{}, frame {}", self.place, self.next);
            DatasetError::invalid(place, "the frame's bytes", error.to_string()).in_file(&self.path)
        })?;
        self.next += 1;
        Ok(positions)
    }

    fn read(&mut self) -> io::Result<Vec<[f32; 3]>> {
        if self.next >= self.frames {
            return Err(io::Error::other("the end of the array"));
        }
        if let FrameSource::Unopened { stored, dtype } = &self.source {
            self.source = FrameSource::Open {
                reader: stored.reader(&self.path)?,
                dtype: dtype.clone(),
            };
        }
        match &mut self.source {
            FrameSource::Unopened { .. } => unreachable!("opened above"),
            FrameSource::Memory(array) => {
                let size = self.vertices * 3;
                let frame = &array.values[self.next * size..][..size];
                let (rows, _) = frame.as_chunks::<3>();
                Ok(rows.iter().map(|row| row.map(|x| x as f32)).collect())
            }
            FrameSource::Open { reader, dtype } => {
                let number = dtype
                    .number
                    .expect("a numeric type, checked with the shape");
                let mut bytes = vec![0; self.vertices * 3 * number.size()];
                reader.read_exact(&mut bytes)?;
                if self.next + 1 == self.frames {
                    expect_end(reader)?;
                }
                let value = |i: usize| {
                    let entry = &bytes[i * number.size()..];
                    number.read(entry, dtype.big_endian) as f32
                };
                Ok((0..self.vertices)
                    .map(|v| std::array::from_fn(|k| value(3 * v + k)))
                    .collect())
            }
        }
    }
}

/// Text that spells bytes may be longer than the array it is for.
pub(super) fn expect_end(reader: &mut impl Read) -> io::Result<()> {
    match reader.read(&mut [0])? {
        0 => Ok(()),
        _ => Err(io::Error::other("more bytes than the shape has")),
    }
}

//! Samples of a data set, ready to iterate: open a split, and take.
//!
//! Frames are read from the files when a sample is drawn, so memory does not grow with
//! the data set. Statistics are gathered once when opening, in one pass, sequence by
//! sequence, and merged in the index's order: the same bits on any number of threads.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Arc;
use std::thread::available_parallelism;

use crate::error::Result;
use crate::file::SequenceReader;
use crate::order::{FIRST_START, Order};
use crate::sample::{FrameStates, Outfit, Sample, gravity_per_frame};
use crate::splits::{DatasetIndex, Split};
use crate::statistics::{Statistics, StatisticsBuilder};

/// What samples are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleOptions {
    /// Side of a patch in metres of real cloth; 0.05 by default. Smaller patches are
    /// more particles with fewer vertices each.
    pub patch_size_m: f32,
    /// Steps that follow the start state; 1 by default.
    pub steps: usize,
    /// Seed of the order.
    pub seed: u64,
}

impl Default for SampleOptions {
    fn default() -> Self {
        Self {
            patch_size_m: 0.05,
            steps: 1,
            seed: 0,
        }
    }
}

/// Endless iterator over the samples of a split, shuffled epoch by epoch.
pub struct Samples {
    sequences: Vec<(SequenceReader, Arc<Outfit>)>,
    statistics: Statistics,
    steps: usize,
    /// Which sample comes next; its progress is what a checkpoint keeps.
    pub order: Order,
}

impl Samples {
    /// Opens a split and gathers its statistics, on all processors.
    ///
    /// Held-out splits are normalised like the training split:
    /// [`with_statistics`](Self::with_statistics).
    ///
    /// # Errors
    /// A file or a frame that cannot be read, a garment that cannot be cut into
    /// patches, a sequence that is too short, an empty split.
    pub fn open(index: &DatasetIndex, split: Split, options: SampleOptions) -> Result<Self> {
        let entries = index.split(split)?;
        let threads = available_parallelism().unwrap_or(NonZeroUsize::MIN);
        let opened = index.map(&entries, threads, |_, reader| {
            let outfit = Arc::new(Outfit::new(reader.header(), options.patch_size_m)?);
            let statistics = statistics_of(&reader)?;
            Ok((reader, outfit, statistics))
        })?;
        let mut builder = StatisticsBuilder::default();
        let mut sequences = Vec::new();
        for (reader, outfit, statistics) in opened {
            builder = builder.merge(statistics);
            sequences.push((reader, outfit));
        }
        let counts: Vec<_> = sequences
            .iter()
            .map(|(reader, _)| reader.frame_count())
            .collect();
        let order = Order::new(&counts, options.steps, options.seed);
        let order = order.map_err(|error| error.in_file(index.folder()))?;
        Ok(Self {
            sequences,
            statistics: builder.finish(),
            steps: options.steps.max(1),
            order,
        })
    }

    /// Normalises by other statistics: those of the training split.
    #[must_use]
    pub fn with_statistics(mut self, statistics: Statistics) -> Self {
        self.statistics = statistics;
        self
    }

    /// What samples are normalised by.
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }
}

impl Iterator for Samples {
    type Item = Result<Sample>;

    fn next(&mut self) -> Option<Self::Item> {
        let place = self.order.next()?;
        let (reader, outfit) = &self.sequences[place.sequence];
        let frames = place.frame - 1..place.frame + self.steps + 1;
        let gravity = gravity_per_frame(reader.header());
        Some(
            read_states(reader, frames)
                .map(|states| Sample::new(Arc::clone(outfit), &states, &self.statistics, gravity)),
        )
    }
}

/// States of consecutive frames; the two before them are read too, as far as they exist.
///
/// # Errors
/// A frame that cannot be read.
pub fn read_states(reader: &SequenceReader, frames: Range<usize>) -> Result<Vec<FrameStates>> {
    let first = frames.start.saturating_sub(2);
    let window = reader
        .frames(first..frames.end)
        .collect::<Result<Vec<_>>>()?;
    let older = |at: usize, back: usize| at.checked_sub(back).map(|at| &window[at]);
    Ok((frames.start - first..window.len())
        .map(|at| FrameStates::new(&window[at], older(at, 1), older(at, 2)))
        .collect())
}

/// Statistics of one sequence: its frames from [`FIRST_START`] on, in one pass.
/// Memory: three frames.
///
/// # Errors
/// A frame that cannot be read.
pub fn statistics_of(reader: &SequenceReader) -> Result<StatisticsBuilder> {
    let mut builder = StatisticsBuilder::default();
    let (mut second, mut first, mut states) = (None, None, None);
    for (at, frame) in reader.frames(0..reader.frame_count()).enumerate() {
        let frame = frame?;
        let now = FrameStates::new(&frame, first.as_ref(), second.as_ref());
        if let Some(before) = states.as_ref().filter(|_| at >= FIRST_START) {
            now.collect(before, &mut builder);
        }
        (second, first, states) = (first, Some(frame), Some(now));
    }
    Ok(builder)
}

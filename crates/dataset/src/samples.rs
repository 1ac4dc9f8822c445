//! Samples of a data set, ready to iterate: open a split, and take.
//!
//! Frames are read from the files when a sample is drawn, so memory does not grow with
//! the data set. Statistics are those of the training split, whatever split is opened:
//! gathered in one pass, sequence by sequence, and merged in the index's order, the same
//! bits on any number of threads.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Arc;
use std::thread::available_parallelism;

use crate::error::{DatasetError, Result};
use crate::file::SequenceReader;
use crate::order::{FIRST_START, Order, starts};
use crate::sample::{FrameStates, Outfit, Sample, gravity_per_frame, turned};
use crate::splits::{DatasetIndex, Split};
use crate::statistics::{Statistics, StatisticsBuilder};

/// What samples are like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampleOptions {
    /// Side of a patch in metres of real cloth; 0.05 by default. Smaller patches are
    /// more particles with fewer vertices each.
    pub patch_size_m: f32,
    /// Steps that follow the start state, at least 1; 1 by default.
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
    /// Opens a split, normalised by the statistics of the training split, which are
    /// gathered on all processors.
    ///
    /// # Errors
    /// A file or a frame that cannot be read, a garment that cannot be cut into patches, a
    /// sequence that is too short, an empty split; no training split: then
    /// [`open_normalised`](Self::open_normalised) takes statistics from elsewhere.
    pub fn open(index: &DatasetIndex, split: Split, options: SampleOptions) -> Result<Self> {
        let statistics = training_statistics(index, FIRST_START)?;
        Self::open_normalised(index, split, options, statistics)
    }

    /// Opens a split with statistics that are there already: those that a model was trained
    /// with.
    ///
    /// # Errors
    /// As [`open`](Self::open), apart from the training split.
    pub fn open_normalised(
        index: &DatasetIndex,
        split: Split,
        options: SampleOptions,
        statistics: Statistics,
    ) -> Result<Self> {
        let sequences = index.map(&index.split(split)?, processors(), |_, reader| {
            starts(reader.frame_count(), options.steps)
                .map_err(|error| error.in_file(reader.path()))?;
            let outfit = Outfit::new(reader.header(), options.patch_size_m)
                .map_err(|error| error.in_file(reader.path()))?;
            Ok((reader, Arc::new(outfit)))
        })?;
        let counts = sequences.iter().map(|(reader, _)| reader.frame_count());
        let order = Order::new(&counts.collect::<Vec<_>>(), options.steps, options.seed);
        Ok(Self {
            sequences,
            statistics,
            steps: options.steps,
            order: order.map_err(|error| error.in_file(index.folder()))?,
        })
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
            read_states(reader, frames, 0.0)
                .map(|states| Sample::new(Arc::clone(outfit), &states, &self.statistics, gravity)),
        )
    }
}

/// States of consecutive frames, the scene turned about Z by `heading_rad` (0: as it is);
/// the two frames before them are read too, as far as they exist.
///
/// # Errors
/// A frame that cannot be read.
pub fn read_states(
    reader: &SequenceReader,
    frames: Range<usize>,
    heading_rad: f64,
) -> Result<Vec<FrameStates>> {
    let first = frames.start.saturating_sub(2);
    let window = reader.frames(first..frames.end).map(|frame| {
        let frame = frame?;
        Ok(match heading_rad {
            0.0 => frame,
            heading_rad => turned(&frame, heading_rad),
        })
    });
    let window = window.collect::<Result<Vec<_>>>()?;
    let older = |at: usize, back: usize| at.checked_sub(back).map(|at| &window[at]);
    Ok((frames.start - first..window.len())
        .map(|at| FrameStates::new(&window[at], older(at, 1), older(at, 2)))
        .collect())
}

/// Statistics of a training split: of each sequence's frames from `first_start` on, merged
/// in the index's order; on all processors, the same bits on any number.
///
/// # Errors
/// A file or a frame that cannot be read, an empty split; as [`statistics_of`].
pub fn training_statistics(index: &DatasetIndex, first_start: usize) -> Result<Statistics> {
    let entries = index.split(Split::Train)?;
    let parts = index.map(&entries, processors(), |_, reader| {
        statistics_of(&reader, first_start)
    })?;
    let merged = parts
        .into_iter()
        .fold(StatisticsBuilder::default(), StatisticsBuilder::merge);
    Ok(merged.finish())
}

/// Statistics of one sequence: its frames from `first_start` on, in one pass. Memory: three
/// frames.
///
/// # Errors
/// A frame that cannot be read; a start before [`FIRST_START`], where accelerations are not
/// known.
pub fn statistics_of(reader: &SequenceReader, first_start: usize) -> Result<StatisticsBuilder> {
    if first_start < FIRST_START {
        let expected = format!("at least {FIRST_START}");
        return Err(DatasetError::invalid(
            "first start",
            expected,
            first_start.to_string(),
        ));
    }
    let mut builder = StatisticsBuilder::default();
    let (mut second, mut first, mut states) = (None, None, None);
    for (at, frame) in reader.frames(0..reader.frame_count()).enumerate() {
        let frame = frame?;
        let now = FrameStates::new(&frame, first.as_ref(), second.as_ref());
        if let Some(before) = states.as_ref().filter(|_| at >= first_start) {
            now.collect(before, &mut builder);
        }
        (second, first, states) = (first, Some(frame), Some(now));
    }
    Ok(builder)
}

fn processors() -> NonZeroUsize {
    available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

//! The order in which samples are drawn: every place of every sequence once an epoch,
//! shuffled by a seed, to be left and taken up again anywhere.
//!
//! An epoch's order is a function of the seed and the epoch's number alone (a named
//! random stream each), so resuming needs no state but two numbers.

use std::ops::Range;

use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use crate::error::{DatasetError, Result};
use crate::random::stream;

/// The first frame that a sample may start at: its state and the one before it have
/// velocities, which need the frame before them.
pub const FIRST_START: usize = 2;

/// Where a sample starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Place {
    /// Number of the sequence.
    pub sequence: usize,
    /// Frame of the start state.
    pub frame: usize,
}

/// How far an [`Order`] has come; what a checkpoint keeps of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    /// Epochs finished.
    pub epoch: u64,
    /// Places of the current epoch that were handed out.
    pub drawn: usize,
}

/// Endless iterator over places, epoch by epoch.
#[derive(Clone, Debug)]
pub struct Order {
    seed: u64,
    /// All places, sequence by sequence.
    places: Vec<Place>,
    /// The current epoch's.
    shuffled: Vec<Place>,
    progress: Progress,
}

impl Order {
    /// All places of sequences with these numbers of frames from which `steps` steps can
    /// be made.
    ///
    /// # Errors
    /// No steps, no sequences, or a sequence that is too short, by its number.
    pub fn new(frame_counts: &[usize], steps: usize, seed: u64) -> Result<Self> {
        let mut places = Vec::new();
        for (sequence, &frames) in frame_counts.iter().enumerate() {
            let starts = starts(frames, steps);
            let starts = starts.map_err(|error| error.at(&format!("sequence {sequence}")))?;
            places.extend(starts.map(|frame| Place { sequence, frame }));
        }
        if places.is_empty() {
            return Err(DatasetError::invalid("sequences", "at least one", "none"));
        }
        let mut order = Self {
            seed,
            places,
            shuffled: Vec::new(),
            progress: Progress::default(),
        };
        order.shuffle();
        Ok(order)
    }

    /// Places in an epoch.
    pub fn places_per_epoch(&self) -> usize {
        self.places.len()
    }

    /// How far it has come.
    pub fn progress(&self) -> Progress {
        self.progress
    }

    /// Goes on from `progress`, which another order over the same sequences with the
    /// same seed came to.
    ///
    /// # Errors
    /// More places drawn than an epoch has: the sequences are others.
    pub fn resume(&mut self, progress: Progress) -> Result<()> {
        if progress.drawn > self.places.len() {
            let expected = format!("at most {} (the epoch's places)", self.places.len());
            let found = progress.drawn.to_string();
            return Err(DatasetError::invalid("places drawn", expected, found));
        }
        self.progress = progress;
        self.shuffle();
        Ok(())
    }

    fn shuffle(&mut self) {
        let name = format!("order/epoch {}", self.progress.epoch);
        self.shuffled.clone_from(&self.places);
        self.shuffled.shuffle(&mut stream(self.seed, &name));
    }
}

/// Frames of a sequence from which `steps` steps can be made.
pub(crate) fn starts(frames: usize, steps: usize) -> Result<Range<usize>> {
    if steps == 0 {
        return Err(DatasetError::invalid("steps", "at least 1", "0"));
    }
    let needed = FIRST_START.saturating_add(steps).saturating_add(1);
    if frames < needed {
        let expected = format!("at least {needed} for samples of {steps} steps");
        return Err(DatasetError::invalid(
            "frames",
            expected,
            frames.to_string(),
        ));
    }
    Ok(FIRST_START..frames - steps)
}

impl Iterator for Order {
    type Item = Place;

    fn next(&mut self) -> Option<Place> {
        if self.progress.drawn == self.places.len() {
            self.progress = Progress {
                epoch: self.progress.epoch + 1,
                drawn: 0,
            };
            self.shuffle();
        }
        self.progress.drawn += 1;
        Some(self.shuffled[self.progress.drawn - 1])
    }
}

//! One rollout to be done: what a method may see ([`Task`]) and what it is
//! measured against ([`Reference`]), cut from a [`Clip`] so that no method can
//! look at the answer.
//!
//! A rollout that starts at frame `s` is given garment positions up to and
//! including `s`, and the body, root and wind of every frame; it predicts the
//! garments of frames `s+1 ..= s+steps`. Two velocities are needed (the model's
//! state is the current and the previous frame), so `s` is at least 2.

use drape_dataset::{
    SequenceReader,
    sequence::{Frame, SequenceHeader},
};

use crate::EvalError;

/// Positions of one garment, `[vertex, 3]`, absolute, in scene units.
pub type Positions = Vec<[f32; 3]>;

/// First frame a rollout can start from: two velocities need three frames.
pub const FIRST_START: usize = 2;

/// The first frames of one sequence, in memory.
#[derive(Clone, Debug)]
pub struct Clip {
    /// What is fixed for the sequence.
    pub header: SequenceHeader,
    /// Frames from frame 0.
    pub frames: Vec<Frame>,
}

/// What a method may see: garments up to the start frame, everything else for all frames.
#[derive(Clone, Debug)]
pub struct Task {
    /// What is fixed for the sequence.
    pub header: SequenceHeader,
    /// Frames from frame 0; `garments` is empty in frames after `start`.
    pub frames: Vec<Frame>,
    /// Newest frame whose garments are known.
    pub start: usize,
    /// Frames to predict.
    pub steps: usize,
}

/// The frames that a rollout is compared with: `frames[k]` is frame `start + 1 + k`.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Garment positions, `[frame][garment][vertex, 3]`.
    pub frames: Vec<Vec<Positions>>,
}

impl Clip {
    /// Number of frames that a rollout needs.
    pub fn frames_needed(start: usize, steps: usize) -> usize {
        start + steps + 1
    }

    /// Reads the frames that a rollout needs.
    ///
    /// # Errors
    /// A damaged file, or fewer frames than needed.
    pub fn read(reader: &SequenceReader, start: usize, steps: usize) -> Result<Self, EvalError> {
        let header = reader.header().clone();
        let needed = Self::frames_needed(start, steps);
        let found = reader.frame_count();
        if found < needed {
            return Err(EvalError::TooShort {
                sequence: header.name,
                found,
                needed,
                start,
                steps,
            });
        }
        let frames = reader.frames(0..needed).collect::<Result<_, _>>()?;
        Ok(Self { header, frames })
    }

    /// Cuts the clip into what a method may see and what it is measured against.
    ///
    /// # Errors
    /// When the start leaves no history, the clip is too short or a frame does not fit the header.
    pub fn split(mut self, start: usize, steps: usize) -> Result<(Task, Reference), EvalError> {
        if start < FIRST_START {
            return Err(EvalError::TooEarly {
                start,
                least: FIRST_START,
            });
        }
        let needed = Self::frames_needed(start, steps);
        if self.frames.len() < needed {
            return Err(EvalError::TooShort {
                sequence: self.header.name,
                found: self.frames.len(),
                needed,
                start,
                steps,
            });
        }
        self.frames.truncate(needed);
        for (index, frame) in self.frames.iter().enumerate() {
            check_frame(&self.header, index, frame)?;
        }
        let frames = self.frames[start + 1..]
            .iter_mut()
            .map(|frame| std::mem::take(&mut frame.garments))
            .collect();
        Ok((
            Task {
                header: self.header,
                frames: self.frames,
                start,
                steps,
            },
            Reference { frames },
        ))
    }
}

impl Task {
    /// Predicted frame `start + 1 + step` as it would stand in a file.
    pub fn frame_with(&self, step: usize, garments: Vec<Positions>) -> Frame {
        let given = &self.frames[self.start + 1 + step];
        Frame {
            garments,
            intersections: None,
            ..given.clone()
        }
    }

    /// The same task with only its first `steps` steps, for warming up.
    pub fn shortened(&self, steps: usize) -> Task {
        let steps = steps.min(self.steps);
        Task {
            header: self.header.clone(),
            frames: self.frames[..Clip::frames_needed(self.start, steps)].to_vec(),
            start: self.start,
            steps,
        }
    }
}

fn check_frame(header: &SequenceHeader, index: usize, frame: &Frame) -> Result<(), EvalError> {
    let wrong = |place: &str, expected, found| EvalError::VertexCount {
        sequence: header.name.clone(),
        frame: index,
        place: place.to_owned(),
        expected,
        found,
    };
    if frame.body.len() != header.body.vertex_count {
        return Err(wrong("body", header.body.vertex_count, frame.body.len()));
    }
    for (number, garment) in header.garments.iter().enumerate() {
        let found = frame.garments.get(number).map_or(0, Vec::len);
        if found != garment.rest.len() {
            return Err(wrong(
                &format!("garment `{}`", garment.name),
                garment.rest.len(),
                found,
            ));
        }
    }
    Ok(())
}

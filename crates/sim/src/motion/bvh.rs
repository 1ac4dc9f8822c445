//! BVH files (Biovision hierarchy): a skeleton and its channels, frame by frame.
//!
//! As the format is used: Y up, the person faces +Z at rest, angles in degrees,
//! rotations multiplied in the order in which the channels are listed. One
//! root. Lengths are in whatever unit the file has.

use std::path::Path;
use std::str::FromStr;

use glam::{DQuat, DVec3};

use crate::error::{Result, SimError};

/// What a channel moves: an axis (0 X, 1 Y, 2 Z).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    Position(usize),
    Rotation(usize),
}

/// A joint of the file's skeleton.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BvhJoint {
    pub name: String,
    pub parent: Option<usize>,
    /// From the parent, unposed.
    pub offset: DVec3,
    channels: Vec<Channel>,
    /// Place of the first channel in a frame.
    first: usize,
}

/// A motion as the file has it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bvh {
    pub joints: Vec<BvhJoint>,
    pub frame_time_s: f64,
    /// Values of all channels, `[frame][channel]`.
    frames: Vec<Vec<f64>>,
}

/// The skeleton at one time: root position, rotation of each joint in its parent's frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct BvhPose {
    pub root: DVec3,
    pub rotations: Vec<DQuat>,
}

impl Bvh {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read, or is no BVH: with the line.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|error| SimError::MotionFile {
            path: path.to_path_buf(),
            line: 0,
            expected: "a readable file".into(),
            found: error.to_string(),
        })?;
        Self::parse(&text, path)
    }

    /// Reads text; `path` is only for errors.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let mut words = Words::new(text, path);
        words.expect("HIERARCHY")?;
        words.expect("ROOT")?;
        let joints = skeleton(&mut words)?;
        words.expect("MOTION")?;
        words.expect("Frames:")?;
        let count: usize = words.number("the number of frames")?;
        words.expect("Frame")?;
        words.expect("Time:")?;
        let frame_time_s: f64 = words.number("the time between frames in seconds")?;
        if !(frame_time_s.is_finite() && frame_time_s > 0.0) {
            return Err(words.error("a positive time between frames", frame_time_s));
        }
        let channels: usize = joints.iter().map(|joint| joint.channels.len()).sum();
        let mut frames = Vec::new();
        for (number, line) in text.lines().enumerate().skip(words.line) {
            let values: Vec<&str> = line.split_whitespace().collect();
            if values.is_empty() {
                continue;
            }
            words.line = number + 1;
            if frames.len() == count {
                return Err(words.error(format!("{count} frames and then the end"), "more"));
            }
            if values.len() != channels {
                let found = format!("{} numbers", values.len());
                return Err(words.error(format!("{channels} numbers, one a channel"), found));
            }
            let mut frame = Vec::with_capacity(channels);
            for value in values {
                match value.parse::<f64>() {
                    Ok(x) if x.is_finite() => frame.push(x),
                    _ => return Err(words.error("a finite number", value)),
                }
            }
            frames.push(frame);
        }
        if frames.len() != count || count == 0 {
            let expected = format!("{} frames", count.max(1));
            return Err(words.error(expected, frames.len()));
        }
        Ok(Self {
            joints,
            frame_time_s,
            frames,
        })
    }

    /// From the first frame to the last.
    pub fn duration_s(&self) -> f64 {
        (self.frames.len() - 1) as f64 * self.frame_time_s
    }

    /// The joint of a name.
    pub fn joint(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|joint| joint.name == name)
    }

    /// The skeleton at a time, between frames by spherical interpolation; before
    /// the first and after the last frame it stays.
    pub fn at(&self, time_s: f64) -> BvhPose {
        let place = (time_s / self.frame_time_s).clamp(0.0, (self.frames.len() - 1) as f64);
        let low = place as usize;
        let high = (low + 1).min(self.frames.len() - 1);
        let share = place - low as f64;
        let (a, b) = (self.frame(low), self.frame(high));
        BvhPose {
            root: a.root.lerp(b.root, share),
            rotations: a
                .rotations
                .iter()
                .zip(&b.rotations)
                .map(|(a, b)| a.slerp(*b, share))
                .collect(),
        }
    }

    fn frame(&self, number: usize) -> BvhPose {
        let values = &self.frames[number];
        let mut root = self.joints[0].offset;
        let rotations = self
            .joints
            .iter()
            .enumerate()
            .map(|(index, joint)| {
                let mut rotation = DQuat::IDENTITY;
                for (channel, &value) in joint.channels.iter().zip(&values[joint.first..]) {
                    match *channel {
                        Channel::Position(axis) if index == 0 => root[axis] = value,
                        // Bones of a person keep their lengths.
                        Channel::Position(_) => {}
                        Channel::Rotation(axis) => {
                            let turn = DVec3::AXES[axis] * value.to_radians();
                            rotation *= DQuat::from_scaled_axis(turn);
                        }
                    }
                }
                rotation
            })
            .collect();
        BvhPose { root, rotations }
    }
}

/// Joints from the root's name on to its closing brace, parents first.
fn skeleton(words: &mut Words) -> Result<Vec<BvhJoint>> {
    let mut joints: Vec<BvhJoint> = Vec::new();
    // Joints whose braces are open; an end site is `None`.
    let mut open: Vec<Option<usize>> = Vec::new();
    let mut channels = 0;
    let start = |words: &mut Words, open: &mut Vec<_>, joints: &mut Vec<BvhJoint>, first| {
        let name = words.next("a joint's name")?.to_string();
        words.expect("{")?;
        joints.push(BvhJoint {
            name,
            parent: open.iter().rev().find_map(|joint| *joint),
            offset: DVec3::ZERO,
            channels: Vec::new(),
            first,
        });
        open.push(Some(joints.len() - 1));
        Ok(())
    };
    start(words, &mut open, &mut joints, channels)?;
    while let Some(&inner) = open.last() {
        let word = words.next("OFFSET, CHANNELS, JOINT, End or }")?;
        match (word, inner) {
            ("OFFSET", _) => {
                let mut offset = DVec3::ZERO;
                for axis in 0..3 {
                    offset[axis] = words.number("an offset")?;
                }
                if let Some(joint) = inner {
                    joints[joint].offset = offset;
                }
            }
            ("CHANNELS", Some(joint)) => {
                let count: usize = words.number("the number of channels")?;
                for _ in 0..count {
                    joints[joint].channels.push(channel(words)?);
                }
                joints[joint].first = channels;
                channels += count;
            }
            ("JOINT", Some(_)) => start(words, &mut open, &mut joints, channels)?,
            ("End", Some(_)) => {
                words.expect("Site")?;
                words.expect("{")?;
                open.push(None);
            }
            ("}", _) => {
                open.pop();
            }
            (other, _) => {
                return Err(words.error("OFFSET, CHANNELS, JOINT, End or }", other));
            }
        }
    }
    Ok(joints)
}

fn channel(words: &mut Words) -> Result<Channel> {
    let expected = "Xposition, Yposition, Zposition, Xrotation, Yrotation or Zrotation";
    let word = words.next(expected)?;
    let axis = match word.as_bytes().first() {
        Some(b'X') => 0,
        Some(b'Y') => 1,
        Some(b'Z') => 2,
        _ => return Err(words.error(expected, word)),
    };
    match &word[1..] {
        "position" => Ok(Channel::Position(axis)),
        "rotation" => Ok(Channel::Rotation(axis)),
        _ => Err(words.error(expected, word)),
    }
}

/// Words of a text with the lines they are in.
struct Words<'a> {
    path: &'a Path,
    words: Box<dyn Iterator<Item = (usize, &'a str)> + 'a>,
    /// Line of the last word, from 1.
    line: usize,
}

impl<'a> Words<'a> {
    fn new(text: &'a str, path: &'a Path) -> Self {
        let words = text
            .lines()
            .enumerate()
            .flat_map(|(number, line)| line.split_whitespace().map(move |word| (number + 1, word)));
        Self {
            path,
            words: Box::new(words),
            line: 1,
        }
    }

    fn error(&self, expected: impl Into<String>, found: impl std::fmt::Display) -> SimError {
        SimError::MotionFile {
            path: self.path.to_path_buf(),
            line: self.line,
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    fn next(&mut self, expected: &str) -> Result<&'a str> {
        match self.words.next() {
            Some((line, word)) => {
                self.line = line;
                Ok(word)
            }
            None => Err(self.error(expected, "the end of the file")),
        }
    }

    fn expect(&mut self, word: &str) -> Result<()> {
        let found = self.next(word)?;
        if found.eq_ignore_ascii_case(word) {
            return Ok(());
        }
        Err(self.error(word, found))
    }

    fn number<N: FromStr>(&mut self, expected: &str) -> Result<N> {
        let word = self.next(expected)?;
        word.parse().map_err(|_| self.error(expected, word))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_BONES: &str = "HIERARCHY
ROOT Hips
{
  OFFSET 0 10 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Leg
  {
    OFFSET 0 -5 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -4 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.5
1 2 3 0 0 90 0 90 0
3 2 3 0 0 90 0 0 0
";

    fn parse(text: &str) -> Result<Bvh> {
        Bvh::parse(text, Path::new("walk.bvh"))
    }

    #[test]
    fn channels_are_read_in_their_order_and_frames_are_interpolated() {
        let bvh = parse(TWO_BONES).unwrap();
        assert_eq!(bvh.joint("Leg"), Some(1));
        assert_eq!(bvh.duration_s(), 0.5);
        let middle = bvh.at(0.25);
        assert!(middle.root.distance(DVec3::new(2.0, 2.0, 3.0)) < 1e-12);
        assert!((middle.rotations[0] * DVec3::Z).distance(DVec3::X) < 1e-12);
        let turned = middle.rotations[1] * DVec3::Y;
        assert!(turned.distance(DVec3::new(0.0, 0.5f64.sqrt(), 0.5f64.sqrt())) < 1e-12);
        assert_eq!(bvh.at(-1.0), bvh.at(0.0));
        assert_eq!(bvh.at(9.0), bvh.at(0.5));
        // Z, then X, then Y: the last one is applied to the bone first.
        let order = parse(&TWO_BONES.replace("1 2 3 0 0 90 0 90 0", "1 2 3 90 90 0 0 0 0"));
        let turned = order.unwrap().at(0.0).rotations[0] * DVec3::Y;
        assert!(turned.distance(DVec3::Z) < 1e-12, "{turned}");
    }

    #[test]
    fn errors_name_the_line_and_what_should_stand_there() {
        let fails = |from: &str, to: &str, line: &str, expected: &str| {
            let message = parse(&TWO_BONES.replacen(from, to, 1))
                .unwrap_err()
                .to_string();
            assert!(
                message.contains(line)
                    && message.contains(expected)
                    && message.contains("walk.bvh"),
                "{message}"
            );
        };
        fails("OFFSET 0 -5 0", "OFFSET 0 x 0", "line 8", "an offset");
        fails("Xposition", "Qposition", "line 5", "Xposition");
        fails("0 90 0 90 0", "0 90 0 90", "line 19", "9 numbers");
        fails("3 2 3 0", "3 2 nan 0", "line 20", "finite");
        fails("Frames: 2", "Frames: 3", "line 20", "3 frames");
        fails(
            "Frames: 2",
            "Frames: 1",
            "line 20",
            "1 frames and then the end",
        );
        fails("Time: 0.5", "Time: 0", "line 18", "positive");
        fails("HIERARCHY", "HIERARCHIE", "line 1", "HIERARCHY");
        fails("MOTION", "}", "line 16", "MOTION");
        let message = parse("HIERARCHY\nROOT Hips\n{\n").unwrap_err().to_string();
        assert!(message.contains("the end of the file"), "{message}");
    }
}

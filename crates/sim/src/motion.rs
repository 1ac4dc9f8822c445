//! Procedural motions: sums of movements, each a smooth function of time.
//!
//! Every angle is a sum of sines and of raised-cosine steps, so joint angles
//! are C1 and angular accelerations stay human. The root follows the feet: its
//! height keeps the lower foot on the ground (softly, where the feet change
//! over), a walk moves it forward along its heading.

mod angles;
mod bvh;
mod clearance;
mod clip;
mod family;
mod movement;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::body::{Body, Pose, ShapedBody};
use crate::error::Result;

pub use clearance::{Clearance, keep_clear};
pub use clip::{Clip, NEEDED, WELCOME};
pub use family::MotionFamily;
pub use movement::Movement;

use angles::{Angles, pose_from_angles};

/// Ankles and balls of both feet.
const FEET: [&str; 4] = ["LeftFoot", "RightFoot", "LeftToeBase", "RightToeBase"];

/// Movements that go on together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// The movements.
    pub movements: Vec<Movement>,
    /// How far the arms come down from the rest pose, in degrees; the rest
    /// pose has them about 40° from the torso.
    pub arms_down_deg: f64,
    /// A recorded motion instead of movements.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clip: Option<Clip>,
}

/// Frames before a motion: the body stands still, then eases in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeadIn {
    /// Frames in the rest pose.
    pub still: usize,
    /// Frames from the rest pose to the motion.
    pub ease: usize,
}

impl Motion {
    /// The same movements at `pace` times the speed.
    #[must_use]
    pub fn at_pace(mut self, pace: f64) -> Self {
        for movement in &mut self.movements {
            *movement = movement.at_pace(pace);
        }
        if let Some(clip) = &mut self.clip {
            clip.pace *= pace;
        }
        self
    }

    /// Poses of the lead-in and of `frames` frames after it, starting from
    /// pose `rest`; frame `lead.still + lead.ease` is time 0 of the motion.
    ///
    /// # Errors
    /// The body's rig lacks a joint, or the clip cannot be used.
    pub fn poses(
        &self,
        body: &Body,
        shaped: &ShapedBody,
        rest: &Pose,
        fps: f64,
        lead: LeadIn,
        frames: usize,
    ) -> Result<Vec<Pose>> {
        if let Some(clip) = &self.clip {
            return clip.poses(body, shaped, rest, fps, lead, frames);
        }
        let mut feet = [0; 4];
        for (slot, name) in feet.iter_mut().zip(FEET) {
            *slot = body.joint(name)?.index();
        }
        let places = |pose: &Pose| -> [DVec3; 4] {
            let joints = shaped.joints(pose);
            feet.map(|foot| joints[foot].0)
        };
        let rest_feet = places(rest);
        let hip = body.joint("LeftUpLeg")?.index();
        let speed = self.speed(shaped.joints(rest)[hip].0.z);
        let first = lead.still + lead.ease;
        let mut travelled = DVec3::ZERO;
        let mut poses = Vec::with_capacity(first + frames);
        for frame in 0..first + frames {
            let time_s = (frame as f64 - first as f64) / fps;
            let eased = (frame as f64 - lead.still as f64) / lead.ease.max(1) as f64;
            let share = smooth_step(eased);
            let angles = self.angles(time_s);
            let moving = pose_from_angles(body, rest, &angles)?;
            let forward = DQuat::from_rotation_z(angles.heading) * DVec3::NEG_Y;
            travelled += share / fps * speed * forward;
            let mut pose = Pose {
                root: rest.root,
                rotations: rest
                    .rotations
                    .iter()
                    .zip(&moving.rotations)
                    .map(|(a, b)| a.slerp(*b, share))
                    .collect(),
            };
            let now = places(&pose);
            let mut shift =
                self.feet_fixed() * 0.5 * (rest_feet[0] + rest_feet[1] - now[0] - now[1]);
            shift.z = share * angles.rise - lowest_rise(&rest_feet, &now);
            pose.root += travelled + shift;
            poses.push(pose);
        }
        Ok(poses)
    }

    fn angles(&self, time_s: f64) -> Angles {
        let mut angles = Angles::default();
        for limbs in &mut angles.limbs {
            limbs.arm_raise = -self.arms_down_deg.to_radians();
            limbs.hip_abduction = 0.02;
        }
        for movement in &self.movements {
            movement.add(time_s, &mut angles);
        }
        angles
    }

    /// Forward speed in units per second.
    fn speed(&self, leg: f64) -> f64 {
        self.movements.iter().map(|m| m.speed(leg)).sum()
    }

    /// 1 when the feet stay where they are, 0 when they move.
    fn feet_fixed(&self) -> f64 {
        if self.movements.iter().any(Movement::moves_feet) {
            0.0
        } else {
            1.0
        }
    }
}

/// 0 before 0, 1 after 1, between them with two continuous derivatives.
pub(crate) fn smooth_step(share: f64) -> f64 {
    let x = share.clamp(0.0, 1.0);
    x * x * x * (x * (6.0 * x - 15.0) + 10.0)
}

/// How far the lowest of the feet's joints rose above its place at rest; a
/// smooth minimum, so that the root's height has no kink where the feet change over.
fn lowest_rise(rest: &[DVec3; 4], now: &[DVec3; 4]) -> f64 {
    let width = 0.12;
    let sum: f64 = rest
        .iter()
        .zip(now)
        .map(|(rest, now)| (-(now.z - rest.z) / width).exp())
        .sum();
    -width * (sum / 4.0).ln()
}

//! Procedural motions: sums of movements, each a smooth function of time.
//!
//! Every angle is a sum of sines and of raised-cosine steps, so joint angles
//! are C1 and angular accelerations stay human. The root follows the feet: its
//! height keeps the lower foot on the ground (softly, where the feet change
//! over), a walk moves it forward along its heading.

mod angles;

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use rand::Rng;
use serde::{Deserialize, Serialize};

use crate::body::{Body, Pose, ShapedBody};
use crate::error::Result;

use angles::{Angles, pose_from_angles};

/// One movement. Angles in degrees, times in seconds; `phase` is a share of the period.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Movement {
    /// Legs and arms swing against each other, the body goes forward.
    Walk {
        /// One left and one right step.
        period_s: f64,
        /// Swing of the thighs to each side of the middle.
        stride_deg: f64,
        /// Share of the swing on the arms.
        arms: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// Turn of the whole body, to the left when positive.
    Turn {
        /// Angle.
        angle_deg: f64,
        /// Beginning.
        start_s: f64,
        /// Duration.
        duration_s: f64,
    },
    /// Arms go up sideways and down again.
    ArmRaise {
        /// Highest angle above the resting arm: left, right.
        angle_deg: [f64; 2],
        /// Up and down.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// Knees bend and stretch; the feet stay.
    Squat {
        /// Deepest bend of the knees.
        knee_deg: f64,
        /// Down and up.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// The torso twists to the left and to the right.
    Twist {
        /// Angle to each side.
        angle_deg: f64,
        /// To and fro.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// The hips sway, the torso leans against them.
    Sway {
        /// Angle to each side.
        angle_deg: f64,
        /// To and fro.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// The torso bends forward and comes up again.
    Bow {
        /// Deepest angle.
        angle_deg: f64,
        /// Down and up.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// One leg goes up forward and sideways and comes down.
    LegLift {
        /// The left leg; otherwise the right one.
        left: bool,
        /// Highest angle of the thigh.
        angle_deg: f64,
        /// Up and down.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
}

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
    /// A brisk motion at random: a main movement and mostly a second one.
    pub fn sample(rng: &mut impl Rng) -> Self {
        let mut movements = Vec::new();
        let side = |rng: &mut _, low: f64, high: f64| {
            let size = Rng::random_range(rng, low..high);
            if Rng::random_bool(rng, 0.5) {
                size
            } else {
                -size
            }
        };
        let arm_raise = |rng: &mut _| {
            let angle = Rng::random_range(rng, 50.0..100.0);
            let one = Rng::random_bool(rng, 0.3);
            Movement::ArmRaise {
                angle_deg: [angle, if one { 0.3 * angle } else { angle }],
                period_s: Rng::random_range(rng, 2.2..3.4),
                phase: Rng::random_range(rng, 0.0..1.0),
            }
        };
        match rng.random_range(0..6) {
            0 | 1 => {
                movements.push(Movement::Walk {
                    period_s: rng.random_range(1.1..1.4),
                    stride_deg: rng.random_range(16.0..26.0),
                    arms: rng.random_range(0.6..1.1),
                    phase: rng.random_range(0.0..1.0),
                });
                if rng.random_bool(0.5) {
                    movements.push(Movement::Turn {
                        angle_deg: side(rng, 20.0, 50.0),
                        start_s: rng.random_range(0.0..0.5),
                        duration_s: rng.random_range(1.2..1.8),
                    });
                }
            }
            2 => {
                movements.push(Movement::Turn {
                    angle_deg: side(rng, 30.0, 70.0),
                    start_s: rng.random_range(0.0..0.4),
                    duration_s: rng.random_range(1.3..2.0),
                });
                movements.push(if rng.random_bool(0.5) {
                    arm_raise(rng)
                } else {
                    Movement::Sway {
                        angle_deg: rng.random_range(8.0..14.0),
                        period_s: rng.random_range(1.6..2.4),
                        phase: rng.random_range(0.0..1.0),
                    }
                });
            }
            3 => {
                movements.push(arm_raise(rng));
                movements.push(if rng.random_bool(0.5) {
                    Movement::Twist {
                        angle_deg: rng.random_range(20.0..40.0),
                        period_s: rng.random_range(1.8..2.8),
                        phase: rng.random_range(0.0..1.0),
                    }
                } else {
                    Movement::LegLift {
                        left: rng.random_bool(0.5),
                        angle_deg: rng.random_range(35.0..60.0),
                        period_s: rng.random_range(2.0..3.0),
                        phase: rng.random_range(0.0..1.0),
                    }
                });
            }
            4 => {
                movements.push(Movement::Squat {
                    knee_deg: rng.random_range(60.0..100.0),
                    period_s: rng.random_range(2.0..3.2),
                    phase: rng.random_range(0.0..1.0),
                });
                if rng.random_bool(0.5) {
                    movements.push(arm_raise(rng));
                }
            }
            _ => {
                movements.push(Movement::Bow {
                    angle_deg: rng.random_range(30.0..60.0),
                    period_s: rng.random_range(2.0..3.2),
                    phase: rng.random_range(0.0..1.0),
                });
                movements.push(Movement::Twist {
                    angle_deg: rng.random_range(20.0..35.0),
                    period_s: rng.random_range(1.8..2.6),
                    phase: rng.random_range(0.0..1.0),
                });
            }
        }
        Self {
            movements,
            arms_down_deg: rng.random_range(0.0..10.0),
        }
    }

    /// The same movements at `pace` times the speed.
    #[must_use]
    pub fn at_pace(mut self, pace: f64) -> Self {
        for movement in &mut self.movements {
            match movement {
                Movement::Walk { period_s, .. }
                | Movement::ArmRaise { period_s, .. }
                | Movement::Squat { period_s, .. }
                | Movement::Twist { period_s, .. }
                | Movement::Sway { period_s, .. }
                | Movement::Bow { period_s, .. }
                | Movement::LegLift { period_s, .. } => *period_s /= pace,
                Movement::Turn {
                    start_s,
                    duration_s,
                    ..
                } => {
                    *start_s /= pace;
                    *duration_s /= pace;
                }
            }
        }
        self
    }

    /// Poses of the lead-in and of `frames` frames after it, starting from
    /// pose `rest`; frame `lead.still + lead.ease` is time 0 of the motion.
    ///
    /// # Errors
    /// The body's rig lacks a joint.
    pub fn poses(
        &self,
        body: &Body,
        shaped: &ShapedBody,
        rest: &Pose,
        fps: f64,
        lead: LeadIn,
        frames: usize,
    ) -> Result<Vec<Pose>> {
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
            shift.z = -lowest_rise(&rest_feet, &now);
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

    /// Forward speed in units per second: what the swing of legs of this length covers.
    fn speed(&self, leg: f64) -> f64 {
        let of = |movement: &Movement| match *movement {
            Movement::Walk {
                period_s,
                stride_deg,
                ..
            } => 4.0 * leg * stride_deg.to_radians().sin() / period_s,
            _ => 0.0,
        };
        self.movements.iter().map(of).sum()
    }

    /// 1 when the feet stay where they are, 0 when they move.
    fn feet_fixed(&self) -> f64 {
        let moves = self.movements.iter().any(|movement| {
            matches!(
                movement,
                Movement::Walk { .. } | Movement::Turn { .. } | Movement::LegLift { .. }
            )
        });
        if moves { 0.0 } else { 1.0 }
    }
}

impl Movement {
    fn add(self, time_s: f64, angles: &mut Angles) {
        let turn = |period_s: f64, phase: f64| TAU * (time_s / period_s + phase);
        // 0 … 1 … 0, smooth.
        let pulse = |period_s: f64, phase: f64| 0.5 - 0.5 * turn(period_s, phase).cos();
        match self {
            Self::Walk {
                period_s,
                stride_deg,
                arms,
                phase,
            } => {
                let stride = stride_deg.to_radians();
                let at = turn(period_s, phase);
                for (side, limbs) in angles.limbs.iter_mut().enumerate() {
                    let at = at + if side == 0 { 0.0 } else { TAU / 2.0 };
                    limbs.hip_flexion += stride * at.sin() + 0.3 * stride;
                    limbs.hip_abduction += 0.04;
                    // The knee bends while the thigh comes forward.
                    let bend = 0.5 + 0.5 * (at + 0.25).cos();
                    limbs.knee_flexion += 0.15 + 1.9 * stride * bend * bend;
                    limbs.ankle_flexion += 0.25 * stride * at.sin();
                    limbs.arm_swing -= 0.9 * arms * stride * at.sin();
                    limbs.elbow_flexion += 0.25 - 0.2 * arms * stride * at.sin();
                }
                angles.twist -= 0.35 * stride * at.sin();
                angles.pelvis += 0.12 * stride * at.cos();
                angles.bend += 0.04;
            }
            Self::Turn {
                angle_deg,
                start_s,
                duration_s,
            } => {
                let share = smooth_step((time_s - start_s) / duration_s);
                angles.heading += angle_deg.to_radians() * share;
            }
            Self::ArmRaise {
                angle_deg,
                period_s,
                phase,
            } => {
                for (limbs, angle) in angles.limbs.iter_mut().zip(angle_deg) {
                    limbs.arm_raise += angle.to_radians() * pulse(period_s, phase);
                }
            }
            Self::Squat {
                knee_deg,
                period_s,
                phase,
            } => {
                let knee = knee_deg.to_radians() * pulse(period_s, phase);
                for limbs in &mut angles.limbs {
                    limbs.knee_flexion += knee;
                    limbs.hip_flexion += 0.55 * knee;
                    limbs.hip_abduction += 0.12 * knee;
                    // The sole stays level: thigh, shank and foot turn by 0 together.
                    limbs.ankle_flexion += knee - 0.55 * knee;
                    limbs.arm_swing += 0.5 * knee;
                    limbs.arm_raise += 0.15 * knee;
                }
                angles.bend += 0.3 * knee;
            }
            Self::Twist {
                angle_deg,
                period_s,
                phase,
            } => {
                angles.twist += angle_deg.to_radians() * turn(period_s, phase).sin();
            }
            Self::Sway {
                angle_deg,
                period_s,
                phase,
            } => {
                let lean = angle_deg.to_radians() * turn(period_s, phase).sin();
                angles.pelvis += 0.5 * lean;
                angles.side_bend += lean;
                // Legs stay upright under the tilted pelvis.
                angles.limbs[0].hip_abduction += 0.5 * lean;
                angles.limbs[1].hip_abduction -= 0.5 * lean;
            }
            Self::Bow {
                angle_deg,
                period_s,
                phase,
            } => {
                let bend = angle_deg.to_radians() * pulse(period_s, phase);
                angles.bend += bend;
                for limbs in &mut angles.limbs {
                    limbs.arm_swing += 0.5 * bend;
                    limbs.arm_raise += 0.25 * bend;
                }
            }
            Self::LegLift {
                left,
                angle_deg,
                period_s,
                phase,
            } => {
                let lift = angle_deg.to_radians() * pulse(period_s, phase);
                let limbs = &mut angles.limbs[usize::from(!left)];
                limbs.hip_flexion += 0.8 * lift;
                limbs.hip_abduction += 0.35 * lift;
                limbs.knee_flexion += 0.7 * lift;
                for limbs in &mut angles.limbs {
                    limbs.arm_raise += 0.2 * lift;
                }
            }
        }
    }
}

/// 0 before 0, 1 after 1, between them with two continuous derivatives.
fn smooth_step(share: f64) -> f64 {
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

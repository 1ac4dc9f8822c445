//! Movements: smooth functions of time that add to joint angles.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::angles::Angles;
use super::smooth_step;

/// Raise and swing of the arm, flexion and cross of the elbow of arms that cross, for each
/// radian of the arm's cross: left, in front and higher up, and right.
const CROSSED: [[f64; 4]; 2] = [[0.23, 0.50, 0.48, 0.81], [-0.01, 0.22, 0.21, 0.80]];

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
    /// Steps in which both feet leave the ground, elbows bent; the body goes forward.
    Run {
        /// One left and one right step.
        period_s: f64,
        /// Swing of the thighs to each side of the middle.
        stride_deg: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// Knees come up in turn, on the spot.
    March {
        /// Highest angle of the thighs.
        angle_deg: f64,
        /// One left and one right step.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// One leg is thrown forward, the torso leans back.
    Kick {
        /// The left leg; otherwise the right one.
        left: bool,
        /// Highest angle of the thigh.
        angle_deg: f64,
        /// From kick to kick.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// A crouch, then both feet leave the ground.
    Jump {
        /// Height of the jump in metres.
        height_m: f64,
        /// From jump to jump.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// One leg goes far ahead of the other, both knees bend, and back.
    Lunge {
        /// The left leg is in front; otherwise the right one.
        left: bool,
        /// Deepest bend of the front knee.
        knee_deg: f64,
        /// Down and up.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// Arms swing forward and back against each other.
    ArmSwing {
        /// Angle to each side of the middle.
        angle_deg: f64,
        /// To and fro.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
    /// Arms cross in front of the chest and open again.
    CrossArms {
        /// Turn of the arms to the other side; 57 crosses the forearms in the middle.
        angle_deg: f64,
        /// Closed and open.
        period_s: f64,
        /// Where in the period time 0 is.
        phase: f64,
    },
}

impl Movement {
    /// Adds the movement's angles at a time.
    pub(super) fn add(self, time_s: f64, angles: &mut Angles) {
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
            Self::Run {
                period_s,
                stride_deg,
                phase,
            } => {
                let stride = stride_deg.to_radians();
                let at = turn(period_s, phase);
                for (side, limbs) in angles.limbs.iter_mut().enumerate() {
                    let at = at + if side == 0 { 0.0 } else { TAU / 2.0 };
                    limbs.hip_flexion += stride * at.sin() + 0.35 * stride;
                    limbs.hip_abduction += 0.04;
                    let bend = 0.5 + 0.5 * (at + 0.3).cos();
                    limbs.knee_flexion += 0.3 + 1.9 * stride * bend * bend;
                    limbs.ankle_flexion += 0.3 * stride * at.sin();
                    limbs.arm_swing -= 0.9 * stride * at.sin() - 0.1;
                    limbs.arm_raise += 0.1;
                    limbs.elbow_flexion += 0.85 - 0.2 * stride * at.sin();
                }
                angles.twist -= 0.3 * stride * at.sin();
                angles.bend += 0.12;
                // Twice a period, 6 cm: what a runner's hips do.
                angles.rise += 0.6 * (0.5 - 0.5 * (2.0 * at).cos());
            }
            Self::March {
                angle_deg,
                period_s,
                phase,
            } => {
                let at = turn(period_s, phase);
                for (side, limbs) in angles.limbs.iter_mut().enumerate() {
                    let at = at + if side == 0 { 0.0 } else { TAU / 2.0 };
                    // Each leg is up for its half of the period.
                    let up = at.sin().max(0.0).powi(2) * angle_deg.to_radians();
                    limbs.hip_flexion += up;
                    limbs.hip_abduction += 0.04 + 0.06 * up;
                    limbs.knee_flexion += 1.1 * up;
                    limbs.arm_swing -= 0.6 * at.sin();
                    limbs.arm_raise += 0.1;
                    limbs.elbow_flexion += 0.5;
                }
            }
            Self::Kick {
                left,
                angle_deg,
                period_s,
                phase,
            } => {
                let share = pulse(period_s, phase).powi(2);
                let lift = angle_deg.to_radians() * share;
                let kicking = &mut angles.limbs[usize::from(!left)];
                kicking.hip_flexion += lift;
                kicking.hip_abduction += 0.08 * lift;
                // The knee is bent on the way and straight at the top.
                kicking.knee_flexion += 1.6 * share.sqrt() * (1.0 - share);
                let standing = &mut angles.limbs[usize::from(left)];
                standing.knee_flexion += 0.12 * lift;
                standing.hip_flexion += 0.06 * lift;
                angles.bend -= 0.15 * lift;
                for limbs in &mut angles.limbs {
                    limbs.arm_raise += 0.3 * lift;
                    limbs.elbow_flexion += 0.3 * lift;
                }
            }
            Self::Jump {
                height_m,
                period_s,
                phase,
            } => {
                let at = (time_s / period_s + phase).rem_euclid(1.0);
                let bump = |from: f64, width: f64| {
                    let share = (at - from) / width;
                    if (0.0..1.0).contains(&share) {
                        0.5 - 0.5 * (TAU * share).cos()
                    } else {
                        0.0
                    }
                };
                // Long enough that no acceleration is much beyond gravity's.
                let flight = (1.28 * height_m.sqrt() / period_s).min(0.5);
                let crouch = bump(0.0, 0.5);
                let air = bump(0.5, flight);
                for limbs in &mut angles.limbs {
                    limbs.knee_flexion += 1.1 * crouch + 0.35 * air;
                    limbs.hip_flexion += 0.65 * crouch + 0.2 * air;
                    limbs.ankle_flexion += 0.45 * crouch - 0.4 * air;
                    limbs.hip_abduction += 0.08 * crouch;
                    limbs.arm_swing += 0.9 * air - 0.35 * crouch;
                    limbs.arm_raise += 0.25 * air + 0.1 * crouch;
                }
                angles.bend += 0.35 * crouch;
                angles.rise += 10.0 * height_m * air;
            }
            Self::Lunge {
                left,
                knee_deg,
                period_s,
                phase,
            } => {
                let knee = knee_deg.to_radians() * pulse(period_s, phase);
                let front = &mut angles.limbs[usize::from(!left)];
                front.hip_flexion += 0.85 * knee;
                front.knee_flexion += knee;
                front.ankle_flexion += 0.15 * knee;
                let back = &mut angles.limbs[usize::from(left)];
                back.hip_flexion -= 0.25 * knee;
                back.knee_flexion += 0.6 * knee;
                back.ankle_flexion += 0.5 * knee;
                angles.bend += 0.1 * knee;
                for limbs in &mut angles.limbs {
                    limbs.arm_raise += 0.2 * knee;
                }
            }
            Self::ArmSwing {
                angle_deg,
                period_s,
                phase,
            } => {
                let swing = angle_deg.to_radians() * turn(period_s, phase).sin();
                for (limbs, side) in angles.limbs.iter_mut().zip([1.0, -1.0]) {
                    limbs.arm_swing += side * swing + 0.3 * swing.abs().min(0.5);
                    limbs.elbow_flexion += 0.3;
                }
                angles.twist += 0.1 * swing;
            }
            Self::CrossArms {
                angle_deg,
                period_s,
                phase,
            } => {
                let across = angle_deg.to_radians() * pulse(period_s, phase);
                for (limbs, arm) in angles.limbs.iter_mut().zip(CROSSED) {
                    limbs.arm_raise += arm[0] * across;
                    limbs.arm_swing += arm[1] * across;
                    limbs.arm_cross += across;
                    limbs.elbow_flexion += arm[2] * across;
                    limbs.elbow_cross += arm[3] * across;
                }
            }
        }
    }

    /// The same movement at `pace` times the speed.
    pub(super) fn at_pace(mut self, pace: f64) -> Self {
        match &mut self {
            Self::Walk { period_s, .. }
            | Self::ArmRaise { period_s, .. }
            | Self::Squat { period_s, .. }
            | Self::Twist { period_s, .. }
            | Self::Sway { period_s, .. }
            | Self::Bow { period_s, .. }
            | Self::LegLift { period_s, .. }
            | Self::Run { period_s, .. }
            | Self::March { period_s, .. }
            | Self::Kick { period_s, .. }
            | Self::Jump { period_s, .. }
            | Self::Lunge { period_s, .. }
            | Self::ArmSwing { period_s, .. }
            | Self::CrossArms { period_s, .. } => *period_s /= pace,
            Self::Turn {
                start_s,
                duration_s,
                ..
            } => {
                *start_s /= pace;
                *duration_s /= pace;
            }
        }
        self
    }

    /// Forward speed in units per second: what the swing of legs of this length covers.
    pub(super) fn speed(&self, leg: f64) -> f64 {
        match *self {
            Self::Walk {
                period_s,
                stride_deg,
                ..
            } => 4.0 * leg * stride_deg.to_radians().sin() / period_s,
            // Both feet are off the ground for a part of each step.
            Self::Run {
                period_s,
                stride_deg,
                ..
            } => 1.3 * 4.0 * leg * stride_deg.to_radians().sin() / period_s,
            _ => 0.0,
        }
    }

    /// Whether feet go elsewhere in it.
    pub(super) fn moves_feet(&self) -> bool {
        match self {
            Self::Walk { .. }
            | Self::Turn { .. }
            | Self::LegLift { .. }
            | Self::Run { .. }
            | Self::March { .. }
            | Self::Kick { .. }
            | Self::Jump { .. }
            | Self::Lunge { .. } => true,
            Self::ArmRaise { .. }
            | Self::Squat { .. }
            | Self::Twist { .. }
            | Self::Sway { .. }
            | Self::Bow { .. }
            | Self::ArmSwing { .. }
            | Self::CrossArms { .. } => false,
        }
    }
}

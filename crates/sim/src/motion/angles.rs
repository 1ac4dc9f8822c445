//! A pose from angles that a person understands.
//!
//! Rotations are about the axes of the world in the fitting pose: X to the
//! person's left, Y backwards, Z up. The right side mirrors the left one.

use glam::DQuat;

use crate::body::{Body, Pose};
use crate::error::Result;

/// Angles of a side's limbs in radians, relative to the rest pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Limbs {
    pub hip_flexion: f64,
    pub hip_abduction: f64,
    pub knee_flexion: f64,
    pub ankle_flexion: f64,
    /// Arm away from the torso.
    pub arm_raise: f64,
    /// Arm forward.
    pub arm_swing: f64,
    pub elbow_flexion: f64,
    /// A forward arm over to the other side.
    pub arm_cross: f64,
    /// A bent forearm over to the other side.
    pub elbow_cross: f64,
}

/// Angles of the whole body in radians, relative to the rest pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Angles {
    /// Left, right.
    pub limbs: [Limbs; 2],
    /// Turn of the whole body to the left.
    pub heading: f64,
    /// Torso: forward, to the left side, twist to the left.
    pub bend: f64,
    pub side_bend: f64,
    pub twist: f64,
    /// Pelvis tilt to the left side.
    pub pelvis: f64,
    /// Height above where the feet would stand, in units.
    pub rise: f64,
}

/// Joints of a side: hip, knee, foot, arm, forearm.
const LIMB_JOINTS: [[&str; 5]; 2] = [
    ["LeftUpLeg", "LeftLeg", "LeftFoot", "LeftArm", "LeftForeArm"],
    [
        "RightUpLeg",
        "RightLeg",
        "RightFoot",
        "RightArm",
        "RightForeArm",
    ],
];

/// Applies angles on top of the rest pose.
pub(super) fn pose_from_angles(body: &Body, rest: &Pose, angles: &Angles) -> Result<Pose> {
    let mut pose = rest.clone();
    let mut turn = |joint: &str, rotation: DQuat| -> Result<()> {
        let joint = body.joint(joint)?.index();
        pose.rotations[joint] = rotation * rest.rotations[joint];
        Ok(())
    };
    turn(
        "Hips",
        DQuat::from_rotation_z(angles.heading) * DQuat::from_rotation_y(angles.pelvis),
    )?;
    // The torso bends over three joints.
    let part = 1.0 / 3.0;
    let spine = DQuat::from_rotation_z(angles.twist * part)
        * DQuat::from_rotation_y((angles.side_bend - angles.pelvis) * part)
        * DQuat::from_rotation_x(angles.bend * part);
    for joint in ["LowerBack", "Spine", "Spine1"] {
        turn(joint, spine)?;
    }
    for (side, (limbs, names)) in angles.limbs.iter().zip(&LIMB_JOINTS).enumerate() {
        let outward = if side == 0 { -1.0 } else { 1.0 };
        turn(
            names[0],
            DQuat::from_rotation_y(outward * limbs.hip_abduction)
                * DQuat::from_rotation_x(-limbs.hip_flexion),
        )?;
        turn(names[1], DQuat::from_rotation_x(limbs.knee_flexion))?;
        turn(names[2], DQuat::from_rotation_x(-limbs.ankle_flexion))?;
        turn(
            names[3],
            DQuat::from_rotation_z(outward * limbs.arm_cross)
                * DQuat::from_rotation_x(-limbs.arm_swing)
                * DQuat::from_rotation_y(outward * limbs.arm_raise),
        )?;
        turn(
            names[4],
            DQuat::from_rotation_z(outward * limbs.elbow_cross)
                * DQuat::from_rotation_x(-limbs.elbow_flexion),
        )?;
    }
    Ok(pose)
}

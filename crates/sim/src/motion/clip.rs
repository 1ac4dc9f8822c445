//! Recorded motions: a BVH file's skeleton carried over to ours by joint names.
//!
//! A joint of ours turns as the file's joint of the same name does, in the
//! world; limbs are first turned so that their bones point where the file's
//! unposed bones point, because skeletons rest in different poses (arms out or
//! down). Needed are [`NEEDED`]; [`WELCOME`] are used where the file has them;
//! joints of other names only count through their children. Lengths are scaled
//! by the legs. The motion starts at the origin, facing −Y, and its lowest
//! step stands on the ground.

use std::path::PathBuf;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::bvh::{Bvh, BvhPose};
use super::{FEET, LeadIn, smooth_step};
use crate::body::{Body, Pose, ShapedBody};
use crate::error::{Result, SimError};

/// Joints that a file must have: the names of the CMU recordings.
pub const NEEDED: [&str; 11] = [
    "Hips",
    "LeftUpLeg",
    "LeftLeg",
    "LeftFoot",
    "RightUpLeg",
    "RightLeg",
    "RightFoot",
    "LeftArm",
    "LeftForeArm",
    "RightArm",
    "RightForeArm",
];

/// Joints that are used where a file has them.
pub const WELCOME: [&str; 12] = [
    "LowerBack",
    "Spine",
    "Spine1",
    "Neck",
    "Neck1",
    "Head",
    "LeftShoulder",
    "RightShoulder",
    "LeftHand",
    "RightHand",
    "LeftToeBase",
    "RightToeBase",
];

/// Bones that are pointed as the file's: from joint to joint.
const BONES: [(&str, &str); 8] = [
    ("LeftUpLeg", "LeftLeg"),
    ("LeftLeg", "LeftFoot"),
    ("RightUpLeg", "RightLeg"),
    ("RightLeg", "RightFoot"),
    ("LeftArm", "LeftForeArm"),
    ("LeftForeArm", "LeftHand"),
    ("RightArm", "RightForeArm"),
    ("RightForeArm", "RightHand"),
];

/// A part of a recorded motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Clip {
    /// BVH file.
    pub path: PathBuf,
    /// Where in the file the part begins: 0 as early as there is a run-up, 1 as
    /// late as there are frames left.
    pub start: f64,
    /// Times the recorded speed.
    pub pace: f64,
}

impl Clip {
    /// Poses of the lead-in and of `frames` frames after it, as
    /// [`super::Motion::poses`] gives them.
    ///
    /// # Errors
    /// The file cannot be read, is no BVH, lacks a joint or is too short.
    pub fn poses(
        &self,
        body: &Body,
        shaped: &ShapedBody,
        rest: &Pose,
        fps: f64,
        lead: LeadIn,
        frames: usize,
    ) -> Result<Vec<Pose>> {
        let bvh = Bvh::read(&self.path)?;
        let rig = Retarget::new(&bvh, body, shaped).map_err(|missing| SimError::MotionFile {
            path: self.path.clone(),
            line: 0,
            expected: format!("joints named {}", NEEDED.join(", ")),
            found: format!("no {}", missing.join(", ")),
        })?;
        // While the body eases in, the clip speeds up from standstill.
        let run_up = 0.5 * lead.ease as f64 / fps;
        let lasts = run_up + frames as f64 / fps;
        let spare = bvh.duration_s() / self.pace - lasts;
        if spare < 0.0 {
            return Err(SimError::MotionFile {
                path: self.path.clone(),
                line: 0,
                expected: format!("at least {:.2} s of motion", lasts * self.pace),
                found: format!("{:.2} s", bvh.duration_s()),
            });
        }
        let begin = run_up + self.start * spare;
        let time_at = |frame: usize| {
            let since = (frame as f64 - (lead.still + lead.ease) as f64) / fps;
            let share = 1.0 + 0.5 * since / run_up.max(1e-9);
            let clip = if since >= 0.0 {
                since
            } else {
                run_up * (share.max(0.0).powi(2) - 1.0)
            };
            self.pace * (begin + clip)
        };
        let count = lead.still + lead.ease + frames;
        let mut moved: Vec<Pose> = (0..count).map(|f| rig.pose(&bvh.at(time_at(f)))).collect();
        rig.face_forward(&mut moved);
        stand(body, shaped, rest, &mut moved, lead)?;
        Ok(moved)
    }
}

/// Fades from the rest pose, puts the start to the origin and the lowest step on the ground.
fn stand(
    body: &Body,
    shaped: &ShapedBody,
    rest: &Pose,
    poses: &mut [Pose],
    lead: LeadIn,
) -> Result<()> {
    let mut feet = [0; 4];
    for (slot, name) in feet.iter_mut().zip(FEET) {
        *slot = body.joint(name)?.index();
    }
    let lowest = |pose: &Pose| {
        let joints = shaped.joints(pose);
        feet.map(|foot| joints[foot].0.z)
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    };
    let ground = lowest(rest);
    let down = poses.iter().map(lowest).fold(f64::INFINITY, f64::min) - ground;
    let from = poses[0].root;
    for (frame, pose) in poses.iter_mut().enumerate() {
        let eased = (frame as f64 - lead.still as f64) / lead.ease.max(1) as f64;
        let share = smooth_step(eased);
        let root = pose.root - DVec3::new(from.x, from.y, down);
        for (rotation, rest) in pose.rotations.iter_mut().zip(&rest.rotations) {
            *rotation = rest.slerp(*rotation, share);
        }
        pose.root = rest.root.lerp(root, share);
        // On the way from one pose to the other the feet stay on the ground.
        if share < 1.0 {
            pose.root.z += (1.0 - share) * (ground - lowest(pose));
        }
    }
    Ok(())
}

/// How joints of ours follow the file's.
struct Retarget<'a> {
    bvh: &'a Bvh,
    /// For each of our joints the file's joint and the turn from our unposed bone to the file's.
    follows: Vec<Option<(usize, DQuat)>>,
    parents: Vec<Option<usize>>,
    /// Our units per unit of the file.
    scale: f64,
    /// Place of our root joint, unposed.
    root: DVec3,
}

impl<'a> Retarget<'a> {
    /// The error lists the joints that are missing.
    fn new(bvh: &'a Bvh, body: &Body, shaped: &ShapedBody) -> Result<Self, Vec<&'static str>> {
        let missing = |name: &&str| bvh.joint(name).is_none() || body.joint(name).is_err();
        let missing: Vec<_> = NEEDED.into_iter().filter(|name| missing(name)).collect();
        if !missing.is_empty() {
            return Err(missing);
        }
        let heads = unposed(bvh);
        let ours = |name: &str| {
            body.joint(name)
                .ok()
                .map(|joint| (joint.index(), shaped.head(joint)))
        };
        let parents = body.joint_parents();
        let mut follows = vec![None; parents.len()];
        let (mut legs, mut file_legs) = (0.0, 0.0);
        for name in NEEDED.into_iter().chain(WELCOME) {
            let (Some(theirs), Some((index, head))) = (bvh.joint(name), ours(name)) else {
                continue;
            };
            let end = BONES
                .iter()
                .find(|(from, _)| *from == name)
                .map(|(_, to)| to);
            let bone = end.and_then(|end| {
                Some((ours(end)?.1 - head, heads[bvh.joint(end)?] - heads[theirs]))
            });
            let align = bone.map_or(DQuat::IDENTITY, |(our, their)| {
                if name.ends_with("Leg") {
                    legs += our.length();
                    file_legs += their.length();
                }
                DQuat::from_rotation_arc(
                    our.normalize_or(DVec3::NEG_Z),
                    their.normalize_or(DVec3::NEG_Z),
                )
            });
            follows[index] = Some((theirs, align));
        }
        // Hands turn with their forearm's alignment.
        for side in ["Left", "Right"] {
            let fore = ours(&format!("{side}ForeArm")).and_then(|(index, _)| follows[index]);
            if let (Some((hand, _)), Some((_, align))) = (ours(&format!("{side}Hand")), fore)
                && let Some(follow) = &mut follows[hand]
            {
                follow.1 = align;
            }
        }
        Ok(Self {
            bvh,
            follows,
            parents,
            scale: if file_legs > 0.0 {
                legs / file_legs
            } else {
                1.0
            },
            root: ours("Hips").map_or(DVec3::ZERO, |(_, head)| head),
        })
    }

    fn pose(&self, pose: &BvhPose) -> Pose {
        let mut theirs: Vec<DQuat> = Vec::with_capacity(self.bvh.joints.len());
        for (joint, local) in self.bvh.joints.iter().zip(&pose.rotations) {
            let parent = joint.parent.map_or(DQuat::IDENTITY, |p| theirs[p]);
            theirs.push(parent * to_our_axes(*local));
        }
        let mut world: Vec<DQuat> = Vec::with_capacity(self.parents.len());
        let mut rotations = Vec::with_capacity(self.parents.len());
        for (follow, parent) in self.follows.iter().zip(&self.parents) {
            let parent = parent.map_or(DQuat::IDENTITY, |p: usize| world[p]);
            let turn = follow.map_or(parent, |(joint, align)| theirs[joint] * align);
            world.push(turn);
            rotations.push((parent.inverse() * turn).normalize());
        }
        Pose {
            root: self.scale * vector_to_our_axes(pose.root) - self.root,
            rotations,
        }
    }

    /// Turns the whole motion so that its first pose faces −Y.
    fn face_forward(&self, poses: &mut [Pose]) {
        let Some(first) = poses.first() else { return };
        let forward = first.rotations[0] * DVec3::NEG_Y;
        let turn = DQuat::from_rotation_z(-(forward.x).atan2(-forward.y));
        for pose in poses {
            pose.root = turn * (pose.root + self.root) - self.root;
            pose.rotations[0] = turn * pose.rotations[0];
        }
    }
}

/// Y up, facing +Z, to Z up, facing −Y: a quarter turn about X.
fn vector_to_our_axes(v: DVec3) -> DVec3 {
    DVec3::new(v.x, -v.z, v.y)
}

fn to_our_axes(q: DQuat) -> DQuat {
    DQuat::from_xyzw(q.x, -q.z, q.y, q.w)
}

/// Unposed places of the file's joints, in our axes and the file's unit.
fn unposed(bvh: &Bvh) -> Vec<DVec3> {
    let mut places: Vec<DVec3> = Vec::with_capacity(bvh.joints.len());
    for joint in &bvh.joints {
        let parent = joint.parent.map_or(DVec3::ZERO, |p| places[p]);
        places.push(parent + vector_to_our_axes(joint.offset));
    }
    places
}

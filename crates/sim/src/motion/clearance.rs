//! Keeps limbs clear of the rest of the body.
//!
//! Where a limb comes closer than a gap to a part that it is not joined to, it
//! is turned away by one more rotation of its root joint: of the six turns about
//! the axes of its parent the smallest one that frees the whole interval, faded
//! in and out over the frames around it. What no turn frees is reported.
//!
//! A limb is too close when its surface, moved outwards by the gap, meets the
//! other parts: exact for crossings, and for distances up to what moving
//! vertices along their normals does to a surface. Folds of skin at a joint
//! (groin, armpit, elbow, knee) belong to the joint and are left alone: the body
//! opens those of knees and hips and smooths skin that is folded over itself.

use std::ops::Range;

use drape_geometry::bvh::Aabb;
use drape_geometry::intersect::count_between;
use drape_geometry::normals::vertex_normals;
use glam::{DQuat, DVec3};

use super::smooth_step;
use crate::body::{Body, Pose, ShapedBody};
use crate::error::Result;

/// Frames over which a correction fades in and out.
const FADE: usize = 9;
/// Turns that are tried, in degrees.
const TURNS: [f64; 7] = [4.0, 8.0, 12.0, 17.0, 22.0, 28.0, 35.0];
/// Where a limb begins to be apart from what it is joined to: share of its first bone.
const JOINED: f64 = 0.6;

/// What was done.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Clearance {
    /// Frames in which a limb was turned away.
    pub turned: Vec<usize>,
    /// Frames in which a limb is too close all the same.
    pub tight: Vec<usize>,
}

/// A limb, and what it must keep clear of.
struct Limb {
    /// Joint that is turned.
    root: usize,
    faces: Vec<[u32; 3]>,
    others: Vec<[u32; 3]>,
}

/// Joints of each limb, its root and the end of its first bone first.
const LIMBS: [[&str; 6]; 4] = [
    [
        "LeftArm",
        "LeftForeArm",
        "LeftHand",
        "LeftFingerBase",
        "LeftHandFinger1",
        "LThumb",
    ],
    [
        "RightArm",
        "RightForeArm",
        "RightHand",
        "RightFingerBase",
        "RightHandFinger1",
        "RThumb",
    ],
    [
        "LeftUpLeg",
        "LeftLeg",
        "LeftFoot",
        "LeftToeBase",
        "LeftToeBase",
        "LeftToeBase",
    ],
    [
        "RightUpLeg",
        "RightLeg",
        "RightFoot",
        "RightToeBase",
        "RightToeBase",
        "RightToeBase",
    ],
];

/// Turns limbs away until they keep `gap` units; frames before `still` stay as they are.
///
/// # Errors
/// The body's rig lacks a joint.
pub fn keep_clear(
    body: &Body,
    shaped: &ShapedBody,
    poses: &mut [Pose],
    still: usize,
    gap: f64,
) -> Result<Clearance> {
    let limbs = limbs(body, shaped)?;
    let mut out = Clearance::default();
    let mut clear = false;
    // Twice: a limb that made room for another may have come close to a third part.
    for _ in 0..2 {
        clear = true;
        for limb in &limbs {
            let tight: Vec<usize> = (still..poses.len())
                .filter(|&frame| limb.is_tight(&shaped.pose(&poses[frame]), body.faces(), gap))
                .collect();
            for interval in intervals(&tight) {
                let turn = limb.turn_for(body, shaped, &poses[interval.clone()], gap);
                let Some(turn) = turn else { continue };
                let from = interval.start.saturating_sub(FADE).max(still);
                let to = (interval.end + FADE).min(poses.len());
                for (frame, pose) in poses.iter_mut().enumerate().take(to).skip(from) {
                    let share = share(frame, &interval, still);
                    let rotation = &mut pose.rotations[limb.root];
                    *rotation = DQuat::from_scaled_axis(turn * share) * *rotation;
                    out.turned.push(frame);
                }
            }
            clear &= tight.is_empty();
        }
        if clear {
            break;
        }
    }
    if !clear {
        let is_tight = |pose: &Pose| {
            let positions = shaped.pose(pose);
            limbs
                .iter()
                .any(|limb| limb.is_tight(&positions, body.faces(), gap))
        };
        out.tight = (still..poses.len())
            .filter(|&frame| is_tight(&poses[frame]))
            .collect();
    }
    out.turned.sort_unstable();
    out.turned.dedup();
    Ok(out)
}

/// How much of a correction for `interval` a frame gets.
fn share(frame: usize, interval: &Range<usize>, still: usize) -> f64 {
    let fade = FADE as f64;
    let after = (frame + FADE) as f64 - interval.start as f64;
    let before = (interval.end + FADE) as f64 - 1.0 - frame as f64;
    // Where the interval begins so early that there is no time to fade in, it fades in late.
    let started = (frame + 1 - still) as f64;
    smooth_step(after / fade) * smooth_step(before / fade) * smooth_step(started / fade)
}

/// Runs of frames; those that would fade into each other are one.
fn intervals(frames: &[usize]) -> Vec<Range<usize>> {
    let mut out: Vec<Range<usize>> = Vec::new();
    for &frame in frames {
        match out.last_mut() {
            Some(last) if frame <= last.end + 2 * FADE => last.end = frame + 1,
            _ => out.push(frame..frame + 1),
        }
    }
    out
}

fn limbs(body: &Body, shaped: &ShapedBody) -> Result<Vec<Limb>> {
    let main = body.main_joint();
    let rest = shaped.pose(&shaped.rest_pose());
    let mut out: Vec<Limb> = Vec::new();
    for names in LIMBS {
        let mut joints = Vec::new();
        for name in names {
            joints.push(body.joint(name)?);
        }
        let [start, end] = [shaped.head(joints[0]), shaped.head(joints[1])];
        let bone = end - start;
        // Which limb a vertex is of: 0 none, 1 joined to the trunk, 2 apart from it.
        let part = |v: u32| {
            let joint = main[v as usize];
            if !joints.contains(&joint) {
                return 0;
            }
            let place = DVec3::from_array(rest[v as usize].map(f64::from));
            let along = (place - start).dot(bone) / bone.length_squared();
            if joint != joints[0] || along > JOINED {
                2
            } else {
                1
            }
        };
        let of_limb = |f: &&[u32; 3]| f.iter().all(|&v| part(v) == 2);
        let elsewhere = |f: &&[u32; 3]| f.iter().all(|&v| part(v) == 0);
        out.push(Limb {
            root: joints[0].index(),
            faces: body.faces().iter().filter(of_limb).copied().collect(),
            others: body.faces().iter().filter(elsewhere).copied().collect(),
        });
    }
    Ok(out)
}

impl Limb {
    fn is_tight(&self, positions: &[[f32; 3]], faces: &[[u32; 3]], gap: f64) -> bool {
        let mut grown = positions.to_vec();
        for (p, n) in grown.iter_mut().zip(vertex_normals(positions, faces)) {
            for k in 0..3 {
                p[k] += gap as f32 * n[k];
            }
        }
        let around = |faces: &[[u32; 3]], positions: &[[f32; 3]]| {
            let boxes = faces
                .iter()
                .map(|f| Aabb::of(&f.map(|v| positions[v as usize])));
            boxes.fold(Aabb::EMPTY, |all, one| all.union(&one))
        };
        let limb = around(&self.faces, &grown);
        // Only what is within the box around the limb can meet it.
        let in_reach = |face: &&[u32; 3]| around(&[**face], positions).overlaps(&limb);
        let others: Vec<[u32; 3]> = self.others.iter().filter(in_reach).copied().collect();
        count_between(&grown, &self.faces, positions, &others) > 0
    }

    /// The smallest turn that frees all of the poses.
    fn turn_for(
        &self,
        body: &Body,
        shaped: &ShapedBody,
        poses: &[Pose],
        gap: f64,
    ) -> Option<DVec3> {
        let axes = [
            DVec3::X,
            DVec3::NEG_X,
            DVec3::Y,
            DVec3::NEG_Y,
            DVec3::Z,
            DVec3::NEG_Z,
        ];
        let frees = |pose: &Pose, turn: DVec3| {
            let mut pose = pose.clone();
            let rotation = &mut pose.rotations[self.root];
            *rotation = DQuat::from_scaled_axis(turn) * *rotation;
            !self.is_tight(&shaped.pose(&pose), body.faces(), gap)
        };
        TURNS.iter().find_map(|degrees| {
            axes.iter()
                .map(|axis| *axis * degrees.to_radians())
                .find(|&turn| poses.iter().all(|pose| frees(pose, turn)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_that_would_fade_into_each_other_are_one() {
        assert_eq!(intervals(&[]), []);
        let one = 3..9 + 2 * FADE;
        assert_eq!(intervals(&[3, 4, 7, 8 + 2 * FADE]), [one]);
        assert_eq!(
            intervals(&[3, 5 + 2 * FADE]),
            [3..4, 5 + 2 * FADE..6 + 2 * FADE]
        );
    }

    #[test]
    fn a_correction_is_whole_in_its_interval_and_gone_before_and_after() {
        let interval = 40..50;
        for frame in interval.clone() {
            assert_eq!(share(frame, &interval, 0), 1.0, "{frame}");
        }
        assert_eq!(share(40 - FADE, &interval, 0), 0.0);
        assert_eq!(share(49 + FADE, &interval, 0), 0.0);
        assert!(share(39, &interval, 0) > 0.5 && share(50, &interval, 0) > 0.5);
    }
}

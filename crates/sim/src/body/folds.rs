//! Flesh in the folds of bent knees and hips.
//!
//! Linear blend skinning lets thigh and calf, or thigh and belly, go through each
//! other when a joint bends far, and shuts what little room cloth has there.
//! Flesh gives way: each side of a fold stays on its own side of the plane that
//! halves the joint's angle, with room for cloth between, and gets no farther
//! from it than it is at rest.

use glam::{DQuat, DVec3};

use super::asset::Asset;
use super::skinning::Joint;
use crate::motion::smooth_step;

/// From the halving plane to the flesh: half of two fabrics, each 4 mm from the skin, 3 mm
/// apart, their folds, and what smoothing takes of it; units of 0.1 m.
const ROOM: f64 = 0.11;
/// How fast the room opens with the distance from the fold at rest.
const OPENS: f64 = 0.5;
/// Bends between which flesh begins to give way, in degrees.
const BENDS: [f64; 2] = [45.0, 75.0];
/// So far from the joint into the hollow the fold is whole, so far on the other side it ends; units.
const DEEP: f64 = 0.2;
/// The groin runs down to the middle of the body: tangent of its slope.
const GROIN: f64 = 0.6;

/// The joint, the end of its bone, who moves the flesh around it, the slope towards +X.
type Place = ([&'static str; 2], &'static [&'static str], f64);

const PLACES: [Place; 4] = [
    (["LeftLeg", "LeftFoot"], &["LeftUpLeg", "LeftLeg"], 0.0),
    (["RightLeg", "RightFoot"], &["RightUpLeg", "RightLeg"], 0.0),
    (
        ["LeftUpLeg", "LeftLeg"],
        &["LeftUpLeg", "Hips", "LowerBack"],
        GROIN,
    ),
    (
        ["RightUpLeg", "RightLeg"],
        &["RightUpLeg", "Hips", "LowerBack"],
        -GROIN,
    ),
];

/// One fold.
#[derive(Clone, Debug)]
pub(super) struct Fold {
    joint: usize,
    end: usize,
    /// What carries the joint.
    parent: usize,
    /// From the end of the bone to the joint, at rest.
    up: DVec3,
    slope: f64,
    /// Vertices of the flesh, and how far above the fold each is at rest; units.
    members: Vec<(usize, f64)>,
}

/// Folds of a body; none where the rig has no such joints.
pub(super) fn folds(asset: &Asset, positions: &[DVec3], heads: &[DVec3]) -> Vec<Fold> {
    let of = |(names, flesh, slope): Place| -> Option<Fold> {
        let index = |name: &str| asset.joint(name).ok().map(Joint::index);
        let [joint, end] = [index(names[0])?, index(names[1])?];
        let flesh: Vec<usize> = flesh.iter().filter_map(|name| index(name)).collect();
        let up = (heads[joint] - heads[end]).normalize();
        let normal = sloped(up, DVec3::X, slope);
        let member = |(v, p): (usize, &DVec3)| {
            let moved_by = asset.skin[v].main_joint();
            let own_half = p.x * heads[joint].x >= 0.0;
            let above = (*p - heads[joint]).dot(normal);
            (own_half && flesh.contains(&moved_by)).then_some((v, above))
        };
        Some(Fold {
            joint,
            end,
            parent: asset.parents[joint]?,
            up,
            slope,
            members: positions.iter().enumerate().filter_map(member).collect(),
        })
    };
    PLACES.into_iter().filter_map(of).collect()
}

impl Fold {
    /// Keeps posed vertices on their sides; `joints` are places and rotations of the pose.
    pub fn open(&self, positions: &mut [DVec3], joints: &[(DVec3, DQuat)]) {
        let at = joints[self.joint].0;
        let turn = joints[self.parent].1;
        let up = turn * self.up;
        let down = (joints[self.end].0 - at).normalize();
        let bend = up.dot(-down).clamp(-1.0, 1.0).acos().to_degrees();
        let share = smooth_step((bend - BENDS[0]) / (BENDS[1] - BENDS[0]));
        // Straight joints have nothing to do, joints folded flat no plane; numbers that are not finite end here.
        if !(share > 0.0 && (up + down).length() > 1e-9 && (up - down).length() > 1e-9) {
            return;
        }
        let hollow = (up + down).normalize();
        let across = sloped((up - down).normalize(), turn * DVec3::X, self.slope);
        for &(v, above) in &self.members {
            let p = &mut positions[v];
            let depth = (*p - at).dot(hollow) / DEEP;
            let side = above.signum();
            let apart = side * (*p - at).dot(across);
            let least = smooth_step(depth) * ROOM.min(OPENS * above.abs());
            let most = least.max(above.abs());
            let moved = apart.max(least).min(most) - apart;
            *p += across * (side * moved * smooth_step(depth + 1.0) * share);
        }
    }
}

/// The normal of a plane that goes down along `sideways`.
fn sloped(normal: DVec3, sideways: DVec3, slope: f64) -> DVec3 {
    (normal - sideways * slope).normalize()
}

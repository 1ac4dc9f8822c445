//! Poses and linear blend skinning.

use glam::{DQuat, DVec3};

use super::asset::Asset;
use super::creases::Creases;
use super::folds::{Fold, folds};

/// A joint of the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Joint(pub(super) u8);

impl Joint {
    /// Index into the rig's joints.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Joint rotations, each in the axes of the world at rest and relative to its
/// parent, and where the root joint goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Displacement of the root joint from its place at rest.
    pub root: DVec3,
    /// Rotation of each joint, `[joint]`.
    pub rotations: Vec<DQuat>,
}

/// A body of one shape.
#[derive(Clone, Debug)]
pub struct ShapedBody<'a> {
    asset: &'a Asset,
    positions: Vec<DVec3>,
    heads: Vec<DVec3>,
    folds: Vec<Fold>,
    creases: Creases,
}

impl<'a> ShapedBody<'a> {
    pub(super) fn new(asset: &'a Asset, positions: Vec<DVec3>, heads: Vec<DVec3>) -> Self {
        let folds = folds(asset, &positions, &heads);
        let creases = Creases::new(asset, &positions);
        Self {
            asset,
            positions,
            heads,
            folds,
            creases,
        }
    }

    /// The pose that changes nothing.
    pub fn rest_pose(&self) -> Pose {
        Pose {
            root: DVec3::ZERO,
            rotations: vec![DQuat::IDENTITY; self.heads.len()],
        }
    }

    /// Where a joint is, unposed.
    pub fn head(&self, joint: Joint) -> DVec3 {
        self.heads[joint.index()]
    }

    /// Joint positions and global rotations of a pose, `[joint]`.
    pub fn joints(&self, pose: &Pose) -> Vec<(DVec3, DQuat)> {
        let mut out: Vec<(DVec3, DQuat)> = Vec::with_capacity(self.heads.len());
        for (j, parent) in self.asset.parents.iter().enumerate() {
            out.push(match *parent {
                None => (self.heads[j] + pose.root, pose.rotations[j]),
                Some(p) => {
                    let (at, turn) = out[p];
                    let head = at + turn * (self.heads[j] - self.heads[p]);
                    (head, turn * pose.rotations[j])
                }
            });
        }
        out
    }

    /// Vertex positions of a pose, `[vertex, 3]`.
    pub fn pose(&self, pose: &Pose) -> Vec<[f32; 3]> {
        let joints = self.joints(pose);
        let mut positions: Vec<DVec3> = self
            .positions
            .iter()
            .zip(&self.asset.skin)
            .map(|(p, skin)| {
                let mut sum = DVec3::ZERO;
                for (&j, &w) in skin.joints.iter().zip(&skin.weights) {
                    if w > 0 {
                        let j = usize::from(j);
                        let (at, turn) = joints[j];
                        sum += (at + turn * (*p - self.heads[j])) * (f64::from(w) / 255.0);
                    }
                }
                sum
            })
            .collect();
        for fold in &self.folds {
            fold.open(&mut positions, &joints);
        }
        self.creases.smooth(self.asset, &mut positions);
        positions
            .iter()
            .map(|p| p.to_array().map(|x| x as f32))
            .collect()
    }
}

//! The CC0 MakeHuman body: shapes, joints, linear blend skinning.
//!
//! Units 0.1 m (scale 10), Z up, facing −Y, the body's left at +X, soles at
//! z = 0 in the rest pose. The asset's layout and origin are told by
//! `assets/pack_body.py`, the program that packs it.

mod asset;
mod creases;
mod folds;
mod shape;
mod skinning;

pub use shape::{Shape, ShapeRanges};
pub use skinning::{Joint, Pose, ShapedBody};

use asset::Asset;
use glam::DVec3;

use crate::error::Result;

/// The body for every shape and pose.
#[derive(Clone, Debug)]
pub struct Body {
    asset: Asset,
}

impl Body {
    /// Reads the packed body that is part of the program.
    ///
    /// # Errors
    /// The asset was replaced by something else.
    pub fn load() -> Result<Self> {
        let asset = Asset::parse(include_bytes!("../../../assets/body.bin"))?;
        Ok(Self { asset })
    }

    /// Triangles, `[face, 3]`, counter-clockwise from outside; the surface is closed.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.asset.faces
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.asset.positions.len()
    }

    /// The joint that moves each vertex most, `[vertex]`.
    pub fn main_joint(&self) -> Vec<Joint> {
        let skin = self.asset.skin.iter();
        skin.map(|skin| Joint(skin.main_joint() as u8)).collect()
    }

    /// Parent of each joint, `[joint]`; parents come before their children.
    pub fn joint_parents(&self) -> Vec<Option<usize>> {
        self.asset.parents.clone()
    }

    /// The joint of a CMU name such as `LeftForeArm`.
    ///
    /// # Errors
    /// No such joint.
    pub fn joint(&self, name: &str) -> Result<Joint> {
        self.asset.joint(name)
    }

    /// The body of one shape, unposed: arms down at about 45°, soles at z = 0.
    pub fn shaped(&self, shape: &Shape) -> ShapedBody<'_> {
        let mut positions = self.asset.positions.clone();
        let mut heads = self.asset.heads.clone();
        for (name, weight) in shape.blend_weights() {
            let Some(index) = self.asset.shapes.iter().position(|s| *s == name) else {
                continue; // average muscle with average weight is the base itself
            };
            for (p, d) in positions.iter_mut().zip(&self.asset.offsets[index]) {
                *p += *d * weight;
            }
            for (p, d) in heads.iter_mut().zip(&self.asset.head_offsets[index]) {
                *p += *d * weight;
            }
        }
        let sole = positions.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
        let lift = DVec3::new(0.0, 0.0, -sole);
        for p in positions.iter_mut().chain(heads.iter_mut()) {
            *p += lift;
        }
        ShapedBody::new(&self.asset, positions, heads)
    }
}

//! Reads `assets/body.bin`; the layout is documented in `assets/pack_body.py`.

use glam::DVec3;

use super::Joint;
use crate::error::{Result, SimError};

/// Joints and weights (sum 255) of one vertex.
#[derive(Clone, Copy, Debug)]
pub(super) struct Skin {
    pub joints: [u8; 4],
    pub weights: [u8; 4],
}

impl Skin {
    /// The joint that moves the vertex most.
    pub fn main_joint(&self) -> usize {
        let best = (0..4).max_by_key(|&k| (self.weights[k], 4 - k));
        usize::from(self.joints[best.expect("four")])
    }
}

/// The packed body.
#[derive(Clone, Debug)]
pub(super) struct Asset {
    pub positions: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    pub skin: Vec<Skin>,
    pub heads: Vec<DVec3>,
    pub parents: Vec<Option<usize>>,
    pub joints: Vec<String>,
    pub shapes: Vec<String>,
    /// `[shape][vertex]`
    pub offsets: Vec<Vec<DVec3>>,
    /// `[shape][joint]`
    pub head_offsets: Vec<Vec<DVec3>>,
}

struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        if self.0.len() < count {
            return Err(SimError::BodyAsset("it ends too early".into()));
        }
        let (head, tail) = self.0.split_at(count);
        self.0 = tail;
        Ok(head)
    }

    fn words<const N: usize>(&mut self, count: usize) -> Result<Vec<[u8; N]>> {
        let bytes = self.take(N * count)?;
        Ok(bytes
            .chunks_exact(N)
            .map(|c| c.try_into().expect("chunks of N"))
            .collect())
    }

    fn vectors(&mut self, count: usize) -> Result<Vec<DVec3>> {
        let x = self.words::<4>(3 * count)?;
        Ok(x.chunks_exact(3)
            .map(|c| DVec3::from_array([0, 1, 2].map(|k| f64::from(f32::from_le_bytes(c[k])))))
            .collect())
    }

    fn offsets(&mut self, scales: &[f64], count: usize) -> Result<Vec<Vec<DVec3>>> {
        scales
            .iter()
            .map(|scale| {
                let x = self.words::<2>(3 * count)?;
                Ok(x.chunks_exact(3)
                    .map(|c| {
                        let v = [0, 1, 2].map(|k| f64::from(i16::from_le_bytes(c[k])));
                        DVec3::from_array(v) * *scale
                    })
                    .collect())
            })
            .collect()
    }

    fn names(&mut self, count: usize) -> Result<Vec<String>> {
        (0..count)
            .map(|_| {
                let length = usize::from(self.take(1)?[0]);
                String::from_utf8(self.take(length)?.to_vec())
                    .map_err(|_| SimError::BodyAsset("a name is not UTF-8".into()))
            })
            .collect()
    }
}

impl Asset {
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let mut at = Cursor(bytes);
        if at.take(8)? != b"DRPBODY1" {
            return Err(SimError::BodyAsset("expected the magic DRPBODY1".into()));
        }
        let counts = at.words::<4>(4)?;
        let [vertices, faces, joints, shapes] =
            [0, 1, 2, 3].map(|k| u32::from_le_bytes(counts[k]) as usize);
        let positions = at.vectors(vertices)?;
        let corner = at.words::<4>(3 * faces)?;
        let faces: Vec<[u32; 3]> = corner
            .chunks_exact(3)
            .map(|c| [0, 1, 2].map(|k| u32::from_le_bytes(c[k])))
            .collect();
        let skin_joints = at.words::<4>(vertices)?;
        let skin_weights = at.words::<4>(vertices)?;
        let skin: Vec<Skin> = skin_joints
            .into_iter()
            .zip(skin_weights)
            .map(|(joints, weights)| Skin { joints, weights })
            .collect();
        let heads = at.vectors(joints)?;
        let parents: Vec<Option<usize>> = at
            .words::<4>(joints)?
            .into_iter()
            .map(|w| usize::try_from(i32::from_le_bytes(w)).ok())
            .collect();
        let scales: Vec<f64> = at
            .words::<4>(shapes)?
            .into_iter()
            .map(|w| f64::from(f32::from_le_bytes(w)))
            .collect();
        let offsets = at.offsets(&scales, vertices)?;
        let head_offsets = at.offsets(&scales, joints)?;
        let asset = Self {
            positions,
            faces,
            skin,
            heads,
            parents,
            joints: at.names(joints)?,
            shapes: at.names(shapes)?,
            offsets,
            head_offsets,
        };
        asset.check(at.0.len())?;
        Ok(asset)
    }

    pub fn joint(&self, name: &str) -> Result<Joint> {
        let index = self.joints.iter().position(|j| j == name);
        index
            .map(|i| Joint(i as u8))
            .ok_or_else(|| SimError::BodyAsset(format!("it has no joint {name}")))
    }

    fn check(&self, left: usize) -> Result<()> {
        let vertices = self.positions.len() as u32;
        let ordered = |(i, p): (usize, &Option<usize>)| p.is_none_or(|p| p < i);
        let ok = left == 0
            && self.faces.iter().flatten().all(|&v| v < vertices)
            && self.parents.iter().enumerate().all(ordered)
            && self.skin.iter().all(|s| {
                s.joints.iter().all(|&j| usize::from(j) < self.heads.len())
                    && s.weights.iter().map(|&w| u32::from(w)).sum::<u32>() == 255
            });
        ok.then_some(())
            .ok_or_else(|| SimError::BodyAsset("its tables do not fit together".into()))
    }
}

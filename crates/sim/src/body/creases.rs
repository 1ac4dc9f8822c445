//! Posed skin that is folded over on itself is smoothed.
//!
//! Where joints bend far, skinning and the planes of [`super::folds`] leave specks
//! of skin folded over sharply, which go through each other: at the knees' sides,
//! in the crotch, in the armpits. Around edges that are blunt at rest and sharp in
//! the pose, vertices move towards the middle of their neighbours. All of it
//! depends on the pose alone, and continuously; skin without such edges stays as it is.

use std::collections::BTreeMap;

use glam::DVec3;

use super::asset::Asset;
use crate::motion::smooth_step;

/// Cosine between the normals of two faces below which their edge is never smoothed: it is sharp at rest.
const BLUNT: f64 = 0.5;
/// Cosines in the pose at which smoothing begins and is whole.
const SHARP: [f64; 2] = [0.3, -0.3];
/// So many edges far the neighbourhood of a crease is smoothed too, each time by this share of the one before.
const SPREAD: usize = 3;
const FADES: f64 = 0.8;
/// Rounds of smoothing.
const ROUNDS: usize = 8;

/// Where skin may be smoothed.
#[derive(Clone, Debug)]
pub(super) struct Creases {
    /// Vertices and faces of the edges that are blunt at rest.
    edges: Vec<[[u32; 2]; 2]>,
    /// Neighbours of each vertex.
    near: Vec<Vec<u32>>,
}

impl Creases {
    /// Those of a body with these vertices at rest.
    pub fn new(asset: &Asset, rest: &[DVec3]) -> Self {
        let normals = normals(asset, rest);
        // The surface is closed: each edge runs once in either direction.
        let mut near = vec![Vec::new(); rest.len()];
        let mut sides = Vec::with_capacity(3 * asset.faces.len());
        for (face, &[a, b, c]) in (0..).zip(&asset.faces) {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                near[from as usize].push(to);
                sides.push(([from.min(to), from.max(to)], face));
            }
        }
        sides.sort_unstable();
        let of = |sides: &[([u32; 2], u32)]| match *sides {
            [(edge, f), (_, g)] => {
                (normals[f as usize].dot(normals[g as usize]) > BLUNT).then_some([edge, [f, g]])
            }
            _ => None,
        };
        let edges = sides.chunk_by(|a, b| a.0 == b.0).filter_map(of).collect();
        Self { edges, near }
    }

    /// Smooths posed vertices around creases.
    pub fn smooth(&self, asset: &Asset, positions: &mut [DVec3]) {
        let weights = self.weights(&normals(asset, positions));
        let mut smoothed = Vec::new();
        for _ in 0..ROUNDS {
            for (&v, weight) in &weights {
                let near = &self.near[v as usize];
                let sum: DVec3 = near.iter().map(|&n| positions[n as usize]).sum();
                let middle = sum / near.len() as f64;
                smoothed.push(positions[v as usize].lerp(middle, 0.5 * weight));
            }
            for (&v, p) in weights.keys().zip(smoothed.drain(..)) {
                positions[v as usize] = p;
            }
        }
    }

    /// How much vertices are smoothed: 1 at creases, less around them.
    fn weights(&self, normals: &[DVec3]) -> BTreeMap<u32, f64> {
        let mut weights = BTreeMap::new();
        let raise = |weights: &mut BTreeMap<u32, f64>, v, to: f64| {
            let weight = weights.entry(v).or_insert(to);
            *weight = weight.max(to);
        };
        for &[edge, faces] in &self.edges {
            let [f, g] = faces.map(|face| normals[face as usize]);
            let sharp = smooth_step((SHARP[0] - f.dot(g)) / (SHARP[0] - SHARP[1]));
            // Not so for numbers that are not finite.
            if sharp > 0.0 {
                for v in edge {
                    raise(&mut weights, v, sharp);
                }
            }
        }
        for _ in 0..SPREAD {
            for (v, weight) in weights.clone() {
                for &n in &self.near[v as usize] {
                    raise(&mut weights, n, FADES * weight);
                }
            }
        }
        weights
    }
}

fn normals(asset: &Asset, positions: &[DVec3]) -> Vec<DVec3> {
    let of = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| positions[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    asset.faces.iter().map(of).collect()
}

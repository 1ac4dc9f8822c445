//! No pair may cross within a substep: a plane that separates it, or a move.
//!
//! Two convex features that move linearly stay apart throughout a substep if
//! one fixed normal n separates them at both of its ends: the gap
//! min n·A − max n·B is concave in time, so it is positive in between. The
//! normals tried are that of the closest points at the start, that at the end,
//! and their sum. The body is just a set of moving vertices.
//!
//! Pairs that fail are repaired in two stages. First, vertices are pushed
//! apart along the pair's normal until a plane with [`FLOOR_M`] of room
//! separates them, in passes over the pairs that touch moved vertices. Then
//! what still fails is gathered into zones that repeat the mean displacement
//! of their vertices, or the body's where it takes part: the features of such a
//! pair do not move against each other, so a pair that was apart stays apart.
//!
//! Pairs that are not given here must not be able to meet: [`super::tubes`]
//! and [`super::strays`] see to that. What is left of failing pairs after all
//! passes is counted, not hidden.

use glam::DVec3;

use super::pair::{Features, Pair, separation};
use crate::engine::state::State;

/// Room that a repaired pair keeps: without it gaps would shrink from substep to substep.
const FLOOR_M: f64 = 5e-5;
/// Passes of the first stage.
const PUSHES: u32 = 20;
/// Passes of the second stage.
const MERGES: u32 = 12;

/// What a repair needs to remember between substeps: nothing but buffers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Certificate {
    /// Pass in which a vertex was last moved.
    moved: Vec<u32>,
    zone: Vec<u32>,
}

/// What one certification did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Outcome {
    /// Pairs that failed at first.
    pub failed: u32,
    /// Pairs that still failed at the end.
    pub left: u32,
    /// Pairs that strays asked for.
    pub found: u64,
}

impl Certificate {
    pub fn new(vertices: usize) -> Self {
        Self {
            moved: vec![0; vertices],
            zone: vec![0; vertices],
        }
    }

    /// Certifies `pairs`, moving `state.p` where needed. The first `certified`
    /// of them are known to hold at present.
    pub fn certify(&mut self, pairs: &[&Pair], certified: usize, state: &mut State) -> Outcome {
        self.moved.fill(0);
        let mut outcome = Outcome::default();
        let known = |pass: u32| if pass == 0 { certified } else { 0 };
        for pass in 0..PUSHES {
            let mut failing = 0;
            for pair in &pairs[known(pass)..] {
                let moved = |&v: &u32| self.moved[v as usize] >= pass;
                let touched = pass == 0 || pair.vertices.iter().any(moved);
                if touched && !separated(pair, state) {
                    failing += 1;
                    self.push(pair, state, pass + 1);
                }
            }
            if pass == 0 {
                outcome.failed = failing;
            }
            if failing == 0 {
                return outcome;
            }
        }
        for _ in 0..MERGES {
            if !self.merge(pairs, state) {
                return outcome;
            }
        }
        outcome.left = pairs.iter().filter(|pair| !separated(pair, state)).count() as u32;
        outcome
    }

    /// Pushes the vertices of a pair to their sides of a plane.
    fn push(&mut self, pair: &Pair, state: &mut State, stamp: u32) {
        let (first, second) = split(pair);
        for &i in first {
            for &j in second {
                let (i, j) = (i as usize, j as usize);
                let w = state.w[i] + state.w[j];
                let missing = FLOOR_M - pair.normal.dot(state.p[i] - state.p[j]);
                if missing <= 0.0 || w <= 0.0 {
                    continue;
                }
                let push = (missing / w) * pair.normal;
                let (wi, wj) = (state.w[i], state.w[j]);
                state.p[i] += wi * push;
                state.p[j] -= wj * push;
                for (v, w) in [(i, wi), (j, wj)] {
                    if w > 0.0 {
                        self.moved[v] = stamp;
                    }
                }
            }
        }
    }

    /// Joins the vertices of failing pairs into zones and lets each move as one.
    fn merge(&mut self, pairs: &[&Pair], state: &mut State) -> bool {
        for (v, zone) in self.zone.iter_mut().enumerate() {
            *zone = v as u32;
        }
        let mut failing = false;
        for pair in pairs {
            if !separated(pair, state) {
                failing = true;
                let root = self.root(pair.vertices[0]);
                for &v in &pair.vertices[1..] {
                    let other = self.root(v);
                    self.zone[other as usize] = root;
                }
            }
        }
        if !failing {
            return false;
        }
        // Mass-weighted displacement of each zone; vertices that are moved from outside decide alone.
        let count = state.x.len();
        let mut mean = vec![(DVec3::ZERO, 0.0_f64); count];
        let mut size = vec![0u32; count];
        for v in 0..count {
            let root = self.root(v as u32) as usize;
            size[root] += 1;
            let weight = if state.w[v] > 0.0 {
                1.0 / state.w[v]
            } else {
                1e12
            };
            mean[root].0 += weight * (state.p[v] - state.x[v]);
            mean[root].1 += weight;
        }
        for v in 0..state.cloth {
            let root = self.root(v as u32) as usize;
            if size[root] > 1 && state.w[v] > 0.0 {
                state.p[v] = state.x[v] + mean[root].0 / mean[root].1;
            }
        }
        true
    }

    fn root(&mut self, mut v: u32) -> u32 {
        while self.zone[v as usize] != v {
            let next = self.zone[self.zone[v as usize] as usize];
            self.zone[v as usize] = next;
            v = next;
        }
        v
    }
}

/// Vertices of the first and of the second feature.
fn split(pair: &Pair) -> (&[u32], &[u32]) {
    pair.vertices.split_at(match pair.features {
        Features::VertexFace => 1,
        Features::EdgeEdge => 2,
    })
}

/// min n·A − max n·B.
#[inline]
fn gap(pair: &Pair, n: DVec3, x: &[DVec3]) -> f64 {
    let along = |k: usize| n.dot(x[pair.vertices[k] as usize]);
    let (a, b, c, d) = (along(0), along(1), along(2), along(3));
    match pair.features {
        Features::VertexFace => a - b.max(c).max(d),
        Features::EdgeEdge => a.min(b) - c.max(d),
    }
}

/// Whether one plane's normal separates the pair at both ends of the substep.
pub(crate) fn separated(pair: &Pair, state: &State) -> bool {
    let apart = |n: DVec3| gap(pair, n, &state.x) > 0.0 && gap(pair, n, &state.p) > 0.5 * FLOOR_M;
    if apart(pair.normal) {
        return true;
    }
    let d = separation(pair.features, pair.vertices, &state.p).d;
    let Some(end) = d.try_normalize() else {
        return false;
    };
    apart(end) || (pair.normal + end).try_normalize().is_some_and(apart)
}

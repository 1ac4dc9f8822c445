//! Contact between garments: vertices, faces and edges of both, each pair on
//! the side where it is, except that an outer garment's vertex just inside an
//! inner one (and the reverse) is brought back outside.

use super::contact::PairList;
use super::contact::pair::Features;
use super::contact::search::{Candidate, Surfaces};
use super::fabric::Fabric;
use super::state::State;

/// Deeper than this, being on the wrong side is taken for another place of the garment, m.
const RESCUE_M: f64 = 0.008;

/// Pairs of different garments.
#[derive(Clone, Debug)]
pub(super) struct LayerContact {
    pub list: PairList,
    pub thickness: f64,
}

impl LayerContact {
    pub fn new(thickness: f64) -> Self {
        Self {
            list: PairList::default(),
            thickness,
        }
    }

    /// Takes a candidate of two garments up.
    pub fn add(
        &mut self,
        found: &Candidate,
        surfaces: &Surfaces,
        fabric: &Fabric,
        state: &State,
        now: u32,
    ) {
        let [first, _, third, _] = found.vertices;
        // The second feature starts at vertex 1 of a vertex and face, at 2 of two edges.
        let garments = [first, third].map(|v| fabric.garment_of[v as usize]);
        let [layer_a, layer_b] = garments.map(|g| fabric.garments[g as usize].layer);
        let friction = 0.5 * (fabric.cloth_of(first).friction + fabric.cloth_of(third).friction);
        let side = wrong_side(found, surfaces, state, garments, layer_a.cmp(&layer_b));
        match (side, found.features) {
            // Crossed edges come apart when their vertices do.
            (true, Features::EdgeEdge) => {}
            (turned, _) => self
                .list
                .pairs
                .push(found.pair(self.thickness, friction, turned, now)),
        }
    }
}

/// Whether an outer feature lies just inside an inner one.
fn wrong_side(
    found: &Candidate,
    surfaces: &Surfaces,
    state: &State,
    garments: [u32; 2],
    order: std::cmp::Ordering,
) -> bool {
    use std::cmp::Ordering::{Equal, Greater, Less};
    if order == Equal || !found.separation.interior || found.distance > RESCUE_M {
        return false;
    }
    let d = found.separation.d;
    let normal = |k: usize| surfaces.normals[found.vertices[k] as usize];
    // D points from the second feature to the first; `out` from the inner surface outwards.
    let outside = if order == Greater { d } else { -d };
    match (found.features, order) {
        (Features::VertexFace, Greater) => {
            let [_, a, b, c] = found.vertices.map(|v| state.x[v as usize]);
            let face = (b - a).cross(c - a) * surfaces.outward(garments[1]);
            outside.dot(face) < 0.0
        }
        (Features::VertexFace, Less | Equal) => outside.dot(normal(0)) < -0.5 * found.distance,
        (Features::EdgeEdge, Greater) => outside.dot(normal(2) + normal(3)) < -found.distance,
        (Features::EdgeEdge, Less | Equal) => outside.dot(normal(0) + normal(1)) < -found.distance,
    }
}

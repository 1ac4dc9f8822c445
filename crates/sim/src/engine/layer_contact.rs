//! Contact between garments: vertices, faces and edges of both, each pair on
//! the side where it is.
//!
//! While garments cross each other, an outer garment's vertex just inside an
//! inner one (and the reverse) is brought back outside, and whatever else it
//! could meet lets it pass.

use std::collections::BTreeSet;

use super::contact::list::PairList;
use super::contact::pair::Features;
use super::contact::pair::Pair;
use super::contact::search::{Candidate, Search};

/// Deeper than this, being on the wrong side is taken for another place of the garment, m.
const RESCUE_M: f64 = 0.008;

/// Pairs of different garments.
#[derive(Clone, Debug)]
pub(super) struct LayerContact {
    pub list: PairList,
    pub thickness: f64,
    /// Whether garments cross at present.
    pub recovering: bool,
    /// Pairs that hold only if none of their vertices is on the wrong side.
    doubtful: Vec<Pair>,
    /// Vertices that are being brought back.
    wrong: BTreeSet<u32>,
}

impl LayerContact {
    pub fn new(thickness: f64) -> Self {
        Self {
            list: PairList::default(),
            thickness,
            recovering: false,
            doubtful: Vec::new(),
            wrong: BTreeSet::new(),
        }
    }

    /// Lists the pairs that can matter before the next search.
    pub fn search(&mut self, within: &Search) {
        self.list.begin(within.now, within.substeps);
        self.doubtful.clear();
        self.wrong.clear();
        let reach = within.reach(self.thickness);
        // What is on the wrong side is looked for further off.
        let look = if self.recovering {
            self.thickness.max(RESCUE_M)
        } else {
            self.thickness
        };
        let garments = &within.surfaces.garments;
        for (number, first) in garments.iter().enumerate() {
            for second in &garments[number + 1..] {
                let mut sieve = within.sieve(Features::VertexFace, look);
                let mut found = |v| self.take(v, Features::VertexFace, within);
                first.vertices_and_faces(second, reach, |v| sieve.put(v, &mut found));
                second.vertices_and_faces(first, reach, |v| sieve.put(v, &mut found));
                sieve.finish(&mut found);
                let mut sieve = within.sieve(Features::EdgeEdge, look);
                let mut found = |v| self.take(v, Features::EdgeEdge, within);
                first.edges_and_edges(second, reach, |v| sieve.put(v, &mut found));
                sieve.finish(&mut found);
            }
        }
        let wrong = &self.wrong;
        let holds = |pair: &Pair| !pair.vertices.iter().any(|v| wrong.contains(v));
        for pair in self.doubtful.drain(..).filter(holds) {
            self.list.push(pair);
        }
    }

    /// Takes features of two garments up if they can matter.
    fn take(&mut self, vertices: [u32; 4], features: Features, within: &Search) {
        let found = within.measure(vertices, features);
        let fabric = within.fabric;
        // The second feature starts at vertex 1 of a vertex and face, at 2 of two edges.
        let [first, _, third, _] = vertices;
        let garments = [first, third].map(|v| fabric.garment_of[v as usize]);
        let friction = 0.5 * (fabric.cloth_of(first).friction + fabric.cloth_of(third).friction);
        let [layer_a, layer_b] = garments.map(|g| fabric.garments[g as usize].layer);
        let turned = self.recovering && wrong_side(&found, within, garments, layer_a.cmp(&layer_b));
        let pair = if turned {
            within.rescue(&found, self.thickness, friction)
        } else {
            within.pair(&found, self.thickness, friction)
        };
        let Some(pair) = pair else {
            return;
        };
        if !self.recovering {
            self.list.push(pair);
        } else if !turned {
            self.doubtful.push(pair);
        } else if features == Features::VertexFace {
            self.wrong.extend(vertices);
            self.list.push(pair);
        }
    }
}

/// Whether an outer feature lies just inside an inner one.
fn wrong_side(
    found: &Candidate,
    within: &Search,
    garments: [u32; 2],
    order: std::cmp::Ordering,
) -> bool {
    use std::cmp::Ordering::{Equal, Greater, Less};
    if order == Equal || !found.separation.interior || found.distance > RESCUE_M {
        return false;
    }
    let d = found.separation.d;
    let normal = |k: usize| within.surfaces.normals[found.vertices[k] as usize];
    // D points from the second feature to the first; `out` from the inner surface outwards.
    let outside = if order == Greater { d } else { -d };
    match (found.features, order) {
        (Features::VertexFace, Greater) => {
            let [_, a, b, c] = found.vertices.map(|v| within.state.x[v as usize]);
            let face = (b - a).cross(c - a) * within.surfaces.outward(garments[1]);
            outside.dot(face) < 0.0
        }
        (Features::VertexFace, Less | Equal) => outside.dot(normal(0)) < -0.5 * found.distance,
        (Features::EdgeEdge, Greater) => outside.dot(normal(2) + normal(3)) < -found.distance,
        (Features::EdgeEdge, Less | Equal) => outside.dot(normal(0) + normal(1)) < -found.distance,
    }
}

//! Contact with the body: vertices, faces and edges of both.
//!
//! The body is closed and knows its inside. A cloth vertex whose nearest body
//! face has it behind itself is inside: it is then brought back through that
//! face alone, and its edges leave the body alone, so that nothing holds it
//! there. A body vertex that pokes through a cloth face is treated likewise.

use super::contact::list::PairList;
use super::contact::pair::Features;
use super::contact::search::{Candidate, Search};
use super::state::State;

/// Vertices known to be inside look this far for the way out, m.
const RESCUE_M: f64 = 0.04;
/// A body vertex this far out of a cloth face is taken to poke through it, m.
const POKE_M: f64 = 0.01;

/// Pairs of cloth and body.
#[derive(Clone, Debug)]
pub(super) struct BodyContact {
    pub list: PairList,
    thickness: f64,
    friction: f64,
    /// Cloth vertices that were inside the body at the last search.
    pub inside: Vec<bool>,
    near: Vec<Candidate>,
}

impl BodyContact {
    pub fn new(thickness: f64, friction: f64, state: &State) -> Self {
        Self {
            list: PairList::default(),
            thickness,
            friction,
            inside: vec![false; state.cloth],
            near: Vec::new(),
        }
    }

    /// Number of cloth vertices inside the body at the last search.
    pub fn inside(&self) -> usize {
        self.inside.iter().filter(|&&inside| inside).count()
    }

    /// Lists the pairs that can matter before the next search.
    pub fn search(&mut self, within: &Search) {
        self.list.begin(within.now, within.substeps);
        let Search {
            surfaces, state, ..
        } = *within;
        let (thickness, friction) = (self.thickness, self.friction);
        for v in 0..state.cloth as u32 {
            self.cloth_vertex(v, within);
        }
        let inside = |v: u32| self.inside[v as usize];
        let normal = |v: u32| surfaces.normals[v as usize];
        let list = &mut self.list;
        let (reach, body) = (within.reach(thickness), &surfaces.body);
        for garment in &surfaces.garments {
            body.vertices_and_faces(garment, reach, |vertices| {
                let [v, a, b, c] = vertices;
                if inside(a) || inside(b) || inside(c) {
                    return;
                }
                let found = within.measure(vertices, Features::VertexFace);
                let pokes = found.separation.interior
                    && found.distance < POKE_M
                    && found.separation.d.dot(normal(v)) > 0.5 * found.distance;
                let pair = if pokes {
                    within.rescue(&found, thickness, friction)
                } else {
                    within.pair(&found, thickness, friction)
                };
                if let Some(pair) = pair {
                    list.push(pair);
                }
            });
            garment.edges_and_edges(body, reach, |vertices| {
                let [a, b, c, d] = vertices;
                if inside(a) || inside(b) {
                    return;
                }
                let found = within.measure(vertices, Features::EdgeEdge);
                if let Some(pair) = within.pair(&found, thickness, friction) {
                    let through = found.separation.interior
                        && found.distance < POKE_M
                        && found.separation.d.dot(normal(c) + normal(d)) < -found.distance;
                    if !through {
                        list.push(pair);
                    }
                }
            });
        }
    }

    fn cloth_vertex(&mut self, v: u32, within: &Search) {
        let Search {
            surfaces, state, ..
        } = *within;
        if state.w[v as usize] == 0.0 {
            return;
        }
        let was_inside = self.inside[v as usize];
        let look = if was_inside { RESCUE_M } else { self.thickness };
        let near = &mut self.near;
        near.clear();
        surfaces.body_faces_near(v, within.reach(look), |vertices| {
            near.push(within.measure(vertices, Features::VertexFace));
        });
        let nearest = near.iter().min_by(|a, b| a.distance.total_cmp(&b.distance));
        let Some(nearest) = nearest else {
            self.inside[v as usize] = false;
            return;
        };
        let [_, a, b, c] = nearest.vertices;
        let x = |v: u32| state.x[v as usize];
        let normal = if nearest.separation.interior {
            (x(b) - x(a)).cross(x(c) - x(a))
        } else {
            let n = |k: usize| {
                -nearest.separation.weights[k] * surfaces.normals[nearest.vertices[k] as usize]
            };
            n(1) + n(2) + n(3)
        };
        let inside = nearest.separation.d.dot(normal) < 0.0;
        self.inside[v as usize] = inside;
        let pair = |found| within.pair(found, self.thickness, self.friction);
        if inside {
            if let Some(pair) = within.rescue(nearest, self.thickness, self.friction) {
                self.list.push(pair);
            }
        } else {
            for pair in near.iter().filter_map(pair) {
                self.list.push(pair);
            }
        }
    }
}

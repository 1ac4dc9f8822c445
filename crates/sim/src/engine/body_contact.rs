//! Contact with the body: vertices, faces and edges of both.
//!
//! The body is closed and knows its inside. A cloth vertex whose nearest body
//! face has it behind itself is inside: it is then brought back through that
//! face alone, and its edges leave the body alone, so that nothing holds it
//! there. A body vertex that pokes through a cloth face is treated likewise.

use super::contact::list::PairList;
use super::contact::pair::Features;
use super::contact::search::{Candidate, Surfaces, candidate};
use super::contact::tubes::Tubes;
use super::fabric::Fabric;
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

    /// Lists the pairs that can matter in the next `substeps`.
    pub fn search(
        &mut self,
        surfaces: &Surfaces,
        fabric: &Fabric,
        state: &State,
        tubes: &Tubes,
        (now, substeps): (u32, f64),
    ) {
        self.list.pairs.clear();
        let (thickness, friction) = (self.thickness, self.friction);
        for v in 0..state.cloth as u32 {
            self.cloth_vertex(v, surfaces, state, tubes, (now, substeps));
        }
        let inside = &self.inside;
        let pairs = &mut self.list.pairs;
        surfaces.body_vertices_and_faces(fabric, thickness, |vertices| {
            if vertices[1..].iter().any(|&v| inside[v as usize]) {
                return;
            }
            let found = candidate(
                vertices,
                Features::VertexFace,
                thickness,
                state,
                tubes,
                substeps,
            );
            if let Some(found) = found {
                let out = found
                    .separation
                    .d
                    .dot(surfaces.normals[vertices[0] as usize]);
                let pokes = found.separation.interior
                    && found.distance < POKE_M
                    && out > 0.5 * found.distance;
                pairs.push(found.pair(thickness, friction, pokes, now));
            }
        });
        surfaces.body_edges(fabric, thickness, |vertices| {
            if vertices[..2].iter().any(|&v| inside[v as usize]) {
                return;
            }
            let found = candidate(
                vertices,
                Features::EdgeEdge,
                thickness,
                state,
                tubes,
                substeps,
            );
            if let Some(found) = found {
                let normal =
                    surfaces.normals[vertices[2] as usize] + surfaces.normals[vertices[3] as usize];
                let through = found.separation.interior
                    && found.distance < POKE_M
                    && found.separation.d.dot(normal) < -found.distance;
                if !through {
                    pairs.push(found.pair(thickness, friction, false, now));
                }
            }
        });
    }

    fn cloth_vertex(
        &mut self,
        v: u32,
        surfaces: &Surfaces,
        state: &State,
        tubes: &Tubes,
        (now, substeps): (u32, f64),
    ) {
        if state.w[v as usize] == 0.0 {
            return;
        }
        let was_inside = self.inside[v as usize];
        let reach = if was_inside { RESCUE_M } else { self.thickness };
        let near = &mut self.near;
        near.clear();
        surfaces.body_faces_near(v, reach, |vertices| {
            near.extend(candidate(
                vertices,
                Features::VertexFace,
                reach,
                state,
                tubes,
                substeps,
            ));
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
        if inside {
            self.list
                .pairs
                .push(nearest.pair(self.thickness, self.friction, true, now));
            return;
        }
        for found in near.iter() {
            if found.distance <= self.thickness + found.rate * substeps {
                self.list
                    .pairs
                    .push(found.pair(self.thickness, self.friction, false, now));
            }
        }
    }
}

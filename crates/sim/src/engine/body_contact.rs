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
/// What is this far on the wrong side is taken to have poked through, m.
const POKE_M: f64 = 0.01;

/// Pairs of cloth and body.
#[derive(Clone, Debug)]
pub(super) struct BodyContact {
    pub list: PairList,
    pub thickness: f64,
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
        self.cloth_vertices(within);
        let inside = |v: u32| self.inside[v as usize];
        let place = |v: u32| state.x[v as usize];
        let normal = |v: u32| surfaces.normals[v as usize];
        let list = &mut self.list;
        let (reach, body) = (within.reach(thickness), &surfaces.body);
        for garment in &surfaces.garments {
            let mut take = |vertices: [u32; 4]| {
                let found = within.measure(vertices, Features::VertexFace);
                let pokes = found.separation.interior
                    && found.distance < POKE_M
                    && found.separation.d.dot(normal(vertices[0])) > 0.5 * found.distance;
                let pair = if pokes {
                    within.rescue(&found, thickness, friction)
                } else {
                    within.pair(&found, thickness, friction)
                };
                if let Some(pair) = pair {
                    list.push(pair);
                }
            };
            let mut sieve = within.sieve(Features::VertexFace, thickness);
            body.vertices_and_faces(garment, reach, |vertices| {
                let [v, a, b, c] = vertices;
                if inside(a) || inside(b) || inside(c) {
                    return;
                }
                // What may poke through matters from further off.
                let out = 3.0 * place(v) - (place(a) + place(b) + place(c));
                if out.dot(normal(v)) > 0.0 {
                    take(vertices);
                } else {
                    sieve.put(vertices, &mut take);
                }
            });
            sieve.finish(&mut take);
            let mut take = |vertices: [u32; 4]| {
                let found = within.measure(vertices, Features::EdgeEdge);
                if let Some(pair) = within.pair(&found, thickness, friction) {
                    let out = normal(vertices[2]) + normal(vertices[3]);
                    let through = found.separation.interior
                        && found.distance < POKE_M
                        && found.separation.d.dot(out) < -found.distance;
                    if !through {
                        list.push(pair);
                    }
                }
            };
            let mut sieve = within.sieve(Features::EdgeEdge, thickness);
            garment.edges_and_edges(body, reach, |vertices| {
                if !(inside(vertices[0]) || inside(vertices[1])) {
                    sieve.put(vertices, &mut take);
                }
            });
            sieve.finish(&mut take);
        }
    }

    /// Pairs of cloth vertices with the body's faces, and who is inside.
    fn cloth_vertices(&mut self, within: &Search) {
        let Search {
            surfaces, state, ..
        } = *within;
        let free = |v: u32| state.w[v as usize] > 0.0;
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        let reach = within.reach(self.thickness);
        let mut take = |vertices| near.push(within.measure(vertices, Features::VertexFace));
        for garment in &surfaces.garments {
            // The nearest face says who is inside: it must not be lost.
            let mut sieve = within.sieve(Features::VertexFace, self.thickness.max(POKE_M));
            garment.vertices_and_faces(&surfaces.body, reach, |vertices| {
                let v = vertices[0];
                if free(v) && !self.inside[v as usize] {
                    sieve.put(vertices, &mut take);
                }
            });
            sieve.finish(&mut take);
        }
        for v in (0..state.cloth as u32).filter(|&v| free(v) && self.inside[v as usize]) {
            surfaces.body_faces_near(v, within.reach(RESCUE_M), &mut take);
        }
        self.inside.fill(false);
        let order = by_vertex(&near, state.cloth);
        let vertex = |number: u32| near[number as usize].vertices[0];
        for of_one in order.chunk_by(|&a, &b| vertex(a) == vertex(b)) {
            self.cloth_vertex(&near, of_one, within);
        }
        self.near = near;
    }

    /// Pairs of one cloth vertex with the body's faces near it: those of these numbers.
    fn cloth_vertex(&mut self, near: &[Candidate], of_one: &[u32], within: &Search) {
        let Search {
            surfaces, state, ..
        } = *within;
        let near = of_one.iter().map(|&number| &near[number as usize]);
        let nearest = near
            .clone()
            .min_by(|a, b| a.distance.total_cmp(&b.distance));
        let Some(nearest) = nearest else {
            return;
        };
        let [v, a, b, c] = nearest.vertices;
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
            for pair in near.filter_map(pair) {
                self.list.push(pair);
            }
        }
    }
}

/// Numbers of candidates by their first vertex, which is below `vertices`; each one's in the order given.
fn by_vertex(near: &[Candidate], vertices: usize) -> Vec<u32> {
    let mut first = vec![0u32; vertices + 1];
    for found in near {
        first[found.vertices[0] as usize + 1] += 1;
    }
    for v in 0..vertices {
        first[v + 1] += first[v];
    }
    let mut order = vec![0; near.len()];
    for (number, found) in near.iter().enumerate() {
        let at = &mut first[found.vertices[0] as usize];
        order[*at as usize] = number as u32;
        *at += 1;
    }
    order
}

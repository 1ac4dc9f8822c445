//! Finding the pairs that can touch before the next search.
//!
//! Every vertex gets a moving box around its tube for the coming substeps.
//! Trees over faces and edges, split once on the start positions and refitted
//! here, give candidates; a candidate becomes a pair if its distance is no more
//! than thickness plus what its tubes can close.

use drape_geometry::bvh::Aabb;
use glam::DVec3;

use super::pair::{Features, Pair, Separation, separation};
use super::tree::{MovingBox, Tree};
use super::tubes::Tubes;
use crate::engine::fabric::Fabric;
use crate::engine::state::State;

/// Trees over faces and edges of cloth and body.
#[derive(Clone, Debug)]
pub(crate) struct Surfaces {
    pub body_faces: Vec<[u32; 3]>,
    pub body_edges: Vec<[u32; 2]>,
    cloth_vertices: Vec<[u32; 1]>,
    body_vertices: Vec<[u32; 1]>,
    cloth_vertex_tree: Tree,
    cloth_face_tree: Tree,
    cloth_edge_tree: Tree,
    body_vertex_tree: Tree,
    body_face_tree: Tree,
    body_edge_tree: Tree,
    /// Boxes around the tubes, one per vertex.
    boxes: Vec<MovingBox>,
    /// Outward normals of vertices at the last search, of garments turned to face outwards.
    pub normals: Vec<DVec3>,
    /// 1 for garments whose faces point away from the body, −1 for the others.
    outward: Vec<f64>,
}

/// A candidate that passed the distance test, before its owner has judged it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub vertices: [u32; 4],
    pub features: Features,
    pub separation: Separation,
    pub distance: f64,
    /// Bound of the closing speed, m per substep.
    pub rate: f64,
}

impl Candidate {
    /// The pair that keeps the candidate on the side where it is now, or,
    /// `turned`, on the other.
    pub fn pair(&self, thickness: f64, friction: f64, turned: bool, now: u32) -> Pair {
        let normal = self.separation.d.normalize_or(DVec3::Z);
        Pair {
            vertices: self.vertices,
            features: self.features,
            thickness: thickness as f32,
            friction: friction as f32,
            rate: self.rate as f32,
            wake: now,
            normal: if turned { -normal } else { normal },
        }
    }
}

impl Surfaces {
    pub fn new(fabric: &Fabric, body_faces: Vec<[u32; 3]>, state: &State) -> Self {
        let body_edges = drape_geometry::mesh::edges(&body_faces);
        let cloth_vertices: Vec<[u32; 1]> = (0..state.cloth as u32).map(|v| [v]).collect();
        let body_vertices: Vec<[u32; 1]> = (state.cloth as u32..state.x.len() as u32)
            .map(|v| [v])
            .collect();
        let mut surfaces = Self {
            cloth_vertex_tree: Tree::build(&state.x, &cloth_vertices),
            body_vertex_tree: Tree::build(&state.x, &body_vertices),
            cloth_vertices,
            body_vertices,
            cloth_face_tree: Tree::build(&state.x, &fabric.faces),
            cloth_edge_tree: Tree::build(&state.x, &fabric.edges),
            body_face_tree: Tree::build(&state.x, &body_faces),
            body_edge_tree: Tree::build(&state.x, &body_edges),
            body_faces,
            body_edges,
            boxes: vec![MovingBox::EMPTY; state.x.len()],
            normals: vec![DVec3::ZERO; state.x.len()],
            outward: vec![1.0; fabric.garments.len()],
        };
        surfaces.measure_normals(fabric, state);
        surfaces.orient(fabric, state);
        surfaces
    }

    /// Which way garments face: away from the nearest body vertices, or towards them.
    fn orient(&mut self, fabric: &Fabric, state: &State) {
        let body = &state.x[state.cloth..];
        for (number, piece) in fabric.garments.iter().enumerate() {
            let mut sum = 0.0;
            for v in piece.vertices.clone() {
                let nearest = body.iter().min_by(|a, b| {
                    a.distance_squared(state.x[v])
                        .total_cmp(&b.distance_squared(state.x[v]))
                });
                if let Some(nearest) = nearest {
                    sum += (state.x[v] - *nearest)
                        .normalize_or_zero()
                        .dot(self.normals[v]);
                }
            }
            if sum < 0.0 {
                self.outward[number] = -1.0;
            }
        }
    }

    /// Outward sign of a garment's faces.
    pub fn outward(&self, garment: u32) -> f64 {
        self.outward[garment as usize]
    }

    fn measure_normals(&mut self, fabric: &Fabric, state: &State) {
        self.normals.fill(DVec3::ZERO);
        for (number, piece) in fabric.garments.iter().enumerate() {
            for face in &fabric.faces[piece.faces.clone()] {
                add_normal(&mut self.normals, &state.x, *face, self.outward[number]);
            }
        }
        for face in &self.body_faces {
            add_normal(&mut self.normals, &state.x, *face, 1.0);
        }
        for normal in &mut self.normals {
            *normal = normal.normalize_or_zero();
        }
    }

    /// Brings boxes, trees and normals up to date; `substeps` until the next search.
    pub fn refit(&mut self, fabric: &Fabric, state: &State, tubes: &Tubes, substeps: f64) {
        self.measure_normals(fabric, state);
        for (i, around) in self.boxes.iter_mut().enumerate() {
            let half = 0.5 * substeps * tubes.step[i];
            // f32 boxes round by less than a micrometre at this size.
            let margin = (tubes.radius[i] * substeps + 1e-6) as f32;
            *around = MovingBox {
                middle: Aabb::of(&[(state.x[i] + half).as_vec3().to_array()]).grown(margin),
                shift: Aabb::of(&[half.as_vec3().to_array()]),
            };
        }
        self.refit_trees(fabric);
    }

    /// Lays boxes around the way of the present substep, from `x` to `p`.
    pub fn refit_substep(&mut self, fabric: &Fabric, state: &State) {
        for (i, around) in self.boxes.iter_mut().enumerate() {
            let half = 0.5 * (state.p[i] - state.x[i]);
            *around = MovingBox {
                middle: Aabb::of(&[(state.x[i] + half).as_vec3().to_array()]).grown(1e-6),
                shift: Aabb::of(&[half.as_vec3().to_array()]),
            };
        }
        self.refit_trees(fabric);
    }

    fn refit_trees(&mut self, fabric: &Fabric) {
        let boxes = &self.boxes;
        self.cloth_vertex_tree.refit(boxes, &self.cloth_vertices);
        self.body_vertex_tree.refit(boxes, &self.body_vertices);
        self.cloth_face_tree.refit(boxes, &fabric.faces);
        self.cloth_edge_tree.refit(boxes, &fabric.edges);
        self.body_face_tree.refit(boxes, &self.body_faces);
        self.body_edge_tree.refit(boxes, &self.body_edges);
    }

    /// Faces of cloth and body that vertex `v` can meet.
    pub fn faces_met_by(&self, v: u32, fabric: &Fabric, mut found: impl FnMut([u32; 3])) {
        let query = &self.boxes[v as usize];
        self.cloth_face_tree
            .meeting(query, 0.0, |f| found(fabric.faces[f as usize]));
        self.body_face_tree
            .meeting(query, 0.0, |f| found(self.body_faces[f as usize]));
    }

    /// Vertices of cloth and body that a face can meet.
    pub fn vertices_meeting(&self, face: [u32; 3], mut found: impl FnMut(u32)) {
        let query = MovingBox::around(&self.boxes, face);
        self.cloth_vertex_tree.meeting(&query, 0.0, &mut found);
        let first = self.cloth_vertices.len() as u32;
        self.body_vertex_tree
            .meeting(&query, 0.0, |v| found(first + v));
    }

    /// Edges of cloth and body that an edge can meet.
    pub fn edges_meeting(&self, edge: [u32; 2], fabric: &Fabric, mut found: impl FnMut([u32; 2])) {
        let query = MovingBox::around(&self.boxes, edge);
        self.cloth_edge_tree
            .meeting(&query, 0.0, |e| found(fabric.edges[e as usize]));
        self.body_edge_tree
            .meeting(&query, 0.0, |e| found(self.body_edges[e as usize]));
    }

    /// Faces of the body near cloth vertex `v`: vertex, then the face's.
    pub fn body_faces_near(&self, v: u32, reach: f64, mut found: impl FnMut([u32; 4])) {
        self.body_face_tree
            .meeting(&self.boxes[v as usize], reach as f32, |f| {
                let [a, b, c] = self.body_faces[f as usize];
                found([v, a, b, c]);
            });
    }

    /// Body vertices near cloth faces: vertex, then the face's.
    pub fn body_vertices_and_faces(
        &self,
        fabric: &Fabric,
        reach: f64,
        mut found: impl FnMut([u32; 4]),
    ) {
        let first = fabric.rest.len() as u32;
        self.body_vertex_tree
            .meeting_tree(&self.cloth_face_tree, reach as f32, |v, f| {
                let [a, b, c] = fabric.faces[f as usize];
                found([first + v, a, b, c]);
            });
    }

    /// Cloth edges near body edges: cloth's vertices, then the body's.
    pub fn body_edges(&self, fabric: &Fabric, reach: f64, mut found: impl FnMut([u32; 4])) {
        self.cloth_edge_tree
            .meeting_tree(&self.body_edge_tree, reach as f32, |e, f| {
                let ([a, b], [c, d]) = (fabric.edges[e as usize], self.body_edges[f as usize]);
                found([a, b, c, d]);
            });
    }

    /// Cloth vertices near cloth faces that they do not belong to.
    pub fn cloth_vertices_and_faces(
        &self,
        fabric: &Fabric,
        reach: f64,
        mut found: impl FnMut([u32; 4]),
    ) {
        self.cloth_vertex_tree
            .meeting_tree(&self.cloth_face_tree, reach as f32, |v, f| {
                let [a, b, c] = fabric.faces[f as usize];
                if v != a && v != b && v != c {
                    found([v, a, b, c]);
                }
            });
    }

    /// Cloth edges near each other without a common vertex.
    pub fn cloth_edges(&self, fabric: &Fabric, reach: f64, mut found: impl FnMut([u32; 4])) {
        self.cloth_edge_tree.meeting_itself(reach as f32, |e, f| {
            let ([a, b], [c, d]) = (fabric.edges[e as usize], fabric.edges[f as usize]);
            if a != c && a != d && b != c && b != d {
                found([a, b, c, d]);
            }
        });
    }
}

/// Measures two features; `None` if they cannot come within `thickness` in `substeps`.
pub(crate) fn candidate(
    vertices: [u32; 4],
    features: Features,
    thickness: f64,
    state: &State,
    tubes: &Tubes,
    substeps: f64,
) -> Option<Candidate> {
    let [a, b, c, d] = vertices.map(|v| v as usize);
    if state.w[a] + state.w[b] + state.w[c] + state.w[d] <= 0.0 {
        return None;
    }
    let step = |i: usize| tubes.step[i];
    let radius = |i: usize| tubes.radius[i];
    // Closing speed: difference of the features' mean steps, plus what their vertices deviate.
    let rate = match features {
        Features::VertexFace => {
            let mean = (step(b) + step(c) + step(d)) / 3.0;
            let spread = |i: usize| step(i).distance(mean);
            step(a).distance(mean)
                + spread(b).max(spread(c)).max(spread(d))
                + radius(a)
                + radius(b).max(radius(c)).max(radius(d))
        }
        Features::EdgeEdge => {
            let (first, second) = ((step(a) + step(b)) / 2.0, (step(c) + step(d)) / 2.0);
            first.distance(second)
                + step(a).distance(first)
                + step(c).distance(second)
                + radius(a).max(radius(b))
                + radius(c).max(radius(d))
        }
    };
    let separation = separation(features, vertices, &state.x);
    let distance = separation.d.length();
    (distance <= thickness + rate * substeps).then_some(Candidate {
        vertices,
        features,
        separation,
        distance,
        rate,
    })
}

fn add_normal(normals: &mut [DVec3], x: &[DVec3], face: [u32; 3], sign: f64) {
    let [a, b, c] = face.map(|v| v as usize);
    let normal = (x[b] - x[a]).cross(x[c] - x[a]) * sign;
    for i in [a, b, c] {
        normals[i] += normal;
    }
}

//! Finding the pairs that can touch before the next search.
//!
//! Every vertex gets a box around its tube for the coming substeps, in the
//! frame that moves with the cloth's mean velocity (walking along costs
//! nothing). Trees over faces and edges, split once on the start positions and
//! refitted here, give candidates; a candidate becomes a pair if its distance
//! is no more than thickness plus what its tubes can close.

use drape_geometry::bvh::{Aabb, Bvh};
use glam::DVec3;

use super::pair::{Features, Pair, Separation, separation};
use super::tubes::Tubes;
use crate::engine::fabric::Fabric;
use crate::engine::state::State;

/// Trees over faces and edges of cloth and body.
#[derive(Clone, Debug)]
pub(crate) struct Surfaces {
    pub body_faces: Vec<[u32; 3]>,
    pub body_edges: Vec<[u32; 2]>,
    cloth_face_tree: Bvh,
    cloth_edge_tree: Bvh,
    body_face_tree: Bvh,
    body_edge_tree: Bvh,
    /// Boxes around the tubes, one per vertex.
    boxes: Vec<Aabb>,
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
        let boxes: Vec<Aabb> = state
            .x
            .iter()
            .map(|x| Aabb::of(&[x.as_vec3().to_array()]))
            .collect();
        let mut surfaces = Self {
            cloth_face_tree: Bvh::build(&around(&boxes, &fabric.faces)),
            cloth_edge_tree: Bvh::build(&around(&boxes, &fabric.edges)),
            body_face_tree: Bvh::build(&around(&boxes, &body_faces)),
            body_edge_tree: Bvh::build(&around(&boxes, &body_edges)),
            body_faces,
            body_edges,
            boxes,
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
        let mean = if state.cloth == 0 {
            DVec3::ZERO
        } else {
            tubes.step[..state.cloth].iter().sum::<DVec3>() / state.cloth as f64
        };
        for (i, aabb) in self.boxes.iter_mut().enumerate() {
            let start = state.x[i];
            let end = start + (tubes.step[i] - mean) * substeps;
            // f32 boxes round by less than a micrometre at this size.
            let margin = (tubes.radius[i] * substeps + 1e-6) as f32;
            *aabb = Aabb::of(&[start.as_vec3().to_array(), end.as_vec3().to_array()]).grown(margin);
        }
        self.cloth_face_tree
            .refit(&around(&self.boxes, &fabric.faces));
        self.cloth_edge_tree
            .refit(&around(&self.boxes, &fabric.edges));
        self.body_face_tree
            .refit(&around(&self.boxes, &self.body_faces));
        self.body_edge_tree
            .refit(&around(&self.boxes, &self.body_edges));
    }

    /// Faces of the body near cloth vertex `v`, each as a candidate.
    pub fn body_faces_near(&self, v: u32, reach: f64, out: &mut impl FnMut(u32, [u32; 4])) {
        let aabb = self.boxes[v as usize].grown(reach as f32);
        self.body_face_tree.overlapping(&aabb, |f| {
            let [a, b, c] = self.body_faces[f as usize];
            out(f, [v, a, b, c]);
        });
    }

    /// Cloth faces near vertex `v` (of cloth or body).
    pub fn cloth_faces_near(
        &self,
        fabric: &Fabric,
        v: u32,
        reach: f64,
        out: &mut impl FnMut([u32; 4]),
    ) {
        let aabb = self.boxes[v as usize].grown(reach as f32);
        self.cloth_face_tree.overlapping(&aabb, |f| {
            let [a, b, c] = fabric.faces[f as usize];
            if v != a && v != b && v != c {
                out([v, a, b, c]);
            }
        });
    }

    /// Body edges near cloth edge number `e`.
    pub fn body_edges_near(
        &self,
        fabric: &Fabric,
        e: usize,
        reach: f64,
        out: &mut impl FnMut([u32; 4]),
    ) {
        let [a, b] = fabric.edges[e];
        let aabb = self.boxes[a as usize]
            .union(&self.boxes[b as usize])
            .grown(reach as f32);
        self.body_edge_tree.overlapping(&aabb, |f| {
            let [c, d] = self.body_edges[f as usize];
            out([a, b, c, d]);
        });
    }

    /// Cloth edges with a higher number near cloth edge number `e`.
    pub fn cloth_edges_near(
        &self,
        fabric: &Fabric,
        e: usize,
        reach: f64,
        out: &mut impl FnMut([u32; 4]),
    ) {
        let [a, b] = fabric.edges[e];
        let aabb = self.boxes[a as usize]
            .union(&self.boxes[b as usize])
            .grown(reach as f32);
        self.cloth_edge_tree.overlapping(&aabb, |f| {
            let [c, d] = fabric.edges[f as usize];
            if f as usize > e && a != c && a != d && b != c && b != d {
                out([a, b, c, d]);
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

fn around<const N: usize>(boxes: &[Aabb], features: &[[u32; N]]) -> Vec<Aabb> {
    let union = |feature: &[u32; N]| {
        feature
            .iter()
            .fold(Aabb::EMPTY, |union, &v| union.union(&boxes[v as usize]))
    };
    features.iter().map(union).collect()
}

fn add_normal(normals: &mut [DVec3], x: &[DVec3], face: [u32; 3], sign: f64) {
    let [a, b, c] = face.map(|v| v as usize);
    let normal = (x[b] - x[a]).cross(x[c] - x[a]) * sign;
    for i in [a, b, c] {
        normals[i] += normal;
    }
}

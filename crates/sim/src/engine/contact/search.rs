//! Finding the pairs that can touch before the next search.
//!
//! Every vertex gets a moving box around its tube for the coming substeps.
//! Trees over vertices, faces and edges, split once on the start positions and
//! refitted here, give candidates; a candidate becomes a pair if its distance
//! is no more than thickness plus what its tubes can close. Every garment has
//! trees of its own, and so does the body: which are compared with which is the
//! business of the effect that asks.

use std::cell::Cell;
use std::ops::Range;

use glam::DVec3;

use super::pair::{Features, Pair, Separation, idle, separation};
use super::sieve::{Sieve, Ways};
use super::tree::{MovingBox, Tree};
use super::tubes::Tubes;
use crate::engine::fabric::{Fabric, Piece};
use crate::engine::state::State;

/// Vertices of a garment that tell which way it faces.
const ASKED: usize = 500;

/// Vertices, faces and edges of one garment or of the body.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    pub vertices: Tree<1>,
    pub faces: Tree<3>,
    pub edges: Tree<2>,
}

/// All surfaces.
#[derive(Clone, Debug)]
pub(crate) struct Surfaces {
    pub garments: Vec<Surface>,
    pub body: Surface,
    /// The body as it moves until the end of the frame, and the substeps left when it was fitted:
    /// it is known in advance.
    frame: Option<u32>,
    whole_frame: Surface,
    body_faces: Vec<[u32; 3]>,
    /// What boxes are relative to, so that they are as exact far away: where a vertex was when the
    /// frame began.
    pub origin: DVec3,
    /// Boxes around the tubes, one per vertex.
    boxes: Vec<MovingBox>,
    /// The tubes as the sieve wants them.
    ways: Ways,
    /// Outward normals of vertices at the last search, of garments turned to face outwards.
    pub normals: Vec<DVec3>,
    /// 1 for garments whose faces point away from the body, −1 for the others.
    outward: Vec<f64>,
}

impl Surface {
    fn new(x: &[DVec3], vertices: Range<usize>, faces: &[[u32; 3]], edges: &[[u32; 2]]) -> Self {
        let vertices: Vec<[u32; 1]> = vertices.map(|v| [v as u32]).collect();
        Self {
            vertices: Tree::build(x, &vertices),
            faces: Tree::build(x, faces),
            edges: Tree::build(x, edges),
        }
    }

    fn refit(&mut self, boxes: &[MovingBox]) {
        self.vertices.refit(boxes);
        self.faces.refit(boxes);
        self.edges.refit(boxes);
    }

    fn refit_within(&mut self, longer: &Self, begin: f32, end: f32) {
        self.vertices.refit_within(&longer.vertices, begin, end);
        self.faces.refit_within(&longer.faces, begin, end);
        self.edges.refit_within(&longer.edges, begin, end);
    }

    /// Vertices here near faces there: the vertex, then the face's.
    pub fn vertices_and_faces(&self, other: &Self, reach: f64, mut found: impl FnMut([u32; 4])) {
        let faces = &other.faces;
        self.vertices
            .meeting_tree(faces, reach as f32, |[v], [a, b, c]| found([v, a, b, c]));
    }

    /// Edges here near edges there: this one's vertices, then the other's.
    pub fn edges_and_edges(&self, other: &Self, reach: f64, mut found: impl FnMut([u32; 4])) {
        let edges = &other.edges;
        self.edges
            .meeting_tree(edges, reach as f32, |[a, b], [c, d]| found([a, b, c, d]));
    }

    /// Vertices and faces here near each other without a common vertex.
    pub fn own_vertices_and_faces(&self, reach: f64, mut found: impl FnMut([u32; 4])) {
        let faces = &self.faces;
        self.vertices
            .meeting_relatives(faces, reach as f32, |[v], [a, b, c]| found([v, a, b, c]));
    }

    /// Edges here near each other without a common vertex.
    pub fn own_edges(&self, reach: f64, mut found: impl FnMut([u32; 4])) {
        self.edges
            .meeting_itself(reach as f32, |[a, b], [c, d]| found([a, b, c, d]));
    }
}

/// Share of the thickness that edges keep from each other.
///
/// Vertices and faces hold surfaces apart. Edges of two meshes that lie at a distance around a
/// curve come nearer than that between their ends: at full thickness they would lift the faces.
const EDGE_SHARE: f64 = 0.7;

/// Distance that features of this kind keep where surfaces keep `thickness`.
pub(crate) fn kept(features: Features, thickness: f64) -> f64 {
    match features {
        Features::VertexFace => thickness,
        Features::EdgeEdge => EDGE_SHARE * thickness,
    }
}

/// Two features, measured, before the effect that asked has judged them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub vertices: [u32; 4],
    pub features: Features,
    pub separation: Separation,
    pub distance: f64,
}

impl Surfaces {
    pub fn new(fabric: &Fabric, body_faces: Vec<[u32; 3]>, state: &State) -> Self {
        let body_edges = drape_geometry::mesh::edges(&body_faces);
        let x = &state.x;
        let garment = |piece: &Piece| {
            let faces = &fabric.faces[piece.faces.clone()];
            let edges = &fabric.edges[piece.edges.clone()];
            Surface::new(x, piece.vertices.clone(), faces, edges)
        };
        let body = Surface::new(x, state.cloth..x.len(), &body_faces, &body_edges);
        let mut surfaces = Self {
            garments: fabric.garments.iter().map(garment).collect(),
            whole_frame: body.clone(),
            body,
            frame: None,
            body_faces,
            origin: DVec3::ZERO,
            boxes: vec![MovingBox::EMPTY; x.len()],
            ways: Ways::default(),
            normals: vec![DVec3::ZERO; x.len()],
            outward: vec![1.0; fabric.garments.len()],
        };
        surfaces.measure_normals(fabric, state);
        surfaces.orient(fabric, state);
        surfaces
    }

    /// Which way garments face: away from the nearest body vertices, or towards
    /// them, as most of [`ASKED`] vertices all over each garment say.
    fn orient(&mut self, fabric: &Fabric, state: &State) {
        let body = &state.x[state.cloth..];
        for (number, piece) in fabric.garments.iter().enumerate() {
            let mut sum = 0.0;
            let every = piece.vertices.len().div_ceil(ASKED).max(1);
            for v in piece.vertices.clone().step_by(every) {
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

    /// The body moves on in another way than before.
    pub fn begin_frame(&mut self) {
        self.frame = None;
    }

    /// Brings boxes, trees and normals up to date; `substeps` until the next
    /// search, `left` in the frame.
    pub fn refit(
        &mut self,
        fabric: &Fabric,
        state: &State,
        tubes: &Tubes,
        substeps: f64,
        left: u32,
    ) {
        self.measure_normals(fabric, state);
        if self.frame.is_none() {
            // The last vertex is one of the body, if there is one.
            self.origin = state.x.last().copied().unwrap_or_default();
        }
        let origin = self.origin;
        self.ways.lay(state, tubes, substeps, origin);
        let fit = |vertex: usize, substeps: f64| {
            let tube = &tubes.of[vertex];
            let start = state.x[vertex] - origin;
            MovingBox::of(start, start + substeps * tube.step, tube.radius * substeps)
        };
        for vertex in 0..state.cloth {
            self.boxes[vertex] = fit(vertex, substeps);
        }
        for surface in &mut self.garments {
            surface.refit(&self.boxes);
        }
        let whole = match self.frame {
            Some(whole) => whole,
            None => {
                for vertex in state.cloth..state.x.len() {
                    self.boxes[vertex] = fit(vertex, f64::from(left));
                }
                self.whole_frame.refit(&self.boxes);
                self.frame = Some(left);
                left
            }
        };
        let part = |gone: f64| (gone / f64::from(whole)) as f32;
        let gone = f64::from(whole - left);
        let (begin, end) = (part(gone), part(gone + substeps));
        self.body.refit_within(&self.whole_frame, begin, end);
    }

    /// Faces of the body near cloth vertex `v`: the vertex, then the face's.
    pub fn body_faces_near(&self, v: u32, reach: f64, mut found: impl FnMut([u32; 4])) {
        let query = &self.boxes[v as usize];
        let faces = &self.body.faces;
        faces.meeting(query, reach as f32, |[a, b, c]| found([v, a, b, c]));
    }
}

/// One search: what it looks at and what for.
pub(crate) struct Search<'a> {
    pub surfaces: &'a Surfaces,
    pub fabric: &'a Fabric,
    pub state: &'a State,
    pub tubes: &'a Tubes,
    /// Number of the present substep.
    pub now: u32,
    /// Substeps until the next search.
    pub substeps: f64,
    /// Candidates that were looked at so far.
    pub candidates: Cell<u64>,
}

impl Search<'_> {
    /// How far apart boxes of features can be that keep `thickness`: at least as
    /// far as both may be out of their tubes.
    pub fn reach(&self, thickness: f64) -> f64 {
        self.tubes.reach(thickness)
    }

    /// A sieve for candidates whose surfaces can come within `thickness` before the next search.
    pub fn sieve(&self, features: Features, thickness: f64) -> Sieve<'_> {
        let reach = self.reach(kept(features, thickness));
        Sieve::new(&self.surfaces.ways, features, reach, &self.candidates)
    }

    /// Measures two features.
    pub fn measure(&self, vertices: [u32; 4], features: Features) -> Candidate {
        let separation = separation(features, vertices, &self.state.x);
        Candidate {
            vertices,
            features,
            separation,
            distance: separation.d.length(),
        }
    }

    /// The pair that keeps a candidate of surfaces with this thickness on the
    /// side where it is; `None` if nothing in it can move or if it cannot
    /// matter before the next search.
    pub fn pair(&self, found: &Candidate, thickness: f64, friction: f64) -> Option<Pair> {
        let thickness = kept(found.features, thickness);
        let normal = found.separation.d.normalize_or(DVec3::Z);
        let idle = if found.distance > self.reach(thickness) {
            let rate = self.tubes.closing(found.features, found.vertices, normal);
            idle(found.distance, self.reach(thickness), rate)
        } else {
            0
        };
        (f64::from(idle) < self.substeps && self.is_mobile(found)).then_some(Pair {
            vertices: found.vertices,
            features: found.features,
            thickness: thickness as f32,
            friction: friction as f32,
            idle,
            normal,
            doubtful: false,
        })
    }

    /// The pair that brings a candidate to the other side, from however deep;
    /// `None` if nothing in it can move.
    pub fn rescue(&self, found: &Candidate, thickness: f64, friction: f64) -> Option<Pair> {
        self.is_mobile(found).then(|| Pair {
            vertices: found.vertices,
            features: found.features,
            thickness: kept(found.features, thickness) as f32,
            friction: friction as f32,
            idle: 0,
            normal: -found.separation.d.normalize_or(DVec3::Z),
            doubtful: true,
        })
    }

    fn is_mobile(&self, found: &Candidate) -> bool {
        let free = |&v: &u32| self.state.w[v as usize] > 0.0;
        found.vertices.iter().any(free)
    }
}

fn add_normal(normals: &mut [DVec3], x: &[DVec3], face: [u32; 3], sign: f64) {
    let [a, b, c] = face.map(|v| v as usize);
    let normal = (x[b] - x[a]).cross(x[c] - x[a]) * sign;
    for i in [a, b, c] {
        normals[i] += normal;
    }
}

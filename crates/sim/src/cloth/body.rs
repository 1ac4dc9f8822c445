//! The body as a prescribed collider: linear motion over a frame.

use drape_geometry::bvh::Bvh;
use glam::DVec3;

/// Positions, smooth normals and the frame's start and end.
#[derive(Clone, Debug)]
pub(super) struct Body {
    /// Triangles, counter-clockwise from outside.
    pub faces: Vec<[u32; 3]>,
    /// Positions at the end of the step, metres.
    pub x: Vec<DVec3>,
    /// Positions at the start of the step.
    pub old: Vec<DVec3>,
    /// Unit vertex normals at `x`.
    pub normals: Vec<DVec3>,
    start: Vec<DVec3>,
    end: Vec<DVec3>,
}

impl Body {
    pub fn new(faces: &[[u32; 3]], positions: Vec<DVec3>) -> Self {
        let mut body = Self {
            faces: faces.to_vec(),
            old: positions.clone(),
            normals: vec![DVec3::ZERO; positions.len()],
            start: positions.clone(),
            end: positions.clone(),
            x: positions,
        };
        vertex_normals(&body.x, &body.faces, &mut body.normals);
        body
    }

    /// Starts a frame: from where the last one ended to `end`.
    pub fn begin_frame(&mut self, end: Vec<DVec3>) {
        self.start = std::mem::replace(&mut self.end, end);
    }

    /// Ends a step at share `t` of the frame.
    pub fn step_to(&mut self, t: f64) {
        std::mem::swap(&mut self.x, &mut self.old);
        for ((x, a), b) in self.x.iter_mut().zip(&self.start).zip(&self.end) {
            *x = a.lerp(*b, t);
        }
        vertex_normals(&self.x, &self.faces, &mut self.normals);
    }

    /// Positions at share `t` of the frame, as f32 for trees.
    pub fn at(&self, t: f64) -> Vec<[f32; 3]> {
        let pairs = self.start.iter().zip(&self.end);
        pairs.map(|(a, b)| single(a.lerp(*b, t))).collect()
    }

    /// Tree over faces at given positions.
    pub fn tree(&self, positions: &[[f32; 3]]) -> Bvh {
        Bvh::of_faces(positions, &self.faces)
    }
}

/// Rounds to f32.
pub(super) fn single(x: DVec3) -> [f32; 3] {
    x.to_array().map(|c| c as f32)
}

/// Area-weighted unit normals of vertices; zero where there is no area.
pub(super) fn vertex_normals(x: &[DVec3], faces: &[[u32; 3]], normals: &mut [DVec3]) {
    normals.fill(DVec3::ZERO);
    for face in faces {
        let [a, b, c] = face.map(|v| x[v as usize]);
        let normal = (b - a).cross(c - a);
        for v in face {
            normals[*v as usize] += normal;
        }
    }
    for normal in normals {
        *normal = normal.normalize_or_zero();
    }
}

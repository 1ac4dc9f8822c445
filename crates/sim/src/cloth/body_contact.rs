//! Contact of cloth with the body, vertices and faces of both.
//!
//! A cloth vertex keeps a thickness from the closest of its candidate faces,
//! measured along the body's smooth normal there: one-sided, so that a vertex
//! that got inside comes out again, at a limited speed. Body vertices keep the
//! same distance from cloth faces, so that knees and elbows do not poke
//! through between cloth vertices. Pushes rub: the tangential motion relative
//! to the body shrinks by at most the friction coefficient times the push.

use drape_geometry::bvh::{Aabb, Bvh};
use drape_geometry::closest::point_triangle;
use glam::DVec3;

use super::body::Body;
use super::state::Cloth;

/// A body vertex this deep under cloth is not pushed on: it belongs elsewhere.
const POKE_DEPTH_M: f64 = 0.012;
/// Cloth this deep in the body still finds out.
const RESCUE_DEPTH_M: f64 = 0.03;

/// Parameters of a contact pass.
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    /// Distance kept, m.
    pub thickness: f64,
    /// Largest undoing of penetration in this step, m.
    pub recovery: f64,
    /// Whether contacts rub.
    pub rub: bool,
}

/// What was pushed in a step; its separating velocity is taken away afterwards.
#[derive(Clone, Copy, Debug)]
struct Touch {
    vertices: [u32; 3],
    weights: [f64; 3],
    normal: DVec3,
    body_velocity: DVec3,
}

/// Candidates and the touches of the present step.
#[derive(Clone, Debug, Default)]
pub(super) struct BodyContact {
    /// Cloth vertex and its range in `faces`.
    vertices: Vec<(u32, u32, u32)>,
    faces: Vec<u32>,
    /// Body vertex, cloth face.
    pokes: Vec<(u32, u32)>,
    touches: Vec<Touch>,
    /// Coefficient for each garment.
    friction: Vec<f64>,
    /// Whether faces of each garment point outwards (1) or inwards (−1).
    orientation: Vec<f64>,
}

/// Where everything will be in the middle of the interval between searches.
pub(super) struct Search<'a> {
    /// Cloth positions.
    pub cloth: &'a [[f32; 3]],
    /// Tree over cloth faces there.
    pub cloth_tree: &'a Bvh,
    /// Body positions.
    pub body: &'a [[f32; 3]],
    /// Margin around everything for relative motion, m.
    pub margin: f64,
}

impl BodyContact {
    pub fn new(friction: Vec<f64>, orientation: Vec<f64>) -> Self {
        Self {
            friction,
            orientation,
            ..Self::default()
        }
    }

    /// Lists candidates.
    pub fn detect(&mut self, cloth: &Cloth, body: &Body, search: &Search, thickness: f64) {
        self.vertices.clear();
        self.faces.clear();
        self.pokes.clear();
        let tree = body.tree(search.body);
        let reach = (thickness + search.margin).max(RESCUE_DEPTH_M);
        let mut near: Vec<(f64, u32)> = Vec::new();
        for (vertex, point) in search.cloth.iter().enumerate() {
            if cloth.w[vertex] == 0.0 {
                continue;
            }
            near.clear();
            let from = point.map(f64::from);
            tree.overlapping(&Aabb::of(&[*point]).grown(reach as f32), |face| {
                let corners =
                    body.faces[face as usize].map(|v| search.body[v as usize].map(f64::from));
                near.push((point_triangle(from, corners).distance2.sqrt(), face));
            });
            let least = near.iter().fold(f64::INFINITY, |l, (d, _)| l.min(*d));
            if least > reach {
                continue;
            }
            near.retain(|(d, _)| *d <= least + search.margin);
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            near.truncate(8);
            let first = self.faces.len() as u32;
            self.faces.extend(near.iter().map(|(_, face)| *face));
            self.vertices
                .push((vertex as u32, first, self.faces.len() as u32));
        }
        let reach = (thickness + search.margin) as f32;
        for (vertex, point) in search.body.iter().enumerate() {
            search
                .cloth_tree
                .overlapping(&Aabb::of(&[*point]).grown(reach), |face| {
                    self.pokes.push((vertex as u32, face));
                });
        }
    }

    /// Forgets the last step's touches.
    pub fn begin_step(&mut self) {
        self.touches.clear();
    }

    /// One pass over all candidates.
    pub fn solve(&mut self, cloth: &mut Cloth, body: &Body, push: Push) {
        for i in 0..self.pokes.len() {
            let (vertex, face) = self.pokes[i];
            self.solve_poke(cloth, body, push, vertex as usize, face as usize);
        }
        for i in 0..self.vertices.len() {
            let (vertex, first, last) = self.vertices[i];
            let faces = first as usize..last as usize;
            self.solve_vertex(cloth, body, push, vertex as usize, faces);
        }
    }

    fn solve_vertex(
        &mut self,
        cloth: &mut Cloth,
        body: &Body,
        push: Push,
        vertex: usize,
        faces: std::ops::Range<usize>,
    ) {
        let x = cloth.x[vertex];
        let mut least = f64::INFINITY;
        let mut nearest = None;
        for &face in &self.faces[faces] {
            let corners = body.faces[face as usize].map(|v| body.x[v as usize].to_array());
            let found = point_triangle(x.to_array(), corners);
            if found.distance2 < least {
                least = found.distance2;
                nearest = Some((face, found));
            }
        }
        let Some((face, nearest)) = nearest else {
            return;
        };
        let corners = body.faces[face as usize];
        let weights = nearest.barycentric;
        let normal = blend(&body.normals, corners, weights).normalize_or_zero();
        let point = DVec3::from_array(nearest.point);
        let gap = (x - point).dot(normal);
        // Farther than the rescue depth, the nearest candidate says nothing about the side.
        if gap >= push.thickness || gap < -RESCUE_DEPTH_M || normal == DVec3::ZERO {
            return;
        }
        let old_point = blend(&body.old, corners, weights);
        let old_gap = (cloth.old[vertex] - old_point).dot(normal);
        let target = push.thickness.min(old_gap + push.recovery);
        if gap >= target {
            return;
        }
        let depth = target - gap;
        cloth.x[vertex] += normal * depth;
        let body_motion = point - old_point;
        if push.rub {
            let motion = cloth.x[vertex] - cloth.old[vertex] - body_motion;
            let slide = motion - normal * motion.dot(normal);
            let limit = self.friction[usize::from(cloth.garment[vertex])] * depth;
            cloth.x[vertex] -= shortened(slide, limit);
        }
        self.touches.push(Touch {
            vertices: [vertex as u32; 3],
            weights: [1.0, 0.0, 0.0],
            normal,
            body_velocity: body_motion,
        });
    }

    fn solve_poke(
        &mut self,
        cloth: &mut Cloth,
        body: &Body,
        push: Push,
        vertex: usize,
        face: usize,
    ) {
        let corners = cloth.faces[face];
        let [a, b, c] = corners.map(|v| cloth.x[v as usize]);
        let (from, normal) = (body.x[vertex], body.normals[vertex]);
        // Cheap tests first: most candidates are far.
        let ahead = [a, b, c].map(|p| (p - from).dot(normal));
        if ahead.iter().all(|&g| g >= push.thickness) || ahead.iter().all(|&g| g < -POKE_DEPTH_M) {
            return;
        }
        let garment = usize::from(cloth.garment_of_face[face]);
        let cloth_normal = (b - a).cross(c - a).normalize_or_zero() * self.orientation[garment];
        if cloth_normal.dot(normal) < 0.2 {
            return;
        }
        let nearest = point_triangle(
            from.to_array(),
            [a.to_array(), b.to_array(), c.to_array()],
        );
        let weights = nearest.barycentric;
        if weights.iter().any(|&w| w <= 0.0) || nearest.distance2 > POKE_DEPTH_M * POKE_DEPTH_M {
            return;
        }
        let gap = (DVec3::from_array(nearest.point) - from).dot(normal);
        let body_motion = from - body.old[vertex];
        let old_gap = (blend(&cloth.old, corners, weights) - body.old[vertex]).dot(normal);
        let target = push.thickness.min(old_gap + push.recovery);
        let inverse = inverse_mass(cloth, corners, weights);
        if gap >= target || inverse == 0.0 {
            return;
        }
        let depth = target - gap;
        let mut shift = normal * depth;
        if push.rub {
            let motion = blend(&cloth.x, corners, weights)
                - blend(&cloth.old, corners, weights)
                - body_motion;
            let slide = motion - normal * motion.dot(normal);
            shift -= shortened(slide, self.friction[garment] * depth);
        }
        for (v, weight) in corners.iter().zip(weights) {
            let v = *v as usize;
            cloth.x[v] += shift * (weight * cloth.w[v] / inverse);
        }
        self.touches.push(Touch {
            vertices: corners,
            weights,
            normal,
            body_velocity: body_motion,
        });
    }

    /// Takes away the velocity with which pushed cloth leaves the body: contacts
    /// are inelastic, and undoing penetration must not throw. Returns how many.
    pub fn settle(&self, cloth: &mut Cloth, dt: f64) -> usize {
        for touch in &self.touches {
            let inverse = inverse_mass(cloth, touch.vertices, touch.weights);
            let velocity = blend(&cloth.v, touch.vertices, touch.weights);
            let leaving = (velocity - touch.body_velocity / dt).dot(touch.normal);
            if leaving <= 0.0 || inverse == 0.0 {
                continue;
            }
            for (v, weight) in touch.vertices.iter().zip(touch.weights) {
                let v = *v as usize;
                let share = weight * cloth.w[v] / inverse;
                cloth.v[v] -= touch.normal * (leaving * share);
            }
        }
        self.touches.len()
    }
}

/// Weighted sum over a triangle's corners.
pub(super) fn blend(x: &[DVec3], corners: [u32; 3], weights: [f64; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|v| x[v as usize]);
    a * weights[0] + b * weights[1] + c * weights[2]
}

/// Inverse mass of a point of a face.
pub(super) fn inverse_mass(cloth: &Cloth, corners: [u32; 3], weights: [f64; 3]) -> f64 {
    let mut inverse = 0.0;
    for (v, weight) in corners.iter().zip(weights) {
        inverse += weight * weight * cloth.w[*v as usize];
    }
    inverse
}

/// The vector, no longer than `limit`.
pub(super) fn shortened(v: DVec3, limit: f64) -> DVec3 {
    let length = v.length();
    if length > limit {
        v * (limit / length)
    } else {
        v
    }
}

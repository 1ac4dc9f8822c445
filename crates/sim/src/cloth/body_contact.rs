//! Contact of cloth with the body, vertices and faces of both.
//!
//! A cloth vertex keeps a thickness from the closest of its candidate faces,
//! measured along the body's smooth normal there: one-sided, so that a vertex
//! that got inside comes out again, at a limited speed. Body vertices keep the
//! same distance from cloth faces, so that knees and elbows do not poke
//! through between cloth vertices.

use drape_geometry::bvh::{Aabb, Bvh};
use glam::DVec3;

use super::body::Body;
use super::closest::closest;
use super::contact::{Contact, Push, blend};
use super::state::Cloth;

/// A body vertex this deep under cloth is not pushed on: it belongs elsewhere.
const POKE_DEPTH_M: f64 = 0.012;
/// Cloth this deep in the body still finds out.
const RESCUE_DEPTH_M: f64 = 0.03;
/// Candidate faces of a vertex; the nearest ones.
const MOST_FACES: usize = 8;

/// Candidates and the contacts of the present step.
#[derive(Clone, Debug, Default)]
pub(super) struct BodyContact {
    /// Cloth vertex and its range in `faces`.
    vertices: Vec<(u32, u32, u32)>,
    faces: Vec<u32>,
    /// Body vertex, cloth face.
    pokes: Vec<(u32, u32)>,
    contacts: Vec<Contact>,
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
            let from = double(*point);
            tree.overlapping(&Aabb::of(&[*point]).grown(reach as f32), |face| {
                let [a, b, c] = body.faces[face as usize].map(|v| double(search.body[v as usize]));
                let (_, at) = closest(from, a, b, c);
                near.push((from.distance(at), face));
            });
            let least = near.iter().fold(f64::INFINITY, |l, (d, _)| l.min(*d));
            if least > reach {
                continue;
            }
            near.retain(|(d, _)| *d <= least + search.margin);
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            near.truncate(MOST_FACES);
            let first = self.faces.len() as u32;
            self.faces.extend(near.iter().map(|(_, face)| *face));
            self.vertices
                .push((vertex as u32, first, self.faces.len() as u32));
        }
        let reach = (thickness + search.margin) as f32;
        for (vertex, point) in search.body.iter().enumerate() {
            let aabb = Aabb::of(&[*point]).grown(reach);
            search.cloth_tree.overlapping(&aabb, |face| {
                self.pokes.push((vertex as u32, face));
            });
        }
    }

    /// Makes the step's contacts from present positions.
    pub fn begin_step(&mut self, cloth: &Cloth, normals: &[DVec3], body: &Body, push: Push) {
        let mut contacts = std::mem::take(&mut self.contacts);
        contacts.clear();
        let pokes = self.pokes.iter();
        contacts.extend(pokes.filter_map(|&(v, f)| self.poke(cloth, normals, body, push, v, f)));
        let vertices = self.vertices.iter();
        contacts.extend(vertices.filter_map(|&(v, first, last)| {
            self.vertex(cloth, body, push, v, first as usize..last as usize)
        }));
        self.contacts = contacts;
    }

    /// One pass over the step's contacts.
    pub fn solve(&mut self, cloth: &mut Cloth) {
        for contact in &mut self.contacts {
            contact.solve(cloth);
        }
    }

    /// Ends the step. Returns how many contacts pushed.
    pub fn settle(&self, cloth: &mut Cloth, dt: f64) -> usize {
        for contact in &self.contacts {
            contact.settle(cloth, dt);
        }
        self.contacts.iter().filter(|c| c.pushed).count()
    }

    fn vertex(
        &self,
        cloth: &Cloth,
        body: &Body,
        push: Push,
        vertex: u32,
        faces: std::ops::Range<usize>,
    ) -> Option<Contact> {
        let x = cloth.x[vertex as usize];
        let mut least = f64::INFINITY;
        let mut nearest = None;
        for &face in &self.faces[faces] {
            let corners = body.faces[face as usize];
            let [a, b, c] = corners.map(|v| body.x[v as usize]);
            let (weights, point) = closest(x, a, b, c);
            let distance2 = x.distance_squared(point);
            if distance2 < least {
                least = distance2;
                nearest = Some((corners, weights, point));
            }
        }
        let (corners, weights, point) = nearest?;
        let normal = blend(&body.normals, corners, weights).normalize_or_zero();
        let gap = (x - point).dot(normal);
        // Farther than the rescue depth, the nearest candidate says nothing about the side.
        let range = -RESCUE_DEPTH_M..push.thickness + Push::SLACK_M;
        if !range.contains(&gap) || normal == DVec3::ZERO {
            return None;
        }
        let old_point = blend(&body.old, corners, weights);
        let old_gap = (cloth.old[vertex as usize] - old_point).dot(normal);
        let garment = usize::from(cloth.garment[vertex as usize]);
        Some(Contact {
            vertices: [vertex; 4],
            weights: [1.0, 0.0, 0.0, 0.0],
            normal,
            base: point,
            base_motion: point - old_point,
            target: push.target(push.thickness, old_gap),
            friction: if push.rub {
                self.friction[garment]
            } else {
                0.0
            },
            pushed: false,
        })
    }

    fn poke(
        &self,
        cloth: &Cloth,
        normals: &[DVec3],
        body: &Body,
        push: Push,
        vertex: u32,
        face: u32,
    ) -> Option<Contact> {
        let corners = cloth.faces[face as usize];
        let [a, b, c] = corners.map(|v| cloth.x[v as usize]);
        let (from, normal) = (body.x[vertex as usize], body.normals[vertex as usize]);
        let garment = usize::from(cloth.garment_of_face[face as usize]);
        let cloth_normal = normals[face as usize] * self.orientation[garment];
        let far = (a - from).dot(cloth_normal);
        if cloth_normal.dot(normal) < 0.2
            || !(-POKE_DEPTH_M..push.thickness + Push::SLACK_M).contains(&far)
        {
            return None;
        }
        let (weights, point) = closest(from, a, b, c);
        if weights.iter().any(|&w| w <= 0.0) {
            return None;
        }
        let gap = (point - from).dot(normal);
        if gap >= push.thickness + Push::SLACK_M {
            return None;
        }
        let old = body.old[vertex as usize];
        let old_gap = (blend(&cloth.old, corners, weights) - old).dot(normal);
        let [wa, wb, wc] = weights;
        let [a, b, c] = corners;
        Some(Contact {
            vertices: [a, b, c, a],
            weights: [wa, wb, wc, 0.0],
            normal,
            base: from,
            base_motion: from - old,
            target: push.target(push.thickness, old_gap),
            friction: if push.rub {
                self.friction[garment]
            } else {
                0.0
            },
            pushed: false,
        })
    }
}

fn double(x: [f32; 3]) -> DVec3 {
    DVec3::from_array(x.map(f64::from))
}

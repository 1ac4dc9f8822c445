//! Contact of cloth with cloth: between garments and within one.
//!
//! A vertex keeps a thickness from faces, both ways. Its side of a face is
//! decided when the pair is listed: where the two surfaces lie over each other
//! (their outward normals agree), the garment of the outer layer belongs
//! outside, also if it is not there now; everywhere else (a sleeve against the
//! chest, folds) the vertex stays on the side where it is.

use drape_dataset::registry::Effect;
use drape_geometry::bvh::Aabb;
use glam::DVec3;

use super::body::vertex_normals;
use super::body_contact::Search;
use super::closest::closest;
use super::contact::{Contact, Push, blend};
use super::physics::{ScenePhysics, friction_coefficient};
use super::state::Cloth;

/// Layers that have passed through each other this far are left alone.
const RESCUE_DEPTH_M: f64 = 0.015;

#[derive(Clone, Copy, Debug)]
struct Pair {
    vertex: u32,
    face: u32,
    /// 1: the vertex belongs where the face's normal points; −1: behind.
    side: f64,
    thickness: f64,
    friction: f64,
}

/// Pairs and the contacts of the present step.
#[derive(Clone, Debug, Default)]
pub(super) struct ClothContact {
    pairs: Vec<Pair>,
    contacts: Vec<Contact>,
    /// Sides of each face that have no neighbour.
    border: Vec<[bool; 3]>,
    orientation: Vec<f64>,
    between: bool,
    within: bool,
    normals: Vec<DVec3>,
}

impl ClothContact {
    pub fn new(cloth: &Cloth, physics: &ScenePhysics, orientation: Vec<f64>) -> Self {
        let mut borders = drape_geometry::mesh::boundary_edges(&cloth.faces);
        for edge in &mut borders {
            edge.sort_unstable();
        }
        borders.sort_unstable();
        let border = (cloth.faces.iter())
            .map(|&[a, b, c]| {
                [(b, c), (c, a), (a, b)]
                    .map(|(u, v)| borders.binary_search(&[u.min(v), u.max(v)]).is_ok())
            })
            .collect();
        Self {
            border,
            orientation,
            between: physics.has(Effect::LayerContact) && cloth.ranges.len() > 1,
            within: physics.has(Effect::SelfContact),
            normals: vec![DVec3::ZERO; cloth.len()],
            ..Self::default()
        }
    }

    pub fn between(&self) -> bool {
        self.between
    }

    pub fn within(&self) -> bool {
        self.within
    }

    /// Lists pairs.
    pub fn detect(&mut self, cloth: &Cloth, search: &Search, thickness: f64) {
        self.pairs.clear();
        vertex_normals(&cloth.x, &cloth.faces, &mut self.normals);
        let reach = (thickness + search.margin) as f32;
        for (vertex, point) in search.cloth.iter().enumerate() {
            let aabb = Aabb::of(&[*point]).grown(reach);
            search.cloth_tree.overlapping(&aabb, |face| {
                let pair = self.pair(cloth, vertex, face as usize, thickness);
                self.pairs.extend(pair);
            });
        }
    }

    fn pair(&self, cloth: &Cloth, vertex: usize, face: usize, thickness: f64) -> Option<Pair> {
        let (g, f) = (
            usize::from(cloth.garment[vertex]),
            usize::from(cloth.garment_of_face[face]),
        );
        let corners = cloth.faces[face];
        if (g == f && (!self.within || corners.contains(&(vertex as u32))))
            || (g != f && !self.between)
        {
            return None;
        }
        let [a, b, c] = corners.map(|v| cloth.x[v as usize]);
        let normal = (b - a).cross(c - a);
        let outward = normal * self.orientation[f];
        let own = self.normals[vertex] * self.orientation[g];
        let stacked = own.dot(outward) > 0.2 * normal.length();
        let (inner, outer) = (cloth.layers[g], cloth.layers[f]);
        let side = if stacked && inner != outer {
            let outside = if inner > outer { 1.0 } else { -1.0 };
            outside * self.orientation[f]
        } else {
            1f64.copysign((cloth.x[vertex] - a).dot(normal))
        };
        let mut kept = thickness;
        if g == f {
            let [a, b, c] = corners.map(|v| cloth.rest[v as usize]);
            let (_, nearest) = closest(cloth.rest[vertex], a, b, c);
            kept = kept.min(0.7 * cloth.rest[vertex].distance(nearest));
        }
        Some(Pair {
            vertex: vertex as u32,
            face: face as u32,
            side,
            thickness: kept,
            friction: friction_coefficient(cloth.fabrics[g].friction, cloth.fabrics[f].friction),
        })
    }

    /// Makes the step's contacts from present positions; `normals` of all faces.
    pub fn begin_step(&mut self, cloth: &Cloth, normals: &[DVec3], push: Push) {
        let mut contacts = std::mem::take(&mut self.contacts);
        contacts.clear();
        let pairs = self.pairs.iter();
        contacts.extend(pairs.filter_map(|pair| self.contact(cloth, normals, pair, push)));
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

    fn contact(
        &self,
        cloth: &Cloth,
        normals: &[DVec3],
        pair: &Pair,
        push: Push,
    ) -> Option<Contact> {
        let (vertex, face) = (pair.vertex as usize, pair.face as usize);
        let corners = cloth.faces[face];
        let x = cloth.x[vertex];
        let normal = normals[face] * pair.side;
        let above = (x - cloth.x[corners[0] as usize]).dot(normal);
        let listed = pair.thickness + Push::SLACK_M;
        if !(-RESCUE_DEPTH_M..listed).contains(&above) || normal == DVec3::ZERO {
            return None;
        }
        let [a, b, c] = corners.map(|v| cloth.x[v as usize]);
        let (weights, point) = closest(x, a, b, c);
        let direction = if weights.iter().all(|&w| w > 0.0) {
            normal
        } else {
            let apart = x.distance(point);
            let at_border = (0..3).any(|i| weights[i] <= 0.0 && self.border[face][i]);
            if apart >= listed || apart < 1e-9 || (above < 0.0 && at_border) {
                return None;
            }
            (x - point) * (1f64.copysign(above) / apart)
        };
        let old = cloth.old[vertex] - blend(&cloth.old, corners, weights);
        let [wa, wb, wc] = weights;
        let [a, b, c] = corners;
        Some(Contact {
            vertices: [pair.vertex, a, b, c],
            weights: [1.0, -wa, -wb, -wc],
            normal: direction,
            base: DVec3::ZERO,
            base_motion: DVec3::ZERO,
            target: push.target(pair.thickness, old.dot(direction)),
            friction: if push.rub { pair.friction } else { 0.0 },
            pushed: false,
        })
    }
}

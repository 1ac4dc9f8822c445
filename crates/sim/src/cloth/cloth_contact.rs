//! Contact of cloth with cloth: between garments and within one.
//!
//! A vertex keeps a thickness from faces, both ways. Its side of a face is
//! decided when the pair is listed: where the two surfaces lie over each other
//! (their outward normals agree), the garment of the outer layer belongs
//! outside, also if it is not there now; everywhere else (a sleeve against the
//! chest, folds) the vertex stays on the side where it is.

use drape_dataset::registry::Effect;
use drape_geometry::bvh::Aabb;
use drape_geometry::closest::point_triangle;
use glam::DVec3;

use super::body::vertex_normals;
use super::body_contact::{Push, Search, blend, inverse_mass, shortened};
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

#[derive(Clone, Copy, Debug)]
struct Touch {
    vertex: u32,
    face: u32,
    weights: [f64; 3],
    normal: DVec3,
}

/// Pairs and the touches of the present step.
#[derive(Clone, Debug, Default)]
pub(super) struct ClothContact {
    pairs: Vec<Pair>,
    touches: Vec<Touch>,
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
            let rest = corners.map(|v| cloth.rest[v as usize].to_array());
            let apart = point_triangle(cloth.rest[vertex].to_array(), rest).distance2;
            kept = kept.min(0.7 * apart.sqrt());
        }
        Some(Pair {
            vertex: vertex as u32,
            face: face as u32,
            side,
            thickness: kept,
            friction: friction_coefficient(cloth.fabrics[g].friction, cloth.fabrics[f].friction),
        })
    }

    /// Forgets the last step's touches.
    pub fn begin_step(&mut self) {
        self.touches.clear();
    }

    /// One pass over all pairs.
    pub fn solve(&mut self, cloth: &mut Cloth, push: Push) {
        for i in 0..self.pairs.len() {
            let pair = self.pairs[i];
            if let Some(touch) = self.solve_pair(cloth, &pair, push) {
                self.touches.push(touch);
            }
        }
    }

    fn solve_pair(&self, cloth: &mut Cloth, pair: &Pair, push: Push) -> Option<Touch> {
        let (vertex, face) = (pair.vertex as usize, pair.face as usize);
        let corners = cloth.faces[face];
        let [a, b, c] = corners.map(|v| cloth.x[v as usize]);
        let x = cloth.x[vertex];
        let normal = (b - a).cross(c - a).normalize_or_zero() * pair.side;
        let above = (x - a).dot(normal);
        if above >= pair.thickness || above < -RESCUE_DEPTH_M || normal == DVec3::ZERO {
            return None;
        }
        let nearest = point_triangle(
            x.to_array(),
            [a.to_array(), b.to_array(), c.to_array()],
        );
        let weights = nearest.barycentric;
        let point = DVec3::from_array(nearest.point);
        let inside = weights.iter().all(|&w| w > 0.0);
        let (direction, gap) = if inside {
            (normal, above)
        } else {
            let apart = nearest.distance2.sqrt();
            let at_border = (0..3).any(|i| weights[i] <= 0.0 && self.border[face][i]);
            if apart >= pair.thickness || apart < 1e-9 || (above < 0.0 && at_border) {
                return None;
            }
            let sign = if above < 0.0 { -1.0 } else { 1.0 };
            ((x - point) * (sign / apart), sign * apart)
        };
        let old = cloth.old[vertex] - blend(&cloth.old, corners, weights);
        let target = pair.thickness.min(old.dot(direction) + push.recovery);
        let (own, other) = (cloth.w[vertex], inverse_mass(cloth, corners, weights));
        if gap >= target || own + other == 0.0 {
            return None;
        }
        let depth = target - gap;
        let mut shift = direction * depth;
        if push.rub {
            let motion = x - point - old;
            let slide = motion - direction * motion.dot(direction);
            shift -= shortened(slide, pair.friction * depth);
        }
        let shift = shift / (own + other);
        cloth.x[vertex] += shift * own;
        for (v, weight) in corners.iter().zip(weights) {
            let v = *v as usize;
            cloth.x[v] -= shift * (weight * cloth.w[v]);
        }
        Some(Touch {
            vertex: pair.vertex,
            face: pair.face,
            weights,
            normal: direction,
        })
    }

    /// Takes away the velocity with which pushed pairs part. Returns how many.
    pub fn settle(&self, cloth: &mut Cloth) -> usize {
        for touch in &self.touches {
            let corners = cloth.faces[touch.face as usize];
            let vertex = touch.vertex as usize;
            let inverse = cloth.w[vertex] + inverse_mass(cloth, corners, touch.weights);
            let relative = cloth.v[vertex] - blend(&cloth.v, corners, touch.weights);
            let leaving = relative.dot(touch.normal);
            if leaving <= 0.0 || inverse == 0.0 {
                continue;
            }
            let impulse = touch.normal * (leaving / inverse);
            let own = cloth.w[vertex];
            cloth.v[vertex] -= impulse * own;
            for (v, weight) in corners.iter().zip(touch.weights) {
                let v = *v as usize;
                let share = weight * cloth.w[v];
                cloth.v[v] += impulse * share;
            }
        }
        self.touches.len()
    }
}

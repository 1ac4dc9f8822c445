//! Stretch, shear and bending as XPBD constraints.
//!
//! - *Stretch*: a spring per edge, stiffness `Y (A₁ + A₂) / l²` for membrane
//!   stiffness Y and the adjacent faces' areas: on equilateral triangles the
//!   sheet then has exactly Young's modulus Y (per thickness), and finer meshes
//!   behave alike. Shortening has its own, lower stiffness.
//! - *Shear*: across each inner edge, the two opposite vertices resist moving
//!   apart; triangles have no other diagonal.
//! - *Bending*: the isometric model (Bergou et al., "A quadratic bending model
//!   for inextensible surfaces", 2006) per inner edge: with cotangent weights c
//!   the vector `L = Σ c x` measures curvature, energy `½ (3B/A) (|L| − |L₀|)²`.
//!
//! One solver pass goes through each list in its order (Gauss–Seidel), with a
//! fresh multiplier: steps are small, so that passes replace warm starts.

use std::collections::BTreeMap;

use drape_dataset::registry::Effect;
use glam::DVec3;

use super::physics::ScenePhysics;
use super::state::{Cloth, area};

#[derive(Clone, Copy, Debug)]
struct Spring {
    ends: [u32; 2],
    rest: f64,
    /// m/N.
    tension: f64,
    /// m/N; infinite where shortening is free.
    compression: f64,
}

#[derive(Clone, Copy, Debug)]
struct Hinge {
    vertices: [u32; 4],
    weights: [f64; 4],
    rest: f64,
    compliance: f64,
}

/// All elastic constraints of an outfit.
#[derive(Clone, Debug, Default)]
pub(super) struct Elastic {
    stretch: Vec<Spring>,
    shear: Vec<Spring>,
    bending: Vec<Hinge>,
}

/// Edges with their adjacent faces' opposite vertices, in order of the edges.
fn edges_with_opposites(faces: &[[u32; 3]]) -> BTreeMap<[u32; 2], Vec<(u32, u32)>> {
    let mut edges: BTreeMap<[u32; 2], Vec<(u32, u32)>> = BTreeMap::new();
    for (number, &[a, b, c]) in faces.iter().enumerate() {
        for (u, v, opposite) in [(a, b, c), (b, c, a), (c, a, b)] {
            if u != v {
                edges
                    .entry([u.min(v), u.max(v)])
                    .or_default()
                    .push((number as u32, opposite));
            }
        }
    }
    edges
}

impl Elastic {
    pub fn new(cloth: &Cloth, physics: &ScenePhysics) -> Self {
        let mut elastic = Self::default();
        for (&[a, b], sides) in &edges_with_opposites(&cloth.faces) {
            let fabric = &cloth.fabrics[usize::from(cloth.garment[a as usize])];
            let (p, q) = (cloth.rest[a as usize], cloth.rest[b as usize]);
            let length = p.distance(q);
            let areas: f64 = sides
                .iter()
                .map(|&(face, _)| area(&cloth.rest, &cloth.faces[face as usize]))
                .sum();
            if length < 1e-6 || areas < 1e-12 {
                continue;
            }
            // The share of Y that a spring carries; needles would get none or too much.
            let share = (areas / (length * length)).clamp(0.1, 4.0);
            if physics.has(Effect::Stretch) && (fabric.tension > 0.0 || fabric.compression > 0.0) {
                elastic.stretch.push(Spring {
                    ends: [a, b],
                    rest: length,
                    tension: 1.0 / (fabric.tension * share),
                    compression: 1.0 / (fabric.compression * share),
                });
            }
            let &[(_, c), (_, d)] = &sides[..] else {
                continue;
            };
            let (r, s) = (cloth.rest[c as usize], cloth.rest[d as usize]);
            if physics.has(Effect::Shear) && fabric.shear > 0.0 && c != d {
                elastic.shear.push(Spring {
                    ends: [c, d],
                    rest: r.distance(s),
                    tension: 1.0 / (fabric.shear * share),
                    compression: f64::INFINITY,
                });
            }
            if physics.has(Effect::Bending) && fabric.bending > 0.0 && c != d {
                let weights = cotangent_weights(p, q, r, s);
                let curvature = combine(&cloth.rest, &[a, b, c, d], &weights);
                elastic.bending.push(Hinge {
                    vertices: [a, b, c, d],
                    weights,
                    rest: curvature.length(),
                    compliance: areas / (3.0 * fabric.bending),
                });
            }
        }
        elastic
    }

    pub fn has_stretch(&self) -> bool {
        !self.stretch.is_empty()
    }

    pub fn has_shear(&self) -> bool {
        !self.shear.is_empty()
    }

    pub fn has_bending(&self) -> bool {
        !self.bending.is_empty()
    }

    pub fn solve_stretch(&self, cloth: &mut Cloth, dt: f64) {
        solve_springs(&self.stretch, cloth, dt);
    }

    pub fn solve_shear(&self, cloth: &mut Cloth, dt: f64) {
        solve_springs(&self.shear, cloth, dt);
    }

    pub fn solve_bending(&self, cloth: &mut Cloth, dt: f64) {
        for hinge in &self.bending {
            let curvature = combine(&cloth.x, &hinge.vertices, &hinge.weights);
            let length = curvature.length();
            if length < 1e-12 {
                continue;
            }
            let mut inverse = hinge.compliance / (dt * dt);
            for (v, weight) in hinge.vertices.iter().zip(hinge.weights) {
                inverse += weight * weight * cloth.w[*v as usize];
            }
            let push = curvature * ((hinge.rest / length - 1.0) / inverse);
            for (v, weight) in hinge.vertices.iter().zip(hinge.weights) {
                let v = *v as usize;
                cloth.x[v] += push * (weight * cloth.w[v]);
            }
        }
    }

    /// Takes `share` of the relative velocity along each edge and of each
    /// hinge's rate of bending; rigid motion is not touched.
    pub fn damp(&self, cloth: &mut Cloth, share: f64) {
        for spring in &self.stretch {
            let [a, b] = spring.ends.map(|v| v as usize);
            let w = cloth.w[a] + cloth.w[b];
            let along = (cloth.x[b] - cloth.x[a]).normalize_or_zero();
            if w > 0.0 {
                let impulse = along * (share * (cloth.v[b] - cloth.v[a]).dot(along) / w);
                let (wa, wb) = (cloth.w[a], cloth.w[b]);
                cloth.v[a] += impulse * wa;
                cloth.v[b] -= impulse * wb;
            }
        }
        for hinge in &self.bending {
            let mut w = 0.0;
            for (v, weight) in hinge.vertices.iter().zip(hinge.weights) {
                w += weight * weight * cloth.w[*v as usize];
            }
            let [a, b, c, d] = hinge.vertices.map(|v| cloth.x[v as usize]);
            let normal = ((b - a).cross(c - a) + (d - a).cross(b - a)).normalize_or_zero();
            if w > 0.0 {
                let rate = combine(&cloth.v, &hinge.vertices, &hinge.weights).dot(normal);
                let impulse = normal * (share * rate / w);
                for (v, weight) in hinge.vertices.iter().zip(hinge.weights) {
                    let v = *v as usize;
                    cloth.v[v] -= impulse * (weight * cloth.w[v]);
                }
            }
        }
    }

    /// Lengths over rest lengths, minus one, of all stretch edges.
    pub fn strains(&self, x: &[DVec3]) -> impl Iterator<Item = f64> {
        self.stretch.iter().map(move |spring| {
            let [a, b] = spring.ends.map(|v| x[v as usize]);
            a.distance(b) / spring.rest - 1.0
        })
    }
}

fn solve_springs(springs: &[Spring], cloth: &mut Cloth, dt: f64) {
    let inverse_dt2 = 1.0 / (dt * dt);
    for spring in springs {
        let [a, b] = spring.ends.map(|v| v as usize);
        let (wa, wb) = (cloth.w[a], cloth.w[b]);
        let delta = cloth.x[b] - cloth.x[a];
        let length = delta.length();
        let stretch = length - spring.rest;
        let compliance = if stretch > 0.0 {
            spring.tension
        } else {
            spring.compression
        };
        let inverse = wa + wb + compliance * inverse_dt2;
        // Pinned at both ends (0) and free to shorten (infinite) both do nothing.
        if length < 1e-12 || !(inverse > 0.0 && inverse.is_finite()) {
            continue;
        }
        let move_apart = delta * (stretch / (length * inverse));
        cloth.x[a] += move_apart * wa;
        cloth.x[b] -= move_apart * wb;
    }
}

fn combine(x: &[DVec3], vertices: &[u32; 4], weights: &[f64; 4]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for (v, weight) in vertices.iter().zip(weights) {
        sum += x[*v as usize] * *weight;
    }
    sum
}

/// Weights of (a, b, c, d) for edge (a, b) with opposite vertices c and d; their sum is 0.
fn cotangent_weights(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> [f64; 4] {
    // Needles have cotangents without bound; beyond 10 they only hurt the solver.
    let cot = |u: DVec3, v: DVec3| {
        let cross = u.cross(v).length().max(1e-12);
        (u.dot(v) / cross).clamp(-10.0, 10.0)
    };
    let at_a_c = cot(b - a, c - a);
    let at_a_d = cot(b - a, d - a);
    let at_b_c = cot(a - b, c - b);
    let at_b_d = cot(a - b, d - b);
    [
        at_b_c + at_b_d,
        at_a_c + at_a_d,
        -(at_a_c + at_b_c),
        -(at_a_d + at_b_d),
    ]
}

//! Bending: two faces at an edge resist folding away from their rest angle.
//!
//! The isometric model (Bergou et al., "A Quadratic Bending Model for
//! Inextensible Surfaces", 2006): with cotangent weights K the vector
//! e = Σ K x is normal to the surface, its length measures the fold, and the
//! energy is ½·(3B/A)·|e|², A the area of both faces, B the flexural rigidity.
//! For curved rest shapes the length along the hinge's normal is compared with
//! that at rest. Linear and angular momentum are kept, because Σ K = 0 and the
//! correction is parallel to e.

use glam::DVec3;

use super::fabric::Fabric;
use super::order::by_rounds;
use super::state::State;

#[derive(Clone, Copy, Debug)]
struct Hinge {
    /// The edge, then the opposite vertices.
    corners: [u32; 4],
    weights: [f64; 4],
    rest: f64,
    stiffness: f64,
    /// Σ K² / m.
    mobility: f64,
}

/// All hinges of an outfit.
#[derive(Clone, Debug)]
pub(super) struct Bending {
    hinges: Vec<Hinge>,
    damping_s: f64,
}

impl Bending {
    pub fn new(fabric: &Fabric, state: &State, damping_s: f64) -> Self {
        let mut hinges = Vec::new();
        for (number, &[a, b]) in fabric.edges.iter().enumerate() {
            let &[(_, c), (_, d)] = &fabric.sides[number][..] else {
                continue;
            };
            let corners = [a, b, c, d];
            let rest = corners.map(|v| fabric.rest[v as usize]);
            let area = fabric.area_at(number);
            let Some(weights) = cotangent_weights(rest).filter(|_| c != d && area > 0.0) else {
                continue;
            };
            let bend = combine(&rest, &weights);
            let share = |(weight, &v): (&f64, &u32)| weight * weight * state.w[v as usize];
            hinges.push(Hinge {
                mobility: weights.iter().zip(&corners).map(share).sum(),
                corners,
                weights,
                rest: bend.dot(normal(&rest)),
                stiffness: 3.0 * fabric.cloth_of(a).bending / area,
            });
        }
        let corners: Vec<[u32; 4]> = hinges.iter().map(|hinge| hinge.corners).collect();
        let order = by_rounds(fabric.rest.len(), &corners);
        let hinges = order.iter().map(|&number| hinges[number as usize]);
        Self {
            hinges: hinges.collect(),
            damping_s,
        }
    }

    /// The one pass of a substep over all hinges.
    ///
    /// Implicit in the fold at the end, and in its rate for the damping (Rayleigh, c = τ k):
    /// λ = −s (C + (τ/h) ΔC) / (1 + s (1 + τ/h) Σ K²/m), s = k h², ΔC what the substep has folded so far.
    pub fn solve(&self, state: &mut State, h: f64) {
        let damping = self.damping_s / h;
        for hinge in &self.hinges {
            let (bend, along) = hinge.bend(&state.p);
            let before = along.dot(combine(&gather(&state.x, &hinge.corners), &hinge.weights));
            let s = hinge.stiffness * h * h;
            let lambda = -s * (bend - hinge.rest + damping * (bend - before))
                / (1.0 + s * (1.0 + damping) * hinge.mobility);
            for (weight, &v) in hinge.weights.iter().zip(&hinge.corners) {
                let i = v as usize;
                state.p[i] += (state.w[i] * lambda * weight) * along;
            }
        }
    }
}

impl Hinge {
    /// Fold and its direction.
    #[inline(always)]
    fn bend(&self, x: &[DVec3]) -> (f64, DVec3) {
        let x = gather(x, &self.corners);
        let bend = combine(&x, &self.weights);
        let length2 = bend.length_squared();
        if length2 > 1e-18 {
            // The side of the normal says which way it folds.
            let length = length2.sqrt();
            let fold = if bend.dot(across(&x)) < 0.0 {
                -length
            } else {
                length
            };
            (fold, bend / fold)
        } else {
            // A flat hinge has no direction of its own.
            let normal = normal(&x);
            (bend.dot(normal), normal)
        }
    }
}

#[inline(always)]
fn gather(x: &[DVec3], &[a, b, c, d]: &[u32; 4]) -> [DVec3; 4] {
    let at = |v: u32| x[v as usize];
    [at(a), at(b), at(c), at(d)]
}

#[inline(always)]
fn combine(x: &[DVec3; 4], k: &[f64; 4]) -> DVec3 {
    k[0] * x[0] + k[1] * x[1] + k[2] * x[2] + k[3] * x[3]
}

/// Direction between the normals of both faces; 0 when they fold onto each other.
fn normal(corners: &[DVec3; 4]) -> DVec3 {
    across(corners).normalize_or_zero()
}

/// Along that direction, of any length.
fn across([a, b, c, d]: &[DVec3; 4]) -> DVec3 {
    (*b - *a).cross(*c - *d)
}

/// Weights of edge (a, b) and opposite vertices c, d; `None` for needles.
fn cotangent_weights([a, b, c, d]: [DVec3; 4]) -> Option<[f64; 4]> {
    let cot = |u: DVec3, v: DVec3| {
        let cot = u.dot(v) / u.cross(v).length();
        // Angles below 3°: the weights would drown the rest.
        (cot.abs() < 20.0).then_some(cot)
    };
    let edge = b - a;
    let (at_a_c, at_a_d) = (cot(edge, c - a)?, cot(edge, d - a)?);
    let (at_b_c, at_b_d) = (cot(-edge, c - b)?, cot(-edge, d - b)?);
    Some([
        at_b_c + at_b_d,
        at_a_c + at_a_d,
        -at_a_c - at_b_c,
        -at_a_d - at_b_d,
    ])
}

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
use super::state::State;

#[derive(Clone, Copy, Debug)]
struct Hinge {
    /// The edge, then the opposite vertices.
    corners: [u32; 4],
    weights: [f64; 4],
    rest: f64,
    stiffness: f64,
}

/// All hinges of an outfit.
#[derive(Clone, Debug)]
pub(super) struct Bending {
    hinges: Vec<Hinge>,
    damping_s: f64,
}

impl Bending {
    pub fn new(fabric: &Fabric, damping_s: f64) -> Self {
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
            hinges.push(Hinge {
                corners,
                weights,
                rest: bend.dot(normal(&rest)),
                stiffness: 3.0 * fabric.cloth_of(a).bending / area,
            });
        }
        Self { hinges, damping_s }
    }

    /// The one pass of a substep over all hinges.
    pub fn solve(&self, state: &mut State, h: f64) {
        for hinge in &self.hinges {
            let corners = hinge.corners.map(|v| v as usize);
            let (bend, along) = hinge.bend(corners.map(|i| state.p[i]));
            let s = hinge.stiffness * h * h;
            let lambda = -s * (bend - hinge.rest) / (1.0 + s * hinge.mobility(state));
            for (weight, &i) in hinge.weights.iter().zip(&corners) {
                state.p[i] += (state.w[i] * lambda * weight) * along;
            }
        }
    }

    /// Slows folding and unfolding for `h` seconds (Rayleigh, on velocities as in [`super::stretch`]).
    pub fn damp(&self, state: &mut State, h: f64) {
        for hinge in &self.hinges {
            let corners = hinge.corners.map(|v| v as usize);
            let (_, along) = hinge.bend(corners.map(|i| state.x[i]));
            let rate = along.dot(combine(&corners.map(|i| state.v[i]), &hinge.weights));
            let c = self.damping_s * hinge.stiffness * h;
            let impulse = -c * rate / (1.0 + c * hinge.mobility(state));
            for (weight, &i) in hinge.weights.iter().zip(&corners) {
                state.v[i] += (state.w[i] * impulse * weight) * along;
            }
        }
    }
}

impl Hinge {
    /// Fold and its direction.
    #[inline]
    fn bend(&self, x: [DVec3; 4]) -> (f64, DVec3) {
        let bend = combine(&x, &self.weights);
        let normal = normal(&x);
        let length = bend.length();
        // A flat hinge has no direction of its own; its normal's sign says which way it folds.
        let along = if length > 1e-9 { bend / length } else { normal };
        let along = if along.dot(normal) < 0.0 {
            -along
        } else {
            along
        };
        (bend.dot(along), along)
    }

    /// Σ K² / m.
    fn mobility(&self, state: &State) -> f64 {
        let share = |(weight, &v): (&f64, &u32)| weight * weight * state.w[v as usize];
        self.weights.iter().zip(&self.corners).map(share).sum()
    }
}

fn combine(x: &[DVec3; 4], k: &[f64; 4]) -> DVec3 {
    k[0] * x[0] + k[1] * x[1] + k[2] * x[2] + k[3] * x[3]
}

/// Direction between the normals of both faces; 0 when they fold onto each other.
fn normal([a, b, c, d]: &[DVec3; 4]) -> DVec3 {
    (*b - *a).cross(*c - *d).normalize_or_zero()
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

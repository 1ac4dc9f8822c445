//! Stretch: every edge of a garment is a spring, with one stiffness when it is
//! longer than at rest and another when it is shorter.
//!
//! A lattice of equilateral triangles whose edges are springs of constant k is
//! a sheet of membrane stiffness 2k/√3 (Ostoja-Starzewski, 2002). An edge with
//! adjacent rest area A and rest length L therefore gets k = K·A/L², which is
//! that on regular meshes and follows the area on others.
//!
//! Solved as XPBD (Macklin et al. 2016) in stiffness form:
//! λ += −(s C + λ) / (1 + s Σw), s = k h². A stiffness of 0 moves nothing,
//! however large, nothing overshoots. A substep starts with half of the last
//! one's λ, so a load is carried in fewer passes. Damping (Rayleigh, c = τ k) acts on
//! velocities after the substep: inside the position solve it would slow its
//! convergence, and damped cloth would stretch like rubber.

use super::fabric::Fabric;
use super::order::by_rounds;
use super::state::State;

/// Ends of an edge move against each other by no more than this share of its
/// length in a substep. Faster, neighbours would be anywhere before contacts
/// are looked for again, and everything would have to be compared with
/// everything: a step too long for its cloth makes that calmer instead.
const TORN: f64 = 0.5;
/// Shorter edges may move as edges of this length, m: needles are no measure of the mesh.
const FINE_M: f64 = 2e-3;

/// Share of the last substep's multipliers that the next one starts with. Loads change little from
/// substep to substep, so passes are saved; with all of them errors would build up, cloth jitter.
const KEPT: f64 = 0.5;

/// One spring.
#[derive(Clone, Copy, Debug)]
struct Spring {
    ends: [u32; 2],
    rest: f64,
    tension: f64,
    compression: f64,
    lambda: f64,
}

/// All springs of an outfit.
#[derive(Clone, Debug)]
pub(super) struct Stretch {
    springs: Vec<Spring>,
    damping_s: f64,
}

impl Stretch {
    pub fn new(fabric: &Fabric, damping_s: f64) -> Self {
        let spring = |number: usize| {
            let ends = fabric.edges[number];
            let rest = fabric.rest_length(ends);
            let cloth = fabric.cloth_of(ends[0]);
            // Needles have next to no area along their long sides: they must hold together all the same.
            let share = (fabric.area_at(number) / (rest * rest)).clamp(0.1, 4.0);
            Spring {
                ends,
                rest,
                tension: cloth.tension * share,
                compression: cloth.compression * share,
                lambda: 0.0,
            }
        };
        let down = downwards(fabric);
        let edges: Vec<[u32; 2]> = down.iter().map(|&n| fabric.edges[n as usize]).collect();
        let order = by_rounds(fabric.rest.len(), &edges);
        let springs = order.iter().map(|&at| spring(down[at as usize] as usize));
        Self {
            springs: springs.collect(),
            damping_s,
        }
    }

    /// Starts a substep with a share of what springs did in the last one.
    pub fn start(&mut self, state: &mut State) {
        for spring in &mut self.springs {
            spring.lambda *= KEPT;
            let (i, j) = (spring.ends[0] as usize, spring.ends[1] as usize);
            let push = spring.lambda * (state.p[i] - state.p[j]).normalize_or_zero();
            state.p[i] += state.w[i] * push;
            state.p[j] -= state.w[j] * push;
        }
    }

    /// One pass over all springs, forth or back: passes in turn carry
    /// corrections both ways along the numbering.
    pub fn solve(&mut self, state: &mut State, h: f64, back: bool) {
        let count = self.springs.len();
        for number in 0..count {
            let spring = &mut self.springs[if back { count - 1 - number } else { number }];
            let (i, j) = (spring.ends[0] as usize, spring.ends[1] as usize);
            let (wi, wj) = (state.w[i], state.w[j]);
            let d = state.p[i] - state.p[j];
            let length = d.length();
            if length < 1e-12 {
                continue;
            }
            let error = length - spring.rest;
            let s = spring.stiffness(error) * h * h;
            // λ per length, for a single division.
            let share = -(s * error + spring.lambda) / ((1.0 + s * (wi + wj)) * length);
            spring.lambda += share * length;
            let push = share * d;
            state.p[i] += wi * push;
            state.p[j] -= wj * push;
        }
    }

    /// Slows lengthening and shortening for `h` seconds, and whatever tears at an edge faster than
    /// [`TORN`] allows.
    pub fn damp(&self, state: &mut State, h: f64) {
        for spring in &self.springs {
            let (i, j) = (spring.ends[0] as usize, spring.ends[1] as usize);
            let (wi, wj) = (state.w[i], state.w[j]);
            let d = state.x[i] - state.x[j];
            let length = d.length();
            if length < 1e-12 {
                continue;
            }
            let n = d / length;
            let c = self.damping_s * spring.stiffness(length - spring.rest) * h;
            let impulse = (-c * n.dot(state.v[i] - state.v[j]) / (1.0 + c * (wi + wj))) * n;
            state.v[i] += wi * impulse;
            state.v[j] -= wj * impulse;

            let torn = state.v[i] - state.v[j];
            let limit = TORN * spring.rest.max(FINE_M) / h;
            if torn.length_squared() > limit * limit && wi + wj > 0.0 {
                let share = 1.0 - limit / torn.length();
                let impulse = (share / (wi + wj)) * torn;
                state.v[i] -= wi * impulse;
                state.v[j] += wj * impulse;
            }
        }
    }
}

/// Numbers of the edges from the highest down.
fn downwards(fabric: &Fabric) -> Vec<u32> {
    let key = |number: u32| {
        let [a, b] = fabric.edges[number as usize].map(|v| fabric.rest[v as usize].z);
        (a.max(b), a.min(b))
    };
    let mut order: Vec<u32> = (0..fabric.edges.len() as u32).collect();
    order.sort_by(|&m, &n| {
        let (one, other) = (key(m), key(n));
        other.0.total_cmp(&one.0).then(other.1.total_cmp(&one.1))
    });
    order
}

impl Spring {
    fn stiffness(&self, error: f64) -> f64 {
        if error > 0.0 {
            self.tension
        } else {
            self.compression
        }
    }
}

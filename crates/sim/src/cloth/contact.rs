//! One contact: a weighted sum of up to four cloth vertices keeps a distance
//! from a place along a normal.
//!
//! Contacts are made once a step, from the positions that elasticity left, and
//! then solved in a few passes with normal and weights fixed. A push rubs: the
//! tangential relative motion shrinks by at most the friction coefficient
//! times the push (Coulomb). Afterwards [`Contact::settle`] takes the
//! separating velocity away: contacts are inelastic, and undoing penetration
//! must not throw cloth off.

use glam::DVec3;

use super::state::Cloth;

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

impl Push {
    /// Contacts this much beyond the thickness are listed too: passes may close them.
    pub const SLACK_M: f64 = 0.001;

    /// Distance to reach at the end of a step that began at distance `old`.
    pub fn target(&self, thickness: f64, old: f64) -> f64 {
        thickness.min(old + self.recovery)
    }
}

/// A contact of one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// Cloth vertices; repeated with weight 0 where fewer take part.
    pub vertices: [u32; 4],
    /// Their weights in the relative position.
    pub weights: [f64; 4],
    /// Direction of the push for positive weights.
    pub normal: DVec3,
    /// Place on the body at the end of the step; zero between cloth and cloth.
    pub base: DVec3,
    /// Motion of that place in the step.
    pub base_motion: DVec3,
    /// Distance to reach.
    pub target: f64,
    /// Coulomb coefficient, 0 where nothing rubs.
    pub friction: f64,
    /// Whether a pass pushed.
    pub pushed: bool,
}

impl Contact {
    /// One pass.
    #[inline]
    pub fn solve(&mut self, cloth: &mut Cloth) {
        let relative = self.sum(&cloth.x) - self.base;
        let depth = self.target - relative.dot(self.normal);
        let inverse = self.inverse_mass(cloth);
        if depth <= 0.0 || inverse == 0.0 {
            return;
        }
        self.pushed = true;
        let mut shift = self.normal * depth;
        if self.friction > 0.0 {
            let old = self.sum(&cloth.old) - (self.base - self.base_motion);
            let motion = relative - old;
            let slide = motion - self.normal * motion.dot(self.normal);
            shift -= shortened(slide, self.friction * depth);
        }
        self.spread(&mut cloth.x, &cloth.w, shift / inverse);
    }

    /// Takes away the velocity with which the sides part after a push.
    pub fn settle(&self, cloth: &mut Cloth, dt: f64) {
        let inverse = self.inverse_mass(cloth);
        let relative = self.sum(&cloth.v) - self.base_motion / dt;
        let leaving = relative.dot(self.normal);
        if self.pushed && leaving > 0.0 && inverse > 0.0 {
            self.spread(&mut cloth.v, &cloth.w, self.normal * (-leaving / inverse));
        }
    }

    fn sum(&self, x: &[DVec3]) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for (v, weight) in self.vertices.iter().zip(self.weights) {
            sum += x[*v as usize] * weight;
        }
        sum
    }

    fn inverse_mass(&self, cloth: &Cloth) -> f64 {
        let mut inverse = 0.0;
        for (v, weight) in self.vertices.iter().zip(self.weights) {
            inverse += weight * weight * cloth.w[*v as usize];
        }
        inverse
    }

    fn spread(&self, x: &mut [DVec3], w: &[f64], impulse: DVec3) {
        for (v, weight) in self.vertices.iter().zip(self.weights) {
            let v = *v as usize;
            x[v] += impulse * (weight * w[v]);
        }
    }
}

/// Weighted sum over a triangle's corners.
pub(super) fn blend(x: &[DVec3], corners: [u32; 3], weights: [f64; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|v| x[v as usize]);
    a * weights[0] + b * weights[1] + c * weights[2]
}

/// The vector, no longer than `limit`.
fn shortened(v: DVec3, limit: f64) -> DVec3 {
    let length = v.length();
    if length > limit {
        v * (limit / length)
    } else {
        v
    }
}

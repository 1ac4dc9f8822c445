//! Where each vertex can be until the next search: its *tube*.
//!
//! A tube is a straight line, position plus velocity; in each substep a vertex
//! may deviate by `radius` from the line's step: 1.5 times what it recently
//! did, between 0.15 and 2 mm. The body moves linearly within a frame, its
//! tubes have radius 0. A vertex that deviates more is a stray
//! ([`super::strays`]); one that in all is [`SLACK_M`] out of its tube, a
//! fraction of every thickness, calls for a new search.

use glam::DVec3;

use super::tree::MovingBox;
use crate::engine::state::State;

/// Narrowest growth of a tube, m per substep.
const NARROWEST_M: f64 = 0.15e-3;
/// Widest growth of a tube, m per substep.
const WIDEST_M: f64 = 2e-3;
/// A vertex may be this far out of its tube.
pub(crate) const SLACK_M: f64 = 1.5e-3;

/// Tubes of all vertices.
#[derive(Clone, Debug)]
pub(crate) struct Tubes {
    /// Positions at the last search.
    start: Vec<DVec3>,
    /// Displacement per substep along the line.
    pub step: Vec<DVec3>,
    /// Growth of the radius per substep, m.
    pub radius: Vec<f64>,
    /// Recent deviation per substep, m.
    deviation: Vec<f64>,
    /// Substeps since the last search; `None` before the first.
    age: Option<u32>,
    /// Substeps the tubes are laid for.
    substeps: f64,
}

impl Tubes {
    pub fn new(state: &State) -> Self {
        let count = state.x.len();
        Self {
            start: vec![DVec3::ZERO; count],
            step: vec![DVec3::ZERO; count],
            radius: vec![0.0; count],
            deviation: vec![0.3e-3; state.cloth],
            age: None,
            substeps: 0.0,
        }
    }

    /// Whether a search is due: too old, or a vertex is out of its tube.
    pub fn expired(&self, every: u32) -> bool {
        self.age.is_none_or(|age| age >= every)
    }

    /// Forces a search before the next substep.
    pub fn expire(&mut self) {
        self.age = None;
    }

    /// Lays new tubes for `substeps` along the present velocities.
    pub fn lay(&mut self, state: &State, h: f64, substeps: f64) {
        self.substeps = substeps;
        self.start.copy_from_slice(&state.x);
        for i in 0..state.x.len() {
            self.step[i] = state.v[i] * h;
        }
        for i in 0..state.cloth {
            self.radius[i] = if state.w[i] > 0.0 {
                (1.5 * self.deviation[i]).clamp(NARROWEST_M, WIDEST_M)
            } else {
                NARROWEST_M
            };
            self.deviation[i] *= 0.7;
        }
        self.age = Some(0);
    }

    /// How far the present substep of a cloth vertex deviates from its line's step, m.
    pub fn deviation(&self, state: &State, i: usize) -> f64 {
        (state.p[i] - state.x[i]).distance(self.step[i])
    }

    /// The way of a cloth vertex in the present substep, with its own tube as
    /// motion: a box that at the time of the substep holds where it goes.
    pub fn way(&self, state: &State, i: usize) -> MovingBox {
        let age = f64::from(self.age.unwrap_or(0));
        let along = self.substeps * self.step[i];
        let from = state.x[i] - age * self.step[i];
        let to = state.p[i] - (age + 1.0) * self.step[i];
        let at = |place: DVec3| MovingBox::of(place, place + along, 0.0);
        at(from).union(&at(to))
    }

    /// Notes where the substep led.
    pub fn observe(&mut self, state: &State) {
        let Some(age) = &mut self.age else { return };
        *age += 1;
        let count = f64::from(*age);
        let mut left = false;
        for i in 0..state.cloth {
            // Positions have been swapped: `p` is where the substep began.
            let deviation = (state.x[i] - state.p[i]).distance(self.step[i]);
            self.deviation[i] = self.deviation[i].max(deviation);
            let line = self.start[i] + count * self.step[i];
            left |= state.x[i].distance(line) - self.radius[i] * count > SLACK_M;
        }
        if left {
            self.age = None;
        }
    }
}

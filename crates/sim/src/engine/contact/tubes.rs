//! Where each vertex can be until the next search: its *tube*.
//!
//! A tube is a straight line, position plus velocity; in each substep a vertex
//! may deviate by `radius` from the line's step: as much as it recently did,
//! between 0.1 (less on fine meshes) and 2 mm. The body moves linearly within a frame, its
//! tubes have radius 0. What a vertex deviates beyond that adds up; pairs are
//! only left out or put to sleep with room for that *slack* on both sides, so
//! until then nothing is lost. A vertex that uses up more is a stray: it is
//! looked up in each substep ([`super::strays`]), and many of them call for a
//! new search.

use glam::DVec3;

use super::pair::Features;
use super::tree::MovingBox;
use crate::engine::COARSE_M;
use crate::engine::state::State;

/// Narrowest growth of a tube per substep, of the slack.
const NARROWEST: f64 = 0.1;
/// Widest growth of a tube, m per substep.
const WIDEST_M: f64 = 2e-3;
/// A vertex may be out of its tube by this, m, or by [`FINE`] of the edges if that is less: what
/// pairs must be listed for should not reach across whole faces.
const SLACK_M: f64 = 1.0e-3;
/// Share of the mean edge.
const FINE: f64 = 0.1;
/// The slack is never less than this, m: a search in each substep would not be faster.
const TIGHTEST_M: f64 = 1e-4;
/// However fine the cloth, tubes are laid for so many substeps if they are worth it and asked for.
const LEAST_SUBSTEPS: u32 = 2;
/// Beyond this share of the slack a vertex counts as a stray: less by more than rounding.
const STRAY: f64 = 0.98;
/// One cloth vertex in so many may be a stray before a search comes cheaper than looking them up.
const FEW: usize = 200;

/// One vertex's tube.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(32))]
pub(crate) struct Tube {
    /// Displacement per substep along the line.
    pub step: DVec3,
    /// Growth of the radius per substep, m.
    pub radius: f64,
}

/// Tubes of all vertices.
#[derive(Clone, Debug)]
pub(crate) struct Tubes {
    pub of: Vec<Tube>,
    /// How far a vertex may be out of its tube, m.
    pub slack: f64,
    /// Deviation beyond the tube since the last search, m.
    excess: Vec<f64>,
    /// Recent deviation per substep, m.
    deviation: Vec<f64>,
    /// Substeps since the last search; `None` before the first.
    age: Option<u32>,
    /// Substeps the tubes are laid for.
    substeps: f64,
    /// Substeps that tubes may be trusted for, as far as the last ones tell.
    trust: u32,
    /// Share of the substeps asked for that tubes of this cloth are laid for: they widen with
    /// time, and on fine cloth soon reach across faces.
    fineness: f64,
}

impl Tubes {
    /// Tubes for cloth with edges of this mean length, m.
    pub fn new(state: &State, edge_m: f64) -> Self {
        Self {
            slack: (FINE * edge_m).clamp(TIGHTEST_M, SLACK_M),
            of: vec![Tube::default(); state.x.len()],
            excess: vec![0.0; state.cloth],
            deviation: vec![0.3e-3; state.cloth],
            age: None,
            substeps: 0.0,
            trust: u32::MAX,
            fineness: (edge_m / COARSE_M).min(1.0),
        }
    }

    /// Distance of two features that keep `thickness` from which on they must be looked at: what
    /// both may be out of their tubes must not be slept through.
    pub fn reach(&self, thickness: f64) -> f64 {
        thickness.max(2.0 * self.slack)
    }

    /// Whether a search is due: too old, or a vertex is out of its tube.
    pub fn expired(&self) -> bool {
        self.age.is_none_or(|age| f64::from(age) >= self.substeps)
    }

    /// For how many substeps, of at most `most`, tubes are worth laying.
    ///
    /// Cloth that is shaken leaves its tubes early: laid for longer, they
    /// would only be wider, and each search would find more for nothing.
    pub fn horizon(&self, most: u32) -> u32 {
        let fine = (f64::from(most) * self.fineness).ceil() as u32;
        self.trust.min(fine.max(LEAST_SUBSTEPS)).min(most)
    }

    /// Forces a search before the next substep.
    pub fn expire(&mut self) {
        self.age = None;
    }

    /// Lays new tubes for `substeps` along the present velocities.
    pub fn lay(&mut self, state: &State, h: f64, substeps: f64) {
        self.substeps = substeps;
        self.excess.fill(0.0);
        for (tube, v) in self.of.iter_mut().zip(&state.v) {
            tube.step = *v * h;
        }
        for i in 0..state.cloth {
            self.of[i].radius = if state.w[i] > 0.0 {
                self.deviation[i].clamp(NARROWEST * self.slack, WIDEST_M)
            } else {
                NARROWEST * self.slack
            };
            self.deviation[i] *= 0.7;
        }
        self.age = Some(0);
    }

    /// How fast the gap of two features along `normal`, from the second to the
    /// first, can shrink, m per substep; valid for as long as the tubes are.
    ///
    /// The plane between them moves with the normal fixed: what vertices do
    /// along it does not count, however fast.
    #[inline]
    pub fn closing(&self, features: Features, vertices: [u32; 4], normal: DVec3) -> f64 {
        let [a, b, c, d] = vertices;
        let of = |v: u32| &self.of[v as usize];
        let (a, b, c, d) = (of(a), of(b), of(c), of(d));
        let back = |tube: &Tube| tube.radius - normal.dot(tube.step);
        let forth = |tube: &Tube| tube.radius + normal.dot(tube.step);
        match features {
            Features::VertexFace => back(a) + forth(b).max(forth(c)).max(forth(d)),
            Features::EdgeEdge => back(a).max(back(b)) + forth(c).max(forth(d)),
        }
    }

    /// Whether a cloth vertex is a stray where the present substep leads it.
    pub fn left(&self, state: &State, i: usize) -> bool {
        let Tube { step, radius } = self.of[i];
        let spare = STRAY * self.slack - self.excess[i];
        let room = radius + spare;
        spare < 0.0 || (state.p[i] - state.x[i]).distance_squared(step) > room * room
    }

    /// The way of a cloth vertex in the present substep, with its own tube as
    /// motion: a box that at the time of the substep holds where it goes, relative to `origin`.
    pub fn way(&self, state: &State, i: usize, origin: DVec3) -> MovingBox {
        let age = f64::from(self.age.unwrap_or(0));
        let step = self.of[i].step;
        let along = self.substeps * step;
        let from = state.x[i] - age * step;
        let to = state.p[i] - (age + 1.0) * step;
        let at = |place: DVec3| {
            let place = place - origin;
            MovingBox::of(place, place + along, 0.0)
        };
        at(from).union(&at(to))
    }

    /// Notes where the substep led.
    pub fn observe(&mut self, state: &State) {
        let Some(age) = &mut self.age else { return };
        *age += 1;
        let count = f64::from(*age);
        let mut strays = 0;
        for i in 0..state.cloth {
            // Positions have been swapped: `p` is where the substep began.
            let tube = &self.of[i];
            let deviation = (state.x[i] - state.p[i]).distance(tube.step);
            self.deviation[i] = self.deviation[i].max(deviation);
            self.excess[i] += (deviation - tube.radius).max(0.0);
            strays += usize::from(self.excess[i] > STRAY * self.slack);
        }
        if strays > state.cloth / FEW {
            self.trust = 2 * *age;
            self.age = None;
        } else if count >= self.substeps {
            self.trust = self.trust.saturating_mul(2);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vertex at rest with its tube, laid for `substeps`.
    fn resting(substeps: f64) -> (State, Tubes) {
        let state = State {
            x: vec![DVec3::ZERO; 400],
            p: vec![DVec3::ZERO; 400],
            v: vec![DVec3::ZERO; 400],
            w: vec![1.0; 400],
            cloth: 400,
        };
        let mut tubes = Tubes::new(&state, 1.0);
        tubes.lay(&state, 1e-3, substeps);
        (state, tubes)
    }

    /// Moves the first vertex by this much in a substep; whether it was a stray on the way.
    fn step(state: &mut State, tubes: &mut Tubes, by: f64) -> bool {
        state.p.clone_from(&state.x);
        state.p[0].x += by;
        let stray = tubes.left(state, 0);
        state.finish(1e-3);
        tubes.observe(state);
        stray
    }

    #[test]
    fn who_has_used_up_the_slack_is_a_stray_until_the_next_search() {
        let (mut state, mut tubes) = resting(20.0);
        let radius = tubes.of[0].radius;
        // Within the tube nothing is used up, however often.
        for _ in 0..5 {
            assert!(!step(&mut state, &mut tubes, 0.99 * radius));
        }
        // Three times a little more than a third of the slack.
        let more = radius + 0.36 * tubes.slack;
        assert!(!step(&mut state, &mut tubes, more));
        assert!(!step(&mut state, &mut tubes, -more));
        assert!(step(&mut state, &mut tubes, more));
        // From then on every move is one too many.
        for by in [1e-5, -1e-5, radius, 0.4 * tubes.slack, 2e-3] {
            assert!(step(&mut state, &mut tubes, by), "{by} m");
        }
        assert!(!tubes.expired(), "one vertex of 400 is no reason to search");
        state.v.fill(DVec3::ZERO);
        tubes.lay(&state, 1e-3, 5.0);
        assert!(!step(&mut state, &mut tubes, 0.99 * radius));
    }

    #[test]
    fn tubes_of_fine_cloth_are_laid_for_less_time() {
        let (state, tubes) = resting(5.0);
        assert_eq!([1, 5, 100].map(|most| tubes.horizon(most)), [1, 5, 100]);
        let horizon = |edge_m, most| Tubes::new(&state, edge_m).horizon(most);
        assert_eq!(horizon(0.5 * COARSE_M, 5), 3);
        assert_eq!([1, 2, 5].map(|most| horizon(1e-9, most)), [1, 2, 2]);
    }

    #[test]
    fn many_strays_call_for_a_search() {
        let (mut state, mut tubes) = resting(20.0);
        for (i, p) in state.p.iter_mut().enumerate() {
            p.x = if i < 3 { 3e-3 } else { 0.0 };
        }
        state.finish(1e-3);
        tubes.observe(&state);
        assert!(tubes.expired());
    }
}

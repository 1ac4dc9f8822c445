//! The pairs of one effect, and what they ask for in the present substep.

use std::time::{Duration, Instant};

use super::pair::Pair;
use super::solve::{self, Contact, PushOut};
use super::tubes::SLACK_M;
use crate::engine::state::State;

/// Pairs of one effect and its contacts in the present substep.
#[derive(Clone, Debug, Default)]
pub(crate) struct PairList {
    pub pairs: Vec<Pair>,
    pub contacts: Vec<Contact>,
    /// Pairs looked at in the present substep whose features had not crossed.
    pub clean: Vec<u32>,
}

/// Contacts are solved if inertia brings them this close to their thickness, m:
/// further than elasticity moves a vertex in a substep.
const MARGIN_M: f64 = 1e-3;

impl PairList {
    /// Looks at the pairs that are awake in substep `now` and lists contacts.
    pub fn look(&mut self, state: &State, now: u32, push: PushOut) {
        self.contacts.clear();
        self.clean.clear();
        for (number, pair) in self.pairs.iter_mut().enumerate() {
            if pair.wake > now {
                continue;
            }
            let (separation, gap) = pair.look(&state.x);
            // What may be out of its tube must not be slept through.
            let room = gap - f64::from(pair.thickness).max(2.0 * SLACK_M);
            let rate = f64::from(pair.rate);
            if room > rate {
                pair.wake = now + (room / rate).min(1e6) as u32;
                continue;
            }
            if gap > 0.0 {
                self.clean.push(number as u32);
            }
            let coming = {
                let [a, b, c, d] = pair.vertices.map(|v| state.p[v as usize]);
                let [u, v, w, z] = separation.weights;
                pair.normal.dot(u * a + v * b + w * c + z * d)
            };
            if coming > f64::from(pair.thickness) + MARGIN_M {
                continue;
            }
            if let Some(contact) = Contact::new(pair, &separation, gap, push, state) {
                self.contacts.push(contact);
            }
        }
    }

    /// One solver pass.
    pub fn solve(&mut self, state: &mut State, rub: bool) {
        solve::solve(&mut self.contacts, state, rub);
    }

    /// How long a solver pass takes without friction, on a copy.
    pub fn time_without_friction(&self, state: &State) -> Duration {
        let (mut contacts, mut state) = (self.contacts.clone(), state.clone());
        let start = Instant::now();
        solve::solve(&mut contacts, &mut state, false);
        start.elapsed()
    }

    /// After the velocities are known.
    pub fn forget_push(&self, state: &mut State, h: f64) {
        solve::forget_push(&self.contacts, state, h);
    }
}

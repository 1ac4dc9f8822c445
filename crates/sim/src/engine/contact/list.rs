//! The pairs of one effect, and what they ask for in the present substep.

use std::time::{Duration, Instant};

use super::certificate::separated;
use super::pair::{Pair, idle};
use super::solve::{self, Contact, PushOut};
use super::tubes::Tubes;
use crate::engine::state::State;

/// Pairs of one effect and its contacts in the present substep.
#[derive(Clone, Debug, Default)]
pub(crate) struct PairList {
    pub pairs: Vec<Pair>,
    pub contacts: Vec<Contact>,
    /// Pairs looked at in the present substep whose features had not crossed.
    pub clean: Vec<u32>,
    /// Pairs that are looked at in every substep for now, ascending.
    awake: Vec<u32>,
    /// Pairs that wake up 0, 1, 2 … substeps after the search.
    later: Vec<Vec<u32>>,
    /// Substep of the search.
    began: u32,
}

/// Contacts are solved if inertia brings them this close to their thickness, m:
/// further than elasticity moves a vertex in a substep.
const MARGIN_M: f64 = 1e-3;

impl PairList {
    /// Starts over, with a search in substep `now` that the next one follows `substeps` later.
    pub fn begin(&mut self, now: u32, substeps: f64) {
        self.pairs.clear();
        self.awake.clear();
        self.later.resize_with(substeps as usize, Vec::new);
        self.later.iter_mut().for_each(Vec::clear);
        self.began = now;
    }

    /// Adds a pair; one that sleeps until the next search is not needed.
    pub fn push(&mut self, pair: Pair) {
        if let Some(bucket) = self.later.get_mut(pair.idle as usize) {
            bucket.push(self.pairs.len() as u32);
            self.pairs.push(pair);
        }
    }

    /// Looks at the pairs that are awake in substep `now` and lists contacts.
    pub fn look(&mut self, state: &State, tubes: &Tubes, now: u32, push: PushOut) {
        self.contacts.clear();
        self.clean.clear();
        let age = (now - self.began) as usize;
        if let Some(bucket) = self.later.get_mut(age) {
            self.awake.append(bucket);
            self.awake.sort();
        }
        let mut kept = 0;
        for at in 0..self.awake.len() {
            let number = self.awake[at];
            let pair = &mut self.pairs[number as usize];
            let (separation, gap) = pair.look(&state.x);
            let thickness = f64::from(pair.thickness);
            if gap > thickness {
                let rate = tubes.closing(pair.features, pair.vertices, pair.normal);
                let idle = idle(gap, tubes.reach(thickness), rate) as usize;
                if idle > 0 {
                    if let Some(bucket) = self.later.get_mut(age.saturating_add(idle)) {
                        bucket.push(number);
                    }
                    continue;
                }
            }
            self.awake[kept] = number;
            kept += 1;
            if gap > 0.0 {
                self.clean.push(number);
            }
            let coming = {
                let d = solve::combine(&separation.weights, &pair.vertices, &state.p);
                pair.normal.dot(d)
            };
            if coming > thickness + MARGIN_M {
                continue;
            }
            if let Some(contact) = Contact::new(pair, &separation, gap, push, state) {
                self.contacts.push(contact);
            }
        }
        self.awake.truncate(kept);
    }

    /// Keeps in mind which of the pairs looked at may have crossed in this substep.
    pub fn doubt(&mut self, state: &State) {
        for &number in &self.clean {
            let pair = &mut self.pairs[number as usize];
            pair.doubtful = !separated(pair, state);
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

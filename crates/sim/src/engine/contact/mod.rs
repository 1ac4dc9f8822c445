//! Contacts: which features may meet, how they are kept apart.
//!
//! Pipeline, the same for body, layer and self contact:
//! 1. [`search`], a few times a frame: pairs of features that can come within
//!    their thickness before the next search, from boxes of swept vertices;
//! 2. [`pair`], each substep: gap and normal of the pairs that are awake;
//! 3. [`solve`], each pass: push apart, rub;
//! 4. [`certificate`], at the end of a substep: a plane between the features of
//!    every pair throughout the substep, or they are moved until there is one.
//!
//! Which features make pairs, at which thickness and friction, is the business
//! of the effect that owns the list: [`super::body_contact`],
//! [`super::layer_contact`], [`super::self_contact`].

pub(super) mod certificate;
pub(super) mod pair;
pub(super) mod search;
pub(super) mod solve;
pub(super) mod tree;
pub(super) mod tubes;

use pair::Pair;
use solve::{Contact, PushOut};

use super::state::State;

/// Pairs of one effect and its contacts in the present substep.
#[derive(Clone, Debug, Default)]
pub(super) struct PairList {
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
            let room = gap - f64::from(pair.thickness);
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

    /// After the velocities are known.
    pub fn forget_push(&self, state: &mut State, h: f64) {
        solve::forget_push(&self.contacts, state, h);
    }
}

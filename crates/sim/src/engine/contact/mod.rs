//! Contacts: which features may meet, how they are kept apart.
//!
//! Pipeline, the same for body, layer and self contact:
//! 1. [`search`], a few times a frame: pairs of features that can come within
//!    their thickness before the next search, from boxes of swept vertices
//!    ([`tree`]) and what [`sieve`] lets through of what these give;
//! 2. [`pair`], each substep: gap and normal of the pairs that are awake;
//! 3. [`solve`], each pass: push apart, rub;
//! 4. [`certificate`], at the end of a substep: a plane between the features of
//!    every pair throughout the substep, or they are moved until there is one;
//! 5. [`strays`]: pairs that the search could not foresee are certified as well.
//!
//! Which features make pairs, at which thickness and friction, is the business
//! of the effect that owns the list: [`super::body_contact`],
//! [`super::layer_contact`], [`super::self_contact`].

pub(super) mod certificate;
pub(super) mod list;
pub(super) mod pair;
pub(super) mod search;
pub(super) mod sieve;
pub(super) mod solve;
pub(super) mod strays;
pub(super) mod tree;
pub(super) mod tubes;

use std::cell::Cell;

use certificate::{Certificate, Outcome};
use drape_dataset::registry::Effect;
use glam::DVec3;
use list::PairList;
use pair::Pair;
use search::{Search, Surfaces};
use solve::PushOut;
use strays::Wanted;
use tubes::Tubes;

use super::StepReport;
use super::body_contact::BodyContact;
use super::fabric::Fabric;
use super::layer_contact::LayerContact;
use super::passes::Passes;
use super::profile::{Part, Stopwatch};
use super::self_contact::SelfContact;
use super::settings::EngineSettings;
use super::state::State;

/// A substep: its number, its length in seconds, and the engine's settings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment<'a> {
    pub now: u32,
    pub h: f64,
    /// Substeps left in the frame, with this one.
    pub left: u32,
    pub settings: &'a EngineSettings,
}

/// Rounds of looking for strays' pairs and certifying them: repairs make new strays.
const STRAY_ROUNDS: u32 = 6;

/// Everything about contacts.
#[derive(Clone, Debug)]
pub(super) struct Contacts {
    surfaces: Surfaces,
    tubes: Tubes,
    body: Option<BodyContact>,
    layer: Option<LayerContact>,
    own: Option<SelfContact>,
    certificate: Certificate,
    /// Where a stray was last looked up.
    looked_up: Vec<DVec3>,
}

impl Contacts {
    /// Contacts of the effects that are there; `None` without any.
    pub fn new(
        fabric: &Fabric,
        body_faces: Vec<[u32; 3]>,
        state: &State,
        body: Option<BodyContact>,
        layer: Option<LayerContact>,
        own: Option<SelfContact>,
    ) -> Option<Self> {
        (body.is_some() || layer.is_some() || own.is_some()).then(|| Self {
            surfaces: Surfaces::new(fabric, body_faces, state),
            tubes: Tubes::new(state, fabric.finest_edge_m()),
            body,
            layer,
            own,
            certificate: Certificate::new(state.x.len()),
            looked_up: vec![DVec3::NAN; state.cloth],
        })
    }

    /// Keeps so many times the distances of the settings from the next search on.
    pub fn keep(&mut self, settings: &EngineSettings, times: f64) {
        if let Some(body) = &mut self.body {
            body.thickness = times * settings.body_thickness_m;
        }
        if let Some(layer) = &mut self.layer {
            layer.thickness = times * settings.layer_thickness_m;
        }
        if let Some(own) = &mut self.own {
            own.keep(times * settings.self_thickness_m);
        }
        self.tubes.expire();
    }

    /// The body changes its velocity: old tubes do not hold.
    pub fn begin_frame(&mut self) {
        self.tubes.expire();
        self.surfaces.begin_frame();
    }

    /// Searches if it is time, and lists the contacts of the substep.
    pub fn prepare(
        &mut self,
        fabric: &Fabric,
        state: &State,
        moment: Moment,
        passes: &mut Passes,
        watch: &mut Stopwatch,
        report: &mut StepReport,
    ) {
        let Moment {
            now, h, settings, ..
        } = moment;
        let push = PushOut {
            close: settings.push_out_m_s * h,
            through: settings.recovery_m_s * h,
        };
        if self.tubes.expired() {
            report.candidates += self.search(fabric, state, moment, watch);
            report.searches += 1;
        }
        let (tubes, lists) = self.tubes_and_lists();
        for (effect, list) in lists {
            passes.count(effect);
            let start = watch.start();
            list.look(state, tubes, now, push);
            watch.stop(Part::Narrow(effect), start);
        }
        report.pairs = self.lists().map(|list| list.pairs.len()).sum();
        report.contacts = self.lists().map(|list| list.contacts.len()).sum();
        report.inside_body = self.body.as_ref().map_or(0, BodyContact::inside);
    }

    /// One solver pass over all contacts.
    pub fn solve(&mut self, state: &mut State, rub: bool, watch: &mut Stopwatch) {
        for (effect, list) in self.lists_mut() {
            let plain = rub
                .then(|| watch.aside(|| list.time_without_friction(state)))
                .flatten();
            let start = watch.start();
            list.solve(state, rub);
            let Some(start) = start else { continue };
            let all = start.elapsed();
            let pushing = plain.map_or(all, |plain| plain.min(all));
            watch.give(Part::Solve(effect), pushing);
            if rub {
                watch.give(Part::Effect(Effect::Friction), all - pushing);
            }
        }
    }

    /// Moves what is about to cross.
    pub fn certify(
        &mut self,
        fabric: &Fabric,
        state: &mut State,
        watch: &mut Stopwatch,
    ) -> Outcome {
        let mut total = Outcome::default();
        let mut found: Vec<Pair> = Vec::new();
        let mut certified = 0;
        self.looked_up.fill(DVec3::NAN);
        for round in 0.. {
            let start = watch.start();
            let lists = [
                self.own.as_ref().map(|own| &own.list),
                self.layer.as_ref().map(|layer| &layer.list),
                self.body.as_ref().map(|body| &body.list),
            ];
            let listed = lists.into_iter().flatten().flat_map(|list| {
                let pair = |&number: &u32| &list.pairs[number as usize];
                list.clean.iter().map(pair)
            });
            let pairs: Vec<&Pair> = listed.chain(&found).collect();
            let outcome = self.certificate.certify(&pairs, certified, state);
            certified = if outcome.left == 0 { pairs.len() } else { 0 };
            total.failed += outcome.failed;
            total.left = outcome.left;
            watch.stop(Part::Certificate, start);
            let start = watch.start();
            let strays = self.strays(state);
            if strays.is_empty() || round == STRAY_ROUNDS {
                watch.stop(Part::Strays, start);
                // Somebody moved after the last look: not certified, if not wrong either.
                total.left += strays.len() as u32;
                break;
            }
            let wanted = Wanted {
                body: self.body.as_ref().map(|body| &body.inside[..]),
                layers: self.layer.as_ref().is_some_and(|layer| !layer.recovering),
                own: self.own.is_some(),
            };
            strays::pairs_of(
                &strays,
                &wanted,
                (&mut self.surfaces, &self.tubes),
                fabric,
                state,
                &mut found,
            );
            total.found = found.len() as u64;
            watch.stop(Part::Strays, start);
        }
        if total.left > 0 {
            self.lists_mut().for_each(|(_, list)| list.doubt(state));
        }
        total
    }

    /// Cloth vertices out of their tubes that have moved since they were looked up.
    fn strays(&mut self, state: &State) -> Vec<u32> {
        let mut strays = Vec::new();
        for i in 0..state.cloth {
            if self.tubes.left(state, i) && self.looked_up[i] != state.p[i] {
                self.looked_up[i] = state.p[i];
                strays.push(i as u32);
            }
        }
        strays
    }

    /// After the velocities are known.
    pub fn finish(&mut self, state: &mut State, h: f64, watch: &mut Stopwatch) {
        for (effect, list) in self.lists_mut() {
            let start = watch.start();
            list.forget_push(state, h);
            watch.stop(Part::Solve(effect), start);
        }
        let start = watch.start();
        self.tubes.observe(state);
        watch.stop(Part::Trees, start);
    }

    /// Lists the pairs of the coming substeps; how many candidates it looked at.
    fn search(
        &mut self,
        fabric: &Fabric,
        state: &State,
        moment: Moment,
        watch: &mut Stopwatch,
    ) -> u64 {
        let Moment {
            now,
            h,
            left,
            settings,
        } = moment;
        // Bodies change their velocities from frame to frame: no search outlives one.
        let substeps = f64::from(self.tubes.horizon(settings.search_every).min(left));
        let start = watch.start();
        self.tubes.lay(state, h, substeps);
        self.surfaces
            .refit(fabric, state, &self.tubes, substeps, left);
        watch.stop(Part::Trees, start);
        let within = Search {
            surfaces: &self.surfaces,
            fabric,
            state,
            tubes: &self.tubes,
            now,
            substeps,
            candidates: Cell::new(0),
        };
        if let Some(body) = &mut self.body {
            let start = watch.start();
            body.search(&within);
            watch.stop(Part::Search(Effect::BodyContact), start);
        }
        if let Some(layer) = &mut self.layer {
            let start = watch.start();
            layer.search(&within);
            watch.stop(Part::Search(Effect::LayerContact), start);
        }
        if let Some(own) = &mut self.own {
            let start = watch.start();
            own.search(&within);
            watch.stop(Part::Search(Effect::SelfContact), start);
        }
        within.candidates.get()
    }

    fn lists(&self) -> impl Iterator<Item = &PairList> {
        let own = self.own.as_ref().map(|own| &own.list);
        let layer = self.layer.as_ref().map(|layer| &layer.list);
        let body = self.body.as_ref().map(|body| &body.list);
        own.into_iter().chain(layer).chain(body)
    }

    /// The body comes last: it cannot give way, so it has the last word.
    fn lists_mut(&mut self) -> impl Iterator<Item = (Effect, &mut PairList)> {
        self.tubes_and_lists().1
    }

    fn tubes_and_lists(&mut self) -> (&Tubes, impl Iterator<Item = (Effect, &mut PairList)>) {
        let own = self.own.as_mut().map(|own| &mut own.list);
        let layer = self.layer.as_mut().map(|layer| &mut layer.list);
        let body = self.body.as_mut().map(|body| &mut body.list);
        let lists = [
            (Effect::SelfContact, own),
            (Effect::LayerContact, layer),
            (Effect::BodyContact, body),
        ];
        let present = lists.into_iter();
        (
            &self.tubes,
            present.filter_map(|(effect, list)| Some((effect, list?))),
        )
    }
}

impl Contacts {
    /// Layer contact, for who knows whether layers cross.
    pub fn layer_mut(&mut self) -> Option<&mut LayerContact> {
        self.layer.as_mut()
    }
}

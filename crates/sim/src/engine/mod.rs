//! The cloth engine: garments on a moving body, in small steps.
//!
//! Extended position-based dynamics with many small steps (Macklin et al.,
//! "XPBD", 2016; "Small Steps in Physics Simulation", 2019). Inside, lengths
//! are metres, times seconds, masses kilograms, all in f64; scene units and
//! f32 are met at the border only.
//!
//! A substep: gravity, drag and wind change velocities; positions are
//! predicted; waist bands follow the body; bending and shear are solved, then
//! stretch and contacts in turn, contacts last; velocities are what the substep moved.
//!
//! Every effect has one owner module, and an effect that the scene does not
//! call for is never computed ([`Engine::passes`] counts):
//!
//! | module | effect |
//! |---|---|
//! | `gravity`, `drag`, `wind` | gravity, air drag, wind |
//! | `stretch`, `shear`, `bending` | elasticity |
//! | `body_contact`, `layer_contact`, `self_contact`, `friction` | contacts, on the machinery of `contact` |
//! | `waistband` | waist bands |
//!
//! Surfaces that are apart at the start stay apart (`contact` tells why), as
//! far as [`StepReport::uncertified`] is 0. Where the body crosses itself or
//! squeezes cloth without room, no engine can be clean: whoever keeps frames
//! counts intersections.

mod air;
mod bending;
mod body_contact;
mod contact;
mod drag;
mod fabric;
mod friction;
mod gravity;
mod layer_contact;
mod material;
mod order;
mod passes;
pub mod profile;
mod self_contact;
mod settings;
mod shear;
mod state;
mod stretch;
#[cfg(test)]
mod tests;
mod waistband;
mod wind;

use drape_dataset::registry::Effect;
use drape_dataset::sequence::{Garment, Wind};
use drape_geometry::intersect::count_between;
use glam::DVec3;

use bending::Bending;
use body_contact::BodyContact;
use contact::{Contacts, Moment};
use drag::Drag;
use fabric::Fabric;
use layer_contact::LayerContact;
use passes::Passes;
use profile::{Part, Stopwatch};
use self_contact::SelfContact;
use shear::Shear;
use state::{State, metres};
use stretch::Stretch;
use waistband::Waistband;
use wind::Blow;

use crate::error::SimError;

pub use air::AIR_DENSITY;
pub use material::Cloth;
pub use settings::{EngineSettings, ScenePhysics};
pub use wind::{PASCAL_PER_STRENGTH, air_velocity};

/// Cloth with edges of this mean length, m, or longer needs no more passes and searches than the settings say.
const COARSE_M: f64 = 0.0125;
/// However fine, cloth gets no more than so many times the passes: a garment in wrong units must not stand still.
const MOST_PASSES: f64 = 8.0;

/// What one frame took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Searches for contact pairs.
    pub searches: u32,
    /// Candidates for pairs that searches and strays looked at: the work of finding contacts.
    pub candidates: u64,
    /// Pairs after the last search.
    pub pairs: usize,
    /// Contacts in the last substep.
    pub contacts: usize,
    /// Cloth vertices inside the body at the last search.
    pub inside_body: usize,
    /// Pairs that had to be moved apart because they were about to cross.
    pub repaired: u64,
    /// Pairs that may have crossed all the same: count intersections.
    pub uncertified: u64,
    /// Greatest speed of a cloth vertex at the end, m/s.
    pub top_speed_m_s: f64,
}

/// An outfit on a body, ready to be moved.
#[derive(Clone, Debug)]
pub struct Engine {
    settings: EngineSettings,
    /// Passes over springs and contacts per substep.
    rounds: u32,
    scale: f64,
    gravity: Option<DVec3>,
    drag: Option<Drag>,
    wind: Option<Blow>,
    friction: bool,
    fabric: Fabric,
    names: Vec<String>,
    state: State,
    stretch: Option<Stretch>,
    shear: Option<Shear>,
    bending: Option<Bending>,
    waistband: Option<Waistband>,
    contacts: Option<Contacts>,
    passes: Passes,
    stopwatch: Stopwatch,
    /// Substeps since the start.
    clock: u32,
}

impl Engine {
    /// Puts garments, at rest, on a body.
    ///
    /// `waistbands` lists for each garment the vertices that follow the body
    /// (an empty list, or no lists at all, for none). Positions are in scene units.
    ///
    /// # Errors
    /// [`SimError`] for meshes, materials or settings that cannot be simulated.
    pub fn new(
        garments: &[Garment],
        waistbands: &[Vec<u32>],
        body_faces: &[[u32; 3]],
        body0: &[[f32; 3]],
        physics: &ScenePhysics,
        settings: &EngineSettings,
    ) -> Result<Self, SimError> {
        settings.validate()?;
        physics.validate()?;
        let scale = f64::from(physics.scale);
        let fabric = Fabric::new(garments, scale)?;
        fabric::check_mesh("body", body0, body_faces)?;
        let has = |effect| physics.calls_for(effect) && !settings.without.contains(&effect);

        let cloth = fabric.rest.len();
        let mut x = fabric.rest.clone();
        x.extend(body0.iter().map(|&p| metres(p, scale)));
        let mut w = fabric.inverse_mass.clone();
        w.resize(x.len(), 0.0);
        let mut state = State {
            p: x.clone(),
            v: vec![DVec3::ZERO; x.len()],
            x,
            w,
            cloth,
        };
        let body_faces: Vec<[u32; 3]> = body_faces
            .iter()
            .map(|face| face.map(|v| v + cloth as u32))
            .collect();

        let bound = bound_vertices(&fabric, waistbands)?;
        let waistband = if has(Effect::Waistband) && !bound.is_empty() {
            Some(Waistband::bind(&mut state, &bound, &body_faces)?)
        } else {
            None
        };
        let body = (has(Effect::BodyContact) && !body_faces.is_empty()).then(|| {
            let friction = material::friction(physics.body_friction);
            BodyContact::new(settings.body_thickness_m, friction, &state)
        });
        let layer = (has(Effect::LayerContact) && garments.len() > 1)
            .then(|| LayerContact::new(settings.layer_thickness_m));
        let own = (has(Effect::SelfContact) && !garments.is_empty())
            .then(|| SelfContact::new(settings.self_thickness_m, fabric.finest_edge_m()));
        let contacts = Contacts::new(&fabric, body_faces, &state, body, layer, own);
        let mut engine = Self {
            settings: settings.clone(),
            rounds: rounds(settings.iterations, fabric.finest_edge_m()),
            scale,
            gravity: has(Effect::Gravity).then(|| metres(physics.gravity, scale)),
            drag: has(Effect::AirDrag).then(|| Drag::new(physics.air_density)),
            wind: has(Effect::Wind).then(|| Blow::new(physics.air_density)),
            friction: has(Effect::Friction),
            names: garments.iter().map(|g| g.name.clone()).collect(),
            stretch: has(Effect::Stretch)
                .then(|| Stretch::new(&fabric, settings.stretch_damping_s)),
            shear: has(Effect::Shear).then(|| Shear::new(garments, &fabric)),
            bending: has(Effect::Bending)
                .then(|| Bending::new(&fabric, &state, settings.bending_damping_s)),
            fabric,
            state,
            waistband,
            contacts,
            passes: Passes::default(),
            stopwatch: Stopwatch::new(),
            clock: 0,
        };
        engine.watch_layers(true);
        Ok(engine)
    }

    /// Lets distances be larger from now on: as much as [`EngineSettings::warm_up_times`] says
    /// with a share of 1, not at all with 0. Meant for frames before the first one that counts.
    pub fn warm_up(&mut self, share: f64) {
        let times = 1.0 + (self.settings.warm_up_times - 1.0) * share.clamp(0.0, 1.0);
        if let Some(contacts) = &mut self.contacts {
            contacts.keep(&self.settings, times);
        }
    }

    /// Moves the body linearly to `body_next` within `dt_s` seconds, and the cloth with it.
    ///
    /// # Errors
    /// [`SimError`] for a body or wind that is not usable (nothing has moved
    /// then), or when the cloth left the range of numbers.
    pub fn advance(
        &mut self,
        body_next: &[[f32; 3]],
        wind: Wind,
        dt_s: f64,
    ) -> Result<StepReport, SimError> {
        let cloth = self.state.cloth;
        let body_count = self.state.x.len() - cloth;
        if body_next.len() != body_count {
            let expected = format!("{body_count} as at the start");
            return Err(SimError::value(
                "vertices of the body in this frame",
                expected,
                body_next.len(),
            ));
        }
        fabric::check_finite("body", body_next)?;
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return Err(SimError::value(
                "frame time",
                "a positive number of seconds",
                dt_s,
            ));
        }
        let wind = air_velocity(wind)?;

        let start = self.stopwatch.start();
        let substeps = self.settings.substeps;
        let h = dt_s / f64::from(substeps);
        let from: Vec<DVec3> = self.state.x[cloth..].to_vec();
        let to: Vec<DVec3> = body_next.iter().map(|&p| metres(p, self.scale)).collect();
        let mut body_velocity = DVec3::ZERO;
        for (i, (from, to)) in from.iter().zip(&to).enumerate() {
            self.state.v[cloth + i] = (*to - *from) / dt_s;
            body_velocity += self.state.v[cloth + i] / body_count as f64;
        }
        if let Some(contacts) = &mut self.contacts {
            contacts.begin_frame();
        }
        let mut report = StepReport::default();
        for substep in 1..=substeps {
            let t = f64::from(substep) / f64::from(substeps);
            for (i, (from, to)) in from.iter().zip(&to).enumerate() {
                self.state.p[cloth + i] = if substep == substeps {
                    *to
                } else {
                    from.lerp(*to, t)
                };
            }
            let left = substeps - substep + 1;
            self.substep(h, left, wind, body_velocity, &mut report);
        }
        self.check_range()?;
        let sides = self.stopwatch.start();
        self.watch_layers(report.uncertified > 0);
        self.stopwatch.stop(Part::Sides, sides);
        report.top_speed_m_s = self.state.v[..cloth]
            .iter()
            .map(|v| v.length())
            .fold(0.0, f64::max);
        self.stopwatch.end_frame(start);
        Ok(report)
    }

    /// Positions of each garment in scene units.
    pub fn garments(&self) -> Vec<Vec<[f32; 3]>> {
        let out = |x: &DVec3| (*x * self.scale).to_array().map(|c| c as f32);
        let of = |piece: &fabric::Piece| {
            self.state.x[piece.vertices.clone()]
                .iter()
                .map(out)
                .collect()
        };
        self.fabric.garments.iter().map(of).collect()
    }

    /// How many times an effect was computed since the engine was made.
    pub fn passes(&self, effect: Effect) -> u64 {
        self.passes.of(effect)
    }

    /// One substep, `left` of the frame with it; the body's positions at its end are in `state.p` already.
    fn substep(
        &mut self,
        h: f64,
        left: u32,
        wind: DVec3,
        body_velocity: DVec3,
        report: &mut StepReport,
    ) {
        let Self {
            state,
            fabric,
            passes,
            settings,
            stopwatch: watch,
            ..
        } = self;
        if let Some(gravity) = self.gravity {
            passes.count(Effect::Gravity);
            let start = watch.start();
            gravity::apply(state, gravity, h);
            watch.stop(Part::Effect(Effect::Gravity), start);
        }
        if let Some(drag) = &mut self.drag {
            passes.count(Effect::AirDrag);
            let start = watch.start();
            drag.apply(state, fabric, (h, left));
            watch.stop(Part::Effect(Effect::AirDrag), start);
        }
        if let Some(blow) = &mut self.wind {
            passes.count(Effect::Wind);
            let start = watch.start();
            blow.apply(state, fabric, wind, (h, left));
            watch.stop(Part::Effect(Effect::Wind), start);
        }
        let start = watch.start();
        state.limit_speeds(body_velocity, settings.speed_limit_m_s);
        state.predict(h);
        watch.stop(Part::Inertia, start);
        if let Some(waistband) = &self.waistband {
            passes.count(Effect::Waistband);
            let start = watch.start();
            waistband.follow(state, h);
            watch.stop(Part::Effect(Effect::Waistband), start);
        }
        if let Some(contacts) = &mut self.contacts {
            let moment = Moment {
                now: self.clock,
                h,
                left,
                settings,
            };
            contacts.prepare(fabric, state, moment, passes, watch, report);
        }
        if let Some(bending) = &mut self.bending {
            passes.count(Effect::Bending);
            let start = watch.start();
            bending.solve(state, h);
            watch.stop(Part::Effect(Effect::Bending), start);
        }
        if let Some(shear) = &mut self.shear {
            passes.count(Effect::Shear);
            let start = watch.start();
            shear.solve(state, h);
            watch.stop(Part::Effect(Effect::Shear), start);
        }
        if let Some(stretch) = &mut self.stretch {
            let start = watch.start();
            stretch.start(state);
            watch.stop(Part::Effect(Effect::Stretch), start);
        }
        // In turn: what a contact holds must be felt by the springs that hang from it.
        for pass in 0..self.rounds {
            if let Some(stretch) = &mut self.stretch {
                passes.count(Effect::Stretch);
                let start = watch.start();
                stretch.solve(state, h, pass % 2 == 1);
                watch.stop(Part::Effect(Effect::Stretch), start);
            }
            if let Some(contacts) = &mut self.contacts {
                if self.friction {
                    passes.count(Effect::Friction);
                }
                contacts.solve(state, self.friction, watch);
            }
        }
        if let Some(contacts) = &mut self.contacts {
            let outcome = contacts.certify(fabric, state, watch);
            report.candidates += outcome.found;
            report.repaired += u64::from(outcome.failed);
            report.uncertified += u64::from(outcome.left);
        }
        let start = watch.start();
        state.finish(h);
        watch.stop(Part::Inertia, start);
        if let Some(contacts) = &mut self.contacts {
            contacts.finish(state, h, watch);
        }
        if let Some(stretch) = &self.stretch {
            let start = watch.start();
            stretch.damp(state, h);
            watch.stop(Part::Effect(Effect::Stretch), start);
        }
        self.clock += 1;
    }

    /// Lets layers be brought back to their sides only while they cross: clean
    /// ones keep theirs, and cloth may lie however it likes. Crossings can be
    /// there at the start and after substeps that were not certified.
    fn watch_layers(&mut self, doubtful: bool) {
        let Some(layer) = self.contacts.as_mut().and_then(Contacts::layer_mut) else {
            return;
        };
        if !(doubtful || layer.recovering) {
            return;
        }
        let pieces = &self.fabric.garments;
        let local = |piece: &fabric::Piece| -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
            let first = piece.vertices.start as u32;
            let positions = self.state.x[piece.vertices.clone()]
                .iter()
                .map(|x| x.as_vec3().to_array());
            let faces = self.fabric.faces[piece.faces.clone()]
                .iter()
                .map(|f| f.map(|v| v - first));
            (positions.collect(), faces.collect())
        };
        let meshes: Vec<_> = pieces.iter().map(local).collect();
        layer.recovering = meshes.iter().enumerate().any(|(i, (x, faces))| {
            let cross = |(y, others): &(Vec<_>, Vec<_>)| count_between(x, faces, y, others) > 0;
            meshes[i + 1..].iter().any(cross)
        });
    }

    fn check_range(&self) -> Result<(), SimError> {
        for (piece, name) in self.fabric.garments.iter().zip(&self.names) {
            for v in piece.vertices.clone() {
                let x = self.state.x[v] * self.scale;
                if !(x.is_finite() && x.abs().max_element() < f64::from(f32::MAX)) {
                    return Err(SimError::NotFinite {
                        surface: format!(
                            "{name} after the step (more substeps or a softer material help)"
                        ),
                        vertex: v - piece.vertices.start,
                        found: x.to_array().map(|c| c as f32),
                    });
                }
            }
        }
        Ok(())
    }
}

/// Passes over springs and contacts: a pass carries a load so many edges further, not so far.
fn rounds(iterations: u32, edge_m: f64) -> u32 {
    let more = (COARSE_M / edge_m).clamp(1.0, MOST_PASSES);
    (f64::from(iterations) * more).ceil() as u32
}

/// Waist band vertices of all garments in the engine's numbering.
fn bound_vertices(fabric: &Fabric, waistbands: &[Vec<u32>]) -> Result<Vec<u32>, SimError> {
    if !waistbands.is_empty() && waistbands.len() != fabric.garments.len() {
        let expected = format!("{}, one for each garment", fabric.garments.len());
        return Err(SimError::value(
            "number of waist bands",
            expected,
            waistbands.len(),
        ));
    }
    let mut bound = Vec::new();
    for (number, (band, piece)) in waistbands.iter().zip(&fabric.garments).enumerate() {
        for &vertex in band {
            if vertex as usize >= piece.vertices.len() {
                let expected = format!("vertex numbers below {}", piece.vertices.len());
                return Err(SimError::value(
                    format!("waist band of garment {number}"),
                    expected,
                    vertex,
                ));
            }
            bound.push(piece.vertices.start as u32 + vertex);
        }
    }
    bound.sort_unstable();
    bound.dedup();
    Ok(bound)
}

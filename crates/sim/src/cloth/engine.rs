//! The engine: state, order of passes, counters.

use std::collections::BTreeMap;

use drape_dataset::registry::Effect;
use drape_dataset::sequence::{Garment, Wind};
use drape_geometry::bvh::Bvh;
use glam::DVec3;

use super::air::{Air, blow};
use super::body::{Body, single};
use super::body_contact::{BodyContact, Search};
use super::cloth_contact::ClothContact;
use super::contact::Push;
use super::elastic::Elastic;
use super::physics::{ScenePhysics, air_velocity, friction_coefficient};
use super::settings::EngineSettings;
use super::state::{Cloth, check_faces, check_finite, metres};
use super::waistband::Waistband;
use crate::error::SimError;

/// Relative motion between two searches that candidates allow for, m.
const MARGIN_M: f64 = 0.008;
/// No vertex moves faster than this relative to the cloth's mean, m/s.
const FASTEST: f64 = 20.0;

/// Simulates one outfit on one body.
#[derive(Clone, Debug)]
pub struct Engine {
    settings: EngineSettings,
    physics: ScenePhysics,
    scale: f64,
    gravity: DVec3,
    cloth: Cloth,
    body: Body,
    elastic: Elastic,
    waistband: Waistband,
    body_contact: Option<BodyContact>,
    cloth_contact: ClothContact,
    face_normals: Vec<DVec3>,
    passes: BTreeMap<Effect, u64>,
}

/// What happened in a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Contacts with the body that pushed, mean over the steps.
    pub body_contacts: f64,
    /// Contacts between cloth and cloth that pushed, mean over the steps.
    pub cloth_contacts: f64,
    /// 95th percentile of the absolute strain of edges at the end.
    pub strain_p95: f64,
    /// Largest absolute strain.
    pub strain_max: f64,
}

impl Engine {
    /// An engine with the garments at rest on `body0`.
    ///
    /// `waistbands[garment]` lists vertices that follow the body; it may be
    /// empty where no garment has one. Without faces there is no body.
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
        check_finite("body", body0)?;
        check_faces("body", body0.len(), body_faces)?;
        let scale = f64::from(physics.scale);
        let mut cloth = Cloth::new(garments, scale)?;
        let body = Body::new(body_faces, body0.iter().map(|p| metres(p, scale)).collect());
        let orientation = orientation(&cloth, &body);
        let elastic = Elastic::new(&cloth, physics);
        let cloth_contact = ClothContact::new(&cloth, physics, orientation.clone());
        let body_contact =
            (physics.has(Effect::BodyContact) && !body_faces.is_empty()).then(|| {
                let rough = f64::from(physics.body_friction);
                let friction = (cloth.fabrics.iter())
                    .map(|fabric| friction_coefficient(rough, fabric.friction))
                    .collect();
                BodyContact::new(friction, orientation)
            });
        let bound = bound_vertices(&cloth, waistbands)?;
        let waistband = if physics.has(Effect::Waistband) {
            Waistband::bind(&mut cloth, &body, bound.into_iter())
        } else {
            Waistband::default()
        };
        Ok(Self {
            settings: settings.clone(),
            physics: physics.clone(),
            scale,
            gravity: metres(&physics.gravity, scale),
            cloth,
            body,
            elastic,
            waistband,
            body_contact,
            cloth_contact,
            face_normals: Vec::new(),
            passes: BTreeMap::new(),
        })
    }

    /// Simulates one frame of `dt_s` seconds, in which the body moves linearly
    /// to `body_next`.
    pub fn advance(
        &mut self,
        body_next: &[[f32; 3]],
        wind: Wind,
        dt_s: f64,
    ) -> Result<StepReport, SimError> {
        if body_next.len() != self.body.x.len() {
            return Err(SimError::value(
                "body of the next frame",
                format!("{} vertices as at the start", self.body.x.len()),
                body_next.len(),
            ));
        }
        check_finite("body", body_next)?;
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return Err(SimError::value("dt_s", "seconds above 0", dt_s));
        }
        let air = self.air(&wind)?;
        let scale = self.scale;
        self.body
            .begin_frame(body_next.iter().map(|p| metres(p, scale)).collect());
        let steps = self.settings.substeps;
        let dt = dt_s / f64::from(steps);
        let mut report = StepReport::default();
        for step in 0..steps {
            if step % self.settings.detect_every == 0 {
                let ahead = self.settings.detect_every.min(steps - step);
                let middle = (f64::from(step) + 0.5 * f64::from(ahead)) / f64::from(steps);
                self.detect(middle, 0.5 * f64::from(ahead) * dt);
            }
            self.body.step_to(f64::from(step + 1) / f64::from(steps));
            self.step(air, dt, &mut report);
        }
        report.body_contacts /= f64::from(steps);
        report.cloth_contacts /= f64::from(steps);
        let mut strains: Vec<f64> = self.elastic.strains(&self.cloth.x).map(f64::abs).collect();
        strains.sort_unstable_by(f64::total_cmp);
        if let Some(&largest) = strains.last() {
            report.strain_max = largest;
            report.strain_p95 = strains[strains.len() * 95 / 100];
        }
        Ok(report)
    }

    /// Positions of each garment in scene units, `[garment][vertex, 3]`.
    pub fn garments(&self) -> Vec<Vec<[f32; 3]>> {
        (self.cloth.ranges.iter())
            .map(|range| {
                let points = self.cloth.x[range.clone()].iter();
                points.map(|x| single(*x * self.scale)).collect()
            })
            .collect()
    }

    /// How many passes of an effect have run so far.
    pub fn passes(&self, effect: Effect) -> u64 {
        self.passes.get(&effect).copied().unwrap_or(0)
    }

    fn count(&mut self, effect: Effect) {
        *self.passes.entry(effect).or_insert(0) += 1;
    }

    fn air(&self, wind: &Wind) -> Result<Option<Air>, SimError> {
        let velocity = if self.physics.has(Effect::Wind) {
            air_velocity(wind)?
        } else {
            DVec3::ZERO
        };
        Ok(if self.physics.has(Effect::AirDrag) {
            Some(Air::Drag(velocity))
        } else if velocity != DVec3::ZERO {
            Some(Air::Push(velocity))
        } else {
            None
        })
    }

    fn detect(&mut self, middle: f64, ahead_s: f64) {
        let (between, within) = (self.cloth_contact.between(), self.cloth_contact.within());
        if self.body_contact.is_none() && !between && !within {
            return;
        }
        let predicted: Vec<[f32; 3]> = (self.cloth.x.iter().zip(&self.cloth.v))
            .map(|(x, v)| single(*x + *v * ahead_s))
            .collect();
        let tree = Bvh::of_faces(&predicted, &self.cloth.faces);
        let body = self.body.at(middle);
        let search = Search {
            cloth: &predicted,
            cloth_tree: &tree,
            body: &body,
            margin: MARGIN_M,
        };
        if let Some(contact) = &mut self.body_contact {
            let thickness = self.settings.body_thickness_m;
            contact.detect(&self.cloth, &self.body, &search, thickness);
        }
        if between || within {
            let thickness = self.settings.cloth_thickness_m;
            self.cloth_contact.detect(&self.cloth, &search, thickness);
        }
    }

    fn step(&mut self, air: Option<Air>, dt: f64, report: &mut StepReport) {
        std::mem::swap(&mut self.cloth.x, &mut self.cloth.old);
        self.cloth.x.copy_from_slice(&self.cloth.old);
        if !self.waistband.is_empty() {
            self.count(Effect::Waistband);
            self.waistband.follow(&mut self.cloth, &self.body, dt);
        }
        if self.physics.has(Effect::Gravity) && self.gravity != DVec3::ZERO {
            self.count(Effect::Gravity);
            for (v, w) in self.cloth.v.iter_mut().zip(&self.cloth.w) {
                if *w > 0.0 {
                    *v += self.gravity * dt;
                }
            }
        }
        if let Some(air) = air {
            let (Air::Drag(velocity) | Air::Push(velocity)) = air;
            if matches!(air, Air::Drag(_)) {
                self.count(Effect::AirDrag);
            }
            if velocity != DVec3::ZERO {
                self.count(Effect::Wind);
            }
            blow(&mut self.cloth, air, dt);
        }
        let cloth = &mut self.cloth;
        for i in 0..cloth.len() {
            if cloth.w[i] > 0.0 {
                cloth.x[i] += cloth.v[i] * dt;
            }
        }
        for _ in 0..self.settings.iterations {
            self.solve_elastic(dt);
        }
        self.solve_contacts(dt);
        self.update_velocities(dt);
        self.settle(dt, report);
    }

    fn solve_elastic(&mut self, dt: f64) {
        if self.elastic.has_bending() {
            self.count(Effect::Bending);
            self.elastic.solve_bending(&mut self.cloth, dt);
        }
        if self.elastic.has_shear() {
            self.count(Effect::Shear);
            self.elastic.solve_shear(&mut self.cloth, dt);
        }
        if self.elastic.has_stretch() {
            self.count(Effect::Stretch);
            self.elastic.solve_stretch(&mut self.cloth, dt);
        }
    }

    fn solve_contacts(&mut self, dt: f64) {
        let rub = self.physics.has(Effect::Friction);
        let push = |thickness: f64| Push {
            thickness,
            recovery: self.settings.recovery_speed * dt,
            rub,
        };
        let on_body = push(self.settings.body_thickness_m);
        let on_cloth = push(self.settings.cloth_thickness_m);
        let (between, within) = (self.cloth_contact.between(), self.cloth_contact.within());
        let on = between || within || self.body_contact.is_some();
        if on {
            face_normals(&self.cloth, &mut self.face_normals);
        }
        if between || within {
            let normals = &self.face_normals;
            self.cloth_contact
                .begin_step(&self.cloth, normals, on_cloth);
        }
        if let Some(contact) = &mut self.body_contact {
            contact.begin_step(&self.cloth, &self.face_normals, &self.body, on_body);
        }
        for _ in 0..self.settings.contact_iterations {
            if between || within {
                self.cloth_contact.solve(&mut self.cloth);
            }
            if let Some(contact) = &mut self.body_contact {
                contact.solve(&mut self.cloth);
            }
        }
        for (runs, effect) in [
            (between, Effect::LayerContact),
            (within, Effect::SelfContact),
            (self.body_contact.is_some(), Effect::BodyContact),
            (rub && on, Effect::Friction),
        ] {
            if runs {
                self.count(effect);
            }
        }
    }

    fn update_velocities(&mut self, dt: f64) {
        let cloth = &mut self.cloth;
        let mut mean = DVec3::ZERO;
        for i in 0..cloth.len() {
            cloth.v[i] = (cloth.x[i] - cloth.old[i]) / dt;
            mean += cloth.v[i];
        }
        mean /= cloth.len().max(1) as f64;
        for i in 0..cloth.len() {
            let relative = cloth.v[i] - mean;
            if cloth.w[i] > 0.0 && relative.length_squared() > FASTEST * FASTEST {
                cloth.v[i] = mean + relative.normalize() * FASTEST;
            }
        }
    }

    fn settle(&mut self, dt: f64, report: &mut StepReport) {
        if self.settings.damping > 0.0 {
            let share = 1.0 - (1.0 - self.settings.damping).powf(600.0 * dt);
            self.elastic.damp(&mut self.cloth, share);
        }
        report.cloth_contacts += self.cloth_contact.settle(&mut self.cloth, dt) as f64;
        if let Some(contact) = &self.body_contact {
            report.body_contacts += contact.settle(&mut self.cloth, dt) as f64;
        }
    }
}

/// Whether each garment's faces point away from the body (1) or towards it
/// (−1), by vote of its vertices; 1 without a body.
fn orientation(cloth: &Cloth, body: &Body) -> Vec<f64> {
    let mut normals = vec![DVec3::ZERO; cloth.len()];
    super::body::vertex_normals(&cloth.x, &cloth.faces, &mut normals);
    let points: Vec<[f32; 3]> = body.x.iter().map(|x| single(*x)).collect();
    let grid = drape_geometry::Grid::build(&points, 0.03);
    (cloth.ranges.iter())
        .map(|range| {
            let votes: f64 = (range.clone())
                .filter_map(|i| {
                    let (nearest, _) = grid.nearest(single(cloth.x[i]))?;
                    Some(body.normals[nearest as usize].dot(normals[i]).signum())
                })
                .sum();
            if votes < 0.0 { -1.0 } else { 1.0 }
        })
        .collect()
}

fn bound_vertices(cloth: &Cloth, waistbands: &[Vec<u32>]) -> Result<Vec<usize>, SimError> {
    if waistbands.len() > cloth.ranges.len() {
        return Err(SimError::value(
            "waist bands",
            format!(
                "at most one list for each of {} garments",
                cloth.ranges.len()
            ),
            waistbands.len(),
        ));
    }
    let mut bound = Vec::new();
    for (garment, (list, range)) in waistbands.iter().zip(&cloth.ranges).enumerate() {
        for &vertex in list {
            if vertex as usize >= range.len() {
                return Err(SimError::value(
                    format!("waist band of garment {garment}"),
                    format!("vertices below {}", range.len()),
                    vertex,
                ));
            }
            bound.push(range.start + vertex as usize);
        }
    }
    Ok(bound)
}

fn face_normals(cloth: &Cloth, normals: &mut Vec<DVec3>) {
    normals.clear();
    normals.extend(cloth.faces.iter().map(|face| {
        let [a, b, c] = face.map(|v| cloth.x[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    }));
}

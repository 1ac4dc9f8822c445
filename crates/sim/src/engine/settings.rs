//! What the engine is told: the scene's physics and its own numerical settings.

use std::collections::BTreeSet;

use drape_dataset::registry::Effect;
use serde::{Deserialize, Serialize};

use crate::error::SimError;

/// Physics of one scene. Lengths are in scene units.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenePhysics {
    /// Scene units per metre.
    pub scale: f32,
    /// Acceleration of gravity in units/s².
    pub gravity: [f32; 3],
    /// Density of the air in kg/m³: drag and wind are in proportion to it. Real air has
    /// [`AIR_DENSITY`](super::AIR_DENSITY), a vacuum 0.
    pub air_density: f64,
    /// Friction of the body in the paper's units (40–80).
    pub body_friction: f32,
    /// Effects that the scene calls for. What is not in the set is not computed.
    pub effects: BTreeSet<Effect>,
}

/// Numerical settings of the engine. Lengths are real metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EngineSettings {
    /// Steps per frame. More: stiffer cloth, fewer intersections, proportionally slower. Default 15.
    pub substeps: u32,
    /// Passes over springs and contacts in turn, per substep, for cloth with edges of 12.5 mm or
    /// more; finer cloth gets more in proportion. More: less stretch under load, stacked layers
    /// press through each other less. Default 3.
    pub iterations: u32,
    /// Substeps between two searches for contact pairs. More: fewer searches, each finding more
    /// pairs. Fast motion makes the engine search earlier by itself, as it does for cloth with
    /// edges below 12.5 mm. Default 5.
    pub search_every: u32,
    /// Distance that cloth keeps from the body. Smaller looks tighter and is easier to push
    /// through. Default 0.004.
    pub body_thickness_m: f64,
    /// Distance between garments. Default 0.003.
    pub layer_thickness_m: f64,
    /// Distance within a garment, never more than 0.3 of the mean edge and
    /// 0.4 of the distance at rest. Default 0.003.
    pub self_thickness_m: f64,
    /// While the engine warms up, all these distances are up to so many times as large: layers
    /// that were made close to each other part first. 1: no warm-up. Default 2.
    pub warm_up_times: f64,
    /// Damping of stretch: time constant of strain rates. Larger: calmer, more sluggish
    /// wrinkles. Default 0.03: woven cloth loses most of a vibration's energy within a frame.
    pub stretch_damping_s: f64,
    /// Damping of bending. Larger: folds move less. Default 0.2.
    pub bending_damping_s: f64,
    /// Speed at which cloth that is closer than its distance is pushed away. Larger: closes the
    /// defect sooner, but visibly. Default 0.1.
    pub push_out_m_s: f64,
    /// Speed at which cloth on the wrong side is brought back. Default 0.5.
    pub recovery_m_s: f64,
    /// Speed that no cloth vertex exceeds relative to the body's mean velocity. Default 30.
    pub speed_limit_m_s: f64,
    /// Effects that are forced off although the scene may call for them; the sequence says so.
    /// Default none.
    pub without: BTreeSet<Effect>,
}

impl Default for EngineSettings {
    fn default() -> Self {
        Self {
            substeps: 15,
            iterations: 3,
            search_every: 5,
            body_thickness_m: 0.004,
            layer_thickness_m: 0.003,
            self_thickness_m: 0.003,
            warm_up_times: 2.0,
            stretch_damping_s: 0.03,
            bending_damping_s: 0.2,
            push_out_m_s: 0.1,
            recovery_m_s: 0.5,
            speed_limit_m_s: 30.0,
            without: BTreeSet::new(),
        }
    }
}

impl EngineSettings {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`SimError::Value`] names the first setting out of range.
    pub fn validate(&self) -> Result<(), SimError> {
        let counts = [
            ("substeps", self.substeps, 1000),
            ("iterations", self.iterations, 100),
            ("search_every", self.search_every, 1000),
        ];
        for (name, found, highest) in counts {
            if found == 0 || found > highest {
                return Err(SimError::value(name, format!("1 to {highest}"), found));
            }
        }
        let thicknesses = [
            ("body_thickness_m", self.body_thickness_m),
            ("layer_thickness_m", self.layer_thickness_m),
            ("self_thickness_m", self.self_thickness_m),
        ];
        for (name, found) in thicknesses {
            if !(found > 0.0 && found <= 0.05) {
                return Err(SimError::value(name, "above 0 and at most 0.05 m", found));
            }
        }
        if !(1.0..=10.0).contains(&self.warm_up_times) {
            let found = self.warm_up_times;
            return Err(SimError::value("warm_up_times", "1 to 10", found));
        }
        let others = [
            ("stretch_damping_s", self.stretch_damping_s),
            ("bending_damping_s", self.bending_damping_s),
            ("push_out_m_s", self.push_out_m_s),
            ("recovery_m_s", self.recovery_m_s),
        ];
        for (name, found) in others {
            if !(0.0..=10.0).contains(&found) {
                return Err(SimError::value(name, "0 to 10", found));
            }
        }
        if !(self.speed_limit_m_s >= 1.0 && self.speed_limit_m_s <= 1000.0) {
            return Err(SimError::value(
                "speed_limit_m_s",
                "1 to 1000",
                self.speed_limit_m_s,
            ));
        }
        Ok(())
    }
}

impl ScenePhysics {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`SimError::Value`] names the first value out of range.
    pub fn validate(&self) -> Result<(), SimError> {
        if !(self.scale.is_finite() && self.scale > 0.0) {
            return Err(SimError::value(
                "scale",
                "a positive number of units per metre",
                self.scale,
            ));
        }
        if !self.gravity.iter().all(|g| g.is_finite()) {
            return Err(SimError::value(
                "gravity",
                "finite",
                format!("{:?}", self.gravity),
            ));
        }
        if !(self.air_density.is_finite() && self.air_density >= 0.0) {
            return Err(SimError::value(
                "air density",
                "finite and not negative, in kg/m³",
                self.air_density,
            ));
        }
        if !(self.body_friction.is_finite() && self.body_friction >= 0.0) {
            return Err(SimError::value(
                "body friction",
                "finite and not negative",
                self.body_friction,
            ));
        }
        Ok(())
    }

    /// Whether the scene calls for an effect.
    pub fn calls_for(&self, effect: Effect) -> bool {
        self.effects.contains(&effect)
    }
}

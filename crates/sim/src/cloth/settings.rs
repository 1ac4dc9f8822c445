//! What the engine's user may tune: accuracy against time.

use crate::error::SimError;

/// Settings of the engine, `[engine]` in a configuration file.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EngineSettings {
    /// Steps a frame. More: stiffer, cleaner, slower in proportion. Below 10,
    /// fast limbs outrun the contacts.
    pub substeps: u32,
    /// Passes of the elastic solver a step. More: less stretch under load.
    pub iterations: u32,
    /// Passes over the contacts a step. More: stacked layers press through each
    /// other less.
    pub contact_iterations: u32,
    /// Steps between searches for contact candidates. More: faster; fast
    /// relative motion is then seen late.
    pub detect_every: u32,
    /// Distance in metres that cloth keeps from the body. Larger hides the
    /// body's facets, and garments look inflated.
    pub body_thickness_m: f64,
    /// Distance in metres that cloth keeps from cloth; within a garment at
    /// most 0.7 of the rest distance.
    pub cloth_thickness_m: f64,
    /// Share of the relative velocity along edges that is taken away each
    /// step at 600 steps a second. Larger: calmer, and wrinkles move sluggishly.
    pub damping: f64,
    /// Speed in m/s at which penetration is undone. Larger: out sooner, with a jerk.
    pub recovery_speed: f64,
}

impl Default for EngineSettings {
    fn default() -> Self {
        Self {
            substeps: 16,
            iterations: 2,
            contact_iterations: 4,
            detect_every: 4,
            body_thickness_m: 0.004,
            cloth_thickness_m: 0.003,
            damping: 0.1,
            recovery_speed: 0.5,
        }
    }
}

impl EngineSettings {
    /// Checks ranges.
    pub fn validate(&self) -> Result<(), SimError> {
        let positive = [
            ("engine.body_thickness_m", self.body_thickness_m),
            ("engine.cloth_thickness_m", self.cloth_thickness_m),
            ("engine.recovery_speed", self.recovery_speed),
        ];
        for (what, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SimError::value(what, "a number above 0", value));
            }
        }
        if !(0.0..=1.0).contains(&self.damping) {
            return Err(SimError::value(
                "engine.damping",
                "a share from 0 to 1",
                self.damping,
            ));
        }
        let counts = [
            ("engine.substeps", self.substeps),
            ("engine.iterations", self.iterations),
            ("engine.contact_iterations", self.contact_iterations),
            ("engine.detect_every", self.detect_every),
        ];
        for (what, count) in counts {
            if !(1..=1000).contains(&count) {
                return Err(SimError::value(what, "a count from 1 to 1000", count));
            }
        }
        Ok(())
    }
}

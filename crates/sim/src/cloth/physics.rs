//! From the paper's material numbers to SI.
//!
//! The paper (and Blender, which made its data) gives numbers without units.
//! Here they mean:
//!
//! | paper | range | SI |
//! |---|---|---|
//! | mass | 0.2–0.8 | mass per area: that many kg/m² (silk 0.2, denim 0.5, felt 0.8) |
//! | tension | 15–100 | membrane stiffness: 100 N/m each, 1.5–10 kN/m |
//! | compression | 15–100 | a tenth of that: cloth buckles before it shortens |
//! | shear | 15–100 | 20 N/m each across inner edges, against lengthening |
//! | bending | 15–100 | flexural rigidity: 1e-6 N·m each, 0.015–0.1 mN·m |
//! | friction | 40–80 | Coulomb coefficient: a hundredth, the mean of both surfaces |
//! | wind strength | 0–400 | air speed: 0.03 m/s each, so that 300 is 9 m/s |

use std::collections::BTreeSet;

use drape_dataset::registry::Effect;
use glam::{DQuat, DVec3};

use drape_dataset::sequence::{Material, Wind};

use crate::error::SimError;

/// What a scene fixes for the engine besides meshes and materials.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenePhysics {
    /// Scene units per metre.
    pub scale: f32,
    /// Acceleration of gravity in units/s².
    pub gravity: [f32; 3],
    /// Friction of the body in the paper's units (40–80).
    pub body_friction: f32,
    /// Effects the scene calls for; the others cost nothing.
    pub effects: BTreeSet<Effect>,
}

impl ScenePhysics {
    pub(super) fn validate(&self) -> Result<(), SimError> {
        if !(self.scale > 0.0 && self.scale.is_finite()) {
            return Err(SimError::value(
                "scale",
                "scene units per metre, above 0",
                self.scale,
            ));
        }
        if !self.gravity.iter().all(|g| g.is_finite()) {
            return Err(SimError::value(
                "gravity",
                "three finite numbers",
                format!("{:?}", self.gravity),
            ));
        }
        if !(self.body_friction >= 0.0 && self.body_friction.is_finite()) {
            return Err(SimError::value(
                "body friction",
                "a number from 0",
                self.body_friction,
            ));
        }
        Ok(())
    }

    pub(super) fn has(&self, effect: Effect) -> bool {
        self.effects.contains(&effect)
    }
}

/// A material in SI.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fabric {
    /// kg/m².
    pub density: f64,
    /// N/m.
    pub tension: f64,
    /// N/m.
    pub compression: f64,
    /// N/m.
    pub shear: f64,
    /// N·m.
    pub bending: f64,
    /// In hundredths, to be averaged with the other surface's.
    pub friction: f64,
}

impl Fabric {
    pub fn new(material: &Material, garment: &str) -> Result<Self, SimError> {
        let fields = [
            ("mass", material.mass),
            ("tension", material.tension),
            ("compression", material.compression),
            ("shear", material.shear),
            ("bending", material.bending),
            ("friction", material.friction),
        ];
        for (field, value) in fields {
            let least = if field == "mass" { 1e-3 } else { 0.0 };
            if !(value >= least && value.is_finite()) {
                return Err(SimError::value(
                    format!("garment {garment:?}, material {field}"),
                    format!("a number from {least}"),
                    value,
                ));
            }
        }
        Ok(Self {
            density: f64::from(material.mass),
            tension: 100.0 * f64::from(material.tension),
            compression: 10.0 * f64::from(material.compression),
            shear: 20.0 * f64::from(material.shear),
            bending: 1e-6 * f64::from(material.bending),
            friction: f64::from(material.friction),
        })
    }
}

/// Coulomb coefficient between two surfaces of the paper's frictions.
pub(super) fn friction_coefficient(a: f64, b: f64) -> f64 {
    (a + b) / 200.0
}

/// Velocity of the air in m/s; zero strength is still air whatever the quaternion.
pub(super) fn air_velocity(wind: &Wind) -> Result<DVec3, SimError> {
    let strength = f64::from(wind.strength);
    if !strength.is_finite() || strength < 0.0 {
        return Err(SimError::value(
            "wind strength",
            "a number from 0",
            wind.strength,
        ));
    }
    if strength == 0.0 {
        return Ok(DVec3::ZERO);
    }
    let [w, x, y, z] = wind.rotation.map(f64::from);
    let turn = DQuat::from_xyzw(x, y, z, w);
    let length = turn.length();
    if !((length - 1.0).abs() < 1e-2) {
        return Err(SimError::value(
            "wind rotation",
            "a unit quaternion (w, x, y, z) where the strength is above 0",
            format!("{:?} of length {length}", wind.rotation),
        ));
    }
    Ok(turn.normalize() * DVec3::Z * (0.03 * strength))
}

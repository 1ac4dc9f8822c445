//! Wind: what moving air does beyond still air.
//!
//! The paper's strength (0–400) is a pressure here, as it is in Blender: a
//! face across the wind feels 0.02 Pa per unit, 6 Pa at 300. That is two to
//! five times the weight of the paper's fabrics and lifts a skirt: a strong
//! wind. The air's speed follows from the pressure, p = ½ ρ C_n s²: 2.9 m/s at
//! 300, 10.5 m/s at 4000. In a scene whose air is thinner than real air the speed
//! is the same and the pressure less, in proportion. The force is that of air with the relative velocity
//! minus that of still air, so drag stays the business of its own effect and
//! a strength of 0 changes nothing.

use drape_dataset::sequence::Wind;
use glam::{DQuat, DVec3};

use super::air::{AIR_DENSITY, NORMAL_DRAG, Push, velocity_change};
use super::fabric::Fabric;
use super::state::State;
use crate::error::SimError;

/// Pressure of one unit of strength on a face across the wind in real air, Pa.
pub const PASCAL_PER_STRENGTH: f64 = 0.02;

/// Velocity of the air in m/s.
///
/// # Errors
/// [`SimError::Value`] if strength or direction is not usable.
pub fn air_velocity(wind: Wind) -> Result<DVec3, SimError> {
    let strength = f64::from(wind.strength);
    if !(strength.is_finite() && strength >= 0.0) {
        return Err(SimError::value(
            "wind strength",
            "finite and not negative",
            wind.strength,
        ));
    }
    if strength == 0.0 {
        return Ok(DVec3::ZERO);
    }
    let [w, x, y, z] = wind.rotation.map(f64::from);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let length = rotation.length();
    if !(length.is_finite() && (length - 1.0).abs() < 1e-2) {
        let found = format!("{:?}", wind.rotation);
        return Err(SimError::value(
            "wind rotation",
            "a unit quaternion (w, x, y, z)",
            found,
        ));
    }
    let speed = (2.0 * PASCAL_PER_STRENGTH * strength / (AIR_DENSITY * NORMAL_DRAG)).sqrt();
    Ok(rotation.normalize() * DVec3::Z * speed)
}

/// Wind in air of one density.
#[derive(Clone, Debug)]
pub(super) struct Blow {
    air: f64,
    push: Push,
}

impl Blow {
    /// Air of this density, kg/m³.
    pub fn new(air: f64) -> Self {
        Self {
            air,
            push: Push::default(),
        }
    }

    /// Pushes free cloth vertices with air of velocity `wind` in one substep of `h` seconds,
    /// `left` of the frame with it.
    pub fn apply(
        &mut self,
        state: &mut State,
        fabric: &Fabric,
        wind: DVec3,
        (h, left): (f64, u32),
    ) {
        let change = |velocity: DVec3, normal, density, seconds| {
            velocity_change(self.air, wind - velocity, normal, density, seconds)
                - velocity_change(self.air, -velocity, normal, density, seconds)
        };
        self.push.apply(state, fabric, (h, left), change);
    }
}

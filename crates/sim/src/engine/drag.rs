//! Drag of still air on moving cloth.

use super::air::{Push, velocity_change};
use super::fabric::Fabric;
use super::state::State;

/// Drag of air with one density.
#[derive(Clone, Debug)]
pub(super) struct Drag {
    air: f64,
    push: Push,
}

impl Drag {
    /// Air of this density, kg/m³.
    pub fn new(air: f64) -> Self {
        Self {
            air,
            push: Push::default(),
        }
    }

    /// Slows free cloth vertices in one substep of `h` seconds, `left` of the frame with it.
    pub fn apply(&mut self, state: &mut State, fabric: &Fabric, (h, left): (f64, u32)) {
        let change = |velocity: glam::DVec3, normal, density, seconds| {
            velocity_change(self.air, -velocity, normal, density, seconds)
        };
        self.push.apply(state, fabric, (h, left), change);
    }
}

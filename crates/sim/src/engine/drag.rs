//! Drag of still air on moving cloth.

use super::air::{for_faces, velocity_change};
use super::fabric::Fabric;
use super::state::State;

/// Slows free cloth vertices for `h` seconds in air of this density.
pub(super) fn apply(state: &mut State, fabric: &Fabric, air: f64, h: f64) {
    for_faces(state, fabric, |velocity, normal, density| {
        velocity_change(air, -velocity, normal, density, h)
    });
}

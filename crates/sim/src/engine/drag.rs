//! Drag of still air on moving cloth.

use super::air::{for_faces, velocity_change};
use super::fabric::Fabric;
use super::state::State;

/// Slows free cloth vertices for `h` seconds.
pub(super) fn apply(state: &mut State, fabric: &Fabric, h: f64) {
    for_faces(state, fabric, |velocity, normal, density| {
        velocity_change(-velocity, normal, density, h)
    });
}

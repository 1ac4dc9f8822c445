//! Gravity: the same acceleration for every free vertex.

use glam::DVec3;

use super::state::State;

/// Adds `gravity · h` (m/s², s) to the velocities of free cloth vertices.
pub(super) fn apply(state: &mut State, gravity: DVec3, h: f64) {
    for i in 0..state.cloth {
        if state.w[i] > 0.0 {
            state.v[i] += gravity * h;
        }
    }
}

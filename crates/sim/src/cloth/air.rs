//! Air: drag in still air and wind, per face.
//!
//! A face is a flat plate: the air's velocity relative to it, along its
//! normal, gives the force `½ ρ C A |u| u` (ρ = 1.2 kg/m³, C = 1.2), a third on
//! each vertex. Skin friction is left out: two orders smaller. The impulse is
//! taken implicitly, so that it never exceeds the relative velocity.
//! A sheet falling flat reaches `sqrt(2 σ g / (ρ C))`, σ its mass per area.

use glam::DVec3;

use super::state::Cloth;

/// Density of air times the drag coefficient of a plate, kg/m³.
pub(super) const DENSITY_TIMES_DRAG: f64 = 1.2 * 1.2;

/// What the air does to cloth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Air {
    /// Resists any motion relative to the air, which moves at this velocity.
    Drag(DVec3),
    /// Only pushes where it is faster than the cloth: wind without air drag.
    Push(DVec3),
}

/// Changes velocities by one step's impulse.
pub(super) fn blow(cloth: &mut Cloth, air: Air, dt: f64) {
    let (velocity, only_push) = match air {
        Air::Drag(velocity) => (velocity, false),
        Air::Push(velocity) => (velocity, true),
    };
    for face in &cloth.faces {
        let [a, b, c] = face.map(|v| v as usize);
        let normal = (cloth.x[b] - cloth.x[a]).cross(cloth.x[c] - cloth.x[a]);
        let doubled_area = normal.length();
        if doubled_area == 0.0 {
            continue;
        }
        let normal = normal / doubled_area;
        let mean = (cloth.v[a] + cloth.v[b] + cloth.v[c]) / 3.0;
        let relative = (velocity - mean).dot(normal);
        if only_push && relative * velocity.dot(normal) <= 0.0 {
            continue;
        }
        let third = DENSITY_TIMES_DRAG * doubled_area / 12.0 * relative.abs() * dt;
        for v in [a, b, c] {
            let share = third * cloth.w[v];
            cloth.v[v] += normal * (relative * share / (1.0 + share));
        }
    }
}

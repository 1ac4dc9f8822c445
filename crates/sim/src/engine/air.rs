//! The force of moving air on a face, shared by drag (still air) and wind.
//!
//! A face of area A that meets air with relative velocity u feels
//! F = ½ ρ A |u| (C_n u_n + C_t u_t), with u split into its part along the
//! face's normal and the rest. A third of it goes to each corner. One substep
//! never takes away more than half of the relative velocity, so no wind and no
//! step size can make the sum overshoot.
//!
//! The air's density ρ is the scene's: real air, none in a vacuum, thinner in
//! units in which everything floats.

use glam::DVec3;

use super::fabric::Fabric;
use super::state::State;

/// Density of real air, kg/m³.
pub const AIR_DENSITY: f64 = 1.2;
/// Drag coefficient of a plate across the flow.
pub(super) const NORMAL_DRAG: f64 = 1.2;
/// Drag coefficient along the surface (skin friction of rough cloth).
pub(super) const TANGENT_DRAG: f64 = 0.05;

/// Velocity change in `h` seconds of a sheet with this areal density and normal
/// in air of density `air` that moves with velocity `u` relative to it.
#[inline]
pub(super) fn velocity_change(air: f64, u: DVec3, normal: DVec3, density: f64, h: f64) -> DVec3 {
    let speed = u.length();
    let along = u.dot(normal) * normal;
    let rate = 0.5 * air * speed * h / density;
    let normal_share = (rate * NORMAL_DRAG).min(0.5);
    let tangent_share = (rate * TANGENT_DRAG).min(0.5);
    normal_share * along + tangent_share * (u - along)
}

/// Visits every face: `change(velocity of the face, unit normal, areal density)`
/// is given to its free corners in proportion to the face's share of their mass.
pub(super) fn for_faces(
    state: &mut State,
    fabric: &Fabric,
    change: impl Fn(DVec3, DVec3, f64) -> DVec3,
) {
    for garment in &fabric.garments {
        let density = garment.cloth.density;
        for face in &fabric.faces[garment.faces.clone()] {
            let (a, b, c) = (face[0] as usize, face[1] as usize, face[2] as usize);
            let doubled = (state.x[b] - state.x[a]).cross(state.x[c] - state.x[a]);
            let length = doubled.length();
            if length < 1e-14 {
                continue;
            }
            let velocity = (state.v[a] + state.v[b] + state.v[c]) / 3.0;
            // Mass of the face in its present size, a third for each corner.
            let mass = density * 0.5 * length / 3.0;
            let impulse = mass * change(velocity, doubled / length, density);
            for i in [a, b, c] {
                // A face stretched far beyond its rest size must not count twice for a corner.
                let share = (mass * state.w[i]).min(0.5) / mass;
                if state.w[i] > 0.0 {
                    state.v[i] += impulse * share;
                }
            }
        }
    }
}

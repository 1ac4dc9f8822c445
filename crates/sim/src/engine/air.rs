//! The force of moving air on a face, shared by drag (still air) and wind.
//!
//! A face of area A that meets air with relative velocity u feels
//! F = ½ ρ A |u| (C_n u_n + C_t u_t), with u split into its part along the
//! face's normal and the rest. A third of it goes to each corner. Air changes
//! more slowly than cloth vibrates: faces are visited in every [`EVERY`]th
//! substep, and the change of velocity found is spread evenly over the substeps
//! until the next visit. In that time never more than half of the relative
//! velocity is taken away, so no wind and no step size can make the sum overshoot.
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

/// Substeps from one visit of the faces to the next.
const EVERY: u32 = 5;

/// What air does to the velocities of vertices in each substep until faces are visited again.
#[derive(Clone, Debug, Default)]
pub(super) struct Push {
    /// Velocity change of each cloth vertex in a substep, m/s.
    of: Vec<DVec3>,
    /// Substeps until the next visit.
    left: u32,
}

impl Push {
    /// One substep of `h` seconds, `left` of the frame with it.
    ///
    /// `change(velocity of the face, unit normal, areal density, seconds)` is given to a
    /// face's free corners in proportion to the face's share of their mass.
    pub fn apply(
        &mut self,
        state: &mut State,
        fabric: &Fabric,
        (h, left): (f64, u32),
        change: impl Fn(DVec3, DVec3, f64, f64) -> DVec3,
    ) {
        if self.left == 0 {
            // Wind and body move on otherwise in the next frame.
            self.left = EVERY.min(left);
            self.visit(state, fabric, f64::from(self.left), h, change);
        }
        self.left -= 1;
        for (v, push) in state.v.iter_mut().zip(&self.of) {
            *v += *push;
        }
    }

    fn visit(
        &mut self,
        state: &State,
        fabric: &Fabric,
        substeps: f64,
        h: f64,
        change: impl Fn(DVec3, DVec3, f64, f64) -> DVec3,
    ) {
        self.of.clear();
        self.of.resize(state.cloth, DVec3::ZERO);
        for garment in &fabric.garments {
            let density = garment.cloth.density;
            for number in garment.faces.clone() {
                let [a, b, c] = fabric.faces[number].map(|v| v as usize);
                let doubled = (state.x[b] - state.x[a]).cross(state.x[c] - state.x[a]);
                let length = doubled.length();
                if length < 1e-14 {
                    continue;
                }
                let velocity = (state.v[a] + state.v[b] + state.v[c]) / 3.0;
                // Mass of the face in its present size, a third for each corner. However far
                // faces are stretched, those at a vertex count for no more than twice its mass.
                let area = (0.5 * length).min(2.0 * fabric.area[number]);
                let mass = density * area / 3.0;
                let impulse = mass * change(velocity, doubled / length, density, substeps * h);
                for i in [a, b, c] {
                    self.of[i] += (state.w[i] / substeps) * impulse;
                }
            }
        }
    }
}

//! The engine's moving numbers: one array of vertices, cloth of all garments
//! first, then the body with inverse mass 0. Metres, seconds, kilograms.

use glam::DVec3;

/// Positions and velocities.
#[derive(Clone, Debug)]
pub(super) struct State {
    /// Positions at the start of the substep.
    pub x: Vec<DVec3>,
    /// Positions at its end, being solved for.
    pub p: Vec<DVec3>,
    /// Velocities.
    pub v: Vec<DVec3>,
    /// Inverse masses; 0 for vertices that are moved from outside.
    pub w: Vec<f64>,
    /// Number of cloth vertices.
    pub cloth: usize,
}

impl State {
    /// Positions that inertia leads to after `h` seconds.
    pub fn predict(&mut self, h: f64) {
        for i in 0..self.cloth {
            self.p[i] = self.x[i] + h * self.v[i];
        }
    }

    /// Takes the solved positions over; velocities are what the substep moved.
    pub fn finish(&mut self, h: f64) {
        for i in 0..self.cloth {
            self.v[i] = (self.p[i] - self.x[i]) / h;
        }
        std::mem::swap(&mut self.x, &mut self.p);
    }

    /// Keeps relative speeds within `limit` of the velocity `frame`.
    pub fn limit_speeds(&mut self, frame: DVec3, limit: f64) {
        for i in 0..self.cloth {
            let relative = self.v[i] - frame;
            if relative.length_squared() > limit * limit {
                self.v[i] = frame + relative.normalize() * limit;
            }
        }
    }
}

/// Position in metres of a point in scene units.
pub(super) fn metres(point: [f32; 3], scale: f64) -> DVec3 {
    DVec3::new(
        f64::from(point[0]),
        f64::from(point[1]),
        f64::from(point[2]),
    ) / scale
}

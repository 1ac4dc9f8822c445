//! Shear: warp and weft of every face resist leaving their right angle.
//!
//! The threads of a face run along the UV axes of its panel. With deformed
//! thread directions f_u, f_v (unit length at rest), the shear is C = f_u·f_v,
//! the energy ½ G A C². This adds to the shear stiffness that a lattice of
//! springs has by itself (3/8 of its membrane stiffness).

use drape_dataset::sequence::Garment;
use glam::{DVec2, DVec3};

use super::fabric::Fabric;
use super::order::by_rounds;
use super::state::State;

/// One face: f_u = Σ u[k] x_k, f_v = Σ v[k] x_k.
#[derive(Clone, Copy, Debug)]
struct Weave {
    corners: [u32; 3],
    u: [f64; 3],
    v: [f64; 3],
    stiffness: f64,
}

/// All faces of an outfit that have area.
#[derive(Clone, Debug)]
pub(super) struct Shear {
    weaves: Vec<Weave>,
}

impl Shear {
    pub fn new(garments: &[Garment], fabric: &Fabric) -> Self {
        let mut weaves = Vec::new();
        for (garment, piece) in garments.iter().zip(&fabric.garments) {
            for (local, number) in piece.faces.clone().enumerate() {
                let corners = fabric.faces[number];
                let [a, b, c] = corners.map(|v| fabric.rest[v as usize]);
                let area = fabric.area[number];
                let (e1, e2) = (b - a, c - a);
                let longest2 = e1
                    .length_squared()
                    .max(e2.length_squared())
                    .max((c - b).length_squared());
                // Needles have no usable frame.
                if area < 1e-3 * longest2 {
                    continue;
                }
                let x = e1.normalize();
                let y = e1.cross(e2).normalize().cross(x);
                let flat = [
                    DVec2::new(e1.length(), 0.0),
                    DVec2::new(e2.dot(x), e2.dot(y)),
                ];
                let warp = thread(garment, local, flat);
                let [u, v] = [warp, warp.perp()].map(|thread| weights(flat, thread));
                weaves.push(Weave {
                    corners,
                    u,
                    v,
                    stiffness: piece.cloth.shear * area,
                });
            }
        }
        let corners: Vec<[u32; 3]> = weaves.iter().map(|weave| weave.corners).collect();
        let order = by_rounds(fabric.rest.len(), &corners);
        let weaves = order.iter().map(|&number| weaves[number as usize]);
        Self {
            weaves: weaves.collect(),
        }
    }

    /// The one pass of a substep over all faces.
    pub fn solve(&self, state: &mut State, h: f64) {
        for weave in &self.weaves {
            let [a, b, c] = weave.corners;
            let corners = [a as usize, b as usize, c as usize];
            let at = |k: usize| state.p[corners[k]];
            let (error, gradient) = weave.shear([at(0), at(1), at(2)]);
            let share = |k: usize| state.w[corners[k]] * gradient[k].length_squared();
            let w = share(0) + share(1) + share(2);
            let s = weave.stiffness * h * h;
            let lambda = -s * error / (1.0 + s * w);
            for (k, &i) in corners.iter().enumerate() {
                state.p[i] += (state.w[i] * lambda) * gradient[k];
            }
        }
    }
}

impl Weave {
    /// Shear and its gradient.
    #[inline]
    fn shear(&self, x: [DVec3; 3]) -> (f64, [DVec3; 3]) {
        let sum = |k: &[f64; 3]| k[0] * x[0] + k[1] * x[1] + k[2] * x[2];
        let (fu, fv) = (sum(&self.u), sum(&self.v));
        let along = |k: usize| self.u[k] * fv + self.v[k] * fu;
        (fu.dot(fv), [along(0), along(1), along(2)])
    }
}

/// Direction of the warp in the face's own plane: that of growing U, or the first edge without UV.
fn thread(garment: &Garment, face: usize, [e1, e2]: [DVec2; 2]) -> DVec2 {
    let uv = garment.uv_faces.get(face).and_then(|corners| {
        let at = |k: usize| {
            garment
                .uv
                .get(corners[k] as usize)
                .map(|uv| f64::from(uv[0]))
        };
        Some([at(1)? - at(0)?, at(2)? - at(0)?])
    });
    let Some([u1, u2]) = uv else { return DVec2::X };
    // Gradient g of U: g·e1 = u1, g·e2 = u2.
    let determinant = e1.perp_dot(e2);
    let gradient = DVec2::new(u1 * e2.y - u2 * e1.y, u2 * e1.x - u1 * e2.x) / determinant;
    gradient
        .try_normalize()
        .filter(|g| g.is_finite())
        .unwrap_or(DVec2::X)
}

/// Weights w with Σ w[k] x_k = image of `thread` under the map from rest to deformed face.
fn weights([e1, e2]: [DVec2; 2], thread: DVec2) -> [f64; 3] {
    let determinant = e1.perp_dot(e2);
    let along1 = thread.perp_dot(e2) / determinant;
    let along2 = e1.perp_dot(thread) / determinant;
    [-along1 - along2, along1, along2]
}

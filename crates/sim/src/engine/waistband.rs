//! Waist bands: vertices bound to the body at the start follow it.
//!
//! Each bound vertex keeps its barycentric place and its offset in the frame
//! of the nearest body face, and moves with it from substep to substep.

use drape_geometry::closest::point_triangle;
use glam::{DMat3, DVec3};

use super::state::State;
use crate::error::SimError;

#[derive(Clone, Copy, Debug)]
struct Bound {
    vertex: u32,
    /// Body face, in the engine's numbering.
    corners: [u32; 3],
    place: [f64; 3],
    /// Offset in the face's frame.
    offset: DVec3,
}

/// All bound vertices of an outfit.
#[derive(Clone, Debug, Default)]
pub(super) struct Waistband {
    bound: Vec<Bound>,
}

impl Waistband {
    /// Binds `vertices` to the nearest faces at the present positions and takes their mass.
    pub fn bind(
        state: &mut State,
        vertices: &[u32],
        body_faces: &[[u32; 3]],
    ) -> Result<Self, SimError> {
        let mut bound = Vec::new();
        for &vertex in vertices {
            let point = state.x[vertex as usize];
            let mut best: Option<(f64, [u32; 3], [f64; 3])> = None;
            for &corners in body_faces {
                let triangle = corners.map(|v| state.x[v as usize].to_array());
                let on = point_triangle(point.to_array(), triangle);
                if best.is_none_or(|(distance2, ..)| on.distance2 < distance2) {
                    best = Some((on.distance2, corners, on.barycentric));
                }
            }
            let Some((_, corners, place)) = best else {
                return Err(SimError::value(
                    "body",
                    "faces for the waist band to be bound to",
                    "none",
                ));
            };
            let [a, b, c] = corners.map(|v| state.x[v as usize]);
            let at = place[0] * a + place[1] * b + place[2] * c;
            let offset = frame(a, b, c).transpose() * (point - at);
            state.w[vertex as usize] = 0.0;
            bound.push(Bound {
                vertex,
                corners,
                place,
                offset,
            });
        }
        Ok(Self { bound })
    }

    /// Moves the bound vertices to where the body is at the end of the substep of `h` seconds.
    pub fn follow(&self, state: &mut State, h: f64) {
        for bound in &self.bound {
            let [a, b, c] = bound.corners.map(|v| state.p[v as usize]);
            let at = bound.place[0] * a + bound.place[1] * b + bound.place[2] * c;
            let i = bound.vertex as usize;
            state.p[i] = at + frame(a, b, c) * bound.offset;
            state.v[i] = (state.p[i] - state.x[i]) / h;
        }
    }
}

/// Orthonormal frame of a triangle; the axes of a degenerate one are 0.
fn frame(a: DVec3, b: DVec3, c: DVec3) -> DMat3 {
    let x = (b - a).normalize_or_zero();
    let z = (b - a).cross(c - a).normalize_or_zero();
    DMat3::from_cols(x, z.cross(x), z)
}

//! Waist bands: vertices bound to the body's nearest triangle at the start,
//! with their offset in the triangle's frame, which turns with it.

use drape_geometry::closest::point_triangle;
use glam::{DMat3, DVec3};

use super::body::Body;
use super::state::Cloth;

#[derive(Clone, Copy, Debug)]
struct Binding {
    vertex: u32,
    face: u32,
    barycentric: [f64; 3],
    offset: DVec3,
}

/// All bound vertices of an outfit.
#[derive(Clone, Debug, Default)]
pub(super) struct Waistband {
    bindings: Vec<Binding>,
}

impl Waistband {
    /// Binds vertices (numbers in the whole cloth) and takes their mass away.
    pub fn bind(cloth: &mut Cloth, body: &Body, vertices: impl Iterator<Item = usize>) -> Self {
        let mut bindings = Vec::new();
        for vertex in vertices {
            let x = cloth.x[vertex].to_array();
            let nearest = (body.faces.iter().enumerate())
                .map(|(face, corners)| {
                    let corners = corners.map(|v| body.x[v as usize].to_array());
                    (face, point_triangle(x, corners))
                })
                .min_by(|(_, a), (_, b)| a.distance2.total_cmp(&b.distance2));
            let Some((face, nearest)) = nearest else {
                continue;
            };
            let (point, frame) = place(&body.x, &body.faces[face], nearest.barycentric);
            bindings.push(Binding {
                vertex: vertex as u32,
                face: face as u32,
                barycentric: nearest.barycentric,
                offset: frame.transpose() * (cloth.x[vertex] - point),
            });
            cloth.w[vertex] = 0.0;
        }
        Self { bindings }
    }

    pub fn is_empty(&self) -> bool {
        self.bindings.is_empty()
    }

    /// Puts bound vertices where the body is now, with the velocity that takes them there.
    pub fn follow(&self, cloth: &mut Cloth, body: &Body, dt: f64) {
        for binding in &self.bindings {
            let face = &body.faces[binding.face as usize];
            let (point, frame) = place(&body.x, face, binding.barycentric);
            let vertex = binding.vertex as usize;
            let target = point + frame * binding.offset;
            cloth.v[vertex] = (target - cloth.old[vertex]) / dt;
            cloth.x[vertex] = target;
        }
    }
}

/// Point of a triangle and the triangle's orthonormal frame.
fn place(x: &[DVec3], face: &[u32; 3], weights: [f64; 3]) -> (DVec3, DMat3) {
    let [a, b, c] = face.map(|v| x[v as usize]);
    let point = a * weights[0] + b * weights[1] + c * weights[2];
    let along = (b - a).normalize_or(DVec3::X);
    let normal = (b - a)
        .cross(c - a)
        .normalize_or(along.any_orthonormal_vector());
    (point, DMat3::from_cols(along, normal.cross(along), normal))
}

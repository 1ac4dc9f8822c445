//! Vertex normals with their backward pass, and the normal loss.
//!
//! Face normal `u = m/(|m| + 1e-7)`, `m = (c − b) × (a − b)`; vertex normal
//! `n = s/(|s| + 1e-7)`, s the sum of the incident unit face normals.
//! Faces whose m is shorter than 1e-12 pass no gradient: 1/1e-7 would explode.

use super::{Term, Vector, squared_error, zeros};

const EPSILON: f64 = 1e-7;
const DEGENERATE: f64 = 1e-12;

fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Gradient by `v` of `v/(|v| + ε)` against `g`; zero for a degenerate `v`.
fn through_normalisation(v: Vector, g: Vector) -> Vector {
    let length = dot(v, v).sqrt();
    if length < DEGENERATE {
        return [0.0; 3];
    }
    let soft = length + EPSILON;
    let along = dot(v, g) / (length * soft * soft);
    [0, 1, 2].map(|axis| g[axis] / soft - v[axis] * along)
}

fn normalised(v: Vector) -> Vector {
    let length = dot(v, v).sqrt() + EPSILON;
    v.map(|value| value / length)
}

/// What a mesh's normals are computed in; its memory serves the next mesh.
#[derive(Clone, Debug, Default)]
pub struct NormalRoom {
    crosses: Vec<Vector>,
    sums: Vec<Vector>,
    normals: Vec<Vector>,
}

/// A mesh's normals and what their backward pass needs.
pub struct MeshNormals<'a> {
    positions: &'a [Vector],
    faces: &'a [[u32; 3]],
    crosses: &'a [Vector],
    sums: &'a [Vector],
    /// Vertex normals.
    pub normals: &'a [Vector],
}

impl<'a> MeshNormals<'a> {
    /// Normals of a mesh.
    pub fn new(positions: &'a [Vector], faces: &'a [[u32; 3]], room: &'a mut NormalRoom) -> Self {
        let NormalRoom {
            crosses,
            sums,
            normals,
        } = room;
        zeros(sums, positions.len());
        crosses.clear();
        crosses.extend(faces.iter().map(|face| {
            let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
            let m = cross(sub(c, b), sub(a, b));
            let u = normalised(m);
            for vertex in face {
                for axis in 0..3 {
                    sums[*vertex as usize][axis] += u[axis];
                }
            }
            m
        }));
        normals.clear();
        normals.extend(sums.iter().map(|&sum| normalised(sum)));
        Self {
            positions,
            faces,
            crosses,
            sums,
            normals,
        }
    }

    /// Adds the gradient by position that belongs to `by_normal`, the gradient by vertex normal,
    /// which becomes the one by the sums of face normals.
    pub fn backward(&self, by_normal: &mut [Vector], gradient: &mut [Vector]) {
        for (&sum, g) in self.sums.iter().zip(&mut *by_normal) {
            *g = through_normalisation(sum, *g);
        }
        let by_sum = by_normal;
        for (face, &m) in self.faces.iter().zip(self.crosses) {
            let mut by_face = [0.0; 3];
            for &vertex in face {
                for axis in 0..3 {
                    by_face[axis] += by_sum[vertex as usize][axis];
                }
            }
            let by_cross = through_normalisation(m, by_face);
            let [a, b, c] = face.map(|vertex| self.positions[vertex as usize]);
            let by_c = cross(sub(a, b), by_cross);
            let by_a = cross(by_cross, sub(c, b));
            for axis in 0..3 {
                gradient[face[0] as usize][axis] += by_a[axis];
                gradient[face[2] as usize][axis] += by_c[axis];
                gradient[face[1] as usize][axis] -= by_a[axis] + by_c[axis];
            }
        }
    }
}

/// Mean squared difference of vertex normals, gradient by the predicted positions; `difference` is
/// room for the gradient by the normals.
pub fn normal_loss(
    predicted: &MeshNormals,
    reference: &MeshNormals,
    difference: &mut Term,
    term: &mut Term,
) {
    squared_error(predicted.normals, reference.normals, difference);
    term.clear(predicted.positions.len());
    term.value = difference.value;
    predicted.backward(&mut difference.gradient, &mut term.gradient);
}

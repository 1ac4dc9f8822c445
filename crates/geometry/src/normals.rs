//! Normals as LayersNet's published program computes them, in f32.
//!
//! Triangle (a, b, c): n = (c − b) × (a − b), then n / (|n| + 1e-7).
//! Vertex: sum of the unit face normals of its triangles in face order,
//! unweighted, then divided by its own length + 1e-7. A face without area and
//! a vertex without faces get the zero vector. Trap: 1e-7 is not small beside
//! a tiny triangle: below areas of about 1e-5 units² normals come out visibly
//! shorter than one. That is the published formula.

use crate::mesh::Incidence;
use crate::vector::{cross, dot, sub};

/// Added to lengths before dividing.
const EPSILON: f32 = 1e-7;

/// Unit normals of faces, `[face, 3]`.
pub fn face_normals(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<[f32; 3]> {
    faces
        .iter()
        .map(|face| face_normal(face.map(|v| positions[v as usize])))
        .collect()
}

/// Unit normals of vertices, `[vertex, 3]`.
pub fn vertex_normals(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut normals = Vec::new();
    vertex_normals_again(positions, faces, &mut normals);
    normals
}

/// [`vertex_normals`] into a buffer that is kept from call to call.
pub fn vertex_normals_again(
    positions: &[[f32; 3]],
    faces: &[[u32; 3]],
    normals: &mut Vec<[f32; 3]>,
) {
    normals.clear();
    normals.resize(positions.len(), [0.0; 3]);
    for face in faces {
        let normal = face_normal(face.map(|v| positions[v as usize]));
        for &vertex in face {
            add(&mut normals[vertex as usize], normal);
        }
    }
    for normal in normals {
        *normal = unit(*normal);
    }
}

/// [`vertex_normals_again`] for a mesh whose incidence is known: `by_face`
/// receives the face normals, `by_vertex` the vertex normals; the same bits.
///
/// # Panics
/// If `incidence` was made for another number of vertices.
pub fn vertex_normals_into(
    positions: &[[f32; 3]],
    faces: &[[u32; 3]],
    incidence: &Incidence,
    by_face: &mut Vec<[f32; 3]>,
    by_vertex: &mut Vec<[f32; 3]>,
) {
    assert_eq!(
        incidence.vertex_count(),
        positions.len(),
        "incidence of another mesh"
    );
    by_face.clear();
    by_face.extend(
        faces
            .iter()
            .map(|face| face_normal(face.map(|v| positions[v as usize]))),
    );
    by_vertex.clear();
    by_vertex.extend((0..positions.len()).map(|vertex| {
        let mut sum = [0.0f32; 3];
        for &face in incidence.faces_of(vertex) {
            add(&mut sum, by_face[face as usize]);
        }
        unit(sum)
    }));
}

/// Unit normal of one triangle.
#[inline]
pub fn face_normal([a, b, c]: [[f32; 3]; 3]) -> [f32; 3] {
    unit(cross(sub(c, b), sub(a, b)))
}

#[inline]
fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt() + EPSILON;
    v.map(|x| x / length)
}

#[inline]
fn add(sum: &mut [f32; 3], v: [f32; 3]) {
    for axis in 0..3 {
        sum[axis] += v[axis];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counter_clockwise_faces_point_at_the_viewer() {
        let normal = face_normal([[0., 0., 0.], [2., 0., 0.], [0., 2., 0.]]);
        assert_eq!(normal, [0.0, 0.0, 1.0]);
        assert_eq!(face_normal([[1., 1., 1.]; 3]), [0.0; 3]);
    }

    #[test]
    fn vertex_normals_weigh_faces_equally_whatever_their_area() {
        // A right-angled crease: a large face in z = 0 and a small one in y = 0.
        let positions = [
            [0., 0., 0.],
            [9., 0., 0.],
            [0., 9., 0.],
            [0., 0., 0.1],
            [5., 5., 5.],
        ];
        let faces = [[0, 1, 2], [0, 3, 1]];
        let normals = vertex_normals(&positions, &faces);
        let half = 0.5f32.sqrt();
        assert!((normals[0][1] - half).abs() < 1e-5 && (normals[0][2] - half).abs() < 1e-5);
        assert_eq!(normals[4], [0.0; 3]);
    }

    #[test]
    fn both_ways_of_summing_give_the_same_bits() {
        let positions: Vec<[f32; 3]> = (0..60)
            .map(|i| [7.3f32, 1.7, 4.1].map(|f| (i as f32 * f).sin()))
            .collect();
        let faces: Vec<[u32; 3]> = (0..200u32)
            .map(|i| [i * 7 % 60, (i * 11 + 1) % 60, (i * 13 + 2) % 60])
            .collect();
        let incidence = Incidence::new(60, &faces);
        let (mut by_face, mut by_vertex) = (Vec::new(), Vec::new());
        vertex_normals_into(&positions, &faces, &incidence, &mut by_face, &mut by_vertex);
        assert_eq!(by_face, face_normals(&positions, &faces));
        assert_eq!(by_vertex, vertex_normals(&positions, &faces));
    }
}

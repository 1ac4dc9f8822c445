//! Connectivity of triangle meshes and their validation.
//!
//! Edges are pairs of vertices in ascending order and lists of edges are
//! sorted, so that the same faces give the same list anywhere. The functions
//! other than [`validate`] and [`defects`] expect valid indices and panic on
//! others: validate at the border.

use crate::error::GeometryError;
use crate::vector::{cross64, dot64, sub64, to64};

/// A face counts as having no area when twice its area is at most this times
/// its longest edge squared: ten times what f32 rounding of the corners can do
/// to a triangle a thousandth of its coordinates in size is still below it.
const ZERO_AREA: f64 = 1e-6;

/// Unique edges, each `[low, high]`, sorted; `[edge, 2]`.
pub fn edges(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut edges = face_sides(faces);
    edges.dedup();
    edges
}

/// Edges with exactly one face, each `[low, high]`, sorted.
pub fn boundary_edges(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let sides = face_sides(faces);
    sides
        .chunk_by(|a, b| a == b)
        .filter(|same| same.len() == 1)
        .map(|same| same[0])
        .collect()
}

/// Whether each vertex lies on an edge with exactly one face; `[vertex]`.
pub fn on_border(vertex_count: usize, faces: &[[u32; 3]]) -> Vec<bool> {
    let mut on_border = vec![false; vertex_count];
    for vertex in boundary_edges(faces).into_iter().flatten() {
        on_border[vertex as usize] = true;
    }
    on_border
}

/// Component of each vertex, numbered from 0 in the order of lowest vertices; `[vertex]`.
/// A vertex without faces is a component of its own.
pub fn components(vertex_count: usize, faces: &[[u32; 3]]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..vertex_count as u32).collect();
    for face in faces {
        for pair in [[face[0], face[1]], [face[1], face[2]]] {
            let (a, b) = (root(&mut parent, pair[0]), root(&mut parent, pair[1]));
            // The lower vertex stays root, so a root is its component's lowest vertex.
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut number = vec![0; vertex_count];
    let mut next = 0;
    for vertex in 0..vertex_count as u32 {
        let lowest = root(&mut parent, vertex);
        if lowest == vertex {
            number[vertex as usize] = next;
            next += 1;
        } else {
            number[vertex as usize] = number[lowest as usize];
        }
    }
    number
}

/// Faces of each vertex, in ascending order, stored as one list with offsets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Incidence {
    offsets: Vec<u32>,
    faces: Vec<u32>,
}

impl Incidence {
    /// Collects the faces of `vertex_count` vertices.
    ///
    /// # Panics
    /// If a face refers to a vertex that does not exist.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Self {
        let mut offsets = vec![0u32; vertex_count + 1];
        for &corner in faces.as_flattened() {
            offsets[corner as usize + 1] += 1;
        }
        for vertex in 0..vertex_count {
            offsets[vertex + 1] += offsets[vertex];
        }
        let mut next = offsets.clone();
        let mut list = vec![0u32; faces.len() * 3];
        for (face, corners) in faces.iter().enumerate() {
            for &corner in corners {
                let slot = &mut next[corner as usize];
                list[*slot as usize] = face as u32;
                *slot += 1;
            }
        }
        Self {
            offsets,
            faces: list,
        }
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Faces of a vertex, ascending.
    pub fn faces_of(&self, vertex: usize) -> &[u32] {
        &self.faces[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }
}

/// Checks indices, coordinates, areas and edges.
///
/// # Errors
/// The first of [`defects`].
pub fn validate(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Result<(), GeometryError> {
    defects(positions, faces, 1).pop().map_or(Ok(()), Err)
}

/// Up to `limit` defects: indices out of range, coordinates that are not
/// finite, faces without area, edges of more than two faces, in this order.
/// Areas and edges are looked at only when all indices are in range.
pub fn defects(positions: &[[f32; 3]], faces: &[[u32; 3]], limit: usize) -> Vec<GeometryError> {
    let vertex_count = positions.len();
    let out_of_range = faces.iter().enumerate().flat_map(|(face, corners)| {
        corners
            .iter()
            .filter(move |&&vertex| vertex as usize >= vertex_count)
            .map(move |&vertex| GeometryError::IndexOutOfRange {
                face,
                vertex,
                vertex_count,
            })
    });
    let not_finite = positions
        .iter()
        .enumerate()
        .filter(|(_, position)| !position.iter().all(|x| x.is_finite()))
        .map(|(vertex, &position)| GeometryError::NotFinite { vertex, position });
    let mut found: Vec<_> = out_of_range.take(limit).collect();
    let indices_valid = found.is_empty();
    found.extend(not_finite.take(limit - found.len()));
    if indices_valid && found.len() < limit {
        let flat = faces
            .iter()
            .enumerate()
            .filter(|(_, corners)| has_zero_area(corners.map(|c| positions[c as usize])))
            .map(|(face, &corners)| GeometryError::ZeroArea { face, corners });
        found.extend(flat.take(limit - found.len()));
        let sides = face_sides(faces);
        let crowded = sides
            .chunk_by(|a, b| a == b)
            .filter(|same| same.len() > 2)
            .map(|same| GeometryError::NonManifoldEdge {
                edge: same[0],
                faces: same.len(),
            });
        found.extend(crowded.take(limit - found.len()));
    }
    found
}

/// The sides of all faces as `[low, high]`, sorted, an entry per face.
fn face_sides(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut sides: Vec<[u32; 2]> = faces
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .filter(|[a, b]| a != b)
        .collect();
    sides.sort_unstable();
    sides
}

fn has_zero_area(corners: [[f32; 3]; 3]) -> bool {
    let [a, b, c] = corners.map(to64);
    let (ab, bc, ca) = (sub64(b, a), sub64(c, b), sub64(a, c));
    let longest2 = dot64(ab, ab).max(dot64(bc, bc)).max(dot64(ca, ca));
    let normal = cross64(ab, bc);
    dot64(normal, normal).sqrt() <= ZERO_AREA * longest2
}

/// Root of a vertex's tree, halving the path on the way.
fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        parent[vertex as usize] = parent[parent[vertex as usize] as usize];
        vertex = parent[vertex as usize];
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
    const CORNERS: [[f32; 3]; 4] = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];

    #[test]
    fn a_closed_surface_has_eulers_edges_and_no_boundary() {
        assert_eq!(
            edges(&TETRAHEDRON),
            [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
        );
        assert!(boundary_edges(&TETRAHEDRON).is_empty());
        assert_eq!(boundary_edges(&TETRAHEDRON[..3]), [[0, 2], [0, 3], [2, 3]]);
        assert_eq!(validate(&CORNERS, &TETRAHEDRON), Ok(()));
    }

    #[test]
    fn incidence_lists_each_corner_once_in_face_order() {
        let incidence = Incidence::new(5, &TETRAHEDRON);
        assert_eq!(incidence.vertex_count(), 5);
        assert_eq!(incidence.faces_of(0), [0, 1, 3]);
        assert_eq!(incidence.faces_of(3), [1, 2, 3]);
        assert!(incidence.faces_of(4).is_empty());
    }

    #[test]
    fn components_are_numbered_by_their_lowest_vertex() {
        let faces = [[5, 1, 3], [2, 4, 6], [6, 7, 2]];
        assert_eq!(components(9, &faces), [0, 1, 2, 1, 2, 1, 2, 2, 3]);
    }

    #[test]
    fn each_defect_names_its_place() {
        use GeometryError::*;
        let out = validate(&CORNERS, &[[0, 1, 4]]);
        assert_eq!(
            out,
            Err(IndexOutOfRange {
                face: 0,
                vertex: 4,
                vertex_count: 4
            })
        );

        let mut broken = CORNERS;
        broken[2][1] = f32::INFINITY;
        assert!(matches!(
            validate(&broken, &TETRAHEDRON),
            Err(NotFinite { vertex: 2, .. })
        ));

        let repeated = validate(&CORNERS, &[[0, 1, 2], [3, 1, 1]]);
        assert_eq!(
            repeated,
            Err(ZeroArea {
                face: 1,
                corners: [3, 1, 1]
            })
        );
        let line = [[0.1, 0.1, 0.1], [0.2, 0.2, 0.2], [0.7, 0.7, 0.7]];
        assert!(matches!(
            validate(&line, &[[0, 1, 2]]),
            Err(ZeroArea { face: 0, .. })
        ));

        let third = [TETRAHEDRON.as_slice(), &[[0, 1, 2]]].concat();
        assert_eq!(
            validate(&CORNERS, &third),
            Err(NonManifoldEdge {
                edge: [0, 1],
                faces: 3
            })
        );
        assert_eq!(defects(&CORNERS, &third, 10).len(), 3);
    }
}

//! Edges that pass through triangles: the test, and counting its hits.
//!
//! The test is exact: it only looks at signs of Shewchuk's adaptive
//! `orient3d` (Adaptive precision floating-point arithmetic and fast robust
//! geometric predicates, 1997) on f32 points, so neither scale nor a distance
//! of one rounding step can change its answer.
//!
//! What counts, for edge (p, q) and triangle (a, b, c): p and q lie strictly on
//! different sides of the triangle's plane, and the line through them meets the
//! triangle including its border. Hence
//! - an edge that only touches the triangle with an end, or lies in its plane,
//!   does not count: resting on each other is not intersecting;
//! - an edge through the common side of two triangles counts for both, so no
//!   crossing slips between triangles; two edges that touch each other count;
//! - a triangle without area and points that are not finite never count.
//!
//! A hit is one pair (edge, triangle). Between two meshes both directions are
//! looked at; within a mesh a pair that shares a vertex is skipped.
//!
//! Limitation: two surfaces that overlap exactly in one plane, or cross exactly
//! at vertices that lie in the other's triangles, can have no hit.

use robust::{Coord3D, orient3d};

use crate::bvh::{Aabb, Bvh};
use crate::mesh::edges;

/// Which mesh's edge meets which mesh's triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Direction {
    /// An edge of the first mesh passes through a triangle of the second.
    FirstThroughSecond,
    /// An edge of the second mesh passes through a triangle of the first.
    SecondThroughFirst,
}

/// One edge that passes through one triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Hit {
    /// The edge's vertices, ascending.
    pub edge: [u32; 2],
    /// The triangle's number.
    pub face: u32,
}

/// Whether edge (p, q) passes through triangle (a, b, c), as the module defines it.
pub fn edge_passes_triangle([p, q]: [[f32; 3]; 2], [a, b, c]: [[f32; 3]; 3]) -> bool {
    let [p, q, a, b, c] = [p, q, a, b, c].map(coord);
    let side_p = orient3d(a, b, c, p);
    let side_q = orient3d(a, b, c, q);
    if !(side_p > 0.0 && side_q < 0.0 || side_p < 0.0 && side_q > 0.0) {
        return false;
    }
    let turns = [
        orient3d(p, q, a, b),
        orient3d(p, q, b, c),
        orient3d(p, q, c, a),
    ];
    turns.iter().all(|&t| t >= 0.0) || turns.iter().all(|&t| t <= 0.0)
}

/// Hits between two meshes, in both directions.
pub fn count_between(
    positions_a: &[[f32; 3]],
    faces_a: &[[u32; 3]],
    positions_b: &[[f32; 3]],
    faces_b: &[[u32; 3]],
) -> u32 {
    let mut count = 0;
    visit_between((positions_a, faces_a), (positions_b, faces_b), |_, _| {
        count += 1
    });
    count
}

/// Hits between two meshes, sorted.
pub fn hits_between(
    positions_a: &[[f32; 3]],
    faces_a: &[[u32; 3]],
    positions_b: &[[f32; 3]],
    faces_b: &[[u32; 3]],
) -> Vec<(Direction, Hit)> {
    let mut hits = Vec::new();
    visit_between(
        (positions_a, faces_a),
        (positions_b, faces_b),
        |direction, hit| {
            hits.push((direction, hit));
        },
    );
    hits.sort_unstable();
    hits
}

/// Hits within a mesh; pairs that share a vertex are skipped.
pub fn count_within(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> u32 {
    let mut count = 0;
    visit_within(positions, faces, |_| count += 1);
    count
}

/// Hits within a mesh, sorted; pairs that share a vertex are skipped.
pub fn hits_within(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<Hit> {
    let mut hits = Vec::new();
    visit_within(positions, faces, |hit| hits.push(hit));
    hits.sort_unstable();
    hits
}

type MeshRef<'a> = (&'a [[f32; 3]], &'a [[u32; 3]]);

fn visit_between(a: MeshRef, b: MeshRef, mut visit: impl FnMut(Direction, Hit)) {
    let (tree_a, tree_b) = (Bvh::of_faces(a.0, a.1), Bvh::of_faces(b.0, b.1));
    visit_edges(
        a,
        b,
        &tree_b,
        |_, _| true,
        |hit| visit(Direction::FirstThroughSecond, hit),
    );
    visit_edges(
        b,
        a,
        &tree_a,
        |_, _| true,
        |hit| visit(Direction::SecondThroughFirst, hit),
    );
}

fn visit_within(positions: &[[f32; 3]], faces: &[[u32; 3]], visit: impl FnMut(Hit)) {
    let mesh = (positions, faces);
    let disjoint = |edge: [u32; 2], face: [u32; 3]| !face.iter().any(|v| edge.contains(v));
    visit_edges(
        mesh,
        mesh,
        &Bvh::of_faces(positions, faces),
        disjoint,
        visit,
    );
}

/// Visits the hits of one mesh's edges on another's triangles.
fn visit_edges(
    (edge_positions, edge_faces): MeshRef,
    (positions, faces): MeshRef,
    tree: &Bvh,
    admissible: impl Fn([u32; 2], [u32; 3]) -> bool,
    mut visit: impl FnMut(Hit),
) {
    let bounds = tree.bounds();
    for edge in edges(edge_faces) {
        let ends = edge.map(|v| edge_positions[v as usize]);
        let aabb = Aabb::of(&ends);
        if !aabb.overlaps(&bounds) {
            continue;
        }
        tree.overlapping(&aabb, |face| {
            let corners = faces[face as usize];
            if admissible(edge, corners)
                && edge_passes_triangle(ends, corners.map(|v| positions[v as usize]))
            {
                visit(Hit { edge, face });
            }
        });
    }
}

fn coord(p: [f32; 3]) -> Coord3D<f64> {
    Coord3D {
        x: f64::from(p[0]),
        y: f64::from(p[1]),
        z: f64::from(p[2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [[f32; 3]; 3] = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];
    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

    /// Triangles with corners on a coarse lattice or anywhere, some sharing vertices.
    fn soup(seed: u64, count: usize, lattice: bool) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let mut state = seed;
        let mut next = move || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as u32
        };
        let positions = (0..count * 2)
            .map(|_| {
                std::array::from_fn(|_| {
                    if lattice {
                        (next() % 6) as f32
                    } else {
                        (next() % 100_003) as f32 * 5e-5
                    }
                })
            })
            .collect();
        let vertices = count as u32 * 2;
        let faces = (0..count)
            .map(|_| {
                let a = next() % vertices;
                let b = (a + 1 + next() % (vertices / 2 - 1)) % vertices;
                let c = (b + 1 + next() % (vertices / 2 - 1)) % vertices;
                [a, b, c]
            })
            .collect();
        (positions, faces)
    }

    fn brute(a: MeshRef, b: MeshRef, within: bool) -> Vec<Hit> {
        let mut hits = Vec::new();
        for edge in edges(a.1) {
            for (face, corners) in b.1.iter().enumerate() {
                let shares = within && corners.iter().any(|v| edge.contains(v));
                let ends = edge.map(|v| a.0[v as usize]);
                if !shares && edge_passes_triangle(ends, corners.map(|v| b.0[v as usize])) {
                    hits.push(Hit {
                        edge,
                        face: face as u32,
                    });
                }
            }
        }
        hits
    }

    #[test]
    fn hits_equal_testing_every_pair() {
        for lattice in [false, true] {
            let (pa, fa) = soup(1, 60, lattice);
            let (pb, fb) = soup(2, 90, lattice);
            let forth = brute((&pa, &fa), (&pb, &fb), false);
            let back = brute((&pb, &fb), (&pa, &fa), false);
            let found = hits_between(&pa, &fa, &pb, &fb);
            let expected: Vec<_> = forth
                .into_iter()
                .map(|hit| (Direction::FirstThroughSecond, hit))
                .chain(
                    back.into_iter()
                        .map(|hit| (Direction::SecondThroughFirst, hit)),
                )
                .collect();
            assert!(
                expected.len() > 100,
                "the soup should be tangled: {}",
                expected.len()
            );
            assert_eq!(found, expected);
            assert_eq!(count_between(&pa, &fa, &pb, &fb) as usize, expected.len());

            let within = brute((&pb, &fb), (&pb, &fb), true);
            assert!(!within.is_empty());
            assert_eq!(hits_within(&pb, &fb), within);
            assert_eq!(count_within(&pb, &fb) as usize, within.len());
        }
    }

    #[test]
    fn the_answer_is_the_same_for_every_order_of_corners_and_ends() {
        let (positions, _) = soup(5, 400, true);
        for points in positions.chunks_exact(5) {
            let [p, q, a, b, c] = points.try_into().unwrap();
            let answer = edge_passes_triangle([p, q], [a, b, c]);
            for corners in [[a, c, b], [b, c, a], [c, b, a]] {
                assert_eq!(edge_passes_triangle([q, p], corners), answer, "{points:?}");
            }
        }
    }

    #[test]
    fn touching_with_an_end_or_lying_in_the_plane_does_not_count() {
        let tiny = f32::MIN_POSITIVE;
        let above = [0.25, 0.25, 1.0];
        assert!(!edge_passes_triangle([above, [0.25, 0.25, tiny]], TRIANGLE));
        assert!(!edge_passes_triangle([above, [0.25, 0.25, 0.0]], TRIANGLE));
        assert!(edge_passes_triangle([above, [0.25, 0.25, -tiny]], TRIANGLE));
        assert!(!edge_passes_triangle(
            [[-1.0, 0.2, 0.0], [1.0, 0.2, 0.0]],
            TRIANGLE
        ));
    }

    #[test]
    fn the_border_belongs_to_the_triangle() {
        let through = |x: f32| [[x, 0.5, 1.0], [x, 0.5, -1.0]];
        assert!(edge_passes_triangle(through(0.0), TRIANGLE));
        assert!(edge_passes_triangle(through(0.5), TRIANGLE));
        assert!(!edge_passes_triangle(through(-f32::MIN_POSITIVE), TRIANGLE));
        assert!(!edge_passes_triangle(through(0.5f32.next_up()), TRIANGLE));
        assert!(edge_passes_triangle(
            [[0., 0., 1.], [0., 0., -1.]],
            TRIANGLE
        ));
    }

    #[test]
    fn faces_without_area_and_points_that_are_not_finite_never_count() {
        let line = [[0., 0., 0.], [1., 0., 0.], [2., 0., 0.]];
        assert!(!edge_passes_triangle([[0.5, 0., 1.], [0.5, 0., -1.]], line));
        assert!(!edge_passes_triangle(
            [[0.2, 0.2, f32::NAN], [0.2, 0.2, -1.]],
            TRIANGLE
        ));
        let mut broken = TRIANGLE.to_vec();
        broken[1][0] = f32::NAN;
        let edge = [[0.2, 0.2, 1.], [0.2, 0.2, -1.], [0.3, 0.3, -1.]];
        assert_eq!(count_between(&edge, &[[0, 1, 2]], &broken, &[[0, 1, 2]]), 0);
    }

    #[test]
    fn tetrahedra_slid_through_each_other_meet_exactly_between_the_touching_places() {
        // A tip that points up at z = tip, slid through a tetrahedron between z = 0 and z = 1.
        let fixed = [[-2., -2., 0.], [3., -2., 0.], [-2., 3., 0.], [0., 0., 1.]];
        let at = |tip: f32| -> Vec<[f32; 3]> {
            let base = [
                [-0.03f32, -0.02, -0.125],
                [0.04, -0.02, -0.125],
                [-0.01, 0.04, -0.125],
            ];
            base.iter()
                .chain(&[[0.0, 0.0, 0.0]])
                .map(|p| [p[0], p[1], p[2] + tip])
                .collect()
        };
        let hits = |tip: f32| count_between(&at(tip), &TETRAHEDRON, &fixed, &TETRAHEDRON);
        let below = -f32::MIN_POSITIVE;
        assert_eq!([hits(-0.5), hits(below), hits(0.0)], [0, 0, 0]);
        // The three edges at the tip pass the base plane.
        assert_eq!([hits(f32::MIN_POSITIVE), hits(0.0625)], [3, 3]);
        // Completely inside: surfaces do not cross, whatever the depth.
        assert_eq!(hits(0.25), 0);
        // The tip leaves at the other tip, which then stands in the small one.
        assert_eq!(hits(1.0f32.next_down()), 0);
        assert!(hits(1.0 + 0.0625) > 0);
        // Sideways, until nothing overlaps.
        assert_eq!(hits(5.0), 0);
    }
}

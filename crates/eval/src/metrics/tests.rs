//! Hand-made cases of a few vertices, each threshold with both neighbours.

use super::*;
use crate::example::{header, tube};

/// A triangle in the plane z = 0, seen from above.
const FLOOR: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]];

fn scene(garments: &[(GarmentKind, u32)]) -> SequenceHeader {
    let mut header = header(garments);
    header.body.faces = vec![[0, 1, 2]];
    header
}

/// H-collisions of points over [`FLOOR`].
fn inside_floor(points: &[[f32; 3]]) -> usize {
    let points = vec![points.to_vec()];
    score_frame(&scene(&[(GarmentKind::Skirt, 0)]), &points, &points, &FLOOR).garments[0]
        .inside_body
}

#[test]
fn errors_are_means_of_distances_in_real_metres() {
    let reference = vec![vec![[0.0; 3], [1.0, 0.0, 0.0]]];
    let predicted = vec![vec![[3.0, 0.0, 4.0], [1.0, 0.0, 0.0]]];
    let mut header = scene(&[(GarmentKind::Skirt, 0)]);
    // Distances 5 and 0 units, mean 2.5; at scale 10 a unit is 0.1 m.
    assert_eq!(
        score_frame(&header, &predicted, &reference, &FLOOR).garments[0].error_m,
        0.25
    );
    header.scene.scale = 1.0;
    assert_eq!(
        score_frame(&header, &predicted, &reference, &FLOOR).garments[0].error_m,
        2.5
    );
}

#[test]
fn a_vertex_counts_below_the_plane_and_not_on_or_above_it() {
    let least = f32::from_bits(1);
    assert_eq!(inside_floor(&[[0.5, 0.5, least]]), 0);
    assert_eq!(inside_floor(&[[0.5, 0.5, 0.0]]), 0);
    assert_eq!(inside_floor(&[[0.5, 0.5, -least]]), 1);
    assert_eq!(inside_floor(&[[0.0, 0.0, 0.0]]), 0, "on a vertex");
}

#[test]
fn a_vertex_counts_up_to_half_a_metre_real_and_not_beyond() {
    assert_eq!(inside_floor(&[[0.0, 0.0, -4.999]]), 1);
    assert_eq!(inside_floor(&[[0.0, 0.0, -5.0]]), 1);
    assert_eq!(inside_floor(&[[0.0, 0.0, -5.0_f32.next_up()]]), 0);
    assert_eq!(inside_floor(&[[0.0, 0.0, -5.001]]), 0);
}

#[test]
fn the_reach_is_a_real_length_at_every_scale() {
    let mut header = scene(&[(GarmentKind::Skirt, 0)]);
    header.scene.scale = 1.0;
    for (depth, expected) in [(0.4999, 1), (0.5, 1), (0.5001, 0)] {
        let points = vec![vec![[0.0, 0.0, -depth]]];
        assert_eq!(
            score_frame(&header, &points, &points, &FLOOR).garments[0].inside_body,
            expected,
            "depth {depth}"
        );
    }
}

#[test]
fn outer_garments_are_measured_against_all_lower_layers_as_predicted() {
    let mut header = scene(&[
        (GarmentKind::Pants, 0),
        (GarmentKind::TShirt, 0),
        (GarmentKind::Dress, 1),
        (GarmentKind::Jacket, 2),
    ]);
    for garment in &mut header.garments {
        garment.faces = vec![[0, 1, 2]];
    }
    let at = |x: f32, z: f32| FLOOR.map(|p| [p[0] + x, p[1], p[2] + z]).to_vec();
    // The jacket's vertices: two just below the dress, one above the T-shirt (which lies apart).
    let jacket = vec![[0.0, 0.0, 0.9], [3.0, 0.0, 0.9], [20.0, 0.0, 0.6]];
    let predicted = vec![at(0.0, 0.0), at(20.0, 0.5), at(0.0, 1.0), jacket];
    let score = score_frame(&header, &predicted, &predicted, &at(0.0, -3.0));
    let inside: Vec<_> = score
        .garments
        .iter()
        .map(|garment| garment.inside_inner)
        .collect();
    assert_eq!(inside, [None, None, None, Some(2)]);
}

#[test]
fn garments_of_one_layer_have_no_layer_collision() {
    let mut header = scene(&[(GarmentKind::TShirt, 0), (GarmentKind::Pants, 0)]);
    header
        .garments
        .iter_mut()
        .for_each(|garment| garment.faces = vec![[0, 1, 2]]);
    let positions = vec![FLOOR.to_vec(); 2];
    let score = score_frame(&header, &positions, &positions, &FLOOR);
    assert!(
        score
            .garments
            .iter()
            .all(|garment| garment.inside_inner.is_none())
    );
}

#[test]
fn normals_weigh_faces_alike_and_faces_without_area_do_not_count() {
    let points = [
        [0.0; 3],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 100.0],
    ];
    // Towards +Z, and a face a hundred times larger towards +X: not weighted by area.
    let normals = vertex_normals(&points, &[[0, 1, 2], [0, 2, 3], [0, 0, 1]]);
    let half = 0.5_f64.sqrt();
    assert!(
        length(sub(normals[0], [half, 0.0, half])) < 1e-15,
        "{:?}",
        normals[0]
    );
    assert_eq!(vertex_normals(&points, &[[0, 0, 1]]), [[0.0; 3]; 4]);
}

#[test]
fn a_smaller_tube_is_inside_and_a_larger_one_outside() {
    let (body, faces) = tube(1.0, 24, 6);
    let obstacle = Obstacle::new(&to_f64(&body), &faces);
    for (radius, expected) in [(0.9, 24 * 6), (1.1, 0)] {
        assert_eq!(
            obstacle.count_inside(&to_f64(&tube(radius, 24, 6).0), 5.0),
            expected,
            "radius {radius}"
        );
    }
}

#[test]
fn a_frame_without_a_body_has_no_body_collision() {
    let mut header = header(&[(GarmentKind::Skirt, 0)]);
    header.body.faces.clear();
    let points = vec![vec![[0.0; 3]]];
    assert_eq!(
        score_frame(&header, &points, &points, &[]).garments[0].inside_body,
        0
    );
}

//! What counts as a hit: δ, the reach, borders, the divisor; each threshold with
//! its two neighbours.

use drape_dataset::sample::StatePair;
use drape_geometry::mesh::on_border;
use drape_train::losses::collision::{
    CollisionConfig, CollisionMean, CollisionRoom, body_collision,
};
use drape_train::losses::{LossConfig, Term, Vector};

use crate::{body, sheet, sheet_faces, term};

/// Collisions with a sheet of 3 × 3 vertices.
fn collision(config: &CollisionConfig, tested: &[Vector], sheet: &[StatePair]) -> Term {
    let faces = sheet_faces(3, 0);
    let (border, mut room) = (on_border(9, &faces), CollisionRoom::default());
    term(|term| body_collision(config, tested, sheet, &faces, &border, &mut room, term))
}

/// Value of one vertex above or below the middle of a flat sheet of spacing 4.
fn value(config: &CollisionConfig, vertex: Vector) -> f64 {
    let flat = body(&sheet(3, 4.0, |_, _| 0.0));
    collision(config, &[vertex], &flat).value
}

#[test]
fn nearer_than_delta_is_a_hit() {
    // 0.25 is exact in binary, so the threshold itself can be tested.
    let config = CollisionConfig {
        threshold: 0.25,
        ..CollisionConfig::default()
    };
    assert!(value(&config, [0.0, 0.0, 0.2499]) > 0.0);
    assert_eq!(value(&config, [0.0, 0.0, 0.2501]), 0.0);
    // The normal is 1 − 1e-7 long (its epsilon), so at δ itself s is −2.5e-8: next to nothing.
    assert!(value(&config, [0.0, 0.0, 0.25]) < 1e-14);
}

#[test]
fn beyond_the_reach_nothing_counts_by_default() {
    let config = CollisionConfig::default();
    assert_eq!(config.reach, Some(1.0));
    let inside = value(&config, [0.0, 0.0, -0.999]);
    assert!(
        (inside - 1.0f64.powi(2)).abs() < 1e-4,
        "s = −0.999 − 0.001, squared: {inside}"
    );
    assert_eq!(
        value(&config, [0.0, 0.0, -1.0]),
        0.0,
        "the reach itself is out"
    );
    assert_eq!(value(&config, [0.0, 0.0, -1.001]), 0.0);
    let released = LossConfig::released().collision;
    let far = value(&released, [0.0, 0.0, -50.0]);
    assert!(
        (far - 50.001f64.powi(2)).abs() < 0.01,
        "the released loss has no reach: {far}"
    );
}

#[test]
fn a_nearest_vertex_on_a_border_is_skipped_by_default() {
    let below_corner = [4.5, 4.5, -0.5];
    assert_eq!(value(&CollisionConfig::default(), below_corner), 0.0);
    let all = CollisionConfig {
        skip_borders: false,
        ..CollisionConfig::default()
    };
    assert!((value(&all, below_corner) - 0.501f64.powi(2)).abs() < 1e-5);
}

#[test]
fn the_divisor_is_the_vertices_by_default_and_the_hits_as_released() {
    let flat = body(&sheet(3, 4.0, |_, _| 0.0));
    let tested: Vec<Vector> = vec![
        [0.0, 0.0, -0.5],
        [0.1, 0.0, 0.5],
        [0.0, 0.2, 0.7],
        [0.2, 0.2, 0.9],
    ];
    let of = |mean| {
        let config = CollisionConfig {
            mean,
            ..CollisionConfig::default()
        };
        collision(&config, &tested, &flat).value
    };
    let (vertices, hits) = (of(CollisionMean::Vertices), of(CollisionMean::Hits));
    assert!(
        (hits / vertices - 4.0).abs() < 1e-5,
        "one hit of four vertices: {hits}, {vertices}"
    );
    assert!((hits - 0.501f64.powi(2)).abs() < 1e-6);
}

#[test]
fn without_hits_value_and_gradient_are_zero() {
    let flat = body(&sheet(3, 4.0, |_, _| 0.0));
    for config in [
        LossConfig::default().collision,
        LossConfig::released().collision,
    ] {
        let term = collision(&config, &[[0.0, 0.0, 0.5]; 3], &flat);
        assert_eq!(term.value, 0.0);
        assert_eq!(term.gradient, [[0.0; 3]; 3]);
    }
}

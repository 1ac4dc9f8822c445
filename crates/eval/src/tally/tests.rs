//! Aggregation on numbers that can be checked by hand.

use super::*;

fn garment(
    kind: GarmentKind,
    vertices: usize,
    error_m: f64,
    body: usize,
    inner: Option<usize>,
) -> GarmentScore {
    GarmentScore {
        kind,
        vertices,
        error_m,
        inside_body: body,
        inside_inner: inner,
    }
}

#[test]
fn the_deviation_is_that_of_the_population() {
    let statistic = Statistic::of(&[1.0, 3.0]).unwrap();
    assert_eq!(
        (statistic.mean, statistic.std, statistic.frames),
        (2.0, 1.0, 2)
    );
    assert_eq!(statistic.scaled(10.0).std, 10.0);
    assert_eq!(Statistic::of(&[]), None);
}

#[test]
fn frames_are_weighted_by_vertices_and_kinds_are_not() {
    let mut tally = Tally::default();
    tally.add(&FrameScore {
        garments: vec![
            garment(GarmentKind::Pants, 30, 0.1, 3, None),
            garment(GarmentKind::Skirt, 10, 0.5, 0, Some(5)),
        ],
    });
    let summary = tally.summary();
    assert!((summary.overall.error_m.unwrap().mean - 0.2).abs() < 1e-15);
    assert_eq!(summary.overall.h_collision.unwrap().mean, 3.0 / 40.0);
    assert_eq!(
        summary.overall.l_collision.unwrap().mean,
        5.0 / 40.0,
        "the paper divides by all vertices"
    );
    assert_eq!(summary.l_collision_of_outer.unwrap().mean, 0.5);
    assert_eq!(
        summary.kinds[&GarmentKind::Skirt].l_collision.unwrap().mean,
        0.5
    );
    assert_eq!(
        summary.kinds[&GarmentKind::Pants].h_collision.unwrap().mean,
        0.1
    );
    assert_eq!(summary.kinds[&GarmentKind::Pants].l_collision, None);
}

#[test]
fn two_garments_of_a_kind_are_averaged_and_absent_kinds_do_not_count() {
    let mut tally = Tally::default();
    tally.add(&FrameScore {
        garments: vec![
            garment(GarmentKind::Skirt, 10, 0.1, 0, None),
            garment(GarmentKind::Skirt, 90, 0.3, 0, Some(0)),
        ],
    });
    tally.add(&FrameScore {
        garments: vec![garment(GarmentKind::Dress, 10, 1.0, 0, None)],
    });
    let summary = tally.summary();
    let skirt = summary.kinds[&GarmentKind::Skirt].error_m.unwrap();
    assert!((skirt.mean - 0.2).abs() < 1e-15);
    assert_eq!(skirt.frames, 1);
    assert_eq!(summary.overall.error_m.unwrap().frames, 2);
    assert_eq!(
        summary.overall.l_collision.unwrap().frames,
        1,
        "one layer: no layer collision"
    );
}

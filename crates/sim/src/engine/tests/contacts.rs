//! Contacts: clean stays clean, what is inside comes out, what rests is still.

use drape_geometry::intersect::{count_between, count_within};

use super::*;

pub(super) fn hits(
    engine: &Engine,
    garments: &[Garment],
    body: &[[f32; 3]],
    faces: &[[u32; 3]],
) -> u32 {
    let positions = engine.garments();
    let mut hits = 0;
    for (i, x) in positions.iter().enumerate() {
        hits +=
            count_within(x, &garments[i].faces) + count_between(x, &garments[i].faces, body, faces);
        for (j, other) in positions.iter().enumerate().skip(i + 1) {
            hits += count_between(x, &garments[i].faces, other, &garments[j].faces);
        }
    }
    hits
}

#[test]
fn layers_on_a_fast_ball_in_a_gale_never_cross() {
    let body = Body::ball([0.0; 3], 2.0);
    let garments = [
        sheet(17, 19, 0.25, 0, |x, y| [x - 2.0, y - 2.0, 2.08]),
        sheet(17, 19, 0.25, 1, |x, y| [x - 2.1, y - 1.9, 2.2]),
    ];
    let effects = [&USUAL[..], &[Effect::Wind]].concat();
    let mut engine = engine(&garments, &body, &effects);
    for frame in 0..30 {
        // Up to 3 m/s, reversing twice a second.
        let t = FRAME_S as f32 * frame as f32;
        let at = body.moved([2.4 * (12.5 * t).sin(), 1.2 * (1.0 - (6.0 * t).cos()), 0.0]);
        let gale = if frame % 12 < 6 {
            wind(400.0)
        } else {
            wind(0.0)
        };
        let report = engine.advance(&at, gale, FRAME_S).unwrap();
        assert_eq!(report.uncertified, 0, "frame {frame}");
        assert_eq!(
            hits(&engine, &garments, &at, &body.faces),
            0,
            "frame {frame}"
        );
    }
}

#[test]
fn cloth_inside_the_body_comes_out_and_stays_out() {
    let body = Body::ball([0.0; 3], 2.0);
    let garment = sheet(7, 7, 0.25, 0, |x, y| {
        let (x, y) = (x - 0.75, y - 0.65);
        // 8 mm under the surface.
        [x, y, (1.92_f32.powi(2) - x * x - y * y).sqrt()]
    });
    let mut engine = engine(std::slice::from_ref(&garment), &body, &USUAL);
    let mut inside = usize::MAX;
    for _ in 0..20 {
        inside = engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap()
            .inside_body;
    }
    assert_eq!(inside, 0);
    assert_eq!(hits(&engine, &[garment], &body.positions, &body.faces), 0);
}

#[test]
fn layers_that_cross_at_the_start_are_untangled() {
    let body = Body::ball([0.0; 3], 2.0);
    let dome = |radius: f32, slope: f32| {
        move |x: f32, y: f32| {
            let (x, y) = (x - 0.75, y - 0.65);
            [x, y, (radius * radius - x * x - y * y).sqrt() + slope * x]
        }
    };
    // On one side the outer layer dips 3 mm under the inner one, as a bad fit might have it.
    let garments = [
        sheet(7, 7, 0.25, 0, dome(2.08, 0.0)),
        sheet(7, 7, 0.25, 1, dome(2.10, 0.067)),
    ];
    let mut engine = engine(&garments, &body, &USUAL);
    assert!(hits(&engine, &garments, &body.positions, &body.faces) > 0);
    for _ in 0..20 {
        engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap();
    }
    assert_eq!(hits(&engine, &garments, &body.positions, &body.faces), 0);
    let radius = |x: &[[f32; 3]]| {
        let length = |p: &[f32; 3]| p.iter().map(|c| c * c).sum::<f32>().sqrt();
        x.iter().map(length).sum::<f32>() / x.len() as f32
    };
    let positions = engine.garments();
    assert!(
        radius(&positions[1]) > radius(&positions[0]),
        "the outer layer is not outside"
    );
}

#[test]
fn layers_at_rest_are_still() {
    let body = Body::ball([0.0; 3], 2.0);
    let garments = [
        sheet(9, 9, 0.25, 0, |x, y| [x - 1.0, y - 0.9, 2.08]),
        sheet(9, 9, 0.25, 1, |x, y| [x - 1.05, y - 0.95, 2.15]),
    ];
    let mut engine = engine(&garments, &body, &USUAL);
    let mut frames = Vec::new();
    for _ in 0..75 {
        engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap();
        frames.push(engine.garments().concat());
    }
    // Root mean square of the second differences of the last second, mm at real size:
    // the accelerations that a network learns from would drown in jitter of 1 mm.
    let mut sum = 0.0_f64;
    let mut count = 0.0;
    for triple in frames[45..].windows(3) {
        for ((a, b), c) in triple[0].iter().zip(&triple[1]).zip(&triple[2]) {
            sum += (0..3)
                .map(|k| f64::from(a[k] - 2.0 * b[k] + c[k]).powi(2))
                .sum::<f64>();
            count += 1.0;
        }
    }
    let jitter_mm = 100.0 * (sum / count).sqrt();
    assert!(jitter_mm < 0.2, "{jitter_mm} mm");
}

#[test]
fn layers_part_while_the_engine_warms_up_and_stay_where_they_are_after_it() {
    let garments = [0, 1].map(|layer| {
        let z = 0.04 * layer as f32;
        sheet(9, 9, 0.25, layer, move |x, y| [x, y, z])
    });
    let far = Body::ball([0.0, 0.0, -50.0], 2.0);
    let effects = [Effect::LayerContact, Effect::Stretch];
    let gap_mm = |shares: &[f64]| {
        let mut engine = engine(&garments, &far, &effects);
        for &share in shares {
            engine.warm_up(share);
            engine
                .advance(&far.positions, Wind::default(), FRAME_S)
                .unwrap();
        }
        let [lower, upper] = [0, 1].map(|layer| engine.garments()[layer].clone());
        let gaps = lower.iter().zip(&upper).map(|(a, b)| 100.0 * (b[2] - a[2]));
        gaps.fold(f32::INFINITY, f32::min)
    };
    // 4 mm at the start; 3 mm is the distance between layers, twice that while warming up.
    assert!((gap_mm(&[0.0; 6]) - 4.0).abs() < 1e-3);
    assert!((gap_mm(&[1.0; 6]) - 6.0).abs() < 0.1);
    let half = gap_mm(&[0.5; 6]);
    assert!((half - 4.5).abs() < 0.1, "{half} mm");
    assert!((gap_mm(&[1.0, 1.0, 0.5, 0.0, 0.0]) - 6.0).abs() < 0.2);
}

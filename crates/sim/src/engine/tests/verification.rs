//! Cloth that hangs, swings and is left alone, against closed forms.

use glam::DVec3;

use super::*;

/// An engine with pins: the garment's `bands` follow the body's triangles.
pub(super) fn pinned(
    garment: &Garment,
    band: Vec<u32>,
    body: &Body,
    effects: &[Effect],
    settings: &EngineSettings,
) -> Engine {
    let garments = std::slice::from_ref(garment);
    let scene = physics(effects);
    Engine::new(
        garments,
        &[band],
        &body.faces,
        &body.positions,
        &scene,
        settings,
    )
    .unwrap()
}

/// A triangle that hangs from two of its corners, 10 units (1 m) long, turned by `angle` around them.
fn pendulum(angle: f32, substeps: u32) -> (Engine, Body) {
    let (sin, cos) = angle.sin_cos();
    let mut garment = sheet(2, 2, 1.0, 0, |_, _| [0.0; 3]);
    garment.rest = vec![
        [-3.0, 0.0, 0.0],
        [3.0, 0.0, 0.0],
        [0.0, 10.0 * sin, -10.0 * cos],
    ];
    garment.uv = vec![[0.0, 0.0], [0.6, 0.0], [0.3, 1.0]];
    garment.faces = vec![[0, 1, 2]];
    garment.uv_faces = garment.faces.clone();
    garment.panel_of_face = vec![0];
    garment.material.tension = 1000.0;
    garment.material.compression = 1000.0;
    let body = Body {
        positions: vec![[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 3.0]],
        faces: vec![[0, 1, 2]],
    };
    let settings = EngineSettings {
        substeps,
        ..EngineSettings::default()
    };
    let effects = [Effect::Gravity, Effect::Stretch, Effect::Waistband];
    (
        pinned(&garment, vec![0, 1], &body, &effects, &settings),
        body,
    )
}

/// Sideways place of the pendulum's free corner after each frame, m.
fn swing(angle: f32, substeps: u32, frames: usize) -> Vec<f64> {
    let (mut engine, body) = pendulum(angle, substeps);
    let mut frame = || {
        engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap();
        engine.state.x[2].y
    };
    (0..frames).map(|_| frame()).collect()
}

#[test]
fn a_pendulum_keeps_its_period() {
    let angle = 0.2_f32;
    let places = swing(angle, 15, 200);
    // Times at which it passes the lowest point, between frames by proportion.
    let passes: Vec<f64> = places
        .windows(2)
        .enumerate()
        .filter(|(_, two)| two[0] * two[1] < 0.0)
        .map(|(frame, two)| FRAME_S * (frame as f64 + 1.0 + two[0] / (two[0] - two[1])))
        .collect();
    assert!(passes.len() >= 5, "{passes:?}");
    let half_periods = (passes.len() - 1) as f64;
    let period = 2.0 * (passes[passes.len() - 1] - passes[0]) / half_periods;
    let small = std::f64::consts::TAU * (1.0_f64 / 9.81).sqrt();
    let expected = small * (1.0 + f64::from(angle).powi(2) / 16.0);
    let ratio = period / expected;
    assert!((ratio - 1.0).abs() < 5e-3, "{ratio} of the closed form");
}

#[test]
fn errors_halve_as_substeps_double() {
    // The symplectic step is of first order.
    let place = |substeps: u32| swing(0.2, substeps, 24)[23];
    let places = [5, 10, 20, 40].map(place);
    let steps: Vec<f64> = places
        .windows(2)
        .map(|two| (two[1] - two[0]).abs())
        .collect();
    for two in steps.windows(2) {
        let order = (two[0] / two[1]).log2();
        assert!(
            (0.7..2.5).contains(&order),
            "order {order}, differences {steps:?}"
        );
    }
}

#[test]
fn a_strip_between_two_points_hangs_as_a_catenary() {
    let columns = 33;
    let mut strip = sheet(columns, 3, 0.25, 0, |x, y| [x, y, 0.0]);
    strip.material.tension = 500.0;
    strip.material.compression = 500.0;
    // Every row ends in a pinned vertex; rows are staggered, so the middle one ends half an edge later.
    let ends: Vec<u32> = (0..3)
        .flat_map(|row| [row * columns, (row + 1) * columns - 1])
        .collect();
    let length = 0.25 * (columns - 1) as f32;
    let pin = |x: f32, up: f32| [[x, -1.0, up], [x, 2.0, up], [x, 0.0, up + 1.0]];
    let body = Body {
        positions: [pin(0.0, 0.0), pin(length, 0.0)].concat(),
        faces: vec![[0, 1, 2], [3, 4, 5]],
    };
    let effects = [
        Effect::Gravity,
        Effect::AirDrag,
        Effect::Stretch,
        Effect::Waistband,
    ];
    let settings = EngineSettings::default();
    let mut engine = pinned(&strip, ends, &body, &effects, &settings);
    // Both ends come together by a tenth of the length each, then wait.
    let closer = 0.1 * length;
    for frame in 1..=240 {
        let by = closer * (frame as f32 / 60.0).min(1.0);
        let mut at = body.positions.clone();
        for p in &mut at[..3] {
            p[0] += by;
        }
        for p in &mut at[3..] {
            p[0] -= by;
        }
        engine.advance(&at, Wind::default(), FRAME_S).unwrap();
    }
    // Length s and span d: s = 2a sinh(d / 2a), the sag is a (cosh(d / 2a) − 1).
    let (s, d) = (f64::from(length), f64::from(length - 2.0 * closer));
    let (mut low, mut high) = (0.1 * d, 100.0 * d);
    for _ in 0..200 {
        let a = 0.5 * (low + high);
        // A larger a hangs flatter and is shorter.
        if 2.0 * a * (d / (2.0 * a)).sinh() > s {
            low = a;
        } else {
            high = a;
        }
    }
    let sag = low * ((d / (2.0 * low)).cosh() - 1.0);
    let positions = &engine.garments()[0];
    let lowest = positions.iter().map(|p| p[2]).fold(f32::MAX, f32::min);
    let ratio = f64::from(-lowest) / sag;
    assert!((ratio - 1.0).abs() < 0.03, "sag {ratio} of the catenary's");
}

#[test]
fn a_sheet_let_go_never_has_more_energy_than_it_began_with() {
    let garment = sheet(9, 9, 0.25, 0, |x, y| [x, y, 0.0]);
    let body = Body {
        positions: vec![[-1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 0.0, 2.0]],
        faces: vec![[0, 1, 2]],
    };
    let effects = [
        Effect::Gravity,
        Effect::Stretch,
        Effect::Shear,
        Effect::Bending,
        Effect::SelfContact,
        Effect::Friction,
        Effect::Waistband,
    ];
    let settings = EngineSettings::default();
    let mut engine = pinned(&garment, (0..9).collect(), &body, &effects, &settings);
    // Motion and height; what is stored in stretch and folds only adds to it.
    let energy = |engine: &Engine| -> f64 {
        let state = &engine.state;
        let free = (0..state.cloth).filter(|&i| state.w[i] > 0.0);
        free.map(|i| (0.5 * state.v[i].length_squared() + 9.81 * state.x[i].z) / state.w[i])
            .sum()
    };
    let start = energy(&engine);
    let mut lowest = start;
    for frame in 0..150 {
        engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap();
        let now = energy(&engine);
        assert!(
            now <= start + 1e-9,
            "frame {frame}: {now} J, {start} J at first"
        );
        lowest = lowest.min(now);
    }
    assert!(lowest < start - 1e-3, "it never fell");
}

#[test]
fn six_hundred_frames_of_gale_and_speed_stay_clean_and_gain_no_energy() {
    let body = Body::ball([0.0; 3], 2.0);
    let garments = [
        sheet(9, 9, 0.25, 0, |x, y| [x - 1.0, y - 0.9, 2.08]),
        sheet(9, 9, 0.25, 1, |x, y| [x - 1.05, y - 0.95, 2.2]),
    ];
    // Pinned to the ball in the middle, so that the gale does not take them away.
    let bands: Vec<Vec<u32>> = vec![vec![39, 40, 41], vec![39, 40, 41]];
    let effects = [&USUAL[..], &[Effect::Wind, Effect::Waistband]].concat();
    let settings = EngineSettings::default();
    let scene = physics(&effects);
    let mut engine = Engine::new(
        &garments,
        &bands,
        &body.faces,
        &body.positions,
        &scene,
        &settings,
    )
    .unwrap();
    let mut energies = Vec::new();
    for frame in 0..600 {
        let t = FRAME_S as f32 * frame as f32;
        let by = [2.4 * (12.5 * t).sin(), 1.2 * (1.0 - (6.0 * t).cos()), 0.0];
        let at = body.moved(by);
        let gale = wind(if frame % 40 < 20 { 400.0 } else { 0.0 });
        let report = engine.advance(&at, gale, FRAME_S).unwrap();
        assert_eq!(report.uncertified, 0, "frame {frame}");
        let hits = super::contacts::hits(&engine, &garments, &at, &body.faces);
        assert_eq!(hits, 0, "frame {frame}");
        let state = &engine.state;
        let moving = state.v[state.cloth..].iter().sum::<DVec3>() / body.positions.len() as f64;
        let kinetic: f64 = (0..state.cloth)
            .filter(|&i| state.w[i] > 0.0)
            .map(|i| 0.5 * (state.v[i] - moving).length_squared() / state.w[i])
            .sum();
        energies.push(kinetic);
    }
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (early, late) = (mean(&energies[40..200]), mean(&energies[440..600]));
    assert!(late < 1.25 * early, "{early} J early, {late} J late");
}

//! Extreme input stays finite; bad input is refused by name.

use super::*;
use crate::error::SimError;

fn span(engine: &Engine) -> f32 {
    let all = engine.garments().concat();
    let mut widest = 0.0_f32;
    for axis in 0..3 {
        let along = || all.iter().map(|p| p[axis]);
        widest = widest.max(along().fold(f32::MIN, f32::max) - along().fold(f32::MAX, f32::min));
    }
    widest
}

#[test]
fn ten_times_stiffer_windier_or_longer_stays_finite_and_in_one_piece() {
    let body = Body::ball([0.0; 3], 2.0);
    let stiff = Material {
        tension: 1000.0,
        compression: 1000.0,
        shear: 1000.0,
        bending: 1000.0,
        ..MATERIAL
    };
    let soft = Material {
        tension: 15.0,
        compression: 15.0,
        shear: 15.0,
        bending: 15.0,
        mass: 0.8,
        friction: 0.0,
    };
    let light = Material {
        mass: 0.02,
        ..MATERIAL
    };
    let cases = [
        (stiff, 0.0, FRAME_S),
        (MATERIAL, 4000.0, FRAME_S),
        (light, 4000.0, FRAME_S),
        (soft, 400.0, FRAME_S),
        (MATERIAL, 0.0, 0.5),
        (stiff, 4000.0, 0.5),
    ];
    let effects = [&USUAL[..], &[Effect::Wind]].concat();
    for (material, strength, dt_s) in cases {
        let mut garments = [
            sheet(9, 9, 0.25, 0, |x, y| [x - 1.0, y - 0.9, 2.08]),
            sheet(9, 9, 0.25, 1, |x, y| [x - 1.05, y - 0.95, 2.15]),
        ];
        for garment in &mut garments {
            garment.material = material;
        }
        let mut engine = engine(&garments, &body, &effects);
        for frame in 0..12 {
            let at = body.moved([(frame as f32).sin(), 0.0, 0.0]);
            engine.advance(&at, wind(strength), dt_s).unwrap();
            // One sheet must stay about its own size; two may drift apart.
            let single = engine.garments()[0].clone();
            let length = |a: usize, b: usize| {
                (0..3)
                    .map(|k| (single[a][k] - single[b][k]).powi(2))
                    .sum::<f32>()
                    .sqrt()
            };
            let corner = length(0, 80);
            assert!(
                corner < 6.0,
                "{material:?} {strength} {dt_s}: diagonal {corner}"
            );
        }
        assert!(span(&engine).is_finite());
    }
}

#[test]
fn needles_coincident_and_loose_vertices_are_survived() {
    let mut garment = sheet(6, 6, 0.25, 0, |x, y| [x, y, 2.2]);
    garment.rest[8] = garment.rest[7];
    garment.rest.push([0.3, 0.3, 2.6]);
    garment.uv.push([0.0; 2]);
    garment.faces.push([3, 3, 4]);
    garment.uv_faces.push([3, 3, 4]);
    garment.panel_of_face.push(0);
    let body = Body::ball([0.0; 3], 2.0);
    let mut engine = engine(&[garment], &body, &USUAL);
    for _ in 0..20 {
        engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap();
    }
    assert!(span(&engine) < 20.0, "{}", span(&engine));
}

#[test]
fn bad_input_is_refused_by_name_and_nothing_moves() {
    let body = Body::ball([0.0; 3], 2.0);
    let garment = sheet(4, 4, 0.25, 0, |x, y| [x, y, 2.2]);
    let make = |garment: &Garment, bands: &[Vec<u32>], settings: &EngineSettings| {
        let garments = std::slice::from_ref(garment);
        Engine::new(
            garments,
            bands,
            &body.faces,
            &body.positions,
            &physics(&USUAL),
            settings,
        )
    };
    let defaults = EngineSettings::default();
    let message = |result: Result<Engine, SimError>| result.unwrap_err().to_string();

    let mut bad = garment.clone();
    bad.rest[5][1] = f32::NAN;
    assert!(message(make(&bad, &[], &defaults)).contains("vertex 5"));
    let mut bad = garment.clone();
    bad.faces[2][1] = 99;
    assert!(message(make(&bad, &[], &defaults)).contains("face 2"));
    let mut bad = garment.clone();
    bad.material.mass = 0.0;
    assert!(message(make(&bad, &[], &defaults)).contains("mass"));
    assert!(message(make(&garment, &[vec![99]], &defaults)).contains("99"));
    assert!(message(make(&garment, &[vec![], vec![]], &defaults)).contains("waist"));
    let settings = EngineSettings {
        substeps: 0,
        ..defaults.clone()
    };
    assert!(message(make(&garment, &[], &settings)).contains("substeps"));

    let mut engine = make(&garment, &[], &defaults).unwrap();
    let before = bits(&engine);
    let mut nowhere = body.positions.clone();
    nowhere[7][2] = f32::NAN;
    let error = engine
        .advance(&nowhere, Wind::default(), FRAME_S)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("body") && error.contains("vertex 7"),
        "{error}"
    );
    assert!(
        engine
            .advance(&body.positions[1..], Wind::default(), FRAME_S)
            .is_err()
    );
    assert!(
        engine
            .advance(&body.positions, Wind::default(), 0.0)
            .is_err()
    );
    let unaimed = Wind {
        rotation: [0.0; 4],
        strength: 100.0,
    };
    assert!(engine.advance(&body.positions, unaimed, FRAME_S).is_err());
    assert_eq!(before, bits(&engine), "a refused frame moved the cloth");
    engine
        .advance(&body.positions, Wind::default(), FRAME_S)
        .unwrap();
}

#[test]
fn misspelt_settings_are_refused() {
    let error = toml::from_str::<EngineSettings>("substep = 3")
        .unwrap_err()
        .to_string();
    assert!(error.contains("substep"), "{error}");
    assert_eq!(
        toml::from_str::<EngineSettings>("").unwrap(),
        EngineSettings::default()
    );
}

#[test]
fn cloth_that_is_shaken_to_pieces_asks_for_no_more_than_its_neighbours() {
    let body = Body::ball([0.0; 3], 2.0);
    let garments = [
        sheet(30, 30, 0.1, 0, |x, y| [x - 1.5, y - 1.3, 2.08]),
        sheet(30, 30, 0.1, 1, |x, y| [x - 1.45, y - 1.25, 2.15]),
    ];
    let mut engine = engine(&garments, &body, &USUAL);
    // Every vertex another way, as fast as the engine allows.
    for (i, v) in engine.state.v[..1800].iter_mut().enumerate() {
        let draw = |salt: f64| (i as f64 * salt).sin() * 28.0;
        *v = glam::DVec3::new(draw(12.9898), draw(78.233), draw(45.164));
    }
    let h = FRAME_S / f64::from(EngineSettings::default().substeps);
    for frame in 0..3 {
        let report = engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap();
        let torn = engine.fabric.edges.iter().map(|&[a, b]| {
            let between = engine.state.v[a as usize] - engine.state.v[b as usize];
            h * between.length() / engine.fabric.rest_length([a, b])
        });
        let torn = torn.fold(0.0, f64::max);
        let work = report.candidates as f64 / (15.0 * 1800.0);
        assert!(torn < 0.75, "frame {frame}: {torn} of an edge in a substep");
        // Comparing everything with everything, or an edge's neighbours with what
        // lies five substeps away, takes hundreds for each vertex and substep.
        assert!(frame == 0 || work < 200.0, "frame {frame}: {work}");
    }
}

#[test]
fn passes_grow_with_fine_cloth_and_have_a_bound() {
    let passes = |edge_m| super::super::rounds(3, edge_m);
    assert_eq!([f64::INFINITY, 0.025, 0.0125].map(passes), [3, 3, 3]);
    assert_eq!([0.01, 0.005].map(passes), [4, 8]);
    assert_eq!([1e-3, 1e-6, 0.0].map(passes), [24, 24, 24]);
}

//! Closed forms and conservation.

use glam::DVec3;

use super::verification::pinned;
use super::*;
use crate::engine::air::NORMAL_DRAG;
use crate::scene::Units;

#[test]
fn cloth_in_a_vacuum_falls_as_a_stone_does() {
    let garment = sheet(6, 6, 0.25, 0, |x, y| [x, y, 10.0 + 0.3 * x]);
    let effects = [
        Effect::Gravity,
        Effect::Stretch,
        Effect::Shear,
        Effect::Bending,
        Effect::SelfContact,
    ];
    let mut engine = engine(std::slice::from_ref(&garment), &Body::default(), &effects);
    for _ in 0..15 {
        engine.advance(&[], Wind::default(), FRAME_S).unwrap();
    }
    // Half a second in steps of h: the symplectic step falls g·t·h/2 further than g·t²/2.
    let h = FRAME_S / f64::from(EngineSettings::default().substeps);
    let fallen = 98.1 * (0.5 * 0.25 + 0.5 * 0.5 * h);
    for (now, rest) in engine.garments()[0].iter().zip(&garment.rest) {
        assert!((f64::from(rest[2] - now[2]) - fallen).abs() < 1e-4);
        assert!((now[0] - rest[0]).abs() < 1e-4 && (now[1] - rest[1]).abs() < 1e-4);
    }
}

#[test]
fn a_strip_hangs_longer_by_its_weight_over_its_stiffness() {
    // Under its own weight a strip of length L grows by ρ g L² / 2K.
    let elongation = |tension: f32| {
        let mut strip = sheet(6, 17, 0.25, 0, |x, y| [x, 0.0, 20.0 - y]);
        // As stiff when compressed: 15 N/m per unit against 50.
        strip.material = Material {
            tension,
            compression: tension * 50.0 / 15.0,
            ..MATERIAL
        };
        let body = Body {
            positions: vec![[-5.0, 1.0, 20.0], [5.0, 1.0, 20.0], [0.0, 1.0, 30.0]],
            faces: vec![[0, 1, 2]],
        };
        let effects = [
            Effect::Gravity,
            Effect::AirDrag,
            Effect::Stretch,
            Effect::Waistband,
        ];
        let band: Vec<u32> = (0..6).collect();
        let settings = EngineSettings::default();
        let mut engine = Engine::new(
            std::slice::from_ref(&strip),
            &[band],
            &body.faces,
            &body.positions,
            &physics(&effects),
            &settings,
        )
        .unwrap();
        for _ in 0..90 {
            engine
                .advance(&body.positions, Wind::default(), FRAME_S)
                .unwrap();
        }
        let lowest = |x: &[[f32; 3]]| x[6 * 16..].iter().map(|p| p[2]).sum::<f32>() / 6.0;
        f64::from(lowest(&strip.rest) - lowest(&engine.garments()[0])) / 10.0
    };
    let expected =
        |tension: f64| 0.2 * 9.81 * (1.6 * 0.25 * 0.75_f64.sqrt()).powi(2) / (2.0 * 50.0 * tension);
    for tension in [0.2, 0.4, 0.8] {
        let ratio = elongation(tension) / expected(f64::from(tension));
        // The lattice has no lateral constraint at its sides: a little softer than the sheet.
        assert!(
            (0.9..1.25).contains(&ratio),
            "tension {tension}: {ratio} of the closed form"
        );
    }
}

#[test]
fn fine_cloth_hangs_no_longer_than_coarse_cloth() {
    // Half a metre of cloth from a pinned row. Its stiffness would let it grow by 0.03 %:
    // what it stretches beyond that is what passes leave undone.
    let stretched = |edge: f32| {
        let count = |size: f32| (size / edge).round() as u32 + 1;
        let (columns, rows) = (count(1.5), count(5.0 / 0.75_f32.sqrt()));
        let cloth = sheet(columns, rows, edge, 0, |x, y| [x, 0.0, 10.0 - y]);
        let body = Body {
            positions: vec![[-5.0, 1.0, 10.0], [5.0, 1.0, 10.0], [0.0, 1.0, 20.0]],
            faces: vec![[0, 1, 2]],
        };
        let band = (0..columns).collect();
        let effects = [
            Effect::Gravity,
            Effect::AirDrag,
            Effect::Stretch,
            Effect::Waistband,
        ];
        let mut engine = pinned(&cloth, band, &body, &effects, &EngineSettings::default());
        for _ in 0..60 {
            engine
                .advance(&body.positions, Wind::default(), FRAME_S)
                .unwrap();
        }
        let lowest = |x: &[[f32; 3]]| x.iter().map(|p| p[2]).fold(f32::MAX, f32::min);
        (lowest(&cloth.rest) - lowest(&engine.garments()[0])) / 5.0
    };
    let [coarse, fine, finest] = [0.25, 0.1, 0.06].map(stretched);
    assert!(coarse > 0.0 && coarse < 0.02, "{coarse} of its length");
    assert!(fine < 0.03 && finest < 0.03, "{coarse}, {fine}, {finest}");
}

#[test]
fn cloth_slides_only_on_slopes_steeper_than_the_friction_angle() {
    // μ = 0.5: the angle is 26.6°.
    let slid = |angle: f32| {
        let body = Body::ramp(angle, 30.0);
        let above = 0.0401;
        let garment = sheet(5, 5, 0.25, 0, |x, y| {
            let along = x - 0.5;
            [
                along * angle.cos() + above * angle.sin(),
                y - 0.5,
                -along * angle.sin() + above * angle.cos(),
            ]
        });
        let effects = [
            Effect::Gravity,
            Effect::Stretch,
            Effect::Bending,
            Effect::BodyContact,
            Effect::Friction,
        ];
        let mut engine = engine(std::slice::from_ref(&garment), &body, &effects);
        for _ in 0..15 {
            engine
                .advance(&body.positions, Wind::default(), FRAME_S)
                .unwrap();
        }
        let middle = |x: &[[f32; 3]]| f64::from(x[12][0]) / f64::from(angle.cos());
        middle(&engine.garments()[0]) - middle(&garment.rest)
    };
    let degrees = |d: f32| d.to_radians();
    for angle in [10.0, 20.0, 26.0] {
        let slid = slid(degrees(angle));
        assert!(slid.abs() < 0.01, "{angle}°: slid by {slid}");
    }
    for angle in [27.5_f32, 35.0, 45.0] {
        let slid = slid(degrees(angle));
        let (sin, cos) = f64::from(degrees(angle)).sin_cos();
        let expected = 0.5 * 98.1 * (sin - 0.5 * cos) * 0.25;
        assert!(
            (slid / expected - 1.0).abs() < 0.1,
            "{angle}°: slid by {slid}, expected {expected}"
        );
    }
}

#[test]
fn a_flat_sheet_approaches_the_terminal_speed_of_a_plate() {
    let garment = sheet(5, 5, 0.25, 0, |x, y| [x, y, 0.0]);
    let effects = [
        Effect::Gravity,
        Effect::AirDrag,
        Effect::Stretch,
        Effect::Bending,
    ];
    let mut engine = engine(&[garment], &Body::default(), &effects);
    for _ in 0..15 {
        engine.advance(&[], Wind::default(), FRAME_S).unwrap();
    }
    let state = &engine.state;
    let speed = -state.v.iter().map(|v| v.z).sum::<f64>() / state.cloth as f64;
    let density = 0.5 * f64::from(MATERIAL.mass);
    let terminal = (2.0 * density * 9.81 / (AIR_DENSITY * NORMAL_DRAG)).sqrt();
    // v = v∞ tanh(g t / v∞): 99.5 % of it after half a second.
    let expected = terminal * (9.81 * 0.5 / terminal).tanh();
    assert!(
        (speed / expected - 1.0).abs() < 0.02,
        "{speed} m/s, expected {expected}"
    );
}

#[test]
fn cloth_drifts_as_fast_as_the_wind_and_no_faster() {
    let garment = sheet(6, 6, 0.25, 0, |x, y| [0.0, x, y]);
    let effects = [Effect::Wind, Effect::AirDrag, Effect::Stretch];
    let mut engine = engine(&[garment], &Body::default(), &effects);
    let air = crate::engine::air_velocity(wind(300.0)).unwrap();
    let mut fastest = 0.0_f64;
    for _ in 0..150 {
        let report = engine.advance(&[], wind(300.0), FRAME_S).unwrap();
        fastest = fastest.max(report.top_speed_m_s);
    }
    assert!(fastest < 1.01 * air.length(), "{fastest}");
    assert!(fastest > 0.8 * air.length(), "{fastest}");
}

#[test]
fn in_units_of_d_layers_wind_and_drag_are_blenders_and_as_strong_against_weight_as_in_real_ones() {
    let edge = 0.263;
    // Acceleration in units/s² of a sheet across the wind that moves with `speed_m_s` along it.
    let acceleration = |units: Units, mass: f32, strength: f32, speed_m_s: f64| {
        let scene = ScenePhysics {
            air_density: units.air_density(),
            ..physics(&[Effect::Wind, Effect::AirDrag])
        };
        let garment = Garment {
            material: Material { mass, ..MATERIAL },
            ..sheet(6, 6, edge, 0, |x, y| [0.0, x, y])
        };
        let settings = EngineSettings::default();
        let mut engine = Engine::new(&[garment], &[], &[], &[], &scene, &settings).unwrap();
        engine.state.v.fill(DVec3::new(speed_m_s, 0.0, 0.0));
        let dt_s = 1e-4;
        engine.advance(&[], wind(strength), dt_s).unwrap();
        // Inside the sheet: a corner with one face gets half.
        10.0 * (engine.state.v[14].x - speed_m_s) / dt_s
    };
    let vertex_area = f64::from(edge * edge) * 0.75_f64.sqrt();
    for mass in [0.2, 0.4, 0.8] {
        for strength in [50.0, 150.0, 400.0] {
            let [floating, real] =
                [Units::DLayers, Units::Real].map(|units| acceleration(units, mass, strength, 0.0));
            let blender = 0.6 * f64::from(strength) * vertex_area / f64::from(mass);
            assert!(
                (floating / blender - 1.0).abs() < 0.01,
                "mass {mass}, strength {strength}: {floating}, Blender's {blender}"
            );
            let weights = f64::from(Units::DLayers.gravity() / Units::Real.gravity());
            // The faster sheet has run a little further from the wind.
            assert!((floating / real / weights - 1.0).abs() < 0.01);
        }
    }
    let drag_per_s = -acceleration(Units::DLayers, 0.4, 0.0, 1.0) / 10.0;
    assert!(
        (drag_per_s / 0.3 - 1.0).abs() < 0.1,
        "{drag_per_s} per second"
    );
}

#[test]
fn sheets_that_collide_keep_their_momentum() {
    let lower = sheet(6, 6, 0.25, 0, |x, y| [x, y, 0.0]);
    let upper = sheet(6, 6, 0.25, 1, |x, y| [x + 0.1, y + 0.07, 0.1 + 0.05 * x]);
    let effects = [
        Effect::Stretch,
        Effect::Shear,
        Effect::Bending,
        Effect::LayerContact,
        Effect::SelfContact,
        Effect::Friction,
    ];
    let mut engine = engine(&[lower, upper], &Body::default(), &effects);
    for i in 36..72 {
        engine.state.v[i] = DVec3::new(0.3, 0.0, -1.0);
    }
    let momentum = |engine: &Engine| -> DVec3 {
        let state = &engine.state;
        (0..state.cloth).map(|i| state.v[i] / state.w[i]).sum()
    };
    let energy = |engine: &Engine| -> f64 {
        let state = &engine.state;
        (0..state.cloth)
            .map(|i| 0.5 * state.v[i].length_squared() / state.w[i])
            .sum()
    };
    let (before, start) = (momentum(&engine), energy(&engine));
    let mut contacts = 0;
    for _ in 0..30 {
        contacts += engine
            .advance(&[], Wind::default(), FRAME_S)
            .unwrap()
            .contacts;
        assert!(
            energy(&engine) <= start * (1.0 + 1e-9),
            "contact made energy"
        );
    }
    assert!(contacts > 0, "they never met");
    assert!(
        (momentum(&engine) - before).length() < 1e-10,
        "{} {before}",
        momentum(&engine)
    );
}

#[test]
fn a_shaken_sheet_loses_energy_and_never_gains() {
    let garment = sheet(10, 10, 0.25, 0, |x, y| [x, y, 0.0]);
    let effects = [
        Effect::Stretch,
        Effect::Shear,
        Effect::Bending,
        Effect::SelfContact,
    ];
    let mut engine = engine(&[garment], &Body::default(), &effects);
    for i in 0..engine.state.cloth {
        let phase = i as f64;
        engine.state.v[i] = DVec3::new(
            (7.1 * phase).sin(),
            (3.3 * phase).cos(),
            (1.7 * phase).sin(),
        );
    }
    let kinetic = |engine: &Engine| -> f64 {
        let state = &engine.state;
        (0..state.cloth)
            .map(|i| 0.5 * state.v[i].length_squared() / state.w[i])
            .sum()
    };
    let start = kinetic(&engine);
    for _ in 0..60 {
        engine.advance(&[], Wind::default(), FRAME_S).unwrap();
        assert!(kinetic(&engine) < start);
    }
    assert!(kinetic(&engine) < 0.5 * start);
}

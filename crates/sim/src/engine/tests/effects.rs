//! Effects on demand.

use super::*;

fn dressed_ball(effects: &[Effect], change: impl Fn(&mut Material)) -> Engine {
    let body = Body::ball([0.0; 3], 2.0);
    let mut garments = [
        sheet(11, 11, 0.25, 0, |x, y| [x - 1.25, y - 1.1, 2.06]),
        sheet(11, 11, 0.25, 1, |x, y| [x - 1.3, y - 1.15, 2.15]),
    ];
    for garment in &mut garments {
        change(&mut garment.material);
    }
    engine(&garments, &body, effects)
}

fn run(engine: &mut Engine, wind: Wind) -> Vec<u32> {
    let body = Body::ball([0.0; 3], 2.0);
    for frame in 1..=6 {
        engine
            .advance(&body.moved([0.05 * frame as f32, 0.0, 0.0]), wind, FRAME_S)
            .unwrap();
    }
    bits(engine)
}

#[test]
fn what_a_scene_does_not_call_for_never_runs() {
    let all = [&USUAL[..], &[Effect::Wind]].concat();
    for left_out in &all {
        let effects: Vec<Effect> = all.iter().copied().filter(|e| e != left_out).collect();
        let mut engine = dressed_ball(&effects, |_| {});
        run(&mut engine, wind(100.0));
        for effect in &all {
            let passes = engine.passes(*effect);
            assert_eq!(
                passes == 0,
                effect == left_out,
                "{effect:?} ran {passes} times without {left_out:?}"
            );
        }
        assert_eq!(engine.passes(Effect::Waistband), 0);
    }
}

#[test]
fn an_effect_that_is_forced_off_is_an_effect_not_called_for() {
    let all = [&USUAL[..], &[Effect::Wind]].concat();
    for &off in &all {
        let with = |effects: &[Effect], settings: &EngineSettings| {
            let body = Body::ball([0.0; 3], 2.0);
            let garments = [
                sheet(7, 7, 0.25, 0, |x, y| [x - 0.75, y - 0.6, 2.06]),
                sheet(7, 7, 0.25, 1, |x, y| [x - 0.8, y - 0.65, 2.15]),
            ];
            let scene = physics(effects);
            let (faces, positions) = (&body.faces, &body.positions);
            Engine::new(&garments, &[], faces, positions, &scene, settings).unwrap()
        };
        let forced = EngineSettings {
            without: [off].into(),
            ..EngineSettings::default()
        };
        let mut forced = with(&all, &forced);
        let left: Vec<Effect> = all.iter().copied().filter(|e| *e != off).collect();
        let mut plain = with(&left, &EngineSettings::default());
        assert_eq!(run(&mut forced, wind(100.0)), run(&mut plain, wind(100.0)));
        assert_eq!(forced.passes(off), 0, "{off}");
        for effect in left {
            assert_eq!(
                forced.passes(effect),
                plain.passes(effect),
                "{effect} without {off}"
            );
        }
    }
}

#[test]
fn one_garment_without_a_body_has_no_contacts_but_its_own() {
    let garment = sheet(4, 4, 0.25, 0, |x, y| [x, y, 0.0]);
    let mut engine = engine(&[garment], &Body::default(), &USUAL);
    engine.advance(&[], Wind::default(), FRAME_S).unwrap();
    assert_eq!(engine.passes(Effect::LayerContact), 0);
    assert_eq!(engine.passes(Effect::BodyContact), 0);
    assert!(engine.passes(Effect::SelfContact) > 0);
}

#[test]
fn an_effect_of_size_zero_is_an_effect_not_called_for() {
    let without = |effect: Effect| -> Vec<Effect> {
        USUAL.iter().copied().filter(|e| *e != effect).collect()
    };
    let compare = |effect: Effect, change: fn(&mut Material)| {
        let left_out = run(&mut dressed_ball(&without(effect), change), Wind::default());
        let mut forced = dressed_ball(&USUAL, change);
        assert_eq!(left_out, run(&mut forced, Wind::default()), "{effect:?}");
        assert!(forced.passes(effect) > 0, "{effect:?} was to be forced on");
    };
    compare(Effect::Bending, |material| material.bending = 0.0);
    compare(Effect::Shear, |material| material.shear = 0.0);
    compare(Effect::Stretch, |material| {
        material.tension = 0.0;
        material.compression = 0.0;
    });

    let calm = run(&mut dressed_ball(&USUAL, |_| {}), Wind::default());
    let with_wind = [&USUAL[..], &[Effect::Wind]].concat();
    let mut windless = dressed_ball(&with_wind, |_| {});
    assert_eq!(calm, run(&mut windless, wind(0.0)));
    assert!(windless.passes(Effect::Wind) > 0);

    let airless = |effects: &[Effect]| {
        let scene = ScenePhysics {
            air_density: 0.0,
            ..physics(effects)
        };
        let garment = sheet(5, 5, 0.25, 0, |x, y| [x, y, 0.1 * x * y]);
        let settings = EngineSettings::default();
        let mut engine = Engine::new(&[garment], &[], &[], &[], &scene, &settings).unwrap();
        for _ in 0..4 {
            engine.advance(&[], wind(200.0), FRAME_S).unwrap();
        }
        (bits(&engine), engine)
    };
    let in_a_vacuum = airless(&without(Effect::AirDrag)).0;
    for forced_on in [
        &USUAL[..],
        &with_wind,
        &[&without(Effect::AirDrag)[..], &[Effect::Wind]].concat(),
    ] {
        let (forced, engine) = airless(forced_on);
        assert_eq!(in_a_vacuum, forced, "{forced_on:?}");
        for effect in [Effect::AirDrag, Effect::Wind] {
            let asked = forced_on.contains(&effect);
            assert_eq!(engine.passes(effect) > 0, asked, "{effect}: {forced_on:?}");
        }
    }

    let weightless = |effects: &[Effect]| {
        let scene = ScenePhysics {
            gravity: [0.0; 3],
            ..physics(effects)
        };
        let garment = sheet(5, 5, 0.25, 0, |x, y| [x, y, 0.1 * x * y]);
        let settings = EngineSettings::default();
        let mut engine = Engine::new(&[garment], &[], &[], &[], &scene, &settings).unwrap();
        for _ in 0..4 {
            engine.advance(&[], wind(200.0), FRAME_S).unwrap();
        }
        bits(&engine)
    };
    let gravityless: Vec<Effect> = with_wind
        .iter()
        .copied()
        .filter(|e| *e != Effect::Gravity)
        .collect();
    assert_eq!(weightless(&with_wind), weightless(&gravityless));

    let smooth = |effects: &[Effect]| {
        let scene = ScenePhysics {
            body_friction: 0.0,
            ..physics(effects)
        };
        let body = Body::ball([0.0; 3], 2.0);
        let garment = sheet(11, 11, 0.25, 0, |x, y| [x - 1.25, y - 1.1, 2.06]);
        let garment = Garment {
            material: Material {
                friction: 0.0,
                ..MATERIAL
            },
            ..garment
        };
        let settings = EngineSettings::default();
        let mut engine = Engine::new(
            &[garment],
            &[],
            &body.faces,
            &body.positions,
            &scene,
            &settings,
        )
        .unwrap();
        run(&mut engine, Wind::default())
    };
    assert_eq!(smooth(&USUAL), smooth(&without(Effect::Friction)));
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let effects = [&USUAL[..], &[Effect::Wind]].concat();
    let run = || run(&mut dressed_ball(&effects, |_| {}), wind(300.0));
    assert_eq!(run(), run());
}

#[test]
fn contacts_out_of_reach_are_contacts_not_called_for() {
    let body = Body::ball([0.0, 0.0, -300.0], 2.0);
    let garments = [
        sheet(7, 7, 0.25, 0, |x, y| [x, y, 0.1 * x * y]),
        sheet(7, 7, 0.25, 1, |x, y| [x, y, 40.0 + 0.1 * x * y]),
    ];
    let falling = |left_out: &[Effect]| {
        let effects = [&USUAL[..], &[Effect::Wind]].concat();
        let asked: Vec<Effect> = effects
            .into_iter()
            .filter(|effect| !left_out.contains(effect))
            .collect();
        let mut engine = engine(&garments, &body, &asked);
        for _ in 0..6 {
            engine
                .advance(&body.positions, wind(100.0), FRAME_S)
                .unwrap();
        }
        (bits(&engine), engine)
    };
    let (all, engine) = falling(&[]);
    for effect in [
        Effect::BodyContact,
        Effect::LayerContact,
        Effect::SelfContact,
        Effect::Friction,
    ] {
        assert!(engine.passes(effect) > 0, "{effect} was to be forced on");
        let (without, engine) = falling(&[effect]);
        assert_eq!(engine.passes(effect), 0);
        assert_eq!(all, without, "{effect}");
    }
    let contacts = [
        Effect::BodyContact,
        Effect::LayerContact,
        Effect::SelfContact,
    ];
    assert_eq!(all, falling(&contacts).0);
}

#[test]
fn a_waist_band_without_vertices_is_none() {
    let with_band = [&USUAL[..], &[Effect::Waistband]].concat();
    let plain = run(&mut dressed_ball(&USUAL, |_| {}), Wind::default());
    let mut empty = dressed_ball(&with_band, |_| {});
    assert_eq!(plain, run(&mut empty, Wind::default()));
    assert_eq!(empty.passes(Effect::Waistband), 0);
}

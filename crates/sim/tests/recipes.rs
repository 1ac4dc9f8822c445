//! A recipe that was read is the recipe that was written, to the last bit.

use std::ops::ControlFlow;

use drape_dataset::sequence::Frame;
use drape_geometry::intersect::count_within;
use drape_sim::engine::{AIR_DENSITY, EngineSettings};
use drape_sim::motion::{LeadIn, Motion, Movement};
use drape_sim::scene::{BodyGap, Recipe, SceneRanges, Units, simulate};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn drawn(number: usize) -> Recipe {
    let name = format!("train_{number:04}");
    SceneRanges::default().sample(&name, number, 5, 48, &EngineSettings::default())
}

#[test]
fn every_number_is_read_as_it_was_written() {
    for number in 0..200 {
        let recipe = drawn(number);
        assert_eq!(Recipe::from_json(&recipe.to_json()).unwrap(), recipe);
    }
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut recipe = drawn(0);
    for _ in 0..20_000 {
        let [a, b]: [f64; 2] = rng.random::<[u64; 2]>().map(f64::from_bits);
        let c = f32::from_bits(rng.random());
        if !(a.is_finite() && b.is_finite() && c.is_finite()) {
            continue;
        }
        (recipe.edge_m, recipe.shape.height) = (a, b);
        recipe.garments[0].material.tension = c;
        let read = Recipe::from_json(&recipe.to_json()).unwrap();
        assert_eq!(
            [a.to_bits(), b.to_bits()],
            [read.edge_m.to_bits(), read.shape.height.to_bits()],
            "{a:e} {b:e}"
        );
        assert_eq!(c.to_bits(), read.garments[0].material.tension.to_bits());
    }
}

#[test]
fn a_recipe_that_does_not_say_its_air_is_of_real_air() {
    let ranges = SceneRanges {
        units: Units::DLayers,
        ..SceneRanges::default()
    };
    let recipe = ranges.sample("train_0000", 0, 1, 9, &EngineSettings::default());
    let text = recipe.to_json();
    let said = format!("\"air_density\":{},", recipe.air_density);
    assert!(text.contains(&said), "{text}");
    let older = Recipe::from_json(&text.replace(&said, "")).unwrap();
    assert_eq!(older.air_density, AIR_DENSITY);
}

#[test]
fn a_chosen_edge_length_holds_for_all_outfits_and_a_wrong_one_is_refused() {
    let with = |edge_m| SceneRanges {
        edge_m,
        ..SceneRanges::default()
    };
    for number in 0..8 {
        let name = format!("train_{number:04}");
        let recipe = with(0.025).sample(&name, number, 5, 48, &EngineSettings::default());
        assert_eq!(recipe.edge_m, 0.025);
        // The rest of the draw is the same.
        let edge_m = drawn(number).edge_m;
        assert_eq!(Recipe { edge_m, ..recipe }, drawn(number));
    }
    for good in [0.0, 0.01, 0.06] {
        with(good).validate().unwrap();
    }
    for bad in [25.0, 0.009, -0.025, f64::NAN] {
        let said = with(bad).validate().unwrap_err().to_string();
        assert!(
            said.contains("scene.edge_m") && said.contains("0.06"),
            "{said}"
        );
    }
}

#[test]
fn a_motion_is_cut_before_the_body_crosses_itself_if_room_is_asked_for() {
    let mut plain = Recipe {
        frames: 10,
        motion: Motion {
            movements: vec![Movement::Twist {
                angle_deg: 170.0,
                period_s: 1.5,
                phase: 0.0,
            }],
            ..Motion::default()
        },
        lead_in: LeadIn { still: 1, ease: 4 },
        body_gap: None,
        ..drawn(0)
    };
    plain.garments.truncate(1);
    let with_room = Recipe {
        body_gap: Some(BodyGap {
            gap_m: 0.004,
            frames: 10,
        }),
        ..plain.clone()
    };
    let go = |recipe: &Recipe| simulate(recipe, Some(1), |_| ControlFlow::Continue(())).unwrap();
    let [(all, frames), (cut, kept)] = [go(&plain), go(&with_room)];
    assert_eq!(frames.len(), 10);
    let hits = |body: &[[f32; 3]]| count_within(body, &all.body.faces);
    let crosses = |frame: &&Frame| hits(&frame.body) > hits(&all.body.rest);
    let clear = frames.iter().take_while(|frame| !crosses(frame)).count();
    assert!((1..10).contains(&clear), "{clear}");
    assert_eq!(kept.len(), clear);
    let crossed = frames.iter().filter(crosses).count();
    let what = "the body intersects itself more than in the fitting pose";
    assert_eq!(
        all.scene.warnings,
        [format!("{what} in {crossed} of 10 frames")]
    );
    let from = 1 + 4 + clear;
    assert_eq!(
        cut.scene.warnings,
        [format!(
            "frames from {from} on were cut, lead-in included: {what}"
        )]
    );
    for (frame, cut) in frames.iter().zip(&kept) {
        assert_eq!(frame.body, cut.body, "what is kept is the same");
    }
}

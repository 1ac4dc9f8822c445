//! A recipe that was read is the recipe that was written, to the last bit.

use drape_sim::engine::{AIR_DENSITY, EngineSettings};
use drape_sim::scene::{Recipe, SceneRanges, Units};
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

//! The committed configuration of `drape-generate` is complete and says the defaults.

use std::collections::{BTreeMap, BTreeSet};

use drape_dataset::registry::GarmentKind;
use drape_sim::blender::BlenderSettings;
use drape_sim::engine::{AIR_DENSITY, EngineSettings};
use drape_sim::motion::MotionFamily;
use drape_sim::scene::{Recipe, SceneRanges, Units};

fn committed() -> toml::Table {
    let text = include_str!("../../../configs/generate.toml");
    toml::from_str(text).unwrap()
}

#[test]
fn the_committed_configuration_lists_every_field_with_its_default() {
    let mut table = committed();
    let scene = table.remove("scene").unwrap();
    let engine = table.remove("engine").unwrap();
    let blender = table.remove("blender").unwrap();
    let all_scene = toml::Value::try_from(SceneRanges::default()).unwrap();
    let all_engine = toml::Value::try_from(EngineSettings::default()).unwrap();
    let all_blender = toml::Value::try_from(BlenderSettings::default()).unwrap();
    assert_eq!(names(&blender), names(&all_blender));
    assert_eq!(names(&scene), names(&all_scene));
    assert_eq!(names(&engine), names(&all_engine));
    let scene: SceneRanges = scene.try_into().unwrap();
    let engine: EngineSettings = engine.try_into().unwrap();
    assert_eq!(scene, SceneRanges::default());
    assert_eq!(engine, EngineSettings::default());
    assert_eq!(
        blender.try_into::<BlenderSettings>().unwrap(),
        BlenderSettings::default()
    );
    scene.validate().unwrap();
    engine.validate().unwrap();
}

/// Names of all fields, nested ones with their tables'.
fn names(value: &toml::Value) -> Vec<String> {
    let Some(table) = value.as_table() else {
        return vec![String::new()];
    };
    let nested = |(name, value): (&String, &toml::Value)| {
        let inner = names(value).into_iter();
        inner
            .map(|inner| format!("{name}.{inner}"))
            .collect::<Vec<_>>()
    };
    table.iter().flat_map(nested).collect()
}

fn wardrobe() -> SceneRanges {
    let text = include_str!("../../../configs/wardrobe.toml");
    let mut table: toml::Table = toml::from_str(text).unwrap();
    table.remove("scene").unwrap().try_into().unwrap()
}

#[test]
fn the_wardrobe_names_every_kind_layer_count_and_family_and_shares_them_evenly() {
    let ranges = wardrobe();
    ranges.validate().unwrap();
    assert_eq!(ranges.wind_strength, [0.0, 400.0]);
    let listed: BTreeSet<MotionFamily> = ranges.motions.iter().copied().collect();
    assert_eq!(listed, BTreeSet::from(MotionFamily::SINGLE));
    let kinds: BTreeSet<GarmentKind> = ranges.outfits.iter().flatten().copied().collect();
    assert_eq!(kinds, BTreeSet::from_iter(GarmentKind::ALL.iter().copied()));
    let count = |layers: usize| ranges.outfits.iter().filter(|o| o.len() == layers).count();
    assert_eq!([count(1), count(2), count(3)], [6, 6, 6]);
    // Each family is recognised by the movements it starts with.
    let rounds = 4 * ranges.motions.len();
    let mut drawn: BTreeMap<String, usize> = BTreeMap::new();
    for number in 0..rounds {
        let engine = EngineSettings::default();
        let recipe = ranges.sample(&format!("train_{number:04}"), number, 1, 90, &engine);
        let text = format!("{:?}", recipe.motion.movements[0]);
        let name = text.split(' ').next().unwrap().to_string();
        *drawn.entry(name).or_default() += 1;
        let read = Recipe::from_json(&recipe.to_json()).unwrap();
        assert_eq!(
            (read.body_gap, read.trimmed_layers),
            (recipe.body_gap, true)
        );
    }
    assert!(drawn.values().all(|&count| count >= 3), "{drawn:?}");
    assert!(drawn.len() >= 14, "{drawn:?}");
}

#[test]
fn garments_float_in_the_units_of_d_layers_and_fall_in_real_ones() {
    for (units, gravity) in [(Units::Real, -98.1), (Units::DLayers, -8.83)] {
        let ranges = SceneRanges {
            units,
            ..SceneRanges::default()
        };
        let recipe = ranges.sample("train_0000", 0, 1, 9, &EngineSettings::default());
        assert_eq!(recipe.gravity, [0.0, 0.0, gravity]);
        // The air is thinner in proportion.
        let thinner = recipe.air_density / AIR_DENSITY;
        assert!(
            (thinner - f64::from(gravity / -98.1)).abs() < 1e-6,
            "{thinner}"
        );
    }
}

#[test]
fn a_name_with_a_typo_is_an_error_that_says_the_name() {
    let error = toml::from_str::<SceneRanges>("calm_shar = 0.2").unwrap_err();
    assert!(error.to_string().contains("calm_shar"), "{error}");
    let error = toml::from_str::<SceneRanges>("[material]\nmas = [1.0, 2.0]").unwrap_err();
    assert!(error.to_string().contains("mas"), "{error}");
}

#[test]
fn an_empty_range_is_refused_by_name() {
    let ranges = SceneRanges {
        wind_strength: [200.0, f32::NAN],
        ..SceneRanges::default()
    };
    let message = ranges.validate().unwrap_err().to_string();
    assert!(message.contains("scene.wind_strength"), "{message}");
}

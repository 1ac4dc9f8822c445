//! The committed configuration of `drape-generate` is complete and says the defaults.

use drape_sim::blender::BlenderSettings;
use drape_sim::engine::EngineSettings;
use drape_sim::scene::SceneRanges;

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

//! Single garment.
//!
//! Symptom: the published layer loss takes the nearest vertex of an empty inner
//! mesh: an index out of range.
//! Guarantee: with one garment the layer loss is exactly 0 and not computed; losses
//! and gradients are bit for bit those of a config without it.

use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};
use drape_train::losses::LossConfig;
use drape_train::step::sample_gradient;

#[test]
fn the_layer_loss_is_zero_and_changes_nothing() {
    let (sample, statistics) = Scene::new(SceneConfig {
        garments: 1,
        ..SceneConfig::default()
    })
    .sample(4);
    let run = super::run(&sample, &statistics);
    assert_eq!(run.trained.losses.layer_collision, 0.0);
    let config = ModelConfig::default();
    let parameters = Parameters::new(&config, 2).unwrap();
    let net = LayersNet::trainable(&config, &parameters).unwrap();
    let without = LossConfig {
        layer_collision: 0.0,
        ..LossConfig::default()
    };
    let other = sample_gradient(
        &net,
        &parameters,
        &statistics.vertices,
        &without,
        &sample,
        &run.rolled,
        true,
    )
    .unwrap();
    assert_eq!(run.trained.losses, other.losses);
    assert!(run.trained.gradients == other.gradients);
    assert_eq!(run.rolled.len(), sample.outfit.vertices());
}

#[test]
fn with_two_garments_it_is_computed() {
    // The outer tube is pushed into the inner one.
    let (mut sample, statistics) = Scene::new(SceneConfig::default()).sample(1);
    for row in &mut sample.state[sample.outfit.garment_offsets[1]..] {
        for block in [0, 6] {
            row[block] *= 0.8;
            row[block + 1] *= 0.8;
        }
    }
    assert!(
        super::run(&sample, &statistics)
            .trained
            .losses
            .layer_collision
            > 0.0
    );
}

//! Body far away, and no body.
//!
//! Symptom: a ball query without hits returns vertex 0, so the published program
//! lets every patch see an arbitrary vertex of a distant body.
//! Guarantee: a body out of reach gives bit for bit what no body gives, passes over
//! it are skipped, and its collision loss is 0.

use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};
use drape_train::losses::LossConfig;
use drape_train::step::sample_gradient;

#[test]
fn a_distant_body_equals_no_body() {
    let none = Scene::new(SceneConfig {
        body: false,
        ..SceneConfig::default()
    });
    let far = Scene::new(SceneConfig {
        body_offset: [0.0, 500.0, 0.0],
        ..SceneConfig::default()
    });
    // The same statistics for both: a distant body would shift them.
    let (without, statistics) = none.sample(4);
    let (mut distant, _) = far.sample(4);
    for (step, other) in distant.steps.iter_mut().zip(&without.steps) {
        let body = std::mem::take(&mut step.body);
        *step = drape_dataset::sample::Step {
            body,
            ..other.clone()
        };
    }
    let (a, b) = (
        super::run(&without, &statistics),
        super::run(&distant, &statistics),
    );
    assert_eq!(a.first, b.first);
    assert_eq!(a.rolled, b.rolled);
    assert_eq!(a.trained.losses, b.trained.losses);
    assert_eq!(b.trained.losses.body_collision, 0.0);
    assert!(a.trained.gradients == b.trained.gradients);
    for run in [&a, &b] {
        let graph = run.trained.evaluation.graph();
        assert!(
            graph.body_rows.is_empty() && graph.body_tokens == 0,
            "nothing of the body is encoded"
        );
        assert!(
            graph
                .vertex_anchors
                .iter()
                .chain(&graph.patch_anchors)
                .all(|anchor| anchor.row.is_none())
        );
        assert_eq!(graph.edges.rotations.len(), 2, "wind and gravity");
    }
}

#[test]
fn the_reach_is_where_the_body_begins_to_count() {
    // Inner tube 1.0 ± 0.03 around a body of radius 0.85: within 0.4, not within 0.05.
    let (sample, statistics) = Scene::new(SceneConfig::default()).sample(1);
    let parameters = Parameters::new(&ModelConfig::default(), 2).unwrap();
    let rows = |body_radius: f32| {
        let config = ModelConfig {
            body_radius,
            ..ModelConfig::default()
        };
        let net = LayersNet::trainable(&config, &parameters).unwrap();
        let losses = LossConfig::default();
        let result = sample_gradient(
            &net,
            &parameters,
            &statistics.vertices,
            &losses,
            &sample,
            &sample.state,
            true,
        )
        .unwrap();
        result.evaluation.graph().body_rows.len()
    };
    assert!(rows(0.4) > 0);
    assert_eq!(rows(0.05), 0);
}

//! The network attends to the world edges that the dataset crate gives to anyone.

use drape_dataset::world_edges::{Reach, WorldEdges};
use drape_model::{FrameGraph, ModelConfig};
use drape_tests::scene::{Scene, SceneConfig};

#[test]
fn the_networks_world_edges_are_those_of_the_dataset_crate() {
    let (sample, _) = Scene::new(SceneConfig::default()).sample(1);
    let (outfit, state, step) = (&sample.outfit, &sample.state, &sample.steps[0]);
    for (layer, body) in [(0.6, 0.4), (1.5, 0.9)] {
        let config = ModelConfig {
            layer_radius: layer,
            body_radius: body,
            ..ModelConfig::default()
        };
        let graph = FrameGraph::new(&config, outfit, state, step).unwrap();
        let edges = WorldEdges::new(outfit, state, step, Reach { layer, body }).unwrap();
        assert!(!edges.patches.items.is_empty() && !edges.body.items.is_empty());
        assert_eq!(graph.edges.world, edges.patches);
        for (patch, tokens) in graph.edges.body.iter().enumerate() {
            // The last two are wind and gravity.
            let tokens = &tokens[..tokens.len() - 2];
            let seen = tokens.iter().map(|&token| &graph.body_rows[token as usize]);
            assert!(seen.eq(edges.body.row(patch)), "patch {patch}");
        }
    }
}

#[test]
fn the_papers_reach_is_the_default_of_both() {
    let (config, reach) = (ModelConfig::default(), Reach::default());
    assert_eq!((config.layer_radius, config.body_radius), (0.6, 0.4));
    assert_eq!((reach.layer, reach.body), (0.6, 0.4));
}

//! Coincident vertices, and coincident patch centres.
//!
//! Symptom: distances of 0 between a vertex and patches, or between patches: the
//! published program finds the own patch by "distance 0", and distances in
//! expanded form give NaN.
//! Guarantee: the own patch is known by its index; vertices with equal states and
//! the same own patch move equally; a vertex whose nearest four patches are all
//! refused (each must be nearer to it than to the own patch's centre) moves with
//! its own patch.

use drape_model::{FrameGraph, LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};

#[test]
fn vertices_at_one_point_move_as_one() {
    let (mut sample, statistics) = Scene::new(SceneConfig::default()).sample(4);
    let patches = &sample.outfit.patches;
    // All members of patch 0 and of a neighbour move to one point: equal centres too.
    let neighbour = patches.neighbours.row(0)[1] as usize;
    let mut all: Vec<u32> = [patches.members.row(0), patches.members.row(neighbour)].concat();
    all.sort_unstable();
    all.dedup();
    for &vertex in &all {
        sample.state[vertex as usize] = sample.state[all[0] as usize];
    }
    let run = super::run(&sample, &statistics);
    let config = ModelConfig::default();
    let graph = FrameGraph::new(&config, &sample.outfit, &sample.state, &sample.steps[0]).unwrap();
    let gap: f32 = (0..3)
        .map(|i| (graph.patch_states[0][i] - graph.patch_states[neighbour][i]).abs())
        .sum();
    assert!(gap < 1e-5, "the centres coincide up to rounding");
    for &vertex in &all {
        if graph.own_patch[vertex as usize] == graph.own_patch[all[0] as usize] {
            let of = |vertex: u32| &run.first[3 * vertex as usize..][..3];
            assert_eq!(of(vertex), of(all[0]), "vertex {vertex}");
        }
    }
}

#[test]
fn a_whole_outfit_at_one_point_runs() {
    let (mut sample, statistics) = Scene::new(SceneConfig::default()).sample(4);
    let point = sample.state[0];
    sample.state.fill(point);
    super::run(&sample, &statistics);
    let config = ModelConfig::default();
    let net = LayersNet::frozen(&config, &Parameters::new(&config, 2).unwrap()).unwrap();
    let prediction = net
        .forward(
            &sample.outfit,
            &statistics.vertices,
            &sample.state,
            &sample.steps[0],
        )
        .unwrap();
    let relative: Vec<Vec<f32>> = prediction.relative.to_vec2().unwrap();
    let offsets = &prediction.graph.slot_offsets;
    let refused: Vec<usize> = (0..relative.len())
        .filter(|&v| offsets[v] == offsets[v + 1])
        .collect();
    assert!(
        !refused.is_empty(),
        "with all centres in one place some vertices have no patch nearer than its own"
    );
    for vertex in refused {
        assert_eq!(
            relative[vertex],
            statistics.vertices.mean[6..],
            "no part of its own but the mean"
        );
    }
}

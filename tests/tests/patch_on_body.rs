//! What a patch's rows of the decoder hold: its state relative to the nearest body vertex.

use drape_dataset::sample::{Sample, StatePair};
use drape_model::{FrameGraph, LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};

fn graph(config: &ModelConfig, sample: &Sample) -> FrameGraph {
    FrameGraph::new(config, &sample.outfit, &sample.state, &sample.steps[0]).unwrap()
}

fn length(v: &[f32]) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

#[test]
fn lengths_are_those_of_the_differences_to_the_nearest_vertex() {
    // On the body, beside it, and too far off.
    for (offset, sees) in [
        ([0.0; 3], true),
        ([2.5, 0.0, 0.0], true),
        ([40.0, 0.0, 0.0], false),
    ] {
        let mut seen = 0;
        let scene = Scene::new(SceneConfig {
            body_offset: offset,
            ..SceneConfig::default()
        });
        let (sample, _) = scene.sample(1);
        let (step, config) = (&sample.steps[0], ModelConfig::default());
        let graph = graph(&config, &sample);
        for (patch, state) in graph.patch_states.iter().enumerate() {
            let apart =
                |body: &StatePair| -> StatePair { std::array::from_fn(|i| state[i] - body[i]) };
            let nearest = step
                .body
                .iter()
                .map(apart)
                .min_by(|a, b| length(&a[..3]).total_cmp(&length(&b[..3])));
            let nearest = nearest.unwrap();
            let found = graph.patch_on_body(patch, step);
            // Turned into the frame of the normal there, or, out of reach, not turned.
            let d = length(&nearest[..3]);
            let share = (1.0 - (d / config.patch_sight).powi(2)).max(0.0).powi(2);
            seen += usize::from(share > 0.0);
            for (found, expected) in found.chunks(3).zip(nearest.chunks(3)) {
                let (found, expected) = (length(found), share * length(expected));
                assert!((found - expected).abs() < 1e-4, "patch {patch}");
            }
            if d > config.body_radius {
                assert_eq!(found, nearest.map(|x| share * x), "patch {patch}");
            }
        }
        assert_eq!(seen > 0, sees, "body at {offset:?}");
    }
}

#[test]
fn nothing_without_a_body_or_as_published() {
    let (sample, _) = Scene::new(SceneConfig::default()).sample(1);
    let released = graph(&ModelConfig::released(), &sample);
    let (alone, _) = Scene::new(SceneConfig {
        body: false,
        ..SceneConfig::default()
    })
    .sample(1);
    let bodiless = graph(&ModelConfig::default(), &alone);
    for (graph, step) in [(released, &sample.steps[0]), (bodiless, &alone.steps[0])] {
        for patch in 0..graph.patch_states.len() {
            assert_eq!(graph.patch_on_body(patch, step), [0.0; 12]);
        }
    }
}

#[test]
fn the_prediction_depends_on_it() {
    let (sample, statistics) = Scene::new(SceneConfig::default()).sample(1);
    let with = ModelConfig::default();
    let without = ModelConfig {
        patch_sight: 0.0,
        ..with.clone()
    };
    let parameters = Parameters::new(&with, 1).unwrap();
    let [a, b] = [with, without].map(|config| {
        let net = LayersNet::frozen(&config, &parameters).unwrap();
        let columns = &statistics.vertices;
        let prediction = net.forward(&sample.outfit, columns, &sample.state, &sample.steps[0]);
        let prediction = prediction.unwrap().patch_acceleration;
        prediction.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    });
    assert_ne!(a, b);
}

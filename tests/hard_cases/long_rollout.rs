//! Rollout of 300 frames.
//!
//! Symptom: prediction errors feed back; garments drift out of the body's and each
//! other's reach, and one NaN ends the rollout.
//! Guarantee: the rollout runs to its end, and positions obey the integration:
//! |x_t − x_0| ≤ t|v_0| + A t(t+1)/2 with A the largest acceleration, which is
//! itself bounded when the decoder's output is.

use drape_model::{LayersNet, ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};
use drape_train::step::advance;

const FRAMES: usize = 300;

fn length(v: &[f32]) -> f64 {
    v.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt()
}

/// Runs 300 frames with the body's frames repeated; returns the largest acceleration and checks the bound.
fn roll(parameters: &Parameters) -> f64 {
    let (mut sample, mut statistics) = Scene::new(SceneConfig::default()).sample(6);
    // Without a mean acceleration nothing drives the garment but the network.
    statistics.vertices.mean[6..].fill(0.0);
    let net = LayersNet::frozen(&ModelConfig::default(), parameters).unwrap();
    let start = sample.state.clone();
    let mut largest = 0f64;
    for frame in 0..FRAMES {
        let step = &sample.steps[frame % sample.steps.len()];
        let prediction = net
            .forward(&sample.outfit, &statistics.vertices, &sample.state, step)
            .unwrap();
        let a: Vec<f32> = prediction
            .acceleration
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap();
        largest = a.chunks_exact(3).fold(largest, |top, a| top.max(length(a)));
        let next = advance(&sample.state, &a);
        for (state, next) in sample.state.iter_mut().zip(&next) {
            let old: [f32; 6] = std::array::from_fn(|i| state[i]);
            *state = drape_dataset::sample::pair(next, &old);
        }
    }
    let t = FRAMES as f64;
    for (vertex, (end, start)) in sample.state.iter().zip(&start).enumerate() {
        let moved: Vec<f32> = (0..3).map(|axis| end[axis] - start[axis]).collect();
        let bound = t * length(&start[3..6]) + largest * t * (t + 1.0) / 2.0;
        // 1e-3: 300 additions of f32 at sizes up to 100.
        assert!(
            length(&moved) <= bound + 1e-3,
            "vertex {vertex} moved {} > {bound}",
            length(&moved)
        );
    }
    largest
}

fn scale_last_layer(parameters: &Parameters, weight: f64, bias: f64) {
    for (part, factor) in [("weight", weight), ("bias", bias)] {
        let variable = parameters
            .get(&format!("decode_head.proj.layers.2.{part}"))
            .unwrap();
        variable
            .set(&(variable.as_tensor() * factor).unwrap())
            .unwrap();
    }
}

#[test]
fn a_decoder_of_zeros_moves_everything_straight_on() {
    let parameters = Parameters::new(&ModelConfig::default(), 4).unwrap();
    scale_last_layer(&parameters, 0.0, 0.0);
    assert_eq!(roll(&parameters), 0.0);
}

#[test]
fn a_bounded_decoder_bounds_the_motion() {
    let parameters = Parameters::new(&ModelConfig::default(), 4).unwrap();
    scale_last_layer(&parameters, 0.0, 0.01);
    let bias: Vec<f32> = parameters
        .get("decode_head.proj.layers.2.bias")
        .unwrap()
        .to_vec1()
        .unwrap();
    let (_, statistics) = Scene::new(SceneConfig::default()).sample(6);
    let std = statistics.vertices.std[6..]
        .iter()
        .fold(0f32, |top, &std| top.max(std));
    // Own patch and own part, each a turned bias scaled by the statistics.
    let bound = 2.0 * f64::from(std) * length(&bias);
    let found = roll(&parameters);
    assert!(
        found > 0.0 && found <= bound * (1.0 + 1e-5),
        "{found} > {bound}"
    );
}

#[test]
fn an_untrained_network_with_small_outputs_does_not_run_away() {
    let parameters = Parameters::new(&ModelConfig::default(), 4).unwrap();
    scale_last_layer(&parameters, 1e-3, 1e-3);
    let (sample, mut statistics) = Scene::new(SceneConfig::default()).sample(1);
    statistics.vertices.mean[6..].fill(0.0);
    let net = LayersNet::frozen(&ModelConfig::default(), &parameters).unwrap();
    let first = net
        .forward(
            &sample.outfit,
            &statistics.vertices,
            &sample.state,
            &sample.steps[0],
        )
        .unwrap();
    let first: Vec<f32> = first.acceleration.flatten_all().unwrap().to_vec1().unwrap();
    let first = first
        .chunks_exact(3)
        .fold(0f64, |top, a| top.max(length(a)));
    // Layer norms keep the embedding's size; only raw relative states could grow.
    let largest = roll(&parameters);
    assert!(
        largest < 100.0 * first,
        "accelerations grew from {first} to {largest}"
    );
}

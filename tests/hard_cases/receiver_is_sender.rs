//! Receiver = sender.
//!
//! Symptom: messages are (r + s)/|r − s|; when a receiver's token equals a
//! sender's, the published program divides 0 by 0, and one NaN poisons the row
//! and all gradients, even of masked pairs.
//! Guarantee: |r − s| is kept above 1e-6, so the message is (r + s)·1e6 along a
//! finite direction, its gradient by the distance is zero, and everything stays finite.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, HEAD, WIDTH, attend};
use drape_model::{ModelConfig, Parameters};
use drape_tests::scene::{Scene, SceneConfig};

/// One receiver, mesh senders `s`; returns output and gradient by tokens, f64.
fn attend_one(q: f64, senders: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let row = |value: f64| vec![value; WIDTH];
    let rows = [
        vec![row(0.5), row(q)],
        senders.iter().map(|&s| row(s)).collect(),
    ]
    .concat();
    let tokens = Tensor::from_vec(rows.concat(), (rows.len(), WIDTH), &Device::Cpu).unwrap();
    let tokens = Var::from_tensor(&tokens).unwrap();
    let parameters = Tensor::zeros(GROUPS * GROUP_PARAMETERS, DType::F64, &Device::Cpu).unwrap();
    let edges = Edges {
        mesh: Csr::from_pairs(1, (0..senders.len() as u32).map(|s| (0, s)).collect()),
        world: Csr::from_pairs(1, vec![]),
        body: Csr::from_pairs(1, vec![]),
        senders: senders.len(),
        ..Edges::default()
    };
    let out = attend(&tokens, &parameters, Arc::new(edges), true).unwrap();
    let gradients = out.sum_all().unwrap().backward().unwrap();
    let values = |t: &Tensor| t.flatten_all().unwrap().to_vec1::<f64>().unwrap();
    (values(&out), values(gradients.get(&tokens).unwrap()))
}

#[test]
fn the_message_is_the_pair_at_the_distance_floor() {
    let (out, gradient) = attend_one(0.1, &[0.5]);
    // Mesh heads only: (0.5 + 0.5)/1e-6.
    for (channel, value) in out.iter().enumerate() {
        let expected = if channel / HEAD % 2 == 1 { 1e6 } else { 0.0 };
        assert!(
            (value - expected).abs() < 1e-6,
            "channel {channel}: {value}"
        );
    }
    // d out/d r = 1/1e-6: the direction, without a term from the distance.
    assert!((gradient[HEAD] - 1e6).abs() < 1e-3 && gradient.iter().all(|g| g.is_finite()));
}

#[test]
fn the_logits_sign_decides_whether_it_wins() {
    // q against r + s: the coincident sender gets logit −∞ in effect, the other all weight:
    // f = (0.5 + 0.25)/sqrt(16 · 0.25²) = 0.75.
    let (out, gradient) = attend_one(-0.1, &[0.5, 0.25]);
    assert!((out[HEAD] - 0.75).abs() < 1e-12, "{}", out[HEAD]);
    assert!(gradient.iter().all(|g| g.is_finite()));
}

#[test]
fn a_model_whose_receivers_equal_their_own_sender_runs() {
    let config = ModelConfig::default();
    let parameters = Parameters::new(&config, 2).unwrap();
    let copy = |from: &str, to: &str| {
        parameters
            .get(to)
            .unwrap()
            .set(&parameters.get(from).unwrap().as_tensor().copy().unwrap())
            .unwrap();
    };
    for part in [
        "layers.0.0.weight",
        "layers.0.0.bias",
        "layers.1.weight",
        "layers.1.bias",
    ] {
        copy(
            &format!("backbone.sender_proj.{part}"),
            &format!("backbone.receiver_proj.{part}"),
        );
    }
    let attention = "backbone.encoder.layers.0.self_attn.attn";
    copy(
        &format!("{attention}.sender_weight.weight"),
        &format!("{attention}.receiver_weight.weight"),
    );
    let (sample, statistics) = Scene::new(SceneConfig::default()).sample(4);
    let run = super::run_with(&parameters, &sample, &statistics);
    // The layer norm after the attention takes the factor 1e6 out again: outputs stay of order 1 std.
    let largest = run.first.iter().fold(0f32, |top, a| top.max(a.abs()));
    let scale = statistics.vertices.std[6..]
        .iter()
        .chain(&statistics.vertices.mean[6..])
        .fold(0f32, |top, s| top.max(s.abs()));
    assert!(
        largest < 20.0 * scale,
        "{largest} against statistics of {scale}"
    );
}

//! Empty attention row.
//!
//! Symptom: softmax over no entries is 0/0.
//! Guarantee: a receiver without entries gets output 0 and passes gradient 0; in a
//! model no row is empty, because a patch sees itself, wind and gravity.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, WIDTH, attend};
use drape_tests::scene::{Scene, SceneConfig};

#[test]
fn output_and_gradient_are_zero() {
    let all: Vec<f32> = (0..6 * WIDTH)
        .map(|i| ((i * 37) % 101) as f32 / 50.0 - 1.0)
        .collect();
    let tokens =
        Var::from_tensor(&Tensor::from_vec(all, (6, WIDTH), &Device::Cpu).unwrap()).unwrap();
    let parameters = Tensor::full(0.1f32, GROUPS * GROUP_PARAMETERS, &Device::Cpu).unwrap();
    // Receivers 0 (empty) and 1; two senders.
    let list = || Csr::from_pairs(2, vec![(1, 0), (1, 1)]);
    let edges = Edges {
        mesh: list(),
        world: list(),
        body: Csr::from_pairs(2, vec![]),
        senders: 2,
        ..Edges::default()
    };
    let out = attend(&tokens, &parameters, Arc::new(edges), true).unwrap();
    let rows: Vec<Vec<f32>> = out.to_vec2().unwrap();
    assert!(rows[0].iter().all(|x| *x == 0.0) && rows[1].iter().all(|x| *x != 0.0));
    let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    let by_token: Vec<Vec<f32>> = gradients
        .get(&tokens)
        .unwrap()
        .to_dtype(DType::F32)
        .unwrap()
        .to_vec2()
        .unwrap();
    // Rows: r₀, r₁, q₀, q₁, senders.
    assert!(by_token[0].iter().chain(&by_token[2]).all(|g| *g == 0.0));
    assert!(by_token[1].iter().chain(&by_token[3]).any(|g| *g != 0.0));
}

#[test]
fn a_patch_alone_still_sees_itself_wind_and_gravity() {
    let scene = Scene::new(SceneConfig {
        garments: 1,
        body: false,
        wind: false,
        ..SceneConfig::default()
    });
    let (sample, statistics) = scene.sample(4);
    let run = super::run(&sample, &statistics);
    let graph = run.trained.evaluation.graph();
    for patch in 0..sample.outfit.patches.count() {
        assert!(graph.edges.mesh.row(patch).contains(&(patch as u32)));
        assert_eq!(graph.edges.body.row(patch), [0, 1], "wind and gravity");
    }
}

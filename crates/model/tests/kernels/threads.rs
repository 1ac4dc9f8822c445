//! The same bits outside a thread pool, where rows are shared, and inside pools of
//! one and two threads, where kernels run serially.

use std::sync::Arc;

use candle_core::{DType, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, WIDTH, attend};
use drape_model::kernels::linear::{Activation, linear};
use rayon::prelude::*;

use crate::{bits, random};

const RECEIVERS: usize = 150;

/// Bits of outputs and gradients of a linear layer of 600 rows and an attention of 150 receivers.
fn work() -> Vec<u32> {
    let f32s =
        |name: &str, shape: (usize, usize)| random(name, shape).to_dtype(DType::F32).unwrap();
    let weight = Var::from_tensor(&f32s("weight", (WIDTH, WIDTH))).unwrap();
    let bias = Tensor::zeros(WIDTH, DType::F32, weight.device()).unwrap();
    let tokens = linear(
        &f32s("many", (600, WIDTH)),
        &weight,
        &bias,
        Activation::Relu,
    )
    .unwrap();
    let pairs = |stride: usize| {
        let row =
            move |r: usize| (0..9).map(move |k| (r as u32, ((r * stride + 7 * k) % 299) as u32));
        Csr::from_pairs(RECEIVERS, (0..RECEIVERS).flat_map(row).collect())
    };
    let edges = Edges {
        mesh: pairs(1),
        world: pairs(3),
        body: Csr::from_pairs(RECEIVERS, (0..RECEIVERS).map(|r| (r as u32, 0)).collect()),
        body_log_count: vec![0.0; RECEIVERS],
        rotations: vec![[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]],
        senders: 299,
    };
    let parameters = random("parameters", GROUPS * GROUP_PARAMETERS)
        .to_dtype(DType::F32)
        .unwrap();
    let out = attend(&tokens, &parameters, Arc::new(edges), true).unwrap();
    let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    [
        bits(&tokens),
        bits(&out),
        bits(gradients.get(&weight).unwrap()),
    ]
    .concat()
}

#[test]
fn bits_do_not_depend_on_threads() {
    let outside = work();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let inside: Vec<Vec<u32>> =
            pool.install(|| (0..3).into_par_iter().map(|_| work()).collect());
        for bits in inside {
            assert!(bits == outside, "inside a pool of {threads}");
        }
    }
}

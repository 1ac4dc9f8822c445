//! The same bits outside a thread pool, where rows are shared, and inside pools of
//! one and two threads, where kernels run serially.

use std::sync::Arc;

use candle_core::{DType, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, WIDTH, attend};
use drape_model::kernels::blocks::{BLOCK_PARAMETERS, Ends, Stack, apply};
use drape_model::kernels::decoder::{Segments, decode};
use drape_model::kernels::layer_norm::layer_norm;
use drape_model::kernels::linear::{Activation, linear};
use rayon::prelude::*;

use crate::{bits, random};

const RECEIVERS: usize = 150;

/// Bits of outputs and gradients of a linear layer and a layer norm of 600 rows, an attention of 150
/// receivers, two blocks on the same edges, and a decoder of 600 rows.
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
    let edges = Arc::new(edges);
    let out = attend(&tokens, &parameters, edges.clone(), true).unwrap();
    let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
    let mut all = [
        bits(&tokens),
        bits(&out),
        bits(gradients.get(&weight).unwrap()),
    ]
    .concat();
    let mut trace = |name: &str, shape: usize, f: &dyn Fn(&Tensor) -> Tensor| {
        let weights = (random(name, shape) * 0.2).unwrap();
        let weights = Var::from_tensor(&weights.to_dtype(DType::F32).unwrap()).unwrap();
        let out = f(&weights);
        let gradients = out.sqr().unwrap().sum_all().unwrap().backward().unwrap();
        all.extend(bits(&out));
        all.extend(bits(gradients.get(&weights).unwrap()));
    };
    trace("norm", WIDTH, &|weight| {
        layer_norm(&tokens, weight, &bias).unwrap()
    });
    trace("blocks", 2 * BLOCK_PARAMETERS, &|weights| {
        let x = f32s("block tokens", (2 * 300 + RECEIVERS, WIDTH));
        let stack = Stack {
            edges: edges.clone(),
            blocks: 2,
            own_slots: true,
            ends: Ends::Patches,
            keep: true,
            transposes: Arc::default(),
        };
        apply(&x, weights, stack).unwrap()
    });
    trace("decoder", (40 + 3) * 41, &|second| {
        let first = f32s("first", (1, 40 * (WIDTH + 1))).flatten_all().unwrap();
        let segments = Segments {
            offsets: (0..=200).map(|s| 3 * s).collect(),
            means: 150,
        };
        decode(&tokens, &first, second, segments, true).unwrap()
    });
    all
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

//! Laws of the attention kernel: it equals the formula written out densely, its
//! weights ignore an orthogonal matrix applied to q, r and s of a head, and its
//! output turns with that matrix.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_dataset::random::stream;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, HEAD, WIDTH, attend};
use drape_tests::dense_attention::dense_attend;
use drape_tests::oracle::relative;
use rand::Rng;

const RECEIVERS: usize = 9;
const SENDERS: usize = 11;

fn random(name: &str, shape: impl Into<candle_core::Shape>) -> Tensor {
    let shape = shape.into();
    let mut rng = stream(3, name);
    let values: Vec<f64> = (0..shape.elem_count())
        .map(|_| rng.random_range(-1.0..1.0))
        .collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

/// Receiver 4 has no entries at all, 5 none in world heads, 6 none in mesh heads.
fn edges(body_tokens: usize) -> Edges {
    let mut rng = stream(3, "edges");
    let mut list = |columns: usize, empty: &[usize]| {
        let mut pairs = Vec::new();
        for row in (0..RECEIVERS).filter(|row| !empty.contains(row)) {
            pairs.extend(
                (0..columns)
                    .filter(|_| rng.random_bool(0.4))
                    .map(|item| (row as u32, item as u32)),
            );
        }
        Csr::from_pairs(RECEIVERS, pairs)
    };
    let (mesh, world, body) = (
        list(SENDERS, &[4, 6]),
        list(SENDERS, &[4, 5]),
        list(body_tokens, &[4, 5]),
    );
    let rotations = (0..body_tokens)
        .map(|_| std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0f32..1.0))))
        .collect();
    let body_log_count = body
        .items
        .iter()
        .map(|&item| (1.0 + (item % 3) as f32).ln())
        .collect();
    Edges {
        mesh,
        world,
        body,
        body_log_count,
        rotations,
        senders: SENDERS,
    }
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

#[test]
fn kernel_equals_the_dense_formula_forwards_and_backwards() {
    let edges = Arc::new(edges(5));
    for own_slots in [true, false] {
        let tokens =
            Var::from_tensor(&random("tokens", (2 * RECEIVERS + SENDERS + 5, WIDTH))).unwrap();
        let parameters =
            Var::from_tensor(&random("parameters", GROUPS * GROUP_PARAMETERS)).unwrap();
        let cotangent = random("cotangent", (RECEIVERS, WIDTH));
        let kernel = attend(&tokens, &parameters, edges.clone(), own_slots).unwrap();
        let dense = dense_attend(&tokens, &parameters, &edges, own_slots).unwrap();
        assert!(relative(&flat(&kernel), &flat(&dense)) < 1e-12);
        let backward = |out: &Tensor| {
            (out * &cotangent)
                .unwrap()
                .sum_all()
                .unwrap()
                .backward()
                .unwrap()
        };
        let (by_kernel, by_dense) = (backward(&kernel), backward(&dense));
        for variable in [&tokens, &parameters] {
            let of = |store: &candle_core::backprop::GradStore| flat(store.get(variable).unwrap());
            let difference = relative(&of(&by_kernel), &of(&by_dense));
            assert!(difference < 1e-11, "{difference}");
        }
    }
}

#[test]
fn a_receiver_without_entries_gets_zero() {
    let tokens = random("tokens", (2 * RECEIVERS + SENDERS + 5, WIDTH));
    let parameters = random("parameters", GROUPS * GROUP_PARAMETERS);
    let out: Vec<Vec<f64>> = attend(&tokens, &parameters, Arc::new(edges(5)), true)
        .unwrap()
        .to_vec2()
        .unwrap();
    assert!(out[4].iter().all(|value| *value == 0.0));
    let heads = |row: usize, mesh: usize| {
        out[row]
            .chunks_exact(HEAD)
            .skip(mesh)
            .step_by(2)
            .all(|head| head.iter().all(|value| *value == 0.0))
    };
    assert!(
        heads(5, 0) && !heads(5, 1),
        "no world entries: world heads are zero"
    );
    assert!(
        !heads(6, 0) && heads(6, 1),
        "no mesh entries: mesh heads are zero"
    );
}

/// A random orthogonal matrix `[16, 16]`, by Gram–Schmidt; determinant of either sign.
fn orthogonal(name: &str) -> Tensor {
    let mut rows: Vec<Vec<f64>> = random(name, (HEAD, HEAD)).to_vec2().unwrap();
    for i in 0..HEAD {
        for j in 0..i {
            let along: f64 = rows[i].iter().zip(&rows[j]).map(|(a, b)| a * b).sum();
            let done = rows[j].clone();
            rows[i]
                .iter_mut()
                .zip(&done)
                .for_each(|(a, b)| *a -= along * b);
        }
        let length = rows[i].iter().map(|a| a * a).sum::<f64>().sqrt();
        rows[i].iter_mut().for_each(|a| *a /= length);
    }
    Tensor::from_vec(rows.concat(), (HEAD, HEAD), &Device::Cpu).unwrap()
}

/// Every head of every row turned by its own orthogonal matrix.
fn turn_heads(x: &Tensor) -> Tensor {
    let heads: Vec<Tensor> = (0..2 * GROUPS)
        .map(|head| {
            let q = orthogonal(&format!("head {head}"));
            x.narrow(1, head * HEAD, HEAD)
                .unwrap()
                .contiguous()
                .unwrap()
                .matmul(&q.t().unwrap())
                .unwrap()
        })
        .collect();
    Tensor::cat(&heads, 1).unwrap()
}

#[test]
fn without_body_tokens_the_output_turns_with_q_r_and_s() {
    let edges = Arc::new(edges(0));
    let parameters = random("parameters", GROUPS * GROUP_PARAMETERS);
    let tokens = random("tokens", (2 * RECEIVERS + SENDERS, WIDTH));
    let run = |tokens: &Tensor| attend(tokens, &parameters, edges.clone(), true).unwrap();
    let expected = turn_heads(&run(&tokens));
    assert!(relative(&flat(&run(&turn_heads(&tokens))), &flat(&expected)) < 1e-12);
}

#[test]
fn weights_do_not_change_with_an_orthogonal_matrix() {
    // One output p_1 f_1 + p_2 f_2 of 2 senders gives both weights by least squares; the
    // weights of turned tokens are the same.
    let pair = Edges {
        mesh: Csr::from_pairs(1, vec![(0, 0), (0, 1)]),
        world: Csr::from_pairs(1, vec![]),
        body: Csr::from_pairs(1, vec![]),
        senders: 2,
        ..Edges::default()
    };
    let pair = Arc::new(pair);
    let parameters = random("parameters", GROUPS * GROUP_PARAMETERS);
    let tokens = random("pair", (4, WIDTH));
    let weights = |tokens: &Tensor, head: usize| -> [f64; 2] {
        let out = flat(&attend(tokens, &parameters, pair.clone(), true).unwrap());
        let rows: Vec<Vec<f64>> = tokens.to_vec2().unwrap();
        let range = head * HEAD..(head + 1) * HEAD;
        let f = |sender: usize| -> Vec<f64> {
            let (r, s) = (&rows[0][range.clone()], &rows[2 + sender][range.clone()]);
            let distance = r
                .iter()
                .zip(s)
                .map(|(a, b)| (a - b) * (a - b))
                .sum::<f64>()
                .sqrt();
            r.iter().zip(s).map(|(a, b)| (a + b) / distance).collect()
        };
        let (f, g, y) = (f(0), f(1), &out[range.clone()]);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (ff, fg, gg, fy, gy) = (
            dot(&f, &f),
            dot(&f, &g),
            dot(&g, &g),
            dot(&f, y),
            dot(&g, y),
        );
        let determinant = ff * gg - fg * fg;
        [
            (gg * fy - fg * gy) / determinant,
            (ff * gy - fg * fy) / determinant,
        ]
    };
    for head in [1, 3, 5, 7] {
        let [p, q] = weights(&tokens, head);
        assert!(
            (p + q - 1.0).abs() < 1e-12 && p > 0.0 && q > 0.0,
            "weights {p} and {q} are probabilities"
        );
        let [p_turned, _] = weights(&turn_heads(&tokens), head);
        assert!((p - p_turned).abs() < 1e-12, "{p} and {p_turned}");
    }
}

#[test]
fn a_body_token_that_counts_twice_equals_two_tokens() {
    // log 2 is an f32, hence the bar.
    let tokens = random("twice", (2 + 1 + 3, WIDTH))
        .to_dtype(DType::F64)
        .unwrap();
    let parameters = random("parameters", GROUPS * GROUP_PARAMETERS);
    let rotation = [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0f32]];
    let make = |pairs: Vec<(u32, u32)>, counts: Vec<f32>| {
        Arc::new(Edges {
            mesh: Csr::from_pairs(1, vec![(0, 0)]),
            world: Csr::from_pairs(1, vec![(0, 0)]),
            body: Csr::from_pairs(1, pairs),
            body_log_count: counts,
            rotations: vec![rotation; 3],
            senders: 1,
        })
    };
    let first = tokens.narrow(0, 3, 1).unwrap();
    let tokens = Tensor::cat(
        &[
            &tokens.narrow(0, 0, 3).unwrap(),
            &first,
            &first,
            &random("third", (1, WIDTH)),
        ],
        0,
    )
    .unwrap();
    let twice = make(vec![(0, 0), (0, 2)], vec![2f32.ln(), 0.0]);
    let copies = make(vec![(0, 0), (0, 1), (0, 2)], vec![0.0; 3]);
    let run = |edges| flat(&attend(&tokens, &parameters, edges, true).unwrap());
    assert!(relative(&run(twice), &run(copies)) < 1e-7);
}

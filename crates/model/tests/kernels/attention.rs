//! Attention over sparse edges: gradients, poison, refused inputs.

use std::sync::Arc;

use candle_core::{DType, Tensor};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, GROUP_PARAMETERS, GROUPS, HEAD, WIDTH, attend};

use crate::{POISON, bits, finite_differences, flat, random};

const P: usize = 3;
const SENDERS: usize = 4;
const BODY: usize = 2;
const ROWS: usize = 2 * P + SENDERS + BODY;

/// Receiver 0 sees everything but sender 3 and body token 1, receiver 1 sees sender 3
/// and body token 1, receiver 2 sees nothing.
fn edges() -> Arc<Edges> {
    Arc::new(Edges {
        mesh: Csr::from_pairs(P, vec![(0, 0), (0, 1), (0, 2), (1, 3)]),
        world: Csr::from_pairs(P, vec![(0, 2), (1, 3)]),
        body: Csr::from_pairs(P, vec![(0, 0), (1, 1)]),
        body_log_count: vec![1.5, 0.0],
        rotations: vec![
            [[0.0, 1.0, 0.0], [-0.6, 0.0, 0.8], [0.8, 0.0, 0.6]],
            [[0.5, 2.0, 0.0], [1.0, -1.0, 3.0], [0.0, 0.5, 1.0]],
        ],
        senders: SENDERS,
    })
}

fn parameters() -> Tensor {
    random("parameters", GROUPS * GROUP_PARAMETERS)
}

#[test]
fn gradients_equal_finite_differences() {
    let tokens = random("tokens", (ROWS, WIDTH));
    for own_slots in [true, false] {
        let f = |t: &[Tensor]| attend(&t[0], &t[1], edges(), own_slots);
        finite_differences::check(&[tokens.clone(), parameters()], f, 1e-8);
    }
}

#[test]
fn strided_tokens_give_the_same() {
    let tokens = random("tokens", (WIDTH, ROWS));
    let strided = attend(&tokens.t().unwrap(), &parameters(), edges(), true).unwrap();
    let whole = attend(
        &tokens.t().unwrap().contiguous().unwrap(),
        &parameters(),
        edges(),
        true,
    )
    .unwrap();
    assert_eq!(flat(&strided), flat(&whole));
}

/// Tokens with one entry of `row`, first channel of head `head`, replaced.
fn poisoned(value: f32, row: usize, head: usize) -> Tensor {
    let mut all: Vec<f32> = random("tokens", (ROWS, WIDTH))
        .to_dtype(DType::F32)
        .unwrap()
        .flatten_all()
        .unwrap()
        .to_vec1()
        .unwrap();
    all[row * WIDTH + head * HEAD] = value;
    Tensor::from_vec(all, (ROWS, WIDTH), &candle_core::Device::Cpu).unwrap()
}

#[test]
fn poison_reaches_only_receivers_that_see_it_and_only_its_head() {
    let parameters = parameters().to_dtype(DType::F32).unwrap();
    let run = |tokens: &Tensor| attend(tokens, &parameters, edges(), true).unwrap();
    let clean = bits(&run(&random("tokens", (ROWS, WIDTH))
        .to_dtype(DType::F32)
        .unwrap()));
    // (token row, receivers that see it): r of 1, q of 0, sender 1, sender 3, body token 1.
    for (row, seen_by) in [
        (1, 1),
        (P, 0),
        (2 * P + 1, 0),
        (2 * P + 3, 1),
        (2 * P + SENDERS + 1, 1),
    ] {
        // Heads 4 (world) and 5 (mesh). Sender 1 is no world neighbour, body tokens are in no mesh head.
        for head in [4, 5] {
            let absent =
                (row == 2 * P + 1 && head == 4) || (row == 2 * P + SENDERS + 1 && head == 5);
            for value in POISON {
                let y = run(&poisoned(value, row, head));
                let found = bits(&y);
                for (at, (a, b)) in found.iter().zip(&clean).enumerate() {
                    let (receiver, of_head) = (at / WIDTH, at % WIDTH / HEAD);
                    if receiver != seen_by || of_head != head || absent {
                        assert_eq!(
                            a, b,
                            "{value} in row {row}, head {head}, shows at receiver {receiver}, head {of_head}"
                        );
                    }
                }
                let touched: Vec<f32> = y
                    .get(seen_by)
                    .unwrap()
                    .narrow(0, head * HEAD, HEAD)
                    .unwrap()
                    .to_vec1()
                    .unwrap();
                if value.is_nan() && !absent {
                    assert!(
                        touched.iter().all(|x| x.is_nan()),
                        "NaN in row {row} got lost: {touched:?}"
                    );
                }
                if value.is_finite() && value.abs() < 1.0 {
                    assert!(
                        touched.iter().all(|x| x.is_finite()),
                        "{value} in row {row} gives {touched:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let tokens = random("tokens", (ROWS, WIDTH));
    let message = attend(
        &tokens.narrow(0, 0, ROWS - 1).unwrap(),
        &parameters(),
        edges(),
        true,
    )
    .unwrap_err()
    .to_string();
    assert!(
        message.contains("tokens [11, 128], edges expect [12, 128]"),
        "{message}"
    );
    let message = attend(&tokens, &random("short", 7), edges(), true)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("[7]") && message.contains("1280"),
        "{message}"
    );
    let half = |t: &Tensor| t.to_dtype(DType::F16).unwrap();
    let message = attend(&half(&tokens), &half(&parameters()), edges(), true)
        .unwrap_err()
        .to_string();
    assert!(message.contains("f32 or f64, got F16"), "{message}");
    let short = Edges {
        world: Csr::from_pairs(P - 1, vec![]),
        ..(*edges()).clone()
    };
    let message = attend(&tokens, &parameters(), Arc::new(short), true)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("differ in their number of receivers"),
        "{message}"
    );
}

#[test]
fn an_edge_to_a_token_that_is_not_there_is_refused() {
    let tokens = random("tokens", (ROWS, WIDTH));
    let wrong = [
        Edges {
            mesh: Csr::from_pairs(P, vec![(0, SENDERS as u32 + 90)]),
            ..(*edges()).clone()
        },
        Edges {
            world: Csr::from_pairs(P, vec![(0, SENDERS as u32)]),
            ..(*edges()).clone()
        },
        Edges {
            body: Csr::from_pairs(P, vec![(0, 0), (1, BODY as u32)]),
            ..(*edges()).clone()
        },
    ];
    for edges in wrong {
        let message = attend(&tokens, &parameters(), Arc::new(edges), true)
            .unwrap_err()
            .to_string();
        assert!(message.contains("beyond"), "{message}");
    }
}

//! The Transformer blocks: gradients, poison, buffers that are used again, refused inputs.
//!
//! Values are checked against the published program's (`drape-tests`, `oracle_unit`) and against
//! plain candle operations (`drape-tests`, `reference`).

use std::sync::Arc;

use candle_core::{DType, Device, Tensor, Var};
use drape_dataset::patches::Csr;
use drape_model::kernels::attention::{Edges, WIDTH};
use drape_model::kernels::blocks::{BLOCK_PARAMETERS, Ends, Stack, apply};

use crate::{POISON, bits, finite_differences, flat, random};

/// A ring of `patches` patches and one attribute token; the first half sees body token 0.
/// Patch 0 also sees patch 2 across the ring.
fn edges(patches: usize) -> Arc<Edges> {
    let ring = |p: usize| [p, (p + 1) % patches, patches].map(|s| (p as u32, s as u32));
    let body: Vec<(u32, u32)> = (0..patches as u32 / 2).map(|p| (p, 0)).collect();
    Arc::new(Edges {
        mesh: Csr::from_pairs(patches, (0..patches).flat_map(ring).collect()),
        world: Csr::from_pairs(patches, vec![(0, 2)]),
        body_log_count: vec![0.5; body.len()],
        body: Csr::from_pairs(patches, body),
        rotations: vec![[[0.0, 1.0, 0.0], [-0.6, 0.0, 0.8], [0.8, 0.0, 0.6]]],
        senders: patches + 1,
    })
}

fn stack(patches: usize, blocks: usize, ends: Ends) -> Stack {
    Stack {
        edges: edges(patches),
        blocks,
        own_slots: true,
        ends,
        keep: true,
        transposes: Arc::default(),
    }
}

/// Z, R and S for so many patches.
fn tokens(patches: usize) -> Tensor {
    random("tokens", (2 * (patches + 2) + patches, WIDTH))
}

/// Weights of a size at which activations stay of size one.
fn parameters(blocks: usize) -> Tensor {
    (random("blocks", blocks * BLOCK_PARAMETERS) * 0.2).unwrap()
}

#[test]
fn gradients_equal_finite_differences() {
    let patches = 4;
    for (blocks, ends) in [(2, Ends::Patches), (1, Ends::Everything)] {
        let f = |t: &[Tensor]| apply(&t[0], &t[1], stack(patches, blocks, ends));
        let inputs = [tokens(patches), parameters(blocks)];
        // A prime stride meets every layer, bias and norm.
        finite_differences::check_every(&[17, 1009], &inputs, f, 1e-6);
    }
}

#[test]
fn buffers_of_another_size_leave_no_trace() {
    let run = |patches: usize, ends: Ends| {
        let x = Var::from_tensor(&tokens(patches).to_dtype(DType::F32).unwrap()).unwrap();
        let w = Var::from_tensor(&parameters(3).to_dtype(DType::F32).unwrap()).unwrap();
        let y = apply(&x, &w, stack(patches, 3, ends)).unwrap();
        let gradients = y.sqr().unwrap().sum_all().unwrap().backward().unwrap();
        let of = |v: &Var| bits(gradients.get(v).unwrap());
        [bits(&y), of(&x), of(&w)].concat()
    };
    // More than one tile, and a last tile that is not full.
    let fresh = run(130, Ends::Patches);
    for (patches, ends) in [
        (5, Ends::Patches),
        (220, Ends::Everything),
        (97, Ends::Patches),
    ] {
        run(patches, ends);
        assert!(
            run(130, Ends::Patches) == fresh,
            "after {patches} patches, {ends:?}"
        );
    }
}

#[test]
fn keeping_nothing_gives_the_same_values_and_no_gradient() {
    let x = Var::from_tensor(&tokens(130)).unwrap();
    let kept = apply(&x, &parameters(3), stack(130, 3, Ends::Patches)).unwrap();
    let frozen = Stack {
        keep: false,
        ..stack(130, 3, Ends::Patches)
    };
    let free = apply(&x, &parameters(3), frozen).unwrap();
    assert_eq!(flat(&kept), flat(&free));
    let message = free.sum_all().unwrap().backward().unwrap_err().to_string();
    assert!(message.contains("nothing was kept"), "{message}");
}

#[test]
fn poison_reaches_only_patches_that_see_it() {
    let patches = 6;
    let w = parameters(1).to_dtype(DType::F32).unwrap();
    let run = |x: &Tensor| bits(&apply(x, &w, stack(patches, 1, Ends::Patches)).unwrap());
    let clean = tokens(patches).to_dtype(DType::F32).unwrap();
    let values: Vec<f32> = clean.flatten_all().unwrap().to_vec1().unwrap();
    let expected = run(&clean);
    let rows = patches + 2;
    // Z, R and S of patch 2: itself, its neighbour before it, and patch 0 across see what it sends.
    for (row, seen_by) in [
        (2, vec![0, 1, 2]),
        (rows + 2, vec![2]),
        (rows + patches + 2, vec![0, 1, 2]),
    ] {
        for value in POISON {
            let mut poisoned = values.clone();
            poisoned[row * WIDTH + 40] = value;
            let x = Tensor::from_vec(poisoned, clean.shape(), &Device::Cpu).unwrap();
            let found = run(&x);
            for patch in 0..patches {
                let at = patch * WIDTH..(patch + 1) * WIDTH;
                let same = found[at.clone()] == expected[at.clone()];
                assert!(
                    same || seen_by.contains(&patch),
                    "{value} in row {row} shows at patch {patch}"
                );
                if value.is_nan() && patch == 2 {
                    let nan = |&bits: &u32| f32::from_bits(bits).is_nan();
                    assert!(found[at].iter().any(nan), "NaN in row {row} got lost");
                }
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let message =
        |x: &Tensor, w: &Tensor, stack: Stack| apply(x, w, stack).unwrap_err().to_string();
    let (x, w) = (tokens(4), parameters(1));
    let short = x.narrow(0, 0, 15).unwrap();
    let text = message(&short, &w, stack(4, 1, Ends::Patches));
    assert!(
        text.contains("tokens [15, 128], edges expect [16, 128]"),
        "{text}"
    );
    let text = message(&x, &w, stack(4, 2, Ends::Patches));
    assert!(text.contains("weights for 2 blocks"), "{text}");
    let text = message(&x, &random("none", 0), stack(4, 0, Ends::Patches));
    assert!(text.contains("at least one block"), "{text}");
    let beyond = Edges {
        world: Csr::from_pairs(4, vec![(0, 5)]),
        ..(*edges(4)).clone()
    };
    let stack = Stack {
        edges: Arc::new(beyond),
        ..stack(4, 1, Ends::Patches)
    };
    let text = message(&x, &w, stack);
    assert!(text.contains("beyond"), "{text}");
}

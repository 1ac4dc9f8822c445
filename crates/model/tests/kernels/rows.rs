//! Rows of two tensors in a new order.

use candle_core::DType;
use drape_model::kernels::rows::take_rows;

use crate::{POISON, bits, finite_differences, flat, ones_with, random};

/// Row 1 of four is not taken, nor row 0 of the other two.
const INDEX: [u32; 4] = [5, 0, 3, 2];

#[test]
fn equals_the_formula() {
    let (a, b) = (random("a", (4, 3)), random("b", (2, 3)));
    let [rows, others]: [Vec<Vec<f64>>; 2] = [&a, &b].map(|x| x.to_vec2().unwrap());
    let expected = [&others[1], &rows[0], &rows[3], &rows[2]];
    let expected: Vec<f64> = expected.into_iter().flatten().copied().collect();
    assert_eq!(flat(&take_rows(&a, &b, INDEX.into()).unwrap()), expected);
}

#[test]
fn gradients_equal_finite_differences() {
    let inputs = [random("a", (4, 3)), random("b", (2, 3))];
    finite_differences::check(&inputs, |t| take_rows(&t[0], &t[1], INDEX.into()), 1e-8);
}

#[test]
fn poison_reaches_only_its_row() {
    let b = random("b", (2, 3)).to_dtype(DType::F32).unwrap();
    let run = |value: f32| bits(&take_rows(&ones_with(value, 4, 3, 2), &b, INDEX.into()).unwrap());
    let clean = run(0.5);
    for value in POISON {
        // Row 2 comes last.
        assert_eq!(run(value)[..9], clean[..9]);
    }
}

#[test]
fn an_index_that_comes_twice_or_lies_beyond_is_an_error() {
    let (a, b) = (random("a", (4, 3)), random("b", (2, 3)));
    for index in [vec![0, 6], vec![5, 1, 5]] {
        let message = take_rows(&a, &b, index).unwrap_err().to_string();
        assert!(message.contains("once at most and below 6"), "{message}");
    }
}

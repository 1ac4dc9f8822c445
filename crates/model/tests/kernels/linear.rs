//! `act(x Wᵀ + b)`.

use candle_core::{DType, Device, Tensor};
use drape_model::kernels::linear::{Activation, linear, product};

use crate::{POISON, bits, difference, finite_differences, ones_with, random};

fn sizes() -> [Tensor; 3] {
    [random("x", (5, 7)), random("w", (4, 7)), random("b", 4)]
}

fn naive(x: &Tensor, w: &Tensor, b: Option<&Tensor>, activation: Activation) -> Tensor {
    let y = x.matmul(&w.t().unwrap()).unwrap();
    let y = b.map_or(y.clone(), |b| y.broadcast_add(b).unwrap());
    if activation == Activation::Relu {
        y.relu().unwrap()
    } else {
        y
    }
}

#[test]
fn equals_the_formula() {
    // 600 rows: more than one block of the kernel, and a rest.
    for rows in [1, 256, 600] {
        let [_, w, b] = sizes();
        let x = random("many rows", (rows, 7));
        for activation in [Activation::None, Activation::Relu] {
            let found = linear(&x, &w, &b, activation).unwrap();
            assert!(difference(&found, &naive(&x, &w, Some(&b), activation)) < 1e-14);
        }
        assert!(
            difference(
                &product(&x, &w).unwrap(),
                &naive(&x, &w, None, Activation::None)
            ) < 1e-14
        );
    }
}

#[test]
fn gradients_equal_finite_differences() {
    for activation in [Activation::None, Activation::Relu] {
        finite_differences::check(&sizes(), |t| linear(&t[0], &t[1], &t[2], activation), 1e-8);
    }
    finite_differences::check(&sizes()[..2], |t| product(&t[0], &t[1]), 1e-8);
}

#[test]
fn poison_stays_in_its_row() {
    let (w, b) = (
        ones_with(0.0, 3, 6, 0),
        Tensor::zeros(3, DType::F32, &Device::Cpu).unwrap(),
    );
    let clean = linear(&ones_with(0.5, 300, 6, 2), &w, &b, Activation::Relu).unwrap();
    for value in POISON {
        let y = linear(&ones_with(value, 300, 6, 2), &w, &b, Activation::Relu).unwrap();
        for (row, (found, expected)) in bits(&y).chunks(3).zip(bits(&clean).chunks(3)).enumerate() {
            assert!(
                row == 2 || found == expected,
                "{value} in row 2 shows in row {row}"
            );
        }
        let row: Vec<f32> = y.get(2).unwrap().to_vec1().unwrap();
        // ReLU must not turn NaN into 0; 0 · ∞ is NaN too (weight 0 of output 0).
        assert_eq!(row[1].is_nan(), value.is_nan(), "{value} gives {row:?}");
        assert_eq!(
            row[0].is_nan(),
            value.is_nan() || value.is_infinite(),
            "{value} gives {row:?}"
        );
        if value == -1e30 {
            assert_eq!(row[1], 0.0);
        }
    }
}

#[test]
fn strided_inputs_give_the_same() {
    let x = random("x", (7, 5));
    let w = random("w", (9, 4));
    let (xt, wt) = (x.t().unwrap(), w.t().unwrap().narrow(1, 1, 7).unwrap());
    let b = random("b", 4);
    let found = linear(&xt, &wt, &b, Activation::None).unwrap();
    let expected = linear(
        &xt.contiguous().unwrap(),
        &wt.contiguous().unwrap(),
        &b,
        Activation::None,
    )
    .unwrap();
    assert_eq!(difference(&found, &expected), 0.0);
    finite_differences::check(
        &[x, w, b],
        |t| {
            linear(
                &t[0].t()?,
                &t[1].t()?.narrow(1, 1, 7)?,
                &t[2],
                Activation::None,
            )
        },
        1e-8,
    );
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let [x, w, _] = sizes();
    let message = product(&x, &random("w", (4, 6))).unwrap_err().to_string();
    assert!(message.contains("x is [5, 7], weight [4, 6]"), "{message}");
    let message = linear(&x, &w, &random("b", 3), Activation::None)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("bias has 3 entries, expected 4"),
        "{message}"
    );
    let half = |t: &Tensor| t.to_dtype(DType::F16).unwrap();
    let message = product(&half(&x), &half(&w)).unwrap_err().to_string();
    assert!(message.contains("f32 or f64, got F16"), "{message}");
    assert!(
        product(&x, &w.to_dtype(DType::F32).unwrap()).is_err(),
        "types may not be mixed"
    );
}

#[test]
fn no_rows_give_no_rows() {
    let [x, w, b] = sizes();
    let y = linear(&x.narrow(0, 0, 0).unwrap(), &w, &b, Activation::Relu).unwrap();
    assert_eq!(y.dims(), [0, 4]);
}

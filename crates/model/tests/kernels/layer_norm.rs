//! Layer norm over the last axis.

use candle_core::{DType, Device, Tensor};
use drape_model::kernels::layer_norm::{layer_norm, layer_norm_first};

use crate::{POISON, bits, difference, finite_differences, flat, ones_with, random};

fn sizes() -> [Tensor; 3] {
    // 37: no multiple of the kernel's lanes.
    [random("x", (4, 37)), random("w", 37), random("b", 37)]
}

fn naive(x: &Tensor, w: &Tensor, b: &Tensor) -> Tensor {
    let mean = x.mean_keepdim(1).unwrap();
    let centred = x.broadcast_sub(&mean).unwrap();
    let variance = centred.sqr().unwrap().mean_keepdim(1).unwrap();
    let normal = centred
        .broadcast_div(&(variance + 1e-5).unwrap().sqrt().unwrap())
        .unwrap();
    normal.broadcast_mul(w).unwrap().broadcast_add(b).unwrap()
}

#[test]
fn equals_the_formula() {
    let [x, w, b] = sizes();
    assert!(difference(&layer_norm(&x, &w, &b).unwrap(), &naive(&x, &w, &b)) < 1e-14);
}

#[test]
fn gradients_equal_finite_differences() {
    finite_differences::check(&sizes(), |t| layer_norm(&t[0], &t[1], &t[2]), 1e-8);
    let [x, w, b] = sizes();
    finite_differences::check(
        &[x.t().unwrap().contiguous().unwrap(), w, b],
        |t| layer_norm(&t[0].t()?, &t[1], &t[2]),
        1e-8,
    );
}

#[test]
fn rows_behind_the_first_pass_as_they_are() {
    let [x, w, b] = sizes();
    let y = layer_norm_first(&x, 3, &w, &b).unwrap();
    let whole = layer_norm(&x, &w, &b).unwrap();
    let part = |tensor: &Tensor, start, rows| flat(&tensor.narrow(0, start, rows).unwrap());
    assert_eq!(part(&y, 0, 3), part(&whole, 0, 3));
    assert_eq!(part(&y, 3, 1), part(&x, 3, 1));
    finite_differences::check(&sizes(), |t| layer_norm_first(&t[0], 3, &t[1], &t[2]), 1e-8);
    let message = layer_norm_first(&x, 5, &w, &b).unwrap_err().to_string();
    assert!(message.contains("at least 5"), "{message}");
}

#[test]
fn a_constant_row_gives_the_bias() {
    let [_, w, b] = sizes();
    let x = Tensor::full(3.25f64, (2, 37), &Device::Cpu).unwrap();
    assert_eq!(
        flat(&layer_norm(&x, &w, &b).unwrap().get(1).unwrap()),
        flat(&b)
    );
}

#[test]
fn poison_stays_in_its_row() {
    let [_, w, b] = sizes().map(|t| t.to_dtype(DType::F32).unwrap());
    let clean = layer_norm(&ones_with(0.5, 6, 37, 2), &w, &b).unwrap();
    for value in POISON {
        let y = layer_norm(&ones_with(value, 6, 37, 2), &w, &b).unwrap();
        for (row, (found, expected)) in bits(&y).chunks(37).zip(bits(&clean).chunks(37)).enumerate()
        {
            assert!(
                row == 2 || found == expected,
                "{value} in row 2 shows in row {row}"
            );
        }
        let row: Vec<f32> = y.get(2).unwrap().to_vec1().unwrap();
        let all_nan = row.iter().all(|x| x.is_nan());
        assert_eq!(all_nan, !value.is_finite(), "{value} gives {row:?}");
        // 1e30: the variance overflows, the row becomes the bias, which is finite.
        assert!(
            all_nan || row.iter().all(|x| x.is_finite()),
            "{value} gives {row:?}"
        );
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let [x, w, b] = sizes();
    let message = layer_norm(&x, &random("w", 36), &b)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("rows of 37") && message.contains("[36]"),
        "{message}"
    );
    let [x, w, b] = [x, w, b].map(|t| t.to_dtype(DType::F16).unwrap());
    let message = layer_norm(&x, &w, &b).unwrap_err().to_string();
    assert!(message.contains("f32 or f64, got F16"), "{message}");
}

//! The decoder's rows from constants, patches and the body.

use candle_core::Tensor;
use drape_model::kernels::features::{FeatureRow, features};

use crate::{POISON, bits, finite_differences, flat, ones_with, random};

/// Patch 1 is used twice, patch 2 and body row 0 never; row 1 sees no body.
fn rows() -> Vec<FeatureRow> {
    [(1u32, Some(1u32)), (0, None), (1, Some(2))]
        .into_iter()
        .enumerate()
        .map(|(i, (patch, body))| FeatureRow {
            state: std::array::from_fn(|k| (i * 12 + k) as f32),
            frame: std::array::from_fn(|r| {
                std::array::from_fn(|c| (i + 3 * r + c) as f32 * 0.25 - 1.0)
            }),
            patch,
            body,
        })
        .collect()
}

#[test]
fn equals_the_formula() {
    let inputs = [random("patches", (3, 3)), random("body", (3, 3))];
    let numbers: Vec<Vec<Vec<f64>>> = inputs.iter().map(|x| x.to_vec2().unwrap()).collect();
    let found = flat(&features(&inputs[0], &inputs[1], rows()).unwrap());
    for (row, found) in rows().iter().zip(found.chunks(18)) {
        let mut expected: Vec<f64> = row.state.iter().map(|&x| f64::from(x)).collect();
        for (input, index) in numbers.iter().zip([Some(row.patch), row.body]) {
            for axis in 0..3 {
                let frame = row.frame[axis].iter();
                expected.push(index.map_or(0.0, |index| {
                    let v = &input[index as usize];
                    frame.zip(v).map(|(&f, v)| f64::from(f) * v).sum()
                }));
            }
        }
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-14);
        }
    }
}

#[test]
fn gradients_equal_finite_differences() {
    finite_differences::check(
        &[random("patches", (3, 3)), random("body", (3, 3))],
        |t: &[Tensor]| features(&t[0], &t[1], rows()),
        1e-8,
    );
}

#[test]
fn poison_reaches_only_rows_that_use_it() {
    let body = ones_with(0.5, 3, 3, 0);
    let run = |value| features(&ones_with(value, 3, 3, 0), &body, rows()).unwrap();
    let clean = bits(&run(0.5));
    for value in POISON {
        for (row, (found, expected)) in
            (rows().iter()).zip(bits(&run(value)).chunks(18).zip(clean.chunks(18)))
        {
            assert!(row.patch == 0 || found == expected, "{value}");
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let [two, three] = [2usize, 3].map(|rows| random("x", (rows, 3)));
    for (patches, body) in [(&three, &two), (&two.narrow(0, 0, 1).unwrap(), &three)] {
        let message = features(patches, body, rows()).unwrap_err().to_string();
        assert!(message.contains("decoder-rows"), "{message}");
    }
}

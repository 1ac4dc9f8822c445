//! Means over consecutive rows.

use candle_core::DType;
use drape_model::kernels::segment_mean::segment_mean;

use crate::{POISON, bits, finite_differences, flat, ones_with, random};

/// Segments of 2, 0, 3 and 1 rows.
fn offsets() -> Vec<u32> {
    vec![0, 2, 2, 5, 6]
}

#[test]
fn equals_the_formula_and_an_empty_segment_gives_zero() {
    let x = random("x", (6, 4));
    let rows: Vec<Vec<f64>> = x.to_vec2().unwrap();
    let found = flat(&segment_mean(&x, offsets()).unwrap());
    for (segment, two) in offsets().windows(2).enumerate() {
        for column in 0..4 {
            let members = &rows[two[0] as usize..two[1] as usize];
            let sum: f64 = members.iter().map(|row| row[column]).sum();
            let expected = sum / (members.len() as f64 + 1e-7);
            assert!((found[4 * segment + column] - expected).abs() < 1e-14);
        }
    }
    assert_eq!(found[4..8], [0.0; 4]);
}

#[test]
fn gradients_equal_finite_differences() {
    finite_differences::check(
        &[random("x", (6, 4))],
        |t| segment_mean(&t[0], offsets()),
        1e-8,
    );
    finite_differences::check(
        &[random("x", (4, 6))],
        |t| segment_mean(&t[0].t()?, offsets()),
        1e-8,
    );
}

#[test]
fn poison_stays_in_its_segment() {
    let clean = segment_mean(&ones_with(0.5, 6, 4, 3), offsets()).unwrap();
    for value in POISON {
        let y = segment_mean(&ones_with(value, 6, 4, 3), offsets()).unwrap();
        for (segment, (found, expected)) in
            bits(&y).chunks(4).zip(bits(&clean).chunks(4)).enumerate()
        {
            assert_eq!(found[1..], expected[1..], "other columns");
            assert_eq!(
                found == expected,
                segment != 2,
                "{value}, segment {segment}"
            );
        }
        assert_eq!(flat(&y)[8].is_nan(), value.is_nan());
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let message = segment_mean(&random("x", (5, 4)), offsets())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("5 rows, offsets end at Some(6)"),
        "{message}"
    );
    let half = random("x", (6, 4)).to_dtype(DType::F16).unwrap();
    let message = segment_mean(&half, offsets()).unwrap_err().to_string();
    assert!(message.contains("f32 or f64, got F16"), "{message}");
}

#[test]
fn offsets_that_do_not_ascend_are_refused() {
    assert!(segment_mean(&random("x", (6, 4)), vec![0, 4, 2, 6]).is_err());
    assert!(
        segment_mean(&random("x", (6, 4)), vec![1, 6]).is_err(),
        "the first row would be lost"
    );
}

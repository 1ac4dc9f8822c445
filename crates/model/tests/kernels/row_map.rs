//! Fixed affine maps of 3-vectors per row.

use candle_core::{DType, Tensor};
use drape_model::kernels::row_map::{RowMap, map_rows};

use crate::{POISON, bits, finite_differences, flat, ones_with, random};

fn maps() -> Vec<RowMap> {
    // Row 1 is used twice, row 3 never.
    [2u32, 1, 0, 1]
        .into_iter()
        .enumerate()
        .map(|(i, index)| RowMap {
            index,
            matrix: std::array::from_fn(|r| {
                std::array::from_fn(|c| (i + 3 * r + c) as f32 * 0.25 - 1.0)
            }),
            offset: [i as f32, -1.0, 0.5],
        })
        .collect()
}

#[test]
fn equals_the_formula() {
    let x = random("x", (4, 3));
    let rows: Vec<Vec<f64>> = x.to_vec2().unwrap();
    let expected: Vec<f64> = maps()
        .iter()
        .flat_map(|map| {
            let v = rows[map.index as usize].clone();
            (0..3).map(move |r| {
                f64::from(map.offset[r])
                    + (0..3)
                        .map(|c| f64::from(map.matrix[r][c]) * v[c])
                        .sum::<f64>()
            })
        })
        .collect();
    for (found, expected) in flat(&map_rows(&x, maps()).unwrap()).iter().zip(&expected) {
        assert!((found - expected).abs() < 1e-14);
    }
}

#[test]
fn gradients_equal_finite_differences() {
    finite_differences::check(&[random("x", (4, 3))], |t| map_rows(&t[0], maps()), 1e-8);
    finite_differences::check(
        &[random("x", (3, 4))],
        |t| map_rows(&t[0].t()?, maps()),
        1e-8,
    );
}

#[test]
fn poison_reaches_only_maps_of_its_row() {
    let clean = map_rows(&ones_with(0.5, 4, 3, 1), maps()).unwrap();
    for value in POISON {
        let y = map_rows(&ones_with(value, 4, 3, 1), maps()).unwrap();
        let (found, expected) = (bits(&y), bits(&clean));
        for (map, row) in maps().iter().zip(0..4) {
            let same = found[3 * row..3 * row + 3] == expected[3 * row..3 * row + 3];
            assert_eq!(same, map.index != 1, "{value}, row {row}");
        }
        if value.is_nan() {
            assert!(flat(&y)[3..6].iter().all(|x| x.is_nan()));
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let message = map_rows(&random("x", (2, 3)), maps())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("input [2, 3]") && message.contains("every index below 2"),
        "{message}"
    );
    let message = map_rows(&random("x", (4, 2)), maps())
        .unwrap_err()
        .to_string();
    assert!(message.contains("expected width 3"), "{message}");
    let half: Tensor = random("x", (4, 3)).to_dtype(DType::F16).unwrap();
    let message = map_rows(&half, maps()).unwrap_err().to_string();
    assert!(message.contains("f32 or f64, got F16"), "{message}");
}

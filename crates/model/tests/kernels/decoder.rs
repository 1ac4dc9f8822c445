//! The decoder's layers and the mean per segment.

use candle_core::{DType, Result, Tensor};
use drape_model::kernels::decoder::{Segments, decode};
use drape_model::kernels::linear::{Activation, linear};

use crate::{POISON, bits, difference, finite_differences, flat, ones_with, random};

const INNER: usize = 4;
const HIDDEN: usize = 5;
const OUT: usize = 2;

/// Segments of 2, 0 and 3 rows that are averaged, and one of 1 row that is not.
fn segments() -> Segments {
    Segments {
        offsets: vec![0, 2, 2, 5, 6],
        means: 3,
    }
}

/// Weights of all layers, biases behind them; the second with the last.
fn layers() -> [Tensor; 2] {
    [
        random("first", HIDDEN * INNER + HIDDEN),
        random("second", (HIDDEN + OUT) * (HIDDEN + 1)),
    ]
}

/// The same on stock tensors.
fn plain(x: &Tensor, first: &Tensor, second: &Tensor, segments: &Segments) -> Result<Tensor> {
    let layer = |x: &Tensor, both: &Tensor, out: usize, activation| {
        let inner = x.dim(1)?;
        let weight = both.narrow(0, 0, out * inner)?;
        let bias = both.narrow(0, out * inner, out)?;
        linear(x, &weight.reshape((out, inner))?, &bias, activation)
    };
    let before = HIDDEN * (HIDDEN + 1);
    let (second, last) = (
        second.narrow(0, 0, before)?,
        second.narrow(0, before, OUT * (HIDDEN + 1))?,
    );
    let hidden = layer(x, first, HIDDEN, Activation::Relu)?;
    let hidden = layer(&hidden, &second, HIDDEN, Activation::Relu)?;
    let rows = segments
        .offsets
        .windows(2)
        .enumerate()
        .map(|(segment, two)| {
            let (start, length) = (two[0] as usize, (two[1] - two[0]) as usize);
            let sum = hidden.narrow(0, start, length)?.sum_keepdim(0)?;
            let divisor = if segment < segments.means {
                length as f64 + 1e-7
            } else {
                1.0
            };
            sum / divisor
        });
    let means = Tensor::cat(&rows.collect::<Result<Vec<_>>>()?, 0)?;
    layer(&means, &last, OUT, Activation::None)
}

#[test]
fn equals_the_layers_one_after_the_other() {
    let [first, second] = layers();
    // The small case, and many blocks of the kernel.
    let many = Segments {
        offsets: (0..=400u32).map(|i| i * i / 200).collect(),
        means: 390,
    };
    for segments in [segments(), many] {
        let rows = *segments.offsets.last().unwrap() as usize;
        let x = random("x", (rows, INNER));
        let found = decode(&x, &first, &second, segments.clone(), false).unwrap();
        let expected = plain(&x, &first, &second, &segments).unwrap();
        assert!(difference(&found, &expected) < 1e-14);
    }
    let x = random("x", (6, INNER));
    let found = flat(&decode(&x, &first, &second, segments(), false).unwrap());
    let bias = &flat(&second)[(HIDDEN + OUT) * (HIDDEN + 1) - OUT..];
    assert_eq!(found[OUT..2 * OUT], *bias, "an empty segment");
}

#[test]
fn gradients_equal_finite_differences() {
    let [first, second] = layers();
    finite_differences::check(
        &[random("x", (6, INNER)), first, second],
        |t| decode(&t[0], &t[1], &t[2], segments(), true),
        1e-8,
    );
}

#[test]
fn poison_stays_in_its_segment() {
    let [first, second] = layers().map(|layer| layer.to_dtype(DType::F32).unwrap());
    let run = |value| {
        let x = ones_with(value, 6, INNER, 3);
        decode(&x, &first, &second, segments(), true).unwrap()
    };
    let clean = bits(&run(0.5));
    for value in POISON {
        let y = run(value);
        for (segment, (found, expected)) in bits(&y).chunks(OUT).zip(clean.chunks(OUT)).enumerate()
        {
            assert!(
                segment == 2 || found == expected,
                "{value} in segment 2 shows in segment {segment}"
            );
        }
        if value.is_nan() {
            assert!(flat(&y)[2 * OUT].is_nan(), "ReLU hides a NaN");
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let [first, second] = layers();
    let refused = |x: &Tensor, second: &Tensor, segments: Segments| {
        decode(x, &first, second, segments, true)
            .unwrap_err()
            .to_string()
    };
    let x = random("x", (6, INNER));
    let offsets = |offsets: &[u32]| Segments {
        offsets: offsets.to_vec(),
        means: 1,
    };
    for bad in [&[0, 5][..], &[1, 6], &[0, 4, 2, 6], &[]] {
        let message = refused(&x, &second, offsets(bad));
        assert!(message.contains("6 rows"), "{message}");
    }
    let message = refused(&x, &first, segments());
    assert!(message.contains("rows of 4"), "{message}");
    let half = x.to_dtype(DType::F16).unwrap();
    let message = refused(&half, &second, segments());
    assert!(message.contains("f32 or f64, got F16"), "{message}");
}

#[test]
fn without_keeping_there_is_no_backward_pass() {
    let [first, second] = layers();
    let x = candle_core::Var::from_tensor(&random("x", (6, INNER))).unwrap();
    let y = decode(&x, &first, &second, segments(), false).unwrap();
    let error = y.sum_all().unwrap().backward().unwrap_err().to_string();
    assert!(error.contains("without keeping"), "{error}");
}

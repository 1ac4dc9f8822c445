//! Every kernel against a naive formula, central differences in f64, poisoned
//! inputs, strided inputs, refused types, and any number of threads.
//!
//! The attention's dense reference lives in the package `drape-tests`.

mod attention;
mod blocks;
mod decoder;
mod features;
mod finite_differences;
mod layer_norm;
mod linear;
mod row_map;
mod rows;
mod threads;

use candle_core::{Device, Shape, Tensor};
use drape_dataset::random::stream;
use rand::Rng;

/// Random f64 values in ±1, from a named stream.
fn random(name: &str, shape: impl Into<Shape>) -> Tensor {
    let shape = shape.into();
    let mut rng = stream(11, name);
    let values: Vec<f64> = (0..shape.elem_count())
        .map(|_| rng.random_range(-1.0..1.0))
        .collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor
        .to_dtype(candle_core::DType::F64)
        .unwrap()
        .flatten_all()
        .unwrap()
        .to_vec1()
        .unwrap()
}

/// Bits of an f32 tensor.
fn bits(tensor: &Tensor) -> Vec<u32> {
    let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
    values.into_iter().map(f32::to_bits).collect()
}

/// Largest difference over the largest reference value.
fn difference(found: &Tensor, reference: &Tensor) -> f64 {
    let (found, reference) = (flat(found), flat(reference));
    assert_eq!(found.len(), reference.len());
    let size = reference
        .iter()
        .fold(1e-300f64, |top, value| top.max(value.abs()));
    found
        .iter()
        .zip(&reference)
        .fold(0f64, |top, (a, b)| top.max((a - b).abs()))
        / size
}

/// An f32 matrix of ones with one row's first entry replaced.
fn ones_with(value: f32, rows: usize, width: usize, row: usize) -> Tensor {
    let mut all: Vec<f32> = (0..rows * width)
        .map(|i| 0.5 + (i % 7) as f32 * 0.1)
        .collect();
    all[row * width] = value;
    Tensor::from_vec(all, (rows, width), &Device::Cpu).unwrap()
}

/// Values that numbers go wrong with.
const POISON: [f32; 7] = [
    0.0,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::NAN,
    1e-42,
    1e30,
    -1e30,
];

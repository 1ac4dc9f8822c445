//! The blocks' weights: where each layer is, and products with it.
//!
//! r, q, s and the attention's output have their channels in the order of the attention's
//! passes. So have the rows or columns of the layers that make or read them, once arranged.

use std::sync::OnceLock;

use rayon::prelude::*;

use super::super::attention::{GROUP_PARAMETERS, GROUPS, WIDTH, place_of};
use super::super::layer_norm;
use super::super::product::{fill_rows, rows_times, transpose};
use super::super::{Real, for_all};
use super::workshop::Keep;

/// Width of the feed-forward layer.
pub(super) const HIDDEN: usize = 2 * WIDTH;

/// Which side of a layer is in the order of the attention's passes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    /// Neither.
    Plain,
    /// What comes out.
    Out,
    /// What goes in.
    In,
}

/// A layer's place among a block's weights.
#[derive(Clone, Copy)]
pub(super) struct Layer {
    pub(super) start: usize,
    pub(super) inner: usize,
    pub(super) out: usize,
    pub(super) bias: bool,
    order: Order,
}

impl Layer {
    pub(super) const fn len(self) -> usize {
        self.inner * self.out + if self.bias { self.out } else { 0 }
    }

    /// The place of a weight's number once it is arranged: `place(row, column)`.
    fn place(self, row: usize, column: usize) -> usize {
        match self.order {
            Order::Plain => row * self.inner + column,
            Order::Out => place_of(row) * self.inner + column,
            Order::In => row * self.inner + place_of(column),
        }
    }

    /// Puts an arranged weight's gradient into the weight's own order.
    pub(super) fn put_back<T: Real>(self, dw: &mut [T]) {
        if self.order != Order::Plain {
            let arranged = dw.to_vec();
            for row in 0..self.out {
                for column in 0..self.inner {
                    dw[row * self.inner + column] = arranged[self.place(row, column)];
                }
            }
        }
    }
}

const fn layer(start: usize, inner: usize, out: usize, bias: bool, order: Order) -> Layer {
    Layer {
        start,
        inner,
        out,
        bias,
        order,
    }
}

const fn end(layer: Layer) -> usize {
    layer.start + layer.len()
}

// The order of a block's weights, as [`super::apply`] says.
pub(super) const RECEIVER: Layer = layer(0, WIDTH, WIDTH, false, Order::Out);
pub(super) const QUERY: Layer = layer(end(RECEIVER), WIDTH, WIDTH, false, Order::Out);
pub(super) const SENDER: Layer = layer(end(QUERY), WIDTH, WIDTH, false, Order::Out);
pub(super) const MEMORY: Layer = layer(end(SENDER), WIDTH, WIDTH, false, Order::Out);
pub(super) const GROUPS_START: usize = end(MEMORY);
pub(super) const OUTPUT: Layer = layer(
    GROUPS_START + GROUPS * GROUP_PARAMETERS,
    WIDTH,
    WIDTH,
    true,
    Order::In,
);
pub(super) const RECEIVER_OUT: Layer = layer(end(OUTPUT), WIDTH, WIDTH, true, Order::In);
pub(super) const SENDER_OUT: Layer = layer(end(RECEIVER_OUT), WIDTH, WIDTH, true, Order::In);
pub(super) const FEED: [Layer; 2] = [
    layer(end(SENDER_OUT), WIDTH, HIDDEN, true, Order::Plain),
    layer(
        end(SENDER_OUT) + (WIDTH + 1) * HIDDEN,
        HIDDEN,
        WIDTH,
        true,
        Order::Plain,
    ),
];
pub(super) const NORMS_START: usize = end(FEED[1]);
pub(super) const NORMS: usize = 4;
/// Numbers of one block.
pub const BLOCK_PARAMETERS: usize = NORMS_START + NORMS * 2 * WIDTH;

/// Which layer a place belongs to.
#[derive(Clone, Copy)]
pub(super) enum Which {
    Receiver,
    Query,
    Sender,
    Memory,
    Output,
    ReceiverOut,
    SenderOut,
    Hidden,
    Fed,
}

/// All layers, in the weights' order.
pub(super) const LAYERS: [(Which, Layer); 9] = [
    (Which::Receiver, RECEIVER),
    (Which::Query, QUERY),
    (Which::Sender, SENDER),
    (Which::Memory, MEMORY),
    (Which::Output, OUTPUT),
    (Which::ReceiverOut, RECEIVER_OUT),
    (Which::SenderOut, SENDER_OUT),
    (Which::Hidden, FEED[0]),
    (Which::Fed, FEED[1]),
];

/// All blocks' weights, arranged, and their transposes at the same places.
#[derive(Debug, Default)]
pub(crate) struct Arranged<T> {
    all: Vec<T>,
    transposed: Vec<T>,
}

/// The blocks' weights arranged for the kernel, made once for as many calls as share them.
#[derive(Debug, Default)]
pub struct Transposes {
    pub(super) f32s: OnceLock<Arranged<f32>>,
    pub(super) f64s: OnceLock<Arranged<f64>>,
}

/// One block's arranged weights with their transposes at the same places.
pub(super) struct Weights<'a, T> {
    pub(super) all: &'a [T],
    pub(super) transposed: &'a [T],
}

impl<T: Real> Arranged<T> {
    fn new(parameters: &[T]) -> Self {
        let mut all = parameters.to_vec();
        let mut transposed = vec![T::zero(); parameters.len()];
        let blocks = (parameters.par_chunks_exact(BLOCK_PARAMETERS))
            .zip(all.par_chunks_exact_mut(BLOCK_PARAMETERS))
            .zip(transposed.par_chunks_exact_mut(BLOCK_PARAMETERS));
        for_all(
            blocks,
            |((weights, all), transposed): ((&[T], &mut [T]), &mut [T])| {
                for (_, layer) in LAYERS {
                    let at = layer.start..layer.start + layer.inner * layer.out;
                    if layer.order != Order::Plain {
                        let (weights, all) = (&weights[at.clone()], &mut all[at.clone()]);
                        for row in 0..layer.out {
                            for column in 0..layer.inner {
                                all[layer.place(row, column)] = weights[row * layer.inner + column];
                            }
                        }
                    }
                    transpose(&all[at.clone()], layer.inner, &mut transposed[at]);
                }
            },
        );
        Self { all, transposed }
    }
}

impl<'a, T: Keep> Weights<'a, T> {
    /// Weights of all blocks, arranged now if nobody did yet.
    pub(super) fn all(parameters: &'a [T], transposes: &'a Transposes) -> Vec<Self> {
        let arranged = T::transposes(transposes).get_or_init(|| Arranged::new(parameters));
        let blocks = arranged.all.chunks_exact(BLOCK_PARAMETERS);
        blocks
            .zip(arranged.transposed.chunks_exact(BLOCK_PARAMETERS))
            .map(|(all, transposed)| Weights { all, transposed })
            .collect()
    }
}

impl<'a, T: Real> Weights<'a, T> {
    pub(super) fn groups(&self) -> &'a [T] {
        &self.all[GROUPS_START..OUTPUT.start]
    }

    /// `y = x Wᵀ + b`.
    pub(super) fn forward(&self, layer: Layer, x: &[T], y: &mut [T]) {
        if layer.bias {
            let start = layer.start + layer.inner * layer.out;
            fill_rows(&self.all[start..start + layer.out], y);
        }
        self.product(layer, x, y, layer.bias);
    }

    /// `y += x Wᵀ`.
    pub(super) fn forward_add(&self, layer: Layer, x: &[T], y: &mut [T]) {
        self.product(layer, x, y, true);
    }

    fn product(&self, layer: Layer, x: &[T], y: &mut [T], keep: bool) {
        let size = layer.inner * layer.out;
        rows_times(
            x,
            &self.transposed[layer.start..][..size],
            layer.out,
            y,
            keep,
        );
    }

    /// `dx = dx·keep + g W`.
    pub(super) fn backward(&self, layer: Layer, g: &[T], dx: &mut [T], keep: bool) {
        let size = layer.inner * layer.out;
        rows_times(g, &self.all[layer.start..][..size], layer.inner, dx, keep);
    }

    fn norm(&self, index: usize) -> (&[T], &[T]) {
        self.all[NORMS_START + index * 2 * WIDTH..][..2 * WIDTH].split_at(WIDTH)
    }

    pub(super) fn norm_forward(&self, index: usize, x: &[T], y: &mut [T]) {
        let (w, b) = self.norm(index);
        layer_norm::run_forward(x, w, b, y);
    }

    /// `dx` from the norm's input x and its output's gradient; weight and bias gradients are added to `d`.
    pub(super) fn norm_backward(&self, index: usize, x: &[T], g: &[T], dx: &mut [T], d: &mut [T]) {
        let (dw, db) = d[index * 2 * WIDTH..][..2 * WIDTH].split_at_mut(WIDTH);
        layer_norm::run_backward(x, self.norm(index).0, g, dx, dw, db);
    }
}

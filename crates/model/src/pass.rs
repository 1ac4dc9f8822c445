//! One frame through the network, forward and back, in memory that the next frame uses again.
//!
//! candle holds the weights; what lies between the input and the accelerations lives here.
//! P patches and B body vertices are encoded by one encoder, A attribute rows, wind and gravity by
//! their own, into `encoded [P + B + A + 2, 128]`. Tokens `[P + A + G, 128]` are its rows that send:
//! patches, attributes, then G body tokens (vertices, wind, gravity). Their norm, the patches'
//! receivers and all senders go through the blocks; what comes out and `encoded` are cut to
//! three numbers a row, turned into each receiver's frame, decoded, and turned back.
//! The backward pass mirrors this, kernel by kernel.

use candle_core::{Device, Tensor, WithDType};
use drape_dataset::sample::{Outfit, StatePair, Step};
use drape_dataset::statistics::ColumnStatistics;
use rayon::prelude::*;

use crate::config::OutputScale;
use crate::error::Result;
use crate::evaluation::ForwardSeconds;
use crate::frames::transposed;
use crate::graph::{FrameGraph, refill, turned};
use crate::kernels::attention::WIDTH;
use crate::kernels::blocks::{Ends, Keep, Workshop};
use crate::kernels::decoder::{Room, Segments};
use crate::kernels::features::{self, FeatureRow, put_together, take_apart};
use crate::kernels::layer_norm::{norm_first, norm_first_backward};
use crate::kernels::linear::{Activation, Passed, affine_rows};
use crate::kernels::product::add;
use crate::kernels::row_map::RowMap;
use crate::kernels::rows::take;
use crate::kernels::{Real, fit, for_all, shelved, values};
use crate::layersnet::{Encoder, Gradients, LayersNet, Norm};

/// Decoder rows that one thread puts together at a time.
const PIECE: usize = 512;

/// Buffers of one frame; the names are those of the module's description.
#[derive(Default)]
pub(crate) struct Pass<T: 'static> {
    pub(crate) graph: FrameGraph,
    /// Accelerations of vertices, their own part of it, and of patches: `[N, 3]` twice, `[P, 3]`.
    pub(crate) acceleration: Vec<T>,
    pub(crate) relative: Vec<T>,
    pub(crate) patch_acceleration: Vec<T>,
    /// Patch tokens after the last block.
    pub(crate) embedding: Vec<T>,
    /// Inputs of the four encoders, and what lies between the layers of all six.
    inputs: [Vec<T>; 4],
    hidden: [Vec<T>; 6],
    encoded: Vec<T>,
    order: Vec<u32>,
    tokens: Vec<T>,
    received: Vec<T>,
    sent: Vec<T>,
    /// Z, R and S, which the blocks keep themselves; on the way back their gradients.
    normed: [Vec<T>; 3],
    workshop: Workshop<T>,
    patch_numbers: Vec<T>,
    body_numbers: Vec<T>,
    rows: Vec<FeatureRow>,
    features: Vec<T>,
    segments: Segments,
    decoder: Room<T>,
    local: Vec<T>,
    trend: Vec<[f32; 3]>,
    back: Vec<RowMap>,
    d: Backward<T>,
}

/// Gradients of what has the same name in [`Pass`].
#[derive(Default)]
struct Backward<T> {
    world: Vec<T>,
    local: Vec<T>,
    features: Vec<T>,
    patch_numbers: Vec<T>,
    body_numbers: Vec<T>,
    embedding: Vec<T>,
    received: Vec<T>,
    sent: Vec<T>,
    tokens: Vec<T>,
    encoded: Vec<T>,
    hidden: Vec<T>,
    norm: Vec<T>,
}

shelved!(Box<Pass<f32>>);
shelved!(Box<Pass<f64>>);

/// Where things are in `encoded`.
struct Rows {
    patches: usize,
    /// P + B.
    states: usize,
    attributes: usize,
}

impl Rows {
    /// Starts of the four encoders' rows, and the end.
    fn starts(&self) -> [usize; 5] {
        let forces = self.states + self.attributes;
        [0, self.states, forces, forces + 1, forces + 2]
    }

    /// Patches and attributes: the tokens that a norm is for.
    fn particles(&self) -> usize {
        self.patches + self.attributes
    }
}

fn constant<T: Real>(rows: &[f32], to: &mut Vec<T>) {
    refill(to, rows.iter().map(|&value| T::of(f64::from(value))));
}

/// Zeros in a buffer's memory.
fn zeros<T: Real>(buffer: &mut Vec<T>, len: usize) -> &mut [T] {
    let buffer = fit(buffer, len);
    buffer.fill(T::zero());
    buffer
}

impl<T: Keep> Pass<T> {
    fn places(&self, outfit_attributes: usize) -> Rows {
        Rows {
            patches: self.graph.patch_states.len(),
            states: self.graph.patch_states.len() + self.graph.body_rows.len(),
            attributes: outfit_attributes,
        }
    }

    /// Accelerations of one frame; see [`LayersNet::evaluate`].
    pub(crate) fn forward(
        &mut self,
        net: &LayersNet,
        outfit: &Outfit,
        statistics: &ColumnStatistics,
        state: &[StatePair],
        step: &Step,
        lap: &mut dyn FnMut() -> f64,
    ) -> Result<ForwardSeconds> {
        let mut seconds = ForwardSeconds::default();
        self.graph.derive(&net.config, outfit, state, step)?;
        seconds.graph = lap();
        self.encode(net, outfit, statistics, step)?;
        seconds.encoders = lap();
        let stack = net.blocks.stack(&self.graph.edges, Ends::Patches);
        stack.forward(
            self.normed.each_ref().map(Vec::as_slice),
            &values::<T>(net.blocks.weights())?,
            &mut self.workshop,
            &mut self.embedding,
        );
        // The graph's edges shall be its own again.
        drop(stack);
        seconds.blocks = lap();
        self.decode(net, state, step)?;
        self.integrate(net, outfit, statistics, state, step);
        seconds.decoder = lap();
        Ok(seconds)
    }

    fn encode(
        &mut self,
        net: &LayersNet,
        outfit: &Outfit,
        statistics: &ColumnStatistics,
        step: &Step,
    ) -> Result<()> {
        let rows = self.places(outfit.attributes.len());
        let normalise = |row: &StatePair| {
            let row = *row;
            (0..row.len()).map(move |i| {
                let value = (row[i] - statistics.mean[i % 6]) / statistics.std[i % 6];
                T::of(f64::from(value))
            })
        };
        let [states, attributes, wind, gravity] = &mut self.inputs;
        let body = self.graph.body_rows.iter();
        let body = body.map(|&vertex| &step.body[vertex as usize]);
        let all = self.graph.patch_states.iter().chain(body);
        refill(states, all.flat_map(normalise));
        constant(outfit.attributes.as_flattened(), attributes);
        constant(&step.wind, wind);
        constant(&step.gravity, gravity);
        let starts = rows.starts();
        let encoded = fit(&mut self.encoded, starts[4] * WIDTH);
        let encoders = net.encoders().into_iter().zip(&self.inputs);
        for (index, ((encoder, x), hidden)) in encoders.zip(&mut self.hidden).enumerate() {
            let own = starts[index] * WIDTH..starts[index + 1] * WIDTH;
            encoder.forward(x, hidden, &mut encoded[own])?;
        }

        let (patches, attributes) = (rows.patches, starts[1]..starts[2]);
        let body = patches..patches + self.graph.body_tokens;
        let order = (0..patches).chain(attributes).chain(body);
        let order = order.chain(starts[2]..starts[4]).map(|row| row as u32);
        refill(&mut self.order, order);
        let tokens = fit(&mut self.tokens, self.order.len() * WIDTH);
        take([&self.encoded, &[]], &self.order, WIDTH, tokens);
        let received = fit(&mut self.received, patches * WIDTH);
        let [.., receiver_hidden, sender_hidden] = &mut self.hidden;
        net.receiver
            .forward(&tokens[..received.len()], receiver_hidden, received)?;
        let sent = fit(&mut self.sent, tokens.len());
        net.sender.forward(tokens, sender_hidden, sent)?;
        let [z, r, s] = &mut self.normed;
        net.particle_norm.forward(tokens, rows.particles(), z)?;
        net.receiver_norm.forward(received, patches, r)?;
        net.sender_norm.forward(sent, self.order.len(), s)
    }

    fn decode(&mut self, net: &LayersNet, state: &[StatePair], step: &Step) -> Result<()> {
        let graph = &self.graph;
        let (patches, pairs) = (graph.patch_states.len(), graph.slots.len());
        // Three numbers per patch and per body vertex, turned into each receiver's frame.
        let rotation = values::<T>(&net.rotation_transposed)?;
        let numbers = |x: &[T], to: &mut Vec<T>| {
            let to = fit(to, x.len() / WIDTH * 3);
            affine_rows(x, &rotation, None, WIDTH, Activation::None, to);
        };
        numbers(&self.embedding, &mut self.patch_numbers);
        // Of all states: cheaper than cutting out the body's, which come after the patches'.
        let states = patches + graph.body_rows.len();
        numbers(&self.encoded[..states * WIDTH], &mut self.body_numbers);
        let row = |index: usize| -> FeatureRow {
            let (patch, anchor, state) = match graph.slots.get(index) {
                Some(slot) => {
                    let anchor = &graph.vertex_anchors[slot.vertex as usize];
                    let vertex = &state[slot.vertex as usize];
                    let patch = &graph.patch_states[slot.patch as usize];
                    let relative = std::array::from_fn(|i| vertex[i] - patch[i]);
                    (slot.patch, anchor, turned(&relative, anchor))
                }
                None => {
                    let patch = index - pairs;
                    let relative = graph.patch_on_body(patch, step);
                    (patch as u32, &graph.patch_anchors[patch], relative)
                }
            };
            FeatureRow {
                state,
                frame: anchor.frame,
                patch,
                body: anchor.row.map(|row| patches as u32 + row),
            }
        };
        let rows = fit(&mut self.rows, pairs + patches);
        for_all(
            rows.par_chunks_mut(PIECE).enumerate(),
            |(piece, rows): (usize, &mut [FeatureRow])| {
                for (index, to) in (piece * PIECE..).zip(rows) {
                    *to = row(index);
                }
            },
        );
        let features = fit(&mut self.features, self.rows.len() * features::WIDTH);
        put_together(
            &self.rows,
            &self.patch_numbers,
            &self.body_numbers,
            features,
        );
        // The last layer is linear, so the mean over a vertex's patches is taken before it;
        // a patch has one row of its own.
        let own_rows = (1..=patches).map(|patch| (pairs + patch) as u32);
        let offsets = graph.slot_offsets.iter().copied().chain(own_rows);
        refill(&mut self.segments.offsets, offsets);
        self.segments.means = state.len();
        let [first, others] = [values::<T>(&net.decoder[0])?, values::<T>(&net.decoder[1])?];
        let sizes = self.segments.sizes(
            &(self.rows.len(), features::WIDTH).into(),
            first.len(),
            others.len(),
        )?;
        self.segments.forward(
            features,
            (&first, &others),
            sizes,
            net.trainable,
            &mut self.decoder,
            &mut self.local,
        );
        Ok(())
    }

    fn integrate(
        &mut self,
        net: &LayersNet,
        outfit: &Outfit,
        statistics: &ColumnStatistics,
        state: &[StatePair],
        step: &Step,
    ) {
        let (graph, vertices) = (&self.graph, state.len());
        let columns = match net.config.output_scale {
            OutputScale::Velocity => 3,
            OutputScale::Acceleration => 6,
        };
        let mean = [0, 1, 2].map(|axis| statistics.mean[columns + axis]);
        let std = [0, 1, 2].map(|axis| statistics.std[columns + axis]);
        graph.trend_again(&statistics.trend, outfit, state, step, &mut self.trend);
        let anchors = graph.vertex_anchors.iter().chain(&graph.patch_anchors);
        let back = anchors
            .zip(&self.trend)
            .enumerate()
            .map(|(index, (anchor, trend))| {
                let r = transposed(&anchor.frame);
                // A vertex whose four candidates are all refused (coincident centres) takes its
                // own patch's motion only: no mean, so not the last layer's bias either.
                let refused =
                    index < vertices && graph.slot_offsets[index] == graph.slot_offsets[index + 1];
                let scale = |axis: usize| if refused { 0.0 } else { std[axis] };
                let matrix = [0, 1, 2].map(|axis| r[axis].map(|value| value * scale(axis)));
                RowMap {
                    index: index as u32,
                    matrix,
                    offset: [0, 1, 2].map(|axis| mean[axis] + trend[axis]),
                }
            });
        refill(&mut self.back, back);
        let (relative, patches) = (
            fit(&mut self.relative, 3 * vertices),
            fit(&mut self.patch_acceleration, 3 * graph.patch_states.len()),
        );
        let local = self.local.chunks_exact(3);
        let to = relative
            .chunks_exact_mut(3)
            .chain(patches.chunks_exact_mut(3));
        for ((map, local), to) in self.back.iter().zip(local).zip(to) {
            to.copy_from_slice(&map.apply(local));
        }
        let own = graph.own_patch.iter().map(|&own| own as usize);
        let all = relative
            .chunks_exact(3)
            .zip(own)
            .flat_map(|(relative, own)| {
                [0, 1, 2].map(|axis| relative[axis] + patches[3 * own + axis])
            });
        refill(&mut self.acceleration, all);
    }

    /// Gradients of all weights that the frame's accelerations depend on, from those of the
    /// vertices' and of the patches' accelerations.
    pub(crate) fn backward(
        &mut self,
        net: &LayersNet,
        by_vertex: &[[f64; 3]],
        by_patch: &[[f64; 3]],
        gradients: &mut Gradients,
    ) -> Result<()> {
        let graph = &self.graph;
        let (vertices, patches) = (by_vertex.len(), by_patch.len());
        let rows = self.places(self.inputs[1].len() / net.attributes.inner()?);
        let graph_rows = rows.states;

        let d = &mut self.d;

        // Accelerations: a vertex's is its own part and its own patch's.
        let all = by_vertex.iter().chain(by_patch).flatten();
        refill(&mut d.world, all.map(|&value| T::of(value)));
        let (d_vertices, d_patches) = d.world.split_at_mut(3 * vertices);
        for (d, &own) in d_vertices.chunks_exact(3).zip(&graph.own_patch) {
            for axis in 0..3 {
                d_patches[3 * own as usize + axis] += d[axis];
            }
        }
        let d_local = zeros(&mut d.local, d.world.len());
        let d_world = d.world.chunks_exact(3);
        for ((map, d_world), d) in self
            .back
            .iter()
            .zip(d_world)
            .zip(d_local.chunks_exact_mut(3))
        {
            map.add_back(d_world, d);
        }

        // Decoder.
        let [first, others] = [values::<T>(&net.decoder[0])?, values::<T>(&net.decoder[1])?];
        let shape = (self.rows.len(), features::WIDTH).into();
        let sizes = self.segments.sizes(&shape, first.len(), others.len())?;
        let d_features = fit(&mut d.features, self.features.len());
        let [mut d_first, mut d_others] = [first.len(), others.len()].map(|n| vec![T::zero(); n]);
        self.segments.backward(
            (&self.features, &first, &others),
            sizes,
            d_local,
            self.decoder.kept(),
            [d_features, &mut d_first, &mut d_others],
        );
        let d_patch_numbers = zeros(&mut d.patch_numbers, 3 * patches);
        let d_body_numbers = zeros(&mut d.body_numbers, 3 * graph_rows);
        take_apart(&self.rows, d_features, d_patch_numbers, d_body_numbers);
        let rotation = values::<T>(&net.rotation)?;
        let d_encoded = zeros(&mut d.encoded, self.encoded.len());
        let d_embedding = fit(&mut d.embedding, self.embedding.len());
        let mut d_rotation = vec![T::zero(); rotation.len()];
        let mut part = vec![T::zero(); rotation.len()];
        let states = graph_rows * WIDTH;
        let cut = |x, y, g: &mut [T], dx, dw| {
            let passed = Passed {
                x,
                weight: &rotation,
                y,
                inner: WIDTH,
                out: 3,
                activation: Activation::None,
            };
            passed.backward(g, Some(dx), Some(dw), None);
        };
        cut(
            &self.embedding,
            &self.patch_numbers,
            d_patch_numbers,
            d_embedding,
            &mut d_rotation,
        );
        let d_states = &mut d_encoded[..states];
        // What the decoder leaves here, the tokens' gradients are added to.
        cut(
            &self.encoded[..states],
            &self.body_numbers,
            d_body_numbers,
            d_states,
            &mut part,
        );
        add(&part, &mut d_rotation);
        net.decoder_gradients([d_first, d_others, d_rotation], gradients)?;

        // Blocks.
        let mut d_blocks = vec![T::zero(); net.blocks.weights().elem_count()];
        let [d_z, d_r, d_s] = &mut self.normed;
        let to = [
            fit(d_z, self.tokens.len()),
            fit(d_r, self.received.len()),
            fit(d_s, self.tokens.len()),
        ];
        let stack = net.blocks.stack(&graph.edges, Ends::Patches);
        stack.backward(
            &values::<T>(net.blocks.weights())?,
            &mut self.workshop,
            d_embedding,
            to,
            &mut d_blocks,
        );
        drop(stack);
        let count = d_blocks.len();
        let d_blocks = Tensor::from_vec(d_blocks, count, &Device::Cpu)?;
        gradients
            .all
            .extend(net.blocks.by_name(gradients.parameters, &d_blocks)?);

        // Norms, receivers and senders.
        let [d_z, d_r, d_s] = &mut self.normed;
        let norm = &mut d.norm;
        let d_tokens = fit(&mut d.tokens, self.tokens.len());
        let particles = rows.particles();
        let particle_norm = &net.particle_norm;
        particle_norm.backward(&self.tokens, particles, d_z, norm, d_tokens, gradients)?;
        let d_received = fit(&mut d.received, self.received.len());
        net.receiver_norm
            .backward(&self.received, patches, d_r, norm, d_received, gradients)?;
        let d_sent = fit(&mut d.sent, self.sent.len());
        let sent = self.order.len();
        net.sender_norm
            .backward(&self.sent, sent, d_s, norm, d_sent, gradients)?;
        let [.., receiver_hidden, sender_hidden] = &self.hidden;
        let own = patches * WIDTH;
        // Of no use any more: room for what is added to the tokens' gradients.
        let (from_receivers, from_senders) = (d_r, d_s);
        net.receiver.backward(
            (&self.tokens[..own], receiver_hidden, &self.received),
            d_received,
            &mut d.hidden,
            Some(from_receivers),
            gradients,
        )?;
        add(from_receivers, &mut d_tokens[..own]);
        net.sender.backward(
            (&self.tokens, sender_hidden, &self.sent),
            d_sent,
            &mut d.hidden,
            Some(from_senders),
            gradients,
        )?;
        add(from_senders, d_tokens);

        // Encoders.
        for (&row, d) in self.order.iter().zip(d_tokens.chunks_exact(WIDTH)) {
            add(d, &mut d_encoded[row as usize * WIDTH..][..WIDTH]);
        }
        let starts = rows.starts();
        let encoders = net.encoders().into_iter().zip(&self.inputs);
        for (index, ((encoder, x), hidden)) in encoders.zip(&self.hidden).enumerate() {
            let own = starts[index] * WIDTH..starts[index + 1] * WIDTH;
            encoder.backward(
                (x, hidden, &self.encoded[own.clone()]),
                &mut d_encoded[own],
                &mut d.hidden,
                None,
                gradients,
            )?;
        }
        Ok(())
    }
}

impl Encoder {
    /// Both layers' rows, the first's into `hidden`.
    fn forward<T: Real>(&self, x: &[T], hidden: &mut Vec<T>, y: &mut [T]) -> Result<()> {
        let rows = x.len() / self.first.inner()?;
        let hidden = fit(hidden, rows * self.second.inner()?);
        self.first.forward(x, hidden)?;
        self.second.forward(hidden, y)
    }

    /// Gradients of both layers, and of x where `dx` asks for it, from that of y, which is masked.
    fn backward<T: Real>(
        &self,
        (x, hidden, y): (&[T], &[T], &[T]),
        g: &mut [T],
        d_hidden: &mut Vec<T>,
        dx: Option<&mut [T]>,
        gradients: &mut Gradients,
    ) -> Result<()> {
        let d_hidden = fit(d_hidden, hidden.len());
        self.second
            .backward(hidden, y, g, Some(d_hidden), gradients)?;
        self.first.backward(x, hidden, d_hidden, dx, gradients)
    }
}

impl Norm {
    /// The norm of the first `rows` rows; the others are copied.
    fn forward<T: Real>(&self, x: &[T], rows: usize, y: &mut Vec<T>) -> Result<()> {
        let (w, b) = (values::<T>(&self.weight)?, values::<T>(&self.bias)?);
        norm_first(x, rows, &w, &b, fit(y, x.len()));
        Ok(())
    }

    fn backward<T: Real>(
        &self,
        x: &[T],
        rows: usize,
        g: &[T],
        room: &mut Vec<T>,
        dx: &mut [T],
        gradients: &mut Gradients,
    ) -> Result<()> {
        let w = values::<T>(&self.weight)?;
        let [mut dw, mut db] = [(); 2].map(|()| vec![T::zero(); w.len()]);
        norm_first_backward((x, rows, &w), g, room, [dx, &mut dw, &mut db]);
        gradients.add(&self.name, "weight", dw, w.len())?;
        gradients.add(&self.name, "bias", db, w.len())
    }
}

impl Gradients<'_> {
    /// A layer's gradient.
    pub(crate) fn add<T: WithDType>(
        &mut self,
        layer: &str,
        kind: &str,
        values: Vec<T>,
        shape: impl Into<candle_core::Shape>,
    ) -> Result<()> {
        let gradient = Tensor::from_vec(values, shape.into(), &Device::Cpu)?;
        self.all.insert(format!("{layer}.{kind}"), gradient);
        Ok(())
    }
}

//! Start states that have swayed: smooth errors as long rollouts make them.
//!
//! After thirty frames a predicted outfit is whole but stands centimetres from where
//! it should be: small errors of acceleration that are alike over a garment add up,
//! while rough ones die out. Few steps without gradient do not get there. So a
//! sample's state is shifted by a smooth field, and the loss shows the way back
//! ([`crate::losses::returning`]). Field: one vector for the outfit, one for each
//! garment, and two waves of 30 to 100 cm, for positions and, apart, for velocities.

use std::f32::consts::TAU;

use drape_dataset::random::stream;
use drape_dataset::sample::{Outfit, StatePair};
use rand::Rng;

use crate::config::TrainConfig;

/// Velocity of the sway, of its size per frame. A rollout drifts more slowly, but what
/// ends a drift is how firmly a wrong velocity is answered, and this teaches it.
const PER_FRAME: f32 = 1.0 / 4.0;
/// Wave numbers in 1/unit: wavelengths of 3 to 10 units.
const WAVES: std::ops::Range<f32> = TAU / 10.0..TAU / 3.0;

type Vector = [f32; 3];

/// A vector in the cube of ±1.
fn vector(rng: &mut impl Rng) -> Vector {
    std::array::from_fn(|_| rng.random_range(-1.0..1.0))
}

/// A smooth field of size one.
struct Field {
    /// Shift of each garment.
    shifts: Vec<Vector>,
    /// Amplitude, wave vector and phase.
    waves: [(Vector, Vector, f32); 2],
}

impl Field {
    fn new(garments: usize, rng: &mut impl Rng) -> Self {
        let common = vector(rng);
        let shifts = (0..garments)
            .map(|_| {
                let own = vector(rng);
                std::array::from_fn(|axis| common[axis] + 0.5 * own[axis])
            })
            .collect();
        let waves = std::array::from_fn(|_| {
            let direction = vector(rng);
            let length = direction
                .iter()
                .map(|x| x * x)
                .sum::<f32>()
                .sqrt()
                .max(1e-3);
            let number = rng.random_range(WAVES) / length;
            (
                vector(rng).map(|x| 0.5 * x),
                direction.map(|x| x * number),
                rng.random_range(0.0..TAU),
            )
        });
        Self { shifts, waves }
    }

    fn at(&self, garment: usize, x: Vector) -> Vector {
        let mut value = self.shifts[garment];
        for (amplitude, wave, phase) in &self.waves {
            let along: f32 = wave.iter().zip(x).map(|(k, x)| k * x).sum();
            let swing = (along + phase).sin();
            for axis in 0..3 {
                value[axis] += amplitude[axis] * swing;
            }
        }
        value
    }
}

/// Shifts a state; `size` in units is the largest shift of an outfit along an axis.
/// Each sample draws its own share of it, so that some stay nearly where they are.
pub fn sway(state: &mut [StatePair], outfit: &Outfit, size: f32, rng: &mut impl Rng) {
    let size = size * rng.random_range(0.0..1.0f32);
    let fields = [0, 1].map(|_| Field::new(outfit.garments(), rng));
    for garment in 0..outfit.garments() {
        let vertices = outfit.garment_offsets[garment]..outfit.garment_offsets[garment + 1];
        for row in &mut state[vertices] {
            let x = [row[0], row[1], row[2]];
            let (shift, drift) = (fields[0].at(garment, x), fields[1].at(garment, x));
            for axis in 0..3 {
                let (shift, drift) = (size * shift[axis], size * PER_FRAME * drift[axis]);
                row[axis] += shift;
                row[3 + axis] += drift;
                // The older frame: one step of the drift before.
                row[6 + axis] += shift - drift;
                row[9 + axis] += drift;
            }
        }
    }
}

/// Shifts a draw's state by the configuration's sway, if any, from the random stream `label`.
pub fn sway_of_draw(config: &TrainConfig, state: &mut [StatePair], outfit: &Outfit, label: &str) {
    let size = config.schedule.sway;
    if size > 0.0 {
        sway(state, outfit, size, &mut stream(config.seed, label));
    }
}

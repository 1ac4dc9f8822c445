//! Hold: every vertex keeps the velocity it has at the start, in the root's
//! moving frame.
//!
//! With `p_f = R_fᵀ (x_f − t_f)` the position in the root's frame at time `f`
//! and `v = p_s − p_{s−1}` at the start frame `s`, step `k` predicts
//! `p_{s+k} = p_s + k·v`, that is `x + v` step by step with a constant `v`.

use super::root_frame::{to_root, to_world};
use crate::{
    EvalError,
    method::Method,
    task::{Positions, Task},
};

/// Garments that keep their velocity.
#[derive(Default)]
pub struct Hold {
    position: Vec<Vec<[f64; 3]>>,
    velocity: Vec<Vec<[f64; 3]>>,
}

impl Method for Hold {
    fn name(&self) -> &str {
        "hold"
    }

    fn threads(&self) -> usize {
        1
    }

    fn begin(&mut self, task: &Task) -> Result<(), EvalError> {
        let local = |frame: usize| {
            let frame = &task.frames[frame];
            to_root(&frame.root, &frame.garments)
        };
        let older = local(task.start - 1);
        self.position = local(task.start);
        self.velocity = combine(&self.position, &older, |now, before| now - before);
        Ok(())
    }

    fn step(&mut self, task: &Task, frame: usize) -> Result<Vec<Positions>, EvalError> {
        self.position = combine(&self.position, &self.velocity, |position, velocity| {
            position + velocity
        });
        Ok(to_world(&task.frames[frame].root, &self.position))
    }
}

fn combine(a: &[Vec<[f64; 3]>], b: &[Vec<[f64; 3]>], f: fn(f64, f64) -> f64) -> Vec<Vec<[f64; 3]>> {
    let garment = |a: &Vec<[f64; 3]>, b: &Vec<[f64; 3]>| {
        a.iter()
            .zip(b)
            .map(|(a, b)| [f(a[0], b[0]), f(a[1], b[1]), f(a[2], b[2])])
            .collect()
    };
    a.iter().zip(b).map(|(a, b)| garment(a, b)).collect()
}

//! From frames to numbers of a table row: mean ± population standard deviation
//! over all frames of all rollouts.
//!
//! How the paper counts:
//! - a frame's overall error and H-collision are weighted by vertices: one value
//!   per frame over all garment vertices;
//! - a kind's value in a frame is the mean over its garments of that kind (each
//!   garment's own mean first); frames without the kind do not count;
//! - a frame's overall L-collision is divided by *all* garment vertices, inner
//!   ones included, while the value per outer kind is divided by the vertices of
//!   that outer garment. The odd divisor is the published evaluation's; it is
//!   kept as `l_collision` so that numbers compare with the paper's, and
//!   `l_collision_of_outer` has the outer garments' vertices as divisor.

use std::collections::BTreeMap;

use drape_dataset::registry::GarmentKind;
use serde::Serialize;

use crate::metrics::{FrameScore, GarmentScore};

/// Mean and population standard deviation over frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistic {
    /// Mean.
    pub mean: f64,
    /// Population standard deviation.
    pub std: f64,
    /// Number of frames.
    pub frames: usize,
}

impl Statistic {
    /// Statistic of `values`; `None` when there are none.
    pub fn of(values: &[f64]) -> Option<Self> {
        if values.is_empty() {
            return None;
        }
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values
            .iter()
            .map(|value| (value - mean).powi(2))
            .sum::<f64>()
            / count;
        Some(Self {
            mean,
            std: variance.sqrt(),
            frames: values.len(),
        })
    }

    /// The statistic in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            mean: self.mean * factor,
            std: self.std * factor,
            ..self
        }
    }
}

/// Values of all frames so far.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    overall: Values,
    outer_share: Vec<f64>,
    kinds: BTreeMap<GarmentKind, Values>,
}

#[derive(Clone, Debug, Default)]
struct Values {
    error_m: Vec<f64>,
    inside_body: Vec<f64>,
    inside_inner: Vec<f64>,
}

/// Errors in real metres, collisions as shares (0–1), over all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// All garments; L-collision with the paper's divisor.
    pub overall: Measures,
    /// L-collision divided by the outer garments' vertices.
    pub l_collision_of_outer: Option<Statistic>,
    /// Each kind that occurs.
    pub kinds: BTreeMap<GarmentKind, Measures>,
}

/// The three measures of one column group.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measures {
    /// Euclidean error in real metres.
    pub error_m: Option<Statistic>,
    /// Share of vertices inside the body.
    pub h_collision: Option<Statistic>,
    /// Share of vertices inside inner garments.
    pub l_collision: Option<Statistic>,
}

impl Tally {
    /// Adds one frame.
    pub fn add(&mut self, frame: &FrameScore) {
        let vertices = frame
            .garments
            .iter()
            .map(|garment| garment.vertices)
            .sum::<usize>() as f64;
        if vertices == 0.0 {
            return;
        }
        let weighted = |value: fn(&GarmentScore) -> f64| {
            frame.garments.iter().map(value).sum::<f64>() / vertices
        };
        self.overall.error_m.push(weighted(|garment| {
            garment.error_m * garment.vertices as f64
        }));
        self.overall
            .inside_body
            .push(weighted(|garment| garment.inside_body as f64));

        let outer: Vec<_> = frame
            .garments
            .iter()
            .filter_map(|garment| Some((garment.inside_inner?, garment.vertices)))
            .collect();
        if !outer.is_empty() {
            let inside = outer.iter().map(|(inside, _)| inside).sum::<usize>() as f64;
            self.overall.inside_inner.push(inside / vertices);
            self.outer_share
                .push(inside / outer.iter().map(|(_, count)| count).sum::<usize>() as f64);
        }

        let mut kinds: BTreeMap<GarmentKind, Vec<&GarmentScore>> = BTreeMap::new();
        for garment in frame.garments.iter().filter(|garment| garment.vertices > 0) {
            kinds.entry(garment.kind).or_default().push(garment);
        }
        for (kind, garments) in kinds {
            let values = self.kinds.entry(kind).or_default();
            let share =
                |count: usize, garment: &GarmentScore| count as f64 / garment.vertices as f64;
            push_mean(
                &mut values.error_m,
                garments.iter().map(|garment| garment.error_m),
            );
            push_mean(
                &mut values.inside_body,
                garments
                    .iter()
                    .map(|garment| share(garment.inside_body, garment)),
            );
            let inner = garments
                .iter()
                .filter_map(|garment| Some(share(garment.inside_inner?, garment)));
            push_mean(&mut values.inside_inner, inner);
        }
    }

    /// Statistics over the frames so far.
    pub fn summary(&self) -> Summary {
        Summary {
            overall: self.overall.measures(),
            l_collision_of_outer: Statistic::of(&self.outer_share),
            kinds: self
                .kinds
                .iter()
                .map(|(kind, values)| (*kind, values.measures()))
                .collect(),
        }
    }
}

impl Values {
    fn measures(&self) -> Measures {
        Measures {
            error_m: Statistic::of(&self.error_m),
            h_collision: Statistic::of(&self.inside_body),
            l_collision: Statistic::of(&self.inside_inner),
        }
    }
}

/// Pushes the mean of `values`; nothing when there are none.
fn push_mean(into: &mut Vec<f64>, values: impl Iterator<Item = f64>) {
    let values: Vec<f64> = values.collect();
    into.extend(Statistic::of(&values).map(|statistic| statistic.mean));
}

#[cfg(test)]
mod tests;

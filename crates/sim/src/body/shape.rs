//! Body shape: MakeHuman's macro parameters and the blend weights they mean.

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Macro parameters, each in 0–1 with 0.5 the average.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// 0 female, 1 male.
    pub sex: f64,
    /// 0 thin, 1 fat.
    pub weight: f64,
    /// 0 slack, 1 athlete.
    pub muscle: f64,
    /// 0 short, 1 tall.
    pub height: f64,
    /// 0 uncommon, 1 ideal.
    pub proportions: f64,
}

impl Default for Shape {
    fn default() -> Self {
        Self {
            sex: 0.5,
            weight: 0.5,
            muscle: 0.5,
            height: 0.5,
            proportions: 0.5,
        }
    }
}

/// Ranges that shapes are drawn from, each `[low, high]` in 0–1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShapeRanges {
    /// 0 female, 1 male.
    pub sex: [f64; 2],
    /// 0 thin, 1 fat.
    pub weight: [f64; 2],
    /// 0 slack, 1 athlete.
    pub muscle: [f64; 2],
    /// 0 short, 1 tall.
    pub height: [f64; 2],
    /// 0 uncommon, 1 ideal.
    pub proportions: [f64; 2],
}

impl Default for ShapeRanges {
    fn default() -> Self {
        Self {
            sex: [0.0, 1.0],
            weight: [0.3, 0.72],
            muscle: [0.3, 0.7],
            height: [0.3, 0.7],
            proportions: [0.4, 1.0],
        }
    }
}

impl ShapeRanges {
    /// Draws one shape.
    pub fn sample(&self, rng: &mut ChaCha8Rng) -> Shape {
        let mut draw = |[low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
        Shape {
            sex: draw(self.sex),
            weight: draw(self.weight),
            muscle: draw(self.muscle),
            height: draw(self.height),
            proportions: draw(self.proportions),
        }
    }
}

impl Shape {
    /// Blend shape names with their weights: products of piecewise linear
    /// weights of the parameters, as MakeHuman's `macro.json` combines them.
    pub(super) fn blend_weights(&self) -> Vec<(String, f64)> {
        let three = |x: f64| {
            let low = (1.0 - 2.0 * x).max(0.0);
            let high = (2.0 * x - 1.0).max(0.0);
            [("min", low), ("average", 1.0 - low - high), ("max", high)]
        };
        let mut weights = Vec::new();
        for (sex, s) in [("female", 1.0 - self.sex), ("male", self.sex)] {
            weights.push((sex.to_string(), s));
            for (muscle, m) in three(self.muscle) {
                for (weight, w) in three(self.weight) {
                    weights.push((format!("{sex}-{muscle}muscle-{weight}weight"), s * m * w));
                }
            }
            let [(_, short), _, (_, tall)] = three(self.height);
            weights.push((format!("{sex}-minheight"), s * short));
            weights.push((format!("{sex}-maxheight"), s * tall));
            let [(_, uncommon), _, (_, ideal)] = three(self.proportions);
            weights.push((format!("{sex}-uncommonproportions"), s * uncommon));
            weights.push((format!("{sex}-idealproportions"), s * ideal));
        }
        weights.retain(|(_, w)| *w > 0.0);
        weights
    }
}

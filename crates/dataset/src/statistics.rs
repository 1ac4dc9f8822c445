//! Normalisation statistics, merged in one pass.
//!
//! A group of rows has mean μ, biased covariance Σ and count n. Two groups merge as
//! μ = (n_a μ_a + n_b μ_b)/(n_a+n_b),
//! Σ = [n_a Σ_a + n_b Σ_b + n_a δ_a δ_aᵀ + n_b δ_b δ_bᵀ]/(n_a+n_b), δ_• = μ_• − μ.
//! Only training sequences go in. A column that never changes gets std 1.

use serde::{Deserialize, Serialize};

/// Mean, biased covariance and count of 3-vectors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Mean.
    pub mean: [f64; 3],
    /// Covariance, biased.
    pub covariance: [[f64; 3]; 3],
    /// Number of rows.
    pub count: f64,
}

impl Moments {
    /// Moments of rows, two passes in f64.
    pub fn of(rows: impl Iterator<Item = [f64; 3]> + Clone) -> Self {
        let mut count = 0f64;
        let mut mean = [0f64; 3];
        for row in rows.clone() {
            count += 1.0;
            for axis in 0..3 {
                mean[axis] += row[axis];
            }
        }
        if count == 0.0 {
            return Self::default();
        }
        let mean = mean.map(|sum| sum / count);
        let mut covariance = [[0f64; 3]; 3];
        for row in rows {
            for i in 0..3 {
                for j in 0..3 {
                    covariance[i][j] += (row[i] - mean[i]) * (row[j] - mean[j]) / count;
                }
            }
        }
        Self {
            mean,
            covariance,
            count,
        }
    }

    /// Moments of both groups together.
    pub fn merge(self, other: Self) -> Self {
        let count = self.count + other.count;
        if count == 0.0 {
            return self;
        }
        let mut merged = Self {
            count,
            ..Self::default()
        };
        for axis in 0..3 {
            merged.mean[axis] =
                (self.count * self.mean[axis] + other.count * other.mean[axis]) / count;
        }
        for group in [&self, &other] {
            for i in 0..3 {
                for j in 0..3 {
                    let (di, dj) = (
                        group.mean[i] - merged.mean[i],
                        group.mean[j] - merged.mean[j],
                    );
                    merged.covariance[i][j] +=
                        group.count * (group.covariance[i][j] + di * dj) / count;
                }
            }
        }
        merged
    }

    /// Standard deviation of each column; 1 where a column never changes.
    pub fn std(&self) -> [f64; 3] {
        let mut std = [0f64; 3];
        for (axis, value) in std.iter_mut().enumerate() {
            let variance = self.covariance[axis][axis].max(0.0).sqrt();
            *value = if variance > 0.0 { variance } else { 1.0 };
        }
        std
    }
}

/// What a vertex's next acceleration owes to its own motion, on average over a training set:
/// `persistence · a − damping · (v − v_rigid) − follow · (v − v_skin) + carry · a_skin − air · w/m · v
/// + gust · Δw + hang · (x_hanging − x)`.
///
/// x, v and a are position, velocity and last acceleration relative to the root, v_skin the coming
/// velocity of the nearest body vertex and a_skin its change (both absent where no body vertex is in
/// sight), w the coming wind's strength/400, m the vertex mass, Δw the coming change of the wind
/// (direction times strength/400). v_rigid is the coming velocity of the vertex if the garment were
/// rigid on what it hangs from, x_hanging where it would hang ([`crate::support`]; without a support
/// v_rigid = 0 and the last term is absent). The first four numbers depend on the distance to the
/// nearest body vertex: cloth on the skin rubs, cloth that hangs free swings on. They are given at
/// three distances ([`Trend::BANDS`]) and linear between these. All zero: none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trend {
    /// Share of the last acceleration that stays.
    pub persistence: [f32; 3],
    /// Share of the velocity relative to what the garment hangs from that goes, per frame.
    pub damping: [f32; 3],
    /// Share of the velocity along the skin that goes, per frame.
    pub follow: [f32; 3],
    /// Share of the skin's acceleration that is taken up.
    pub carry: [f32; 3],
    /// Share of the velocity that moving air of strength 400 takes from a vertex of mass 1, per frame.
    pub air: f32,
    /// Acceleration by a gust of strength 400, units/frame².
    pub gust: f32,
    /// Share of the way to where the point hangs when all is still, per frame².
    pub hang: f32,
}

/// What a [`Trend`] reads of a point, in units and frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Velocity.
    pub velocity: [f32; 3],
    /// Last acceleration.
    pub acceleration: [f32; 3],
    /// Nearest body vertex: distance, coming velocity and its change.
    pub skin: Option<(f32, [f32; 3], [f32; 3])>,
    /// Coming strength of the wind, of 400, by the vertex mass.
    pub air: f32,
    /// Coming change of the wind.
    pub gust: [f32; 3],
    /// Coming velocity of the point if it were rigid on what the garment hangs from, and the way to
    /// where it hangs when all is still; zeros without a support.
    pub support: [[f32; 3]; 2],
}

impl Trend {
    /// Distances to the body in units at which the numbers are given; nearer and farther they stay.
    pub const BANDS: [f32; 3] = [0.2, 0.5, 2.0];
    /// Number of terms.
    pub const TERMS: usize = 15;

    /// All numbers: persistence, damping, follow and carry by distance, air, gust, hang.
    pub fn weights(&self) -> [f32; Self::TERMS] {
        let bands = [self.persistence, self.damping, self.follow, self.carry];
        let mut weights = [0.0; Self::TERMS];
        weights[..12].copy_from_slice(bands.as_flattened());
        weights[12..].copy_from_slice(&[self.air, self.gust, self.hang]);
        weights
    }

    /// The trend of these [`Trend::weights`].
    pub fn of_weights(weights: [f32; Self::TERMS]) -> Self {
        let band = |at: usize| [weights[at], weights[at + 1], weights[at + 2]];
        Self {
            persistence: band(0),
            damping: band(3),
            follow: band(6),
            carry: band(9),
            air: weights[12],
            gust: weights[13],
            hang: weights[14],
        }
    }

    /// What each of the weights is multiplied with, units/frame².
    pub fn terms(motion: &Motion) -> [[f32; 3]; Self::TERMS] {
        let (distance, along, change) = match motion.skin {
            Some((distance, velocity, change)) => {
                let along = [0, 1, 2].map(|axis| velocity[axis] - motion.velocity[axis]);
                (distance, along, change)
            }
            None => (f32::INFINITY, [0.0; 3], [0.0; 3]),
        };
        let [rigid, way] = motion.support;
        let mut terms = [[0.0; 3]; Self::TERMS];
        let by_distance = [
            motion.acceleration,
            [0, 1, 2].map(|axis| rigid[axis] - motion.velocity[axis]),
            along,
            change,
        ];
        for (band, share) in Self::shares(distance).into_iter().enumerate() {
            for (kind, vector) in by_distance.iter().enumerate() {
                terms[3 * kind + band] = vector.map(|x| share * x);
            }
        }
        terms[12] = motion.velocity.map(|v| -motion.air * v);
        terms[13] = motion.gust;
        terms[14] = way;
        terms
    }

    /// The acceleration, units/frame².
    pub fn acceleration(&self, motion: &Motion) -> [f32; 3] {
        let (weights, terms) = (self.weights(), Self::terms(motion));
        [0, 1, 2].map(|axis| {
            let parts = weights.iter().zip(&terms).map(|(w, term)| w * term[axis]);
            parts.sum()
        })
    }

    /// How much each distance of [`Trend::BANDS`] counts.
    fn shares(distance: f32) -> [f32; 3] {
        let [near, middle, far] = Self::BANDS;
        let between = |low: f32, high: f32| ((distance - low) / (high - low)).clamp(0.0, 1.0);
        let (first, second) = (between(near, middle), between(middle, far));
        [1.0 - first, first - second, second]
    }
}

/// Mean and standard deviation of position, velocity and acceleration
/// (units, units/frame, units/frame²), three columns each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColumnStatistics {
    /// Mean of `[pos, vel, acc]`.
    pub mean: [f32; 9],
    /// Standard deviation of `[pos, vel, acc]`.
    pub std: [f32; 9],
    /// Trend of accelerations.
    #[serde(default)]
    pub trend: Trend,
}

impl ColumnStatistics {
    /// Columns from the moments of position, velocity and acceleration.
    pub fn from_moments(moments: &[Moments; 3]) -> Self {
        let mut columns = Self {
            mean: [0.0; 9],
            std: [1.0; 9],
            trend: Trend::default(),
        };
        for (block, group) in moments.iter().enumerate() {
            let std = group.std();
            for (axis, &value) in std.iter().enumerate() {
                columns.mean[3 * block + axis] = group.mean[axis] as f32;
                columns.std[3 * block + axis] = value as f32;
            }
        }
        columns
    }
}

/// Statistics of a training set.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Garment and body rows, relative to the root.
    pub vertices: ColumnStatistics,
    /// The root, absolute.
    pub root: ColumnStatistics,
}

/// Collects [`Statistics`] frame by frame.
#[derive(Clone, Debug, Default)]
pub struct StatisticsBuilder {
    vertices: [Moments; 3],
    root: [Moments; 3],
}

impl StatisticsBuilder {
    /// Adds one frame's rows `[pos, vel, acc]` of garments and body (relative) and of the root (absolute).
    pub fn add(&mut self, vertices: &[[f32; 9]], root: [f32; 9]) {
        for block in 0..3 {
            let column = |row: &[f32; 9]| [0, 1, 2].map(|axis| f64::from(row[3 * block + axis]));
            self.vertices[block] =
                self.vertices[block].merge(Moments::of(vertices.iter().map(column)));
            self.root[block] = self.root[block].merge(Moments::of(std::iter::once(column(&root))));
        }
    }

    /// Merges two builders; the order of merging is part of the result's bits.
    pub fn merge(self, other: Self) -> Self {
        let both = |a: [Moments; 3], b: [Moments; 3]| {
            [a[0].merge(b[0]), a[1].merge(b[1]), a[2].merge(b[2])]
        };
        Self {
            vertices: both(self.vertices, other.vertices),
            root: both(self.root, other.root),
        }
    }

    /// The statistics of all that was added.
    pub fn finish(&self) -> Statistics {
        Statistics {
            vertices: ColumnStatistics::from_moments(&self.vertices),
            root: ColumnStatistics::from_moments(&self.root),
        }
    }
}

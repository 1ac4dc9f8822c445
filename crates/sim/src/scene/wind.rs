//! Wind as in the paper: piecewise constant, each piece from a pivot on.

use drape_dataset::sequence::Wind;
use glam::{Quat, Vec3};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// From this frame on the wind is so, until the next pivot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindPivot {
    /// First recorded frame of the piece.
    pub frame: usize,
    /// Unit quaternion (w, x, y, z) that turns +Z into the wind's direction.
    pub rotation: [f32; 4],
    /// Strength in the paper's units, 0–400.
    pub strength: f32,
}

/// Wind of a recorded frame; calm before the first pivot. Pivots are in order.
pub fn wind_at(pivots: &[WindPivot], frame: usize) -> Wind {
    pivots
        .iter()
        .rev()
        .find(|pivot| pivot.frame <= frame)
        .map_or_else(Wind::default, |pivot| Wind {
            rotation: pivot.rotation,
            strength: pivot.strength,
        })
}

/// Two or three pieces in mostly horizontal directions.
pub(super) fn sample(rng: &mut ChaCha8Rng, frames: usize, strength: [f32; 2]) -> Vec<WindPivot> {
    let pieces = rng.random_range(2..=3usize);
    (0..pieces)
        .map(|piece| {
            let azimuth = rng.random_range(0.0..std::f32::consts::TAU);
            let rise = rng.random_range(-0.3f32..0.4);
            let direction = Vec3::new(azimuth.cos(), azimuth.sin(), rise).normalize();
            let [x, y, z, w] = Quat::from_rotation_arc(Vec3::Z, direction)
                .normalize()
                .to_array();
            let share = rng.random_range(0.0..1.0f32);
            WindPivot {
                frame: piece * frames / pieces,
                rotation: [w, x, y, z],
                strength: strength[0] + (strength[1] - strength[0]) * share,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pivot_holds_from_its_frame_until_the_next_one() {
        let pivot = |frame, strength| WindPivot {
            frame,
            rotation: [1.0, 0.0, 0.0, 0.0],
            strength,
        };
        let pivots = [pivot(3, 10.0), pivot(7, 20.0)];
        let strengths: Vec<f32> = (0..9).map(|f| wind_at(&pivots, f).strength).collect();
        assert_eq!(strengths, [0., 0., 0., 10., 10., 10., 10., 20., 20.]);
        assert_eq!(wind_at(&pivots, 0), Wind::default());
    }
}

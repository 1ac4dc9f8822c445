//! What a garment hangs from: the body under its highest part.
//!
//! A skirt's hem is nearer to a thigh than to the waist, but turns and swings with the waist, and
//! hangs below it when all is still. So a garment has a [`Support`]: the body vertices nearest to
//! the highest 6 cm of its rest shape. Fitted to a frame's body ([`Support::pose`]) it tells where
//! each point of the rest shape would go if the garment were rigid on its support, and where it
//! would hang upright below it. A hooded jacket's support is its head: the hood is its highest part.

use drape_geometry::grid::Grid;
use drape_geometry::rigid::Rigid;

use crate::sample::StatePair;
use crate::sequence::{Garment, SequenceHeader};

/// Height of the part that a garment hangs from, in metres.
const HEIGHT_M: f32 = 0.06;
/// Body vertices farther from the rest shape than this hold nothing, in metres.
const REACH_M: f32 = 0.1;
/// Fewer body vertices do not tell a rotation.
const FEWEST: usize = 3;

/// What a garment hangs from.
#[derive(Clone, Debug, PartialEq)]
pub struct Support {
    /// Body vertices.
    pub body: Vec<u32>,
    /// Their rest positions relative to their mean.
    rest: Vec<[f32; 3]>,
    /// Mean of their rest positions, in units.
    pub centre: [f32; 3],
}

/// Where a support is and how it moves, coming frame; for points given relative to
/// [`Support::centre`] in the rest shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupportPose {
    /// Coming rotation less the present one.
    turning: [[f32; 3]; 3],
    /// Velocity of the centre, units/frame.
    velocity: [f32; 3],
    /// Coming rotation about the vertical axis.
    upright: [[f32; 3]; 3],
    /// Coming centre relative to the root.
    centre: [f32; 3],
}

impl Support {
    /// The support of each garment of a sequence; `None` where there is no body at the garment's top.
    pub fn of_outfit(header: &SequenceHeader) -> Vec<Option<Self>> {
        let (body, scale) = (&header.body.rest, header.scene.scale);
        let grid = Grid::build(body, REACH_M * scale);
        let whole = body.len() == header.body.vertex_count;
        let garments = header.garments.iter();
        garments
            .map(|garment| {
                whole
                    .then(|| Self::of(garment, body, &grid, scale))
                    .flatten()
            })
            .collect()
    }

    fn of(garment: &Garment, body: &[[f32; 3]], grid: &Grid, scale: f32) -> Option<Self> {
        let heights = garment.rest.iter().map(|x| x[2]);
        let lowest = heights.fold(f32::NEG_INFINITY, f32::max) - HEIGHT_M * scale;
        let highest = garment.rest.iter().filter(|x| x[2] > lowest);
        let mut held: Vec<u32> = highest
            .filter_map(|&x| grid.nearest_within(x, REACH_M * scale))
            .map(|(vertex, _)| vertex)
            .collect();
        held.sort_unstable();
        held.dedup();
        if held.len() < FEWEST {
            return None;
        }
        let rest = || held.iter().map(|&vertex| body[vertex as usize]);
        let centre = mean(rest());
        let rest = rest().map(|x| less(x, centre)).collect();
        Some(Self {
            body: held,
            rest,
            centre,
        })
    }

    /// The support's pose in a step to a frame whose body states are `body` (newer frame first);
    /// `points` is room for its body vertices. `None` if they are not finite.
    pub fn pose(&self, body: &[StatePair], points: &mut Vec<[f32; 3]>) -> Option<SupportPose> {
        let mut at = |column: usize| {
            points.clear();
            points.extend(self.body.iter().map(|&vertex| {
                let state = &body[vertex as usize];
                [0, 1, 2].map(|axis| state[column + axis])
            }));
            let rotation = Rigid::fit(&self.rest, points).ok()?.rotation;
            Some((rotation, mean(points.iter().copied())))
        };
        let ((next, centre), (now, older)) = (at(0)?, at(6)?);
        let angle = (next[1][0] - next[0][1]).atan2(next[0][0] + next[1][1]);
        let (sin, cos) = (angle.sin() as f32, angle.cos() as f32);
        Some(SupportPose {
            turning: [0, 1, 2].map(|i| [0, 1, 2].map(|j| (next[i][j] - now[i][j]) as f32)),
            velocity: less(centre, older),
            upright: [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]],
            centre,
        })
    }
}

impl SupportPose {
    /// Coming velocity of a point that is rigid on the support, units/frame.
    pub fn velocity(&self, point: [f32; 3]) -> [f32; 3] {
        plus(turned(&self.turning, point), self.velocity)
    }

    /// Where a point hangs when all is still, relative to the root.
    pub fn hanging(&self, point: [f32; 3]) -> [f32; 3] {
        plus(turned(&self.upright, point), self.centre)
    }
}

fn turned(rotation: &[[f32; 3]; 3], x: [f32; 3]) -> [f32; 3] {
    rotation.map(|row| row[0] * x[0] + row[1] * x[1] + row[2] * x[2])
}

fn plus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn less(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Mean of points, summed in f64.
fn mean(points: impl Iterator<Item = [f32; 3]>) -> [f32; 3] {
    let (mut sum, mut count) = ([0f64; 3], 0f64);
    for point in points {
        for (sum, x) in sum.iter_mut().zip(point) {
            *sum += f64::from(x);
        }
        count += 1.0;
    }
    sum.map(|sum| (sum / count) as f32)
}

//! What is measured in one predicted frame, in f64, sharing no code with the
//! training losses.
//!
//! - *Error*: mean over a garment's vertices of `|x̂ − x|`, kept in real metres
//!   (`units / scale`), so that data sets of different scales can share a table.
//! - *H-collision*: a garment vertex `x̂` counts when, for the nearest body
//!   vertex `b` with unit normal `n`, `n·(x̂ − b) < 0` and `|x̂ − b| ≤ 0.5 m`
//!   real (5 units at scale 10). The paper's threshold is 0, not a margin.
//! - *L-collision*: the same for each vertex of an outer garment against the
//!   nearest vertex of all inner garments together, as predicted. Outer
//!   garments are those of the outfit's highest layer, inner ones all of lower
//!   layers (in the paper's data every garment is a layer of its own, so its
//!   "last garment against all earlier ones" is this). Outfits with one layer
//!   have no L-collision.
//!
//! Vertex normals are sums of the unit normals of the incident faces, not
//! weighted by area, made unit. A vertex without a normal (all its faces have
//! zero area) never counts as a collision. Equal distances: the lower index.
//!
//! What the paper's counting is not: it looks at vertices (not surfaces) and
//! has no notion of an open mesh, so a vertex past the hem of an inner garment
//! can count. Exact intersection counts are another metric.

use drape_dataset::{registry::GarmentKind, sequence::SequenceHeader};
use rayon::prelude::*;

use crate::{nearest::NearestVertex, task::Positions};

/// Largest distance at which a vertex behind the nearest plane counts, real metres.
pub const COLLISION_REACH_M: f64 = 0.5;

/// One garment in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct GarmentScore {
    /// Kind.
    pub kind: GarmentKind,
    /// Number of vertices.
    pub vertices: usize,
    /// Mean Euclidean error in real metres.
    pub error_m: f64,
    /// Vertices inside the body.
    pub inside_body: usize,
    /// Vertices inside inner garments; `None` for garments that are not outer.
    pub inside_inner: Option<usize>,
}

/// All garments in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameScore {
    /// Garments, inner first.
    pub garments: Vec<GarmentScore>,
}

/// Measures one frame: `predicted` and `reference` are `[garment][vertex, 3]`,
/// `body` is `[vertex, 3]`, all absolute in scene units.
///
/// # Panics
/// When counts do not match the header; [`crate::task::Clip::split`] checks them.
pub fn score_frame(
    header: &SequenceHeader,
    predicted: &[Positions],
    reference: &[Positions],
    body: &[[f32; 3]],
) -> FrameScore {
    let scale = f64::from(header.scene.scale);
    let reach = COLLISION_REACH_M * scale;
    let body = Obstacle::new(&to_f64(body), &header.body.faces);
    let inner = inner_obstacle(header, predicted);
    let top = header
        .garments
        .iter()
        .map(|garment| garment.layer)
        .max()
        .unwrap_or(0);
    let garments = header
        .garments
        .iter()
        .zip(predicted.iter().zip(reference))
        .map(|(garment, (predicted, reference))| {
            let points = to_f64(predicted);
            GarmentScore {
                kind: garment.kind,
                vertices: points.len(),
                error_m: mean_distance(&points, &to_f64(reference)) / scale,
                inside_body: body.count_inside(&points, reach),
                inside_inner: inner
                    .as_ref()
                    .filter(|_| garment.layer == top)
                    .map(|inner| inner.count_inside(&points, reach)),
            }
        })
        .collect();
    FrameScore { garments }
}

/// Mean Euclidean distance between corresponding points; 0 for no points.
pub fn mean_distance(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len(), "positions to compare must correspond");
    let sum: f64 = a.iter().zip(b).map(|(a, b)| length(sub(*a, *b))).sum();
    if a.is_empty() {
        0.0
    } else {
        sum / a.len() as f64
    }
}

/// A surface that points can be inside of, in the paper's sense.
pub struct Obstacle {
    points: NearestVertex,
    normals: Vec<[f64; 3]>,
}

impl Obstacle {
    /// Surface of `points`, `[vertex, 3]`, and `faces`, `[face, 3]`.
    pub fn new(points: &[[f64; 3]], faces: &[[u32; 3]]) -> Self {
        Self {
            points: NearestVertex::new(points),
            normals: vertex_normals(points, faces),
        }
    }

    /// How many of `points` are behind the plane of their nearest vertex, at most `reach` away from it.
    pub fn count_inside(&self, points: &[[f64; 3]], reach: f64) -> usize {
        points
            .par_iter()
            .filter(|point| self.is_inside(**point, reach))
            .count()
    }

    fn is_inside(&self, point: [f64; 3], reach: f64) -> bool {
        self.points.nearest(point).is_some_and(|(vertex, at)| {
            let offset = sub(point, at);
            dot(self.normals[vertex], offset) < 0.0 && length(offset) <= reach
        })
    }
}

/// Unit vertex normals, `[vertex, 3]`: sums of unit face normals; zero where no face has an area.
pub fn vertex_normals(points: &[[f64; 3]], faces: &[[u32; 3]]) -> Vec<[f64; 3]> {
    let mut normals = vec![[0.0; 3]; points.len()];
    for face in faces {
        let [a, b, c] = face.map(|vertex| points[vertex as usize]);
        let normal = unit(cross(sub(b, a), sub(c, a)));
        for vertex in face {
            let sum = &mut normals[*vertex as usize];
            *sum = [sum[0] + normal[0], sum[1] + normal[1], sum[2] + normal[2]];
        }
    }
    normals.into_iter().map(unit).collect()
}

/// All garments below the highest layer as one surface; `None` when there is one layer.
fn inner_obstacle(header: &SequenceHeader, predicted: &[Positions]) -> Option<Obstacle> {
    let top = header.garments.iter().map(|garment| garment.layer).max()?;
    let mut points = Vec::new();
    let mut faces = Vec::new();
    for (garment, positions) in header
        .garments
        .iter()
        .zip(predicted)
        .filter(|(garment, _)| garment.layer < top)
    {
        let first = points.len() as u32;
        points.extend(to_f64(positions));
        faces.extend(
            garment
                .faces
                .iter()
                .map(|face| face.map(|vertex| vertex + first)),
        );
    }
    (!points.is_empty()).then(|| Obstacle::new(&points, &faces))
}

fn to_f64(points: &[[f32; 3]]) -> Vec<[f64; 3]> {
    points.iter().map(|point| point.map(f64::from)).collect()
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// `a` with length 1; zero stays zero.
fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = length(a);
    if length > 0.0 {
        a.map(|x| x / length)
    } else {
        [0.0; 3]
    }
}

#[cfg(test)]
mod tests;

//! Collision losses: signed distances to the planes of nearest vertices.
//!
//! `s_i = n_j·(x_i − b_j) − δ` with j the obstacle vertex nearest to x_i; a vertex
//! with s < 0 is a hit. Loss = Σ_hits s² / count. The nearest index and the set of
//! hits are constants of the gradient.
//!
//! The published program counts every vertex however far, includes those past
//! the border of an open obstacle, and divides by the number of hits, so that one
//! touching vertex weighs as much as a thousand. The default limits the reach,
//! skips nearest vertices on a border, and divides by the number of vertices.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use drape_dataset::sample::{Outfit, StatePair};
use drape_geometry::grid::Grid;
use drape_geometry::normals::vertex_normals;
use drape_model::kernels::for_all_with;
use rayon::prelude::*;

use super::normal::{MeshNormals, dot};
use super::{Term, Vector};

const EPSILON: f64 = 1e-7;
/// Cell of the search grid in units: a few vertex distances of cloth and body.
const SEARCH_CELL: f32 = 0.5;

/// How collisions are found and averaged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CollisionConfig {
    /// δ in units: vertices nearer than this count as hits. Default 0.001.
    pub threshold: f64,
    /// Farthest nearest vertex that counts, in units; none: no limit. Default 1.
    pub reach: Option<f64>,
    /// Leave out vertices whose nearest obstacle vertex lies on a border. Default true.
    pub skip_borders: bool,
    /// What the sum is divided by. Default all vertices.
    pub mean: CollisionMean,
}

/// Divisor of a collision loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CollisionMean {
    /// Number of hits (published program).
    Hits,
    /// Number of tested vertices.
    Vertices,
}

impl Default for CollisionConfig {
    fn default() -> Self {
        Self {
            threshold: 1e-3,
            reach: Some(1.0),
            skip_borders: true,
            mean: CollisionMean::Vertices,
        }
    }
}

/// Vertices that one thread tests at a time.
const PIECE: usize = 64;

/// One hit: tested vertex, obstacle vertex, signed distance s.
#[derive(Clone, Copy)]
struct Hit {
    vertex: usize,
    nearest: usize,
    s: f64,
}

fn narrow(x: Vector) -> [f32; 3] {
    x.map(|value| value as f32)
}

fn hits(
    config: &CollisionConfig,
    predicted: &[Vector],
    tested: Range<usize>,
    obstacle: &[Vector],
    normals: &[Vector],
    on_border: &[bool],
) -> Vec<Hit> {
    let grid = Grid::build(
        &obstacle.iter().map(|&x| narrow(x)).collect::<Vec<_>>(),
        SEARCH_CELL,
    );
    let find = |near: &mut Vec<(u32, f32)>, vertex: usize| {
        let x = predicted[vertex];
        let nearest = match config.reach {
            Some(reach) => {
                grid.k_nearest(narrow(x), 1, reach as f32, near);
                near.first().copied()
            }
            None => grid.nearest(narrow(x)),
        };
        let nearest = nearest?.0 as usize;
        if config.skip_borders && on_border[nearest] {
            return None;
        }
        let apart = [0, 1, 2].map(|axis| x[axis] - obstacle[nearest][axis]);
        let s = dot(normals[nearest], apart) - config.threshold;
        (s < 0.0).then_some(Hit { vertex, nearest, s })
    };
    let mut found: Vec<Option<Hit>> = vec![None; tested.len()];
    let pieces = found.par_chunks_mut(PIECE).enumerate();
    for_all_with(
        pieces,
        |near: &mut Vec<(u32, f32)>, (piece, found): (usize, &mut [Option<Hit>])| {
            for (vertex, to) in (tested.start + piece * PIECE..).zip(found) {
                *to = find(near, vertex);
            }
        },
    );
    found.into_iter().flatten().collect()
}

fn divisor(config: &CollisionConfig, hits: usize, tested: usize) -> f64 {
    EPSILON
        + match config.mean {
            CollisionMean::Hits => hits as f64,
            CollisionMean::Vertices => tested as f64,
        }
}

/// Garment vertices inside the body; the body is given. `on_border` of each body vertex as in
/// [`Outfit`].
pub fn body_collision(
    config: &CollisionConfig,
    predicted: &[Vector],
    body: &[StatePair],
    body_faces: &[[u32; 3]],
    on_border: &[bool],
) -> Term {
    let body: Vec<[f32; 3]> = body.iter().map(|row| [row[0], row[1], row[2]]).collect();
    let wide = |x: &[f32; 3]| x.map(f64::from);
    let normals: Vec<Vector> = vertex_normals(&body, body_faces).iter().map(wide).collect();
    let obstacle: Vec<Vector> = body.iter().map(wide).collect();
    let tested = 0..predicted.len();
    let hits = hits(config, predicted, tested, &obstacle, &normals, on_border);
    let divisor = divisor(config, hits.len(), predicted.len());
    let mut term = Term::zero(predicted.len());
    for hit in hits {
        term.value += hit.s * hit.s / divisor;
        for axis in 0..3 {
            term.gradient[hit.vertex][axis] += 2.0 * hit.s / divisor * normals[hit.nearest][axis];
        }
    }
    term
}

/// Vertices of the last (outer) garment inside the garments before it; both move.
pub fn layer_collision(
    config: &CollisionConfig,
    outfit: &Outfit,
    predicted: &[Vector],
    normals: &MeshNormals,
) -> Term {
    let inner = outfit.garment_offsets[outfit.garments() - 1];
    let hits = hits(
        config,
        predicted,
        inner..predicted.len(),
        &predicted[..inner],
        &normals.normals[..inner],
        &outfit.on_border[..inner],
    );
    let divisor = divisor(config, hits.len(), predicted.len() - inner);
    let mut term = Term::zero(predicted.len());
    let mut by_normal = vec![[0.0; 3]; predicted.len()];
    for hit in hits {
        term.value += hit.s * hit.s / divisor;
        let ds = 2.0 * hit.s / divisor;
        for axis in 0..3 {
            let n = normals.normals[hit.nearest][axis];
            term.gradient[hit.vertex][axis] += ds * n;
            term.gradient[hit.nearest][axis] -= ds * n;
            by_normal[hit.nearest][axis] +=
                ds * (predicted[hit.vertex][axis] - predicted[hit.nearest][axis]);
        }
    }
    normals.backward(&by_normal, &mut term.gradient);
    term
}

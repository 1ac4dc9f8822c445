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
use drape_geometry::normals::vertex_normals_again;
use drape_model::kernels::for_all_with;
use rayon::prelude::*;

use super::normal::{MeshNormals, dot};
use super::{Term, Vector, zeros};

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

/// What collisions are found in; its memory serves the next sample.
#[derive(Default)]
pub struct CollisionRoom {
    search: Search,
    /// Normals of the body.
    normals: Vec<[f32; 3]>,
    /// Gradient by the layers' normals.
    by_normal: Vec<Vector>,
}

/// An obstacle's vertices, and what hits them.
#[derive(Default)]
struct Search {
    points: Vec<[f32; 3]>,
    grid: Grid,
    found: Vec<Option<Hit>>,
}

impl Search {
    /// Hits of the `tested` vertices on [`Search::points`]; `plane` gives place and normal of one.
    fn hits(
        &mut self,
        config: &CollisionConfig,
        predicted: &[Vector],
        tested: Range<usize>,
        plane: impl Fn(usize) -> [Vector; 2] + Sync,
        on_border: &[bool],
    ) -> impl Iterator<Item = &Hit> + Clone {
        self.grid.rebuild(&self.points, SEARCH_CELL);
        let grid = &self.grid;
        let find = |vertex: usize| {
            let x = predicted[vertex];
            let nearest = match config.reach {
                Some(reach) => grid.nearest_within(narrow(x), reach as f32),
                None => grid.nearest(narrow(x)),
            };
            let nearest = nearest?.0 as usize;
            if config.skip_borders && on_border[nearest] {
                return None;
            }
            let [place, normal] = plane(nearest);
            let apart = [0, 1, 2].map(|axis| x[axis] - place[axis]);
            let s = dot(normal, apart) - config.threshold;
            (s < 0.0).then_some(Hit { vertex, nearest, s })
        };
        self.found.clear();
        self.found.resize(tested.len(), None);
        let pieces = self.found.par_chunks_mut(PIECE).enumerate();
        for_all_with(
            pieces,
            |(): &mut (), (piece, found): (usize, &mut [Option<Hit>])| {
                for (vertex, to) in (tested.start + piece * PIECE..).zip(found) {
                    *to = find(vertex);
                }
            },
        );
        self.found.iter().flatten()
    }
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
    room: &mut CollisionRoom,
    term: &mut Term,
) {
    let CollisionRoom {
        search, normals, ..
    } = room;
    let place = |row: &StatePair| [row[0], row[1], row[2]];
    search.points.clear();
    search.points.extend(body.iter().map(place));
    vertex_normals_again(&search.points, body_faces, normals);
    let plane = |vertex: usize| [place(&body[vertex]), normals[vertex]].map(|x| x.map(f64::from));
    let tested = 0..predicted.len();
    let hits = search.hits(config, predicted, tested, plane, on_border);
    let divisor = divisor(config, hits.clone().count(), predicted.len());
    term.clear(predicted.len());
    for hit in hits {
        let [_, normal] = plane(hit.nearest);
        term.value += hit.s * hit.s / divisor;
        for axis in 0..3 {
            term.gradient[hit.vertex][axis] += 2.0 * hit.s / divisor * normal[axis];
        }
    }
}

/// Vertices of the last (outer) garment inside the garments before it; both move.
pub fn layer_collision(
    config: &CollisionConfig,
    outfit: &Outfit,
    predicted: &[Vector],
    normals: &MeshNormals,
    room: &mut CollisionRoom,
    term: &mut Term,
) {
    let CollisionRoom {
        search, by_normal, ..
    } = room;
    let inner = outfit.garment_offsets[outfit.garments() - 1];
    search.points.clear();
    let points = predicted[..inner].iter().map(|&x| narrow(x));
    search.points.extend(points);
    let plane = |vertex: usize| [predicted[vertex], normals.normals[vertex]];
    let tested = inner..predicted.len();
    let hits = search.hits(config, predicted, tested, plane, &outfit.on_border);
    let divisor = divisor(config, hits.clone().count(), predicted.len() - inner);
    term.clear(predicted.len());
    zeros(by_normal, predicted.len());
    for hit in hits {
        let [place, normal] = plane(hit.nearest);
        term.value += hit.s * hit.s / divisor;
        let ds = 2.0 * hit.s / divisor;
        for axis in 0..3 {
            term.gradient[hit.vertex][axis] += ds * normal[axis];
            term.gradient[hit.nearest][axis] -= ds * normal[axis];
            by_normal[hit.nearest][axis] += ds * (predicted[hit.vertex][axis] - place[axis]);
        }
    }
    normals.backward(by_normal, &mut term.gradient);
}

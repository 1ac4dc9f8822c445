//! Skinned: the rest garment carried by the nearest parts of the body, with no
//! dynamics (rest-skinned garments are where static methods start from).
//!
//! No skeleton is needed. Around each body vertex that a garment vertex is
//! bound to, the rigid motion from the body's rest pose to the frame is fitted
//! over a patch of the surface; a garment vertex is moved by the mean of the
//! motions of its nearest body vertices, weighted by `1 / d²` in the rest pose.
//! A body at rest gives the rest garment, a body that moves rigidly carries it
//! rigidly.
//!
//! A file without a body rest pose is bound at its first frame instead: body
//! and garments of frame 0 are then the rest.

use std::collections::{BTreeMap, BTreeSet};

use drape_geometry::rigid::Rigid;

use crate::{
    EvalError,
    method::Method,
    nearest::NearestVertex,
    task::{Positions, Task},
};

/// Body vertices that a garment vertex is bound to.
const BONDS: usize = 8;
/// Smallest surface patch over which a motion is fitted: about two rings, so
/// that noise in single vertices does not turn it.
const PATCH: usize = 16;

/// Rest garments that follow the body's surface.
#[derive(Default)]
pub struct Skinned {
    body_rest: Vec<[f32; 3]>,
    /// Body vertices whose motion is needed, and the patch around each.
    patches: Vec<Vec<u32>>,
    /// `[garment][vertex]`
    bonds: Vec<Vec<Bond>>,
}

/// One garment vertex.
struct Bond {
    rest: [f64; 3],
    /// Index of a patch, weight; weights sum to 1.
    patches: Vec<(u32, f64)>,
}

impl Method for Skinned {
    fn name(&self) -> &str {
        "skinned"
    }

    fn threads(&self) -> usize {
        1
    }

    fn begin(&mut self, task: &Task) -> Result<(), EvalError> {
        let header = &task.header;
        let has_rest = header.body.rest.len() == header.body.vertex_count;
        let first = &task.frames[0];
        let (body, garments): (_, Vec<&Positions>) = if has_rest {
            (
                &header.body.rest,
                header
                    .garments
                    .iter()
                    .map(|garment| &garment.rest)
                    .collect(),
            )
        } else {
            (&first.body, first.garments.iter().collect())
        };
        if body.is_empty() {
            return Err(EvalError::NotApplicable {
                method: self.name().to_owned(),
                sequence: header.name.clone(),
                reason: "it has no body".to_owned(),
            });
        }

        let tree = NearestVertex::new(
            &body
                .iter()
                .map(|point| point.map(f64::from))
                .collect::<Vec<_>>(),
        );
        let mut patch_of_vertex = BTreeMap::new();
        let mut bind = |rest: &[f32; 3]| {
            let rest = rest.map(f64::from);
            let mut patches: Vec<(u32, f64)> = tree
                .nearest_many(rest, BONDS)
                .into_iter()
                .map(|(squared, vertex)| {
                    let next = patch_of_vertex.len() as u32;
                    // A vertex that lies on the body is all its own; the floor of 1e-12 keeps the sum finite.
                    (
                        *patch_of_vertex.entry(vertex).or_insert(next),
                        1.0 / squared.max(1e-12),
                    )
                })
                .collect();
            let sum: f64 = patches.iter().map(|(_, weight)| weight).sum();
            patches.iter_mut().for_each(|(_, weight)| *weight /= sum);
            Bond { rest, patches }
        };
        self.bonds = garments
            .iter()
            .map(|garment| garment.iter().map(&mut bind).collect())
            .collect();

        let neighbours = neighbours(body.len(), &header.body.faces);
        self.patches = vec![Vec::new(); patch_of_vertex.len()];
        for (vertex, patch) in patch_of_vertex {
            self.patches[patch as usize] = grow(vertex as u32, &neighbours);
        }
        self.body_rest.clone_from(body);
        Ok(())
    }

    fn step(&mut self, task: &Task, frame: usize) -> Result<Vec<Positions>, EvalError> {
        let body = &task.frames[frame].body;
        let pick = |from: &[[f32; 3]], patch: &[u32]| -> Positions {
            patch.iter().map(|vertex| from[*vertex as usize]).collect()
        };
        let motions: Vec<Rigid> = self
            .patches
            .iter()
            .map(|patch| Rigid::fit(&pick(&self.body_rest, patch), &pick(body, patch)))
            .collect::<Result<_, _>>()
            .map_err(|error| EvalError::Method {
                method: self.name().to_owned(),
                sequence: task.header.name.clone(),
                frame,
                reason: error.to_string(),
            })?;
        let place = |bond: &Bond| {
            let mut sum = [0.0; 3];
            for (patch, weight) in &bond.patches {
                let moved = motions[*patch as usize].apply(bond.rest);
                sum = [0, 1, 2].map(|k| sum[k] + weight * moved[k]);
            }
            sum.map(|x| x as f32)
        };
        Ok(self
            .bonds
            .iter()
            .map(|garment| garment.iter().map(place).collect())
            .collect())
    }
}

/// Vertices that share a face with each vertex, sorted.
fn neighbours(count: usize, faces: &[[u32; 3]]) -> Vec<BTreeSet<u32>> {
    let mut neighbours = vec![BTreeSet::new(); count];
    for face in faces {
        for vertex in face {
            neighbours[*vertex as usize].extend(face);
        }
    }
    neighbours
}

/// Whole rings around a vertex until there are [`PATCH`] vertices or no more.
fn grow(vertex: u32, neighbours: &[BTreeSet<u32>]) -> Vec<u32> {
    let mut patch = BTreeSet::from([vertex]);
    let mut rim = patch.clone();
    while patch.len() < PATCH && !rim.is_empty() {
        rim = rim
            .iter()
            .flat_map(|vertex| &neighbours[*vertex as usize])
            .copied()
            .collect();
        rim.retain(|vertex| patch.insert(*vertex));
    }
    patch.into_iter().collect()
}

//! Who sees whom in one frame: everything discrete that LayersNet derives from
//! the state and the body before any weight is used.
//!
//! World edges join patches closer than the layer radius that are not mesh
//! neighbours. Body tokens are the distinct body vertices that some patch sees,
//! then wind and gravity, which every patch sees. A vertex takes its motion from
//! at most four patches near it: among the mesh neighbours q of its own patch
//! (lowest index), the four nearest, kept if q is the own patch or nearer to the
//! vertex than to the own patch's centre.
//! Distances are direct differences in f32. A pass whose subject is absent (no
//! body, no second patch in reach) does not run; the result equals masking it.

use std::sync::Arc;

use drape_dataset::patches::Csr;
use drape_dataset::sample::{Outfit, StatePair, Step};
use drape_dataset::statistics::{Motion, Trend};
use drape_geometry::grid::Grid;
use drape_geometry::normals::vertex_normals;

use crate::config::{BodySlots, ForceFrames, ModelConfig};
use crate::error::{ModelError, Result};
use crate::frames::{IDENTITY, Matrix, frame, rotate, unit};
use crate::kernels::attention::Edges;
use crate::kernels::for_all_with;

/// Body vertices a patch sees at most.
const BODY_SLOTS: usize = 16;
/// Patches a vertex takes its motion from at most.
const PATCHES_PER_VERTEX: usize = 4;
const EPSILON: f32 = 1e-7;
/// Lighter cloth than this (a tenth of the paper's lightest) moves in wind as this does.
const LEAST_MASS: f32 = 0.02;

/// The nearest body vertex of a point and the frame there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Row in [`FrameGraph::body_rows`] of the nearest body vertex, if the decoder uses one.
    pub row: Option<u32>,
    /// Frame of the body's normal, identity out of reach.
    pub frame: Matrix,
    /// The nearest body vertex within the configuration's `patch_sight`; of vertices only if
    /// there is a trend.
    pub sight: Option<Sight>,
}

/// A body vertex that is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Body vertex.
    pub vertex: u32,
    /// Distance in units.
    pub distance: f32,
    /// How much of a patch's state relative to it counts.
    pub share: f32,
}

/// One (vertex, patch) pair of the decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Vertex.
    pub vertex: u32,
    /// Patch.
    pub patch: u32,
}

/// Discrete structure of one frame.
#[derive(Clone, Debug)]
pub struct FrameGraph {
    /// Mean raw state of each patch.
    pub patch_states: Vec<StatePair>,
    /// Attention edges; body tokens are the first [`FrameGraph::body_tokens`] body rows, wind, gravity.
    pub edges: Arc<Edges>,
    /// Body vertices that are encoded, token vertices first.
    pub body_rows: Vec<u32>,
    /// How many of `body_rows` are attention tokens.
    pub body_tokens: usize,
    /// Anchor of each vertex.
    pub vertex_anchors: Vec<Anchor>,
    /// Anchor of each patch.
    pub patch_anchors: Vec<Anchor>,
    /// Decoder pairs, by vertex.
    pub slots: Vec<Slot>,
    /// Start of each vertex's pairs, `[vertex + 1]`.
    pub slot_offsets: Vec<u32>,
    /// Own patch of each vertex.
    pub own_patch: Vec<u32>,
    /// Vertex mass of each patch's garment.
    pub patch_masses: Vec<f32>,
}

/// Items that one thread derives at a time.
const PIECE: usize = 64;

/// `work(i)` of every `i < count`, with room for what a grid finds.
fn each<R: Clone + Default + Send>(
    count: usize,
    work: impl Fn(usize, &mut Vec<(u32, f32)>) -> R + Send + Sync,
) -> Vec<R> {
    let mut all = vec![R::default(); count];
    let pieces = all.chunks_mut(PIECE).enumerate().collect();
    for_all_with(pieces, |found, (piece, all): (usize, &mut [R])| {
        for (index, to) in (piece * PIECE..).zip(all) {
            *to = work(index, found);
        }
    });
    all
}

fn position(state: &StatePair) -> [f32; 3] {
    [state[0], state[1], state[2]]
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (x * x + y * y + z * z).sqrt()
}

/// Mean state of each patch's members.
pub fn patch_means<const N: usize>(members: &Csr, states: &[[f32; N]]) -> Vec<[f32; N]> {
    members
        .iter()
        .map(|vertices| {
            let mut sum = [0f32; N];
            for &vertex in vertices {
                for (sum, value) in sum.iter_mut().zip(&states[vertex as usize]) {
                    *sum += value;
                }
            }
            sum.map(|value| value / (vertices.len() as f32 + EPSILON))
        })
        .collect()
}

/// Body slots of a patch: `(token vertex, repeats)`.
fn body_slots(
    config: &ModelConfig,
    centre: [f32; 3],
    grid: &Grid,
    found: &mut Vec<(u32, f32)>,
) -> Vec<(u32, u32)> {
    match config.body_slots {
        BodySlots::Nearest => {
            grid.k_nearest(centre, BODY_SLOTS, config.body_radius, found);
            found.iter().map(|&(vertex, _)| (vertex, 1)).collect()
        }
        BodySlots::FirstByIndex => {
            grid.within(centre, config.body_radius, found);
            found.truncate(BODY_SLOTS);
            let repeats = 1 + (BODY_SLOTS - found.len()) as u32;
            let count = |slot| if slot == 0 { repeats } else { 1 };
            found
                .iter()
                .enumerate()
                .map(|(slot, &(vertex, _))| (vertex, count(slot)))
                .collect()
        }
    }
}

/// Smallest and largest coordinates.
fn bounds(points: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let start = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    points.iter().fold(start, |[low, high], p| {
        [
            [0, 1, 2].map(|axis| low[axis].min(p[axis])),
            [0, 1, 2].map(|axis| high[axis].max(p[axis])),
        ]
    })
}

/// The nearest body vertex nearer than `sight`.
fn see(
    grid: &Grid,
    body: &[[f32; 3]],
    [low, high]: &[[f32; 3]; 2],
    centre: [f32; 3],
    sight: f32,
) -> Option<Sight> {
    // A body that is nowhere near is not searched for.
    let inside = [0, 1, 2].map(|axis| centre[axis].clamp(low[axis], high[axis]));
    if distance(inside, centre) >= sight {
        return None;
    }
    let (vertex, _) = grid.nearest(centre)?;
    let distance = distance(centre, body[vertex as usize]);
    (distance < sight).then(|| Sight {
        vertex,
        distance,
        share: (1.0 - (distance / sight).powi(2)).powi(2),
    })
}

fn csr_of(rows: &[Vec<u32>]) -> Csr {
    let mut offsets = vec![0u32];
    for row in rows {
        offsets.push(offsets.last().expect("not empty") + row.len() as u32);
    }
    Csr {
        offsets,
        items: rows.concat(),
    }
}

impl FrameGraph {
    /// Derives the structure of one frame.
    ///
    /// # Errors
    /// [`ModelError::Input`] if state or body do not fit the outfit, or are not finite.
    pub fn new(
        config: &ModelConfig,
        outfit: &Outfit,
        state: &[StatePair],
        step: &Step,
    ) -> Result<Self> {
        check(outfit, state, step)?;
        let patches = &outfit.patches;
        let patch_states = patch_means(&patches.members, state);
        let centres: Vec<[f32; 3]> = patch_states.iter().map(position).collect();
        let body: Vec<[f32; 3]> = step.body.iter().map(position).collect();
        let senders = patches.count() + outfit.attributes.len();

        let layer_grid = Grid::build(&centres, config.layer_radius);
        let mesh = each(patches.count(), |patch, _| {
            let attributes = outfit.patch_attributes.row(patch).iter();
            let attributes = attributes.map(|&a| a + patches.count() as u32);
            let neighbours = patches.neighbours.row(patch).iter().copied();
            neighbours.chain(attributes).collect::<Vec<u32>>()
        });
        let world = each(patches.count(), |patch, found| {
            let neighbours = patches.neighbours.row(patch);
            layer_grid.within(centres[patch], config.layer_radius, found);
            let far = |&(q, _): &(u32, f32)| neighbours.binary_search(&q).is_err().then_some(q);
            found.iter().filter_map(far).collect::<Vec<u32>>()
        });

        // Body tokens, and anchors of patches and vertices.
        let has_body = !body.is_empty();
        let mut body_rows: Vec<u32> = Vec::new();
        let mut slots_of_patch: Vec<Vec<(u32, u32)>> = vec![Vec::new(); patches.count()];
        let mut patch_nearest: Vec<Option<(u32, bool)>> = vec![None; patches.count()];
        let mut patch_sight: Vec<Option<Sight>> = vec![None; patches.count()];
        let mut vertex_sight: Vec<Option<Sight>> = vec![None; state.len()];
        let mut vertex_nearest: Vec<Option<u32>> = vec![None; state.len()];
        let mut body_frames: Vec<Matrix> = Vec::new();
        let mut token_rotations: Vec<Matrix> = Vec::new();
        let mut row_of = vec![u32::MAX; body.len()];
        if has_body {
            let normals = vertex_normals(&body, &outfit.body_faces);
            body_frames = each(body.len(), |vertex, _| {
                frame(normals[vertex], config.frame_axis)
            });
            let grid = Grid::build(&body, config.body_radius);
            slots_of_patch = each(patches.count(), |patch, found| {
                body_slots(config, centres[patch], &grid, found)
            });
            body_rows = slots_of_patch
                .iter()
                .flatten()
                .map(|&(vertex, _)| vertex)
                .collect();
            body_rows.sort_unstable();
            body_rows.dedup();
            token_rotations = body_rows
                .iter()
                .map(|&vertex| body_frames[vertex as usize])
                .collect();
            let reach = |p: [f32; 3]| {
                (grid.nearest_within(p, config.body_radius)).map(|(vertex, _)| vertex)
            };
            patch_nearest = each(patches.count(), |patch, _| match reach(centres[patch]) {
                Some(vertex) => Some((vertex, true)),
                None if config.distant_patch_body => {
                    (grid.nearest(centres[patch])).map(|(vertex, _)| (vertex, false))
                }
                None => None,
            });
            if config.patch_sight > 0.0 {
                let bounds = bounds(&body);
                let see = |point| see(&grid, &body, &bounds, point, config.patch_sight);
                patch_sight = each(patches.count(), |patch, _| see(centres[patch]));
                if config.trend {
                    vertex_sight = each(state.len(), |vertex, _| see(position(&state[vertex])));
                }
            }
            vertex_nearest = each(state.len(), |vertex, _| reach(position(&state[vertex])));
        }
        let body_tokens = body_rows.len();
        for (row, &vertex) in body_rows.iter().enumerate() {
            row_of[vertex as usize] = row as u32;
        }
        let anchored = patch_nearest.iter().flatten().map(|&(vertex, _)| vertex);
        for vertex in anchored.chain(vertex_nearest.iter().flatten().copied()) {
            if row_of[vertex as usize] == u32::MAX {
                row_of[vertex as usize] = body_rows.len() as u32;
                body_rows.push(vertex);
            }
        }
        let vertex_anchors: Vec<Anchor> = vertex_nearest
            .iter()
            .zip(vertex_sight)
            .map(|(nearest, sight)| match *nearest {
                Some(vertex) => Anchor {
                    row: Some(row_of[vertex as usize]),
                    frame: body_frames[vertex as usize],
                    sight,
                },
                None => Anchor {
                    row: None,
                    frame: IDENTITY,
                    sight,
                },
            })
            .collect();
        let patch_anchors = patch_nearest
            .iter()
            .zip(patch_sight)
            .map(|(nearest, sight)| match *nearest {
                Some((vertex, within)) => Anchor {
                    row: Some(row_of[vertex as usize]),
                    frame: if within {
                        body_frames[vertex as usize]
                    } else {
                        IDENTITY
                    },
                    sight,
                },
                None => Anchor {
                    row: None,
                    frame: IDENTITY,
                    sight,
                },
            })
            .collect();

        // Wind and gravity are always there: they also carry the root's motion.
        token_rotations.extend(force_frames(config, step));
        let (mut body_lists, mut body_log_count) = (Vec::new(), Vec::new());
        for slots in &slots_of_patch {
            let mut list: Vec<u32> = slots
                .iter()
                .map(|&(vertex, _)| row_of[vertex as usize])
                .collect();
            body_log_count.extend(slots.iter().map(|&(_, repeats)| (repeats as f32).ln()));
            list.extend([body_tokens as u32, body_tokens as u32 + 1]);
            body_log_count.extend([0.0, 0.0]);
            body_lists.push(list);
        }

        let own_patch: Vec<u32> = patches.of_vertex.iter().map(|all| all[0]).collect();
        let (slots, slot_offsets) = decoder_slots(patches, &own_patch, state, &centres);
        let edges = Edges {
            mesh: csr_of(&mesh),
            world: csr_of(&world),
            body: csr_of(&body_lists),
            body_log_count,
            rotations: token_rotations,
            senders,
        };
        Ok(Self {
            patch_states,
            edges: Arc::new(edges),
            body_rows,
            body_tokens,
            vertex_anchors,
            patch_anchors,
            slots,
            slot_offsets,
            own_patch,
            patch_masses: (0..patches.count()).map(|p| outfit.mass(p)).collect(),
        })
    }
}

impl FrameGraph {
    /// State of a patch relative to its nearest body vertex, in the anchor's frame, fading with
    /// the distance d as `(1 − d²/s²)²`, s the configuration's `patch_sight`; zeros beyond.
    pub fn patch_on_body(&self, patch: usize, step: &Step) -> StatePair {
        let anchor = &self.patch_anchors[patch];
        let Some(Sight { vertex, share, .. }) = anchor.sight else {
            return [0.0; 12];
        };
        let (state, body) = (&self.patch_states[patch], &step.body[vertex as usize]);
        turned(
            &std::array::from_fn(|i| share * (state[i] - body[i])),
            anchor,
        )
    }
}

impl FrameGraph {
    /// What a [`Trend`] reads of a vertex.
    pub fn vertex_motion(&self, vertex: usize, state: &StatePair, step: &Step) -> Motion {
        let patch = self.own_patch[vertex] as usize;
        self.motion(patch, &self.vertex_anchors[vertex], state, step)
    }

    fn motion(&self, patch: usize, anchor: &Anchor, state: &StatePair, step: &Step) -> Motion {
        let velocity = |state: &StatePair| [state[3], state[4], state[5]];
        let change = |state: &StatePair| [0, 1, 2].map(|axis| state[3 + axis] - state[9 + axis]);
        Motion {
            velocity: velocity(state),
            acceleration: change(state),
            skin: anchor.sight.map(|sight| {
                let body = &step.body[sight.vertex as usize];
                (sight.distance, velocity(body), change(body))
            }),
            air: step.wind_strength() / self.patch_masses[patch].max(LEAST_MASS),
            gust: step.gust(),
        }
    }

    /// What a trend adds to the accelerations: of each vertex relative to its own patch, then of
    /// each patch, `[N + P]` in units/frame².
    pub fn trend(&self, trend: &Trend, state: &[StatePair], step: &Step) -> Vec<[f32; 3]> {
        if *trend == Trend::default() {
            return vec![[0.0; 3]; state.len() + self.patch_states.len()];
        }
        let patches = each(self.patch_states.len(), |patch, _| {
            let (state, anchor) = (&self.patch_states[patch], &self.patch_anchors[patch]);
            trend.acceleration(&self.motion(patch, anchor, state, step))
        });
        let mut all = each(state.len(), |vertex, _| {
            let whole = trend.acceleration(&self.vertex_motion(vertex, &state[vertex], step));
            let own = patches[self.own_patch[vertex] as usize];
            [0, 1, 2].map(|axis| whole[axis] - own[axis])
        });
        all.extend(patches);
        all
    }
}

/// The four 3-vectors of a relative state in the anchor's frame.
pub(crate) fn turned(state: &StatePair, anchor: &Anchor) -> StatePair {
    let mut out = [0f32; 12];
    for block in 0..4 {
        let v = [state[3 * block], state[3 * block + 1], state[3 * block + 2]];
        out[3 * block..3 * block + 3].copy_from_slice(&rotate(&anchor.frame, v));
    }
    out
}

fn decoder_slots(
    patches: &drape_dataset::patches::Patches,
    own_patch: &[u32],
    state: &[StatePair],
    centres: &[[f32; 3]],
) -> (Vec<Slot>, Vec<u32>) {
    let of_vertex = each(own_patch.len(), |vertex, candidates| {
        let (own, x) = (own_patch[vertex], position(&state[vertex]));
        let neighbours = patches.neighbours.row(own as usize).iter();
        candidates.clear();
        candidates.extend(neighbours.map(|&q| (q, distance(centres[q as usize], x))));
        candidates.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        candidates.truncate(PATCHES_PER_VERTEX);
        let mut kept = [None; PATCHES_PER_VERTEX];
        for (kept, &(q, from_vertex)) in kept.iter_mut().zip(candidates.iter()) {
            let nearer = from_vertex < distance(centres[q as usize], centres[own as usize]);
            *kept = (q == own || nearer).then_some(q);
        }
        kept
    });
    let (mut slots, mut offsets) = (Vec::new(), vec![0u32]);
    for (vertex, kept) in (0u32..).zip(of_vertex) {
        let kept = kept.into_iter().flatten();
        slots.extend(kept.map(|patch| Slot { vertex, patch }));
        offsets.push(slots.len() as u32);
    }
    (slots, offsets)
}

fn force_frames(config: &ModelConfig, step: &Step) -> [Matrix; 2] {
    let g = step.gravity;
    match config.force_frames {
        ForceFrames::Older => [
            step.wind_rotations[1],
            frame([g[3], g[4], g[5]], config.frame_axis),
        ],
        ForceFrames::NewerUnit => [
            step.wind_rotations[0],
            frame(unit([g[0], g[1], g[2]]), config.frame_axis),
        ],
    }
}

fn check(outfit: &Outfit, state: &[StatePair], step: &Step) -> Result<()> {
    let fail = |what, expected: String, found: String| {
        Err(ModelError::Input {
            what,
            expected,
            found,
        })
    };
    if state.len() != outfit.vertices() {
        return fail(
            "garment state",
            format!("{} vertices", outfit.vertices()),
            state.len().to_string(),
        );
    }
    if step.body.len() != outfit.body_vertices {
        return fail(
            "body",
            format!("{} vertices", outfit.body_vertices),
            step.body.len().to_string(),
        );
    }
    let finite = |rows: &[StatePair]| {
        rows.iter()
            .position(|row| !row.iter().all(|value| value.is_finite()))
    };
    if let Some(vertex) = finite(state) {
        return fail(
            "garment state",
            "finite numbers".into(),
            format!("{:?} at vertex {vertex}", state[vertex]),
        );
    }
    if let Some(vertex) = finite(&step.body) {
        return fail(
            "body",
            "finite numbers".into(),
            format!("{:?} at vertex {vertex}", step.body[vertex]),
        );
    }
    if let Some(vertex) = outfit.patches.of_vertex.iter().position(<[u32]>::is_empty) {
        return fail(
            "patches",
            "every vertex in a patch".into(),
            format!("vertex {vertex} belongs to no face"),
        );
    }
    Ok(())
}

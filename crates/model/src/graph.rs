//! Who sees whom in one frame: everything discrete that LayersNet derives from
//! the state and the body before any weight is used.
//!
//! World edges are those of [`drape_dataset::world_edges`]. Body tokens are the
//! distinct body vertices that some patch sees, then wind and gravity, which every
//! patch sees. A vertex takes its motion from at most four patches near it: among
//! the mesh neighbours q of its own patch
//! (lowest index), the four nearest, kept if q is the own patch or nearer to the
//! vertex than to the own patch's centre.
//! Distances are direct differences in f32. A pass whose subject is absent (no
//! body, no second patch in reach) does not run; the result equals masking it.

use std::sync::Arc;

use drape_dataset::patches::{Csr, Patches};
use drape_dataset::sample::{Outfit, StatePair, Step};
use drape_dataset::statistics::{Motion, Trend};
use drape_dataset::support::SupportPose;
use drape_dataset::world_edges::{BODY_NEIGHBOURS, body_nearby, patches_across};
use drape_geometry::grid::Grid;
use drape_geometry::normals::vertex_normals_again;
use rayon::prelude::*;

use crate::config::{BodySlots, ForceFrames, ModelConfig};
use crate::error::{ModelError, Result};
use crate::frames::{IDENTITY, Matrix, frame, rotate, unit};
use crate::kernels::attention::Edges;
use crate::kernels::{fit, for_all_with};

/// Patches a vertex takes its motion from at most.
const PATCHES_PER_VERTEX: usize = 4;
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
#[derive(Clone, Debug, Default)]
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
    /// What each garment hangs from, if there is a trend.
    supports: Vec<Option<SupportPose>>,
    room: Room,
}

/// Items that one thread derives at a time.
const PIECE: usize = 64;

/// What a grid finds.
type Found = Vec<(u32, f32)>;

/// `work(i)` of every `i < count` into `all`, with room for what a grid finds.
fn each<R: Clone + Default + Send>(
    all: &mut Vec<R>,
    count: usize,
    work: impl Fn(usize, &mut Found) -> R + Send + Sync,
) {
    let pieces = fit(all, count).par_chunks_mut(PIECE).enumerate();
    for_all_with(
        pieces,
        |found: &mut Found, (piece, all): (usize, &mut [R])| {
            for (index, to) in (piece * PIECE..).zip(all) {
                *to = work(index, found);
            }
        },
    );
}

/// Lists of any length, put together piece by piece.
#[derive(Clone, Debug)]
struct Lists<I>(Vec<Piece<I>>);

/// [`PIECE`] lists one behind the other, and where each ends.
#[derive(Clone, Debug)]
struct Piece<I> {
    items: Vec<I>,
    ends: Vec<usize>,
}

impl<I> Default for Lists<I> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<I: Send> Lists<I> {
    /// `work(i)` adds the items of list i, of `count` lists.
    fn fill(&mut self, count: usize, work: impl Fn(usize, &mut Found, &mut Vec<I>) + Send + Sync) {
        self.0.resize_with(count.div_ceil(PIECE), || Piece {
            items: Vec::new(),
            ends: Vec::new(),
        });
        let pieces = self.0.par_iter_mut().enumerate();
        for_all_with(pieces, |found: &mut Found, (piece, to)| {
            to.items.clear();
            to.ends.clear();
            for index in piece * PIECE..count.min((piece + 1) * PIECE) {
                work(index, found, &mut to.items);
                to.ends.push(to.items.len());
            }
        });
    }

    fn iter(&self) -> impl Iterator<Item = &[I]> {
        self.0.iter().flat_map(|piece| {
            let mut start = 0;
            let ends = piece.ends.iter();
            ends.map(move |&end| &piece.items[std::mem::replace(&mut start, end)..end])
        })
    }
}

/// What a frame's structure is derived in; its memory serves the next frame.
#[derive(Clone, Debug, Default)]
struct Room {
    centres: Vec<[f32; 3]>,
    body: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    body_frames: Vec<Matrix>,
    layer_grid: Grid,
    body_grid: Grid,
    world: Lists<u32>,
    body_slots: Lists<(u32, u32)>,
    patch_nearest: Vec<Option<(u32, bool)>>,
    patch_sight: Vec<Option<Sight>>,
    vertex_sight: Vec<Option<Sight>>,
    vertex_nearest: Vec<Option<u32>>,
    row_of: Vec<u32>,
    kept: Vec<[Option<u32>; PATCHES_PER_VERTEX]>,
    supporting: Vec<[f32; 3]>,
}

fn position(state: &StatePair) -> [f32; 3] {
    [state[0], state[1], state[2]]
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (x * x + y * y + z * z).sqrt()
}

/// Body slots of a patch: `(token vertex, repeats)`.
fn body_slots(
    config: &ModelConfig,
    centre: [f32; 3],
    grid: &Grid,
    found: &mut Found,
    slots: &mut Vec<(u32, u32)>,
) {
    match config.body_slots {
        BodySlots::Nearest => {
            let nearby = body_nearby(grid, centre, config.body_radius, found);
            slots.extend(nearby.map(|vertex| (vertex, 1)));
        }
        BodySlots::FirstByIndex => {
            grid.within(centre, config.body_radius, found);
            found.truncate(BODY_NEIGHBOURS);
            let repeats = 1 + (BODY_NEIGHBOURS - found.len()) as u32;
            let count = |slot| if slot == 0 { repeats } else { 1 };
            let found = found.iter().enumerate();
            slots.extend(found.map(|(slot, &(vertex, _))| (vertex, count(slot))));
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
        let mut graph = Self::default();
        graph.derive(config, outfit, state, step)?;
        Ok(graph)
    }

    /// [`FrameGraph::new`] in the memory of an earlier frame's structure.
    ///
    /// # Errors
    /// As [`FrameGraph::new`]; what the graph then holds means nothing.
    pub fn derive(
        &mut self,
        config: &ModelConfig,
        outfit: &Outfit,
        state: &[StatePair],
        step: &Step,
    ) -> Result<()> {
        check(outfit, state, step)?;
        let patches = &outfit.patches;
        let count = patches.count();
        let Room {
            centres,
            body,
            normals,
            body_frames,
            layer_grid,
            body_grid: grid,
            world,
            body_slots: slots_of_patch,
            patch_nearest,
            patch_sight,
            vertex_sight,
            vertex_nearest,
            row_of,
            kept,
            supporting,
        } = &mut self.room;
        refill(&mut self.patch_states, patches.means(state));
        refill(centres, self.patch_states.iter().map(position));
        refill(body, step.body.iter().map(position));
        let (centres, body) = (&*centres, &*body);
        layer_grid.rebuild(centres, config.layer_radius);
        let layer_grid = &*layer_grid;
        world.fill(count, |patch, found, items| {
            let (centre, radius) = (centres[patch], config.layer_radius);
            items.extend(patches_across(
                patches, patch, centre, layer_grid, radius, found,
            ));
        });

        // Body tokens, and anchors of patches and vertices.
        let body_rows = &mut self.body_rows;
        body_rows.clear();
        refill(patch_nearest, std::iter::repeat_n(None, count));
        refill(patch_sight, std::iter::repeat_n(None, count));
        refill(vertex_sight, std::iter::repeat_n(None, state.len()));
        refill(vertex_nearest, std::iter::repeat_n(None, state.len()));
        refill(row_of, std::iter::repeat_n(u32::MAX, body.len()));
        body_frames.clear();
        if body.is_empty() {
            slots_of_patch.fill(count, |_, _, _| ());
        } else {
            vertex_normals_again(body, &outfit.body_faces, normals);
            each(body_frames, body.len(), |vertex, _| {
                frame(normals[vertex], config.frame_axis)
            });
            grid.rebuild(body, config.body_radius);
            let grid = &*grid;
            slots_of_patch.fill(count, |patch, found, slots| {
                body_slots(config, centres[patch], grid, found, slots);
            });
            body_rows.extend(slots_of_patch.iter().flatten().map(|&(vertex, _)| vertex));
            body_rows.sort_unstable();
            body_rows.dedup();
            let reach = |p: [f32; 3]| {
                (grid.nearest_within(p, config.body_radius)).map(|(vertex, _)| vertex)
            };
            each(patch_nearest, count, |patch, _| {
                match reach(centres[patch]) {
                    Some(vertex) => Some((vertex, true)),
                    None if config.distant_patch_body => {
                        (grid.nearest(centres[patch])).map(|(vertex, _)| (vertex, false))
                    }
                    None => None,
                }
            });
            if config.patch_sight > 0.0 {
                let bounds = bounds(body);
                let see = |point| see(grid, body, &bounds, point, config.patch_sight);
                each(patch_sight, count, |patch, _| see(centres[patch]));
                if config.trend {
                    each(vertex_sight, state.len(), |vertex, _| {
                        see(position(&state[vertex]))
                    });
                }
            }
            each(vertex_nearest, state.len(), |vertex, _| {
                reach(position(&state[vertex]))
            });
        }
        self.body_tokens = body_rows.len();
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
        let anchor = |nearest: Option<(u32, bool)>, sight| Anchor {
            row: nearest.map(|(vertex, _)| row_of[vertex as usize]),
            frame: match nearest {
                Some((vertex, true)) => body_frames[vertex as usize],
                _ => IDENTITY,
            },
            sight,
        };
        let sights = vertex_nearest.iter().zip(&*vertex_sight);
        refill(
            &mut self.vertex_anchors,
            sights.map(|(nearest, &sight)| anchor(nearest.map(|vertex| (vertex, true)), sight)),
        );
        let sights = patch_nearest.iter().zip(&*patch_sight);
        refill(
            &mut self.patch_anchors,
            sights.map(|(&nearest, &sight)| anchor(nearest, sight)),
        );

        // Wind and gravity are always there: they also carry the root's motion.
        let edges = Arc::make_mut(&mut self.edges);
        edges.senders = count + outfit.attributes.len();
        let (tokens, forces) = (self.body_tokens as u32, force_frames(config, step));
        let seen = self.body_rows[..self.body_tokens].iter();
        let seen = seen.map(|&vertex| body_frames[vertex as usize]);
        refill(&mut edges.rotations, seen.chain(forces));
        [&mut edges.mesh, &mut edges.world, &mut edges.body]
            .into_iter()
            .for_each(Csr::clear);
        for patch in 0..count {
            let attributes = outfit.patch_attributes.row(patch).iter();
            let attributes = attributes.map(|&a| a + count as u32);
            let neighbours = patches.neighbours.row(patch).iter().copied();
            edges.mesh.push_row(neighbours.chain(attributes));
        }
        for items in world.iter() {
            edges.world.push_row(items.iter().copied());
        }
        edges.body_log_count.clear();
        for slots in slots_of_patch.iter() {
            let seen = slots.iter().map(|&(vertex, _)| row_of[vertex as usize]);
            edges.body.push_row(seen.chain([tokens, tokens + 1]));
            let counts = slots.iter().map(|&(_, repeats)| (repeats as f32).ln());
            edges.body_log_count.extend(counts.chain([0.0, 0.0]));
        }

        refill(&mut self.patch_masses, (0..count).map(|p| outfit.mass(p)));
        let poses = outfit.supports.iter().map(|support| match support {
            Some(support) if config.trend => support.pose(&step.body, supporting),
            _ => None,
        });
        refill(&mut self.supports, poses);
        let own_patch = &mut self.own_patch;
        refill(own_patch, patches.of_vertex.iter().map(|all| all[0]));
        each(kept, state.len(), |vertex, candidates| {
            let (own, x) = (own_patch[vertex], position(&state[vertex]));
            decoder_patches(patches, own, x, centres, candidates)
        });
        self.slots.clear();
        refill(&mut self.slot_offsets, [0]);
        for (vertex, kept) in (0u32..).zip(kept) {
            let kept = kept.iter().flatten();
            let slots = kept.map(|&patch| Slot { vertex, patch });
            self.slots.extend(slots);
            self.slot_offsets.push(self.slots.len() as u32);
        }
        Ok(())
    }
}

/// Other items into a list's memory.
pub(crate) fn refill<I>(list: &mut Vec<I>, items: impl IntoIterator<Item = I>) {
    list.clear();
    list.extend(items);
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
    pub fn vertex_motion(
        &self,
        outfit: &Outfit,
        vertex: usize,
        state: &StatePair,
        step: &Step,
    ) -> Motion {
        let patch = self.own_patch[vertex] as usize;
        let (of, rest) = ((patch, outfit.garment_of(vertex)), outfit.rest[vertex]);
        self.motion(of, rest, &self.vertex_anchors[vertex], state, step)
    }

    fn motion(
        &self,
        (patch, garment): (usize, usize),
        rest: [f32; 3],
        anchor: &Anchor,
        state: &StatePair,
        step: &Step,
    ) -> Motion {
        let velocity = |state: &StatePair| [state[3], state[4], state[5]];
        let change = |state: &StatePair| [0, 1, 2].map(|axis| state[3 + axis] - state[9 + axis]);
        let support = self.supports[garment];
        Motion {
            velocity: velocity(state),
            acceleration: change(state),
            skin: anchor.sight.map(|sight| {
                let body = &step.body[sight.vertex as usize];
                (sight.distance, velocity(body), change(body))
            }),
            air: step.wind_strength() / self.patch_masses[patch].max(LEAST_MASS),
            gust: step.gust(),
            support: support.map_or([[0.0; 3]; 2], |support| {
                let hanging = support.hanging(rest);
                let way = [0, 1, 2].map(|axis| hanging[axis] - state[axis]);
                [support.velocity(rest), way]
            }),
        }
    }

    /// What a trend adds to the accelerations: of each vertex relative to its own patch, then of
    /// each patch, `[N + P]` in units/frame².
    pub fn trend(
        &self,
        trend: &Trend,
        outfit: &Outfit,
        state: &[StatePair],
        step: &Step,
    ) -> Vec<[f32; 3]> {
        let mut all = Vec::new();
        self.trend_again(trend, outfit, state, step, &mut all);
        all
    }

    /// [`FrameGraph::trend`] into a buffer that is kept from call to call.
    pub fn trend_again(
        &self,
        trend: &Trend,
        outfit: &Outfit,
        state: &[StatePair],
        step: &Step,
        all: &mut Vec<[f32; 3]>,
    ) {
        let (vertices, patches) =
            fit(all, state.len() + self.patch_states.len()).split_at_mut(state.len());
        if *trend == Trend::default() {
            vertices.fill([0.0; 3]);
            patches.fill([0.0; 3]);
            return;
        }
        for (patch, to) in patches.iter_mut().enumerate() {
            let (state, anchor) = (&self.patch_states[patch], &self.patch_anchors[patch]);
            let first = outfit.patches.members.row(patch)[0] as usize;
            let (of, rest) = ((patch, outfit.garment_of(first)), outfit.patch_rest[patch]);
            *to = trend.acceleration(&self.motion(of, rest, anchor, state, step));
        }
        for (vertex, to) in vertices.iter_mut().enumerate() {
            let motion = self.vertex_motion(outfit, vertex, &state[vertex], step);
            let whole = trend.acceleration(&motion);
            let own = patches[self.own_patch[vertex] as usize];
            *to = [0, 1, 2].map(|axis| whole[axis] - own[axis]);
        }
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

/// Patches that a vertex at `x` takes its motion from.
fn decoder_patches(
    patches: &Patches,
    own: u32,
    x: [f32; 3],
    centres: &[[f32; 3]],
    candidates: &mut Found,
) -> [Option<u32>; PATCHES_PER_VERTEX] {
    let neighbours = patches.neighbours.row(own as usize).iter();
    let from_vertex = neighbours.map(|&q| (q, distance(centres[q as usize], x)));
    refill(candidates, from_vertex);
    candidates.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    candidates.truncate(PATCHES_PER_VERTEX);
    let mut kept = [None; PATCHES_PER_VERTEX];
    for (kept, &(q, from_vertex)) in kept.iter_mut().zip(candidates.iter()) {
        let nearer = from_vertex < distance(centres[q as usize], centres[own as usize]);
        *kept = (q == own || nearer).then_some(q);
    }
    kept
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

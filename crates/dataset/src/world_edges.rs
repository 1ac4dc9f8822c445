//! World edges: who is near whom in space at one instant, whatever the meshes say.
//!
//! A patch stands where its centre is, the mean position of its members. Two patches see
//! each other across a gap if their centres are nearer than [`Reach::layer`] and no mesh
//! edge joins them ([`Patches::neighbours`]): layers that touch, folds, a sleeve on the
//! chest. A patch sees the nearest body vertices within [`Reach::body`]. Both end at the
//! distance itself: d < r, or d = 0; d² is `(dx·dx + dy·dy) + dz·dz` in f32.
//!
//! Edges change with every frame. [`WorldEdges`] has those of a state;
//! [`patches_across`] and [`body_nearby`] are what it asks patch by patch, for callers
//! that keep their own grids from frame to frame.
//! Source: the paper's second attention mask; the published program takes body vertices
//! by index instead of by distance.

use drape_geometry::grid::Grid;

use crate::error::{DatasetError, Result};
use crate::patches::{Csr, Patches};
use crate::sample::{Outfit, StatePair, Step};

/// Body vertices that a patch sees at most.
pub const BODY_NEIGHBOURS: usize = 16;

/// How far a patch sees, in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// To the centres of other patches; 0.6 by default, as in the paper (6 cm at 10 units
    /// to a metre). Larger: more edges, and patches that do not touch among them.
    pub layer: f32,
    /// To body vertices; 0.4 by default, as in the paper (4 cm).
    pub body: f32,
}

impl Default for Reach {
    fn default() -> Self {
        Self {
            layer: 0.6,
            body: 0.4,
        }
    }
}

/// World edges of one frame, by patch.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorldEdges {
    /// Patches that each patch sees, sorted: `[patch]` to patches. Mutual.
    pub patches: Csr,
    /// Body vertices that each patch sees, the nearest first, at most
    /// [`BODY_NEIGHBOURS`]: `[patch]` to body vertices.
    pub body: Csr,
}

impl WorldEdges {
    /// Edges of garments in `state` (`[vertex, 12]`) on the body that `step` leads to.
    /// The start of a sample has those of `sample.state` and `sample.steps[0]`.
    ///
    /// # Errors
    /// A state or a body with another number of vertices than the outfit's, or numbers
    /// that are not finite; a reach that is not positive.
    pub fn new(outfit: &Outfit, state: &[StatePair], step: &Step, reach: Reach) -> Result<Self> {
        check_rows("garment state", state, outfit.vertices())?;
        check_rows("body", &step.body, outfit.body_vertices)?;
        for (name, radius) in [("reach.layer", reach.layer), ("reach.body", reach.body)] {
            if !(radius.is_finite() && radius > 0.0) {
                let expected = "a positive length in units";
                return Err(DatasetError::invalid(name, expected, radius.to_string()));
            }
        }
        let position = |state: &StatePair| [state[0], state[1], state[2]];
        let patches = &outfit.patches;
        let centres: Vec<_> = patches.means(state).map(|mean| position(&mean)).collect();
        let body: Vec<_> = step.body.iter().map(position).collect();
        let layers = Grid::build(&centres, reach.layer);
        let skin = Grid::build(&body, reach.body);
        let (mut edges, mut room) = (Self::default(), Vec::new());
        edges.patches.clear();
        edges.body.clear();
        for (patch, &centre) in centres.iter().enumerate() {
            let across = patches_across(patches, patch, centre, &layers, reach.layer, &mut room);
            edges.patches.push_row(across);
            let nearby = body_nearby(&skin, centre, reach.body, &mut room);
            edges.body.push_row(nearby);
        }
        Ok(edges)
    }
}

/// Patches within `radius` of a patch at `centre` that are not its mesh neighbours, sorted;
/// `centres` is the grid of all centres, `room` is overwritten.
pub fn patches_across<'a>(
    patches: &'a Patches,
    patch: usize,
    centre: [f32; 3],
    centres: &Grid,
    radius: f32,
    room: &'a mut Vec<(u32, f32)>,
) -> impl Iterator<Item = u32> + 'a {
    let neighbours = patches.neighbours.row(patch);
    centres.within(centre, radius, room);
    let far = |&(q, _): &(u32, f32)| neighbours.binary_search(&q).is_err().then_some(q);
    room.iter().filter_map(far)
}

/// The nearest body vertices within `radius` of `centre`, at most [`BODY_NEIGHBOURS`],
/// the nearest first, the lower index first on ties; `room` is overwritten.
pub fn body_nearby<'a>(
    body: &Grid,
    centre: [f32; 3],
    radius: f32,
    room: &'a mut Vec<(u32, f32)>,
) -> impl Iterator<Item = u32> + 'a {
    body.k_nearest(centre, BODY_NEIGHBOURS, radius, room);
    room.iter().map(|&(vertex, _)| vertex)
}

fn check_rows(what: &str, rows: &[StatePair], expected: usize) -> Result<()> {
    if rows.len() != expected {
        let expected = format!("{expected} vertices, as the outfit has");
        return Err(DatasetError::invalid(
            what,
            expected,
            rows.len().to_string(),
        ));
    }
    let finite = |row: &StatePair| row.iter().all(|value| value.is_finite());
    match rows.iter().position(|row| !finite(row)) {
        None => Ok(()),
        Some(vertex) => {
            let place = format!("{what}, vertex {vertex}");
            let found = format!("{:?}", rows[vertex]);
            Err(DatasetError::invalid(place, "finite numbers", found))
        }
    }
}

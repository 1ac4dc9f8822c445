//! Samples: what a learned method sees of a sequence at one instant.
//!
//! States are relative to the moving root: `p_f = x_f − root_f`,
//! `v_f = p_f − p_{f−1}` (units/frame; the time step is one frame). The garment's
//! state holds the current frame first and the older one second; the body's
//! state looks one frame ahead, because its motion is given. [`Outfit`] is what
//! stays fixed for a sequence, [`Step`] what drives one frame, [`Sample`] a start
//! state with the steps and the reference that follow it.
//! Source: `LAYERSNET.md` section 5 of the published program's description;
//! nothing here depends on a tensor library.

use std::sync::Arc;

use drape_geometry::mesh::on_border;

use crate::error::DatasetError;
use crate::patches::{Csr, Patches};
use crate::registry::GarmentKind;
use crate::sequence::{Frame, SequenceHeader, Wind};
use crate::statistics::{Statistics, StatisticsBuilder};
use crate::support::Support;

/// Position and velocity of one vertex, relative to the root: `[pos(3), vel(3)]`.
pub type State = [f32; 6];
/// Two frames of a state, newer first: `[pos, vel, pos, vel]`.
pub type StatePair = [f32; 12];

/// The strongest wind of the paper; strengths are divided by it.
pub const WIND_STRENGTH_SCALE: f32 = 400.0;
/// Name of each attribute and its range in the paper's units, mapped to 0–1
/// (`data-spec/registry.md`); `friction` is between garments.
pub const ATTRIBUTE_RANGES: [(&str, f32, f32); 5] = [
    ("tension", 15.0, 100.0),
    ("bending", 15.0, 200.0),
    ("mass", 0.2, 0.8),
    ("friction", 40.0, 80.0),
    ("body_friction", 40.0, 80.0),
];
/// Column of the mass.
const MASS: usize = 2;

/// What a sequence's garments and body are, apart from where they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Outfit {
    /// Start of each garment in the outfit's vertex numbering, then the vertex count: `[garment + 1]`.
    pub garment_offsets: Vec<usize>,
    /// Kind of each garment.
    pub kinds: Vec<GarmentKind>,
    /// Triangles of all garments in the outfit's vertex numbering.
    pub faces: Vec<[u32; 3]>,
    /// Whether each vertex lies on its garment's border.
    pub on_border: Vec<bool>,
    /// Number of body vertices.
    pub body_vertices: usize,
    /// Triangles of the body.
    pub body_faces: Vec<[u32; 3]>,
    /// Whether each body vertex lies on a border: where a scan may be cut.
    pub body_on_border: Vec<bool>,
    /// Patches of all garments.
    pub patches: Patches,
    /// Distinct attribute rows, `[attribute row, 5]`, each column mapped to 0–1.
    pub attributes: Vec<[f32; 5]>,
    /// Attribute rows of each patch.
    pub patch_attributes: Csr,
    /// What each garment hangs from.
    pub supports: Vec<Option<Support>>,
    /// Rest positions relative to the support's centre, zeros without one: `[vertex, 3]`.
    pub rest: Vec<[f32; 3]>,
    /// Mean of `rest` over each patch's vertices: `[patch, 3]`.
    pub patch_rest: Vec<[f32; 3]>,
}

impl Outfit {
    /// Prepares a sequence's outfit with patches of `patch_size_m` metres (real size).
    ///
    /// # Errors
    /// [`DatasetError::Patches`] if a garment cannot be cut into patches.
    pub fn new(header: &SequenceHeader, patch_size_m: f32) -> Result<Self, DatasetError> {
        let mut garment_offsets = vec![0usize];
        let mut faces = Vec::new();
        let mut attributes: Vec<[f32; 5]> = Vec::new();
        let mut attribute_of_vertex = Vec::new();
        for garment in &header.garments {
            let offset = *garment_offsets.last().expect("starts with one entry");
            faces.extend(
                garment
                    .faces
                    .iter()
                    .map(|face| face.map(|vertex| vertex + offset as u32)),
            );
            garment_offsets.push(offset + garment.rest.len());
            let material = &garment.material;
            let raw = [
                material.tension,
                material.bending,
                material.mass,
                material.friction,
                header.scene.body_friction,
            ];
            let mut row = [0f32; 5];
            for ((value, raw), (_, low, high)) in row.iter_mut().zip(raw).zip(ATTRIBUTE_RANGES) {
                *value = (raw - low) / (high - low);
            }
            let index = attributes
                .iter()
                .position(|known| *known == row)
                .unwrap_or_else(|| {
                    attributes.push(row);
                    attributes.len() - 1
                });
            attribute_of_vertex.extend(std::iter::repeat_n(index as u32, garment.rest.len()));
        }
        let patches =
            Patches::of_outfit(&header.garments, patch_size_m / header.scene.metres_per_uv)?;
        let patch_attributes = Csr::from_pairs(
            patches.count(),
            patches
                .members
                .pairs()
                .map(|(patch, vertex)| (patch, attribute_of_vertex[vertex as usize]))
                .collect(),
        );
        let supports = Support::of_outfit(header);
        let rest = header.garments.iter().zip(&supports);
        let rest = rest.flat_map(|(garment, support)| {
            let points = garment.rest.iter();
            points.map(move |x| match support {
                Some(Support { centre, .. }) => [0, 1, 2].map(|axis| x[axis] - centre[axis]),
                None => [0.0; 3],
            })
        });
        let rest: Vec<[f32; 3]> = rest.collect();
        Ok(Self {
            patch_rest: patches.means(&rest).collect(),
            rest,
            supports,
            garment_offsets,
            kinds: header.garments.iter().map(|garment| garment.kind).collect(),
            on_border: on_border(attribute_of_vertex.len(), &faces),
            faces,
            body_vertices: header.body.vertex_count,
            body_on_border: on_border(header.body.vertex_count, &header.body.faces),
            body_faces: header.body.faces.clone(),
            patches,
            attributes,
            patch_attributes,
        })
    }

    /// Number of garment vertices.
    pub fn vertices(&self) -> usize {
        *self
            .garment_offsets
            .last()
            .expect("one entry more than garments")
    }

    /// Vertex mass of a patch's garment in the paper's units.
    pub fn mass(&self, patch: usize) -> f32 {
        let row = self.patch_attributes.row(patch)[0];
        let (_, low, high) = ATTRIBUTE_RANGES[MASS];
        low + self.attributes[row as usize][MASS] * (high - low)
    }

    /// Garment of a vertex.
    pub fn garment_of(&self, vertex: usize) -> usize {
        let starts = &self.garment_offsets[1..self.garments()];
        starts.partition_point(|&start| start <= vertex)
    }

    /// Number of garments.
    pub fn garments(&self) -> usize {
        self.garment_offsets.len() - 1
    }
}

/// States of one frame, relative to its root.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameStates {
    /// Garment vertices.
    pub garments: Vec<State>,
    /// Body vertices.
    pub body: Vec<State>,
    /// Root: absolute position, velocity, acceleration.
    pub root: [f32; 9],
    /// Wind.
    pub wind: Wind,
}

impl FrameStates {
    /// States of frame `f` from the frames `f`, `f − 1` and `f − 2`; velocity and
    /// acceleration are zero where the older frame does not exist.
    pub fn new(frame: &Frame, previous: Option<&Frame>, second: Option<&Frame>) -> Self {
        let mut states = Self::default();
        states.become_those_of(frame, previous, second);
        states
    }

    /// [`FrameStates::new`] in the same memory.
    pub fn become_those_of(
        &mut self,
        frame: &Frame,
        previous: Option<&Frame>,
        second: Option<&Frame>,
    ) {
        let relative = |frame: &Frame, x: [f32; 3]| {
            let root = frame.root.translation;
            [x[0] - root[0], x[1] - root[1], x[2] - root[2]]
        };
        let state = |x: [f32; 3], older: Option<(&Frame, [f32; 3])>| -> State {
            let p = relative(frame, x);
            let v = older.map_or([0.0; 3], |(older, x)| {
                let q = relative(older, x);
                [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
            });
            [p[0], p[1], p[2], v[0], v[1], v[2]]
        };
        self.garments.clear();
        for (garment, positions) in frame.garments.iter().enumerate() {
            let older = previous.map(|older| (older, &older.garments[garment]));
            let states = positions
                .iter()
                .enumerate()
                .map(|(vertex, &x)| state(x, older.map(|(frame, all)| (frame, all[vertex]))));
            self.garments.extend(states);
        }
        self.body.clear();
        let body = frame.body.iter().enumerate();
        self.body.extend(
            body.map(|(vertex, &x)| state(x, previous.map(|older| (older, older.body[vertex])))),
        );
        let mut root = [0f32; 9];
        for axis in 0..3 {
            let x = frame.root.translation[axis];
            root[axis] = x;
            if let Some(previous) = previous {
                let v = x - previous.root.translation[axis];
                root[3 + axis] = v;
                let older = second.map_or(0.0, |second| {
                    previous.root.translation[axis] - second.root.translation[axis]
                });
                root[6 + axis] = v - older;
            }
        }
        self.root = root;
        self.wind = frame.wind;
    }

    /// Adds this frame to the statistics; accelerations are differences of
    /// velocities to the previous frame's states.
    pub fn collect(&self, previous: &FrameStates, builder: &mut StatisticsBuilder) {
        let rows: Vec<[f32; 9]> = (self.garments.iter().zip(&previous.garments))
            .chain(self.body.iter().zip(&previous.body))
            .map(|(now, old)| {
                let mut row = [0f32; 9];
                row[..6].copy_from_slice(now);
                for axis in 0..3 {
                    row[6 + axis] = now[3 + axis] - old[3 + axis];
                }
                row
            })
            .collect();
        builder.add(&rows, self.root);
    }
}

/// What drives one frame: everything at `t + 1` and `t` that is given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// Body states, next frame first: `[body vertex, 12]`.
    pub body: Vec<StatePair>,
    /// Wind and root motion, next frame first: per frame root velocity (3) and
    /// acceleration (3) normalised, wind quaternion (4), strength/400 (1).
    pub wind: [f32; 22],
    /// Rotation matrices (rows) of the wind quaternions, next frame first; identity without wind.
    pub wind_rotations: [[[f32; 3]; 3]; 2],
    /// Gravity minus the root's acceleration, normalised by the acceleration's statistics, next frame first.
    pub gravity: [f32; 6],
}

impl Step {
    /// The step from `now` to `next`; `gravity` in units/frame².
    pub fn new(
        next: &FrameStates,
        now: &FrameStates,
        statistics: &Statistics,
        gravity: [f32; 3],
    ) -> Self {
        let mut step = Self::default();
        step.lead(next, now, statistics, gravity);
        step
    }

    /// [`Step::new`] in the same memory.
    pub fn lead(
        &mut self,
        next: &FrameStates,
        now: &FrameStates,
        statistics: &Statistics,
        gravity: [f32; 3],
    ) {
        let body = next.body.iter().zip(&now.body);
        self.body.clear();
        self.body
            .extend(body.map(|(newer, older)| pair(newer, older)));
        let mut wind = [0f32; 22];
        let mut normalised_gravity = [0f32; 6];
        for (slot, states) in [next, now].into_iter().enumerate() {
            let (root, columns) = (&statistics.root, &statistics.vertices);
            for column in 0..6 {
                wind[11 * slot + column] =
                    (states.root[3 + column] - root.mean[3 + column]) / root.std[3 + column];
            }
            wind[11 * slot + 6..11 * slot + 10].copy_from_slice(&states.wind.rotation);
            wind[11 * slot + 10] = states.wind.strength / WIND_STRENGTH_SCALE;
            for axis in 0..3 {
                normalised_gravity[3 * slot + axis] =
                    (gravity[axis] - states.root[6 + axis] - columns.mean[6 + axis])
                        / columns.std[6 + axis];
            }
        }
        self.wind = wind;
        self.wind_rotations = [next, now].map(|states| rotation_matrix(states.wind.rotation));
        self.gravity = normalised_gravity;
    }

    /// Coming strength of the wind, of 400.
    pub fn wind_strength(&self) -> f32 {
        self.wind[10]
    }

    /// Change of the wind from this frame to the next: direction times strength/400.
    pub fn gust(&self) -> [f32; 3] {
        let wind = |frame: usize, axis: usize| {
            self.wind_rotations[frame][axis][2] * self.wind[11 * frame + 10]
        };
        [0, 1, 2].map(|axis| wind(0, axis) - wind(1, axis))
    }
}

/// A start state with the steps and the reference that follow it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The outfit.
    pub outfit: Arc<Outfit>,
    /// Garment state at the start: `[vertex, 12]`.
    pub state: Vec<StatePair>,
    /// Steps `0..=k`; the gradient belongs to the last.
    pub steps: Vec<Step>,
    /// Reference state after each step, `[step][vertex, 6]`.
    pub reference: Vec<Vec<State>>,
}

impl Sample {
    /// Sample that starts at `states[1]` (with `states[0]` its history) and makes `states.len() − 2` steps.
    ///
    /// # Panics
    /// If fewer than three states are given.
    pub fn new(
        outfit: Arc<Outfit>,
        states: &[FrameStates],
        statistics: &Statistics,
        gravity: [f32; 3],
    ) -> Self {
        assert!(
            states.len() >= 3,
            "a sample needs a history, a start and at least one step"
        );
        let state = states[1]
            .garments
            .iter()
            .zip(&states[0].garments)
            .map(|(now, old)| pair(now, old))
            .collect();
        let steps = states[1..]
            .windows(2)
            .map(|two| Step::new(&two[1], &two[0], statistics, gravity))
            .collect();
        let reference = states[2..]
            .iter()
            .map(|states| states.garments.clone())
            .collect();
        Self {
            outfit,
            state,
            steps,
            reference,
        }
    }
}

/// Gravity of a scene in units/frame².
pub fn gravity_per_frame(header: &SequenceHeader) -> [f32; 3] {
    header
        .scene
        .gravity
        .map(|g| g / (header.scene.fps * header.scene.fps))
}

/// Joins two frames of a state, newer first.
pub fn pair(newer: &State, older: &State) -> StatePair {
    let mut both = [0f32; 12];
    both[..6].copy_from_slice(newer);
    both[6..].copy_from_slice(older);
    both
}

/// Rotation matrix (rows) of a quaternion (w, x, y, z), which need not be a unit
/// one; the zero quaternion gives the identity.
pub fn rotation_matrix(quaternion: [f32; 4]) -> [[f32; 3]; 3] {
    let q = quaternion.map(f64::from);
    let squared: f64 = q.iter().map(|value| value * value).sum();
    if squared == 0.0 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    let [w, x, y, z] = q.map(|value| value / squared.sqrt());
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
        ],
        [
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
        ],
        [
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
    .map(|row| row.map(|value| value as f32))
}

/// The frame turned about the world's Z axis by `angle_rad`; wind and root turn along.
pub fn turned(frame: &Frame, angle_rad: f64) -> Frame {
    let (sin, cos) = (angle_rad.sin() as f32, angle_rad.cos() as f32);
    let turn = |x: [f32; 3]| [cos * x[0] - sin * x[1], sin * x[0] + cos * x[1], x[2]];
    let half = (
        (angle_rad / 2.0).cos() as f32,
        (angle_rad / 2.0).sin() as f32,
    );
    let compose = |[w, x, y, z]: [f32; 4]| {
        let (c, s) = half;
        [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]
    };
    let mut frame = frame.clone();
    frame
        .body
        .iter_mut()
        .chain(frame.garments.iter_mut().flatten())
        .for_each(|x| *x = turn(*x));
    frame.root.translation = turn(frame.root.translation);
    frame.root.rotation = compose(frame.root.rotation);
    frame.wind.rotation = compose(frame.wind.rotation);
    frame
}

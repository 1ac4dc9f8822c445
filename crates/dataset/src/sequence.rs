//! A layered garment sequence in memory: what is fixed for the whole sequence
//! ([`SequenceHeader`]) and what changes from frame to frame ([`Frame`]).
//!
//! Conventions: lengths in scene units (`scale` units are one metre; 10 by
//! default, so one unit is 0.1 m), Z up, right-handed, positions absolute in
//! the world. Garments are ordered from the inner layer to the outer one.

use crate::registry::{Effect, GarmentKind};

/// What is written once for a sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceHeader {
    /// Name of the sequence, unique in its data set, for example `train_0007`.
    pub name: String,
    /// Units, rates, origin and effects.
    pub scene: SceneMeta,
    /// The prescribed collider.
    pub body: BodyTopology,
    /// Garments, inner layer first.
    pub garments: Vec<Garment>,
}

/// Scene metadata.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneMeta {
    /// Scene units per metre (10: one unit is 0.1 m).
    pub scale: f32,
    /// Frames per second.
    pub fps: f32,
    /// Seed that made the sequence.
    pub seed: u64,
    /// Program that made the frames, for example `drape-sim`, `blender`, `layersnet`.
    pub engine: String,
    /// Version of that program.
    pub engine_version: String,
    /// Effects that were active, sorted.
    pub effects: Vec<Effect>,
    /// Acceleration of gravity in units/s², Z up: `[0, 0, -98.1]`.
    pub gravity: [f32; 3],
    /// Friction of the body in the paper's units (40–80).
    pub body_friction: f32,
    /// Metres that one UV unit stands for, the same for all garments.
    pub metres_per_uv: f32,
    /// The recipe the engine can repeat the sequence from, as JSON; empty when unknown.
    pub recipe: String,
    /// Things that a user of the data should know.
    pub warnings: Vec<String>,
}

/// 10 units to a metre, 30 frames per second, one UV unit is a metre; no effects, no
/// gravity, origin unknown.
impl Default for SceneMeta {
    fn default() -> Self {
        Self {
            scale: 10.0,
            fps: 30.0,
            seed: 0,
            engine: String::new(),
            engine_version: String::new(),
            effects: Vec::new(),
            gravity: [0.0; 3],
            body_friction: 0.0,
            metres_per_uv: 1.0,
            recipe: String::new(),
            warnings: Vec::new(),
        }
    }
}

/// The body's mesh without its motion. By default there is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodyTopology {
    /// Body in its rest pose (the pose in which garments are fitted), `[vertex, 3]`; may be empty.
    pub rest: Vec<[f32; 3]>,
    /// Triangles, `[face, 3]`, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
    /// Number of vertices in every frame.
    pub vertex_count: usize,
}

/// One garment's fixed part.
#[derive(Clone, Debug, PartialEq)]
pub struct Garment {
    /// Name, unique in the outfit.
    pub name: String,
    /// Kind, from the registry.
    pub kind: GarmentKind,
    /// Layer, 0 next to the body.
    pub layer: u32,
    /// Rest positions, `[vertex, 3]`, on the body's rest pose.
    pub rest: Vec<[f32; 3]>,
    /// Triangles, `[face, 3]`.
    pub faces: Vec<[u32; 3]>,
    /// UV coordinates, `[uv, 2]`, in `[0, 1]`.
    pub uv: Vec<[f32; 2]>,
    /// UV index of each triangle corner, `[face, 3]`.
    pub uv_faces: Vec<[u32; 3]>,
    /// Panel index of each triangle, `[face]`.
    pub panel_of_face: Vec<u32>,
    /// Panel names.
    pub panels: Vec<String>,
    /// Material.
    pub material: Material,
}

/// Material in the paper's units (`PAPER.md`, section B: mass 0.2–0.8 per
/// vertex, stiffness 15–100, friction 40–80).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Vertex mass.
    pub mass: f32,
    /// Tension stiffness.
    pub tension: f32,
    /// Compression stiffness.
    pub compression: f32,
    /// Shear stiffness.
    pub shear: f32,
    /// Bending stiffness.
    pub bending: f32,
    /// Friction between garments.
    pub friction: f32,
}

/// One instant of a sequence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Body positions, `[vertex, 3]`, absolute.
    pub body: Vec<[f32; 3]>,
    /// Root of the body.
    pub root: Root,
    /// Positions of each garment, `[garment][vertex, 3]`, absolute.
    pub garments: Vec<Vec<[f32; 3]>>,
    /// Wind.
    pub wind: Wind,
    /// Intersections counted in this frame; `None` when nobody counted.
    pub intersections: Option<Intersections>,
}

/// Rigid transform of the body's root joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Root {
    /// Position in units.
    pub translation: [f32; 3],
    /// Rotation, unit quaternion (w, x, y, z).
    pub rotation: [f32; 4],
}

impl Default for Root {
    fn default() -> Self {
        Self {
            translation: [0.0; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
        }
    }
}

/// Wind of one frame. No wind: all zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wind {
    /// Unit quaternion (w, x, y, z) that turns +Z into the wind's direction; zeros without wind.
    pub rotation: [f32; 4],
    /// Strength in the paper's units, 0–400.
    pub strength: f32,
}

/// Edge–triangle hits in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Intersections {
    /// Between different garments.
    pub between_garments: u32,
    /// Within one garment.
    pub within_garments: u32,
    /// Between garments and the body.
    pub with_body: u32,
}

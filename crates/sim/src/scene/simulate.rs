//! From a recipe to a sequence.
//!
//! The garments are made on the body in the fitting pose and hang for the
//! still frames of the lead-in, while the engine warms up: distances start out
//! large and shrink to what they are. Then the body eases into its motion; only
//! then frames are recorded, each with its intersections counted.

use std::ops::ControlFlow;

use drape_dataset::intersections::count_intersections;
use drape_dataset::sequence::{
    BodyTopology, Frame, Intersections, Root, SceneMeta, SequenceHeader, Wind,
};
use drape_geometry::intersect::count_within;

use super::effects::{active_effects, forced_off};
use super::recipe::{BodyGap, Recipe};
use super::wind::wind_at;
use crate::body::{Body, Pose, ShapedBody};
use crate::engine::{Engine, ScenePhysics};
use crate::error::{Result, SimError};
use crate::garment::{METRES_PER_UV, Outfit, fitting_pose};
use crate::motion::keep_clear;

/// Scene units per metre.
pub(super) const SCALE: f32 = 10.0;

/// How far a simulation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Frames done, lead-in included.
    pub done: usize,
    /// Frames in all, lead-in included; fewer than asked for when the motion had to be cut.
    pub of: usize,
    /// Hits in the frame that was done last; none while in the lead-in.
    pub intersections: Option<Intersections>,
}

/// Simulates a recipe; `substeps` replaces the engine's number of steps a
/// frame. `progress` is called after every frame and may break off.
///
/// # Errors
/// Garments that do not fit the body, settings out of range, a simulation that
/// blew up ([`SimError::NotFinite`]), or [`SimError::Stopped`].
pub fn simulate(
    recipe: &Recipe,
    substeps: Option<u32>,
    progress: impl FnMut(Progress) -> ControlFlow<()>,
) -> Result<(SequenceHeader, Vec<Frame>)> {
    let mut recipe = recipe.clone();
    recipe.blender = None;
    if let Some(substeps) = substeps {
        recipe.engine.substeps = substeps;
    }
    run(&recipe, progress, |stage, header| {
        let physics = ScenePhysics {
            scale: SCALE,
            gravity: recipe.gravity,
            air_density: recipe.air_density,
            body_friction: recipe.body_friction,
            effects: header.scene.effects.iter().copied().collect(),
        };
        Engine::new(
            &stage.outfit.garments,
            &stage.outfit.waistbands,
            &header.body.faces,
            &stage.outfit.body,
            &physics,
            &recipe.engine,
        )
    })
}

/// What moves the garments of a scene on its body.
pub(super) trait Mover {
    /// The next frame is one of the still ones, with this share of them to come after it.
    fn warm_up(&mut self, share: f64);

    /// Goes on to the next frame, in which the body is there.
    fn advance(&mut self, body: &[[f32; 3]], wind: Wind, dt_s: f64) -> Result<()>;

    /// Positions of each garment.
    fn garments(&self) -> Vec<Vec<[f32; 3]>>;
}

impl Mover for Engine {
    fn warm_up(&mut self, share: f64) {
        Self::warm_up(self, share);
    }

    fn advance(&mut self, body: &[[f32; 3]], wind: Wind, dt_s: f64) -> Result<()> {
        Self::advance(self, body, wind, dt_s).map(|_| ())
    }

    fn garments(&self) -> Vec<Vec<[f32; 3]>> {
        Self::garments(self)
    }
}

/// A dressed body and the way it will go.
pub(super) struct Stage<'a> {
    pub recipe: &'a Recipe,
    pub outfit: &'a Outfit,
    shaped: &'a ShapedBody<'a>,
    poses: &'a [Pose],
}

impl Stage<'_> {
    /// Body of every frame after the start, lead-in included.
    pub fn bodies(&self) -> impl Iterator<Item = Vec<[f32; 3]>> {
        self.poses.iter().map(|pose| self.shaped.pose(pose))
    }

    /// Wind of one of these frames; the lead-in is calm.
    pub fn wind(&self, number: usize) -> Wind {
        let lead = self.recipe.lead_in;
        number
            .checked_sub(lead.still + lead.ease)
            .map_or_else(Wind::default, |frame| wind_at(&self.recipe.wind, frame))
    }
}

/// Makes a recipe's scene, lets what `start` gives move the garments, and
/// records it. `start` may say in the header what is different with it.
pub(super) fn run<M: Mover>(
    recipe: &Recipe,
    mut progress: impl FnMut(Progress) -> ControlFlow<()>,
    start: impl FnOnce(&Stage, &mut SequenceHeader) -> Result<M>,
) -> Result<(SequenceHeader, Vec<Frame>)> {
    let body = Body::load()?;
    let shaped = body.shaped(&recipe.shape);
    let outfit = recipe.outfit(&body, &shaped)?;
    let rest = fitting_pose(&body, &shaped)?;
    let fps = f64::from(recipe.fps);
    let lead = recipe.lead_in;
    let first = lead.still + lead.ease;
    let looked_at = recipe.body_gap.map_or(0, |gap| gap.frames);
    let mut poses = recipe.motion.poses(
        &body,
        &shaped,
        &rest,
        fps,
        lead,
        recipe.frames.max(looked_at),
    )?;
    // The mesh has a few hits of its own at mouth and toes.
    let at_rest = count_within(&outfit.body, body.faces());
    let crosses = |positions: &[[f32; 3]]| count_within(positions, body.faces()) > at_rest;
    let cleared = make_room(recipe, &body, &shaped, &crosses, &mut poses)?;
    poses.truncate(first + recipe.frames);

    let mut header = header(recipe, &body, &outfit);
    header.scene.warnings.extend(cleared);
    let stage = Stage {
        recipe,
        outfit: &outfit,
        shaped: &shaped,
        poses: &poses,
    };
    let mut mover = start(&stage, &mut header)?;
    let mut frames = Vec::with_capacity(recipe.frames);
    let mut crossed_body = 0;
    for (number, pose) in poses.iter().enumerate() {
        let positions = shaped.pose(pose);
        let wind = stage.wind(number);
        if number < lead.still {
            mover.warm_up(1.0 - (number + 1) as f64 / lead.still as f64);
        }
        mover.advance(&positions, wind, 1.0 / fps)?;
        if number >= first {
            // With room asked for, such frames are cut already.
            let crossed = recipe.body_gap.is_none() && crosses(&positions);
            crossed_body += u32::from(crossed);
            let garments = mover.garments();
            frames.push(frame(&shaped, pose, positions, garments, &header, wind)?);
        }
        let now = Progress {
            done: number + 1,
            of: poses.len(),
            intersections: frames.last().and_then(|frame| frame.intersections),
        };
        if progress(now).is_break() {
            return Err(SimError::Stopped { frame: number + 1 });
        }
    }
    if crossed_body > 0 {
        header.scene.warnings.push(format!(
            "the body intersects itself more than in the fitting pose in {crossed_body} of {} frames",
            frames.len()
        ));
    }
    Ok((header, frames))
}

/// Turns limbs away from the body and cuts the motion before the first frame
/// in which one stays too close or the body's skin crosses itself; says what it did.
fn make_room(
    recipe: &Recipe,
    body: &Body,
    shaped: &ShapedBody,
    crosses: &impl Fn(&[[f32; 3]]) -> bool,
    poses: &mut Vec<Pose>,
) -> Result<Vec<String>> {
    let Some(BodyGap { gap_m, .. }) = recipe.body_gap else {
        return Ok(Vec::new());
    };
    let gap = gap_m * f64::from(SCALE);
    let clearance = keep_clear(body, shaped, poses, recipe.lead_in.still, gap)?;
    let mut said = Vec::new();
    let mm = gap_m * 1e3;
    if !clearance.turned.is_empty() {
        said.push(format!(
            "limbs turned away to keep {mm:.0} mm from the body in {} of {} frames, lead-in included",
            clearance.turned.len(),
            poses.len()
        ));
    }
    if let Some(&first) = clearance.tight.first() {
        said.push(format!(
            "frames from {first} on were cut, lead-in included: a limb is nearer than {mm:.0} mm to the body"
        ));
        poses.truncate(first);
    }
    let crossed = (recipe.lead_in.still..poses.len()).find(|&k| crosses(&shaped.pose(&poses[k])));
    if let Some(first) = crossed {
        said.push(format!(
            "frames from {first} on were cut, lead-in included: the body intersects itself more than in the fitting pose"
        ));
        poses.truncate(first);
    }
    Ok(said)
}

fn header(recipe: &Recipe, body: &Body, outfit: &Outfit) -> SequenceHeader {
    SequenceHeader {
        name: recipe.name.clone(),
        scene: SceneMeta {
            scale: SCALE,
            fps: recipe.fps,
            seed: recipe.seed,
            engine: "drape-sim".into(),
            engine_version: env!("CARGO_PKG_VERSION").into(),
            effects: active_effects(recipe).into_iter().collect(),
            gravity: recipe.gravity,
            body_friction: recipe.body_friction,
            metres_per_uv: METRES_PER_UV as f32,
            recipe: recipe.to_json(),
            warnings: forced_off(recipe).into_iter().collect(),
        },
        body: BodyTopology {
            rest: outfit.body.clone(),
            faces: body.faces().to_vec(),
            vertex_count: body.vertex_count(),
        },
        garments: outfit.garments.clone(),
    }
}

fn frame(
    shaped: &ShapedBody,
    pose: &Pose,
    body: Vec<[f32; 3]>,
    garments: Vec<Vec<[f32; 3]>>,
    header: &SequenceHeader,
    wind: Wind,
) -> Result<Frame> {
    let (place, turn) = shaped.joints(pose)[0];
    let [x, y, z, w] = turn.to_array().map(|value| value as f32);
    let mut frame = Frame {
        body,
        root: Root {
            translation: place.to_array().map(|value| value as f32),
            rotation: [w, x, y, z],
        },
        garments,
        wind,
        intersections: None,
    };
    // Counting skips numbers that are not finite, so they are looked for first.
    for (positions, garment) in frame.garments.iter().zip(&header.garments) {
        let broken = |p: &[f32; 3]| !p.iter().all(|x| x.is_finite());
        if let Some(vertex) = positions.iter().position(broken) {
            return Err(SimError::NotFinite {
                surface: garment.name.clone(),
                vertex,
                found: positions[vertex],
            });
        }
    }
    frame.intersections = Some(count_intersections(header, &frame));
    Ok(frame)
}

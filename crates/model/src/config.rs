//! Configuration of LayersNet: one struct, two presets.
//!
//! [`ModelConfig::released`] computes what the published program computes
//! (equal numbers); [`ModelConfig::default`] is the paper's model with the
//! handling of the program's fragile points. Each difference is a field.

use drape_dataset::world_edges::Reach;
use serde::{Deserialize, Serialize};

use crate::error::ModelError;

/// LayersNet's choices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelConfig {
    /// Attention blocks. More: better, slower. Default 4.
    pub blocks: usize,
    /// Reach of the body in units (0.4 = 4 cm real at scale 10): patches and
    /// vertices farther away do not see it. Released 0.6, default (the paper) 0.4.
    pub body_radius: f32,
    /// Reach of world edges between patches in units. Released 0.4, default (the paper) 0.6.
    pub layer_radius: f32,
    /// Which body vertices a patch sees. Released `first-by-index`, default `nearest`.
    pub body_slots: BodySlots,
    /// Which head slots body messages are added to. Released `first-four`, default `own`.
    pub body_messages: BodyMessages,
    /// Frames of wind and gravity. Released `older`, default `newer-unit`.
    pub force_frames: ForceFrames,
    /// Statistics that scale the decoder's output. Released `velocity`, default `acceleration`.
    pub output_scale: OutputScale,
    /// Whether patches beyond the body's reach still get its nearest vertex in
    /// the decoder. Released true, default false.
    pub distant_patch_body: bool,
    /// Reach in units within which a patch's own rows of the decoder hold its state relative to the
    /// nearest body vertex, as a vertex's rows hold its state relative to the patch; it fades to
    /// nothing at the reach. With it the model sees how cloth moves along the skin. Released 0
    /// (the rows hold zeros), default 3.
    pub patch_sight: f32,
    /// Whether training fits a [`drape_dataset::statistics::Trend`], to which the decoder's
    /// accelerations are added as to their mean. Released false (none), default true.
    pub trend: bool,
    /// How a normal is completed to a frame. Released `fixed-x`, default `smallest-component`.
    pub frame_axis: FrameAxis,
    /// Gravity used to make samples. Released `released`, default `scene`.
    pub gravity: GravitySource,
}

/// Which body vertices within reach become a patch's body tokens (at most 16).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BodySlots {
    /// The first 16 in vertex numbering; fewer are padded by repeating the first.
    FirstByIndex,
    /// The nearest 16, each once.
    Nearest,
}

/// Head slots that receive the messages of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BodyMessages {
    /// Group g's go to head slot g, although its world head is head 2g.
    FirstFour,
    /// To the head they were attended with.
    Own,
}

/// Local frames of the wind and gravity tokens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForceFrames {
    /// Of the older frame; gravity normalised by statistics, not a unit vector.
    Older,
    /// Of the newer frame; gravity (minus the root's acceleration) as a unit vector.
    NewerUnit,
}

/// Statistics that turn decoder outputs into accelerations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutputScale {
    /// Of velocities.
    Velocity,
    /// Of accelerations.
    Acceleration,
}

/// The axis that a frame's tangent starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameAxis {
    /// (1, 0, 0), with 1 in each further component where the normal's is below 1e-7;
    /// degenerate near ±x.
    FixedX,
    /// The axis of the normal's smallest component; identity without a normal.
    SmallestComponent,
}

/// Which gravity enters the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GravitySource {
    /// 9.8/30 units/frame² downwards, whatever the scene.
    Released,
    /// The scene's own, in units/frame².
    Scene,
}

impl Default for ModelConfig {
    fn default() -> Self {
        let reach = Reach::default();
        Self {
            blocks: 4,
            body_radius: reach.body,
            layer_radius: reach.layer,
            body_slots: BodySlots::Nearest,
            body_messages: BodyMessages::Own,
            force_frames: ForceFrames::NewerUnit,
            output_scale: OutputScale::Acceleration,
            distant_patch_body: false,
            patch_sight: 3.0,
            trend: true,
            frame_axis: FrameAxis::SmallestComponent,
            gravity: GravitySource::Scene,
        }
    }
}

impl ModelConfig {
    /// The published program's choices.
    pub fn released() -> Self {
        Self {
            blocks: 4,
            body_radius: 0.6,
            layer_radius: 0.4,
            body_slots: BodySlots::FirstByIndex,
            body_messages: BodyMessages::FirstFour,
            force_frames: ForceFrames::Older,
            output_scale: OutputScale::Velocity,
            distant_patch_body: true,
            patch_sight: 0.0,
            trend: false,
            frame_axis: FrameAxis::FixedX,
            gravity: GravitySource::Released,
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`ModelError::Config`] naming the field.
    pub fn validate(&self) -> Result<(), ModelError> {
        let fail = |field, found: String, expected| {
            Err(ModelError::Config {
                field,
                found,
                expected,
            })
        };
        if !(1..=64).contains(&self.blocks) {
            return fail("blocks", self.blocks.to_string(), "1 to 64");
        }
        for (field, radius) in [
            ("body_radius", self.body_radius),
            ("layer_radius", self.layer_radius),
        ] {
            if !(radius.is_finite() && radius > 0.0) {
                return fail(field, radius.to_string(), "a positive length in units");
            }
        }
        if !(self.patch_sight.is_finite() && self.patch_sight >= 0.0) {
            let found = self.patch_sight.to_string();
            return fail("patch_sight", found, "a length in units, or 0 for none");
        }
        Ok(())
    }
}

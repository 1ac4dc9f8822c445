//! Scenes: a [`Recipe`] says everything about a sequence; [`simulate`] makes it.
//!
//! The same recipe makes the same bits at any thread count. A recipe is stored
//! as JSON in the sequence it made, so that the engine can repeat it with other
//! settings.

mod cut_range;
mod effects;
mod in_blender;
mod quality;
mod ranges;
mod recipe;
mod simulate;
mod wind;

pub use cut_range::CutRange;
pub use effects::active_effects;
pub use in_blender::simulate_in_blender;
pub use quality::Quality;
pub use ranges::{SceneRanges, Units};
pub use recipe::{BodyGap, Recipe, RecipeGarment};
pub use simulate::{Progress, simulate};
pub use wind::{WindPivot, wind_at};

//! Scenes: a [`Recipe`] says everything about a sequence; [`simulate`] makes it.
//!
//! The same recipe makes the same bits at any thread count. A recipe is stored
//! as JSON in the sequence it made, so that the engine can repeat it with other
//! settings.

mod clean;
mod effects;
mod in_blender;
mod ranges;
mod recipe;
mod simulate;
mod wind;

pub use effects::active_effects;
pub use in_blender::simulate_in_blender;
pub use ranges::SceneRanges;
pub use recipe::{Recipe, RecipeGarment};
pub use simulate::{Progress, simulate};
pub use wind::{WindPivot, wind_at};

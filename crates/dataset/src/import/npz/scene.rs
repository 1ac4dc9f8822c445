//! Gravity, effects and recipe of an imported scene, from Blender's settings.

use serde_json::{Value, json};

use super::arrays::Arrays;
use crate::error::Result;
use crate::registry::Effect;
use crate::sequence::{Garment, Material};

/// Blender's cloth lives in frames: gravity g acts as 0.001·g units/frame².
const BLENDER_GRAVITY: f64 = 0.001;

/// Acceleration of gravity in units/s².
pub(super) fn gravity(arrays: &Arrays, settings: &Value, fps: f64) -> Result<[f32; 3]> {
    let read = |k: usize| settings["gravity"][k].as_f64();
    match (read(0), read(1), read(2)) {
        (Some(x), Some(y), Some(z)) => {
            Ok([x, y, z].map(|g| (g * BLENDER_GRAVITY * fps * fps) as f32))
        }
        _ => {
            let found = settings["gravity"].to_string();
            Err(arrays.invalid("settings", "\"gravity\": [x, y, z]", found))
        }
    }
}

/// What the scene called for besides the garments' own stiffness.
pub(super) struct Active {
    pub(super) gravity: bool,
    pub(super) wind: bool,
    pub(super) air_drag: bool,
    pub(super) self_collision: bool,
    pub(super) waistband: bool,
    pub(super) body: bool,
}

/// Active effects, in the registry's order.
pub(super) fn effects(garments: &[Garment], body_friction: f32, active: &Active) -> Vec<Effect> {
    let any = |of: &dyn Fn(&Material) -> f32| garments.iter().any(|g| of(&g.material) > 0.0);
    let is_active = |effect: Effect| match effect {
        Effect::Gravity => active.gravity,
        Effect::Wind => active.wind,
        Effect::AirDrag => active.air_drag,
        Effect::Stretch => any(&|m| m.tension.max(m.compression)),
        Effect::Shear => any(&|m| m.shear),
        Effect::Bending => any(&|m| m.bending),
        Effect::BodyContact => active.body,
        // One merged cloth object: its self-collision is also what keeps layers apart.
        Effect::LayerContact => active.self_collision && garments.len() > 1,
        Effect::SelfContact => active.self_collision,
        Effect::Friction => body_friction > 0.0 || any(&|m| m.friction),
        Effect::Waistband => active.waistband,
    };
    Effect::ALL
        .iter()
        .copied()
        .filter(|&effect| is_active(effect))
        .collect()
}

/// What a Blender script needs to simulate the scene again.
pub(super) fn recipe(arrays: &mut Arrays, settings: Value) -> Result<String> {
    let mut recipe = json!({ "settings": settings });
    if arrays.has("motion") {
        recipe["motion"] = arrays.json("motion")?;
    }
    if arrays.has("body_shape") {
        recipe["body_shape"] = arrays.strings("body_shape")?.into();
    }
    Ok(recipe.to_string())
}

//! Which effects a scene calls for: what does not occur in it is not active.

use std::collections::BTreeSet;

use drape_dataset::registry::{Effect, GarmentKind};

use super::recipe::Recipe;

/// Effects that the recipe's scene calls for, less those that its settings force off.
pub fn active_effects(recipe: &Recipe) -> BTreeSet<Effect> {
    let garments = || recipe.garments.iter();
    let windy = recipe.wind.iter().any(|pivot| pivot.strength > 0.0);
    let rubs = recipe.body_friction > 0.0 || garments().any(|g| g.material.friction > 0.0);
    let banded =
        garments().any(|g| matches!(g.parameters.kind, GarmentKind::Skirt | GarmentKind::Pants));
    let stretches = garments().any(|g| g.material.tension > 0.0 || g.material.compression > 0.0);
    let called_for = |effect: Effect| match effect {
        Effect::Gravity => recipe.gravity != [0.0; 3],
        Effect::Wind => windy && recipe.air_density > 0.0,
        Effect::AirDrag => recipe.air_density > 0.0,
        Effect::BodyContact | Effect::SelfContact => true,
        Effect::Stretch => stretches,
        Effect::Shear => garments().any(|g| g.material.shear > 0.0),
        Effect::Bending => garments().any(|g| g.material.bending > 0.0),
        Effect::LayerContact => recipe.garments.len() > 1,
        Effect::Friction => rubs,
        Effect::Waistband => banded,
    };
    Effect::ALL
        .iter()
        .copied()
        .filter(|&effect| called_for(effect) && !recipe.engine.without.contains(&effect))
        .collect()
}

/// What a sequence says of effects that were forced off; nothing if none was.
pub(super) fn forced_off(recipe: &Recipe) -> Option<String> {
    let names: Vec<&str> = recipe.engine.without.iter().map(|e| e.name()).collect();
    (!names.is_empty()).then(|| format!("forced off by the settings: {}", names.join(", ")))
}

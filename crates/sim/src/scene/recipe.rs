//! Everything that decides a sequence.

use drape_dataset::sequence::Material;
use serde::{Deserialize, Serialize};

use super::ranges::Units;
use super::wind::WindPivot;
use crate::blender::BlenderSettings;
use crate::body::{Body, Shape, ShapedBody};
use crate::engine::{AIR_DENSITY, EngineSettings};
use crate::error::{Result, SimError};
use crate::garment::{GarmentParameters, Outfit, OutfitRequest};
use crate::motion::{LeadIn, Motion};

/// A scene, complete: shape, outfit, motion, wind, engine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Name of the sequence.
    pub name: String,
    /// Seed the recipe was drawn with.
    pub seed: u64,
    /// Recorded frames.
    pub frames: usize,
    /// Frames per second.
    pub fps: f32,
    /// Body shape.
    pub shape: Shape,
    /// Friction of the body in the paper's units.
    pub body_friction: f32,
    /// Garments, inner layer first.
    pub garments: Vec<RecipeGarment>,
    /// Target edge length of the garments' meshes in metres.
    pub edge_m: f64,
    /// Whether inner garments end at their hems for the garments over them too.
    #[serde(default, skip_serializing_if = "is_false")]
    pub trimmed_layers: bool,
    /// Acceleration of gravity in units/s².
    pub gravity: [f32; 3],
    /// Density of the air in kg/m³; recipes that do not say it are of real air.
    #[serde(default = "real_air")]
    pub air_density: f64,
    /// Movement of the body.
    pub motion: Motion,
    /// Room that limbs keep from the rest of the body; without it the motion stays as it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body_gap: Option<BodyGap>,
    /// Frames before the first recorded one.
    pub lead_in: LeadIn,
    /// Wind, pivots in order; empty when calm.
    pub wind: Vec<WindPivot>,
    /// The engine's settings.
    pub engine: EngineSettings,
    /// Settings of Blender, if it makes the sequence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blender: Option<BlenderSettings>,
}

fn real_air() -> f64 {
    AIR_DENSITY
}

fn is_false(x: &bool) -> bool {
    !x
}

/// How limbs are kept clear of the body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyGap {
    /// Gap in metres.
    pub gap_m: f64,
    /// Recorded frames of the motion that are looked at, whatever number of them is simulated.
    pub frames: usize,
}

/// A garment of a recipe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecipeGarment {
    /// Kind and cut.
    pub parameters: GarmentParameters,
    /// Material in the paper's units.
    #[serde(with = "MaterialNumbers")]
    pub material: Material,
}

/// [`Material`] as it is written in recipes.
#[derive(Serialize, Deserialize)]
#[serde(remote = "Material", deny_unknown_fields)]
struct MaterialNumbers {
    mass: f32,
    tension: f32,
    compression: f32,
    shear: f32,
    bending: f32,
    friction: f32,
}

impl Recipe {
    /// The same scene for Blender, which has a gravity and an air of its own.
    pub fn for_blender(mut self, settings: &BlenderSettings) -> Self {
        self.gravity = settings.acceleration(self.fps);
        self.air_density = Units::DLayers.air_density();
        self.blender = Some(settings.clone());
        self
    }

    /// The outfit, made on a body of the recipe's shape.
    ///
    /// # Errors
    /// A garment does not fit.
    pub fn outfit(&self, body: &Body, shaped: &ShapedBody) -> Result<Outfit> {
        let garments: Vec<_> = self
            .garments
            .iter()
            .map(|garment| (garment.parameters, garment.material))
            .collect();
        let request = OutfitRequest {
            garments: &garments,
            edge_m: self.edge_m,
            trimmed_layers: self.trimmed_layers,
        };
        Outfit::fit(body, shaped, &request)
    }

    /// The recipe as it is stored in a sequence.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("numbers and text always have a JSON form")
    }

    /// Reads a stored recipe.
    ///
    /// # Errors
    /// Not a recipe of this version: the error says where.
    pub fn from_json(text: &str) -> Result<Self> {
        serde_json::from_str(text)
            .map_err(|error| SimError::value("recipe", "JSON of a drape-sim recipe", error))
    }
}

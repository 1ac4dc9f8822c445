//! What scenes are drawn from, `[scene]` in a configuration file, and drawing.
//!
//! Every part of a scene has a random stream of its own under the sequence's
//! seed, so that changing one range leaves the other parts as they were.

use std::path::PathBuf;

use drape_dataset::random::stream;
use drape_dataset::registry::GarmentKind;
use drape_dataset::sequence::Material;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::cut_range::CutRange;
use super::recipe::{BodyGap, Recipe, RecipeGarment};
use super::wind;
use crate::body::ShapeRanges;
use crate::engine::{AIR_DENSITY, EngineSettings};
use crate::error::{Result, SimError};
use crate::garment::{EDGES_M, GarmentParameters};
use crate::motion::{Clip, LeadIn, Motion, MotionFamily};

/// Ranges of scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneRanges {
    /// Outfits, inner garment first; sequences take them in turn.
    pub outfits: Vec<Vec<GarmentKind>>,
    /// How garments are cut.
    pub cuts: CutRange,
    /// Families of motions; sequences take them in turn.
    pub motions: Vec<MotionFamily>,
    /// BVH files with recorded motions; sequences take them and the families in turn.
    pub clips: Vec<PathBuf>,
    /// Gap in metres that limbs keep from the rest of the body, more where cloth lies
    /// between; motions are cut before a frame in which they do not, or in which the body
    /// crosses itself. 0 leaves the motions as they are.
    pub body_gap_m: f64,
    /// Units of time and force.
    pub units: Units,
    /// Frames per second.
    pub fps: f32,
    /// Vertices of an outfit, roughly: the meshes' edge length follows from it.
    /// More: finer folds, slower in proportion.
    pub outfit_vertices: f64,
    /// Edge length of all garments in metres, 0.01 to 0.06; 0 lets `outfit_vertices` say.
    pub edge_m: f64,
    /// Speed of the motions: 1 is brisk (a step takes 0.6 s, a squat 2.6 s).
    /// Cloth on slower bodies swings less.
    pub pace: [f64; 2],
    /// Share of the sequences without wind.
    pub calm_share: f64,
    /// Strength of the wind in the paper's units.
    pub wind_strength: [f32; 2],
    /// Frames before the first recorded one: still in the fitting pose, then
    /// easing into the motion.
    pub lead_in: LeadIn,
    /// Body shapes.
    pub body: ShapeRanges,
    /// Materials.
    pub material: MaterialRanges,
}

/// Ranges of materials in the paper's units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaterialRanges {
    /// Vertex mass.
    pub mass: [f32; 2],
    /// Tension, compression, shear and bending stiffness, each drawn alone.
    pub stiffness: [f32; 2],
    /// Friction of garments and body.
    pub friction: [f32; 2],
}

impl Default for MaterialRanges {
    fn default() -> Self {
        Self {
            mass: [0.2, 0.8],
            stiffness: [15.0, 100.0],
            friction: [40.0, 80.0],
        }
    }
}

impl Default for SceneRanges {
    fn default() -> Self {
        use GarmentKind::{Dress, Jacket, Pants, Skirt, TShirt};
        Self {
            outfits: vec![
                vec![TShirt, Jacket],
                vec![Pants, Skirt],
                vec![Pants, Dress],
                vec![Dress, Jacket],
            ],
            cuts: CutRange::Common,
            motions: vec![MotionFamily::Mixed],
            clips: Vec::new(),
            body_gap_m: 0.004,
            units: Units::Real,
            fps: 30.0,
            outfit_vertices: 1650.0,
            edge_m: 0.0,
            pace: [0.5, 0.75],
            calm_share: 0.5,
            wind_strength: [50.0, 400.0],
            lead_in: LeadIn { still: 8, ease: 40 },
            body: ShapeRanges::default(),
            material: MaterialRanges::default(),
        }
    }
}

/// Units of time and force that a scene is simulated in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Units {
    /// The earth's gravity at scale 10: 98.1 units/s².
    Real,
    /// Blender's frame time as in D-LAYERS, where garments float: 8.83 units/s² at 30 frames/s,
    /// and air that pushes as much less.
    DLayers,
}

impl Units {
    /// Acceleration of gravity along Z in units/s².
    pub fn gravity(self) -> f32 {
        match self {
            Self::Real => -98.1,
            Self::DLayers => -8.83,
        }
    }

    /// Density of the air in kg/m³, in proportion to gravity: a wind lifts the same share of a
    /// garment's weight in all units.
    ///
    /// Blender's law was measured face-on: 0.60 · strength · area / mass in units/s² at 30
    /// frames/s, the area and the mass being those of a vertex. Thinned so, our air gives the
    /// same on meshes with edges of 26 mm, and cloth of mass 0.4 at 1 m/s a drag of 0.32 per
    /// second (Blender's: about 0.3). On finer meshes Blender's wind is weaker, because the paper's mass is a
    /// vertex's; ours is not.
    pub fn air_density(self) -> f64 {
        AIR_DENSITY * f64::from(self.gravity() / Self::Real.gravity())
    }
}

impl SceneRanges {
    /// Checks ranges and outfits.
    ///
    /// # Errors
    /// The first range that is empty, out of bounds or not finite, by name.
    pub fn validate(&self) -> Result<()> {
        let range = |name: &str, [low, high]: [f64; 2], [least, most]: [f64; 2]| {
            // Written so that NaN fails too.
            let good = least <= low && low <= high && high <= most;
            if good {
                return Ok(());
            }
            Err(SimError::value(
                format!("scene.{name}"),
                format!("[low, high] with {least} ≤ low ≤ high ≤ {most}"),
                format!("[{low}, {high}]"),
            ))
        };
        let wide = |values: [f32; 2]| values.map(f64::from);
        range("outfit_vertices", [self.outfit_vertices; 2], [100.0, 1e5])?;
        let [least, most] = EDGES_M;
        if self.edge_m != 0.0 && !(least..=most).contains(&self.edge_m) {
            let expected = format!("0, or {least} to {most} metres");
            return Err(SimError::value("scene.edge_m", expected, self.edge_m));
        }
        range("wind_strength", wide(self.wind_strength), [0.0, 400.0])?;
        range("pace", self.pace, [0.05, 3.0])?;
        range("calm_share", [self.calm_share; 2], [0.0, 1.0])?;
        range("fps", [f64::from(self.fps); 2], [1.0, 1000.0])?;
        range("material.mass", wide(self.material.mass), [0.01, 10.0])?;
        range(
            "material.stiffness",
            wide(self.material.stiffness),
            [0.0, 1000.0],
        )?;
        range(
            "material.friction",
            wide(self.material.friction),
            [0.0, 1000.0],
        )?;
        for (name, values) in [
            ("body.sex", self.body.sex),
            ("body.weight", self.body.weight),
            ("body.muscle", self.body.muscle),
            ("body.height", self.body.height),
            ("body.proportions", self.body.proportions),
        ] {
            range(name, values, [0.0, 1.0])?;
        }
        range("body_gap_m", [self.body_gap_m; 2], [0.0, 0.05])?;
        if self.motions.is_empty() && self.clips.is_empty() {
            return Err(SimError::value(
                "scene.motions",
                "at least one family of motions, or scene.clips",
                "none",
            ));
        }
        if self.outfits.is_empty() || self.outfits.iter().any(Vec::is_empty) {
            return Err(SimError::value(
                "scene.outfits",
                "at least one outfit, each with at least one garment",
                format!("{:?}", self.outfits),
            ));
        }
        Ok(())
    }

    /// Motion of the `number`th sequence: families and clips in turn, and shifted at
    /// every round of the outfits, so that each outfit meets all of them.
    fn motion(&self, number: usize, rng: &mut ChaCha8Rng) -> Motion {
        let round = number / self.outfits.len();
        let turn = (number + round) % (self.motions.len() + self.clips.len());
        match self.motions.get(turn) {
            Some(family) => family.sample(rng),
            None => Motion {
                clip: Some(Clip {
                    path: self.clips[turn - self.motions.len()].clone(),
                    start: rng.random(),
                    pace: 1.0,
                }),
                ..Motion::default()
            },
        }
    }

    /// Draws the recipe of sequence `name`, the `number`th of its split.
    pub fn sample(
        &self,
        name: &str,
        number: usize,
        seed: u64,
        frames: usize,
        engine: &EngineSettings,
    ) -> Recipe {
        let part = |part: &str| stream(seed, &format!("{name}/{part}"));
        let material = &self.material;
        let mut rng = part("garments");
        let outfit = &self.outfits[number % self.outfits.len()];
        let is_jacket =
            |kind: &GarmentKind| matches!(kind, GarmentKind::Jacket | GarmentKind::JacketHood);
        let garments: Vec<RecipeGarment> = outfit
            .iter()
            .enumerate()
            .map(|(layer, &kind)| {
                let under_jacket = outfit[layer + 1..].iter().any(is_jacket);
                RecipeGarment {
                    parameters: self.cuts.sample(kind, under_jacket, &mut rng),
                    material: material.sample(&mut rng),
                }
            })
            .collect();
        let mut rng = part("scene");
        let body_friction = between(&mut rng, material.friction.map(f64::from)) as f32;
        let shape = self.body.sample(&mut part("shape"));
        let mut rng = part("wind");
        let calm = rng.random_bool(self.calm_share);
        Recipe {
            name: name.to_string(),
            seed,
            frames,
            fps: self.fps,
            shape,
            body_friction,
            edge_m: match self.edge_m {
                0.0 => edge_for(self.outfit_vertices, &garments, shape.height),
                chosen => chosen,
            },
            garments,
            trimmed_layers: self.cuts == CutRange::All,
            gravity: [0.0, 0.0, self.units.gravity()],
            air_density: self.units.air_density(),
            motion: self
                .motion(number, &mut part("motion"))
                .at_pace(between(&mut part("pace"), self.pace)),
            body_gap: (self.body_gap_m > 0.0).then_some(BodyGap {
                gap_m: self.body_gap_m,
                frames,
            }),
            lead_in: self.lead_in,
            wind: if calm {
                Vec::new()
            } else {
                wind::sample(&mut rng, frames, self.wind_strength)
            },
            engine: engine.clone(),
            blender: None,
        }
    }
}

impl MaterialRanges {
    fn sample(&self, rng: &mut ChaCha8Rng) -> Material {
        let mut draw = |range: [f32; 2]| between(rng, range.map(f64::from)) as f32;
        Material {
            mass: draw(self.mass),
            tension: draw(self.stiffness),
            compression: draw(self.stiffness),
            shear: draw(self.stiffness),
            bending: draw(self.stiffness),
            friction: draw(self.friction),
        }
    }
}

/// Edge length in metres with which an outfit has about so many vertices.
///
/// The counts at 33 mm were measured on drawn outfits; single outfits are up
/// to a fifth off.
fn edge_for(vertices: f64, garments: &[RecipeGarment], height: f64) -> f64 {
    let at_33_mm = |garment: &RecipeGarment| {
        let GarmentParameters {
            kind,
            length,
            flare,
            ..
        } = garment.parameters;
        match kind {
            GarmentKind::TShirt => 650.0,
            GarmentKind::Jacket => 1020.0,
            GarmentKind::JacketHood => 1250.0,
            GarmentKind::Pants => 500.0 + 750.0 * length,
            GarmentKind::Jumpsuit => 1000.0 + 750.0 * length,
            GarmentKind::Skirt => 450.0 + 750.0 * length + 700.0 * flare,
            GarmentKind::Dress => 900.0 + 700.0 * length + 700.0 * flare,
        }
    };
    let all: f64 = garments.iter().map(at_33_mm).sum();
    let taller = 1.0 + 1.5 * (height - 0.4);
    let [least, most] = EDGES_M;
    (0.033 * (all * taller / vertices).sqrt()).clamp(least, most)
}

pub(super) fn between(rng: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

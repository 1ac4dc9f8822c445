//! The bench's scenes: a walking body in garments of known size, in wind.

use anyhow::{Context, Result};
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{Garment, Material, Wind};
use drape_sim::body::{Body, Shape};
use drape_sim::engine::{AIR_DENSITY, ScenePhysics};
use drape_sim::garment::{GarmentParameters, Outfit, OutfitRequest, fitting_pose};
use drape_sim::motion::{LeadIn, Motion, Movement};

use super::refine::{self, Refined};

/// Frames per second.
pub const FPS: f64 = 30.0;
/// Frames before the first measured one.
const LEAD: LeadIn = LeadIn { still: 8, ease: 30 };

/// The middle of the paper's ranges.
const MATERIAL: Material = Material {
    mass: 0.5,
    tension: 50.0,
    compression: 50.0,
    shear: 50.0,
    bending: 50.0,
    friction: 60.0,
};

/// What people wear in the bench.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Wardrobe {
    /// T-shirt under a jacket.
    Jacket,
    /// Two skirts.
    Skirts,
}

/// Everything the engine needs.
pub struct Scene {
    pub garments: Vec<Garment>,
    pub waistbands: Vec<Vec<u32>>,
    pub body_faces: Vec<[u32; 3]>,
    /// Body of each frame, `[frame][vertex]`.
    pub bodies: Vec<Vec<[f32; 3]>>,
    /// Frames that lead in, not measured.
    pub lead: usize,
    pub physics: ScenePhysics,
    pub wind: Wind,
}

impl Scene {
    /// A walk of `frames` frames at `pace` in wind of `strength`.
    pub fn new(
        wardrobe: Wardrobe,
        garment_vertices: usize,
        body_vertices: usize,
        frames: usize,
        pace: f64,
        strength: f32,
    ) -> Result<Self> {
        let body = Body::load()?;
        let shaped = body.shaped(&Shape::default());
        let rest = fitting_pose(&body, &shaped)?;
        let cut = |kind, sleeve, flare| {
            let ease_m = 0.04;
            let length = 0.5;
            let parameters = GarmentParameters {
                kind,
                length,
                ease_m,
                sleeve,
                flare,
                panels: 2,
            };
            (parameters, MATERIAL)
        };
        let garments = match wardrobe {
            Wardrobe::Jacket => [
                cut(GarmentKind::TShirt, 0.6, 0.0),
                cut(GarmentKind::Jacket, 1.6, 0.0),
            ],
            Wardrobe::Skirts => [
                cut(GarmentKind::Skirt, 0.0, 0.1),
                cut(GarmentKind::Skirt, 0.0, 0.25),
            ],
        };
        let outfit = fitted(&body, &shaped, &garments, garment_vertices)?;
        let motion = Motion {
            movements: vec![Movement::Walk {
                period_s: 1.2,
                stride_deg: 22.0,
                arms: 0.9,
                phase: 0.0,
            }],
            ..Motion::default()
        }
        .at_pace(pace);
        let poses = motion.poses(&body, &shaped, &rest, FPS, LEAD, frames)?;
        let finer = Refined::new(&outfit.body, body.faces(), body_vertices);
        let bodies = poses
            .iter()
            .map(|pose| finer.positions(&shaped.pose(pose)))
            .collect();
        let effects = Effect::ALL.iter().copied();
        let half = 0.5_f32.sqrt();
        Ok(Self {
            garments: outfit.garments,
            waistbands: outfit.waistbands,
            body_faces: finer.faces,
            bodies,
            lead: LEAD.still + LEAD.ease,
            physics: ScenePhysics {
                scale: 10.0,
                gravity: [0.0, 0.0, -98.1],
                air_density: AIR_DENSITY,
                body_friction: 60.0,
                effects: effects.collect(),
            },
            // From the side.
            wind: Wind {
                rotation: [half, 0.0, half, 0.0],
                strength,
            },
        })
    }

    /// Vertices of all garments.
    pub fn vertices(&self) -> usize {
        self.garments.iter().map(|garment| garment.rest.len()).sum()
    }
}

/// An outfit of about so many vertices: remeshed as finely as garments are
/// made, halving edges beyond that and for what is missing.
fn fitted(
    body: &Body,
    shaped: &drape_sim::body::ShapedBody,
    garments: &[(GarmentParameters, Material)],
    vertices: usize,
) -> Result<Outfit> {
    let made = |edge_m: f64| {
        let request = OutfitRequest {
            garments,
            edge_m,
            trimmed_layers: false,
        };
        Outfit::fit(body, shaped, &request)
    };
    let count = |outfit: &Outfit| -> usize { outfit.garments.iter().map(|g| g.rest.len()).sum() };
    let coarse = 0.033;
    let at_coarse = count(&made(coarse)?) as f64;
    let mut edge = (coarse * (at_coarse / vertices as f64).sqrt()).clamp(0.012, 0.06);
    // The next edge length that fits and does not have more vertices than asked for.
    let mut outfit = (0..20)
        .find_map(|_| {
            let fits = made(edge).ok().filter(|outfit| count(outfit) <= vertices);
            edge *= 1.02;
            fits
        })
        .with_context(|| format!("no outfit of {vertices} vertices fits the bench's body"))?;
    let all = count(&outfit);
    for garment in &mut outfit.garments {
        *garment = refine::garment(garment, garment.rest.len() * vertices / all);
    }
    Ok(outfit)
}

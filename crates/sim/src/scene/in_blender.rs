//! From a recipe to a sequence that Blender simulates.

use std::iter::once;
use std::ops::ControlFlow;

use drape_dataset::registry::Effect;
use drape_dataset::sequence::{Frame, SequenceHeader, Wind};

use super::recipe::Recipe;
use super::simulate::{Mover, Progress, SCALE, Stage, run};
use crate::blender::{Blender, Job, Run, SharedMaterials};
use crate::error::{Result, SimError};

/// Simulates a recipe made [`for_blender`](Recipe::for_blender) as
/// [`simulate`](super::simulate) does with our engine; the header says what
/// Blender made of the materials. Nothing but the solver is different: frames
/// may have intersections, counted in each.
///
/// # Errors
/// As [`simulate`](super::simulate), and when Blender fails.
pub fn simulate_in_blender(
    recipe: &Recipe,
    blender: &Blender,
    progress: impl FnMut(Progress) -> ControlFlow<()>,
) -> Result<(SequenceHeader, Vec<Frame>)> {
    let Some(settings) = &recipe.blender else {
        let expected = "Blender's settings (Recipe::for_blender)";
        return Err(SimError::value("recipe.blender", expected, "none"));
    };
    settings.validate()?;
    if !recipe.engine.without.is_empty() {
        let names: Vec<&str> = recipe.engine.without.iter().map(|e| e.name()).collect();
        let expected = "none: Blender's effects cannot be forced off";
        return Err(SimError::value(
            "recipe.engine.without",
            expected,
            names.join(", "),
        ));
    }
    run(recipe, progress, |stage, header| {
        let asked: Vec<_> = header.garments.iter().map(|g| g.material).collect();
        let shared = SharedMaterials::of(&asked)?;
        describe(header, &shared, blender);
        let bodies: Vec<_> = once(stage.outfit.body.clone())
            .chain(stage.bodies())
            .collect();
        let job = Job {
            settings,
            garments: &stage.outfit.garments,
            waistbands: &stage.outfit.waistbands,
            body_faces: &header.body.faces,
            bodies: &bodies,
            wind: &wind(stage, bodies.len() - 1),
            body_friction: recipe.body_friction,
            fps: recipe.fps,
            scale: SCALE,
            // The start is a frame of its own.
            warm_up_frames: recipe.lead_in.still + 1,
        };
        Run::start(blender, &job, &shared)
    })
}

impl Mover for Run {
    /// Blender warms up by itself.
    fn warm_up(&mut self, _: f64) {}

    /// Blender knows the way already.
    fn advance(&mut self, _: &[[f32; 3]], _: Wind, _: f64) -> Result<()> {
        Self::advance(self)
    }

    fn garments(&self) -> Vec<Vec<[f32; 3]>> {
        Self::garments(self)
    }
}

/// Wind of the start and the frames after it.
fn wind(stage: &Stage, frames: usize) -> Vec<Wind> {
    once(Wind::default())
        .chain((0..frames).map(|number| stage.wind(number)))
        .collect()
}

fn describe(header: &mut SequenceHeader, shared: &SharedMaterials, blender: &Blender) {
    let scene = &mut header.scene;
    scene.engine = "blender".into();
    scene.engine_version = blender.version().into();
    scene.effects.retain(|&effect| effect != Effect::Shear);
    scene.warnings.push(format!(
        "gravity {:.2} units/s²: Blender's cloth works in frame time, garments float compared \
         with reality",
        -scene.gravity[2]
    ));
    scene.warnings.push(
        "one mesh for all garments: mass and friction are the garments' means, compression is as \
         near to what was asked for as tension lets it be, triangles have no shear springs"
            .into(),
    );
    for (garment, material) in header.garments.iter_mut().zip(&shared.materials) {
        garment.material = *material;
    }
}

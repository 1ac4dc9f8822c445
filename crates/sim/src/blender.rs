//! Blender's cloth solver as a second engine: the paper's way of making data.
//!
//! All garments become one mesh with self-collision, hang for the still frames
//! of the lead-in with large collision distances, then follow the body with
//! the usual ones. Bodies, garments, motion and wind are those of the recipe,
//! so the same recipe can be simulated by both engines.
//!
//! Blender runs in a Python of its own with the package `bpy`; `cargo xtask
//! setup blender` makes one. For one sequence a [`Run`] writes what the script
//! `blender/simulate.py` needs to a temporary folder, starts it, and reads
//! frame after frame back.
//!
//! Blender works in frames: its gravity of 9.81 pulls with 0.00981 units per
//! frame², 8.8 units/s² at 30 frames a second, and stiffness, damping and wind
//! mean something else than in our engine. Only one vertex mass and one
//! friction fit one mesh, and its shear springs are there on quadrangles only:
//! [`SharedMaterials`] says what remains of the garments' materials.

mod job;
mod materials;
mod python;
mod run;
mod settings;
#[cfg(test)]
mod tests;

pub(crate) use job::Job;
pub use materials::SharedMaterials;
pub use python::Blender;
pub use run::Run;
pub use settings::BlenderSettings;

/// Acceleration in units per frame² of a Blender gravity of 1.
const GRAVITY: f32 = 0.001;

//! The cloth engine: garments on a moving body, in small steps.
//!
//! Extended position-based dynamics (Macklin, Müller, Chentanez, "XPBD", 2016)
//! with one solver pass per small step ("Small steps in physics simulation",
//! 2019). Inside, lengths are metres, masses kilograms, times seconds, and the
//! state is f64; scene units and f32 end at [`Engine`]'s border.
//!
//! One step, in this order:
//! 1. the body moves; bound waist bands move with it ([`waistband`]);
//! 2. gravity and air change velocities ([`air`]), vertices are predicted;
//! 3. stretch, shear and bending are solved ([`elastic`]);
//! 4. contacts push apart and rub ([`body_contact`], [`cloth_contact`]);
//! 5. velocities come from displacements, without what recovery from
//!    penetration added, and internal vibration is damped.
//!
//! Contact candidates are listed every few steps ([`EngineSettings::detect_every`])
//! at positions predicted for the middle of the interval, cloth and body alike,
//! so that walking along costs no margin.
//!
//! What an effect does happens in one *pass*; a scene that does not call for
//! the effect runs zero passes of it ([`Engine::passes`]).
//!
//! Limits: frames are clean as far as contacts with a thickness go; nothing
//! certifies that no intersection is left.

mod air;
mod body;
mod body_contact;
mod closest;
mod cloth_contact;
mod contact;
mod elastic;
mod engine;
mod physics;
mod settings;
mod state;
mod waistband;

#[cfg(test)]
mod tests;

pub use engine::{Engine, StepReport};
pub use physics::ScenePhysics;
pub use settings::EngineSettings;

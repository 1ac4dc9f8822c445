//! What the paper's material numbers mean in SI units inside the engine.
//!
//! The paper takes Blender's numbers, whose units depend on frame time and
//! mesh resolution. Here each stands for a property of the cloth, so that a
//! finer mesh of the same garment behaves the same:
//!
//! | number | range | meaning | SI range |
//! |---|---|---|---|
//! | mass | 0.2–0.8 | areal density, 0.5 kg/m² per unit | 0.1–0.4 kg/m² (shirt to denim) |
//! | tension | 15–100 | membrane stiffness when stretched, 50 N/m per unit | 750–5000 N/m |
//! | compression | 15–100 | the same when compressed, 15 N/m per unit: cloth buckles below the mesh's size | 225–1500 N/m |
//! | shear | 15–100 | shear stiffness on top of what stretching gives, 0.5 N/m per unit | 7.5–50 N/m |
//! | bending | 15–100 | flexural rigidity, 1e-6 N·m per unit | 1.5e-5–1e-4 N·m |
//! | friction | 40–80 | Coulomb coefficient, 0.01 per unit | 0.4–0.8 |

use drape_dataset::sequence::Material;

use crate::error::SimError;

/// A material in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cloth {
    /// Areal density in kg/m².
    pub density: f64,
    /// Membrane stiffness when stretched, N/m.
    pub tension: f64,
    /// Membrane stiffness when compressed, N/m.
    pub compression: f64,
    /// Shear stiffness, N/m.
    pub shear: f64,
    /// Flexural rigidity, N·m.
    pub bending: f64,
    /// Coulomb coefficient between garments.
    pub friction: f64,
}

impl Cloth {
    /// Converts the paper's numbers.
    ///
    /// # Errors
    /// [`SimError::Value`] if a number is not finite, negative, or the mass is 0.
    pub fn new(garment: &str, material: &Material) -> Result<Self, SimError> {
        let check = |name: &str, x: f32| {
            if x.is_finite() && x >= 0.0 {
                Ok(f64::from(x))
            } else {
                Err(SimError::value(
                    format!("{garment}: {name}"),
                    "finite and not negative",
                    x,
                ))
            }
        };
        let mass = check("mass", material.mass)?;
        if mass == 0.0 {
            return Err(SimError::value(format!("{garment}: mass"), "above 0", mass));
        }
        Ok(Self {
            density: 0.5 * mass,
            tension: 50.0 * check("tension", material.tension)?,
            compression: 15.0 * check("compression", material.compression)?,
            shear: 0.5 * check("shear", material.shear)?,
            bending: 1e-6 * check("bending", material.bending)?,
            friction: friction(check("friction", material.friction)? as f32),
        })
    }
}

/// Coulomb coefficient of a friction in the paper's units.
pub fn friction(paper: f32) -> f64 {
    0.01 * f64::from(paper)
}

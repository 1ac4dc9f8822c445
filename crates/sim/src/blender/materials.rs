//! Materials of several garments in one cloth object.
//!
//! Blender interpolates a stiffness between a lowest and a highest value by a
//! weight of each vertex, and takes one weight for tension and compression.
//! So tension is what every garment asks for, and compression is the line over
//! tension, never falling, that is nearest to what they ask for: exact where
//! their orders agree, their mean where they do not. Mass and friction are
//! means. Shear is 0: there are no shear springs on triangles (measured with
//! Blender 5.0.1: 0 and 60 give the same bits).

use drape_dataset::sequence::Material;

use crate::error::{Result, SimError};

/// Lowest and highest stiffness, and where between them each garment is.
#[derive(Clone, Debug, PartialEq)]
pub struct Span {
    /// Value at weight 0.
    pub low: f32,
    /// Value at weight 1.
    pub high: f32,
}

impl Span {
    fn of(values: &[f32]) -> Self {
        Self {
            low: values.iter().copied().fold(f32::INFINITY, f32::min),
            high: values.iter().copied().fold(0.0, f32::max),
        }
    }

    fn weight(&self, value: f32) -> f32 {
        if self.high > self.low {
            ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }
}

/// What one cloth object makes of the garments' materials.
#[derive(Clone, Debug, PartialEq)]
pub struct SharedMaterials {
    /// Tension, at the weights `stretch`.
    pub tension: Span,
    /// Compression, at the same weights.
    pub compression: Span,
    /// Bending.
    pub bending: Span,
    /// Weight of tension and compression, `[garment]`.
    pub stretch_weights: Vec<f32>,
    /// Weight of bending, `[garment]`.
    pub bending_weights: Vec<f32>,
    /// What each garment gets, `[garment]`.
    pub materials: Vec<Material>,
}

impl SharedMaterials {
    /// Shares out the materials of an outfit.
    ///
    /// # Errors
    /// [`SimError::Value`] if there is no garment.
    pub fn of(asked: &[Material]) -> Result<Self> {
        if asked.is_empty() {
            return Err(SimError::value("outfit", "at least one garment", "none"));
        }
        let all = |of: fn(&Material) -> f32| asked.iter().map(of).collect::<Vec<f32>>();
        let mean = |of| mean(&all(of)) as f32;
        let (mass, friction) = (mean(|m| m.mass), mean(|m| m.friction));
        let tension = Span::of(&all(|m| m.tension));
        let bending = Span::of(&all(|m| m.bending));
        let weights = |span: &Span, values: Vec<f32>| -> Vec<f32> {
            values.into_iter().map(|value| span.weight(value)).collect()
        };
        let stretch_weights = weights(&tension, all(|m| m.tension));
        let bending_weights = weights(&bending, all(|m| m.bending));
        let compression = nearest_line(&stretch_weights, &all(|m| m.compression));
        let materials = asked
            .iter()
            .zip(&stretch_weights)
            .map(|(material, &weight)| Material {
                mass,
                friction,
                shear: 0.0,
                compression: compression.low + weight * (compression.high - compression.low),
                ..*material
            })
            .collect();
        Ok(Self {
            tension,
            compression,
            bending,
            stretch_weights,
            bending_weights,
            materials,
        })
    }

    /// The vertex mass of the whole object.
    pub fn mass(&self) -> f32 {
        self.materials[0].mass
    }

    /// The friction of the whole object.
    pub fn friction(&self) -> f32 {
        self.materials[0].friction
    }
}

/// Values at weights 0 and 1 of the line over the weights that is nearest to
/// the values (least squares), does not fall and stays at or above 0.
fn nearest_line(weights: &[f32], values: &[f32]) -> Span {
    let (w0, y0) = (mean(weights), mean(values));
    let mut along = 0.0;
    let mut spread = 0.0;
    for (&w, &y) in weights.iter().zip(values) {
        along += (f64::from(w) - w0) * (f64::from(y) - y0);
        spread += (f64::from(w) - w0).powi(2);
    }
    let steepest = if w0 > 0.0 { y0 / w0 } else { f64::INFINITY };
    let slope = if spread > 0.0 {
        (along / spread).clamp(0.0, steepest)
    } else {
        0.0
    };
    let low = (y0 - slope * w0).max(0.0);
    Span {
        low: low as f32,
        high: (low + slope) as f32,
    }
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|&x| f64::from(x)).sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn material(tension: f32, compression: f32, bending: f32) -> Material {
        Material {
            mass: tension / 100.0,
            tension,
            compression,
            shear: 50.0,
            bending,
            friction: 40.0,
        }
    }

    fn close(found: f32, expected: f32) {
        assert!(
            (found - expected).abs() < 1e-4,
            "{found} instead of {expected}"
        );
    }

    #[test]
    fn two_garments_whose_orders_agree_get_what_they_ask_for_but_mass_and_shear() {
        let asked = [material(80.0, 70.0, 20.0), material(30.0, 20.0, 90.0)];
        let shared = SharedMaterials::of(&asked).unwrap();
        for (got, asked) in shared.materials.iter().zip(&asked) {
            close(got.tension, asked.tension);
            close(got.compression, asked.compression);
            close(got.bending, asked.bending);
            close(got.mass, 0.55);
            close(got.friction, 40.0);
            assert_eq!(got.shear, 0.0);
        }
    }

    #[test]
    fn opposed_orders_meet_in_the_mean_compression() {
        let asked = [material(80.0, 20.0, 1.0), material(30.0, 70.0, 1.0)];
        let shared = SharedMaterials::of(&asked).unwrap();
        for (got, asked) in shared.materials.iter().zip(&asked) {
            close(got.tension, asked.tension);
            close(got.compression, 45.0);
        }
    }

    #[test]
    fn what_a_garment_is_said_to_have_is_what_its_weight_gives() {
        let asked = [
            material(15.0, 60.0, 33.0),
            material(100.0, 99.0, 15.0),
            material(40.0, 16.0, 80.0),
        ];
        let shared = SharedMaterials::of(&asked).unwrap();
        let at = |span: &Span, weight: f32| span.low + weight * (span.high - span.low);
        for (k, got) in shared.materials.iter().enumerate() {
            close(at(&shared.tension, shared.stretch_weights[k]), got.tension);
            close(
                at(&shared.compression, shared.stretch_weights[k]),
                got.compression,
            );
            close(at(&shared.bending, shared.bending_weights[k]), got.bending);
            close(got.tension, asked[k].tension);
            close(got.bending, asked[k].bending);
        }
        assert!(shared.compression.low >= 0.0 && shared.compression.high > shared.compression.low);
    }

    #[test]
    fn one_garment_and_equal_garments_keep_their_numbers() {
        let one = material(50.0, 25.0, 75.0);
        for count in [1, 3] {
            for got in SharedMaterials::of(&vec![one; count]).unwrap().materials {
                let expected = Material { shear: 0.0, ..one };
                assert_eq!(got, expected);
            }
        }
        assert!(SharedMaterials::of(&[]).is_err());
    }
}

//! What Blender is told besides the scene.

use serde::{Deserialize, Serialize};

use super::GRAVITY;
use crate::error::{Result, SimError};

/// Blender's settings, `[blender]` in a configuration. Lengths are scene units,
/// other numbers are in Blender's own units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BlenderSettings {
    /// Gravity along −Z. Default 9.81, Blender's own: garments float compared with reality.
    pub gravity: f32,
    /// Steps per frame. More: stiffer, fewer intersections, proportionally slower. Default 20.
    pub quality: u32,
    /// Passes over the contacts per step. More: fewer intersections. Default 6.
    pub collision_quality: u32,
    /// Distance that cloth keeps from the body's own distance. Default 0.04 (4 mm real).
    pub distance: f32,
    /// Distance of the body's outside, on top of `distance`. Default 0.04.
    pub body_thickness: f32,
    /// Distance between layers and within a garment, at most 0.1. Default 0.03.
    pub self_distance: f32,
    /// The three distances are so many times as large while the body stands still at first, up to
    /// Blender's limits. Default 2.
    pub warm_up_times: f32,
    /// Drag of still air. Default 1.
    pub air_damping: f32,
    /// Damping of stretching. Default 5.
    pub tension_damping: f32,
    /// Damping of compressing. Default 5.
    pub compression_damping: f32,
    /// Damping of shearing. Default 5.
    pub shear_damping: f32,
    /// Damping of bending. Default 0.5.
    pub bending_damping: f32,
}

impl Default for BlenderSettings {
    fn default() -> Self {
        Self {
            gravity: 9.81,
            quality: 20,
            collision_quality: 6,
            distance: 0.04,
            body_thickness: 0.04,
            self_distance: 0.03,
            warm_up_times: 2.0,
            air_damping: 1.0,
            tension_damping: 5.0,
            compression_damping: 5.0,
            shear_damping: 5.0,
            bending_damping: 0.5,
        }
    }
}

impl BlenderSettings {
    /// Checks the ranges, which are Blender's own: it would clamp in silence.
    ///
    /// # Errors
    /// [`SimError::Value`] names the first setting out of range.
    pub fn validate(&self) -> Result<()> {
        for (name, found, highest) in [
            ("quality", self.quality, 80),
            ("collision_quality", self.collision_quality, 100),
        ] {
            if !(1..=highest).contains(&found) {
                let expected = format!("1 to {highest}");
                return Err(SimError::value(format!("blender.{name}"), expected, found));
            }
        }
        for (name, found, [low, high]) in [
            ("gravity", self.gravity, [0.0, 200.0]),
            ("distance", self.distance, [0.001, 1.0]),
            ("body_thickness", self.body_thickness, [0.001, 1.0]),
            ("self_distance", self.self_distance, [0.001, 0.1]),
            ("warm_up_times", self.warm_up_times, [1.0, 10.0]),
            ("air_damping", self.air_damping, [0.0, 10.0]),
            ("tension_damping", self.tension_damping, [0.0, 50.0]),
            ("compression_damping", self.compression_damping, [0.0, 50.0]),
            ("shear_damping", self.shear_damping, [0.0, 50.0]),
            ("bending_damping", self.bending_damping, [0.0, 1000.0]),
        ] {
            if !(low..=high).contains(&found) {
                let expected = format!("{low} to {high}");
                return Err(SimError::value(format!("blender.{name}"), expected, found));
            }
        }
        Ok(())
    }

    /// Acceleration of gravity in units/s² that cloth feels.
    pub fn acceleration(&self, fps: f32) -> [f32; 3] {
        [0.0, 0.0, -GRAVITY * self.gravity * fps * fps]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blenders_own_gravity_is_the_floating_one_of_its_frame_time() {
        let [x, y, z] = BlenderSettings::default().acceleration(30.0);
        assert_eq!([x, y], [0.0; 2]);
        assert!((z + 8.829).abs() < 1e-4, "{z}");
    }

    #[test]
    fn settings_that_blender_would_clamp_are_refused_by_name() {
        BlenderSettings::default().validate().unwrap();
        let check = |edit: fn(&mut BlenderSettings), name: &str| {
            let mut settings = BlenderSettings::default();
            edit(&mut settings);
            let message = settings.validate().unwrap_err().to_string();
            assert!(
                message.starts_with(&format!("blender.{name}:")),
                "{message}"
            );
        };
        check(|s| s.self_distance = 0.11, "self_distance");
        check(|s| s.distance = f32::NAN, "distance");
        check(|s| s.quality = 0, "quality");
        check(|s| s.warm_up_times = 0.5, "warm_up_times");
        let mut widest = BlenderSettings::default();
        (widest.self_distance, widest.distance) = (0.1, 1.0);
        widest.validate().unwrap();
    }
}

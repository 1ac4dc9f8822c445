//! What the script is given: one folder of files, listed in its header.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use drape_dataset::registry::Effect;
use drape_dataset::sequence::{Garment, Wind};
use serde_json::json;

use super::materials::{SharedMaterials, Span};
use super::settings::BlenderSettings;
use crate::engine::{Engine, EngineSettings, ScenePhysics};
use crate::error::{Result, SimError};

/// A scene as Blender sees it. Frame 0 is the start: body and garments at rest.
pub(crate) struct Job<'a> {
    pub settings: &'a BlenderSettings,
    pub garments: &'a [Garment],
    /// Vertices of each garment that follow the body.
    pub waistbands: &'a [Vec<u32>],
    pub body_faces: &'a [[u32; 3]],
    /// Body of every frame, `[frame][vertex, 3]`.
    pub bodies: &'a [Vec<[f32; 3]>],
    /// Wind of every frame.
    pub wind: &'a [Wind],
    pub body_friction: f32,
    /// Frames per second: contacts depend on it, gravity does not (measured with Blender 5.0.1).
    pub fps: f32,
    /// Scene units per metre.
    pub scale: f32,
    /// Frames with large collision distances.
    pub warm_up_frames: usize,
}

impl Job<'_> {
    /// Writes the files into a folder that is there.
    pub fn write(&self, folder: &Path, shared: &SharedMaterials) -> Result<()> {
        let put = |name: &str, bytes: Vec<u8>| {
            fs::write(folder.join(name), bytes)
                .map_err(|error| SimError::blender(format!("cannot write its {name}: {error}")))
        };
        let first_of = self.first_vertices();
        let count = |g: &Garment| g.rest.len();
        let rest: Vec<[f32; 3]> = self.garments.iter().flat_map(|g| g.rest.clone()).collect();
        let faces: Vec<[u32; 3]> = self
            .garments
            .iter()
            .zip(&first_of)
            .flat_map(|(g, &first)| g.faces.iter().map(move |f| f.map(|v| v + first)))
            .collect();
        let pinned: Vec<u32> = self
            .waistbands
            .iter()
            .zip(&first_of)
            .flat_map(|(band, &first)| band.iter().map(move |v| v + first))
            .collect();
        let of_vertices = |weights: &[f32]| -> Vec<f32> {
            weights
                .iter()
                .zip(self.garments)
                .flat_map(|(&weight, g)| std::iter::repeat_n(weight, count(g)))
                .collect()
        };
        let stretch = of_vertices(&shared.stretch_weights);
        // No shear springs on triangles: any weight will do.
        let weights = [&stretch, &stretch, &of_vertices(&shared.bending_weights)];

        put("cloth_rest.f32", bytes(rest.iter().flatten()))?;
        put("cloth_faces.u32", index_bytes(faces.iter().flatten()))?;
        put("cloth_weights.f32", bytes(weights.into_iter().flatten()))?;
        put("pinned.u32", index_bytes(&pinned))?;
        put(
            "body_faces.u32",
            index_bytes(self.body_faces.iter().flatten()),
        )?;
        put("body.pc2", point_cache(self.bodies))?;
        if !pinned.is_empty() {
            put("cloth.pc2", point_cache(&self.pinned_motion()?))?;
        }
        let span = |span: &Span| [span.low, span.high];
        let wind: Vec<[f32; 5]> = self.wind.iter().map(wind_row).collect();
        let job = json!({
            "frames": self.bodies.len() - 1,
            "fps": self.fps,
            "body_vertices": self.bodies[0].len(),
            "gravity": [0.0, 0.0, -self.settings.gravity],
            "mass": shared.mass(),
            "friction": shared.friction(),
            "body_friction": self.body_friction,
            "tension": span(&shared.tension),
            "compression": span(&shared.compression),
            "shear": [0.0, 0.0],
            "bending": span(&shared.bending),
            "wind": wind,
            "warm_up_frames": self.warm_up_frames,
            "settings": self.settings,
        });
        put("job.json", job.to_string().into_bytes())
    }

    /// Number of the first vertex of each garment in the merged mesh.
    fn first_vertices(&self) -> Vec<u32> {
        self.garments
            .iter()
            .scan(0, |next, g| {
                let first = *next;
                *next += g.rest.len() as u32;
                Some(first)
            })
            .collect()
    }

    /// All cloth vertices at rest but for the pinned ones, which follow the
    /// body: our engine with waist bands and nothing else.
    fn pinned_motion(&self) -> Result<Vec<Vec<[f32; 3]>>> {
        let physics = ScenePhysics {
            scale: self.scale,
            gravity: [0.0; 3],
            air_density: 0.0,
            body_friction: 0.0,
            effects: BTreeSet::from([Effect::Waistband]),
        };
        let settings = EngineSettings {
            substeps: 1,
            ..EngineSettings::default()
        };
        let mut engine = Engine::new(
            self.garments,
            self.waistbands,
            self.body_faces,
            &self.bodies[0],
            &physics,
            &settings,
        )?;
        let now = |engine: &Engine| engine.garments().concat();
        let mut frames = vec![now(&engine)];
        for body in &self.bodies[1..] {
            engine.advance(body, Wind::default(), 1.0)?;
            frames.push(now(&engine));
        }
        Ok(frames)
    }
}

/// Quaternion (w, x, y, z) and strength.
fn wind_row(wind: &Wind) -> [f32; 5] {
    let [w, x, y, z] = wind.rotation;
    [w, x, y, z, wind.strength]
}

fn bytes<'a>(numbers: impl IntoIterator<Item = &'a f32>) -> Vec<u8> {
    numbers.into_iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn index_bytes<'a>(numbers: impl IntoIterator<Item = &'a u32>) -> Vec<u8> {
    numbers.into_iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// Positions as a PC2 file: 12 bytes of signature, version, vertices, first
/// frame, frames per sample, samples; then the positions of each frame.
fn point_cache(frames: &[Vec<[f32; 3]>]) -> Vec<u8> {
    let mut out = b"POINTCACHE2\0".to_vec();
    out.extend(1_i32.to_le_bytes());
    out.extend((frames[0].len() as i32).to_le_bytes());
    out.extend(0.0_f32.to_le_bytes());
    out.extend(1.0_f32.to_le_bytes());
    out.extend((frames.len() as i32).to_le_bytes());
    for positions in frames {
        out.extend(bytes(positions.iter().flatten()));
    }
    out
}

//! Layered sequences exported from Blender's cloth solver as one `.npz` file.
//!
//! | array | shape | meaning |
//! |---|---|---|
//! | `names` | text `[garment]` | garment names, inner first; the kind follows from the name |
//! | `fps`, `scale` | number | frames per second, units per metre |
//! | `body_vertices`, `body_faces` | `[frame, vertex, 3]`, `[face, 3]` | posed body |
//! | `pose_rotmats`, `joint_names` | `[frame, joint, 3, 3]`, text `[joint]` | pose; the joint `Hips` is the root |
//! | `garment{i}_rest`, `_faces`, `_uv`, `_uv_faces`, `_vertices` | | mesh and its motion `[frame, vertex, 3]` |
//! | `garment{i}_material` | JSON | mass, tension, compression, shear, bending, friction, body_friction |
//! | `garment{i}_pin` | `[n]` | pinned vertices, optional |
//! | `wind` | JSON | `frames`: per frame `quat_wxyz` and `strength`, or empty |
//! | `intersections_detail` | `[frame, 4]` | inner–inner, outer–outer, inner–outer, cloth–body; optional |
//! | `settings` | JSON | `gravity`, `blender`, `cfg.air_damping`, `cloth.collision.use_self_collision` |
//!
//! `root_translation` is not used: it is the displacement of a joint whose
//! place in the rest pose the file does not tell. The root is placed in the
//! centre of the pelvis instead.

mod arrays;
mod root;
mod scene;
mod uv;

pub use uv::METRES_PER_UV;

use std::path::Path;

use serde_json::Value;

pub(super) use self::arrays::Arrays;
use self::root::roots;
use self::scene::{Active, effects, gravity, recipe};
use self::uv::fit_uv;
use super::Imported;
use crate::error::Result;
use crate::panels::{numbered_names, uv_islands};
use crate::registry::GarmentKind;
use crate::sequence::{
    BodyTopology, Frame, Garment, Intersections, Material, SceneMeta, SequenceHeader, Wind,
};

/// Reads a Blender cloth export; the sequence is named after the file.
///
/// # Errors
/// A missing array, a wrong shape or type, a name that is no garment kind,
/// and whatever [`SequenceHeader::check`] and [`Frame::check`] refuse.
pub fn import_npz(path: impl AsRef<Path>) -> Result<Imported> {
    let path = path.as_ref();
    let mut arrays = Arrays::open(path)?;
    let mut warnings = Vec::new();
    let fps = arrays.number("fps")?;
    let scale = arrays.number("scale")?;
    let settings = arrays.json("settings")?;
    let bodies = arrays.frames("body_vertices")?;
    let body_faces = arrays.index_rows("body_faces")?;
    let wind = wind(&mut arrays, bodies.len())?;
    let roots = roots(&mut arrays, &bodies, &mut warnings)?;
    let intersections = intersections(&mut arrays, bodies.len(), &mut warnings)?;

    let names = arrays.strings("names")?;
    let mut garments = Vec::new();
    let mut motions = Vec::new();
    let mut pinned = 0;
    let mut body_friction = 0.0;
    for (i, name) in names.iter().enumerate() {
        let (garment, friction) = garment(&mut arrays, i, name)?;
        let key = format!("garment{i}_vertices");
        let motion = arrays.frames(&key)?;
        if motion.len() != bodies.len() {
            let expected = format!("{} frames, as many as body_vertices", bodies.len());
            return Err(arrays.invalid(&key, &expected, format!("{} frames", motion.len())));
        }
        let pin = format!("garment{i}_pin");
        if arrays.has(&pin) {
            pinned += arrays.len(&pin)?;
        }
        body_friction = friction;
        garments.push(garment);
        motions.push(motion);
    }
    let metres_per_uv =
        fit_uv(&mut garments, scale, &mut warnings).map_err(|error| error.in_file(path))?;

    // The body fits the garments' rest positions in frame 0 if they start there.
    let starts_at_rest = motions
        .iter()
        .zip(&garments)
        .all(|(motion, garment)| motion.first() == Some(&garment.rest));
    let rest = if starts_at_rest {
        warnings.push("body rest pose: frame 0, where the garments are at rest".into());
        bodies[0].clone()
    } else {
        warnings.push("no body rest pose: the garments are not at rest in frame 0".into());
        Vec::new()
    };

    let gravity = gravity(&arrays, &settings, fps)?;
    warnings.push(format!(
        "gravity {:.2} units/s²: Blender's cloth works in frame time, garments float compared \
         with reality",
        -gravity[2]
    ));
    let active = Active {
        gravity: gravity != [0.0; 3],
        wind: wind.iter().any(|wind| wind.strength > 0.0),
        air_drag: settings["cfg"]["air_damping"]
            .as_f64()
            .is_some_and(|damping| damping > 0.0),
        self_collision: settings["cloth"]["collision"]["use_self_collision"] == true,
        waistband: pinned > 0,
        body: !body_faces.is_empty(),
    };
    let header = SequenceHeader {
        name: path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned(),
        scene: SceneMeta {
            scale: scale as f32,
            fps: fps as f32,
            seed: 0,
            engine: "blender".into(),
            engine_version: settings["blender"].as_str().unwrap_or("unknown").to_owned(),
            effects: effects(&garments, body_friction, &active),
            gravity,
            body_friction,
            metres_per_uv,
            recipe: recipe(&mut arrays, settings)?,
            warnings,
        },
        body: BodyTopology {
            vertex_count: bodies[0].len(),
            rest,
            faces: body_faces,
        },
        garments,
    };
    let mut motions: Vec<_> = motions.into_iter().map(Vec::into_iter).collect();
    let frames: Vec<Frame> = bodies
        .into_iter()
        .enumerate()
        .map(|(i, body)| Frame {
            body,
            root: roots[i],
            garments: motions.iter_mut().filter_map(Iterator::next).collect(),
            wind: wind[i],
            intersections: intersections.as_ref().map(|counts| counts[i]),
        })
        .collect();
    header.check().map_err(|error| error.in_file(path))?;
    for (i, frame) in frames.iter().enumerate() {
        frame
            .check(&header)
            .map_err(|error| error.at(&format!("frame {i}")).in_file(path))?;
    }
    Ok(Imported { header, frames })
}

/// The fixed part of garment `i` and the body's friction in its material.
fn garment(arrays: &mut Arrays, i: usize, name: &str) -> Result<(Garment, f32)> {
    let Some(kind) = kind_of(name) else {
        let known = "names such as tshirt, jacket, jacket_hood, pants, skirt, dress, jumpsuit";
        return Err(arrays.invalid("names", known, format!("{name:?}")));
    };
    let uv = arrays.rows::<2>(&format!("garment{i}_uv"))?;
    let uv_key = format!("garment{i}_uv_faces");
    let uv_faces = arrays.index_rows(&uv_key)?;
    if let Some(index) = uv_faces
        .as_flattened()
        .iter()
        .find(|&&index| index as usize >= uv.len())
    {
        let expected = format!("indices below {}", uv.len());
        return Err(arrays.invalid(&uv_key, &expected, index.to_string()));
    }
    let (panel_of_face, panels) = uv_islands(&uv_faces, uv.len());
    let key = format!("garment{i}_material");
    let json = arrays.json(&key)?;
    let number = |name: &str| {
        json[name].as_f64().map(|x| x as f32).ok_or_else(|| {
            arrays.invalid(&key, &format!("a number {name:?}"), json[name].to_string())
        })
    };
    let material = Material {
        mass: number("mass")?,
        tension: number("tension")?,
        compression: number("compression")?,
        shear: number("shear")?,
        bending: number("bending")?,
        friction: number("friction")?,
    };
    let body_friction = number("body_friction")?;
    let garment = Garment {
        name: name.to_owned(),
        kind,
        layer: i as u32,
        rest: arrays.rows(&format!("garment{i}_rest"))?,
        faces: arrays.index_rows(&format!("garment{i}_faces"))?,
        uv,
        uv_faces,
        panel_of_face,
        panels: numbered_names(panels),
        material,
    };
    Ok((garment, body_friction))
}

/// `tshirt`, `T-shirt`, `t_shirt` → T-shirt, and so on.
fn kind_of(name: &str) -> Option<GarmentKind> {
    let letters = |text: &str| -> String {
        text.chars()
            .filter(|c| c.is_alphanumeric())
            .flat_map(char::to_lowercase)
            .collect()
    };
    GarmentKind::ALL
        .iter()
        .copied()
        .find(|kind| letters(kind.name()) == letters(name))
}

/// Wind of every frame; none where the source lists none.
fn wind(arrays: &mut Arrays, frame_count: usize) -> Result<Vec<Wind>> {
    let json = arrays.json("wind")?;
    let frames = json["frames"]
        .as_array()
        .map(Vec::as_slice)
        .unwrap_or_default();
    if frames.is_empty() {
        return Ok(vec![Wind::default(); frame_count]);
    }
    if frames.len() != frame_count {
        let expected = format!("no frames or {frame_count} of them");
        return Err(arrays.invalid("wind", &expected, format!("{} frames", frames.len())));
    }
    let wind_of = |frame: &Value| {
        let mut rotation = [0.0; 4];
        for (k, value) in rotation.iter_mut().enumerate() {
            *value = frame["quat_wxyz"][k].as_f64()? as f32;
        }
        Some(Wind {
            rotation,
            strength: frame["strength"].as_f64()? as f32,
        })
    };
    frames
        .iter()
        .map(|frame| {
            wind_of(frame).ok_or_else(|| {
                arrays.invalid(
                    "wind",
                    "quat_wxyz (4 numbers) and strength",
                    frame.to_string(),
                )
            })
        })
        .collect()
}

/// Counts of every frame, if the source counted.
fn intersections(
    arrays: &mut Arrays,
    frame_count: usize,
    warnings: &mut Vec<String>,
) -> Result<Option<Vec<Intersections>>> {
    const KEY: &str = "intersections_detail";
    if !arrays.has(KEY) {
        warnings.push("the source counted no intersections".into());
        return Ok(None);
    }
    let rows = arrays.index_rows::<4>(KEY)?;
    if rows.len() != frame_count {
        let expected = format!("{frame_count} rows, as many as frames");
        return Err(arrays.invalid(KEY, &expected, rows.len().to_string()));
    }
    let counts = |&[inner, outer, between, body]: &[u32; 4]| Intersections {
        between_garments: between,
        within_garments: inner.saturating_add(outer),
        with_body: body,
    };
    Ok(Some(rows.iter().map(counts).collect()))
}

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

use std::path::Path;

use drape_geometry::rigid::quaternion_from_matrix;
use serde_json::{Value, json};

use super::Imported;
use super::npz_arrays::Arrays;
use crate::error::{DatasetError, Result};
use crate::panels::{numbered_names, uv_islands};
use crate::registry::{Effect, GarmentKind};
use crate::sequence::{
    BodyTopology, Frame, Garment, Intersections, Material, Root, SceneMeta, SequenceHeader, Wind,
};

/// Metres that one UV unit stands for after the import (the source's UVs are
/// scaled into `[0, 1]` by one factor for the whole outfit). The same for
/// every file, so that patches are equally large in UV, too; a larger outfit
/// raises it to its own size.
pub const METRES_PER_UV: f32 = 3.0;

/// Blender's cloth lives in frames: gravity g acts as 0.001·g units/frame².
const BLENDER_GRAVITY: f64 = 0.001;

/// Garments whose UV density differs by more than this get a warning.
const DENSITY_TOLERANCE: f64 = 0.05;

/// The pelvis: this part of the body's height in frame 0. Arms stretched
/// sideways are higher, hanging hands lower.
const PELVIS: std::ops::RangeInclusive<f32> = 0.50..=0.58;

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

/// Scales all UVs into `[0, 1]` by one factor; returns metres per UV unit,
/// from the ratio of the garments' areas in space and in UV.
fn fit_uv(garments: &mut [Garment], scale: f64, warnings: &mut Vec<String>) -> Result<f32> {
    let mut total = (0.0, 0.0);
    let mut largest_extent = 0.0f64;
    let mut densities = Vec::new();
    let mut corners = Vec::new();
    for garment in garments.iter() {
        garment_indices_fit(garment)?;
        let (space, uv) = (area(&garment.rest, &garment.faces), uv_area(garment));
        total = (total.0 + space, total.1 + uv);
        densities.push((space / uv).sqrt() / scale);
        let corner: [f32; 2] =
            std::array::from_fn(|k| garment.uv.iter().map(|uv| uv[k]).fold(f32::MAX, f32::min));
        for uv in &garment.uv {
            for k in 0..2 {
                largest_extent = largest_extent.max(f64::from(uv[k]) - f64::from(corner[k]));
            }
        }
        corners.push(corner);
    }
    let source = (total.0 / total.1).sqrt() / scale;
    let metres_per_uv = f64::from(METRES_PER_UV).max(largest_extent * source);
    let factor = source / metres_per_uv;
    for (garment, corner) in garments.iter_mut().zip(corners) {
        for uv in &mut garment.uv {
            // Rounding may push the largest one a hair past 1.
            *uv = std::array::from_fn(|k| {
                ((f64::from(uv[k]) - f64::from(corner[k])) * factor).min(1.0) as f32
            });
        }
    }
    warnings.push(format!(
        "metres_per_uv estimated from areas: {source:.4} m per unit of the source, UVs scaled \
         to {metres_per_uv:.4}"
    ));
    for (garment, density) in garments.iter().zip(densities) {
        if (density / source - 1.0).abs() > DENSITY_TOLERANCE {
            warnings.push(format!(
                "garment {:?} alone has {density:.4} m per UV unit of the source: its patches \
                 differ in size",
                garment.name
            ));
        }
    }
    Ok(metres_per_uv as f32)
}

/// Areas need valid indices before the header's check runs.
fn garment_indices_fit(garment: &Garment) -> Result<()> {
    let invalid = |place: &str, expected: &str, found: String| {
        Err(DatasetError::invalid(
            format!("garment {:?}, {place}", garment.name),
            expected,
            found,
        ))
    };
    let vertices = garment.rest.len();
    if let Some(i) = garment
        .faces
        .as_flattened()
        .iter()
        .find(|&&i| i as usize >= vertices)
    {
        return invalid("faces", &format!("indices below {vertices}"), i.to_string());
    }
    let (space, uv) = (area(&garment.rest, &garment.faces), uv_area(garment));
    if !(space > 0.0 && uv > 0.0) {
        return invalid("rest and UV", "areas above 0", format!("{space} and {uv}"));
    }
    Ok(())
}

fn area(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> f64 {
    faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|i| positions[i as usize].map(f64::from));
            let (u, v): ([f64; 3], [f64; 3]) = (
                std::array::from_fn(|k| b[k] - a[k]),
                std::array::from_fn(|k| c[k] - a[k]),
            );
            let cross = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            cross.iter().map(|x| x * x).sum::<f64>().sqrt() / 2.0
        })
        .sum()
}

fn uv_area(garment: &Garment) -> f64 {
    let flat: Vec<[f32; 3]> = garment.uv.iter().map(|&[u, v]| [u, v, 0.0]).collect();
    area(&flat, &garment.uv_faces)
}

fn gravity(arrays: &Arrays, settings: &Value, fps: f64) -> Result<[f32; 3]> {
    let read = |k: usize| settings["gravity"][k].as_f64();
    match (read(0), read(1), read(2)) {
        (Some(x), Some(y), Some(z)) => {
            Ok([x, y, z].map(|g| (g * BLENDER_GRAVITY * fps * fps) as f32))
        }
        _ => {
            let found = settings["gravity"].to_string();
            Err(arrays.invalid("settings", "\"gravity\": [x, y, z]", found))
        }
    }
}

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

/// Root of every frame: centre of the pelvis, rotation of the joint `Hips`.
fn roots(
    arrays: &mut Arrays,
    bodies: &[Vec<[f32; 3]>],
    warnings: &mut Vec<String>,
) -> Result<Vec<Root>> {
    let Some(first) = bodies.first() else {
        return Err(arrays.invalid("body_vertices", "at least one frame", "none"));
    };
    let joints = arrays.strings("joint_names")?;
    let Some(hips) = joints.iter().position(|joint| joint == "Hips") else {
        return Err(arrays.invalid("joint_names", "a joint \"Hips\"", joints.join(", ")));
    };
    let rotations = arrays.joint_matrices("pose_rotmats", hips)?;
    if rotations.len() != bodies.len() {
        let expected = format!("{} frames, as many as body_vertices", bodies.len());
        return Err(arrays.invalid("pose_rotmats", &expected, rotations.len().to_string()));
    }
    let low = first.iter().map(|p| p[2]).fold(f32::MAX, f32::min);
    let high = first.iter().map(|p| p[2]).fold(f32::MIN, f32::max);
    let in_pelvis = |p: &[f32; 3]| PELVIS.contains(&((p[2] - low) / (high - low)));
    let mut pelvis: Vec<usize> = (0..first.len()).filter(|&v| in_pelvis(&first[v])).collect();
    if pelvis.is_empty() {
        warnings.push("root position: centre of the whole body (no vertex in the pelvis)".into());
        pelvis = (0..first.len()).collect();
    } else {
        warnings.push("root position: centre of the pelvis, estimated".into());
    }
    rotations
        .iter()
        .zip(bodies)
        .enumerate()
        .map(|(frame, (rotation, body))| {
            let error = orthogonality_error(rotation);
            if error.is_nan() || error > 1e-3 {
                let found = format!("frame {frame}: {rotation:?}, off by {error:.1e}");
                return Err(arrays.invalid("pose_rotmats", "rotation matrices", found));
            }
            Ok(Root {
                translation: std::array::from_fn(|k| {
                    let sum: f64 = pelvis.iter().map(|&v| f64::from(body[v][k])).sum();
                    (sum / pelvis.len() as f64) as f32
                }),
                rotation: quaternion_from_matrix(rotation).map(|x| x as f32),
            })
        })
        .collect()
}

/// Largest entry of R·Rᵀ − 1, infinite for a reflection.
fn orthogonality_error(r: &[[f64; 3]; 3]) -> f64 {
    let dot = |a: usize, b: usize| (0..3).map(|k| r[a][k] * r[b][k]).sum::<f64>();
    let determinant: f64 = (0..3)
        .map(|k| {
            r[0][k]
                * (r[1][(k + 1) % 3] * r[2][(k + 2) % 3] - r[1][(k + 2) % 3] * r[2][(k + 1) % 3])
        })
        .sum();
    if determinant < 0.0 {
        return f64::INFINITY;
    }
    // Not `max`, which would swallow a NaN.
    (0..9)
        .map(|i| (dot(i / 3, i % 3) - f64::from(u8::from(i / 3 == i % 3))).abs())
        .fold(
            0.0,
            |worst, x| if x > worst || x.is_nan() { x } else { worst },
        )
}

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

/// What the scene called for besides the garments' own stiffness.
struct Active {
    gravity: bool,
    wind: bool,
    air_drag: bool,
    self_collision: bool,
    waistband: bool,
    body: bool,
}

fn effects(garments: &[Garment], body_friction: f32, active: &Active) -> Vec<Effect> {
    let any = |of: &dyn Fn(&Material) -> f32| garments.iter().any(|g| of(&g.material) > 0.0);
    let is_active = |effect: Effect| match effect {
        Effect::Gravity => active.gravity,
        Effect::Wind => active.wind,
        Effect::AirDrag => active.air_drag,
        Effect::Stretch => any(&|m| m.tension.max(m.compression)),
        Effect::Shear => any(&|m| m.shear),
        Effect::Bending => any(&|m| m.bending),
        Effect::BodyContact => active.body,
        // One merged cloth object: its self-collision is also what keeps layers apart.
        Effect::LayerContact => active.self_collision && garments.len() > 1,
        Effect::SelfContact => active.self_collision,
        Effect::Friction => body_friction > 0.0 || any(&|m| m.friction),
        Effect::Waistband => active.waistband,
    };
    Effect::ALL
        .iter()
        .copied()
        .filter(|&effect| is_active(effect))
        .collect()
}

/// What a Blender script needs to simulate the scene again.
fn recipe(arrays: &mut Arrays, settings: Value) -> Result<String> {
    let mut recipe = json!({ "settings": settings });
    if arrays.has("motion") {
        recipe["motion"] = arrays.json("motion")?;
    }
    if arrays.has("body_shape") {
        recipe["body_shape"] = arrays.strings("body_shape")?.into();
    }
    Ok(recipe.to_string())
}

//! What is fixed for a sequence: garments, body, scene.

use std::path::Path;

use super::FPS;
use super::meta::{GarmentMeta, Meta};
use super::panels;
use crate::error::{DatasetError, Result};
use crate::import::density::{DENSITY_TOLERANCE, area, uv_area};
use crate::import::pickle::{Frames, Pickle};
use crate::import::smpl::ShapedBody;
use crate::registry::{Effect, GarmentKind};
use crate::sequence::{BodyTopology, Garment, SceneMeta, SequenceHeader};

/// Side of the published program's patches, in UV units.
const PUBLISHED_PATCH: f32 = 0.04;

/// Blender's default gravity, 9.81, acts in frame time as 0.001 · 9.81
/// units/frame²; in units/s² at 30 frames per second.
const GRAVITY: f32 = -0.001 * 9.81 * FPS * FPS;

/// Kind of a garment by its published name.
pub fn kind_of(name: &str) -> Option<GarmentKind> {
    Some(match name {
        "jacket" => GarmentKind::Jacket,
        "jacket_hood" => GarmentKind::JacketHood,
        "jumpsuit_sleeveless" => GarmentKind::Jumpsuit,
        "tee" | "tee_sleeveless" => GarmentKind::TShirt,
        "dress_sleeveless" | "wb_dress_sleeveless" => GarmentKind::Dress,
        "wb_pants_straight" | "pants_straight_sides" => GarmentKind::Pants,
        "skirt_2_panels" | "skirt_4_panels" | "skirt_8_panels" => GarmentKind::Skirt,
        _ => return None,
    })
}

/// Reads a garment's files: its fixed part and its frames, not yet read.
pub(super) fn garment(
    folder: &Path,
    layer: usize,
    meta: &GarmentMeta,
    meta_path: &Path,
    notes: &mut Vec<String>,
) -> Result<(Garment, Frames)> {
    let name = &meta.name;
    let Some(kind) = kind_of(name) else {
        let place = format!("garment[{layer}].name");
        let expected = "one of the 12 published garments, such as tee or skirt_4_panels";
        return Err(DatasetError::invalid(place, expected, format!("{name:?}")).in_file(meta_path));
    };
    let path = folder.join(format!("{name}.pkl"));
    let pickle = Pickle::open(&path)?;
    let root = pickle.root();
    let frames = root.get("vertices", "garment")?.frames("vertices")?;
    let tpose = root.get("tpose", "garment")?;
    let rest = tpose.numbers("tpose")?;
    if rest.shape != [frames.vertex_count(), 3] {
        let expected = format!("shape [{}, 3], as vertices has", frames.vertex_count());
        return Err(tpose.invalid("tpose", expected, format!("shape {:?}", rest.shape)));
    }
    let faces = root.get("faces", "garment")?;
    let triangles = faces.numbers("faces")?;
    if triangles.shape.len() != 2 || triangles.shape[1] != 3 {
        let found = format!("shape {:?}", triangles.shape);
        return Err(faces.invalid("faces", "shape [faces, 3]", found));
    }
    let triangles = triangles
        .index_rows()
        .map_err(|bad| faces.invalid("faces", "vertex numbers", bad.to_string()))?;
    let vertices = frames.vertex_count();
    if let Some(index) = triangles
        .as_flattened()
        .iter()
        .find(|&&i| i as usize >= vertices)
    {
        let expected = format!("vertex indices below {vertices}");
        return Err(faces.invalid("faces", expected, format!("index {index}")));
    }
    let uv_path = folder.join(format!("uv_{name}.pkl"));
    let panels = panels::read(&uv_path, name, &triangles, notes)?;
    let garment = Garment {
        name: name.clone(),
        kind,
        layer: layer as u32,
        rest: rest.rows().into_iter().map(z_up).collect(),
        faces: triangles,
        uv: panels.uv,
        uv_faces: panels.uv_faces,
        panel_of_face: panels.panel_of_face,
        panels: panels.names,
        material: meta.material,
    };
    garment.check().map_err(|error| error.in_file(&path))?;
    Ok((garment, frames))
}

/// The header; `notes` become its warnings, with what is derived in every sequence.
pub(super) fn header(
    name: &str,
    meta: &Meta,
    garments: Vec<Garment>,
    body: Option<&ShapedBody>,
    mut notes: Vec<String>,
) -> Result<SequenceHeader> {
    let metres_per_uv = metres_per_uv(&garments, meta.human.scale, &mut notes)
        .map_err(|error| error.in_file(&meta.path))?;
    let windy = meta.wind.iter().any(|pivot| pivot.wind.strength > 0.0);
    let scale = meta.human.scale as f32;
    notes.push(format!(
        "fps 30, gravity {:.3} units/s² (Blender's default in frame time) and effects: from the \
         paper and its generator, not from the files",
        -GRAVITY
    ));
    notes.push("rest positions: tpose, turned from Y-up to Z-up".into());
    let body = match body {
        Some(body) => {
            let [x, y, z] = body.root_offset().map(|x| x * meta.human.scale);
            notes.push(format!(
                "root: the published program's origin, scale · trans; the root joint is \
                 [{x:.4}, {y:.4}, {z:.4}] units from it"
            ));
            BodyTopology {
                rest: body
                    .rest()
                    .iter()
                    .map(|p| z_up(p.map(|x| (x * meta.human.scale) as f32)))
                    .collect(),
                faces: body.model().faces().to_vec(),
                vertex_count: body.rest().len(),
            }
        }
        None => {
            notes.push("the body is missing: no SMPL model was given".into());
            notes.push("root: the published program's origin, scale · trans".into());
            BodyTopology {
                rest: Vec::new(),
                faces: Vec::new(),
                vertex_count: 0,
            }
        }
    };
    let is_active = |effect: &Effect| match effect {
        Effect::Wind => windy,
        Effect::LayerContact => garments.len() > 1,
        // Blender damps by air and pins waists only if told to; nobody says so.
        Effect::AirDrag | Effect::Waistband => false,
        _ => true,
    };
    let header = SequenceHeader {
        name: name.to_owned(),
        scene: SceneMeta {
            scale,
            fps: FPS,
            seed: 0,
            engine: "blender".into(),
            engine_version: "unknown".into(),
            effects: Effect::ALL.iter().copied().filter(is_active).collect(),
            gravity: [0.0, 0.0, GRAVITY],
            body_friction: meta.human.friction,
            metres_per_uv,
            recipe: meta.json.to_string(),
            warnings: notes,
        },
        body,
        garments,
    };
    header.check().map_err(|error| error.in_file(&meta.path))?;
    Ok(header)
}

/// Y-up to Z-up: a quarter turn about x.
fn z_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    [x, -z, y]
}

/// From the ratio of all garments' areas in space and in UV.
fn metres_per_uv(garments: &[Garment], scale: f64, notes: &mut Vec<String>) -> Result<f32> {
    let mut total = (0.0, 0.0);
    let mut densities = Vec::new();
    for garment in garments {
        let (space, uv) = (area(&garment.rest, &garment.faces), uv_area(garment));
        if !(space > 0.0 && uv > 0.0) {
            let place = format!("garment {:?}, tpose and UV", garment.name);
            let found = format!("{space} and {uv}");
            return Err(DatasetError::invalid(place, "areas above 0", found));
        }
        total = (total.0 + space, total.1 + uv);
        densities.push((space / uv).sqrt() / scale);
    }
    let all = (total.0 / total.1).sqrt() / scale;
    let metres_per_uv = all as f32;
    notes.push(format!(
        "metres_per_uv {metres_per_uv:.4} from areas: the published patch of {PUBLISHED_PATCH} UV \
         units is {:.4} m",
        PUBLISHED_PATCH * metres_per_uv
    ));
    for (garment, density) in garments.iter().zip(densities) {
        if (density / all - 1.0).abs() > DENSITY_TOLERANCE {
            notes.push(format!(
                "garment {:?} alone has {density:.4} m per UV unit: its patches differ in size",
                garment.name
            ));
        }
    }
    Ok(metres_per_uv)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_twelve_published_garments_cover_the_seven_kinds_and_others_are_none() {
        let names = [
            "jacket",
            "jacket_hood",
            "jumpsuit_sleeveless",
            "tee",
            "tee_sleeveless",
            "dress_sleeveless",
            "wb_dress_sleeveless",
            "wb_pants_straight",
            "pants_straight_sides",
            "skirt_2_panels",
            "skirt_4_panels",
            "skirt_8_panels",
        ];
        let mut kinds: Vec<_> = names.iter().map(|name| kind_of(name).unwrap()).collect();
        kinds.sort();
        kinds.dedup();
        assert_eq!(kinds, GarmentKind::ALL);
        assert_eq!(kind_of("cape"), None);
    }
}

//! Conversion between the in-memory types and the protobuf messages.
//!
//! Positions travel as packed little-endian f32, indices as packed
//! little-endian u32: one copy each way and the same bits back.

use prost::bytes::Bytes;

use super::FORMAT_MAJOR;
use crate::error::{DatasetError, Result};
use crate::registry::{Effect, GarmentKind};
use crate::sequence::{
    BodyTopology, Frame, Garment, Intersections, Material, Root, SceneMeta, SequenceHeader, Wind,
};

/// Types generated from `drape.proto`.
pub(super) mod proto {
    include!(concat!(env!("OUT_DIR"), "/drape.rs"));
}

pub(super) fn header_to_message(header: &SequenceHeader, minor: u32) -> proto::SequenceHeader {
    let scene = &header.scene;
    proto::SequenceHeader {
        format_major: FORMAT_MAJOR,
        format_minor: minor,
        name: header.name.clone(),
        scene: Some(proto::Scene {
            scale: scene.scale,
            fps: scene.fps,
            seed: scene.seed,
            engine: scene.engine.clone(),
            engine_version: scene.engine_version.clone(),
            effects: scene
                .effects
                .iter()
                .map(|effect| effect.name().to_owned())
                .collect(),
            gravity: scene.gravity.to_vec(),
            body_friction: scene.body_friction,
            metres_per_uv: scene.metres_per_uv,
            recipe: scene.recipe.clone(),
            warnings: scene.warnings.clone(),
        }),
        body: Some(proto::Body {
            vertex_count: header.body.vertex_count as u32,
            rest: pack_f32(&header.body.rest),
            faces: pack_u32(header.body.faces.as_flattened()),
        }),
        garments: header.garments.iter().map(garment_to_message).collect(),
    }
}

fn garment_to_message(garment: &Garment) -> proto::Garment {
    let m = garment.material;
    proto::Garment {
        name: garment.name.clone(),
        kind: garment.kind.name().to_owned(),
        layer: garment.layer,
        rest: pack_f32(&garment.rest),
        faces: pack_u32(garment.faces.as_flattened()),
        uv: pack_f32(&garment.uv),
        uv_faces: pack_u32(garment.uv_faces.as_flattened()),
        panel_of_face: pack_u32(&garment.panel_of_face),
        panels: garment.panels.clone(),
        material: Some(proto::Material {
            mass: m.mass,
            tension: m.tension,
            compression: m.compression,
            shear: m.shear,
            bending: m.bending,
            friction: m.friction,
        }),
    }
}

pub(super) fn header_from_message(message: proto::SequenceHeader) -> Result<SequenceHeader> {
    let scene = message.scene.ok_or_else(|| missing("header", "scene"))?;
    let body = message.body.ok_or_else(|| missing("header", "body"))?;
    Ok(SequenceHeader {
        name: message.name,
        scene: SceneMeta {
            scale: scene.scale,
            fps: scene.fps,
            seed: scene.seed,
            engine: scene.engine,
            engine_version: scene.engine_version,
            effects: scene
                .effects
                .iter()
                .map(|e| e.parse())
                .collect::<Result<Vec<Effect>>>()?,
            gravity: small(&scene.gravity, "scene gravity")?,
            body_friction: scene.body_friction,
            metres_per_uv: scene.metres_per_uv,
            recipe: scene.recipe,
            warnings: scene.warnings,
        },
        body: BodyTopology {
            rest: unpack_f32(&body.rest, "body rest")?,
            faces: unpack_u32(&body.faces, "body faces")?,
            vertex_count: body.vertex_count as usize,
        },
        garments: message
            .garments
            .into_iter()
            .map(|garment| {
                let place = format!("garment {:?}", garment.name);
                garment_from_message(garment).map_err(|error| error.at(&place))
            })
            .collect::<Result<_>>()?,
    })
}

fn garment_from_message(garment: proto::Garment) -> Result<Garment> {
    let m = garment
        .material
        .ok_or_else(|| missing("garment", "material"))?;
    Ok(Garment {
        kind: garment.kind.parse::<GarmentKind>()?,
        layer: garment.layer,
        rest: unpack_f32(&garment.rest, "rest")?,
        faces: unpack_u32(&garment.faces, "faces")?,
        uv: unpack_f32(&garment.uv, "uv")?,
        uv_faces: unpack_u32(&garment.uv_faces, "uv_faces")?,
        panel_of_face: unpack_u32::<1>(&garment.panel_of_face, "panel_of_face")?
            .into_iter()
            .map(|[panel]| panel)
            .collect(),
        panels: garment.panels,
        material: Material {
            mass: m.mass,
            tension: m.tension,
            compression: m.compression,
            shear: m.shear,
            bending: m.bending,
            friction: m.friction,
        },
        name: garment.name,
    })
}

pub(super) fn frame_to_message(index: u64, frame: &Frame) -> proto::Frame {
    proto::Frame {
        index,
        body: pack_f32(&frame.body),
        root: Some(proto::Root {
            translation: frame.root.translation.to_vec(),
            rotation: frame.root.rotation.to_vec(),
        }),
        garments: frame
            .garments
            .iter()
            .map(|positions| pack_f32(positions))
            .collect(),
        wind: Some(proto::Wind {
            rotation: frame.wind.rotation.to_vec(),
            strength: frame.wind.strength,
        }),
        intersections: frame.intersections.map(|count| proto::Intersections {
            between_garments: count.between_garments,
            within_garments: count.within_garments,
            with_body: count.with_body,
        }),
    }
}

pub(super) fn frame_from_message(message: proto::Frame) -> Result<Frame> {
    let root = message.root.ok_or_else(|| missing("frame", "root"))?;
    let wind = message.wind.ok_or_else(|| missing("frame", "wind"))?;
    Ok(Frame {
        body: unpack_f32(&message.body, "body positions")?,
        root: Root {
            translation: small(&root.translation, "root translation")?,
            rotation: small(&root.rotation, "root rotation")?,
        },
        garments: message
            .garments
            .iter()
            .map(|positions| unpack_f32(positions, "garment positions"))
            .collect::<Result<_>>()?,
        wind: Wind {
            rotation: small(&wind.rotation, "wind rotation")?,
            strength: wind.strength,
        },
        intersections: message.intersections.map(|count| Intersections {
            between_garments: count.between_garments,
            within_garments: count.within_garments,
            with_body: count.with_body,
        }),
    })
}

fn missing(place: &str, field: &str) -> DatasetError {
    DatasetError::invalid(place, format!("a field {field:?}"), "none")
}

fn small<const N: usize>(values: &[f32], place: &str) -> Result<[f32; N]> {
    values.try_into().map_err(|_| {
        DatasetError::invalid(
            place,
            format!("{N} numbers"),
            format!("{} numbers", values.len()),
        )
    })
}

fn pack_f32<const N: usize>(values: &[[f32; N]]) -> Bytes {
    let mut bytes = Vec::with_capacity(size_of_val(values));
    for value in values.as_flattened() {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.into()
}

fn pack_u32(values: &[u32]) -> Bytes {
    let mut bytes = Vec::with_capacity(size_of_val(values));
    for value in values {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.into()
}

fn unpack_f32<const N: usize>(bytes: &[u8], place: &str) -> Result<Vec<[f32; N]>> {
    rows(bytes, place, f32::from_le_bytes)
}

fn unpack_u32<const N: usize>(bytes: &[u8], place: &str) -> Result<Vec<[u32; N]>> {
    rows(bytes, place, u32::from_le_bytes)
}

/// Splits `bytes` into rows of `N` four-byte words.
fn rows<const N: usize, T: Copy>(
    bytes: &[u8],
    place: &str,
    parse: impl Fn([u8; 4]) -> T,
) -> Result<Vec<[T; N]>> {
    let (words, rest) = bytes.as_chunks::<4>();
    let (rows, tail) = words.as_chunks::<N>();
    if !rest.is_empty() || !tail.is_empty() {
        return Err(DatasetError::invalid(
            place,
            format!("a multiple of {} bytes", 4 * N),
            format!("{} bytes", bytes.len()),
        ));
    }
    Ok(rows.iter().map(|row| row.map(&parse)).collect())
}

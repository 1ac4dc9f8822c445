//! UV groups of a garment as panels: each face gets the panel that lists it and
//! the UVs that its corners have there.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use crate::error::{DatasetError, Result};
use crate::import::pickle::{Item, Pickle};

/// UV part of a garment.
pub(super) struct Panels {
    pub names: Vec<String>,
    pub uv: Vec<[f32; 2]>,
    /// `[face, 3]`
    pub uv_faces: Vec<[u32; 3]>,
    pub panel_of_face: Vec<u32>,
}

/// UV index of each vertex of one group.
type Corners = BTreeMap<u32, u32>;

/// Reads the groups of a garment with `faces`; notes what had to be assumed.
pub(super) fn read(
    path: &Path,
    garment: &str,
    faces: &[[u32; 3]],
    notes: &mut Vec<String>,
) -> Result<Panels> {
    let pickle = Pickle::open(path)?;
    let groups = pickle.root().entries("UV groups")?;
    let mut names = Vec::new();
    let mut uv = Vec::new();
    let mut corners: Vec<Corners> = Vec::new();
    // Faces by their vertices, ascending: groups may start a triangle elsewhere.
    let mut listed: HashMap<[u32; 3], (u32, bool)> = HashMap::new();
    let mut twice = 0;
    for (panel, (key, group)) in groups.iter().enumerate() {
        let name = key.text().or_else(|| key.int().map(|n| n.to_string()));
        let Some(name) = name else {
            return Err(group.invalid("UV groups", "names as keys", key.describe()));
        };
        let place = format!("UV group \"{name}\"");
        names.push(name);
        corners.push(vertices(group.get("vertices", &place)?, &place, &mut uv)?);
        for face in triangles(group.get("faces", &place)?, &place)? {
            let first = *listed.entry(sorted(face)).or_insert((panel as u32, false));
            twice += usize::from(first.0 != panel as u32);
        }
    }
    let mut panels = Panels {
        names,
        uv,
        uv_faces: Vec::with_capacity(faces.len()),
        panel_of_face: Vec::with_capacity(faces.len()),
    };
    let mut unlisted = 0;
    for (index, face) in faces.iter().enumerate() {
        let all_in = |panel: u32| {
            let corners = &corners[panel as usize];
            let uv = face.map(|vertex| corners.get(&vertex).copied());
            match uv {
                [Some(a), Some(b), Some(c)] => Some((panel, [a, b, c])),
                _ => None,
            }
        };
        let place = || format!("UV of face {index}, {face:?}");
        let found = match listed.get_mut(&sorted(*face)) {
            Some((panel, used)) => {
                *used = true;
                all_in(*panel).ok_or_else(|| {
                    let name = &panels.names[*panel as usize];
                    let expected = format!("all vertices in group \"{name}\", which lists it");
                    DatasetError::invalid(place(), expected, "one without UV").in_file(path)
                })?
            }
            None => {
                unlisted += 1;
                (0..corners.len() as u32).find_map(all_in).ok_or_else(|| {
                    let expected = "a UV group that lists it or has all its vertices";
                    DatasetError::invalid(place(), expected, "none").in_file(path)
                })?
            }
        };
        panels.panel_of_face.push(found.0);
        panels.uv_faces.push(found.1);
    }
    let mut others: Vec<_> = listed
        .iter()
        .filter(|(_, (_, used))| !used)
        .map(|(f, _)| f)
        .collect();
    others.sort_unstable();
    if let Some(face) = others.first() {
        let expected = "faces of the garment only";
        let found = format!("{} others, such as {face:?}", others.len());
        return Err(DatasetError::invalid("UV groups", expected, found).in_file(path));
    }
    if unlisted > 0 {
        notes.push(format!(
            "garment {garment:?}: {unlisted} faces are in no UV group, and are put into the first \
             one that has all their vertices"
        ));
    }
    if twice > 0 {
        notes.push(format!(
            "garment {garment:?}: {twice} faces are in two UV groups, and are put into the first"
        ));
    }
    Ok(panels)
}

/// Appends the UVs of a group; returns the index of each vertex.
fn vertices(item: Item<'_>, place: &str, uv: &mut Vec<[f32; 2]>) -> Result<Corners> {
    let mut by_vertex = BTreeMap::new();
    for (key, value) in item.entries(place)? {
        let Some(vertex) = key.int().and_then(|vertex| u32::try_from(vertex).ok()) else {
            return Err(item.invalid(place, "vertex numbers as keys", key.describe()));
        };
        let place = format!("{place}, vertex {vertex}");
        let coordinates = value.numbers(&place)?.values;
        match coordinates[..] {
            [u, v] if [u, v].iter().all(|x| (0.0..=1.0).contains(x)) => {
                by_vertex.insert(vertex, [u as f32, v as f32]);
            }
            _ => {
                let found = format!("{coordinates:?}");
                return Err(item.invalid(&place, "two UV coordinates in [0, 1]", found));
            }
        }
    }
    Ok(by_vertex
        .into_iter()
        .map(|(vertex, coordinates)| {
            uv.push(coordinates);
            (vertex, uv.len() as u32 - 1)
        })
        .collect())
}

fn triangles(item: Item<'_>, place: &str) -> Result<Vec<[u32; 3]>> {
    let array = item.numbers(&format!("{place}, faces"))?;
    if array.values.is_empty() {
        return Ok(Vec::new());
    }
    let found = format!("shape {:?}", array.shape);
    match (&array.shape[..], array.index_rows()) {
        ([_, 3], Ok(rows)) => Ok(rows),
        ([_, 3], Err(bad)) => Err(item.invalid(place, "vertex numbers", bad.to_string())),
        _ => Err(item.invalid(place, "faces of three vertices", found)),
    }
}

fn sorted(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}

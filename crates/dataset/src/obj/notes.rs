//! What of a garment's mesh may not be as it was meant. Each is a guess or a matter of
//! taste, so none is an error: an engine may refuse what a viewer draws.

use std::collections::BTreeMap;

use drape_geometry::mesh::components;

use super::{FLAT, GarmentMesh};

/// Longest side of a garment in metres: a small top to a coat with sleeves spread. Its
/// ends are a factor of ten apart, as the units in use are, so that one unit fits.
const LONGEST_SIDE_M: [f32; 2] = [0.22, 2.2];
/// Units of a metre that programs write, and what they are called.
const UNITS: [(f32, &str); 4] = [
    (1.0, "metres"),
    (10.0, "units of 0.1 m"),
    (100.0, "centimetres"),
    (1000.0, "millimetres"),
];
/// Units per metre of scenes.
const SCENE: f32 = 10.0;

/// Notes on a mesh whose indices are in range; `line` tells each face's.
pub(super) fn of(mesh: &GarmentMesh, line: &[usize]) -> Vec<String> {
    let notes = [
        shared_edges(mesh, line),
        turned_faces(mesh, line),
        flat_in_uv(mesh, line),
        unwelded(mesh),
        pieces(mesh),
        scale(mesh),
        up_axis(mesh),
    ];
    notes.into_iter().flatten().collect()
}

/// Directed sides of faces, in order of their ends.
fn sides(mesh: &GarmentMesh) -> BTreeMap<[u32; 2], Vec<(usize, bool)>> {
    let mut sides: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for (face, &[a, b, c]) in mesh.faces.iter().enumerate() {
        for [a, b] in [[a, b], [b, c], [c, a]] {
            sides
                .entry([a.min(b), a.max(b)])
                .or_default()
                .push((face, a < b));
        }
    }
    sides
}

fn shared_edges(mesh: &GarmentMesh, line: &[usize]) -> Option<String> {
    let sides = sides(mesh);
    let mut bad = sides.iter().filter(|(_, faces)| faces.len() > 2);
    let (edge, faces) = bad.next()?;
    let lines: Vec<_> = faces
        .iter()
        .map(|(face, _)| line[*face].to_string())
        .collect();
    Some(format!(
        "lines {}: more than two faces on the edge of vertices {edge:?} (not a manifold; {} such edges)",
        lines.join(", "),
        bad.count() + 1
    ))
}

fn turned_faces(mesh: &GarmentMesh, line: &[usize]) -> Option<String> {
    let sides = sides(mesh);
    let mut bad = (sides.iter()).filter_map(|(edge, faces)| match faces[..] {
        [(a, up), (b, same)] if up == same => Some((edge, a, b)),
        _ => None,
    });
    let (edge, a, b) = bad.next()?;
    Some(format!(
        "lines {} and {}: neighbours on the edge {edge:?} that face opposite ways ({} such edges): \
         turn one side over",
        line[a],
        line[b],
        bad.count() + 1
    ))
}

fn flat_in_uv(mesh: &GarmentMesh, line: &[usize]) -> Option<String> {
    let flat = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|corner| mesh.uv[corner as usize].map(f64::from));
        let [p, q] = [b, c].map(|to| [to[0] - a[0], to[1] - a[1]]);
        let longest_squared = [p, q, [q[0] - p[0], q[1] - p[1]]]
            .map(|[u, v]| u * u + v * v)
            .into_iter()
            .fold(0.0, f64::max);
        (p[0] * q[1] - p[1] * q[0]).abs() <= FLAT * longest_squared
    };
    let mut bad = (0..).zip(&mesh.uv_faces).filter(|(_, face)| flat(face));
    let (first, _): (usize, _) = bad.next()?;
    Some(format!(
        "line {}: a face without area in the UV map ({} such faces): patches are cells of \
         that map, so unwrap the garment at one scale",
        line[first],
        bad.count() + 1
    ))
}

fn unwelded(mesh: &GarmentMesh) -> Option<String> {
    let mut first_at: BTreeMap<[u32; 3], usize> = BTreeMap::new();
    let mut pairs = Vec::new();
    for (vertex, position) in mesh.rest.iter().enumerate() {
        // Adding 0 makes −0 the same place as 0.
        let place = position.map(|x| (x + 0.0).to_bits());
        match first_at.get(&place) {
            Some(&first) => pairs.push((first, vertex)),
            None => drop(first_at.insert(place, vertex)),
        }
    }
    let (first, other) = pairs.first()?;
    Some(format!(
        "vertices {first} and {other} lie in one place ({} such vertices): unless layers are meant \
         to touch, weld them, or the garment comes apart there (UV seams need no second vertex)",
        pairs.len()
    ))
}

fn pieces(mesh: &GarmentMesh) -> Option<String> {
    let component = components(mesh.rest.len(), &mesh.faces);
    let count = component.iter().max().map_or(0, |&last| last as usize + 1);
    let mut sizes = vec![0usize; count];
    component
        .iter()
        .for_each(|&piece| sizes[piece as usize] += 1);
    sizes.sort_unstable_by(|a, b| b.cmp(a));
    let largest: Vec<_> = sizes.iter().take(4).map(usize::to_string).collect();
    let more = if count > 4 { " …" } else { "" };
    (count > 1).then(|| {
        format!(
            "{count} pieces that share no vertex ({}{more} vertices): a garment of an outfit is one piece",
            largest.join(", ")
        )
    })
}

/// Least and largest coordinate of each axis.
fn extent(mesh: &GarmentMesh) -> [[f32; 2]; 3] {
    let mut extent = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
    for position in &mesh.rest {
        for ([low, high], &x) in extent.iter_mut().zip(position) {
            (*low, *high) = (low.min(x), high.max(x));
        }
    }
    extent
}

fn scale(mesh: &GarmentMesh) -> Option<String> {
    let longest = extent(mesh)
        .map(|[low, high]| high - low)
        .into_iter()
        .fold(0.0, f32::max);
    let [least, most] = LONGEST_SIDE_M;
    let fits = |unit: f32| least * unit < longest && longest <= most * unit;
    if fits(SCENE) {
        return None;
    }
    Some(match UNITS.iter().find(|(unit, _)| fits(*unit)) {
        Some((unit, name)) => format!(
            "the longest side is {longest}: it looks as if it were in {name}; scenes have 10 units \
             to a metre by default, so multiply by {}",
            SCENE / unit
        ),
        None => format!(
            "the longest side is {longest}: no garment in metres, units of 0.1 m, centimetres or \
             millimetres is that size"
        ),
    })
}

/// A worn garment hangs above the ground and around the vertical axis.
fn up_axis(mesh: &GarmentMesh) -> Option<String> {
    let extent = extent(mesh);
    let longest = extent
        .map(|[low, high]| high - low)
        .into_iter()
        .fold(0.0, f32::max);
    let [x, y, z] = extent.map(|[low, high]| (low + high) / 2.0);
    let near = |centre: f32| centre.abs() < longest / 4.0;
    (near(x) && near(z) && y > longest / 2.0).then(|| {
        format!(
            "it hangs around the Y axis, {y} along it: it looks as if Y were up; scenes have Z up, \
             so turn (x, y, z) to (x, -z, y)"
        )
    })
}

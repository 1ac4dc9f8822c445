//! Garment meshes from and to Wavefront OBJ.
//!
//! A garment file holds faces, each corner with position and UV (`f 1/1 2/2 3/3`),
//! UVs in `[0, 1]`. Panels are the islands of the UV map. What cannot be a garment is
//! refused with the line it stands in: missing UVs that were invented train silently
//! wrong. What can be one, but may not be meant so, is told in
//! [`GarmentMesh::notes`]: polygons, which are cut into triangles, edges that are not a
//! manifold's, faces without area in the UV map, vertices in one place, pieces, and a guess at unit and up axis. Normals,
//! groups, smoothing and materials are read over.
//!
//! `tobj` reads the mesh. What it would pass over in silence is checked line by
//! line before: it invents missing UVs, takes index 0 for none, and knows no
//! line numbers. It also numbers vertices in the order in which faces name them,
//! which would break the link to recorded frames: a first face that names all in
//! the file's order prevents that.

mod notes;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use crate::atomic;
use crate::error::{DatasetError, Result};
use crate::panels::{numbered_names, uv_islands};
use crate::registry::GarmentKind;
use crate::sequence::{Garment, Material};

/// A face is flat when twice its area is below this share of its longest
/// edge squared: f32 coordinates carry a relative error of 6e-8.
const FLAT: f64 = 1e-6;

/// What an OBJ file tells about a garment.
#[derive(Clone, Debug, PartialEq)]
pub struct GarmentMesh {
    /// Positions, `[vertex, 3]`, in the file's order.
    pub rest: Vec<[f32; 3]>,
    /// Triangles, `[face, 3]`.
    pub faces: Vec<[u32; 3]>,
    /// UV coordinates, `[uv, 2]`.
    pub uv: Vec<[f32; 2]>,
    /// UV index of each corner, `[face, 3]`.
    pub uv_faces: Vec<[u32; 3]>,
    /// Panel of each face: UV island.
    pub panel_of_face: Vec<u32>,
    /// Number of panels.
    pub panel_count: usize,
    /// What may not be as it was meant, with lines.
    pub notes: Vec<String>,
}

impl GarmentMesh {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// Names the line: not a number, NaN or infinite; a face with fewer than
    /// three corners, without UV, with an index out of range, with a repeated
    /// vertex or without area; a vertex of no face; UVs outside `[0, 1]`;
    /// lines and points; no faces at all.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = fs::read(path).map_err(DatasetError::io("read", path))?;
        // Names and comments may be in any encoding; a statement with such letters is refused.
        Self::parse(&String::from_utf8_lossy(&bytes)).map_err(|error| error.in_file(path))
    }

    /// Like [`read`](Self::read), from text.
    pub fn parse(text: &str) -> Result<Self> {
        let mut polygons = 0;
        let mut first_polygon = None;
        // The text without what tobj need not see, its faces counted from 1.
        let mut plain = String::new();
        // Line of each vertex, UV and face, to name it when a later check fails.
        let (mut vertex_line, mut uv_line, mut face_line) = (Vec::new(), Vec::new(), Vec::new());
        // Some programs begin text with a mark of its encoding.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        for (number, line) in (1..).zip(text.lines()) {
            let at = |error: DatasetError| error.at(&format!("line {number}"));
            let mut words = line.split_whitespace();
            match words.next() {
                Some("v") => {
                    // Colours or a weight may follow.
                    let [x, y, z] = numbers("vertex", words).map_err(at)?;
                    writeln!(plain, "v {x} {y} {z}").expect("memory");
                    vertex_line.push(number);
                }
                Some("vt") => {
                    let [u, v] = numbers("UV", words).map_err(at)?;
                    writeln!(plain, "vt {u} {v}").expect("memory");
                    uv_line.push(number);
                }
                Some("f") => {
                    let corners = corners(words, vertex_line.len(), uv_line.len()).map_err(at)?;
                    let word = |(vertex, uv): (u32, u32)| format!("{}/{}", vertex + 1, uv + 1);
                    if corners.len() > 3 {
                        polygons += 1;
                        first_polygon.get_or_insert((number, corners.len()));
                    }
                    // A fan from the first corner: with three corners, the face itself.
                    for pair in corners[1..].windows(2) {
                        let [a, b, c] = [corners[0], pair[0], pair[1]].map(word);
                        writeln!(plain, "f {a} {b} {c}").expect("memory");
                        face_line.push(number);
                    }
                }
                Some("vn" | "vp" | "o" | "g" | "s" | "usemtl" | "mtllib") | None => {}
                Some(comment) if comment.starts_with('#') => {}
                Some(other) => {
                    return Err(at(DatasetError::invalid(
                        "statement",
                        "v, vt, f, or one of vn vp o g s usemtl mtllib",
                        format!("{other:?}"),
                    )));
                }
            }
        }
        if face_line.is_empty() {
            return Err(DatasetError::invalid(
                "faces",
                "at least one triangle",
                "none",
            ));
        }
        let mut mesh = Self::read_plain(&plain, vertex_line.len(), uv_line.len())?;
        for (uv, line) in mesh.uv.iter().zip(uv_line) {
            if !uv.iter().all(|x| (0.0..=1.0).contains(x)) {
                return Err(DatasetError::invalid(
                    format!("line {line}, UV"),
                    "two numbers in [0, 1] (scale all UVs by one factor and divide \
                     metres_per_uv by it)",
                    format!("{uv:?}"),
                ));
            }
        }
        for (face, line) in face_line.iter().enumerate() {
            let at = |error: DatasetError| error.at(&format!("line {line}"));
            check_area(&mesh, face).map_err(at)?;
            // Triangles of one line are one polygon.
            if face > 0 && face_line[face - 1] == *line {
                check_fan(&mesh, face).map_err(at)?;
            }
        }
        let mut used = vec![false; mesh.rest.len()];
        mesh.faces
            .as_flattened()
            .iter()
            .for_each(|&vertex| used[vertex as usize] = true);
        if let Some(loose) = used.iter().position(|used| !used) {
            return Err(DatasetError::invalid(
                format!("line {}, vertex {loose}", vertex_line[loose]),
                "a vertex of at least one face (delete loose vertices)",
                "a vertex of none",
            ));
        }
        (mesh.panel_of_face, mesh.panel_count) = uv_islands(&mesh.uv_faces, mesh.uv.len());
        if let Some((line, corners)) = first_polygon {
            mesh.notes.push(format!(
                "line {line}: a face of {corners} corners; {polygons} such faces were cut into \
                 triangles, each as a fan from its first corner"
            ));
        }
        mesh.notes.extend(notes::of(&mesh, &face_line));
        Ok(mesh)
    }

    /// A checked file of triangles, with vertices and UVs in its order; panels are not found yet.
    fn read_plain(plain: &str, vertices: usize, uvs: usize) -> Result<Self> {
        let mut text = String::from("f");
        for corner in 1..=vertices.max(uvs) {
            write!(text, " {}/{}", corner.min(vertices), corner.min(uvs)).expect("memory");
        }
        text.push('\n');
        text.push_str(plain);
        let refused = |found: String| DatasetError::invalid("OBJ", "what tobj can read", found);
        let options = tobj::LoadOptions::default();
        let (mut models, _) =
            tobj::load_obj_buf(&mut text.as_bytes(), &options, |_| Ok(Default::default()))
                .map_err(|cause| refused(cause.to_string()))?;
        let mesh = match (models.pop(), models.is_empty()) {
            (Some(model), true) => model.mesh,
            _ => return Err(refused("not one mesh".into())),
        };
        let triangles = |indices: &[u32]| -> Vec<[u32; 3]> {
            let (faces, _) = indices[vertices.max(uvs)..].as_chunks();
            faces.to_vec()
        };
        Ok(Self {
            rest: mesh.positions.as_chunks().0.to_vec(),
            faces: triangles(&mesh.indices),
            uv: mesh.texcoords.as_chunks().0.to_vec(),
            uv_faces: triangles(&mesh.texcoord_indices),
            panel_of_face: Vec::new(),
            panel_count: 0,
            notes: Vec::new(),
        })
    }

    /// The mesh as a garment of an outfit; panels are named `panel_0` and so on.
    pub fn into_garment(
        self,
        name: impl Into<String>,
        kind: GarmentKind,
        layer: u32,
        material: Material,
    ) -> Garment {
        Garment {
            name: name.into(),
            kind,
            layer,
            rest: self.rest,
            faces: self.faces,
            uv: self.uv,
            uv_faces: self.uv_faces,
            panel_of_face: self.panel_of_face,
            panels: numbered_names(self.panel_count),
            material,
        }
    }
}

/// Writes one frame of a garment (`positions`, `[vertex, 3]`; or its rest
/// positions) with its faces and UVs. Numbers are written so that they read
/// back as the same f32.
///
/// # Errors
/// Another number of positions than the garment has vertices; a failing disk.
pub fn write_garment(
    path: impl AsRef<Path>,
    garment: &Garment,
    positions: &[[f32; 3]],
) -> Result<()> {
    let path = path.as_ref();
    if positions.len() != garment.rest.len() {
        return Err(DatasetError::invalid(
            format!("garment {:?}, positions", garment.name),
            garment.rest.len().to_string(),
            positions.len().to_string(),
        )
        .in_file(path));
    }
    let mut text = format!(
        "# {} ({})\no {}\n",
        garment.name, garment.kind, garment.name
    );
    // Writing to a String cannot fail.
    for [x, y, z] in positions {
        writeln!(text, "v {x} {y} {z}").expect("memory");
    }
    for [u, v] in &garment.uv {
        writeln!(text, "vt {u} {v}").expect("memory");
    }
    for (face, uv) in garment.faces.iter().zip(&garment.uv_faces) {
        let [a, b, c] = std::array::from_fn(|i| format!("{}/{}", face[i] + 1, uv[i] + 1));
        writeln!(text, "f {a} {b} {c}").expect("memory");
    }
    atomic::write(path, text.as_bytes())
}

/// The first `N` words as finite numbers.
fn numbers<'a, const N: usize>(
    what: &str,
    mut words: impl Iterator<Item = &'a str>,
) -> Result<[f32; N]> {
    let mut values = [0.0; N];
    for value in &mut values {
        let word = words.next().unwrap_or("the end of the line");
        *value = word
            .parse::<f32>()
            .ok()
            .filter(|x| x.is_finite())
            .ok_or_else(|| {
                DatasetError::invalid(what, format!("{N} finite numbers"), format!("{word:?}"))
            })?;
    }
    Ok(values)
}

/// At least three corners as (vertex, UV), counted from 0.
fn corners<'a>(
    words: impl Iterator<Item = &'a str>,
    vertices: usize,
    uvs: usize,
) -> Result<Vec<(u32, u32)>> {
    let words: Vec<&str> = words.take_while(|word| !word.starts_with('#')).collect();
    if words.len() < 3 {
        let found = format!("{} corners", words.len());
        return Err(DatasetError::invalid(
            "face",
            "three corners or more",
            found,
        ));
    }
    let mut corners = Vec::with_capacity(words.len());
    for word in words {
        let mut parts = word.split('/');
        let vertex = parts.next().unwrap_or_default();
        let uv = parts.next().filter(|uv| !uv.is_empty()).ok_or_else(|| {
            let expected = "position/UV at every corner (unwrap the whole mesh)";
            DatasetError::invalid("face", expected, format!("{word:?}"))
        })?;
        corners.push((index("vertex", vertex, vertices)?, index("UV", uv, uvs)?));
    }
    Ok(corners)
}

/// An index of an OBJ face: from 1, or negative from the latest.
fn index(what: &str, word: &str, count: usize) -> Result<u32> {
    let value = word.parse::<i64>().ok();
    let from_zero = match value {
        Some(i) if i > 0 => i.checked_sub(1),
        Some(i) if i < 0 => i.checked_add(count as i64),
        _ => None,
    };
    from_zero
        .filter(|i| (0..count as i64).contains(i))
        .map(|i| i as u32)
        .ok_or_else(|| {
            let expected = format!("a {what} index from 1 to {count} (the {what} lines so far)");
            DatasetError::invalid("face", expected, format!("{word:?}"))
        })
}

/// A fan over a corner that points inwards has a triangle that lies on another.
fn check_fan(mesh: &GarmentMesh, face: usize) -> Result<()> {
    let normal = |face: usize| {
        let [a, b, c] = mesh.faces[face].map(|i| mesh.rest[i as usize].map(f64::from));
        let (p, q) = (
            [0, 1, 2].map(|i| b[i] - a[i]),
            [0, 1, 2].map(|i| c[i] - a[i]),
        );
        [1, 2, 0].map(|i| p[i] * q[(i + 1) % 3] - p[(i + 1) % 3] * q[i])
    };
    let (before, now) = (normal(face - 1), normal(face));
    if (0..3).map(|i| before[i] * now[i]).sum::<f64>() > 0.0 {
        return Ok(());
    }
    let expected = "a polygon whose corners point outwards (triangulate this one by hand)";
    Err(DatasetError::invalid(
        "face",
        expected,
        "a corner that points inwards",
    ))
}

fn check_area(mesh: &GarmentMesh, face: usize) -> Result<()> {
    let [a, b, c] = mesh.faces[face].map(|i| mesh.rest[i as usize].map(f64::from));
    let edge = |p: [f64; 3], q: [f64; 3]| [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
    let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    let (ab, ac, bc) = (edge(a, b), edge(a, c), edge(b, c));
    let longest_squared = dot(ab, ab).max(dot(ac, ac)).max(dot(bc, bc));
    let cross_squared = dot(ab, ab) * dot(ac, ac) - dot(ab, ac).powi(2);
    // Squared on both sides: no root of a number that rounding made negative.
    if cross_squared <= (FLAT * longest_squared).powi(2) {
        return Err(DatasetError::invalid(
            format!("face {face}"),
            "a triangle with an area (delete or merge degenerate faces)",
            format!(
                "corners {:?}",
                mesh.faces[face].map(|i| mesh.rest[i as usize])
            ),
        ));
    }
    Ok(())
}

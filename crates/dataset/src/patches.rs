//! Patches: square UV cells within a panel, the model's particles.
//!
//! Every triangle belongs to the cell `floor(mean UV of its corners / patch_size)`
//! of its own panel; its three vertices are members of that patch, so a vertex
//! may belong to several patches. Patches are numbered panel by panel in
//! increasing order of (cell u, cell v), empty cells do not exist.
//! Two patches are mesh neighbours if an edge of the mesh joins their members;
//! a patch is its own neighbour.
//! Source: the paper's supplement, section C ("square cells of the UV map").

use crate::error::DatasetError;
use crate::sequence::Garment;

/// Keeps the mean of no members finite; part of the bits of a mean, as in the published program.
const EPSILON: f32 = 1e-7;

/// Lists of indices by row, stored back to back.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Csr {
    /// Start of each row in `items`, one more than there are rows.
    pub offsets: Vec<u32>,
    /// Entries of all rows.
    pub items: Vec<u32>,
}

impl Csr {
    /// Builds the lists from `(row, item)` pairs: rows in order, items sorted, repeats dropped.
    pub fn from_pairs(rows: usize, mut pairs: Vec<(u32, u32)>) -> Self {
        pairs.sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0u32; rows + 1];
        for &(row, _) in &pairs {
            offsets[row as usize + 1] += 1;
        }
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        Self {
            offsets,
            items: pairs.into_iter().map(|(_, item)| item).collect(),
        }
    }

    /// Takes all rows away and keeps the memory.
    pub fn clear(&mut self) {
        self.offsets.clear();
        self.offsets.push(0);
        self.items.clear();
    }

    /// Adds a row of items behind the others.
    pub fn push_row(&mut self, items: impl IntoIterator<Item = u32>) {
        if self.offsets.is_empty() {
            self.offsets.push(0);
        }
        self.items.extend(items);
        self.offsets.push(self.items.len() as u32);
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Entries of one row.
    pub fn row(&self, row: usize) -> &[u32] {
        &self.items[self.offsets[row] as usize..self.offsets[row + 1] as usize]
    }

    /// All rows in order.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.rows()).map(|row| self.row(row))
    }

    /// `(row, item)` pairs in order.
    pub fn pairs(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        (0..self.rows()).flat_map(|row| self.row(row).iter().map(move |&item| (row as u32, item)))
    }
}

/// Patch of each triangle of one garment, `[face]`, and the number of patches.
///
/// `patch_size_uv` is the side of a cell in UV units.
///
/// # Errors
/// [`DatasetError::Patches`] if the size is not positive, a UV coordinate is not
/// finite, or the UV tables do not fit the faces.
pub fn patch_of_face(
    garment: &Garment,
    patch_size_uv: f32,
) -> Result<(Vec<u32>, usize), DatasetError> {
    let fail = |found: String| DatasetError::Patches {
        garment: garment.name.clone(),
        found,
    };
    if !(patch_size_uv.is_finite() && patch_size_uv > 0.0) {
        return Err(fail(format!(
            "patch size {patch_size_uv} UV units, expected a positive number"
        )));
    }
    let faces = garment.faces.len();
    if garment.uv_faces.len() != faces || garment.panel_of_face.len() != faces {
        return Err(fail(format!(
            "{faces} faces, but {} UV faces and {} panel indices: expected equal counts",
            garment.uv_faces.len(),
            garment.panel_of_face.len()
        )));
    }
    let mut cells = Vec::with_capacity(faces);
    for (face, (corners, &panel)) in garment
        .uv_faces
        .iter()
        .zip(&garment.panel_of_face)
        .enumerate()
    {
        let mut mean = [0f64; 2];
        for &corner in corners {
            let uv = garment.uv.get(corner as usize).ok_or_else(|| {
                fail(format!(
                    "face {face} names UV {corner} of {}",
                    garment.uv.len()
                ))
            })?;
            mean[0] += f64::from(uv[0]) / 3.0;
            mean[1] += f64::from(uv[1]) / 3.0;
        }
        let cell = mean.map(|value| (value / f64::from(patch_size_uv)).floor());
        if !cell.iter().all(|value| value.abs() < 1e9) {
            return Err(fail(format!(
                "face {face} has UV mean {mean:?}: expected finite coordinates in [0, 1]"
            )));
        }
        cells.push((panel, cell[0] as i64, cell[1] as i64));
    }
    let mut used = cells.clone();
    used.sort_unstable();
    used.dedup();
    let ids = cells
        .iter()
        .map(|cell| used.binary_search(cell).expect("cell was collected") as u32)
        .collect();
    Ok((ids, used.len()))
}

/// Members of each patch of an outfit, garments one after the other.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Patches {
    /// Vertices of each patch, sorted, in the outfit's vertex numbering.
    pub members: Csr,
    /// Patches of each vertex, sorted.
    pub of_vertex: Csr,
    /// Mesh neighbours of each patch, sorted, with the patch itself.
    pub neighbours: Csr,
}

impl Patches {
    /// Patches of an outfit from its membership pairs `(patch, vertex)` and mesh
    /// edges (outfit's vertex numbering).
    pub fn new(
        patches: usize,
        vertices: usize,
        membership: Vec<(u32, u32)>,
        edges: &[[u32; 2]],
    ) -> Self {
        let members = Csr::from_pairs(patches, membership.clone());
        let of_vertex = Csr::from_pairs(
            vertices,
            membership.into_iter().map(|(p, v)| (v, p)).collect(),
        );
        let mut neighbours = Vec::new();
        for &[a, b] in edges {
            for &p in of_vertex.row(a as usize) {
                for &q in of_vertex.row(b as usize) {
                    neighbours.push((p, q));
                    neighbours.push((q, p));
                }
            }
        }
        Self {
            neighbours: Csr::from_pairs(patches, neighbours),
            members,
            of_vertex,
        }
    }

    /// Patches of garments worn together; `patch_size_uv` as in [`patch_of_face`].
    ///
    /// # Errors
    /// As [`patch_of_face`].
    pub fn of_outfit(garments: &[Garment], patch_size_uv: f32) -> Result<Self, DatasetError> {
        let (mut patches, mut vertices) = (0u32, 0u32);
        let (mut membership, mut edges) = (Vec::new(), Vec::new());
        for garment in garments {
            let (ids, count) = patch_of_face(garment, patch_size_uv)?;
            for (face, id) in garment.faces.iter().zip(ids) {
                let face = face.map(|vertex| vertex + vertices);
                membership.extend(face.map(|vertex| (patches + id, vertex)));
                edges.extend([[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]]);
            }
            patches += count as u32;
            vertices += garment.rest.len() as u32;
        }
        Ok(Self::new(
            patches as usize,
            vertices as usize,
            membership,
            &edges,
        ))
    }

    /// Mean of the members' rows, by patch: `[vertex, N]` to `[patch, N]`. Of states, a
    /// patch's own state; its first three columns are the patch's centre.
    pub fn means<const N: usize>(&self, rows: &[[f32; N]]) -> impl Iterator<Item = [f32; N]> {
        self.members.iter().map(|vertices| {
            let mut sum = [0f32; N];
            for &vertex in vertices {
                for (sum, value) in sum.iter_mut().zip(&rows[vertex as usize]) {
                    *sum += value;
                }
            }
            sum.map(|value| value / (vertices.len() as f32 + EPSILON))
        })
    }

    /// Number of patches.
    pub fn count(&self) -> usize {
        self.members.rows()
    }
}

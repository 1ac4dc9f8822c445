//! Losses: gradients against central differences in f64, thresholds and their
//! neighbours, the orthogonality regulariser, the way back of strayed states; and
//! Adam's bits.

mod adam;
mod collisions;
mod gradients;
mod orthogonality;
mod returning;
mod stray;
mod sway;

use drape_dataset::patches::{Csr, Patches};
use drape_dataset::registry::GarmentKind;
use drape_dataset::sample::{Outfit, StatePair};
use drape_geometry::mesh::on_border;
use drape_train::losses::{Term, Vector};

/// A term computed in memory that another one has left.
fn term(compute: impl FnOnce(&mut Term)) -> Term {
    let mut term = Term {
        value: 7.0,
        gradient: vec![[f64::NAN; 3]; 99],
    };
    compute(&mut term);
    term
}

/// Triangles of a sheet of `side × side` vertices, starting at vertex `first`, facing +z.
fn sheet_faces(side: u32, first: u32) -> Vec<[u32; 3]> {
    let at = |i: u32, j: u32| first + i * side + j;
    let quads = (0..side - 1).flat_map(|i| (0..side - 1).map(move |j| (i, j)));
    quads
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// Its vertices: spacing `step`, height from `z(x, y)`.
fn sheet(side: u32, step: f64, z: impl Fn(f64, f64) -> f64) -> Vec<Vector> {
    let middle = f64::from(side - 1) / 2.0;
    let grid = (0..side).flat_map(|i| (0..side).map(move |j| (i, j)));
    grid.map(|(i, j)| {
        let (x, y) = (
            step * (f64::from(i) - middle),
            step * (f64::from(j) - middle),
        );
        [x, y, z(x, y)]
    })
    .collect()
}

/// Body rows from positions; the losses read positions only.
fn body(positions: &[Vector]) -> Vec<StatePair> {
    positions
        .iter()
        .map(|x| std::array::from_fn(|i| if i < 3 { x[i] as f32 } else { 0.0 }))
        .collect()
}

/// An outfit of two garments for the layer loss, without patches.
fn outfit(inner: usize, outer: usize, faces: Vec<[u32; 3]>) -> Outfit {
    Outfit {
        on_border: on_border(inner + outer, &faces),
        garment_offsets: vec![0, inner, inner + outer],
        kinds: vec![GarmentKind::Dress, GarmentKind::Jacket],
        faces,
        body_vertices: 0,
        body_faces: Vec::new(),
        body_on_border: Vec::new(),
        patches: Patches::default(),
        attributes: Vec::new(),
        patch_attributes: Csr::default(),
        supports: vec![None; 2],
        rest: vec![[0.0; 3]; inner + outer],
        patch_rest: Vec::new(),
    }
}

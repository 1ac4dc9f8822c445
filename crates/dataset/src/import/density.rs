//! Areas of a garment in space and in its UV map: their ratio tells how large
//! one UV unit is where a source does not say it.

use crate::sequence::Garment;

/// Garments whose UV density differs by more than this get a warning.
pub(super) const DENSITY_TOLERANCE: f64 = 0.05;

/// Area of a mesh; `faces` index into `positions`.
pub(super) fn area(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> f64 {
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

/// Area of a garment's UV map; `uv_faces` index into `uv`.
pub(super) fn uv_area(garment: &Garment) -> f64 {
    let flat: Vec<[f32; 3]> = garment.uv.iter().map(|&[u, v]| [u, v, 0.0]).collect();
    area(&flat, &garment.uv_faces)
}

//! Triangle meshes and the exact questions that are asked about them.
//!
//! Points are `[f32; 3]`, as sequences store them. What LayersNet computes in
//! f32 (normals, squared distances) is computed here in f32 with the same
//! order of operations; everything else (closest points, rigid fits, the
//! intersection test) works in f64 on the f32 points.
//!
//! | module | holds |
//! |---|---|
//! | [`vector`] | sums and products of three-vectors |
//! | [`mesh`] | edges, incidence, boundary, components, validation |
//! | [`normals`] | face and vertex normals |
//! | [`grid`] | nearest neighbours and balls among points |
//! | [`bvh`] | boxes that overlap a box |
//! | [`closest`] | closest points of point and triangle, of two segments |
//! | [`intersect`] | edges that pass through triangles, counted exactly |
//! | [`rigid`] | best-fit rotation and translation, quaternions |
//!
//! This crate never touches a file and knows no tensors. Its results do not
//! depend on the number of threads: it starts none.

pub mod bvh;
pub mod closest;
pub mod error;
pub mod grid;
pub mod intersect;
pub mod mesh;
pub mod normals;
pub mod rigid;
pub mod vector;

pub use error::GeometryError;
pub use grid::Grid;
pub use mesh::Incidence;
pub use rigid::Rigid;

//! What can be wrong with meshes and point sets, naming the place.

use thiserror::Error;

/// Defect of a mesh or of a pair of point sets.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GeometryError {
    /// A face refers to a vertex that does not exist.
    #[error("face {face} refers to vertex {vertex}, but the mesh has {vertex_count} vertices (0 to {})", .vertex_count.saturating_sub(1))]
    IndexOutOfRange {
        /// Face that holds the index.
        face: usize,
        /// The index.
        vertex: u32,
        /// Vertices in the mesh.
        vertex_count: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} is at ({}, {}, {}): expected finite coordinates", .position[0], .position[1], .position[2])]
    NotFinite {
        /// The vertex.
        vertex: usize,
        /// Its position.
        position: [f32; 3],
    },
    /// A face has no area: two corners coincide or all three lie on a line.
    #[error("face {face} (vertices {}, {}, {}) has no area: merge its coincident vertices or delete it", .corners[0], .corners[1], .corners[2])]
    ZeroArea {
        /// The face.
        face: usize,
        /// Its vertices.
        corners: [u32; 3],
    },
    /// More than two faces meet at an edge.
    #[error("edge {}-{} belongs to {faces} faces: a surface has at most 2 at an edge", .edge[0], .edge[1])]
    NonManifoldEdge {
        /// The edge's vertices, ascending.
        edge: [u32; 2],
        /// Faces at the edge.
        faces: usize,
    },
    /// Two point sets that should correspond have different sizes.
    #[error(
        "expected as many target points as source points ({source_count}), found {target_count}"
    )]
    CountMismatch {
        /// Points in the source set.
        source_count: usize,
        /// Points in the target set.
        target_count: usize,
    },
    /// An operation needs at least one point.
    #[error("a rigid fit needs at least one pair of points, found none")]
    NoPoints,
}

//! Vertices that leave their tubes: strays.
//!
//! A search finds every pair that can meet while vertices stay in their tubes,
//! and a pair sleeps for as long as tubes keep it apart. Both promises are
//! void for a vertex that strays, be it by its own dynamics or because a repair
//! pushed it. Its features are therefore looked up again for the substep at
//! hand, along the way they really go, and the pairs found are certified too.

use super::pair::{Features, Pair};
use super::search::Surfaces;
use crate::engine::fabric::Fabric;
use crate::engine::state::State;

/// Which kinds of pairs the scene asks for, and which vertices are exempt.
pub(crate) struct Wanted<'a> {
    /// Pairs with the body, except of these cloth vertices: they are inside it already.
    pub body: Option<&'a [bool]>,
    /// Pairs of different garments.
    pub layers: bool,
    /// Pairs within a garment.
    pub own: bool,
}

/// Pairs that strays can form in this substep.
pub(crate) fn pairs_of(
    strays: &[u32],
    wanted: &Wanted,
    surfaces: &mut Surfaces,
    fabric: &Fabric,
    state: &State,
    out: &mut Vec<Pair>,
) {
    surfaces.refit_substep(fabric, state);
    let mut faces: Vec<u32> = Vec::new();
    let mut edges: Vec<u32> = Vec::new();
    for &v in strays {
        faces.extend(&fabric.faces_of[v as usize]);
        edges.extend(&fabric.edges_of[v as usize]);
    }
    for features in [&mut faces, &mut edges] {
        features.sort_unstable();
        features.dedup();
    }
    let garment = |v: u32| fabric.garment_of[v as usize];
    let cloth = state.cloth as u32;
    let mut take = |vertices: [u32; 4], features| {
        let [a, b, c, d] = vertices;
        let (from, to) = match features {
            Features::VertexFace => (a, b),
            Features::EdgeEdge => (a, c),
        };
        let shared = match features {
            Features::VertexFace => a == b || a == c || a == d,
            Features::EdgeEdge => a == c || a == d || b == c || b == d,
        };
        let asked = if from < cloth && to < cloth {
            if garment(from) == garment(to) {
                wanted.own
            } else {
                wanted.layers
            }
        } else {
            let inside =
                |v: &u32| *v < cloth && wanted.body.is_some_and(|inside| inside[*v as usize]);
            wanted.body.is_some() && !vertices.iter().any(inside)
        };
        if asked && !shared {
            out.extend(Pair::found(vertices, features, state));
        }
    };
    for &v in strays {
        surfaces.faces_met_by(v, fabric, |face| {
            take([v, face[0], face[1], face[2]], Features::VertexFace)
        });
    }
    for &f in &faces {
        let face = fabric.faces[f as usize];
        surfaces.vertices_meeting(face, |v| {
            take([v, face[0], face[1], face[2]], Features::VertexFace)
        });
    }
    for &e in &edges {
        let [a, b] = fabric.edges[e as usize];
        surfaces.edges_meeting([a, b], fabric, |[c, d]| {
            take([a, b, c, d], Features::EdgeEdge)
        });
    }
}

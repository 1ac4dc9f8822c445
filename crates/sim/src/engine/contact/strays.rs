//! Vertices that leave their tubes: strays.
//!
//! A search finds every pair that can meet while vertices stay in their tubes,
//! and a pair sleeps for as long as tubes keep it apart. Both promises are
//! void for a vertex that strays, be it by its own dynamics or because a repair
//! pushed it. Its features are therefore looked up again for the substep at
//! hand, along the way they really go, and the pairs found are certified too.
//!
//! The trees of the last search serve for that: whoever did not stray is within
//! the slack of its tube, which they hold, and the boxes of features that
//! strayed are grown by where these go. To compare with tubes, which are laid
//! for the whole stretch between searches, a stray's way is given the stray's
//! own tube as motion: at the time of the present substep it is then where it
//! really is, and features that move along with it cost nothing.

use super::pair::{Features, Pair};
use super::search::{Surface, Surfaces};
use super::tree::MovingBox;
use super::tubes::Tubes;
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

/// Pairs that strays, ascending, can form in this substep.
pub(crate) fn pairs_of(
    strays: &[u32],
    wanted: &Wanted,
    (surfaces, tubes): (&mut Surfaces, &Tubes),
    fabric: &Fabric,
    state: &State,
    out: &mut Vec<Pair>,
) {
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
    let origin = surfaces.origin;
    let way = |v: u32| tubes.way(state, v as usize, origin);
    let way_of = |feature: &[u32]| {
        feature
            .iter()
            .fold(MovingBox::EMPTY, |union, &v| union.union(&way(v)))
    };
    let garment = |v: u32| fabric.garment_of[v as usize] as usize;
    for &v in strays {
        let (g, room) = (garment(v), way(v));
        let first = fabric.garments[g].vertices.start;
        surfaces.garments[g]
            .vertices
            .grow(v as usize - first, &room);
    }
    for &f in &faces {
        let face = fabric.faces[f as usize];
        let g = garment(face[0]);
        let first = fabric.garments[g].faces.start;
        surfaces.garments[g]
            .faces
            .grow(f as usize - first, &way_of(&face));
    }
    for &e in &edges {
        let edge = fabric.edges[e as usize];
        let g = garment(edge[0]);
        let first = fabric.garments[g].edges.start;
        surfaces.garments[g]
            .edges
            .grow(e as usize - first, &way_of(&edge));
    }

    let surfaces = &*surfaces;
    let strayed = |v: u32| strays.binary_search(&v).is_ok();
    let inside =
        |v: u32| (v as usize) < state.cloth && wanted.body.is_some_and(|inside| inside[v as usize]);
    // Both trees hold where features may be; here is where they are.
    let near = |a: &[u32], b: &[u32]| {
        let real = |feature: &[u32]| {
            feature.iter().fold(MovingBox::EMPTY, |union, &v| {
                let (x, p) = (state.x[v as usize] - origin, state.p[v as usize] - origin);
                union.union(&MovingBox::of(x, p, 0.0))
            })
        };
        real(a).can_meet(&real(b), 0.0)
    };
    let partners = |g: usize| -> Vec<(&Surface, bool)> {
        let cloth = surfaces.garments.iter().enumerate();
        let asked = cloth.filter(|(other, _)| {
            if *other == g {
                wanted.own
            } else {
                wanted.layers
            }
        });
        let mut partners: Vec<_> = asked.map(|(_, surface)| (surface, false)).collect();
        partners.extend(wanted.body.map(|_| (&surfaces.body, true)));
        partners
    };
    let partners: Vec<_> = (0..surfaces.garments.len()).map(partners).collect();
    let reach = tubes.slack as f32;
    for &v in strays {
        let query = way(v);
        for (surface, is_body) in &partners[garment(v)] {
            if *is_body && inside(v) {
                continue;
            }
            surface.faces.meeting(&query, reach, |[a, b, c]| {
                if v != a && v != b && v != c && near(&[v], &[a, b, c]) {
                    out.extend(Pair::found([v, a, b, c], Features::VertexFace, state));
                }
            });
        }
    }
    for &f in &faces {
        let face = fabric.faces[f as usize];
        let [a, b, c] = face;
        let query = way_of(&face);
        for (surface, is_body) in &partners[garment(a)] {
            if *is_body && face.iter().any(|&v| inside(v)) {
                continue;
            }
            surface.vertices.meeting(&query, reach, |[v]| {
                // Strays have looked for faces themselves.
                if v != a && v != b && v != c && !strayed(v) && near(&[v], &face) {
                    out.extend(Pair::found([v, a, b, c], Features::VertexFace, state));
                }
            });
        }
    }
    for &e in &edges {
        let edge = fabric.edges[e as usize];
        let [a, b] = edge;
        let query = way_of(&edge);
        for (surface, is_body) in &partners[garment(a)] {
            if *is_body && (inside(a) || inside(b)) {
                continue;
            }
            surface.edges.meeting(&query, reach, |[c, d]| {
                let apart = a != c && a != d && b != c && b != d;
                // Of two edges that both look for the other, the first one finds it.
                let other = !(strayed(c) || strayed(d)) || edge < [c, d];
                if apart && other && near(&edge, &[c, d]) {
                    out.extend(Pair::found([a, b, c, d], Features::EdgeEdge, state));
                }
            });
        }
    }
}

//! Contact of a garment with itself: pairs stay on the side where they are.
//!
//! Neighbours on the mesh are close to each other at rest already: no pair
//! asks for more than 0.7 of its distance at rest.

use super::contact::list::PairList;
use super::contact::pair::{Features, separation};
use super::contact::search::Search;

/// Share of the distance at rest that a pair may ask for.
const REST_SHARE: f64 = 0.7;

/// Pairs within garments.
#[derive(Clone, Debug)]
pub(super) struct SelfContact {
    pub list: PairList,
    pub thickness: f64,
}

impl SelfContact {
    pub fn new(thickness: f64) -> Self {
        Self {
            list: PairList::default(),
            thickness,
        }
    }

    /// Lists the pairs that can matter before the next search.
    pub fn search(&mut self, within: &Search) {
        self.list.begin(within.now, within.substeps);
        let (reach, list) = (within.reach(self.thickness), &mut self.list);
        let thickness = self.thickness;
        let mut take = |vertices, features| {
            let found = within.measure(vertices, features);
            let fabric = within.fabric;
            let friction = fabric.cloth_of(vertices[0]).friction;
            let pair = |thickness| within.pair(&found, thickness, friction);
            if pair(thickness).is_none() {
                return;
            }
            let rest = separation(features, vertices, &fabric.rest).d.length();
            if let Some(pair) = pair(thickness.min(REST_SHARE * rest)) {
                list.push(pair);
            }
        };
        let [vertex, edge] = [Features::VertexFace, Features::EdgeEdge];
        for garment in &within.surfaces.garments {
            let mut sieve = within.sieve(vertex, thickness);
            let mut found = |v| take(v, vertex);
            garment.own_vertices_and_faces(reach, |v| sieve.put(v, &mut found));
            sieve.finish(&mut found);
            let mut sieve = within.sieve(edge, thickness);
            let mut found = |v| take(v, edge);
            garment.own_edges(reach, |v| sieve.put(v, &mut found));
            sieve.finish(&mut found);
        }
    }
}

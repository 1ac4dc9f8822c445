//! Contact of a garment with itself: pairs stay on the side where they are.
//!
//! Neighbours on the mesh are close to each other at rest already: no pair
//! asks for more than 0.4 of its distance at rest: cloth that is folded
//! flat comes within 2/π of it, and crumples more than that.

use super::contact::list::PairList;
use super::contact::pair::{Features, separation};
use super::contact::search::Search;

/// Share of the distance at rest that a pair may ask for.
const REST_SHARE: f64 = 0.4;
/// Share of the mean edge that pairs may ask for: fine meshes follow folds closely, and what lies
/// about an edge off in the same cloth is no contact.
const EDGE_SHARE: f64 = 0.3;

/// Pairs within garments.
#[derive(Clone, Debug)]
pub(super) struct SelfContact {
    pub list: PairList,
    pub thickness: f64,
    /// The largest thickness that this mesh is fit for, m.
    most: f64,
}

impl SelfContact {
    /// For cloth with edges of this mean length, m.
    pub fn new(thickness: f64, edge_m: f64) -> Self {
        let most = EDGE_SHARE * edge_m;
        Self {
            list: PairList::default(),
            thickness: thickness.min(most),
            most,
        }
    }

    /// Keeps this distance, as far as the mesh is fit for it.
    pub fn keep(&mut self, thickness: f64) {
        self.thickness = thickness.min(self.most);
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
            let Some(full) = pair(thickness) else {
                return;
            };
            let rest = separation(features, vertices, &fabric.rest).d.length();
            let narrow = REST_SHARE * rest;
            let fits = thickness <= narrow;
            if let Some(pair) = if fits { Some(full) } else { pair(narrow) } {
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

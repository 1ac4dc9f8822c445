//! Contact of a garment with itself: pairs stay on the side where they are.
//!
//! Neighbours on the mesh are close to each other at rest already: no pair
//! asks for more than 0.7 of its distance at rest.

use super::contact::list::PairList;
use super::contact::pair::separation;
use super::contact::search::Candidate;
use super::fabric::Fabric;

/// Share of the distance at rest that a pair may ask for.
const REST_SHARE: f64 = 0.7;

/// Pairs within garments.
#[derive(Clone, Debug)]
pub(super) struct SelfContact {
    pub list: PairList,
    thickness: f64,
}

impl SelfContact {
    pub fn new(thickness: f64) -> Self {
        Self {
            list: PairList::default(),
            thickness,
        }
    }

    /// Starts over; how far to look.
    pub fn begin_search(&mut self) -> f64 {
        self.list.pairs.clear();
        self.thickness
    }

    /// Takes a candidate of one garment up.
    pub fn add(&mut self, found: &Candidate, fabric: &Fabric, substeps: f64, now: u32) {
        let rest = separation(found.features, found.vertices, &fabric.rest)
            .d
            .length();
        let thickness = self.thickness.min(REST_SHARE * rest);
        if found.distance > thickness + found.rate * substeps {
            return;
        }
        let friction = fabric.cloth_of(found.vertices[0]).friction;
        self.list
            .pairs
            .push(found.pair(thickness, friction, false, now));
    }
}

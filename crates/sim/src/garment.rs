//! Parametric garments on any body: even triangle meshes with straight hems,
//! welded seams and flat panels, in outfits whose layers nest.

mod anatomy;
mod cuts;
mod field;
mod flatten;
mod outfit;
mod parameters;
mod pattern;
mod remesh;
mod sections;
mod surface;

pub use outfit::{EDGES_M, METRES_PER_UV, Outfit, OutfitRequest, fitting_pose};
pub use parameters::GarmentParameters;

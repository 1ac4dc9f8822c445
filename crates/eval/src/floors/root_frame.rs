//! The moving frame of the body's root: `p = Rᵀ (x − t)`, `x = R p + t`, with
//! `R` the root's rotation and `t` its translation at the same time.

use drape_dataset::sequence::Root;
use drape_geometry::rigid::{Rigid, matrix_from_quaternion};

use crate::task::Positions;

/// World positions of one frame, `[garment][vertex, 3]`, in the frame of `root`.
pub fn to_root(root: &Root, garments: &[Positions]) -> Vec<Vec<[f64; 3]>> {
    let motion = motion(root).inverse();
    let local = |positions: &Positions| {
        positions
            .iter()
            .map(|x| motion.apply(x.map(f64::from)))
            .collect()
    };
    garments.iter().map(local).collect()
}

/// Positions in the frame of `root`, `[garment][vertex, 3]`, in the world.
pub fn to_world(root: &Root, garments: &[Vec<[f64; 3]>]) -> Vec<Positions> {
    let motion = motion(root);
    let world = |positions: &Vec<[f64; 3]>| {
        positions
            .iter()
            .map(|p| motion.apply(*p).map(|x| x as f32))
            .collect()
    };
    garments.iter().map(world).collect()
}

/// From the root's frame to the world. A zero quaternion (a file without rotations) does not turn.
fn motion(root: &Root) -> Rigid {
    Rigid {
        rotation: matrix_from_quaternion(root.rotation.map(f64::from)),
        translation: root.translation.map(f64::from),
    }
}

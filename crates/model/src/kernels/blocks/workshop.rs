//! Buffers that passes use again, and where they are kept.

use std::sync::{Mutex, OnceLock};

use super::super::attention::{Gradient, Projected, WIDTH};
use super::super::{Real, fit, shelved};
use super::Blocks;
use super::plan::Plan;
use super::tile::{Tile, TileGradient};
use super::weights::{Arranged, Transposes};

/// What a block keeps.
#[derive(Default)]
pub(super) struct Block<T> {
    /// r, q, s one below the other, as the attention reads them, channels in its order.
    pub(super) tokens: Vec<T>,
    /// The attention's output.
    pub(super) attended: Vec<T>,
    pub(super) tiles: Vec<Tile<T>>,
}

/// Buffers of a pass. What the forward pass leaves in `blocks` is what the backward pass needs.
/// Workshops are used again, so that passes over outfits of one size allocate nothing.
#[derive(Default)]
pub(crate) struct Workshop<T: 'static> {
    pub(super) plan: Plan,
    pub(super) blocks: Vec<Block<T>>,
    pub(super) projected: Projected<T>,
    pub(super) gradients: Vec<TileGradient<T>>,
    pub(super) attention: Gradient<T>,
    pub(super) d_attended: Vec<T>,
    /// Room for lists of tiles' parts.
    pub(super) parts: Vec<[&'static mut [T]; 3]>,
}

impl<T: Real> Block<T> {
    pub(super) fn fit(&mut self, plan: &Plan) {
        fit(&mut self.tokens, (2 * plan.patches + plan.rows) * WIDTH);
        fit(&mut self.attended, plan.patches * WIDTH);
        self.tiles.resize_with(plan.tiles.len(), Tile::default);
    }
}

/// Scalars with places for what is kept.
pub(crate) trait Keep: Real {
    /// A call's workshop between its forward and its backward pass.
    fn place(blocks: &Blocks) -> &Mutex<Option<Workshop<Self>>>;
    /// The arranged weights of this type.
    fn transposes(transposes: &Transposes) -> &OnceLock<Arranged<Self>>;
}

macro_rules! keep {
    ($T:ty, $field:ident) => {
        impl Keep for $T {
            fn place(blocks: &Blocks) -> &Mutex<Option<Workshop<Self>>> {
                &blocks.$field
            }

            fn transposes(transposes: &Transposes) -> &OnceLock<Arranged<Self>> {
                &transposes.$field
            }
        }

        shelved!(Workshop<$T>);
    };
}

keep!(f32, f32s);
keep!(f64, f64s);

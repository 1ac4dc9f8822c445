//! Buffers that passes use again, and where they are kept.

use std::sync::{Mutex, OnceLock};

use super::super::Real;
use super::super::attention::{Gradient, WIDTH};
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
/// Workshops are used again, so that passes over outfits of one size allocate nothing but results.
#[derive(Default)]
pub(super) struct Workshop<T> {
    pub(super) blocks: Vec<Block<T>>,
    pub(super) gradients: Vec<TileGradient<T>>,
    pub(super) attention: Gradient<T>,
    pub(super) d_attended: Vec<T>,
}

impl<T: Keep> Workshop<T> {
    /// One that nobody uses, or a new one.
    pub(super) fn take() -> Self {
        let shelf = T::shelf().lock();
        let free = shelf.expect("nobody panics with it").pop();
        free.unwrap_or_default()
    }

    pub(super) fn put_back(self) {
        let shelf = T::shelf().lock();
        shelf.expect("nobody panics with it").push(self);
    }
}

/// Fits a buffer's length; what is in it is to be overwritten.
pub(super) fn fit<T: Real>(buffer: &mut Vec<T>, len: usize) -> &mut [T] {
    buffer.resize(len, T::zero());
    buffer
}

impl<T: Real> Block<T> {
    pub(super) fn fit(&mut self, plan: &Plan) {
        fit(&mut self.tokens, (2 * plan.patches + plan.rows) * WIDTH);
        fit(&mut self.attended, plan.patches * WIDTH);
        self.tiles.resize_with(plan.tiles.len(), Tile::default);
    }
}

/// Scalars with places for what is kept.
pub(super) trait Keep: Real {
    /// A call's workshop between its forward and its backward pass.
    fn place(blocks: &Blocks) -> &Mutex<Option<Workshop<Self>>>;
    /// Workshops that nobody uses at the moment.
    fn shelf() -> &'static Mutex<Vec<Workshop<Self>>>;
    /// The arranged weights of this type.
    fn transposes(transposes: &Transposes) -> &OnceLock<Arranged<Self>>;
}

macro_rules! keep {
    ($T:ty, $field:ident) => {
        impl Keep for $T {
            fn place(blocks: &Blocks) -> &Mutex<Option<Workshop<Self>>> {
                &blocks.$field
            }

            fn shelf() -> &'static Mutex<Vec<Workshop<Self>>> {
                static SHELF: Mutex<Vec<Workshop<$T>>> = Mutex::new(Vec::new());
                &SHELF
            }

            fn transposes(transposes: &Transposes) -> &OnceLock<Arranged<Self>> {
                &transposes.$field
            }
        }
    };
}

keep!(f32, f32s);
keep!(f64, f64s);

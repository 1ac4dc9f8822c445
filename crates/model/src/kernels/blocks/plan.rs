//! Rows of the tokens, cut into tiles.

use std::ops::Range;

use super::super::attention::{Edges, WIDTH};

/// Rows of a tile, at most.
pub(super) const TILE: usize = 96;

/// Rows of the tokens, cut into tiles: patches first, no tile holds both kinds.
#[derive(Default)]
pub(super) struct Plan {
    pub(super) patches: usize,
    pub(super) rows: usize,
    pub(super) tiles: Vec<Range<usize>>,
}

impl Plan {
    /// Lays the plan of a frame's edges.
    pub(super) fn lay(&mut self, edges: &Edges) {
        self.patches = edges.mesh.rows();
        self.rows = edges.senders + edges.rotations.len();
        self.tiles.clear();
        for part in [0..self.patches, self.patches..self.rows] {
            let mut start = part.start;
            while start < part.end {
                let end = (start + TILE).min(part.end);
                self.tiles.push(start..end);
                start = end;
            }
        }
    }

    /// Tiles of patches.
    pub(super) fn receiving(&self) -> usize {
        self.patches.div_ceil(TILE)
    }

    /// Cuts `values` `[rows, 128]` (or patches only, or nothing) at the tiles; after its last part
    /// come empty ones.
    pub(super) fn cut<'a, T>(&self, mut values: &'a mut [T]) -> impl Iterator<Item = &'a mut [T]> {
        self.tiles.iter().map(move |tile| {
            let len = (tile.len() * WIDTH).min(values.len());
            values.split_off_mut(..len).expect("as many as are left")
        })
    }

    /// Cuts three arrays side by side.
    pub(super) fn cut_three<'a, T>(
        &self,
        [a, b, c]: [&'a mut [T]; 3],
    ) -> impl Iterator<Item = [&'a mut [T]; 3]> {
        let all = self.cut(a).zip(self.cut(b)).zip(self.cut(c));
        all.map(|((a, b), c)| [a, b, c])
    }

    /// r, q and s out of the attention's tokens.
    pub(super) fn split_tokens<'a, T>(&self, tokens: &'a mut [T]) -> [&'a mut [T]; 3] {
        let (r, rest) = tokens.split_at_mut(self.patches * WIDTH);
        let (q, s) = rest.split_at_mut(self.patches * WIDTH);
        [r, q, s]
    }

    /// A tile's rows of r, q and s.
    pub(super) fn rows_of<'a, T>(&self, tokens: &'a [T], tile: usize) -> [&'a [T]; 3] {
        let rows = &self.tiles[tile];
        let at = |first: usize| &tokens[(first + rows.start) * WIDTH..(first + rows.end) * WIDTH];
        if tile < self.receiving() {
            [at(0), at(self.patches), at(2 * self.patches)]
        } else {
            [&[], &[], at(2 * self.patches)]
        }
    }
}

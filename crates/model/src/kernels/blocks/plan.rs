//! Rows of the tokens, cut into tiles.

use std::ops::Range;

use super::super::attention::{Edges, WIDTH};

/// Rows of a tile, at most.
pub(super) const TILE: usize = 96;

/// Rows of the tokens, cut into tiles: patches first, no tile holds both kinds.
pub(super) struct Plan {
    pub(super) patches: usize,
    pub(super) rows: usize,
    pub(super) tiles: Vec<Range<usize>>,
}

impl Plan {
    pub(super) fn new(edges: &Edges) -> Self {
        let patches = edges.mesh.rows();
        let rows = edges.senders + edges.rotations.len();
        let mut tiles = Vec::new();
        for part in [0..patches, patches..rows] {
            let mut start = part.start;
            while start < part.end {
                let end = (start + TILE).min(part.end);
                tiles.push(start..end);
                start = end;
            }
        }
        Self {
            patches,
            rows,
            tiles,
        }
    }

    /// Tiles of patches.
    pub(super) fn receiving(&self) -> usize {
        self.patches.div_ceil(TILE)
    }

    /// Cuts `values` `[rows, 128]` (or patches only) at the tiles.
    pub(super) fn cut<'a, T>(&self, mut values: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut parts = Vec::new();
        for tile in &self.tiles {
            if values.is_empty() {
                break;
            }
            let (part, rest) = values.split_at_mut(tile.len() * WIDTH);
            parts.push(part);
            values = rest;
        }
        parts
    }

    /// r, q and s of each tile out of the attention's tokens; r and q are empty where nothing receives.
    pub(super) fn cut_tokens<'a, T>(&self, tokens: &'a mut [T]) -> Vec<[&'a mut [T]; 3]> {
        let (r, rest) = tokens.split_at_mut(self.patches * WIDTH);
        let (q, s) = rest.split_at_mut(self.patches * WIDTH);
        let (mut r, mut q) = (self.cut(r).into_iter(), self.cut(q).into_iter());
        self.cut(s)
            .into_iter()
            .map(|s| {
                [
                    r.next().unwrap_or_default(),
                    q.next().unwrap_or_default(),
                    s,
                ]
            })
            .collect()
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

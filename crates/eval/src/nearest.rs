//! Nearest vertex in f64, exact, ties to the lower index: a balanced k-d tree
//! stored as a permutation (the median of a range is its node).
//!
//! Predictions may lie anywhere, also far outside the body, so a tree and not a
//! grid. Points must be finite.

/// Vertices to search among.
pub struct NearestVertex {
    /// `(position, vertex)` in tree order.
    nodes: Vec<([f64; 3], u32)>,
    /// Split axis of each node.
    axes: Vec<u8>,
}

/// Ranges this small are scanned.
const LEAF: usize = 8;

impl NearestVertex {
    /// Builds the tree over `points`, `[vertex, 3]`.
    pub fn new(points: &[[f64; 3]]) -> Self {
        let mut nodes: Vec<_> = points.iter().copied().zip(0..).collect();
        let mut axes = vec![0; nodes.len()];
        build(&mut nodes, &mut axes);
        Self { nodes, axes }
    }

    /// Nearest vertex and its position; `None` when there are no vertices.
    pub fn nearest(&self, query: [f64; 3]) -> Option<(usize, [f64; 3])> {
        let mut best = Best {
            squared: f64::INFINITY,
            vertex: u32::MAX,
            at: [0.0; 3],
        };
        self.visit(query, 0, self.nodes.len(), &mut best);
        (best.vertex != u32::MAX).then_some((best.vertex as usize, best.at))
    }

    /// The `count` nearest vertices as `(squared distance, vertex)`, nearest first.
    pub fn nearest_many(&self, query: [f64; 3], count: usize) -> Vec<(f64, usize)> {
        let mut all: Vec<(f64, usize)> = self
            .nodes
            .iter()
            .map(|(at, vertex)| (squared(query, *at), *vertex as usize))
            .collect();
        let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if count < all.len() {
            all.select_nth_unstable_by(count, order);
            all.truncate(count);
        }
        all.sort_unstable_by(order);
        all
    }

    fn visit(&self, query: [f64; 3], from: usize, to: usize, best: &mut Best) {
        if to - from <= LEAF {
            for node in &self.nodes[from..to] {
                best.offer(query, node);
            }
            return;
        }
        let middle = from + (to - from) / 2;
        let axis = usize::from(self.axes[middle]);
        let offset = query[axis] - self.nodes[middle].0[axis];
        best.offer(query, &self.nodes[middle]);
        let (near, far) = if offset < 0.0 {
            ((from, middle), (middle + 1, to))
        } else {
            ((middle + 1, to), (from, middle))
        };
        self.visit(query, near.0, near.1, best);
        // `<=`: an equally distant vertex with a lower index may be on the far side.
        if offset * offset <= best.squared {
            self.visit(query, far.0, far.1, best);
        }
    }
}

struct Best {
    squared: f64,
    vertex: u32,
    at: [f64; 3],
}

impl Best {
    fn offer(&mut self, query: [f64; 3], (at, vertex): &([f64; 3], u32)) {
        let squared = squared(query, *at);
        if squared < self.squared || (squared == self.squared && *vertex < self.vertex) {
            *self = Best {
                squared,
                vertex: *vertex,
                at: *at,
            };
        }
    }
}

fn build(nodes: &mut [([f64; 3], u32)], axes: &mut [u8]) {
    if nodes.len() <= LEAF {
        return;
    }
    let extent = |axis: usize| {
        let range = nodes.iter().fold(
            (f64::INFINITY, f64::NEG_INFINITY),
            |(low, high), (at, _)| (low.min(at[axis]), high.max(at[axis])),
        );
        range.1 - range.0
    };
    let axis = (0..3)
        .max_by(|a, b| extent(*a).total_cmp(&extent(*b)))
        .unwrap_or(0);
    let middle = nodes.len() / 2;
    nodes.select_nth_unstable_by(middle, |a, b| {
        a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
    });
    axes[middle] = axis as u8;
    let (low, high) = nodes.split_at_mut(middle);
    let (low_axes, high_axes) = axes.split_at_mut(middle);
    build(low, low_axes);
    build(&mut high[1..], &mut high_axes[1..]);
}

fn squared(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on an integer lattice: every query has many exact ties.
    fn lattice(side: i32) -> Vec<[f64; 3]> {
        let range = move || 0..side;
        range()
            .flat_map(move |x| {
                range().flat_map(move |y| range().map(move |z| [x, z, y].map(f64::from)))
            })
            .chain([[1.0, 1.0, 1.0]]) // a coincident vertex
            .collect()
    }

    #[test]
    fn the_tree_agrees_with_a_scan_also_on_ties_and_far_away() {
        let points = lattice(6);
        let tree = NearestVertex::new(&points);
        for step in 0..4000 {
            let at = |k: i32| f64::from((step * k) % 29) * 0.25 - 1.0;
            let mut query = [at(1), at(7), at(13)];
            if step % 10 == 0 {
                query = query.map(|x| x * 1e4);
            }
            let scan = points
                .iter()
                .enumerate()
                .min_by(|a, b| squared(query, *a.1).total_cmp(&squared(query, *b.1)))
                .map(|(vertex, at)| (vertex, *at));
            assert_eq!(tree.nearest(query), scan, "query {query:?}");
        }
    }

    #[test]
    fn nothing_is_nearest_among_nothing() {
        assert_eq!(NearestVertex::new(&[]).nearest([0.0; 3]), None);
    }
}

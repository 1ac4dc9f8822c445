//! Points sorted into cubic cells, for nearest neighbours and balls.
//!
//! Squared distances are f32, `(dx·dx + dy·dy) + dz·dz`, as in LayersNet's
//! point operations; a point belongs to a ball when d² = 0 or d² < r². Ties go
//! to the lower index. Answers equal those of scanning all points in order.
//!
//! Cells fill the points' bounding box. Where that would take far more cells
//! than points (an outlier, a tiny cell), cells are enlarged: answers stay the
//! same, queries get slower, at worst one scan of all points.
//! Points with a NaN or an infinity are never found, and a query with one
//! finds nothing.

use crate::vector::distance2;

/// Cells allowed per point, and at least [`MIN_CELLS`].
const CELLS_PER_POINT: usize = 8;
const MIN_CELLS: usize = 64;
/// Relative slack for bounds computed in f64 about distances rounded to f32
/// (a handful of roundings of 6e-8 each).
const SLACK: f64 = 1e-5;

/// Points in cells; by default none.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    low: [f64; 3],
    cell: f64,
    dims: [usize; 3],
    /// First slot of each cell, x fastest; one more entry than cells.
    starts: Vec<u32>,
    /// Points by cell, ascending by index within one.
    points: Vec<[f32; 3]>,
    /// Index of each slot's point.
    indices: Vec<u32>,
    /// Cell of each point while building.
    cells: Vec<u32>,
}

impl Grid {
    /// Sorts points into cells of edge length `cell`; about the query radius is good.
    ///
    /// # Panics
    /// If `cell` is not positive and finite.
    pub fn build(points: &[[f32; 3]], cell: f32) -> Self {
        let mut grid = Self::default();
        grid.rebuild(points, cell);
        grid
    }

    /// [`Grid::build`] in the same memory.
    ///
    /// # Panics
    /// If `cell` is not positive and finite.
    pub fn rebuild(&mut self, points: &[[f32; 3]], cell: f32) {
        assert!(
            cell > 0.0 && cell.is_finite(),
            "cell size {cell}: expected a positive length"
        );
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        let mut count = 0;
        for point in points.iter().filter(|p| is_finite(p)) {
            count += 1;
            for axis in 0..3 {
                low[axis] = low[axis].min(f64::from(point[axis]));
                high[axis] = high[axis].max(f64::from(point[axis]));
            }
        }
        if count == 0 {
            (low, high) = ([0.0; 3], [0.0; 3]);
        }
        self.low = low;
        self.cell = f64::from(cell);
        let limit = (count * CELLS_PER_POINT).max(MIN_CELLS) as f64;
        loop {
            let dims: [f64; 3] =
                std::array::from_fn(|i| ((high[i] - low[i]) / self.cell).floor() + 1.0);
            if dims[0] * dims[1] * dims[2] <= limit {
                self.dims = dims.map(|d| d as usize);
                break;
            }
            self.cell *= 1.25;
        }

        // Counting sort; scanning points in order keeps indices ascending in a cell.
        let cell_count = self.dims.iter().product::<usize>();
        self.starts.clear();
        self.starts.resize(cell_count + 1, 0);
        let mut cells = std::mem::take(&mut self.cells);
        cells.clear();
        cells.extend(points.iter().map(|point| {
            if is_finite(point) {
                self.cell_index(self.cell_of(*point)) as u32
            } else {
                u32::MAX
            }
        }));
        for &cell in cells.iter().filter(|&&c| c != u32::MAX) {
            self.starts[cell as usize + 1] += 1;
        }
        for cell in 0..cell_count {
            self.starts[cell + 1] += self.starts[cell];
        }
        self.points.clear();
        self.points.resize(count, [0.0; 3]);
        self.indices.clear();
        self.indices.resize(count, 0);
        for (index, &cell) in cells.iter().enumerate().filter(|(_, c)| **c != u32::MAX) {
            let slot = self.starts[cell as usize] as usize;
            self.points[slot] = points[index];
            self.indices[slot] = index as u32;
            self.starts[cell as usize] += 1;
        }
        // Filling moved each start to its cell's end: shift back by one cell.
        self.starts.copy_within(0..cell_count, 1);
        self.starts[0] = 0;
        self.cells = cells;
    }

    /// Number of points that can be found.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether no point can be found.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The nearest point's index and squared distance; lowest index on ties.
    /// `None` when there are no points or `p` is not finite. The squared
    /// distance is infinite when it exceeds f32.
    pub fn nearest(&self, p: [f32; 3]) -> Option<(u32, f32)> {
        if self.is_empty() || !is_finite(&p) {
            return None;
        }
        let centre = self.cell_of(p);
        let mut best = (u32::MAX, f32::INFINITY);
        let mut visited = 0;
        let widest = self.dims.iter().max().copied().unwrap_or(1);
        for ring in 0..widest {
            self.scan_ring(p, centre, ring, &mut best, &mut visited);
            let bound = self.distance_beyond(p, centre, ring);
            if f64::from(best.1) < bound * bound * (1.0 - SLACK) {
                return Some(best);
            }
            // Sparse cells or a far query: one scan of all points is cheaper from here.
            if visited > self.len() {
                self.scan_slots(p, 0..self.len(), &mut best);
                break;
            }
        }
        Some(best)
    }

    /// The nearest of the points that [`Grid::within`] finds and its squared distance; lowest index
    /// on ties.
    pub fn nearest_within(&self, p: [f32; 3], radius: f32) -> Option<(u32, f32)> {
        let mut best = None;
        self.visit_within(p, radius, |index, d2| {
            best = match best {
                Some((i, d)) if d < d2 || (d == d2 && i < index) => Some((i, d)),
                _ => Some((index, d2)),
            };
        });
        best
    }

    /// Points with d² = 0 or d² < `radius`², sorted by index, with their squared
    /// distances. `out` is cleared first. A negative or NaN radius counts as 0.
    pub fn within(&self, p: [f32; 3], radius: f32, out: &mut Vec<(u32, f32)>) {
        self.collect_within(p, radius, out);
        out.sort_unstable_by_key(|hit| hit.0);
    }

    /// The `k` nearest points of those that [`Grid::within`] finds, sorted by
    /// distance, then index. `out` is cleared first.
    pub fn k_nearest(&self, p: [f32; 3], k: usize, radius: f32, out: &mut Vec<(u32, f32)>) {
        self.collect_within(p, radius, out);
        let by_distance = |a: &(u32, f32), b: &(u32, f32)| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0));
        if k == 0 {
            out.clear();
        } else if out.len() > k {
            out.select_nth_unstable_by(k - 1, by_distance);
            out.truncate(k);
        }
        out.sort_unstable_by(by_distance);
    }

    fn collect_within(&self, p: [f32; 3], radius: f32, out: &mut Vec<(u32, f32)>) {
        out.clear();
        self.visit_within(p, radius, |index, d2| out.push((index, d2)));
    }

    /// Calls `found` with index and squared distance of each point of [`Grid::within`].
    fn visit_within(&self, p: [f32; 3], radius: f32, mut found: impl FnMut(u32, f32)) {
        if self.is_empty() || !is_finite(&p) {
            return;
        }
        let radius = radius.max(0.0);
        let radius2 = radius * radius;
        // The box must also hold points so near that their d² underflows to 0.
        let reach = f64::from(radius) * (1.0 + SLACK) + 1e-20;
        let corner = |sign: f64| -> [usize; 3] {
            std::array::from_fn(|axis| self.cell_along(axis, f64::from(p[axis]) + sign * reach))
        };
        let (from, to) = (corner(-1.0), corner(1.0));
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                // Cells along x are neighbours in memory.
                for slot in self.slots([from[0], y, z], to[0]) {
                    let d2 = distance2(p, self.points[slot]);
                    if d2 == 0.0 || d2 < radius2 {
                        found(self.indices[slot], d2);
                    }
                }
            }
        }
    }

    /// Scans the cells at Chebyshev distance `ring` from `centre`.
    fn scan_ring(
        &self,
        p: [f32; 3],
        centre: [usize; 3],
        ring: usize,
        best: &mut (u32, f32),
        visited: &mut usize,
    ) {
        let from: [usize; 3] = std::array::from_fn(|i| centre[i].saturating_sub(ring));
        let to: [usize; 3] = std::array::from_fn(|i| (centre[i] + ring).min(self.dims[i] - 1));
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                let on_shell = z.abs_diff(centre[2]) == ring || y.abs_diff(centre[1]) == ring;
                if on_shell {
                    *visited += to[0] - from[0] + 1;
                    self.scan_slots(p, self.slots([from[0], y, z], to[0]), best);
                    continue;
                }
                *visited += 2;
                if centre[0] >= ring {
                    let x = centre[0] - ring;
                    self.scan_slots(p, self.slots([x, y, z], x), best);
                }
                if centre[0] + ring < self.dims[0] {
                    let x = centre[0] + ring;
                    self.scan_slots(p, self.slots([x, y, z], x), best);
                }
            }
        }
    }

    #[inline]
    fn scan_slots(&self, p: [f32; 3], slots: std::ops::Range<usize>, best: &mut (u32, f32)) {
        for slot in slots {
            let d2 = distance2(p, self.points[slot]);
            let index = self.indices[slot];
            if d2 < best.1 || (d2 == best.1 && index < best.0) {
                *best = (index, d2);
            }
        }
    }

    /// Lower bound of the distance from `p` to points in cells beyond `ring`.
    fn distance_beyond(&self, p: [f32; 3], centre: [usize; 3], ring: usize) -> f64 {
        let mut bound = f64::INFINITY;
        for axis in 0..3 {
            let at = f64::from(p[axis]);
            if centre[axis] > ring {
                let face = self.low[axis] + (centre[axis] - ring) as f64 * self.cell;
                bound = bound.min(at - face);
            }
            if centre[axis] + ring + 1 < self.dims[axis] {
                let face = self.low[axis] + (centre[axis] + ring + 1) as f64 * self.cell;
                bound = bound.min(face - at);
            }
        }
        let magnitude = self
            .low
            .iter()
            .chain(&p.map(f64::from))
            .fold(0.0f64, |m, x| m.max(x.abs()));
        (bound - SLACK * self.cell - 1e-14 * magnitude).max(0.0)
    }

    /// Slots of the cells from `cell` to `last_x` in the same row.
    #[inline]
    fn slots(&self, cell: [usize; 3], last_x: usize) -> std::ops::Range<usize> {
        let first = self.cell_index(cell);
        self.starts[first] as usize..self.starts[first + last_x - cell[0] + 1] as usize
    }

    #[inline]
    fn cell_index(&self, cell: [usize; 3]) -> usize {
        (cell[2] * self.dims[1] + cell[1]) * self.dims[0] + cell[0]
    }

    #[inline]
    fn cell_of(&self, p: [f32; 3]) -> [usize; 3] {
        std::array::from_fn(|axis| self.cell_along(axis, f64::from(p[axis])))
    }

    /// Cell along an axis, the first or last one for places outside. Monotone in
    /// `x` under rounding, which is what makes boxes of cells hold their points.
    #[inline]
    fn cell_along(&self, axis: usize, x: f64) -> usize {
        // The cast maps negative numbers to 0.
        (((x - self.low[axis]) / self.cell) as usize).min(self.dims[axis] - 1)
    }
}

#[inline]
fn is_finite(p: &[f32; 3]) -> bool {
    p.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deterministic numbers in −1..1.
    fn noise(seed: u64) -> impl FnMut() -> f32 {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
        }
    }

    fn brute_nearest(points: &[[f32; 3]], p: [f32; 3]) -> Option<(u32, f32)> {
        let mut best = None;
        for (index, &point) in points.iter().enumerate().filter(|(_, q)| is_finite(q)) {
            let d2 = distance2(p, point);
            if best.is_none_or(|(_, least)| d2 < least) {
                best = Some((index as u32, d2));
            }
        }
        best
    }

    fn brute_within(points: &[[f32; 3]], p: [f32; 3], radius: f32) -> Vec<(u32, f32)> {
        let hits = points
            .iter()
            .enumerate()
            .map(|(i, &q)| (i as u32, distance2(p, q)));
        hits.filter(|&(_, d2)| d2 == 0.0 || d2 < radius * radius)
            .collect()
    }

    fn assert_equals_brute_force(points: &[[f32; 3]], cell: f32, queries: &[[f32; 3]]) {
        let grid = Grid::build(points, cell);
        let mut out = Vec::new();
        for &p in queries {
            assert_eq!(
                grid.nearest(p),
                brute_nearest(points, p),
                "nearest to {p:?}, cell {cell}"
            );
            for radius in [0.0, 0.1, 0.25, 1.0, 40.0] {
                let mut expected = brute_within(points, p, radius);
                grid.within(p, radius, &mut out);
                assert_eq!(out, expected, "radius {radius} around {p:?}");
                expected.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                expected.truncate(16);
                grid.k_nearest(p, 16, radius, &mut out);
                assert_eq!(out, expected, "16 nearest within {radius} of {p:?}");
                let nearest = grid.nearest_within(p, radius);
                assert_eq!(
                    nearest,
                    expected.first().copied(),
                    "nearest within {radius} of {p:?}"
                );
            }
        }
    }

    #[test]
    fn random_points_give_the_answers_of_a_full_scan() {
        let mut next = noise(1);
        let points: Vec<[f32; 3]> = (0..500)
            .map(|_| [next() * 3.0, next(), next() * 0.2])
            .collect();
        let queries: Vec<[f32; 3]> = (0..100)
            .map(|_| [next() * 5.0, next() * 2.0, next()])
            .collect();
        for cell in [0.01, 0.25, 100.0] {
            assert_equals_brute_force(&points, cell, &queries);
        }
    }

    #[test]
    fn ties_on_a_lattice_go_to_the_lowest_index() {
        // Half-integer queries are equally far from up to eight points; radii
        // 0.25 and 1 meet lattice distances exactly.
        let points: Vec<[f32; 3]> = (0..1000)
            .map(|i| {
                [(i * 7 % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32].map(|x| x * 0.25)
            })
            .collect();
        let queries: Vec<[f32; 3]> = (0..343)
            .map(|i| [i % 7, i / 7 % 7, i / 49].map(|x| x as f32 * 0.375 - 0.125))
            .collect();
        for cell in [0.25, 0.4, 1.0] {
            assert_equals_brute_force(&points, cell, &queries);
        }
    }

    #[test]
    fn outliers_huge_coordinates_and_coincident_points_are_answered_exactly() {
        let mut next = noise(2);
        let mut points: Vec<[f32; 3]> = (0..200).map(|_| [next(), next(), next()]).collect();
        points[17] = [3e9, 0.0, 0.0];
        points[18] = [0.0, -1e30, 0.0];
        let queries = [
            [0.1, 0.1, 0.1],
            [2.9e9, 0.0, 0.0],
            [1e25, 1e25, 0.0],
            [-3e38, 0.0, 3e38],
        ];
        assert_equals_brute_force(&points, 0.3, &queries);

        let far: Vec<[f32; 3]> = (0..200)
            .map(|_| [1e8 + next() * 100.0, next(), 1e8])
            .collect();
        assert_equals_brute_force(
            &far,
            0.3,
            &[[1e8, 0.0, 1e8], [1e8 + 64.0, 0.5, 1e8], [0.0; 3]],
        );

        let same = vec![[1.5, -2.0, 0.25]; 50];
        assert_equals_brute_force(
            &same,
            0.1,
            &[[1.5, -2.0, 0.25], [1.6, -2.0, 0.25], [9.0; 3]],
        );
    }

    #[test]
    fn points_and_queries_that_are_not_finite_find_nothing() {
        let grid = Grid::build(
            &[
                [f32::NAN, 0.0, 0.0],
                [2.0, 0.0, 0.0],
                [0.0, f32::INFINITY, 0.0],
            ],
            1.0,
        );
        assert_eq!(grid.len(), 1);
        assert_eq!(grid.nearest([0.0; 3]), Some((1, 4.0)));
        assert_eq!(grid.nearest([f32::NAN, 0.0, 0.0]), None);
        let mut out = vec![(0, 0.0)];
        grid.within([f32::INFINITY, 0.0, 0.0], 1.0, &mut out);
        assert!(out.is_empty());
        assert_eq!(Grid::build(&[], 1.0).nearest([0.0; 3]), None);
    }

    #[test]
    fn rebuilding_forgets_the_earlier_points() {
        let mut grid = Grid::build(&[[9.0; 3]; 30], 0.5);
        grid.rebuild(&[[1.0, 0.0, 0.0], [0.0; 3]], 0.5);
        assert_eq!(
            (grid.len(), grid.nearest([0.1, 0.0, 0.0]).unwrap().0),
            (2, 1)
        );
    }
}

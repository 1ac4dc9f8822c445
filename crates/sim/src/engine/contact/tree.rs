//! A tree of moving boxes: which features can meet within a stretch of time?
//!
//! A box has a place at the interval's start and one at its end, and moves
//! linearly between them. Two boxes cannot meet if on some axis one lies beyond
//! the other at both ends: then it does so throughout. So cloth and limb that
//! move together cost no margin, however fast they move: with boxes swept in
//! space, a swinging arm would meet everything on its sleeve's way.
//!
//! Nodes are eight boxes wide and hold them by coordinate, so that one
//! comparison serves eight boxes; the same code is compiled for wider registers
//! where the processor has them, and only compares, so the answers are the
//! same. The tree has no pointers: features are put in an order in which every
//! aligned run of 8, 64, 512 … of them is compact, once, on start positions,
//! and levels are stacked on that. Boxes are refitted; single ones can grow.
//! Features with a common vertex are no candidates: most of what meets within a
//! garment are neighbours, and eight of them are recognised at once too.

use glam::DVec3;

/// Calls a function compiled for wider registers where the processor has them;
/// its last generic parameter tells it so.
macro_rules! widest {
    ($inner:ident<$($N:ident),*>($($name:ident: $type:ty = $value:expr),*)) => {{
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide<$(const $N: usize),*>($($name: $type),*) {
                $inner::<$($N,)* true>($($name),*);
            }
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the registers were detected on this machine.
                unsafe { wide($($value),*) };
                return;
            }
        }
        $inner::<$($N,)* false>($($value),*);
    }};
}
pub(crate) use widest;

/// Boxes in a node.
const WIDTH: usize = 8;
/// Bits of all boxes in a node.
const EVERY: u32 = (1 << WIDTH) - 1;
/// Coordinates of a box: x, y, z of the low corner at start and end, and of
/// the negative of the high corner, so that the smaller one always wins.
const COORDINATES: usize = 12;
/// f32 boxes of points within 8 m of what they are relative to round by less, m.
pub(crate) const ROUNDING_M: f32 = 1e-6;

/// A box that moves linearly from its place at the start to that at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MovingBox([f32; COORDINATES]);

impl MovingBox {
    /// The box that holds nothing: so far away that it stays so between any two moments.
    pub const EMPTY: Self = Self([f32::MAX; COORDINATES]);

    /// Around a point that starts at `start` and ends within `radius` of `end`.
    #[inline]
    pub fn of(start: DVec3, end: DVec3, radius: f64) -> Self {
        let (s, e) = (start.as_vec3(), end.as_vec3());
        let r = radius as f32 + ROUNDING_M;
        let m = ROUNDING_M;
        Self([
            s.x - m,
            s.y - m,
            s.z - m,
            e.x - r,
            e.y - r,
            e.z - r,
            -s.x - m,
            -s.y - m,
            -s.z - m,
            -e.x - r,
            -e.y - r,
            -e.z - r,
        ])
    }

    /// Smallest moving box around two.
    #[inline]
    pub fn union(&self, other: &Self) -> Self {
        let mut union = self.0;
        for (a, &b) in union.iter_mut().zip(&other.0) {
            *a = if b < *a { b } else { *a };
        }
        Self(union)
    }

    /// Around the vertices of a feature.
    #[inline]
    pub fn around<const N: usize>(boxes: &[Self], feature: [u32; N]) -> Self {
        feature
            .iter()
            .fold(Self::EMPTY, |union, &v| union.union(&boxes[v as usize]))
    }

    /// Whether the two can come within `reach` of each other on every axis.
    pub fn can_meet(&self, other: &Self, reach: f32) -> bool {
        let limits = Limits::new(self, reach);
        (0..3).all(|k| {
            let beyond = |c: usize| other.0[c] > limits.0[c];
            !(beyond(k) && beyond(3 + k) || beyond(6 + k) && beyond(9 + k))
        })
    }
}

/// What another box's coordinates must not exceed to be met.
#[derive(Clone, Copy)]
struct Limits([f32; COORDINATES]);

impl Limits {
    /// Another box's low corner counts against this one's high corner and the reverse.
    #[inline(always)]
    fn new(of: &MovingBox, reach: f32) -> Self {
        const HALF: usize = COORDINATES / 2;
        let mut limits = [0.0; COORDINATES];
        for c in 0..HALF {
            limits[c] = reach - of.0[HALF + c];
            limits[HALF + c] = reach - of.0[c];
        }
        Self(limits)
    }
}

impl Limits {
    /// Those of one box among many.
    #[inline(always)]
    fn at(all: &[[f32; WIDTH]; COORDINATES], lane: usize) -> Self {
        Self(all.map(|coordinate| coordinate[lane]))
    }
}

/// Eight boxes by coordinate.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
struct Node([[f32; WIDTH]; COORDINATES]);

impl Node {
    const EMPTY: Self = Self([[f32::MAX; WIDTH]; COORDINATES]);

    #[inline(always)]
    fn get(&self, lane: usize) -> MovingBox {
        let mut one = MovingBox::EMPTY;
        for c in 0..COORDINATES {
            one.0[c] = self.0[c][lane];
        }
        one
    }

    #[inline]
    fn set(&mut self, lane: usize, of: &MovingBox) {
        for c in 0..COORDINATES {
            self.0[c][lane] = of.0[c];
        }
    }

    /// Around all boxes.
    #[inline(always)]
    fn union(&self) -> MovingBox {
        let mut union = MovingBox::EMPTY;
        for c in 0..COORDINATES {
            for lane in 0..WIDTH {
                let one = self.0[c][lane];
                union.0[c] = if one < union.0[c] { one } else { union.0[c] };
            }
        }
        union
    }

    /// Limits of all boxes, by coordinate.
    #[inline(always)]
    fn limits(&self, reach: f32) -> [[f32; WIDTH]; COORDINATES] {
        const HALF: usize = COORDINATES / 2;
        let mut limits = [[0.0; WIDTH]; COORDINATES];
        for c in 0..COORDINATES {
            for lane in 0..WIDTH {
                limits[c][lane] = reach - self.0[(c + HALF) % COORDINATES][lane];
            }
        }
        limits
    }

    /// Bit of each box that can be met within the limits.
    #[inline(always)]
    fn met<const WIDE: bool>(&self, limits: &Limits) -> u32 {
        #[cfg(target_arch = "x86_64")]
        if WIDE {
            // SAFETY: only who runs on a machine with these registers is wide.
            return unsafe { wide::met(&self.0, &limits.0) };
        }
        let l = &limits.0;
        let apart = |lane: usize| {
            (0..3).any(|k| {
                let beyond = |c: usize| self.0[c][lane] > l[c];
                beyond(k) && beyond(3 + k) || beyond(6 + k) && beyond(9 + k)
            })
        };
        (0..WIDTH).fold(0, |met, lane| met | u32::from(!apart(lane)) << lane)
    }
}

/// Vertices of the eight features of a node on level 0, corner by corner.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
struct Corners<const N: usize>([[u32; WIDTH]; N]);

impl<const N: usize> Corners<N> {
    fn of(features: &[[u32; N]]) -> Self {
        let mut corners = [[u32::MAX; WIDTH]; N];
        for (lane, feature) in features.iter().enumerate() {
            for (corner, &v) in corners.iter_mut().zip(feature) {
                corner[lane] = v;
            }
        }
        Self(corners)
    }

    /// Bit of each feature that has one of these vertices.
    #[inline(always)]
    fn having<const M: usize, const WIDE: bool>(&self, vertices: &[u32; M]) -> u32 {
        #[cfg(target_arch = "x86_64")]
        if WIDE {
            // SAFETY: only who runs on a machine with these registers is wide.
            return unsafe { wide::having(&self.0, vertices) };
        }
        let has = |lane: usize| self.0.iter().any(|of| vertices.contains(&of[lane]));
        (0..WIDTH).fold(0, |having, lane| having | u32::from(has(lane)) << lane)
    }
}

/// The innermost comparisons in 256-bit registers: compilers take them apart otherwise.
#[cfg(target_arch = "x86_64")]
mod wide {
    use std::arch::x86_64::{
        _CMP_GT_OQ, _mm256_and_ps, _mm256_castsi256_ps, _mm256_cmp_ps, _mm256_cmpeq_epi32,
        _mm256_loadu_ps, _mm256_loadu_si256, _mm256_movemask_ps, _mm256_or_ps, _mm256_or_si256,
        _mm256_set1_epi32, _mm256_set1_ps, _mm256_setzero_si256,
    };

    use super::{COORDINATES, EVERY, WIDTH};

    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn met(boxes: &[[f32; WIDTH]; COORDINATES], limits: &[f32; COORDINATES]) -> u32 {
        let beyond = |c: usize| {
            // SAFETY: eight numbers are there.
            let place = unsafe { _mm256_loadu_ps(boxes[c].as_ptr()) };
            _mm256_cmp_ps::<_CMP_GT_OQ>(place, _mm256_set1_ps(limits[c]))
        };
        let both = |c: usize| _mm256_and_ps(beyond(c), beyond(c + 3));
        let low = _mm256_or_ps(_mm256_or_ps(both(0), both(1)), both(2));
        let high = _mm256_or_ps(_mm256_or_ps(both(6), both(7)), both(8));
        !_mm256_movemask_ps(_mm256_or_ps(low, high)) as u32 & EVERY
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn having<const N: usize, const M: usize>(
        corners: &[[u32; WIDTH]; N],
        vertices: &[u32; M],
    ) -> u32 {
        let mut having = _mm256_setzero_si256();
        for corner in corners {
            // SAFETY: eight numbers are there.
            let of = unsafe { _mm256_loadu_si256(corner.as_ptr().cast()) };
            for &v in vertices {
                let same = _mm256_cmpeq_epi32(of, _mm256_set1_epi32(v as i32));
                having = _mm256_or_si256(having, same);
            }
        }
        _mm256_movemask_ps(_mm256_castsi256_ps(having)) as u32
    }
}

/// Tree over features of `N` vertices each.
#[derive(Clone, Debug)]
pub(crate) struct Tree<const N: usize> {
    /// Features in the tree's order.
    features: Vec<[u32; N]>,
    /// The same by the nodes of level 0.
    corners: Vec<Corners<N>>,
    /// Place of each feature in that order.
    place: Vec<u32>,
    /// Level 0 holds the features' boxes, each further one those of the nodes below; the last is one node.
    levels: Vec<Vec<Node>>,
}

impl<const N: usize> Tree<N> {
    /// Splits at medians of the features' centres.
    pub fn build(positions: &[DVec3], features: &[[u32; N]]) -> Self {
        let centre = |feature: &[u32; N]| {
            let sum: DVec3 = feature.iter().map(|&v| positions[v as usize]).sum();
            (sum / N as f64).to_array()
        };
        let centres: Vec<[f64; 3]> = features.iter().map(centre).collect();
        let mut order: Vec<u32> = (0..features.len() as u32).collect();
        arrange(&centres, &mut order);
        let mut place = vec![0; order.len()];
        for (at, &number) in order.iter().enumerate() {
            place[number as usize] = at as u32;
        }
        let mut levels = Vec::new();
        let mut count = features.len();
        while count > 1 || levels.is_empty() {
            count = count.div_ceil(WIDTH).max(1);
            levels.push(vec![Node::EMPTY; count]);
        }
        let features: Vec<[u32; N]> = order.iter().map(|&i| features[i as usize]).collect();
        let corners = features.chunks(WIDTH).map(Corners::of).collect();
        Self {
            features,
            corners,
            place,
            levels,
        }
    }

    /// Takes the vertices' new boxes over.
    pub fn refit(&mut self, vertices: &[MovingBox]) {
        for (node, features) in self.levels[0].iter_mut().zip(self.features.chunks(WIDTH)) {
            for (lane, &feature) in features.iter().enumerate() {
                node.set(lane, &MovingBox::around(vertices, feature));
            }
        }
        for level in 1..self.levels.len() {
            let (below, above) = self.levels.split_at_mut(level);
            for (node, children) in above[0].iter_mut().zip(below[level - 1].chunks(WIDTH)) {
                for (lane, child) in children.iter().enumerate() {
                    node.set(lane, &child.union());
                }
            }
        }
    }

    /// Takes the boxes of a tree over the same features that is fitted to a
    /// longer stretch, from `begin` to `end` of it (0 to 1).
    ///
    /// What moves linearly within a linearly moving box does so for a part of
    /// the time too; boxes of parts come out no smaller than fitted anew.
    pub fn refit_within(&mut self, longer: &Self, begin: f32, end: f32) {
        let levels = (&mut self.levels[..], &longer.levels[..]);
        widest!(between<>(levels: (&mut [Vec<Node>], &[Vec<Node>]) = levels, begin: f32 = begin, end: f32 = end));
    }

    /// Makes room for what one feature does beside what it was fitted to.
    pub fn grow(&mut self, feature: usize, room: &MovingBox) {
        let mut at = self.place[feature] as usize;
        for level in &mut self.levels {
            let node = &mut level[at / WIDTH];
            let lane = at % WIDTH;
            let grown = node.get(lane).union(room);
            node.set(lane, &grown);
            at /= WIDTH;
        }
    }

    /// Calls `found` with every feature that can come within `reach` of `query`.
    pub fn meeting(&self, query: &MovingBox, reach: f32, found: impl FnMut([u32; N])) {
        widest!(descend<N>(tree: &Tree<N> = self, limits: &Limits = &Limits::new(query, reach), found: impl FnMut([u32; N]) = found));
    }

    /// Calls `found` with every feature here and every one in `other` that can
    /// come within `reach` of each other; both trees are descended together.
    pub fn meeting_tree<const M: usize>(
        &self,
        other: &Tree<M>,
        reach: f32,
        found: impl FnMut([u32; N], [u32; M]),
    ) {
        widest!(descend_both<N, M>(a: &Tree<N> = self, b: &Tree<M> = other, related: bool = false, reach: f32 = reach, found: impl FnMut([u32; N], [u32; M]) = found));
    }

    /// The same for features of one surface: those with a common vertex are left out.
    pub fn meeting_relatives<const M: usize>(
        &self,
        other: &Tree<M>,
        reach: f32,
        found: impl FnMut([u32; N], [u32; M]),
    ) {
        widest!(descend_both<N, M>(a: &Tree<N> = self, b: &Tree<M> = other, related: bool = true, reach: f32 = reach, found: impl FnMut([u32; N], [u32; M]) = found));
    }

    /// The same within this tree, each two features once.
    pub fn meeting_itself(&self, reach: f32, found: impl FnMut([u32; N], [u32; N])) {
        widest!(descend_itself<N>(tree: &Tree<N> = self, reach: f32 = reach, found: impl FnMut([u32; N], [u32; N]) = found));
    }

    fn height(&self) -> usize {
        self.levels.len() - 1
    }

    /// The box around a node, where the level above has it.
    #[inline(always)]
    fn around(&self, level: usize, index: u32) -> Option<MovingBox> {
        let above = self.levels.get(level + 1)?;
        let (node, lane) = (index as usize / WIDTH, index as usize % WIDTH);
        Some(above[node].get(lane))
    }
}

#[inline(always)]
fn between<const WIDE: bool>(
    (part, whole): (&mut [Vec<Node>], &[Vec<Node>]),
    begin: f32,
    end: f32,
) {
    const HALF: usize = COORDINATES / 2;
    let nodes = part.iter_mut().flatten();
    for (node, whole) in nodes.zip(whole.iter().flatten()) {
        for half in [0, HALF] {
            for c in half..half + 3 {
                let (first, last) = (whole.0[c], whole.0[c + 3]);
                for lane in 0..WIDTH {
                    let at = |t: f32| first[lane] * (1.0 - t) + last[lane] * t - ROUNDING_M;
                    node.0[c][lane] = at(begin);
                    node.0[c + 3][lane] = at(end);
                }
            }
        }
    }
}

#[inline(always)]
fn descend<const N: usize, const WIDE: bool>(
    tree: &Tree<N>,
    limits: &Limits,
    mut found: impl FnMut([u32; N]),
) {
    // At most seven siblings wait on each of the eleven levels that u32 numbers can fill.
    let mut stack = [(0u8, 0u32); 96];
    stack[0].0 = tree.height() as u8;
    let mut depth = 1;
    while depth > 0 {
        depth -= 1;
        let (level, index) = stack[depth];
        let mut met = tree.levels[level as usize][index as usize].met::<WIDE>(limits);
        while met != 0 {
            let at = index * WIDTH as u32 + met.trailing_zeros();
            met &= met - 1;
            if level == 0 {
                found(tree.features[at as usize]);
            } else {
                stack[depth] = (level - 1, at);
                depth += 1;
            }
        }
    }
}

#[inline(always)]
fn descend_both<const N: usize, const M: usize, const WIDE: bool>(
    a: &Tree<N>,
    b: &Tree<M>,
    related: bool,
    reach: f32,
    mut found: impl FnMut([u32; N], [u32; M]),
) {
    let width = WIDTH as u32;
    let (top_a, top_b) = (a.height(), b.height());
    let mut stack = Vec::with_capacity(512);
    stack.push(((top_a, 0u32), (top_b, 0u32)));
    while let Some(((la, i), (lb, j))) = stack.pop() {
        let (node_a, node_b) = (&a.levels[la][i as usize], &b.levels[lb][j as usize]);
        // The higher tree is descended alone until both are at the same level.
        if la != lb {
            let (node, whole) = if la > lb {
                (node_a, node_b.union())
            } else {
                (node_b, node_a.union())
            };
            let mut met = node.met::<WIDE>(&Limits::new(&whole, reach));
            while met != 0 {
                let lane = met.trailing_zeros();
                met &= met - 1;
                stack.push(if la > lb {
                    ((la - 1, i * width + lane), (lb, j))
                } else {
                    ((la, i), (lb - 1, j * width + lane))
                });
            }
            continue;
        }
        // Most nodes that meet do so at their borders: only few boxes matter.
        let mut lanes = match b.around(lb, j) {
            Some(whole) => node_a.met::<WIDE>(&Limits::new(&whole, reach)),
            None => EVERY,
        };
        let limits = node_a.limits(reach);
        while lanes != 0 {
            let lane = lanes.trailing_zeros();
            lanes &= lanes - 1;
            let mut met = node_b.met::<WIDE>(&Limits::at(&limits, lane as usize));
            let from = i * width + lane;
            if la == 0 && related && met != 0 {
                met &= !b.corners[j as usize].having::<N, WIDE>(&a.features[from as usize]);
            }
            while met != 0 {
                let to = j * width + met.trailing_zeros();
                met &= met - 1;
                if la == 0 {
                    found(a.features[from as usize], b.features[to as usize]);
                } else {
                    stack.push(((la - 1, from), (lb - 1, to)));
                }
            }
        }
    }
}

#[inline(always)]
fn descend_itself<const N: usize, const WIDE: bool>(
    tree: &Tree<N>,
    reach: f32,
    mut found: impl FnMut([u32; N], [u32; N]),
) {
    let width = WIDTH as u32;
    let mut stack = Vec::with_capacity(512);
    stack.push((tree.height(), 0u32, 0u32));
    while let Some((level, i, j)) = stack.pop() {
        let nodes = &tree.levels[level];
        let (node_i, node_j) = (&nodes[i as usize], &nodes[j as usize]);
        let mut lanes = match tree.around(level, j).filter(|_| i != j) {
            Some(whole) => node_i.met::<WIDE>(&Limits::new(&whole, reach)),
            None => EVERY,
        };
        let limits = node_i.limits(reach);
        while lanes != 0 {
            let lane = lanes.trailing_zeros();
            lanes &= lanes - 1;
            let mut met = node_j.met::<WIDE>(&Limits::at(&limits, lane as usize));
            if i == j {
                // Each two once; a node below with itself, a feature not.
                met &= u32::MAX << (lane + u32::from(level == 0));
            }
            let from = i * width + lane;
            if level == 0 && met != 0 {
                met &= !tree.corners[j as usize].having::<N, WIDE>(&tree.features[from as usize]);
            }
            while met != 0 {
                let to = j * width + met.trailing_zeros();
                met &= met - 1;
                if level == 0 {
                    found(tree.features[from as usize], tree.features[to as usize]);
                } else {
                    stack.push((level - 1, from, to));
                }
            }
        }
    }
}

/// Orders `items` so that every aligned run of `WIDTH`, `WIDTH`², … of them is compact.
fn arrange(centres: &[[f64; 3]], items: &mut [u32]) {
    if items.len() <= WIDTH {
        return;
    }
    let spread = |axis: usize| {
        let along = items.iter().map(|&i| centres[i as usize][axis]);
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), c| {
            (low.min(c), high.max(c))
        });
        high - low
    };
    let spreads = [spread(0), spread(1), spread(2)];
    let axis = (1..3).fold(0, |best, axis| {
        if spreads[axis] > spreads[best] {
            axis
        } else {
            best
        }
    });
    // Nodes to the left: the largest power of two that leaves some to the right.
    let nodes = items.len().div_ceil(WIDTH);
    let left = WIDTH * (nodes.next_power_of_two() / 2);
    items.select_nth_unstable_by(left, |&a, &b| {
        let key = |i: u32| centres[i as usize][axis];
        key(a).total_cmp(&key(b)).then(a.cmp(&b))
    });
    let (left, right) = items.split_at_mut(left);
    arrange(centres, left);
    arrange(centres, right);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Points that fly through each other, with what they may stray at the end.
    struct Swarm {
        start: Vec<DVec3>,
        end: Vec<DVec3>,
        radius: f64,
    }

    impl Swarm {
        fn new(count: u32, seed: f64) -> Self {
            let place = |i: u32, s: f64| {
                let x = [1.3, 2.9, 0.7].map(|f: f64| (f64::from(i) * f + s).sin() * 2.0);
                DVec3::from_array(x)
            };
            let start: Vec<DVec3> = (0..count).map(|i| place(i, seed)).collect();
            let end = (0..count).map(|i| start[i as usize] + place(i, seed + 4.0));
            Self {
                end: end.collect(),
                start,
                radius: 0.05,
            }
        }

        fn boxes(&self) -> Vec<MovingBox> {
            let ends = self.start.iter().zip(&self.end);
            ends.map(|(s, e)| MovingBox::of(*s, *e, self.radius))
                .collect()
        }

        fn tree(&self) -> Tree<1> {
            let features: Vec<[u32; 1]> = (0..self.start.len() as u32).map(|i| [i]).collect();
            let mut tree = Tree::build(&self.start, &features);
            tree.refit(&self.boxes());
            tree
        }

        /// Whether two points come so near that their boxes touch, at one of many moments.
        fn meets(&self, a: usize, other: &Self, b: usize) -> bool {
            (0..=100).any(|moment| {
                let t = f64::from(moment) / 100.0;
                let apart =
                    self.start[a].lerp(self.end[a], t) - other.start[b].lerp(other.end[b], t);
                apart.abs().max_element() < (self.radius + other.radius) * t
            })
        }
    }

    #[test]
    fn whatever_meets_on_the_way_is_found_once() {
        for count in [1, 7, 8, 9, 64, 65, 200, 600] {
            let (a, b) = (Swarm::new(count, 0.0), Swarm::new(150, 0.3));
            let (tree, other) = (a.tree(), b.tree());
            let mut across = BTreeSet::new();
            tree.meeting_tree(&other, 0.0, |[i], [j]| {
                assert!(across.insert((i, j)), "{i} and {j} found twice");
            });
            let mut back = BTreeSet::new();
            other.meeting_tree(&tree, 0.0, |[j], [i]| {
                back.insert((i, j));
            });
            assert_eq!(across, back);
            let mut single = BTreeSet::new();
            for (i, around) in a.boxes().iter().enumerate() {
                other.meeting(around, 0.0, |[j]| {
                    single.insert((i as u32, j));
                });
            }
            assert_eq!(across, single);
            let mut together = BTreeSet::new();
            tree.meeting_itself(0.0, |[i], [j]| {
                assert!(i != j && together.insert((i.min(j), i.max(j))), "{i}, {j}");
            });
            let (boxes, others) = (a.boxes(), b.boxes());
            for i in 0..count {
                for j in 0..150 {
                    let expected = boxes[i as usize].can_meet(&others[j as usize], 0.0);
                    assert_eq!(across.contains(&(i, j)), expected);
                    assert!(expected || !a.meets(i as usize, &b, j as usize));
                }
                for j in 0..i {
                    let expected = boxes[i as usize].can_meet(&boxes[j as usize], 0.0);
                    assert_eq!(together.contains(&(j, i)), expected);
                    assert!(expected || !a.meets(i as usize, &a, j as usize));
                }
            }
            assert!(
                across.len() > count as usize / 20,
                "too few meetings for a test"
            );
            assert!(
                across.len() < 150 * count as usize / 2 + 100,
                "too many for a test"
            );
        }
    }

    #[test]
    fn wide_and_plain_comparisons_give_the_same_bits() {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            let (tree, queries) = (Swarm::new(200, 0.0).tree(), Swarm::new(60, 0.3).boxes());
            let mut seen = BTreeSet::new();
            for node in tree.levels.iter().flatten() {
                for query in &queries {
                    let limits = Limits::new(query, 0.1);
                    let met = node.met::<false>(&limits);
                    assert_eq!(node.met::<true>(&limits), met);
                    seen.insert(met);
                }
                let nowhere = Limits([f32::NAN; COORDINATES]);
                assert_eq!(node.met::<true>(&nowhere), node.met::<false>(&nowhere));
            }
            assert!(seen.len() > 20, "{} answers", seen.len());
            let corners = Corners::of(&[[1, 2, 3], [3, 4, 5], [6, 7, 8], [2, 8, 9]]);
            for vertices in [[0, 1], [2, 3], [5, 8], [10, 11]] {
                let plain = corners.having::<2, false>(&vertices);
                assert_eq!(corners.having::<2, true>(&vertices), plain);
            }
            assert_eq!(corners.having::<2, true>(&[2, 3]), 0b1011);
        }
    }

    #[test]
    fn points_that_fly_in_formation_do_not_meet() {
        let flight = DVec3::new(3.0, 0.0, 0.0);
        let points = [DVec3::ZERO, DVec3::new(0.2, 0.0, 0.0)];
        let boxes = points.map(|p| MovingBox::of(p, p + flight, 0.01));
        assert!(!boxes[0].can_meet(&boxes[1], 0.17));
        assert!(boxes[0].can_meet(&boxes[1], 0.19));
    }

    #[test]
    fn boxes_of_a_part_of_the_time_hold_what_moves_in_it() {
        let mut swarm = Swarm::new(200, 0.0);
        swarm.radius = 0.0;
        let whole = swarm.tree();
        let mut part = whole.clone();
        for (begin, end) in [(0.0, 1.0), (0.0, 0.25), (0.3, 0.7), (0.5, 1.0), (1.0, 1.0)] {
            part.refit_within(&whole, begin as f32, end as f32);
            let at = |i: usize, t: f64| swarm.start[i].lerp(swarm.end[i], t);
            for i in 0..200 {
                for t in [0.0, 0.4, 1.0] {
                    // Something that is there at that moment of the part, and nowhere near before and after.
                    let there = at(i, begin + t * (end - begin));
                    let away = DVec3::new(0.0, 0.0, 50.0);
                    let query = MovingBox::of(there - t * away, there + (1.0 - t) * away, 0.0);
                    let mut found = Vec::new();
                    part.meeting(&query, 0.0, |[j]| found.push(j));
                    assert!(
                        found.contains(&(i as u32)),
                        "{i} at {t} of {begin} to {end}"
                    );
                }
            }
            // And no more than boxes fitted to the part would.
            let boxes: Vec<MovingBox> = (0..200)
                .map(|i| MovingBox::of(at(i, begin), at(i, end), 0.0))
                .collect();
            let mut fitted = whole.clone();
            fitted.refit(&boxes);
            let query = MovingBox::of(DVec3::ZERO, DVec3::ONE, 0.3);
            let count = |tree: &Tree<1>| {
                let mut count = 0;
                tree.meeting(&query, 1e-5, |_| count += 1);
                count
            };
            let strict = {
                let mut count = 0;
                fitted.meeting(&query, 0.0, |_| count += 1);
                count
            };
            assert!((strict..=count(&fitted)).contains(&{
                let mut count = 0;
                part.meeting(&query, 0.0, |_| count += 1);
                count
            }));
        }
    }

    #[test]
    fn what_grew_is_found_where_it_grew_to() {
        let swarm = Swarm::new(200, 0.0);
        let far = DVec3::splat(30.0);
        let room = MovingBox::of(far, far, 0.1);
        let mut tree = swarm.tree();
        let mut found = Vec::new();
        tree.meeting(&room, 0.0, |[i]| found.push(i));
        assert!(found.is_empty());
        tree.grow(123, &room);
        tree.meeting(&room, 0.0, |[i]| found.push(i));
        assert_eq!(found, [123]);
        found.clear();
        tree.meeting(&swarm.boxes()[123], 0.0, |[i]| found.push(i));
        assert!(found.contains(&123), "lost where it was");
    }
}

//! A tree of moving boxes: which features can meet within a stretch of time?
//!
//! Each vertex has a box at the middle of the interval and a range of
//! displacements from there to its end (by symmetry, minus that to its start).
//! Two boxes can meet if, on every axis, they overlap after growing by their
//! largest *relative* displacement. So cloth and limb that move together cost
//! no margin, however fast they move: with boxes swept in space, a swinging
//! arm would meet everything on its sleeve's way.
//!
//! The tree is split once on start positions and refitted.

use drape_geometry::bvh::Aabb;

/// Features in a leaf.
const LEAF: usize = 4;

/// Box at the interval's middle and range of displacements to its end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MovingBox {
    pub middle: Aabb,
    pub shift: Aabb,
}

impl MovingBox {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self {
        middle: Aabb::EMPTY,
        shift: Aabb::EMPTY,
    };

    /// Smallest moving box around two.
    pub fn union(&self, other: &Self) -> Self {
        Self {
            middle: self.middle.union(&other.middle),
            shift: self.shift.union(&other.shift),
        }
    }

    /// Around the vertices of a feature.
    pub fn around<const N: usize>(boxes: &[Self], feature: [u32; N]) -> Self {
        feature
            .iter()
            .fold(Self::EMPTY, |union, &v| union.union(&boxes[v as usize]))
    }

    /// Whether the two can come within `reach` of each other in the interval.
    #[inline]
    pub fn can_meet(&self, other: &Self, reach: f32) -> bool {
        (0..3).all(|k| {
            let forth = self.shift.high[k] - other.shift.low[k];
            let back = other.shift.high[k] - self.shift.low[k];
            let reach = reach + forth.abs().max(back.abs());
            self.middle.low[k] - reach <= other.middle.high[k]
                && other.middle.low[k] - reach <= self.middle.high[k]
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    around: MovingBox,
    /// Leaf: first item. Inner node: the right child, the left one follows.
    first: u32,
    /// Items in a leaf, 0 for an inner node.
    count: u32,
}

/// Tree over features, numbered as in the slice it was built from.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    nodes: Vec<Node>,
    items: Vec<u32>,
    boxes: Vec<MovingBox>,
}

impl Tree {
    /// Splits at medians of the features' centres.
    pub fn build<const N: usize>(positions: &[glam::DVec3], features: &[[u32; N]]) -> Self {
        let centre = |feature: &[u32; N]| {
            let sum: glam::DVec3 = feature.iter().map(|&v| positions[v as usize]).sum();
            (sum / N as f64).to_array()
        };
        let centres: Vec<[f64; 3]> = features.iter().map(centre).collect();
        let mut tree = Self {
            nodes: Vec::new(),
            items: (0..features.len() as u32).collect(),
            boxes: vec![MovingBox::EMPTY; features.len()],
        };
        if !features.is_empty() {
            split(&centres, &mut tree.items, 0, &mut tree.nodes);
        }
        tree
    }

    /// Takes the vertices' new boxes over.
    pub fn refit<const N: usize>(&mut self, vertices: &[MovingBox], features: &[[u32; N]]) {
        for (around, &item) in self.boxes.iter_mut().zip(&self.items) {
            *around = MovingBox::around(vertices, features[item as usize]);
        }
        // Children come after their parents.
        for index in (0..self.nodes.len()).rev() {
            let Node { first, count, .. } = self.nodes[index];
            self.nodes[index].around = if count == 0 {
                self.nodes[index + 1]
                    .around
                    .union(&self.nodes[first as usize].around)
            } else {
                let items = &self.boxes[self.nodes[index].range()];
                items
                    .iter()
                    .fold(MovingBox::EMPTY, |union, item| union.union(item))
            };
        }
    }

    /// Calls `found` with every feature that can come within `reach` of `query`.
    pub fn meeting(&self, query: &MovingBox, reach: f32, mut found: impl FnMut(u32)) {
        let mut stack = Vec::with_capacity(64);
        stack.extend((!self.nodes.is_empty()).then_some(0));
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            if !node.around.can_meet(query, reach) {
                continue;
            }
            if node.count == 0 {
                stack.extend([node.first, index + 1]);
            } else {
                for at in node.range() {
                    if self.boxes[at].can_meet(query, reach) {
                        found(self.items[at]);
                    }
                }
            }
        }
    }

    /// Calls `found` with every feature here and every one in `other` that can
    /// come within `reach` of each other; both trees are descended together.
    pub fn meeting_tree(&self, other: &Tree, reach: f32, mut found: impl FnMut(u32, u32)) {
        let mut stack = Vec::with_capacity(256);
        stack.extend((!self.nodes.is_empty() && !other.nodes.is_empty()).then_some((0, 0)));
        while let Some((i, j)) = stack.pop() {
            let (a, b) = (&self.nodes[i as usize], &other.nodes[j as usize]);
            if !a.around.can_meet(&b.around, reach) {
                continue;
            }
            match (a.count, b.count) {
                (0, 0) => {
                    stack.extend([(i + 1, j + 1), (i + 1, b.first)]);
                    stack.extend([(a.first, j + 1), (a.first, b.first)]);
                }
                (0, _) => stack.extend([(i + 1, j), (a.first, j)]),
                (_, 0) => stack.extend([(i, j + 1), (i, b.first)]),
                _ => {
                    for at in a.range() {
                        for to in b.range() {
                            if self.boxes[at].can_meet(&other.boxes[to], reach) {
                                found(self.items[at], other.items[to]);
                            }
                        }
                    }
                }
            }
        }
    }

    /// The same within this tree, each two features once.
    pub fn meeting_itself(&self, reach: f32, mut found: impl FnMut(u32, u32)) {
        let mut stack = Vec::with_capacity(256);
        stack.extend((!self.nodes.is_empty()).then_some((0, 0)));
        while let Some((i, j)) = stack.pop() {
            let (a, b) = (&self.nodes[i as usize], &self.nodes[j as usize]);
            if i != j && !a.around.can_meet(&b.around, reach) {
                continue;
            }
            match (a.count, b.count) {
                (0, 0) if i == j => {
                    stack.extend([(i + 1, i + 1), (i + 1, a.first), (a.first, a.first)]);
                }
                (0, 0) => {
                    stack.extend([(i + 1, j + 1), (i + 1, b.first)]);
                    stack.extend([(a.first, j + 1), (a.first, b.first)]);
                }
                (0, _) => stack.extend([(i + 1, j), (a.first, j)]),
                (_, 0) => stack.extend([(i, j + 1), (i, b.first)]),
                _ => {
                    for at in a.range() {
                        let from = if i == j { at + 1 } else { b.range().start };
                        for to in from..b.range().end {
                            if self.boxes[at].can_meet(&self.boxes[to], reach) {
                                found(self.items[at], self.items[to]);
                            }
                        }
                    }
                }
            }
        }
    }
}

impl Node {
    /// Items of a leaf.
    fn range(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }
}

fn split(centres: &[[f64; 3]], items: &mut [u32], offset: usize, nodes: &mut Vec<Node>) {
    let node = nodes.len();
    nodes.push(Node {
        around: MovingBox::EMPTY,
        first: offset as u32,
        count: items.len() as u32,
    });
    if items.len() <= LEAF {
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
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |&a, &b| {
        let key = |i: u32| centres[i as usize][axis];
        key(a).total_cmp(&key(b)).then(a.cmp(&b))
    });
    let (left, right) = items.split_at_mut(middle);
    split(centres, left, offset, nodes);
    nodes[node].first = nodes.len() as u32;
    nodes[node].count = 0;
    split(centres, right, offset + middle, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn whatever_meets_on_the_way_is_found() {
        // Points that fly through each other: brute force over time against the tree.
        let place =
            |i: u32, s: f64| [1.3, 2.9, 0.7].map(|f: f64| (f64::from(i) * f + s).sin() * 2.0);
        let start: Vec<DVec3> = (0..200).map(|i| DVec3::from_array(place(i, 0.0))).collect();
        let shift: Vec<DVec3> = (0..200)
            .map(|i| DVec3::from_array(place(i, 4.0)) * 0.5)
            .collect();
        let radius = 0.05;
        let boxes: Vec<MovingBox> = start
            .iter()
            .zip(&shift)
            .map(|(x, d)| MovingBox {
                middle: Aabb::of(&[x.as_vec3().to_array()]).grown(radius),
                shift: Aabb::of(&[d.as_vec3().to_array()]),
            })
            .collect();
        let features: Vec<[u32; 1]> = (0..200).map(|i| [i]).collect();
        let mut tree = Tree::build(&start, &features);
        tree.refit(&boxes, &features);
        let mut meetings = 0;
        let mut together = std::collections::BTreeSet::new();
        tree.meeting_itself(0.0, |i, j| {
            assert!(
                together.insert((i.min(j), i.max(j))),
                "{i} and {j} found twice"
            );
        });
        let mut across = std::collections::BTreeSet::new();
        tree.meeting_tree(&tree.clone(), 0.0, |i, j| {
            assert!(across.insert((i, j)), "{i} and {j} found twice");
        });
        for i in 0..200 {
            let mut found = Vec::new();
            tree.meeting(&boxes[i as usize], 0.0, |j| found.push(j));
            for j in 0..200 {
                assert_eq!(found.contains(&j), across.contains(&(i, j)));
                assert!(i == j || found.contains(&j) == together.contains(&(i.min(j), i.max(j))));
                let (a, b) = (i as usize, j as usize);
                let at = |t: f64| (start[a] + t * shift[a]) - (start[b] + t * shift[b]);
                let meet = (-50..=50).any(|t| {
                    at(f64::from(t) / 50.0).abs().max_element() < 1.99 * f64::from(radius)
                });
                if meet {
                    meetings += 1;
                    assert!(found.contains(&j), "{i} and {j} meet");
                }
            }
        }
        assert!(meetings > 220, "too few meetings for a test: {meetings}");
    }
}

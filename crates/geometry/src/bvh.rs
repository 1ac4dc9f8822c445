//! A tree of axis-aligned boxes: which items' boxes overlap a given box?
//!
//! Built by splitting at the median of box centres along the widest axis.
//! Boxes are f32 like the points they hold, so no rounding can lose an item;
//! touching boxes overlap. Items whose box holds a NaN are never reported.

/// Items in a leaf: few enough to test quickly, enough to keep the tree small.
const LEAF: usize = 4;

/// Axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Lowest corner.
    pub low: [f32; 3],
    /// Highest corner.
    pub high: [f32; 3],
}

impl Aabb {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self {
        low: [f32::INFINITY; 3],
        high: [f32::NEG_INFINITY; 3],
    };

    /// Smallest box around points; not finite if one of them is not.
    pub fn of(points: &[[f32; 3]]) -> Self {
        let mut aabb = Self::EMPTY;
        for point in points {
            // `min` would drop a NaN; here it has to survive until `is_finite`.
            if point.iter().any(|x| x.is_nan()) {
                return Self {
                    low: [f32::NAN; 3],
                    high: [f32::NAN; 3],
                };
            }
            aabb = aabb.union(&Self {
                low: *point,
                high: *point,
            });
        }
        aabb
    }

    /// Smallest box around two boxes.
    pub fn union(&self, other: &Self) -> Self {
        let mut union = *self;
        for axis in 0..3 {
            union.low[axis] = union.low[axis].min(other.low[axis]);
            union.high[axis] = union.high[axis].max(other.high[axis]);
        }
        union
    }

    /// The box grown by `margin` on all sides.
    pub fn grown(&self, margin: f32) -> Self {
        Self {
            low: self.low.map(|x| x - margin),
            high: self.high.map(|x| x + margin),
        }
    }

    /// Whether the boxes share a point.
    #[inline]
    pub fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }

    fn is_finite(&self) -> bool {
        self.low.iter().chain(&self.high).all(|x| x.is_finite())
    }

    fn doubled_centre(&self, axis: usize) -> f64 {
        f64::from(self.low[axis]) + f64::from(self.high[axis])
    }
}

/// Tree over items numbered as in the slice it was built from.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    items: Vec<u32>,
    boxes: Vec<Aabb>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    aabb: Aabb,
    /// Leaf: range of items. Inner node: `first` is the right child, the left one follows.
    first: u32,
    /// Items in a leaf, 0 for an inner node.
    count: u32,
}

impl Bvh {
    /// Builds the tree over items' boxes.
    pub fn build(boxes: &[Aabb]) -> Self {
        let mut items: Vec<u32> = (0..boxes.len() as u32)
            .filter(|&i| boxes[i as usize].is_finite())
            .collect();
        let mut nodes = Vec::with_capacity(items.len());
        if !items.is_empty() {
            split(boxes, &mut items, 0, &mut nodes);
        }
        let boxes = items.iter().map(|&item| boxes[item as usize]).collect();
        Self {
            nodes,
            items,
            boxes,
        }
    }

    /// Builds the tree over triangles; item numbers are face numbers.
    pub fn of_faces(positions: &[[f32; 3]], faces: &[[u32; 3]]) -> Self {
        let boxes: Vec<Aabb> = faces
            .iter()
            .map(|f| Aabb::of(&f.map(|v| positions[v as usize])))
            .collect();
        Self::build(&boxes)
    }

    /// Box around all items, [`Aabb::EMPTY`] without items.
    pub fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, |node| node.aabb)
    }

    /// Calls `found` with every item whose box overlaps `aabb`, in the tree's order.
    pub fn overlapping(&self, aabb: &Aabb, mut found: impl FnMut(u32)) {
        // Median splits halve the items: 32 levels hold any u32 number of them.
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            if !node.aabb.overlaps(aabb) {
                continue;
            }
            if node.count == 0 {
                stack[depth] = node.first;
                stack[depth + 1] = index + 1;
                depth += 2;
            } else {
                let range = node.first as usize..(node.first + node.count) as usize;
                for (item, item_box) in self.items[range.clone()].iter().zip(&self.boxes[range]) {
                    if item_box.overlaps(aabb) {
                        found(*item);
                    }
                }
            }
        }
    }
}

fn split(boxes: &[Aabb], items: &mut [u32], offset: usize, nodes: &mut Vec<Node>) {
    let aabb = items
        .iter()
        .fold(Aabb::EMPTY, |union, &i| union.union(&boxes[i as usize]));
    let node = nodes.len();
    nodes.push(Node {
        aabb,
        first: offset as u32,
        count: items.len() as u32,
    });
    if items.len() <= LEAF {
        return;
    }
    let spread = |axis: usize| {
        let centres = items
            .iter()
            .map(|&i| boxes[i as usize].doubled_centre(axis));
        let (low, high) = centres.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), c| {
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
        let key = |i: u32| boxes[i as usize].doubled_centre(axis);
        key(a).total_cmp(&key(b)).then(a.cmp(&b))
    });
    let (left, right) = items.split_at_mut(middle);
    split(boxes, left, offset, nodes);
    nodes[node].first = nodes.len() as u32;
    nodes[node].count = 0;
    split(boxes, right, offset + middle, nodes);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_overlap_is_found_once_and_nothing_else() {
        let mut boxes: Vec<Aabb> = (0..300)
            .map(|i| {
                let low = [1.3f32, 2.9, 0.7].map(|f| (i as f32 * f).sin() * 5.0);
                let size = (i as f32 * 0.37).cos().abs();
                Aabb {
                    low,
                    high: low.map(|x| x + size),
                }
            })
            .collect();
        boxes.extend([boxes[7]; 20]);
        boxes[13].low[1] = f32::NAN;
        let tree = Bvh::build(&boxes);
        for query in boxes.iter().map(|b| b.grown(0.5)) {
            let mut found = Vec::new();
            tree.overlapping(&query, |item| found.push(item));
            found.sort_unstable();
            let expected: Vec<u32> = (0..boxes.len() as u32)
                .filter(|&i| i != 13 && boxes[i as usize].overlaps(&query))
                .collect();
            assert_eq!(found, expected);
        }
        assert_eq!(Bvh::build(&[]).bounds(), Aabb::EMPTY);
    }
}

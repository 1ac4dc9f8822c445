//! From a field to triangles: marching tetrahedra, then cuts along surfaces
//! `h(x) = 0` that either remove what lies beyond or divide panels.

use std::collections::{BTreeMap, HashMap};

use drape_geometry::mesh::boundary_edges;
use glam::DVec3;

use super::field::{Field, gradient};

/// A function whose zero set cuts a garment.
pub(super) type Cut = Box<dyn Fn(DVec3) -> f64 + Send + Sync>;

/// Vertices this near to a cut (units) are moved onto it instead of splitting an edge.
const SNAP: f64 = 0.02;

/// Triangles with labels (panels) and, per vertex, the set of cuts it lies on.
#[derive(Clone, Debug, Default)]
pub(super) struct Surface {
    pub positions: Vec<DVec3>,
    pub cuts: Vec<u32>,
    pub faces: Vec<[u32; 3]>,
    pub labels: Vec<u32>,
}

impl Surface {
    /// Zero surface of a field, outward normals along its gradient.
    pub fn extract(field: &Field) -> Self {
        // Kuhn's six tetrahedra around the diagonal 0–7 of a cube (corner bits: x, y, z).
        const TETRAHEDRA: [[usize; 4]; 6] = [
            [0, 1, 3, 7],
            [0, 1, 5, 7],
            [0, 2, 3, 7],
            [0, 2, 6, 7],
            [0, 4, 5, 7],
            [0, 4, 6, 7],
        ];
        let mut out = Self::default();
        let mut on_edge: HashMap<(usize, usize), u32> = HashMap::new();
        for z in 0..field.size[2] - 1 {
            for y in 0..field.size[1] - 1 {
                for x in 0..field.size[0] - 1 {
                    let node = |c: usize| [x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)];
                    let value = |c: usize| field.values[field.index(node(c))];
                    let negative = (0..8).filter(|&c| value(c) < 0.0).count();
                    if negative == 0 || negative == 8 {
                        continue;
                    }
                    let mut cross = |out: &mut Self, a: usize, b: usize| {
                        let (i, j) = (field.index(node(a)), field.index(node(b)));
                        let key = (i.min(j), i.max(j));
                        *on_edge.entry(key).or_insert_with(|| {
                            let t = value(a) / (value(a) - value(b));
                            let p = field.at(node(a)).lerp(field.at(node(b)), t);
                            out.positions.push(p);
                            out.positions.len() as u32 - 1
                        })
                    };
                    for t in TETRAHEDRA {
                        let inside: Vec<usize> =
                            t.into_iter().filter(|&c| value(c) < 0.0).collect();
                        let outside: Vec<usize> =
                            t.into_iter().filter(|&c| value(c) >= 0.0).collect();
                        let loop_of: Vec<u32> = match inside.len() {
                            1 => outside
                                .iter()
                                .map(|&o| cross(&mut out, inside[0], o))
                                .collect(),
                            3 => inside
                                .iter()
                                .map(|&i| cross(&mut out, i, outside[0]))
                                .collect(),
                            2 => [(0, 0), (0, 1), (1, 1), (1, 0)]
                                .iter()
                                .map(|&(i, o)| cross(&mut out, inside[i], outside[o]))
                                .collect(),
                            _ => continue,
                        };
                        for k in 1..loop_of.len() - 1 {
                            let mut f = [loop_of[0], loop_of[k], loop_of[k + 1]];
                            let [a, b, c] = f.map(|v| out.positions[v as usize]);
                            let outward = field.gradient((a + b + c) / 3.0);
                            if (b - a).cross(c - a).dot(outward) < 0.0 {
                                f.swap(1, 2);
                            }
                            out.faces.push(f);
                        }
                    }
                }
            }
        }
        out.cuts = vec![0; out.positions.len()];
        out.labels = vec![0; out.faces.len()];
        out
    }

    /// Cuts along `h = 0`; where `h > 0` faces are removed, or get the label's bit.
    pub fn cut(&mut self, h: &Cut, bit: u32, remove: bool) {
        for p in &mut self.positions {
            let value = h(*p);
            if value.abs() < SNAP {
                let g = gradient(h, *p, 1e-3);
                *p -= g * (value / g.length_squared().max(1e-9));
            }
        }
        let sign: Vec<i32> = self
            .positions
            .iter()
            .map(|&p| {
                let value = h(p);
                if value.abs() < 0.2 * SNAP {
                    0
                } else {
                    value.signum() as i32
                }
            })
            .collect();
        let mut on_edge: HashMap<(u32, u32), u32> = HashMap::new();
        let mut faces = Vec::with_capacity(self.faces.len());
        let mut labels = Vec::with_capacity(self.faces.len());
        for (f, label) in std::mem::take(&mut self.faces)
            .into_iter()
            .zip(std::mem::take(&mut self.labels))
        {
            let mut sides: [Vec<u32>; 2] = Default::default();
            for k in 0..3 {
                let (a, b) = (f[k], f[(k + 1) % 3]);
                let (sa, sb) = (sign[a as usize], sign[b as usize]);
                match sa {
                    -1 => sides[0].push(a),
                    1 => sides[1].push(a),
                    _ => sides.iter_mut().for_each(|s| s.push(a)),
                }
                if sa * sb < 0 {
                    let m = *on_edge.entry((a.min(b), a.max(b))).or_insert_with(|| {
                        let (mut p, mut q) =
                            (self.positions[a as usize], self.positions[b as usize]);
                        let inside = h(p) < 0.0;
                        for _ in 0..30 {
                            let m = 0.5 * (p + q);
                            if (h(m) < 0.0) == inside { p = m } else { q = m }
                        }
                        self.positions.push(0.5 * (p + q));
                        let common = self.cuts[a as usize] & self.cuts[b as usize];
                        self.cuts.push(common);
                        self.positions.len() as u32 - 1
                    });
                    sides.iter_mut().for_each(|s| s.push(m));
                    self.cuts[m as usize] |= 1 << bit;
                }
            }
            let beyond = f.iter().any(|&v| sign[v as usize] > 0);
            let before = f.iter().any(|&v| sign[v as usize] < 0);
            for (side, polygon) in sides.iter().enumerate() {
                let present = if side == 0 { before || !beyond } else { beyond };
                if !present || polygon.len() < 3 || (side == 1 && remove) {
                    continue;
                }
                for k in 1..polygon.len() - 1 {
                    faces.push([polygon[0], polygon[k], polygon[k + 1]]);
                    labels.push(label | (side as u32) << bit);
                }
            }
        }
        self.faces = faces;
        self.labels = labels;
        for (v, s) in sign.iter().enumerate() {
            if *s == 0 {
                self.cuts[v] |= 1 << bit;
            }
        }
    }

    /// Keeps the largest piece and the vertices in use; what hangs at a vertex only is
    /// another piece.
    pub fn keep_largest(&mut self) {
        let mut parent: Vec<u32> = (0..self.faces.len() as u32).collect();
        fn find(parent: &mut [u32], mut a: u32) -> u32 {
            while parent[a as usize] != a {
                parent[a as usize] = parent[parent[a as usize] as usize];
                a = parent[a as usize];
            }
            a
        }
        let mut at_edge: HashMap<(u32, u32), u32> = HashMap::new();
        for (i, f) in self.faces.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (f[k], f[(k + 1) % 3]);
                let other = *at_edge.entry((a.min(b), a.max(b))).or_insert(i as u32);
                let (a, b) = (find(&mut parent, i as u32), find(&mut parent, other));
                parent[a.max(b) as usize] = a.min(b);
            }
        }
        let piece: Vec<u32> = (0..self.faces.len() as u32)
            .map(|f| find(&mut parent, f))
            .collect();
        let mut count = vec![0u32; self.faces.len()];
        piece.iter().for_each(|&p| count[p as usize] += 1);
        let Some(best) = (0..count.len()).max_by_key(|&i| (count[i], usize::MAX - i)) else {
            return;
        };
        let keep: Vec<bool> = piece.iter().map(|&p| p as usize == best).collect();
        let mut flags = keep.iter();
        self.faces
            .retain(|_| *flags.next().expect("one flag a face"));
        let mut flags = keep.iter();
        self.labels
            .retain(|_| *flags.next().expect("one flag a face"));
        self.compact();
    }

    /// The middle of a boundary edge that does not lie on a cut, if there is one: there the
    /// surface left the grid that it was made on.
    pub fn torn(&self) -> Option<DVec3> {
        let off_cuts = |&[a, b]: &[u32; 2]| self.cuts[a as usize] & self.cuts[b as usize] == 0;
        boundary_edges(&self.faces)
            .into_iter()
            .find(off_cuts)
            .map(|edge| 0.5 * (self.positions[edge[0] as usize] + self.positions[edge[1] as usize]))
    }

    /// Forgets cuts that a vertex only touches: a cut stays where an edge of the
    /// boundary or between two labels runs along it.
    pub fn keep_features(&mut self) {
        let mut edges: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
        for (f, label) in self.faces.iter().zip(&self.labels) {
            for k in 0..3 {
                let (a, b) = (f[k], f[(k + 1) % 3]);
                edges.entry([a.min(b), a.max(b)]).or_default().push(*label);
            }
        }
        let mut along = vec![0; self.positions.len()];
        for ([a, b], labels) in edges {
            if labels.len() == 1 || labels[0] != labels[1] {
                let common = self.cuts[a as usize] & self.cuts[b as usize];
                along[a as usize] |= common;
                along[b as usize] |= common;
            }
        }
        self.cuts = along;
    }

    /// Drops unused vertices.
    pub fn compact(&mut self) {
        let mut index = vec![u32::MAX; self.positions.len()];
        let (mut positions, mut cuts) = (Vec::new(), Vec::new());
        for v in self.faces.iter_mut().flatten() {
            let slot = &mut index[*v as usize];
            if *slot == u32::MAX {
                *slot = positions.len() as u32;
                positions.push(self.positions[*v as usize]);
                cuts.push(self.cuts[*v as usize]);
            }
            *v = *slot;
        }
        (self.positions, self.cuts) = (positions, cuts);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_boundary_beside_its_cut_is_torn() {
        // A square whose lower side lies on cut 0, the right one on cut 1 and so on.
        let mut surface = Surface {
            positions: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
                .map(|[x, y]| DVec3::new(x, y, 0.0))
                .to_vec(),
            cuts: vec![0b1001, 0b0011, 0b0110, 0b1100],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            labels: vec![0, 0],
        };
        assert_eq!(surface.torn(), None);
        surface.cuts[3] = 0b1000;
        assert_eq!(surface.torn(), Some(DVec3::new(0.5, 1.0, 0.0)));
    }

    #[test]
    fn a_piece_that_hangs_at_a_vertex_is_not_kept() {
        // Two triangles with a common edge, and a third that touches one corner.
        let mut surface = Surface {
            positions: (0..6).map(|k| DVec3::new(f64::from(k), 0.0, 0.0)).collect(),
            cuts: vec![0, 0, 0, 1, 0, 0],
            faces: vec![[3, 4, 5], [0, 1, 2], [2, 1, 3]],
            labels: vec![7, 8, 9],
        };
        surface.keep_largest();
        assert_eq!(surface.faces, [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(surface.labels, [8, 9]);
        assert_eq!(surface.cuts, [0, 0, 0, 1]);
    }
}

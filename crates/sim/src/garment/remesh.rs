//! Isotropic remeshing that keeps hems and seams.
//!
//! Botsch and Kobbelt, "A Remeshing Approach to Multiresolution Modeling"
//! (2004): split long edges, collapse short ones, flip towards valence six,
//! smooth tangentially, project back. Edges between labels and on the boundary
//! are features: their vertices stay on their cuts and move only along them.

use glam::DVec3;

use super::field::{Field, gradient};
use super::surface::{Cut, Surface};

/// Edges shorter than this multiple of the target go even where the mesh is folded and
/// their going does not unfold it.
const SPECK: f64 = 0.25;

struct Remesher<'a> {
    field: &'a Field,
    cuts: &'a [&'a Cut],
    edge: f64,
    mesh: Surface,
    alive: Vec<bool>,
    around: Vec<Vec<u32>>,
}

/// Remeshes `mesh` to edges of about `edge` units; `cuts[k]` belongs to bit `k`.
pub(super) fn remesh(
    mesh: Surface,
    field: &Field,
    cuts: &[&Cut],
    edge: f64,
    rounds: usize,
) -> Surface {
    let mut around = vec![Vec::new(); mesh.positions.len()];
    for (i, f) in mesh.faces.iter().enumerate() {
        f.iter().for_each(|&v| around[v as usize].push(i as u32));
    }
    let alive = vec![true; mesh.faces.len()];
    let mut work = Remesher {
        field,
        cuts,
        edge,
        mesh,
        alive,
        around,
    };
    for round in 0..rounds {
        work.split_long();
        work.collapse_short();
        work.flip_edges();
        let last = round + 1 == rounds;
        for _ in 0..if last { 4 } else { 2 } {
            work.smooth();
        }
    }
    let mut out = work.mesh;
    let mut flags = work.alive.iter();
    out.faces
        .retain(|_| *flags.next().expect("one flag a face"));
    let mut flags = work.alive.iter();
    out.labels
        .retain(|_| *flags.next().expect("one flag a face"));
    out.compact();
    out
}

impl Remesher<'_> {
    fn p(&self, v: u32) -> DVec3 {
        self.mesh.positions[v as usize]
    }

    fn mask(&self, v: u32) -> u32 {
        self.mesh.cuts[v as usize]
    }

    fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges = Vec::new();
        for (i, f) in self.mesh.faces.iter().enumerate() {
            if self.alive[i] {
                for k in 0..3 {
                    let (a, b) = (f[k], f[(k + 1) % 3]);
                    edges.push([a.min(b), a.max(b)]);
                }
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    fn shared(&self, a: u32, b: u32) -> Vec<u32> {
        let of_b = &self.around[b as usize];
        self.around[a as usize]
            .iter()
            .copied()
            .filter(|f| of_b.contains(f))
            .collect()
    }

    fn is_feature(&self, shared: &[u32]) -> bool {
        shared.len() != 2
            || self.mesh.labels[shared[0] as usize] != self.mesh.labels[shared[1] as usize]
    }

    fn neighbours(&self, v: u32) -> Vec<u32> {
        let mut out: Vec<u32> = self.around[v as usize]
            .iter()
            .flat_map(|&f| self.mesh.faces[f as usize])
            .filter(|&w| w != v)
            .collect();
        out.sort_unstable();
        out.dedup();
        out
    }

    fn normal(&self, f: [u32; 3]) -> DVec3 {
        let [a, b, c] = f.map(|v| self.p(v));
        (b - a).cross(c - a)
    }

    fn split_long(&mut self) {
        let limit = 4.0 / 3.0 * self.edge;
        let mut edges = self.edges();
        edges.retain(|&[a, b]| self.p(a).distance(self.p(b)) > limit);
        edges.sort_by(|x, y| {
            let d = |e: &[u32; 2]| self.p(e[0]).distance_squared(self.p(e[1]));
            d(y).total_cmp(&d(x)).then(x.cmp(y))
        });
        for [a, b] in edges {
            let shared = self.shared(a, b);
            if shared.is_empty() {
                continue;
            }
            let m = self.mesh.positions.len() as u32;
            self.mesh.positions.push(0.5 * (self.p(a) + self.p(b)));
            let mask = if self.is_feature(&shared) {
                self.mask(a) & self.mask(b)
            } else {
                0
            };
            self.mesh.cuts.push(mask);
            self.around.push(Vec::new());
            for f in shared {
                let old = self.mesh.faces[f as usize];
                let new = self.mesh.faces.len() as u32;
                self.mesh.faces[f as usize] = old.map(|v| if v == b { m } else { v });
                let other = old.map(|v| if v == a { m } else { v });
                self.mesh.faces.push(other);
                self.mesh.labels.push(self.mesh.labels[f as usize]);
                self.alive.push(true);
                self.around[b as usize].retain(|&x| x != f);
                for v in other {
                    self.around[v as usize].push(new);
                }
                self.around[m as usize].push(f);
            }
            self.project(m);
        }
    }

    fn collapse_short(&mut self) {
        let limit = 0.8 * self.edge;
        let mut edges = self.edges();
        edges.retain(|&[a, b]| self.p(a).distance(self.p(b)) < limit);
        edges.sort_by(|x, y| {
            let d = |e: &[u32; 2]| self.p(e[0]).distance_squared(self.p(e[1]));
            d(x).total_cmp(&d(y)).then(x.cmp(y))
        });
        for [a, b] in edges {
            if self.p(a).distance(self.p(b)) < limit && !self.collapse(a, b) {
                self.collapse(b, a);
            }
        }
    }

    /// Removes `a` into `b`; says whether it did.
    fn collapse(&mut self, a: u32, b: u32) -> bool {
        let shared = self.shared(a, b);
        if shared.is_empty() || shared.len() > 2 {
            return false;
        }
        let (ma, mb) = (self.mask(a), self.mask(b));
        let on_feature = self.is_feature(&shared);
        if ma != 0 && (!on_feature || ma & !mb != 0) {
            return false;
        }
        let nb = self.neighbours(b);
        let common = self
            .neighbours(a)
            .into_iter()
            .filter(|v| nb.contains(v))
            .count();
        if common != shared.len() {
            return false;
        }
        let target = if ma == mb {
            0.5 * (self.p(a) + self.p(b))
        } else {
            self.p(b)
        };
        // Against the field's normal, not the old face's: slivers have none to speak of.
        // A place that is folded already may stay as bad as it is.
        let bad = |q: [DVec3; 3]| {
            let n = (q[1] - q[0]).cross(q[2] - q[0]);
            let outward = self
                .field
                .gradient((q[0] + q[1] + q[2]) / 3.0)
                .normalize_or_zero();
            n.length() < 1e-4 * self.edge * self.edge || n.dot(outward) < 0.3 * n.length()
        };
        let limit = 1.3 * self.edge;
        let (mut before, mut after) = (0, 0);
        for (v, other) in [(a, b), (b, a)] {
            for &f in &self.around[v as usize] {
                let face = self.mesh.faces[f as usize];
                let old = face.map(|w| self.p(w));
                if face.contains(&other) {
                    before += usize::from(v == a && bad(old));
                    continue;
                }
                let q = face.map(|w| if w == v { target } else { self.p(w) });
                before += usize::from(bad(old));
                after += usize::from(bad(q));
                let longest = |q: [DVec3; 3]| {
                    (0..3)
                        .map(|k| q[k].distance(q[(k + 1) % 3]))
                        .fold(0.0, f64::max)
                };
                if longest(q) > limit.max(longest(old)) {
                    return false;
                }
            }
        }
        let speck = self.p(a).distance(self.p(b)) < SPECK * self.edge;
        if after > 0 && after + usize::from(!speck) > before {
            return false;
        }
        for f in shared {
            self.alive[f as usize] = false;
            for v in self.mesh.faces[f as usize] {
                self.around[v as usize].retain(|&x| x != f);
            }
        }
        for f in std::mem::take(&mut self.around[a as usize]) {
            let face = &mut self.mesh.faces[f as usize];
            *face = face.map(|v| if v == a { b } else { v });
            self.around[b as usize].push(f);
        }
        self.mesh.positions[b as usize] = target;
        self.project(b);
        true
    }

    fn flip_edges(&mut self) {
        for [a, b] in self.edges() {
            let shared = self.shared(a, b);
            if self.is_feature(&shared) {
                continue;
            }
            let opposite = |f: u32| {
                let face = self.mesh.faces[f as usize];
                face.into_iter()
                    .find(|&v| v != a && v != b)
                    .expect("a third corner")
            };
            let (c, d) = (opposite(shared[0]), opposite(shared[1]));
            if c == d || !self.shared(c, d).is_empty() {
                continue;
            }
            // Interior vertices want six neighbours, those on a feature four (on each side three).
            let excess = |v: u32, change: i32| {
                let ideal = if self.mask(v) == 0 {
                    6
                } else if self.on_boundary(v) {
                    3
                } else {
                    6
                };
                (self.around[v as usize].len() as i32 + change - ideal).pow(2)
            };
            let before: i32 = [a, b, c, d].iter().map(|&v| excess(v, 0)).sum();
            let after = excess(a, -1) + excess(b, -1) + excess(c, 1) + excess(d, 1);
            // A face with all corners on one cut is a sliver: its inner edge goes.
            let ear = |v: u32| self.mask(a) & self.mask(b) & self.mask(v) != 0;
            let new_ear = |v: u32| self.mask(c) & self.mask(d) & self.mask(v) != 0;
            let was_ear = ear(c) || ear(d);
            if new_ear(a) || new_ear(b) || (after >= before && !was_ear) {
                continue;
            }
            // Keep the order of shared[0], in which a → b or b → a.
            let f0 = self.mesh.faces[shared[0] as usize];
            let k = f0.iter().position(|&v| v == a).expect("a corner");
            let (s, e) = if f0[(k + 1) % 3] == b { (a, b) } else { (b, a) };
            let (n0, n1) = ([c, s, d], [d, e, c]);
            let old = (self.normal(f0) + self.normal(self.mesh.faces[shared[1] as usize]))
                .normalize_or_zero();
            let fair = |f: [u32; 3]| {
                let n = self.normal(f);
                let least = if was_ear { 0.0 } else { 0.075 };
                n.dot(old) > 0.6 * n.length() && n.length() > least * self.edge * self.edge
            };
            if !fair(n0) || !fair(n1) {
                continue;
            }
            for (f, new) in shared.iter().zip([n0, n1]) {
                for v in self.mesh.faces[*f as usize] {
                    self.around[v as usize].retain(|x| x != f);
                }
                self.mesh.faces[*f as usize] = new;
                for v in new {
                    self.around[v as usize].push(*f);
                }
            }
        }
    }

    fn on_boundary(&self, v: u32) -> bool {
        self.neighbours(v)
            .into_iter()
            .any(|w| self.shared(v, w).len() == 1)
    }

    fn smooth(&mut self) {
        for v in 0..self.mesh.positions.len() as u32 {
            let mask = self.mask(v);
            if self.around[v as usize].is_empty() || mask.count_ones() > 1 {
                continue;
            }
            let mut ring = self.neighbours(v);
            if mask != 0 {
                ring.retain(|&w| self.is_feature(&self.shared(v, w)));
                if ring.len() != 2 {
                    continue;
                }
            }
            let mean = ring.iter().map(|&w| self.p(w)).sum::<DVec3>() / ring.len() as f64;
            let n = self.field.gradient(self.p(v)).normalize_or_zero();
            let step = mean - self.p(v);
            self.mesh.positions[v as usize] += 0.6 * (step - n * step.dot(n));
            self.project(v);
        }
    }

    /// Newton steps onto the field's zero surface and the vertex's cuts in turn.
    fn project(&mut self, v: u32) {
        let mut p = self.p(v);
        let mask = self.mask(v);
        for _ in 0..if mask == 0 { 2 } else { 5 } {
            let g = self.field.gradient(p);
            p -= step(self.field.value(p), g);
            for (k, h) in self.cuts.iter().enumerate() {
                if mask >> k & 1 == 1 {
                    p -= step(h(p), gradient(h, p, 1e-3));
                }
            }
        }
        self.mesh.positions[v as usize] = p;
    }
}

fn step(value: f64, gradient: DVec3) -> DVec3 {
    let move_by = gradient * (value / gradient.length_squared().max(0.04));
    move_by.clamp_length_max(0.2)
}

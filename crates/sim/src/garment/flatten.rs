//! Flattens panels: as-rigid-as-possible parametrisation (Liu et al., "A
//! Local/Global Approach to Mesh Parameterization", 2008), so that all panels
//! have one texel density, then packs them on shelves.

use glam::{DMat2, DVec2, DVec3};

/// A flattened panel: where its vertices lie, in units, in ascending order of the garment's vertices.
pub(super) struct Flat {
    pub uv: Vec<DVec2>,
    /// Corner indices into `uv`.
    pub faces: Vec<[u32; 3]>,
}

/// Flattens `faces`; `start` places a vertex in the plane well enough to begin with.
pub(super) fn flatten(
    positions: &[DVec3],
    faces: &[[u32; 3]],
    start: &dyn Fn(DVec3) -> DVec2,
) -> Flat {
    let mut vertices: Vec<u32> = faces.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let local = |v: u32| vertices.binary_search(&v).expect("a vertex of the panel") as u32;
    let faces: Vec<[u32; 3]> = faces.iter().map(|f| f.map(local)).collect();
    let mut uv: Vec<DVec2> = vertices
        .iter()
        .map(|&v| start(positions[v as usize]))
        .collect();

    // Each triangle laid flat, and its cotangent weights (edge k faces corner k).
    let mut flat = Vec::new();
    let mut weight = Vec::new();
    let mut diagonal = vec![1e-9; uv.len()];
    for f in &faces {
        let [a, b, c] = f.map(|v| positions[vertices[v as usize] as usize]);
        let x = (b - a).normalize();
        let n = x.cross(c - a).normalize();
        let y = n.cross(x);
        let q = [
            DVec2::ZERO,
            DVec2::new((b - a).dot(x), 0.0),
            DVec2::new((c - a).dot(x), (c - a).dot(y)),
        ];
        let w = [0, 1, 2].map(|k: usize| {
            let (u, v) = (q[(k + 1) % 3] - q[k], q[(k + 2) % 3] - q[k]);
            (u.dot(v) / u.perp_dot(v).abs().max(1e-9)).clamp(0.05, 10.0)
        });
        for (k, w) in w.into_iter().enumerate() {
            diagonal[f[(k + 1) % 3] as usize] += w;
            diagonal[f[(k + 2) % 3] as usize] += w;
        }
        flat.push(q);
        weight.push(w);
    }
    let apply = |x: &[DVec2]| -> Vec<DVec2> {
        let mut y: Vec<DVec2> = x.iter().map(|p| *p * 1e-9).collect();
        for (f, w) in faces.iter().zip(&weight) {
            for (k, w) in w.iter().enumerate() {
                let (i, j) = (f[(k + 1) % 3] as usize, f[(k + 2) % 3] as usize);
                let d = (x[i] - x[j]) * *w;
                y[i] += d;
                y[j] -= d;
            }
        }
        y
    };
    for _ in 0..40 {
        let mut right = vec![DVec2::ZERO; uv.len()];
        for ((f, q), w) in faces.iter().zip(&flat).zip(&weight) {
            // Closest rotation of the weighted cross covariance.
            let mut m = DMat2::ZERO;
            for (k, w) in w.iter().enumerate() {
                let (i, j) = ((k + 1) % 3, (k + 2) % 3);
                let e = q[i] - q[j];
                let u = uv[f[i] as usize] - uv[f[j] as usize];
                m += DMat2::from_cols(u * e.x, u * e.y) * *w;
            }
            let turn =
                DVec2::new(m.x_axis.x + m.y_axis.y, m.x_axis.y - m.y_axis.x).normalize_or(DVec2::X);
            for (k, w) in w.iter().enumerate() {
                let (i, j) = ((k + 1) % 3, (k + 2) % 3);
                let e = turn.rotate(q[i] - q[j]) * *w;
                right[f[i] as usize] += e;
                right[f[j] as usize] -= e;
            }
        }
        conjugate_gradients(&apply, &diagonal, &right, &mut uv);
    }
    let mut flat = Flat { uv, faces };
    flat.untangle();
    flat
}

fn conjugate_gradients(
    apply: &dyn Fn(&[DVec2]) -> Vec<DVec2>,
    diagonal: &[f64],
    right: &[DVec2],
    x: &mut [DVec2],
) {
    let dot = |a: &[DVec2], b: &[DVec2]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
    let precondition =
        |r: &[DVec2]| -> Vec<DVec2> { r.iter().zip(diagonal).map(|(r, d)| *r / *d).collect() };
    let mut r: Vec<DVec2> = right.iter().zip(apply(x)).map(|(b, a)| *b - a).collect();
    let mut z = precondition(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let target = 1e-12 * dot(right, right).max(1e-12);
    for _ in 0..60 {
        if dot(&r, &r) < target {
            break;
        }
        let ap = apply(&p);
        let alpha = rz / dot(&p, &ap);
        for i in 0..x.len() {
            x[i] += p[i] * alpha;
            r[i] -= ap[i] * alpha;
        }
        z = precondition(&r);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        for (p, z) in p.iter_mut().zip(&z) {
            *p = *z + *p * beta;
        }
    }
}

impl Flat {
    /// Moves corners of turned-over triangles to the mean of their neighbours,
    /// a few times: the usual cause is one sliver at a seam.
    fn untangle(&mut self) {
        for _ in 0..20 {
            let turned: Vec<[u32; 3]> = self
                .faces
                .iter()
                .filter(|f| self.is_turned(f))
                .copied()
                .collect();
            if turned.is_empty() {
                return;
            }
            for v in turned.into_iter().flatten() {
                let (mut sum, mut count) = (DVec2::ZERO, 0.0);
                for f in self.faces.iter().filter(|f| f.contains(&v)) {
                    for &w in f.iter().filter(|&&w| w != v) {
                        sum += self.uv[w as usize];
                        count += 1.0;
                    }
                }
                let at = &mut self.uv[v as usize];
                *at = at.lerp(sum / count, 0.3);
            }
        }
    }

    fn is_turned(&self, f: &[u32; 3]) -> bool {
        let [a, b, c] = f.map(|v| self.uv[v as usize]);
        (b - a).perp_dot(c - a) <= 0.0
    }

    /// Triangles that are turned over or have lost their area.
    pub fn flipped(&self) -> usize {
        self.faces.iter().filter(|f| self.is_turned(f)).count()
    }

    fn bounds(&self) -> (DVec2, DVec2) {
        let low = self.uv.iter().fold(DVec2::INFINITY, |a, b| a.min(*b));
        let high = self.uv.iter().fold(DVec2::NEG_INFINITY, |a, b| a.max(*b));
        (low, high)
    }
}

/// Moves panels onto shelves of a square of `side` units, the highest first and each onto
/// the first shelf with room for it; false when they do not fit.
pub(super) fn pack(panels: &mut [Flat], side: f64, gap: f64) -> bool {
    let mut order: Vec<usize> = (0..panels.len()).collect();
    let size = |p: &Flat| p.bounds().1 - p.bounds().0;
    order.sort_by(|&a, &b| {
        size(&panels[b])
            .y
            .total_cmp(&size(&panels[a]).y)
            .then(a.cmp(&b))
    });
    // Where the next panel of each shelf goes; no panel is higher than its shelf's first.
    let mut shelves: Vec<DVec2> = Vec::new();
    let mut top = gap;
    for i in order {
        let (low, high) = panels[i].bounds();
        let extent = high - low;
        let right_end = |at: &DVec2| at.x + extent.x + gap;
        let shelf = match shelves.iter().position(|at| right_end(at) <= side) {
            Some(shelf) => shelf,
            None => {
                shelves.push(DVec2::new(gap, top));
                top += extent.y + gap;
                shelves.len() - 1
            }
        };
        let at = &mut shelves[shelf];
        if right_end(at) > side || top > side {
            return false;
        }
        for p in &mut panels[i].uv {
            *p += *at - low;
        }
        at.x += extent.x + gap;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rectangle(width: f64, height: f64) -> Flat {
        let uv = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]];
        Flat {
            uv: uv.map(DVec2::from_array).to_vec(),
            faces: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    fn packed(sizes: &[[f64; 2]], side: f64, gap: f64) -> Option<Vec<(DVec2, DVec2)>> {
        let mut panels: Vec<Flat> = sizes.iter().map(|&[w, h]| rectangle(w, h)).collect();
        pack(&mut panels, side, gap).then(|| panels.iter().map(Flat::bounds).collect())
    }

    #[test]
    fn packed_panels_lie_in_the_square_and_keep_their_gap() {
        // A wide dress: two skirts that cannot lie side by side leave room beside them.
        let sizes = [[13.0, 12.0], [13.0, 11.0], [10.5, 6.0], [10.5, 5.0]];
        let boxes = packed(&sizes, 25.0, 0.3).expect("there is room");
        for (i, (low, high)) in boxes.iter().enumerate() {
            assert!((*high - *low - DVec2::from_array(sizes[i])).length() < 1e-12);
            assert!(low.min_element() > 0.29 && high.max_element() < 24.71);
            for (other_low, other_high) in &boxes[i + 1..] {
                let apart = (*other_low - *high).max(*low - *other_high);
                assert!(apart.max_element() > 0.29, "{apart}");
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_said_and_what_just_fits_is_packed() {
        assert!(packed(&[[9.0, 9.0]], 10.0, 0.5).is_some());
        assert!(packed(&[[9.01, 9.0]], 10.0, 0.5).is_none());
        assert!(packed(&[[9.0, 9.01]], 10.0, 0.5).is_none());
        // A third panel needs a shelf of its own, for which there is no height.
        assert!(packed(&[[4.0, 5.0]; 2], 10.0, 0.5).is_some());
        assert!(packed(&[[4.0, 5.0]; 3], 10.0, 0.5).is_none());
    }
}

//! Scalar fields on a grid, negative inside, whose zero surface is a garment.
//!
//! A garment's surface is the zero set of a smooth union of two fields: the
//! signed distance to the body less the ease, and a *tube* around the convex
//! hulls of the trunk's horizontal sections (cloth spans hollows). Garments of
//! an outfit nest by construction: the outer field is the minimum of its own
//! and the inner one less the layers' gap.

use drape_geometry::closest::point_triangle;
use glam::{DVec2, DVec3};

use super::surface::Cut;

/// Beyond this distance from the body (units) the signed distance is clamped.
pub(super) const BAND: f64 = 0.8;

/// Values at the nodes of a regular grid.
#[derive(Clone, Debug)]
pub(super) struct Field {
    pub low: DVec3,
    pub step: f64,
    pub size: [usize; 3],
    pub values: Vec<f64>,
}

impl Field {
    /// Signed distance to a closed mesh, clamped to the band, on a grid that leaves a
    /// margin around the mesh and holds all between `reach`'s two corners, seen from above.
    pub fn body(
        positions: &[[f32; 3]],
        faces: &[[u32; 3]],
        step: f64,
        margin: DVec3,
        reach: [DVec2; 2],
    ) -> Self {
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        let p: Vec<DVec3> = positions.iter().map(|&p| vector(p)).collect();
        for &x in &p {
            low = low.min(x);
            high = high.max(x);
        }
        low = (low - margin).min(reach[0].extend(f64::INFINITY));
        high = (high + margin).max(reach[1].extend(f64::NEG_INFINITY));
        let size = ((high - low) / step).ceil().to_array();
        let size = size.map(|n| n as usize + 1);
        let count = size[0] * size[1] * size[2];
        let mut field = Self {
            low,
            step,
            size,
            values: vec![BAND; count],
        };
        for f in faces {
            let t = f.map(|v| p[v as usize]);
            let centre = (t[0] + t[1] + t[2]) / 3.0;
            let radius = t.iter().map(|x| x.distance(centre)).fold(0.0, f64::max);
            field.near(t, BAND, |node, at| {
                if at.distance_squared(centre) > (*node + radius).powi(2) {
                    return;
                }
                let d = point_triangle(at.to_array(), t.map(|x| x.to_array())).distance2;
                if d < node.powi(2) {
                    *node = d.sqrt();
                }
            });
        }
        field.negate_inside(&p, faces);
        field
    }

    /// Calls `visit` for the nodes of the box around a triangle.
    fn near(&mut self, t: [DVec3; 3], margin: f64, mut visit: impl FnMut(&mut f64, DVec3)) {
        let low = t[0].min(t[1]).min(t[2]) - DVec3::splat(margin);
        let high = t[0].max(t[1]).max(t[2]) + DVec3::splat(margin);
        let from = ((low - self.low) / self.step).ceil().to_array();
        let to = ((high - self.low) / self.step).floor().to_array();
        let range = |k: usize| {
            (from[k].max(0.0) as usize)..=(to[k].min(self.size[k] as f64 - 1.0) as usize)
        };
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let at = self.at([x, y, z]);
                    let i = self.index([x, y, z]);
                    visit(&mut self.values[i], at);
                }
            }
        }
    }

    /// Winding number along vertical lines through the nodes.
    fn negate_inside(&mut self, p: &[DVec3], faces: &[[u32; 3]]) {
        let mut crossings: Vec<Vec<(f64, i32)>> = vec![Vec::new(); self.size[0] * self.size[1]];
        // Lines are shifted by a hair so that none meets an edge of a symmetric mesh.
        let shift = DVec3::new(1.37e-5, 0.91e-5, 0.0);
        for f in faces {
            let [a, b, c] = f.map(|v| p[v as usize]);
            let area = (b - a).truncate().perp_dot((c - a).truncate());
            if area == 0.0 {
                continue;
            }
            let low = a.min(b).min(c);
            let high = a.max(b).max(c);
            let from = ((low - self.low) / self.step).floor();
            let to = ((high - self.low) / self.step).ceil();
            for y in from.y.max(0.0) as usize..=to.y as usize {
                for x in from.x.max(0.0) as usize..=to.x as usize {
                    let q = self.at([x, y, 0]) + shift;
                    let u = (b - q).truncate().perp_dot((c - q).truncate()) / area;
                    let v = (c - q).truncate().perp_dot((a - q).truncate()) / area;
                    let w = 1.0 - u - v;
                    if u >= 0.0 && v >= 0.0 && w >= 0.0 {
                        let z = u * a.z + v * b.z + w * c.z;
                        crossings[x + self.size[0] * y].push((z, if area > 0.0 { 1 } else { -1 }));
                    }
                }
            }
        }
        for y in 0..self.size[1] {
            for x in 0..self.size[0] {
                for z in 0..self.size[2] {
                    let height = self.at([x, y, z]).z;
                    let above = crossings[x + self.size[0] * y]
                        .iter()
                        .filter(|c| c.0 > height);
                    if above.map(|c| c.1).sum::<i32>() > 0 {
                        let i = self.index([x, y, z]);
                        self.values[i] = -self.values[i];
                    }
                }
            }
        }
    }

    /// The field of what is left when everything where a cut is positive is taken
    /// away. It closes over `BEYOND` units outside the cut at a slope, so that what
    /// is worn over it does so too.
    pub fn trimmed(&self, cuts: &[Cut]) -> Self {
        const BEYOND: f64 = 0.3;
        const SLOPE: f64 = 0.5;
        self.map(|i, p| {
            let value = self.values[i];
            if value > BAND {
                return value;
            }
            let outside = cuts
                .iter()
                .map(|cut| cut(p))
                .fold(f64::NEG_INFINITY, f64::max);
            value.max(SLOPE * (outside - BEYOND))
        })
    }

    /// The smaller value at every node of the same grid: both solids together.
    pub fn joined(&self, other: &Self) -> Self {
        self.map(|i, _| self.values[i].min(other.values[i]))
    }

    pub fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.size[0] * (y + self.size[1] * z)
    }

    /// Place of a node.
    pub fn at(&self, [x, y, z]: [usize; 3]) -> DVec3 {
        self.low + DVec3::new(x as f64, y as f64, z as f64) * self.step
    }

    /// A field of the same grid from each node's value here and place.
    pub fn map(&self, f: impl Fn(usize, DVec3) -> f64) -> Self {
        let mut out = self.clone();
        for z in 0..self.size[2] {
            for y in 0..self.size[1] {
                for x in 0..self.size[0] {
                    let i = self.index([x, y, z]);
                    out.values[i] = f(i, self.at([x, y, z]));
                }
            }
        }
        out
    }

    /// Binomial smoothing (1, 2, 1) along each axis.
    pub fn smooth(&mut self) {
        for axis in 0..3 {
            let stride = [1, self.size[0], self.size[0] * self.size[1]][axis];
            let old = self.values.clone();
            for z in 0..self.size[2] {
                for y in 0..self.size[1] {
                    for x in 0..self.size[0] {
                        let k = [x, y, z][axis];
                        if k > 0 && k + 1 < self.size[axis] {
                            let i = self.index([x, y, z]);
                            self.values[i] =
                                0.25 * (old[i - stride] + 2.0 * old[i] + old[i + stride]);
                        }
                    }
                }
            }
        }
    }

    /// Trilinear value.
    pub fn value(&self, p: DVec3) -> f64 {
        let q = (p - self.low) / self.step;
        let cell = |x: f64, n: usize| x.floor().clamp(0.0, (n - 2) as f64);
        let c = DVec3::new(
            cell(q.x, self.size[0]),
            cell(q.y, self.size[1]),
            cell(q.z, self.size[2]),
        );
        let t = q - c;
        let i = self.index([c.x as usize, c.y as usize, c.z as usize]);
        let (dy, dz) = (self.size[0], self.size[0] * self.size[1]);
        let v = |k: usize| self.values[i + k];
        let line = |k: usize| v(k) + (v(k + 1) - v(k)) * t.x;
        let low = line(0) + (line(dy) - line(0)) * t.y;
        let high = line(dz) + (line(dz + dy) - line(dz)) * t.y;
        low + (high - low) * t.z
    }

    /// Central difference over half a cell.
    pub fn gradient(&self, p: DVec3) -> DVec3 {
        gradient(&|q| self.value(q), p, 0.5 * self.step)
    }
}

/// Central differences of any function.
pub(super) fn gradient(f: &dyn Fn(DVec3) -> f64, p: DVec3, h: f64) -> DVec3 {
    let d = |e: DVec3| (f(p + e * h) - f(p - e * h)) / (2.0 * h);
    DVec3::new(d(DVec3::X), d(DVec3::Y), d(DVec3::Z))
}

/// Minimum with a fillet of size `k`.
pub(super) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * k * 0.25
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(super) fn ramp(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

pub(super) fn vector(p: [f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

//! Convex hulls of a body's horizontal sections, and distances to them.

use glam::{DVec2, DVec3};

/// Counter-clockwise convex polygons at the levels `low + k·step`.
#[derive(Clone, Debug)]
pub(super) struct Sections {
    low: f64,
    step: f64,
    polygons: Vec<Vec<DVec2>>,
}

impl Sections {
    /// Sections of the faces whose three vertices are chosen.
    pub fn cut(
        positions: &[DVec3],
        faces: &[[u32; 3]],
        chosen: &[bool],
        low: f64,
        step: f64,
        count: usize,
    ) -> Self {
        let mut points: Vec<Vec<DVec2>> = vec![Vec::new(); count];
        for f in faces {
            if !f.iter().all(|&v| chosen[v as usize]) {
                continue;
            }
            for k in 0..3 {
                let a = positions[f[k] as usize];
                let b = positions[f[(k + 1) % 3] as usize];
                let (bottom, top) = (a.z.min(b.z), a.z.max(b.z));
                let from = ((bottom - low) / step).ceil().max(0.0) as usize;
                let to = ((top - low) / step).floor();
                if to < 0.0 || top == bottom {
                    continue;
                }
                for (level, at) in points
                    .iter_mut()
                    .enumerate()
                    .take(to as usize + 1)
                    .skip(from)
                {
                    let t = (low + level as f64 * step - a.z) / (b.z - a.z);
                    at.push(a.truncate().lerp(b.truncate(), t));
                }
            }
        }
        let polygons = points.into_iter().map(hull).collect();
        Self {
            low,
            step,
            polygons,
        }
    }

    /// Forgets what was cut below `bottom`.
    pub fn clear_below(&mut self, bottom: f64) {
        let count = ((bottom - self.low) / self.step).ceil().max(0.0) as usize;
        self.polygons.iter_mut().take(count).for_each(Vec::clear);
    }

    /// Below `top`, each section also covers all sections from there down to it: cloth hangs.
    pub fn hang_from(&mut self, top: f64) {
        let start =
            ((top - self.low) / self.step).clamp(0.0, (self.polygons.len() - 1) as f64) as usize;
        for level in (0..start).rev() {
            let mut all = self.polygons[level].clone();
            all.extend_from_slice(&self.polygons[level + 1]);
            self.polygons[level] = hull(all);
        }
    }

    /// Corners of the box around all polygons, seen from above.
    pub fn bounds(&self) -> [DVec2; 2] {
        let points = || self.polygons.iter().flatten();
        [
            points().fold(DVec2::INFINITY, |low, &p| low.min(p)),
            points().fold(DVec2::NEG_INFINITY, |high, &p| high.max(p)),
        ]
    }

    /// Signed distance within the level to the hull, interpolated between levels; none where nothing was cut.
    pub fn distance(&self, p: DVec3) -> Option<f64> {
        let level = (p.z - self.low) / self.step;
        if level < 0.0 || level >= (self.polygons.len() - 1) as f64 {
            return None;
        }
        let k = level as usize;
        let a = polygon_distance(&self.polygons[k], p.truncate())?;
        let b = polygon_distance(&self.polygons[k + 1], p.truncate())?;
        Some(a + (b - a) * (level - k as f64))
    }
}

fn polygon_distance(polygon: &[DVec2], p: DVec2) -> Option<f64> {
    if polygon.len() < 3 {
        return None;
    }
    let mut inside = f64::NEG_INFINITY;
    let mut nearest = f64::INFINITY;
    for (k, &a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        let side = b - a;
        let t = ((p - a).dot(side) / side.length_squared()).clamp(0.0, 1.0);
        nearest = nearest.min(p.distance(a + side * t));
        inside = inside.max((p - a).dot(DVec2::new(side.y, -side.x).normalize_or_zero()));
    }
    Some(if inside <= 0.0 { inside } else { nearest })
}

/// Andrew's monotone chain.
fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup_by(|a, b| a.distance_squared(*b) < 1e-12);
    if points.len() < 3 {
        return points;
    }
    let mut chain: Vec<DVec2> = Vec::new();
    for upper in [false, true] {
        let start = chain.len();
        let mut add = |p: DVec2| {
            while chain.len() >= start + 2 {
                let (a, b) = (chain[chain.len() - 2], chain[chain.len() - 1]);
                if (b - a).perp_dot(p - a) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        };
        if upper {
            points.iter().rev().for_each(|&p| add(p));
        } else {
            points.iter().for_each(|&p| add(p));
        }
        chain.pop();
    }
    chain
}

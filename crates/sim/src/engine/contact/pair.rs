//! A contact pair: a vertex and a face, or two edges, that may meet before the
//! next search.
//!
//! The separation of a pair is D = Σ w_k x_k, from the closest point of the
//! second feature to that of the first. Its normal n remembers the side: it is
//! turned so that it never jumps by more than 90° between two looks, so a
//! vertex that was pushed through a face has a negative gap instead of a
//! fresh start on the wrong side.

use drape_geometry::closest::{point_triangle, segment_segment};
use glam::DVec3;

/// Features of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Features {
    /// The first vertex against the face of the other three.
    VertexFace,
    /// The edge of the first two against that of the last two.
    EdgeEdge,
}

/// Two features that may touch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub vertices: [u32; 4],
    pub features: Features,
    /// Distance to be kept, m.
    pub thickness: f32,
    /// Coulomb coefficient.
    pub friction: f32,
    /// Upper bound of how fast the pair closes, m per substep.
    pub rate: f32,
    /// Substep at which the pair can first matter.
    pub wake: u32,
    /// Normal at the last look.
    pub normal: DVec3,
}

/// Closest points of a pair.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Separation {
    /// Weights of the four vertices: D = Σ w x.
    pub weights: [f64; 4],
    /// From the second feature to the first.
    pub d: DVec3,
    /// Whether the closest points lie inside both features, so that D is normal to both.
    pub interior: bool,
}

/// Measures features at `x`.
pub(crate) fn separation(features: Features, vertices: [u32; 4], x: &[DVec3]) -> Separation {
    let [a, b, c, d] = vertices.map(|v| x[v as usize].to_array());
    match features {
        Features::VertexFace => {
            let on = point_triangle(a, [b, c, d]);
            let [u, v, w] = on.barycentric;
            Separation {
                weights: [1.0, -u, -v, -w],
                d: DVec3::from_array(a) - DVec3::from_array(on.point),
                interior: u > 1e-9 && v > 1e-9 && w > 1e-9,
            }
        }
        Features::EdgeEdge => {
            let between = segment_segment([a, b], [c, d]);
            let (s, t) = (between.s, between.t);
            Separation {
                weights: [1.0 - s, s, t - 1.0, -t],
                d: DVec3::from_array(between.first) - DVec3::from_array(between.second),
                interior: s > 1e-9 && s < 1.0 - 1e-9 && t > 1e-9 && t < 1.0 - 1e-9,
            }
        }
    }
}

impl Pair {
    /// Gap along the remembered normal, which is brought up to date.
    pub fn look(&mut self, x: &[DVec3]) -> (Separation, f64) {
        let separation = separation(self.features, self.vertices, x);
        let distance = separation.d.length();
        let (mut normal, mut gap) = if distance > 1e-7 {
            (separation.d / distance, distance)
        } else {
            // Touching: the common normal of both features, if they have one.
            (self.geometric_normal(x).unwrap_or(self.normal), distance)
        };
        if normal.dot(self.normal) < 0.0 {
            normal = -normal;
            gap = -gap;
        }
        self.normal = normal;
        (separation, gap)
    }

    fn geometric_normal(&self, x: &[DVec3]) -> Option<DVec3> {
        let [a, b, c, d] = self.vertices.map(|v| x[v as usize]);
        let normal = match self.features {
            Features::VertexFace => (c - b).cross(d - b),
            Features::EdgeEdge => (b - a).cross(d - c),
        };
        normal.try_normalize()
    }
}

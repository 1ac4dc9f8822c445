//! A contact pair: a vertex and a face, or two edges, that may meet before the
//! next search.
//!
//! The separation of a pair is D = Σ w_k x_k, from the closest point of the
//! second feature to that of the first. Its normal n remembers the side: it is
//! turned so that it never jumps by more than 90° between two looks, so a
//! vertex that was pushed through a face has a negative gap instead of a
//! fresh start on the wrong side.

use drape_geometry::closest::point_triangle;
use glam::DVec3;

use crate::engine::state::State;

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
    let [a, b, c, d] = vertices.map(|v| x[v as usize]);
    match features {
        Features::VertexFace => {
            let on = point_triangle(a.to_array(), [b, c, d].map(|x| x.to_array()));
            let [u, v, w] = on.barycentric;
            Separation {
                weights: [1.0, -u, -v, -w],
                d: a - DVec3::from_array(on.point),
                interior: u > 1e-9 && v > 1e-9 && w > 1e-9,
            }
        }
        Features::EdgeEdge => {
            let (s, t) = between_segments([a, b], [c, d]);
            Separation {
                weights: [1.0 - s, s, t - 1.0, -t],
                d: (a - c) + s * (b - a) - t * (d - c),
                interior: s > 1e-9 && s < 1.0 - 1e-9 && t > 1e-9 && t < 1.0 - 1e-9,
            }
        }
    }
}

/// Places of the closest points on two segments (Ericson, "Real-Time Collision
/// Detection", 5.1.9). The exact version in `drape_geometry` takes three times
/// as long; here nearly parallel edges may be served with any of their nearly
/// equal answers.
fn between_segments([a0, a1]: [DVec3; 2], [b0, b1]: [DVec3; 2]) -> (f64, f64) {
    let (u, v, r) = (a1 - a0, b1 - b0, a0 - b0);
    let (uu, vv, uv) = (u.length_squared(), v.length_squared(), u.dot(v));
    let (ur, vr) = (u.dot(r), v.dot(r));
    // Edges shorter than a nanometre are points.
    let place = |along: f64, length2: f64| {
        if length2 > 1e-18 {
            (along / length2).clamp(0.0, 1.0)
        } else {
            0.0
        }
    };
    let determinant = uu * vv - uv * uv;
    let s = if determinant > 1e-9 * uu * vv {
        ((uv * vr - ur * vv) / determinant).clamp(0.0, 1.0)
    } else {
        0.5
    };
    let along = uv * s + vr;
    if along < 0.0 {
        (place(-ur, uu), 0.0)
    } else if along > vv {
        (place(uv - ur, uu), 1.0)
    } else {
        (s, place(along, vv))
    }
}

impl Pair {
    /// A pair that is only certified, not kept at a distance; `None` if nothing in it can move.
    pub fn found(vertices: [u32; 4], features: Features, state: &State) -> Option<Self> {
        let mobile = vertices.iter().any(|&v| state.w[v as usize] > 0.0);
        let normal = separation(features, vertices, &state.x).d.try_normalize()?;
        mobile.then_some(Self {
            vertices,
            features,
            thickness: 0.0,
            friction: 0.0,
            rate: 0.0,
            wake: 0,
            normal,
        })
    }

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

//! A contact pair: a vertex and a face, or two edges, that may meet before the
//! next search.
//!
//! The separation of a pair is D = Σ w_k x_k, from the closest point of the
//! second feature to that of the first, its gap the length of D. Features that
//! were certified have not crossed, however D may have turned: a vertex can go
//! around the edge of a face. A pair in doubt, one that has to be brought back
//! or whose certificate failed, remembers its side: its normal never jumps by
//! more than 90° between two looks, so what was pushed through has a negative
//! gap instead of a fresh start on the wrong side, until it has come back.

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

/// Features nearer than this touch and have no normal of their own, m.
pub(crate) const SAME_M: f64 = 1e-7;

/// Substeps in which a pair with this gap cannot come within `reach` if it
/// closes at this rate, m per substep.
pub(crate) fn idle(gap: f64, reach: f64, rate: f64) -> u32 {
    let room = gap - reach;
    if room <= 0.0 || room <= rate {
        0
    } else if rate <= 0.0 {
        u32::MAX
    } else {
        (room / rate) as u32
    }
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
    /// Substeps from the search until the pair can first matter.
    pub idle: u32,
    /// Normal at the last look.
    pub normal: DVec3,
    /// Whether the features may have crossed.
    pub doubtful: bool,
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
    let [a, b, c, d] = vertices;
    let at = |v: u32| x[v as usize];
    separation_of(features, [at(a), at(b), at(c), at(d)])
}

/// Measures features with vertices at these places.
#[inline]
pub(crate) fn separation_of(features: Features, [a, b, c, d]: [DVec3; 4]) -> Separation {
    match features {
        Features::VertexFace => {
            let (u, v) = on_triangle(a, b, c, d);
            let w = 1.0 - u - v;
            Separation {
                weights: [1.0, -w, -u, -v],
                d: (a - b) - u * (c - b) - v * (d - b),
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

/// Barycentric coordinates, of the second and third corner, of the point of
/// triangle (a, b, c) that is closest to `p` (Ericson, "Real-Time Collision
/// Detection", 5.1.5). Needles go the slow way of `drape_geometry`, which
/// measures what it returns.
fn on_triangle(p: DVec3, a: DVec3, b: DVec3, c: DVec3) -> (f64, f64) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (bb, cc, bc) = (ab.length_squared(), ac.length_squared(), ab.dot(ac));
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    // Squared area: of a triangle flatter than 1 in 1000 it is mostly rounding.
    let area2 = bb * cc - bc * bc;
    if area2 <= 1e-6 * bb * cc {
        let triangle = [a, b, c].map(|x| x.to_array());
        let [_, v, w] = point_triangle(p.to_array(), triangle).barycentric;
        return (v, w);
    }
    if d1 <= 0.0 && d2 <= 0.0 {
        return (0.0, 0.0);
    }
    let (d3, d4) = (d1 - bb, d2 - bc);
    if d3 >= 0.0 && d4 <= d3 {
        return (1.0, 0.0);
    }
    let (d5, d6) = (d1 - bc, d2 - cc);
    if d6 >= 0.0 && d5 <= d6 {
        return (0.0, 1.0);
    }
    if d1 >= 0.0 && d3 <= 0.0 && d1 * d4 - d3 * d2 <= 0.0 {
        return (d1 / bb, 0.0);
    }
    if d2 >= 0.0 && d6 <= 0.0 && d5 * d2 - d1 * d6 <= 0.0 {
        return (0.0, d2 / cc);
    }
    if d4 - d3 >= 0.0 && d5 - d6 >= 0.0 && d3 * d6 - d5 * d4 <= 0.0 {
        let along = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return (1.0 - along, along);
    }
    ((cc * d1 - bc * d2) / area2, (bb * d2 - bc * d1) / area2)
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
    if vv <= 1e-18 {
        return (place(-ur, uu), 0.0);
    }
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
            idle: 0,
            normal,
            doubtful: false,
        })
    }

    /// Gap along the normal, which is brought up to date.
    pub fn look(&mut self, x: &[DVec3]) -> (Separation, f64) {
        let separation = separation(self.features, self.vertices, x);
        let distance = separation.d.length();
        let touching = distance <= SAME_M;
        let mut normal = if touching {
            // The common normal of both features, if they have one.
            self.geometric_normal(x).unwrap_or(self.normal)
        } else {
            separation.d / distance
        };
        let mut gap = distance;
        if (self.doubtful || touching) && normal.dot(self.normal) < 0.0 {
            normal = -normal;
            gap = if touching { gap } else { -gap };
        }
        self.normal = normal;
        self.doubtful &= gap <= 0.0;
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

#[cfg(test)]
mod tests {
    use super::*;
    use drape_geometry::closest::segment_segment;

    /// Points on, beside and beyond a face or edge: every region of the case analysis
    /// and the borders between them.
    fn grid() -> impl Iterator<Item = DVec3> {
        let at = |i: i32| 0.25 * f64::from(i);
        (-4..9).flat_map(move |i| {
            (-4..9).flat_map(move |j| {
                [-1e-3, 0.0, 1e-6, 2e-3].map(move |z| DVec3::new(at(i), at(j), z))
            })
        })
    }

    #[test]
    fn vertex_and_face_are_as_far_apart_as_the_slow_way_says() {
        let corners = [
            [DVec3::ZERO, DVec3::X, DVec3::Y],
            [DVec3::ZERO, DVec3::X, DVec3::new(1.5, 0.5, 0.0)],
            [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 2e-3, 0.0)],
            [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1e-7, 0.0)],
            [DVec3::ZERO, DVec3::X, DVec3::X],
        ];
        for [b, c, d] in corners {
            for a in grid() {
                let found = separation_of(Features::VertexFace, [a, b, c, d]);
                let slow = point_triangle(a.to_array(), [b, c, d].map(|x| x.to_array()));
                let distance = slow.distance2.sqrt();
                let error = (found.d.length() - distance).abs();
                assert!(error < 1e-9, "{a} {b} {c} {d}: {error}");
                let [one, u, v, w] = found.weights;
                assert!((one + u + v + w).abs() < 1e-12);
                let sum = one * a + u * b + v * c + w * d;
                assert!(sum.distance(found.d) < 1e-12);
            }
        }
    }

    #[test]
    fn edges_are_as_far_apart_as_the_slow_way_says() {
        let first = [DVec3::ZERO, DVec3::X];
        for along in [
            DVec3::Y,
            DVec3::X,
            DVec3::new(1.0, 1e-3, 0.0),
            DVec3::new(0.3, -0.4, 0.1),
            DVec3::ZERO,
        ] {
            for c in grid() {
                let d = c + along;
                let found = separation_of(Features::EdgeEdge, [first[0], first[1], c, d]);
                let slow =
                    segment_segment(first.map(|x| x.to_array()), [c, d].map(|x| x.to_array()));
                let error = (found.d.length() - slow.distance2.sqrt()).abs();
                assert!(error < 1e-9, "{c} {d}: {error}");
            }
        }
    }

    #[test]
    fn who_goes_around_an_edge_keeps_its_gap_and_who_may_have_crossed_its_side() {
        // A face in the plane z = 0 and a vertex that passes its side y = 0 from above to below.
        let face = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0)];
        let x = |y: f64, z: f64| [DVec3::new(0.5, y, z), face[0], face[1], face[2]];
        let pair = |doubtful| Pair {
            vertices: [0, 1, 2, 3],
            features: Features::VertexFace,
            thickness: 0.003,
            friction: 0.0,
            idle: 0,
            normal: DVec3::Z,
            doubtful,
        };
        let mut sure = pair(false);
        for (y, z) in [(-1e-4, 1e-3), (-1e-4, -1e-3), (1e-4, -1e-3)] {
            let (_, gap) = sure.look(&x(y, z));
            assert!(gap > 0.0, "{gap} at {y}, {z}");
        }
        assert!(sure.normal.z < -0.9);
        // The same places, but it may have gone through: then it is on the wrong side till it is back.
        let mut in_doubt = pair(true);
        for (y, z) in [(0.1, -1e-3), (1e-4, -1e-3)] {
            let (_, gap) = in_doubt.look(&x(y, z));
            assert!(gap < 0.0 && in_doubt.doubtful, "{gap} at {y}, {z}");
        }
        let (_, gap) = in_doubt.look(&x(0.1, 1e-3));
        assert!(gap > 0.0 && !in_doubt.doubtful);
    }

    #[test]
    fn a_pair_sleeps_only_while_it_cannot_come_within_its_thickness() {
        let thickness = 0.004;
        for step in 0..2000 {
            let gap = 0.003 + 1e-5 * f64::from(step);
            for rate in [-1.0, 0.0, 1e-5, 4e-4, 1e-3, 0.1] {
                let asleep = idle(gap, thickness, rate);
                if asleep > 0 && rate > 0.0 {
                    let nearest = gap - f64::from(asleep) * rate;
                    assert!(nearest >= thickness - 1e-12, "{gap} {rate}: {nearest}");
                }
                assert!(asleep == 0 || gap > thickness);
            }
        }
    }
}

//! Closest points of a point and a triangle, and of two segments, in f64.
//!
//! Both take the least of a few candidates and measure each candidate by the
//! points it really gives, so that degenerate input (a triangle without area,
//! a segment without length, parallel segments) needs no case of its own and
//! cannot produce NaN from finite input. Signs of distances are the caller's.

use crate::vector::{add_scaled64, cross64, distance2_64, dot64, sub64};

/// Closest point of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnTriangle {
    /// The point.
    pub point: [f64; 3],
    /// Its barycentric coordinates: not negative, sum 1 up to rounding.
    pub barycentric: [f64; 3],
    /// Squared distance from the query.
    pub distance2: f64,
}

/// Closest points of two segments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BetweenSegments {
    /// Place on the first segment, 0 at its first end, 1 at its second.
    pub s: f64,
    /// Place on the second segment.
    pub t: f64,
    /// Point on the first segment.
    pub first: [f64; 3],
    /// Point on the second segment.
    pub second: [f64; 3],
    /// Squared distance of the two points.
    pub distance2: f64,
}

/// Closest point of triangle (a, b, c) to `p`.
pub fn point_triangle(p: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> OnTriangle {
    let normal = cross64(sub64(b, a), sub64(c, a));
    let normal2 = dot64(normal, normal);
    // Signed areas of (p, b, c), (a, p, c), (a, b, p) along the normal.
    let area = |u: [f64; 3], v: [f64; 3]| dot64(cross64(sub64(u, p), sub64(v, p)), normal);
    let weights = [area(b, c), area(c, a), area(a, b)];
    let sum = weights[0] + weights[1] + weights[2];
    let on_edge = || {
        let sides = [([a, b], [0, 1]), ([b, c], [1, 2]), ([c, a], [2, 0])];
        let candidates = sides.map(|([from, to], [i, j])| {
            let t = along_segment(p, from, to);
            let mut barycentric = [0.0; 3];
            barycentric[i] = 1.0 - t;
            barycentric[j] = t;
            on_triangle(p, [a, b, c], barycentric)
        });
        let nearer = |x: OnTriangle, y: OnTriangle| if y.distance2 < x.distance2 { y } else { x };
        nearer(nearer(candidates[0], candidates[1]), candidates[2])
    };
    if !(sum > 0.0 && weights.iter().all(|&w| w >= 0.0)) {
        return on_edge();
    }
    let inside = on_triangle(p, [a, b, c], weights.map(|w| w / sum));
    // The normal of a needle is mostly rounding: there the edges may be nearer.
    let longest2 = distance2_64(a, b)
        .max(distance2_64(b, c))
        .max(distance2_64(c, a));
    if normal2 > 1e-16 * longest2 * longest2 {
        return inside;
    }
    let edge = on_edge();
    if edge.distance2 < inside.distance2 {
        edge
    } else {
        inside
    }
}

/// Closest points of segments (a0, a1) and (b0, b1). Parallel segments have
/// many pairs; one with an end of a segment is returned.
pub fn segment_segment([a0, a1]: [[f64; 3]; 2], [b0, b1]: [[f64; 3]; 2]) -> BetweenSegments {
    let at = |s: f64, t: f64| {
        let first = point_along(a0, a1, s);
        let second = point_along(b0, b1, t);
        BetweenSegments {
            s,
            t,
            first,
            second,
            distance2: distance2_64(first, second),
        }
    };
    let mut best = at(0.0, along_segment(a0, b0, b1));
    let mut consider = |candidate: BetweenSegments| {
        if candidate.distance2 < best.distance2 {
            best = candidate;
        }
    };
    consider(at(1.0, along_segment(a1, b0, b1)));
    consider(at(along_segment(b0, a0, a1), 0.0));
    consider(at(along_segment(b1, a0, a1), 1.0));

    let (u, v, w) = (sub64(a1, a0), sub64(b1, b0), sub64(a0, b0));
    let (uu, uv, vv, uw, vw) = (
        dot64(u, u),
        dot64(u, v),
        dot64(v, v),
        dot64(u, w),
        dot64(v, w),
    );
    let determinant = uu * vv - uv * uv;
    if determinant > 0.0 {
        let s = ((uv * vw - vv * uw) / determinant).clamp(0.0, 1.0);
        // The best partner of a point is its own projection, whatever rounding did to `s`.
        let t = along_segment(point_along(a0, a1, s), b0, b1);
        consider(at(s, t));
        consider(at(along_segment(point_along(b0, b1, t), a0, a1), t));
    }
    best
}

/// Place on segment (a, b) closest to `p`, 0 for a segment without length.
pub fn along_segment(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let direction = sub64(b, a);
    let length2 = dot64(direction, direction);
    if length2 > 0.0 {
        (dot64(sub64(p, a), direction) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

fn point_along(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    // Exact at both ends.
    if t == 1.0 {
        b
    } else {
        add_scaled64(a, t, sub64(b, a))
    }
}

fn on_triangle(p: [f64; 3], [a, b, c]: [[f64; 3]; 3], barycentric: [f64; 3]) -> OnTriangle {
    let [u, v, w] = barycentric;
    let point = std::array::from_fn(|axis| u * a[axis] + v * b[axis] + w * c[axis]);
    OnTriangle {
        point,
        barycentric,
        distance2: distance2_64(p, point),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coordinates on a coarse lattice, so that degenerate cases come up often.
    fn lattice(seed: u64) -> impl FnMut() -> [f64; 3] {
        let mut state = seed;
        move || {
            std::array::from_fn(|_| {
                state = state
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                ((state >> 33) % 4) as f64 - 1.5
            })
        }
    }

    #[test]
    fn no_sampled_point_of_the_triangle_is_nearer() {
        let mut next = lattice(3);
        for _ in 0..2000 {
            let (p, triangle) = (next(), [next(), next(), next()]);
            let found = point_triangle(p, triangle);
            assert!(found.barycentric.iter().all(|&w| w >= 0.0));
            assert!((found.barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            for i in 0..=12 {
                for j in 0..=12 - i {
                    let weights = [i, j, 12 - i - j].map(|w| f64::from(w) / 12.0);
                    let sample = on_triangle(p, triangle, weights);
                    assert!(
                        found.distance2 <= sample.distance2 + 1e-12,
                        "{p:?} {triangle:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn no_sampled_pair_of_the_segments_is_nearer() {
        let mut next = lattice(4);
        for _ in 0..2000 {
            let (a, b) = ([next(), next()], [next(), next()]);
            let found = segment_segment(a, b);
            assert!((0.0..=1.0).contains(&found.s) && (0.0..=1.0).contains(&found.t));
            let swapped = segment_segment(b, a);
            assert!((found.distance2 - swapped.distance2).abs() < 1e-12);
            for i in 0..=12 {
                for j in 0..=12 {
                    let first = point_along(a[0], a[1], f64::from(i) / 12.0);
                    let second = point_along(b[0], b[1], f64::from(j) / 12.0);
                    let sample = distance2_64(first, second);
                    assert!(found.distance2 <= sample + 1e-12, "{a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn points_and_needles_are_triangles_too() {
        let point = point_triangle([1.0, 0.0, 0.0], [[0.0; 3]; 3]);
        assert_eq!((point.distance2, point.point), (1.0, [0.0; 3]));
        let needle = [[0.0; 3], [1.0, 0.0, 0.0], [0.5, 1e-13, 0.0]];
        let beside = point_triangle([0.25, 0.0, 2.0], needle);
        assert!((beside.distance2 - 4.0).abs() < 1e-12);
    }
}

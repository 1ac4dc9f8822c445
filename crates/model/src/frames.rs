//! Local frames from normals: rows tangent, bitangent, normal.
//!
//! `t = x − (n·x) n`, normalised; `b = n × t`. The released program starts from
//! the fixed axis x = (1, 0, 0), which degenerates near n = ±x; the default
//! starts from the axis of the smallest component and is orthonormal for every n.

use crate::config::FrameAxis;

/// Rows of a 3×3 matrix.
pub type Matrix = [[f32; 3]; 3];

/// The identity.
pub const IDENTITY: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

const EPSILON: f32 = 1e-7;

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The frame of a normal.
pub fn frame(n: [f32; 3], axis: FrameAxis) -> Matrix {
    let x = match axis {
        FrameAxis::FixedX => {
            let mut x = [1.0, 0.0, 0.0];
            for (x, n) in x.iter_mut().zip(n) {
                if n.abs() < EPSILON {
                    *x = 1.0;
                }
            }
            x
        }
        FrameAxis::SmallestComponent => {
            if dot(n, n).sqrt() < EPSILON {
                return IDENTITY;
            }
            let smallest = (0..3).fold(
                0,
                |best, k| if n[k].abs() < n[best].abs() { k } else { best },
            );
            let mut x = [0.0; 3];
            x[smallest] = 1.0;
            x
        }
    };
    let along = dot(n, x);
    let t = [0, 1, 2].map(|k| x[k] - along * n[k]);
    let length = dot(t, t).sqrt() + EPSILON;
    let t = t.map(|value| value / length);
    let b = [
        n[1] * t[2] - n[2] * t[1],
        n[2] * t[0] - n[0] * t[2],
        n[0] * t[1] - n[1] * t[0],
    ];
    [t, b, n]
}

/// The unit vector along `v`; zero for (nearly) zero.
pub fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    if length < EPSILON {
        [0.0; 3]
    } else {
        v.map(|value| value / length)
    }
}

/// `R v`.
pub fn rotate(r: &Matrix, v: [f32; 3]) -> [f32; 3] {
    [dot(r[0], v), dot(r[1], v), dot(r[2], v)]
}

/// The transposed matrix.
pub fn transposed(r: &Matrix) -> Matrix {
    [0, 1, 2].map(|row| [r[0][row], r[1][row], r[2][row]])
}

//! Best-fit rigid motions, and quaternions (w, x, y, z), in f64.
//!
//! The fit minimises Σ |R·sourceᵢ + t − targetᵢ|² over rotations with
//! determinant +1. The rotation is the eigenvector of the largest eigenvalue of
//! Horn's symmetric 4 × 4 matrix (Closed-form solution of absolute orientation
//! using unit quaternions, 1987), found by Jacobi rotations: the same optimum
//! as Kabsch's, but no reflection can come out, and flat, straight or single
//! points need no case of their own. Where the optimum is not unique (points on
//! a line) one of the best rotations is returned; for coincident points the identity.

use crate::error::GeometryError;
use crate::vector::{distance2_64, sub64, to64};

/// 3 × 3 matrix, `[row][column]`.
pub type Matrix3 = [[f64; 3]; 3];

/// Rotation, then translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// Rotation matrix, determinant +1.
    pub rotation: Matrix3,
    /// Translation.
    pub translation: [f64; 3],
}

impl Rigid {
    /// The motion that changes nothing.
    pub const IDENTITY: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    /// The motion that brings `source` closest to `target` in least squares.
    ///
    /// # Errors
    /// If the sets have different sizes, are empty, or hold a NaN or an infinity.
    pub fn fit(source: &[[f32; 3]], target: &[[f32; 3]]) -> Result<Self, GeometryError> {
        if source.len() != target.len() {
            let (source_count, target_count) = (source.len(), target.len());
            return Err(GeometryError::CountMismatch {
                source_count,
                target_count,
            });
        }
        if source.is_empty() {
            return Err(GeometryError::NoPoints);
        }
        for points in [source, target] {
            if let Some(vertex) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
                return Err(GeometryError::NotFinite {
                    vertex,
                    position: points[vertex],
                });
            }
        }
        let (source_mean, target_mean) = (mean(source), mean(target));
        // covariance[i][j] = Σ sourceᵢ targetⱼ about the means
        let mut covariance = [[0.0; 3]; 3];
        for (&from, &to) in source.iter().zip(target) {
            let (from, to) = (sub64(to64(from), source_mean), sub64(to64(to), target_mean));
            for i in 0..3 {
                for j in 0..3 {
                    covariance[i][j] += from[i] * to[j];
                }
            }
        }
        let rotation = matrix_from_quaternion(horn_quaternion(covariance));
        let translation = sub64(target_mean, rotate(&rotation, source_mean));
        Ok(Self {
            rotation,
            translation,
        })
    }

    /// R·p + t.
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let turned = rotate(&self.rotation, p);
        std::array::from_fn(|axis| turned[axis] + self.translation[axis])
    }

    /// The motion that undoes this one.
    pub fn inverse(&self) -> Self {
        let r = &self.rotation;
        let rotation = std::array::from_fn(|i| std::array::from_fn(|j| r[j][i]));
        let translation = rotate(&rotation, self.translation).map(|x| -x);
        Self {
            rotation,
            translation,
        }
    }

    /// Root mean square of |R·source + t − target|.
    ///
    /// # Panics
    /// If the sets have different sizes.
    pub fn residual(&self, source: &[[f32; 3]], target: &[[f32; 3]]) -> f64 {
        assert_eq!(source.len(), target.len(), "point sets must correspond");
        let pairs = source.iter().zip(target);
        let sum: f64 = pairs
            .map(|(&from, &to)| distance2_64(self.apply(to64(from)), to64(to)))
            .sum();
        (sum / source.len().max(1) as f64).sqrt()
    }
}

/// R·p.
pub fn rotate(rotation: &Matrix3, p: [f64; 3]) -> [f64; 3] {
    rotation.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2])
}

/// Rotation matrix of a quaternion (w, x, y, z), normalised first; the zero
/// quaternion, which sequences use for "no wind", gives the identity.
pub fn matrix_from_quaternion(quaternion: [f64; 4]) -> Matrix3 {
    let length2: f64 = quaternion.iter().map(|x| x * x).sum();
    if length2 == 0.0 {
        return Rigid::IDENTITY.rotation;
    }
    let [w, x, y, z] = quaternion;
    let s = 2.0 / length2;
    [
        [
            1.0 - s * (y * y + z * z),
            s * (x * y - w * z),
            s * (x * z + w * y),
        ],
        [
            s * (x * y + w * z),
            1.0 - s * (x * x + z * z),
            s * (y * z - w * x),
        ],
        [
            s * (x * z - w * y),
            s * (y * z + w * x),
            1.0 - s * (x * x + y * y),
        ],
    ]
}

/// Unit quaternion (w, x, y, z) of a rotation matrix, w ≥ 0.
pub fn quaternion_from_matrix(m: &Matrix3) -> [f64; 4] {
    // Four times the squares of w, x, y, z; dividing by the largest is stable.
    let squares = [
        1.0 + m[0][0] + m[1][1] + m[2][2],
        1.0 + m[0][0] - m[1][1] - m[2][2],
        1.0 - m[0][0] + m[1][1] - m[2][2],
        1.0 - m[0][0] - m[1][1] + m[2][2],
    ];
    let largest = (1..4).fold(
        0,
        |best, i| if squares[i] > squares[best] { i } else { best },
    );
    let (wx, wy, wz) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (xy, xz, yz) = (m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]);
    let square = squares[largest];
    let quaternion = match largest {
        0 => [square, wx, wy, wz],
        1 => [wx, square, xy, xz],
        2 => [wy, xy, square, yz],
        _ => [wz, xz, yz, square],
    };
    let length = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
    let sign = if quaternion[0] < 0.0 { -1.0 } else { 1.0 };
    quaternion.map(|x| sign * x / length)
}

/// Quaternion of the rotation that maximises tr(R · covariance).
fn horn_quaternion(s: Matrix3) -> [f64; 4] {
    let (x, y, z) = (s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]);
    let (xy, xz, yz) = (s[0][1] + s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1]);
    let (xx, yy, zz) = (s[0][0], s[1][1], s[2][2]);
    let mut n = [
        [xx + yy + zz, x, y, z],
        [x, xx - yy - zz, xy, xz],
        [y, xy, yy - xx - zz, yz],
        [z, xz, yz, zz - xx - yy],
    ];
    let mut vectors = [[0.0; 4]; 4]; // columns
    for (i, row) in vectors.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    // Cyclic Jacobi converges quadratically: 4 × 4 needs five or six sweeps.
    for _ in 0..50 {
        let scale: f64 = n.as_flattened().iter().map(|x| x * x).sum();
        let rest: f64 = (0..4)
            .flat_map(|i| (0..i).map(move |j| (i, j)))
            .map(|(i, j)| n[i][j] * n[i][j])
            .sum();
        if rest <= 1e-34 * scale {
            break;
        }
        for p in 0..3 {
            for q in p + 1..4 {
                jacobi_rotation(&mut n, &mut vectors, p, q);
            }
        }
    }
    let best = (1..4).fold(0, |best, i| if n[i][i] > n[best][best] { i } else { best });
    std::array::from_fn(|row| vectors[row][best])
}

/// Turns rows and columns p and q so that n[p][q] becomes zero.
fn jacobi_rotation(n: &mut [[f64; 4]; 4], vectors: &mut [[f64; 4]; 4], p: usize, q: usize) {
    if n[p][q] == 0.0 {
        return;
    }
    let theta = (n[q][q] - n[p][p]) / (2.0 * n[p][q]);
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    for row in n.iter_mut().chain(vectors) {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    (n[p], n[q]) = (
        std::array::from_fn(|i| c * n[p][i] - s * n[q][i]),
        std::array::from_fn(|i| s * n[p][i] + c * n[q][i]),
    );
}

fn mean(points: &[[f32; 3]]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for &point in points {
        for axis in 0..3 {
            sum[axis] += f64::from(point[axis]);
        }
    }
    sum.map(|x| x / points.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::{cross64, dot64};

    fn cloud(count: usize) -> Vec<[f32; 3]> {
        (0..count)
            .map(|i| [1.1f32, 2.3, 3.7].map(|f| (i as f32 * f + 0.3).sin() * 2.0))
            .collect()
    }

    fn moved(motion: &Rigid, points: &[[f32; 3]]) -> Vec<[f32; 3]> {
        points
            .iter()
            .map(|&p| motion.apply(to64(p)).map(|x| x as f32))
            .collect()
    }

    fn assert_rotation(r: &Matrix3) {
        for i in 0..3 {
            for j in 0..3 {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((dot64(r[i], r[j]) - expected).abs() < 1e-12);
            }
        }
        assert!((dot64(cross64(r[0], r[1]), r[2]) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn quaternions_and_matrices_are_inverse_to_each_other() {
        let half = 0.5f64.sqrt();
        for q in [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, half, -half],
            [0.5, -0.5, 0.5, 0.5],
            [1e-9, 0.6, 0.0, 0.8],
        ] {
            let matrix = matrix_from_quaternion(q);
            assert_rotation(&matrix);
            let back = quaternion_from_matrix(&matrix);
            let same = (0..4).map(|i| back[i] * q[i]).sum::<f64>().abs();
            assert!((same - 1.0).abs() < 1e-14, "{q:?} became {back:?}");
        }
        // A quarter turn about Z takes X to Y.
        let turned = rotate(
            &matrix_from_quaternion([half, 0.0, 0.0, half]),
            [1.0, 0.0, 0.0],
        );
        assert!(distance2_64(turned, [0.0, 1.0, 0.0]) < 1e-30);
        assert_eq!(matrix_from_quaternion([0.0; 4]), Rigid::IDENTITY.rotation);
    }

    #[test]
    fn a_rigid_motion_is_recovered_from_solid_and_from_flat_points() {
        let motion = Rigid {
            rotation: matrix_from_quaternion([0.3, -0.7, 0.2, 0.9]),
            translation: [5.0, -3.0, 11.0],
        };
        let mut flat = cloud(40);
        flat.iter_mut().for_each(|p| p[2] = 1.0);
        for points in [cloud(40), flat, cloud(3)] {
            let target = moved(&motion, &points);
            let fit = Rigid::fit(&points, &target).unwrap();
            assert_rotation(&fit.rotation);
            assert!(fit.residual(&points, &target) < 2e-6);
            for axis in 0..3 {
                assert!(distance2_64(fit.rotation[axis], motion.rotation[axis]).sqrt() < 1e-6);
            }
            assert!(fit.inverse().residual(&target, &points) < 2e-6);
        }
    }

    #[test]
    fn a_mirrored_target_is_fitted_without_a_reflection() {
        let points = cloud(30);
        let mirrored: Vec<_> = points.iter().map(|p| [-p[0], p[1], p[2]]).collect();
        let fit = Rigid::fit(&points, &mirrored).unwrap();
        assert_rotation(&fit.rotation);
        // No small turn in any direction does better.
        for axis in 0..3 {
            for angle in [-0.01, 0.01f64] {
                let mut q = [1.0, 0.0, 0.0, 0.0];
                q[axis + 1] = angle;
                let turn = matrix_from_quaternion(q);
                let target_mean = mean(&mirrored);
                let rotation = std::array::from_fn(|i| {
                    std::array::from_fn(|j| (0..3).map(|k| turn[i][k] * fit.rotation[k][j]).sum())
                });
                let translation = sub64(target_mean, rotate(&rotation, mean(&points)));
                let other = Rigid {
                    rotation,
                    translation,
                };
                assert!(fit.residual(&points, &mirrored) < other.residual(&points, &mirrored));
            }
        }
    }

    #[test]
    fn degenerate_sets_are_fitted_and_bad_ones_refused() {
        let line: Vec<_> = (0..5).map(|i| [i as f32, 0.0, 0.0]).collect();
        let upright: Vec<_> = (0..5).map(|i| [1.0, 2.0, i as f32]).collect();
        let fit = Rigid::fit(&line, &upright).unwrap();
        assert_rotation(&fit.rotation);
        assert!(fit.residual(&line, &upright) < 1e-12);
        let same = Rigid::fit(&[[1.0; 3]; 4], &[[3.0; 3]; 4]).unwrap();
        assert_eq!(
            same,
            Rigid {
                translation: [2.0; 3],
                ..Rigid::IDENTITY
            }
        );

        use GeometryError::*;
        assert_eq!(Rigid::fit(&[], &[]), Err(NoPoints));
        let sizes = Rigid::fit(&line, &upright[1..]);
        assert_eq!(
            sizes,
            Err(CountMismatch {
                source_count: 5,
                target_count: 4
            })
        );
        let nan = Rigid::fit(&[[f32::NAN; 3]], &[[0.0; 3]]);
        assert!(matches!(nan, Err(NotFinite { vertex: 0, .. })));
    }
}

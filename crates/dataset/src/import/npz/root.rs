//! The body's root in an imported sequence.

use drape_geometry::rigid::quaternion_from_matrix;

use super::arrays::Arrays;
use crate::error::Result;
use crate::sequence::Root;

/// The pelvis: this part of the body's height in frame 0. Arms stretched
/// sideways are higher, hanging hands lower.
const PELVIS: std::ops::RangeInclusive<f32> = 0.50..=0.58;

/// Root of every frame: centre of the pelvis, rotation of the joint `Hips`.
pub(super) fn roots(
    arrays: &mut Arrays,
    bodies: &[Vec<[f32; 3]>],
    warnings: &mut Vec<String>,
) -> Result<Vec<Root>> {
    let Some(first) = bodies.first() else {
        return Err(arrays.invalid("body_vertices", "at least one frame", "none"));
    };
    let joints = arrays.strings("joint_names")?;
    let Some(hips) = joints.iter().position(|joint| joint == "Hips") else {
        return Err(arrays.invalid("joint_names", "a joint \"Hips\"", joints.join(", ")));
    };
    let rotations = arrays.joint_matrices("pose_rotmats", hips)?;
    if rotations.len() != bodies.len() {
        let expected = format!("{} frames, as many as body_vertices", bodies.len());
        return Err(arrays.invalid("pose_rotmats", &expected, rotations.len().to_string()));
    }
    let low = first.iter().map(|p| p[2]).fold(f32::MAX, f32::min);
    let high = first.iter().map(|p| p[2]).fold(f32::MIN, f32::max);
    let in_pelvis = |p: &[f32; 3]| PELVIS.contains(&((p[2] - low) / (high - low)));
    let mut pelvis: Vec<usize> = (0..first.len()).filter(|&v| in_pelvis(&first[v])).collect();
    if pelvis.is_empty() {
        warnings.push("root position: centre of the whole body (no vertex in the pelvis)".into());
        pelvis = (0..first.len()).collect();
    } else {
        warnings.push("root position: centre of the pelvis, estimated".into());
    }
    rotations
        .iter()
        .zip(bodies)
        .enumerate()
        .map(|(frame, (rotation, body))| {
            let error = orthogonality_error(rotation);
            if error.is_nan() || error > 1e-3 {
                let found = format!("frame {frame}: {rotation:?}, off by {error:.1e}");
                return Err(arrays.invalid("pose_rotmats", "rotation matrices", found));
            }
            Ok(Root {
                translation: std::array::from_fn(|k| {
                    let sum: f64 = pelvis.iter().map(|&v| f64::from(body[v][k])).sum();
                    (sum / pelvis.len() as f64) as f32
                }),
                rotation: quaternion_from_matrix(rotation).map(|x| x as f32),
            })
        })
        .collect()
}

/// Largest entry of R·Rᵀ − 1, infinite for a reflection.
fn orthogonality_error(r: &[[f64; 3]; 3]) -> f64 {
    let dot = |a: usize, b: usize| (0..3).map(|k| r[a][k] * r[b][k]).sum::<f64>();
    let determinant: f64 = (0..3)
        .map(|k| {
            r[0][k]
                * (r[1][(k + 1) % 3] * r[2][(k + 2) % 3] - r[1][(k + 2) % 3] * r[2][(k + 1) % 3])
        })
        .sum();
    if determinant < 0.0 {
        return f64::INFINITY;
    }
    // Not `max`, which would swallow a NaN.
    (0..9)
        .map(|i| (dot(i / 3, i % 3) - f64::from(u8::from(i / 3 == i % 3))).abs())
        .fold(
            0.0,
            |worst, x| if x > worst || x.is_nan() { x } else { worst },
        )
}

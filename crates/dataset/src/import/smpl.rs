//! The SMPL body: a template, shape and pose blend shapes, and linear blend
//! skinning (Loper et al., SMPL: A Skinned Multi-Person Linear Model, 2015).
//! The model's files are licensed and never shipped; a user's own are read.
//!
//! ```text
//! shaped  = template + shape directions · β
//! joints  = regressor · shaped;   both shifted so that joint 0 is the origin
//! posed   = shaped + pose directions · vec(Rₖ − 1, k = 1 …)
//! vertex  = Σₖ weightₖ Gₖ posed + translation
//! ```
//!
//! Rₖ is the rotation by the axis-angle vector of joint k relative to its
//! parent, vec goes through a matrix row by row, Gₖ is the rigid motion of joint
//! k from the rest pose. The shift is the *root offset*: D-LAYERS adds it again
//! to the body in the world. Lengths are the model's (metres), numbers f64.
//!
//! Left out: dynamic blend shapes, hands and faces (SMPL-H, SMPL-X).

mod load;

use std::sync::Arc;

use crate::error::{DatasetError, Result};
use drape_geometry::rigid::{Matrix3, rotate};

/// A body model of one sex.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyModel {
    /// `[vertex, 3]`
    template: Vec<[f64; 3]>,
    /// `[vertex, 3, shape]`
    shape_directions: Vec<f64>,
    shapes: usize,
    /// `[vertex, 3, 9·(joint − 1)]`
    pose_directions: Vec<f64>,
    /// Entries (joint, vertex, weight) of the joint regressor.
    regressor: Vec<(usize, usize, f64)>,
    /// `[vertex]`: joints that move it, with weights.
    weights: Vec<Vec<(usize, f64)>>,
    /// Parent of each joint but the first; parents come first.
    parents: Vec<usize>,
    faces: Vec<[u32; 3]>,
}

/// A body model with a shape.
#[derive(Clone, Debug)]
pub struct ShapedBody {
    model: Arc<BodyModel>,
    /// `[vertex, 3]`, joint 0 in the origin.
    rest: Vec<[f64; 3]>,
    /// `[joint, 3]`, joint 0 in the origin.
    joints: Vec<[f64; 3]>,
    root_offset: [f64; 3],
}

impl BodyModel {
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.template.len()
    }

    /// Number of joints, the root included.
    pub fn joint_count(&self) -> usize {
        self.parents.len() + 1
    }

    /// Triangles, `[face, 3]`.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The body with shape parameters β; fewer than the model has leave the rest zero.
    ///
    /// # Errors
    /// More parameters than the model has.
    pub fn shaped(self: &Arc<Self>, betas: &[f64]) -> Result<ShapedBody> {
        if betas.len() > self.shapes {
            return Err(DatasetError::invalid(
                "betas",
                format!(
                    "at most {} shape parameters, as the body model has",
                    self.shapes
                ),
                betas.len().to_string(),
            ));
        }
        let mut rest = self.template.clone();
        if self.shapes > 0 {
            let directions = self.shape_directions.chunks_exact(self.shapes);
            for (x, directions) in rest.as_flattened_mut().iter_mut().zip(directions) {
                *x += directions
                    .iter()
                    .zip(betas)
                    .map(|(d, b)| d * b)
                    .sum::<f64>();
            }
        }
        let mut joints = vec![[0.0; 3]; self.joint_count()];
        for &(joint, vertex, weight) in &self.regressor {
            for k in 0..3 {
                joints[joint][k] += weight * rest[vertex][k];
            }
        }
        let root_offset = joints[0];
        for point in rest.iter_mut().chain(&mut joints) {
            for k in 0..3 {
                point[k] -= root_offset[k];
            }
        }
        Ok(ShapedBody {
            model: Arc::clone(self),
            rest,
            joints,
            root_offset,
        })
    }
}

impl ShapedBody {
    /// The model.
    pub fn model(&self) -> &BodyModel {
        &self.model
    }

    /// Rest pose with joint 0 in the origin, `[vertex, 3]`.
    pub fn rest(&self) -> &[[f64; 3]] {
        &self.rest
    }

    /// Where the regressor puts joint 0 before it is shifted to the origin.
    pub fn root_offset(&self) -> [f64; 3] {
        self.root_offset
    }

    /// Vertices in a pose, `[vertex, 3]`; `pose` holds an axis-angle vector per joint.
    ///
    /// # Errors
    /// Another number of joints.
    pub fn posed(&self, pose: &[[f64; 3]], translation: [f64; 3]) -> Result<Vec<[f64; 3]>> {
        let model = &*self.model;
        if pose.len() != model.joint_count() {
            let expected = format!("{} joints, as the body model has", model.joint_count());
            return Err(DatasetError::invalid(
                "pose",
                expected,
                pose.len().to_string(),
            ));
        }
        let rotations: Vec<Matrix3> = pose.iter().map(|&r| rotation_of(r)).collect();
        let feature: Vec<f64> = rotations[1..]
            .iter()
            .flat_map(|r| (0..9).map(move |i| r[i / 3][i % 3] - f64::from(u8::from(i % 4 == 0))))
            .collect();
        let motions = self.joint_motions(&rotations);
        let mut vertices = self.rest.clone();
        if !feature.is_empty() {
            let directions = model.pose_directions.chunks_exact(feature.len());
            for (x, directions) in vertices.as_flattened_mut().iter_mut().zip(directions) {
                *x += directions
                    .iter()
                    .zip(&feature)
                    .map(|(d, f)| d * f)
                    .sum::<f64>();
            }
        }
        for (vertex, weights) in vertices.iter_mut().zip(&model.weights) {
            let mut moved = translation;
            for &(joint, weight) in weights {
                let (rotation, shift) = &motions[joint];
                let p = rotate(rotation, *vertex);
                for k in 0..3 {
                    moved[k] += weight * (p[k] + shift[k]);
                }
            }
            *vertex = moved;
        }
        Ok(vertices)
    }

    /// Rotation and shift of each joint's rigid motion from the rest pose.
    fn joint_motions(&self, rotations: &[Matrix3]) -> Vec<(Matrix3, [f64; 3])> {
        // Posed joints first: the place of a joint in its parent's frame is fixed.
        let mut placed = vec![(rotations[0], self.joints[0])];
        for joint in 1..rotations.len() {
            let parent = self.model.parents[joint - 1];
            let (turn, place) = &placed[parent];
            let bone = std::array::from_fn(|k| self.joints[joint][k] - self.joints[parent][k]);
            let bone = rotate(turn, bone);
            let place = std::array::from_fn(|k| place[k] + bone[k]);
            placed.push((product(turn, &rotations[joint]), place));
        }
        placed
            .into_iter()
            .zip(&self.joints)
            .map(|((turn, place), &joint)| {
                let turned = rotate(&turn, joint);
                (turn, std::array::from_fn(|k| place[k] - turned[k]))
            })
            .collect()
    }
}

/// Rotation about the vector's direction by its length (Rodrigues).
pub fn rotation_of(axis_angle: [f64; 3]) -> Matrix3 {
    let [x, y, z] = axis_angle;
    let angle2 = x * x + y * y + z * z;
    // sin θ/θ and (1 − cos θ)/θ²; below 1e-4 their series are exact to 1e-17.
    let (s, c) = if angle2 < 1e-8 {
        (1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0)
    } else {
        let angle = angle2.sqrt();
        let half = (angle / 2.0).sin() / angle;
        (angle.sin() / angle, 2.0 * half * half)
    };
    [
        [
            1.0 - c * (y * y + z * z),
            c * x * y - s * z,
            c * x * z + s * y,
        ],
        [
            c * x * y + s * z,
            1.0 - c * (x * x + z * z),
            c * y * z - s * x,
        ],
        [
            c * x * z - s * y,
            c * y * z + s * x,
            1.0 - c * (x * x + y * y),
        ],
    ]
}

fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_agree_with_their_quaternions_at_every_angle() {
        let axis = [2.0 / 7.0, -3.0 / 7.0, 6.0 / 7.0];
        for angle in [
            0.0,
            1e-9,
            0.99e-4,
            1.01e-4,
            0.3,
            3.0,
            std::f64::consts::PI,
            9.0,
        ] {
            let (sin, cos) = f64::sin_cos(angle / 2.0);
            let quaternion = [cos, sin * axis[0], sin * axis[1], sin * axis[2]];
            let expected = drape_geometry::rigid::matrix_from_quaternion(quaternion);
            let found = rotation_of(axis.map(|x| angle * x));
            for (a, b) in found.as_flattened().iter().zip(expected.as_flattened()) {
                assert!((a - b).abs() < 1e-15, "{angle}: {found:?} {expected:?}");
            }
        }
    }
}

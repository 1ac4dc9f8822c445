//! How far knees bend before thigh and calf close over the cloth between them.
//!
//! Beyond some bend, other for every body, the hollow of the knee is shut: cloth in it
//! has no place that is not inside the body. A squat then ends where thigh and calf
//! still leave room, apart from the fold at the joint itself.

use drape_geometry::intersect::count_between;
use drape_geometry::normals::vertex_normals;

use super::angles::{Angles, pose_from_angles};
use super::{Motion, Movement};
use crate::body::{Body, Pose, ShapedBody};
use crate::error::Result;

/// Nearer to the knee than this share of a bone, thigh and calf belong to the fold.
const FOLD: f64 = 0.2;
/// Steps in which the deepest bend is looked for, in degrees.
const STEP_DEG: f64 = 2.0;
/// No squat goes on where it could not begin.
const LEAST_DEG: f64 = 60.0;

impl Motion {
    /// Ends squats where thigh and calf leave `room` units for cloth; the deepest bend in degrees,
    /// if one was to go deeper.
    ///
    /// # Errors
    /// The body's rig lacks a joint.
    pub fn leave_room_at_knees(
        &mut self,
        body: &Body,
        shaped: &ShapedBody,
        rest: &Pose,
        room: f64,
    ) -> Result<Option<f64>> {
        let mut ended = None;
        for movement in &mut self.movements {
            if let Movement::Squat { knee_deg, .. } = movement {
                let deepest = deepest_bend(body, shaped, rest, *knee_deg, room)?;
                if deepest < *knee_deg {
                    *knee_deg = deepest;
                    ended = Some(deepest);
                }
            }
        }
        Ok(ended)
    }
}

/// The largest bend up to `wanted` degrees that leaves room.
fn deepest_bend(
    body: &Body,
    shaped: &ShapedBody,
    rest: &Pose,
    wanted: f64,
    room: f64,
) -> Result<f64> {
    let [thigh, calf] = parts(body, shaped)?;
    let mut bend = wanted;
    while bend > LEAST_DEG {
        let squat = Movement::Squat {
            knee_deg: bend,
            period_s: 1.0,
            phase: 0.5,
        };
        let mut angles = Angles::default();
        squat.add(0.0, &mut angles);
        let positions = shaped.pose(&pose_from_angles(body, rest, &angles)?);
        let mut grown = positions.clone();
        for (p, n) in (grown.iter_mut()).zip(vertex_normals(&positions, body.faces())) {
            for axis in 0..3 {
                p[axis] += room as f32 * n[axis];
            }
        }
        if count_between(&grown, &thigh, &positions, &calf) == 0 {
            break;
        }
        bend -= STEP_DEG;
    }
    Ok(bend)
}

/// Faces of the left thigh and of the left calf, apart from the fold between them.
fn parts(body: &Body, shaped: &ShapedBody) -> Result<[Vec<[u32; 3]>; 2]> {
    let [hip, knee, ankle] = [
        body.joint("LeftUpLeg")?,
        body.joint("LeftLeg")?,
        body.joint("LeftFoot")?,
    ];
    let main = body.main_joint();
    let at = |joint| shaped.head(joint);
    let unposed = shaped.pose(&shaped.rest_pose());
    let of = |joint, end| -> Vec<[u32; 3]> {
        let (from, bone) = (at(knee), at(end) - at(knee));
        let apart = |v: u32| {
            let place = glam::DVec3::from_array(unposed[v as usize].map(f64::from));
            let along = (place - from).dot(bone) / bone.length_squared();
            main[v as usize] == joint && along > FOLD
        };
        let faces = body.faces().iter();
        let faces = faces.filter(|face| face.iter().all(|&v| apart(v)));
        faces.copied().collect()
    };
    Ok([of(hip, hip), of(knee, ankle)])
}

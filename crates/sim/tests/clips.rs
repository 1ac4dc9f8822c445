//! Recorded motions: our body does what the file's skeleton does.

use drape_sim::body::{Body, Shape};
use drape_sim::garment::fitting_pose;
use drape_sim::motion::{Clip, LeadIn, Motion, NEEDED};
use glam::{DQuat, DVec3, EulerRot};

/// A person with the arms straight out, in the file's axes (Y up, facing +Z) and inches.
const SKELETON: [(&str, Option<usize>, [f64; 3]); 13] = [
    ("Hips", None, [0.0, 36.0, 0.0]),
    ("LeftUpLeg", Some(0), [3.5, -1.0, 0.0]),
    ("LeftLeg", Some(1), [0.0, -17.0, 0.0]),
    ("LeftFoot", Some(2), [0.0, -16.0, 0.5]),
    ("RightUpLeg", Some(0), [-3.5, -1.0, 0.0]),
    ("RightLeg", Some(4), [0.0, -17.0, 0.0]),
    ("RightFoot", Some(5), [0.0, -16.0, 0.5]),
    ("Spine", Some(0), [0.0, 4.0, 0.0]),
    ("LeftArm", Some(7), [7.0, 14.0, 0.0]),
    ("LeftForeArm", Some(8), [11.0, 0.0, 0.0]),
    ("RightArm", Some(7), [-7.0, 14.0, 0.0]),
    ("RightForeArm", Some(10), [-11.0, 0.0, 0.0]),
    ("LeftHand", Some(9), [9.0, 0.0, 0.0]),
];

/// Angles in degrees (Z, X, Y) of each joint in a frame.
type Angles = fn(joint: usize, frame: usize) -> [f64; 3];

fn file(folder: &std::path::Path, frames: usize, skip: &str, angles: Angles) -> Clip {
    let mut text = String::from("HIERARCHY\n");
    let mut order = Vec::new();
    write_joint(0, skip, &mut text, &mut order);
    text += &format!("MOTION\nFrames: {frames}\nFrame Time: 0.0333333\n");
    for frame in 0..frames {
        let mut numbers = vec![0.0, 36.0, 0.0];
        for &joint in &order {
            numbers.extend(angles(joint, frame));
        }
        let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
        text += &(words.join(" ") + "\n");
    }
    let path = folder.join("motion.bvh");
    std::fs::write(&path, text).unwrap();
    Clip {
        path,
        start: 0.0,
        pace: 1.0,
    }
}

fn write_joint(joint: usize, skip: &str, text: &mut String, order: &mut Vec<usize>) {
    let (name, parent, offset) = SKELETON[joint];
    order.push(joint);
    let name = if name == skip { "Elsewhere" } else { name };
    let [x, y, z] = offset;
    let (what, position) = match parent {
        None => ("ROOT", "6 Xposition Yposition Zposition"),
        Some(_) => ("JOINT", "3"),
    };
    *text += &format!(
        "{what} {name}\n{{\nOFFSET {x} {y} {z}\nCHANNELS {position} Zrotation Xrotation Yrotation\n"
    );
    for (child, (_, parent, _)) in SKELETON.iter().enumerate() {
        if *parent == Some(joint) {
            write_joint(child, skip, text, order);
        }
    }
    *text += "End Site\n{\nOFFSET 0 1 0\n}\n}\n";
}

/// Directions of the file's bones in our axes, by forward kinematics of its own.
fn bone(from: usize, to: usize, frame: usize, angles: Angles) -> DVec3 {
    let turn = |joint: usize| {
        let [z, x, y] = angles(joint, frame).map(f64::to_radians);
        DQuat::from_euler(EulerRot::ZXY, z, x, y)
    };
    let mut direction = DVec3::from_array(SKELETON[to].2);
    let mut joint = Some(from);
    while let Some(at) = joint {
        direction = turn(at) * direction;
        joint = SKELETON[at].1;
    }
    DVec3::new(direction.x, -direction.z, direction.y).normalize()
}

fn wild(joint: usize, frame: usize) -> [f64; 3] {
    // The hips keep their heading, so that the motion already faces forward.
    let size = if joint == 0 { 0.0 } else { 25.0 };
    let at = (joint * 7) as f64 + 0.2 * frame as f64;
    [
        size * at.sin(),
        size * (1.3 * at).cos(),
        0.5 * size * (0.7 * at).sin(),
    ]
}

const BONES: [(usize, usize); 7] = [(1, 2), (2, 3), (4, 5), (5, 6), (8, 9), (10, 11), (9, 12)];

#[test]
fn bones_of_the_body_point_where_the_bones_of_the_file_point() {
    let folder = tempfile::tempdir().unwrap();
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    let motion = Motion {
        clip: Some(file(folder.path(), 40, "", wild)),
        ..Motion::default()
    };
    let lead = LeadIn { still: 0, ease: 0 };
    let poses = motion.poses(&body, &shaped, &rest, 30.0, lead, 30).unwrap();
    // Without frames to ease in, the first one is the rest pose still.
    for (frame, pose) in poses.iter().enumerate().skip(1) {
        let joints = shaped.joints(pose);
        let place = |joint: usize| {
            let joint = body.joint(SKELETON[joint].0).unwrap();
            joints[joint.index()].0
        };
        for (from, to) in BONES {
            let found = (place(to) - place(from)).normalize();
            let expected = bone(from, to, frame, wild);
            // The file's frame time is rounded.
            assert!(
                found.distance(expected) < 1e-3,
                "frame {frame}, {}: {found} instead of {expected}",
                SKELETON[from].0
            );
        }
    }
}

#[test]
fn clips_start_from_the_rest_pose_face_forward_and_stand_on_the_ground() {
    let folder = tempfile::tempdir().unwrap();
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    // Turned to the side as a whole, arms swinging.
    let turned: Angles = |joint, frame| match joint {
        0 => [0.0, 0.0, 90.0],
        8 => [-60.0, 20.0 * (0.3 * frame as f64).sin(), 0.0],
        10 => [60.0, 20.0 * (0.3 * frame as f64).sin(), 0.0],
        _ => [0.0; 3],
    };
    let motion = Motion {
        clip: Some(file(folder.path(), 60, "", turned)),
        ..Motion::default()
    };
    let lead = LeadIn { still: 3, ease: 20 };
    let poses = motion.poses(&body, &shaped, &rest, 30.0, lead, 40).unwrap();
    assert_eq!(poses.len(), 63);
    for (a, b) in poses[2].rotations.iter().zip(&rest.rotations) {
        assert!(a.angle_between(*b) < 1e-6);
    }
    let forward = poses[30].rotations[0] * DVec3::NEG_Y;
    assert!(forward.distance(DVec3::NEG_Y) < 1e-6, "{forward}");
    let mut before = shaped.pose(&poses[0]);
    for (frame, pose) in poses.iter().enumerate() {
        let positions = shaped.pose(pose);
        let lowest = positions.iter().map(|p| p[2]).fold(f32::INFINITY, f32::min);
        assert!((-0.7..0.7).contains(&lowest), "frame {frame}: {lowest}");
        let jump = positions
            .iter()
            .zip(&before)
            .map(|(a, b)| glam::Vec3::from(*a).distance(glam::Vec3::from(*b)))
            .fold(0.0, f32::max);
        assert!(jump < 2.0, "frame {frame}: {jump} units");
        before = positions;
    }
}

#[test]
fn a_file_without_a_needed_joint_or_too_short_is_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    let lead = LeadIn { still: 0, ease: 0 };
    let message = |skip: &str, frames| {
        let motion = Motion {
            clip: Some(file(folder.path(), 20, skip, wild)),
            ..Motion::default()
        };
        let poses = motion.poses(&body, &shaped, &rest, 30.0, lead, frames);
        poses.unwrap_err().to_string()
    };
    for name in NEEDED {
        let message = message(name, 10);
        assert!(message.contains(&format!("found no {name}")), "{message}");
        assert!(message.contains("motion.bvh"), "{message}");
    }
    let message = message("", 30);
    assert!(message.contains("at least 1.00 s"), "{message}");
}

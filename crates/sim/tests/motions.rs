//! What every drawn motion guarantees.

use drape_dataset::random::stream;
use drape_geometry::intersect::count_within;
use drape_sim::body::{Body, Pose, Shape, ShapeRanges};
use drape_sim::garment::fitting_pose;
use drape_sim::motion::{LeadIn, Motion, MotionFamily, Movement, keep_clear};
use glam::DVec3;

#[test]
fn motions_start_still_stay_on_the_ground_and_move_like_a_person() {
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    let lead = LeadIn { still: 3, ease: 25 };
    let fps = 30.0;
    for number in 0..24 {
        let motion = MotionFamily::Mixed.sample(&mut stream(number, "motion"));
        let poses = motion.poses(&body, &shaped, &rest, fps, lead, 48).unwrap();
        assert_eq!(poses.len(), 76);
        let start = shaped.pose(&rest);
        let still = shaped.pose(&poses[2]);
        let moved = |a: &[[f32; 3]], b: &[[f32; 3]]| {
            a.iter()
                .zip(b)
                .map(|(a, b)| DVec3::from(a.map(f64::from)).distance(DVec3::from(b.map(f64::from))))
                .fold(0.0, f64::max)
        };
        assert!(
            moved(&start, &still) < 1e-4,
            "motion {number} starts with a jump"
        );

        let bodies: Vec<_> = poses.iter().map(|pose| shaped.pose(pose)).collect();
        for (frame, positions) in bodies.iter().enumerate() {
            let lowest = positions.iter().map(|p| p[2]).fold(f32::INFINITY, f32::min);
            assert!(
                (-0.6..0.8).contains(&lowest),
                "motion {number}, frame {frame}: lowest point at {lowest} units: {motion:?}"
            );
        }
        let at = |frame: usize, v: usize| DVec3::from(bodies[frame][v].map(f64::from)) / 10.0;
        let (mut fastest, mut hardest) = (0.0f64, 0.0f64);
        for frame in 1..75 {
            for v in 0..body.vertex_count() {
                let (a, b, c) = (at(frame - 1, v), at(frame, v), at(frame + 1, v));
                fastest = fastest.max((c - b).length() * fps);
                hardest = hardest.max((c - 2.0 * b + a).length() * fps * fps);
            }
        }
        assert!(fastest > 0.3, "motion {number} hardly moves: {fastest} m/s");
        assert!(fastest < 6.0, "motion {number}: {fastest} m/s: {motion:?}");
        assert!(
            hardest < 80.0,
            "motion {number}: {hardest} m/s²: {motion:?}"
        );
    }
}

#[test]
fn half_the_pace_takes_twice_the_frames() {
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    let lead = LeadIn { still: 0, ease: 0 };
    for number in 0..6 {
        let brisk = MotionFamily::Mixed.sample(&mut stream(number, "motion"));
        let slow = brisk.clone().at_pace(0.5);
        let poses =
            |motion: &Motion, frames| motion.poses(&body, &shaped, &rest, 30.0, lead, frames);
        let (brisk, slow) = (poses(&brisk, 12).unwrap(), poses(&slow, 24).unwrap());
        for (frame, pose) in brisk.iter().enumerate() {
            for (a, b) in pose.rotations.iter().zip(&slow[2 * frame].rotations) {
                let apart = a.angle_between(*b).min(a.angle_between(-*b));
                assert!(apart < 1e-6, "motion {number}, frame {frame}: {apart} rad");
            }
        }
        assert_ne!(brisk[1].rotations, slow[1].rotations);
    }
}

#[test]
fn every_family_is_smooth_faster_than_calm_ones_may_be_and_lands_on_the_ground() {
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    let lead = LeadIn { still: 0, ease: 25 };
    let fps = 30.0;
    for family in MotionFamily::SINGLE {
        for seed in 0..2 {
            let motion = family.sample(&mut stream(seed, "family"));
            let again = family.sample(&mut stream(seed, "family"));
            assert_eq!(motion, again, "{family:?}");
            let poses = motion.poses(&body, &shaped, &rest, fps, lead, 75).unwrap();
            let bodies: Vec<_> = poses.iter().map(|pose| shaped.pose(pose)).collect();
            let lowest = |positions: &Vec<[f32; 3]>| {
                let heights = positions.iter().map(|p| p[2]);
                heights.fold(f32::INFINITY, f32::min)
            };
            let heights: Vec<f32> = bodies.iter().map(lowest).collect();
            assert!(
                heights.iter().all(|z| *z > -1.2),
                "{family:?}, seed {seed}: {heights:?}"
            );
            let touches = heights.iter().any(|z| z.abs() < 0.8);
            assert!(touches, "{family:?}, seed {seed}: {heights:?}");
            let at = |frame: usize, v: usize| DVec3::from(bodies[frame][v].map(f64::from)) / 10.0;
            let (mut fastest, mut hardest) = (0.0f64, 0.0f64);
            for frame in 1..bodies.len() - 1 {
                for v in (0..body.vertex_count()).step_by(7) {
                    let (a, b, c) = (at(frame - 1, v), at(frame, v), at(frame + 1, v));
                    fastest = fastest.max(0.5 * (c - a).length() * fps);
                    hardest = hardest.max((c - 2.0 * b + a).length() * fps * fps);
                }
            }
            // A kicking foot reaches 8 m/s, a fist that turns back 150 m/s².
            assert!(
                (0.2..9.0).contains(&fastest),
                "{family:?}: {fastest} m/s: {motion:?}"
            );
            assert!(hardest < 160.0, "{family:?}: {hardest} m/s²: {motion:?}");
        }
    }
}

#[test]
fn arms_that_hang_into_the_hips_are_turned_away_smoothly_and_the_rest_pose_stays() {
    let body = Body::load().unwrap();
    let shaped = body.shaped(&Shape::default());
    let rest = fitting_pose(&body, &shaped).unwrap();
    let lead = LeadIn { still: 4, ease: 20 };
    let motion = Motion {
        arms_down_deg: 50.0,
        ..Motion::default()
    };
    let plain = motion.poses(&body, &shaped, &rest, 30.0, lead, 10).unwrap();
    let gap = 0.2;
    let mut poses = plain.clone();
    let found = keep_clear(&body, &shaped, &mut poses, lead.still, gap).unwrap();
    assert!(!found.turned.is_empty(), "the arms are in the hips");
    assert!(found.tight.is_empty(), "{found:?}");
    assert_eq!(poses[..4], plain[..4], "still frames stay as they are");
    let mut once_more = poses.clone();
    let nothing = keep_clear(&body, &shaped, &mut once_more, lead.still, gap).unwrap();
    assert!(nothing.turned.is_empty(), "what is clear is left alone");
    assert_eq!(once_more, poses);
    for pair in poses.windows(2) {
        for (a, b) in pair[0].rotations.iter().zip(&pair[1].rotations) {
            let turn = a.angle_between(*b).to_degrees();
            assert!(turn < 9.0, "{turn}° from one frame to the next");
        }
    }
}

#[test]
fn flesh_gives_way_in_deep_squats_and_leaves_room_for_cloth() {
    let body = Body::load().unwrap();
    let lead = LeadIn { still: 0, ease: 1 };
    let main = body.main_joint();
    let [hip, knee, ankle] =
        ["LeftUpLeg", "LeftLeg", "LeftFoot"].map(|name| body.joint(name).unwrap());
    for seed in 0..4 {
        let shape = ShapeRanges::default().sample(&mut stream(seed, "knees"));
        let shaped = body.shaped(&shape);
        let rest = fitting_pose(&body, &shaped).unwrap();
        let motion = Motion {
            movements: vec![Movement::Squat {
                knee_deg: 120.0,
                period_s: 2.0,
                phase: 0.0,
            }],
            ..Motion::default()
        };
        let poses = motion.poses(&body, &shaped, &rest, 30.0, lead, 31).unwrap();
        let place = |p: [f32; 3]| DVec3::from(p.map(f64::from));
        // Thigh and calf away from the joint, on either side of the plane that halves the knee.
        let unposed = shaped.pose(&shaped.rest_pose());
        let part = |joint, end| -> Vec<usize> {
            let bone = shaped.head(end) - shaped.head(knee);
            let far = |v: &usize| {
                let along = (place(unposed[*v]) - shaped.head(knee)).dot(bone);
                main[*v] == joint && along > 0.1 * bone.length_squared()
            };
            (0..body.vertex_count()).filter(far).collect()
        };
        let (thigh, calf) = (part(hip, hip), part(knee, ankle));
        let deepest = shaped.pose(&poses[31]);
        let nearest = thigh
            .iter()
            .flat_map(|&a| calf.iter().map(move |&b| (a, b)))
            .map(|(a, b)| place(deepest[a]).distance(place(deepest[b])))
            .fold(f64::INFINITY, f64::min);
        assert!(nearest > 0.13, "{nearest} units left, seed {seed}");
        // Nothing jumps where flesh begins to give way.
        for pair in poses.windows(2) {
            let [a, b] = [0, 1].map(|k: usize| shaped.pose(&pair[k]));
            let root = shaped.joints(&pair[1])[0].0 - shaped.joints(&pair[0])[0].0;
            let step = |v: &usize| (place(b[*v]) - place(a[*v]) - root).length();
            let most = thigh.iter().chain(&calf).map(step).fold(0.0, f64::max);
            assert!(most < 1.5, "{most} units in a frame");
        }
    }
}

#[test]
fn arms_that_cross_do_so_in_front_of_the_chest_and_stay_clear_of_it() {
    let body = Body::load().unwrap();
    let lead = LeadIn { still: 0, ease: 1 };
    let joint = |name| body.joint(name).unwrap();
    let hands = ["LeftFingerBase", "RightFingerBase"].map(joint);
    let chest = joint("Spine1");
    for seed in 0..6 {
        let mut draws = stream(seed, "arms");
        let shaped = body.shaped(&ShapeRanges::default().sample(&mut draws));
        let rest = fitting_pose(&body, &shaped).unwrap();
        let motion = MotionFamily::CrossArms.sample(&mut draws);
        let mut poses = motion.poses(&body, &shaped, &rest, 30.0, lead, 90).unwrap();
        // Left hand to the right of the right one, both in front, seen from the chest.
        let crossed = |pose: &Pose| {
            let joints = shaped.joints(pose);
            let (place, turn) = joints[chest.index()];
            let [l, r] = hands.map(|hand| turn.inverse() * (joints[hand.index()].0 - place));
            l.x < r.x && l.y < -1.0 && r.y < -1.0
        };
        let (some, all) = (
            poses.iter().filter(|pose| crossed(pose)).count(),
            poses.len(),
        );
        assert!(
            (all / 10..all).contains(&some),
            "crossed in {some} of {all} frames, seed {seed}: {motion:?}"
        );
        let found = keep_clear(&body, &shaped, &mut poses, 0, 0.04).unwrap();
        assert!(found.tight.is_empty(), "seed {seed}: {found:?}");
    }
}

#[test]
fn skin_does_not_cross_itself_in_far_bends() {
    let body = Body::load().unwrap();
    let lead = LeadIn { still: 0, ease: 1 };
    let families = [
        MotionFamily::DeepSquat,
        MotionFamily::Kick,
        MotionFamily::LegLift,
        MotionFamily::Lunge,
        MotionFamily::ArmSwing,
        MotionFamily::Twist,
    ];
    for (seed, family) in (0..3).flat_map(|seed| families.map(|family| (seed, family))) {
        let mut draws = stream(seed, "skin");
        let shaped = body.shaped(&ShapeRanges::default().sample(&mut draws));
        let rest = fitting_pose(&body, &shaped).unwrap();
        let at_rest = count_within(&shaped.pose(&rest), body.faces());
        let motion = family.sample(&mut draws);
        let poses = motion.poses(&body, &shaped, &rest, 30.0, lead, 60).unwrap();
        for (frame, pose) in poses.iter().enumerate().step_by(5) {
            let crossed = count_within(&shaped.pose(pose), body.faces());
            assert!(
                crossed <= at_rest,
                "{family:?}, seed {seed}, frame {frame}: {crossed} hits, {at_rest} at rest"
            );
        }
    }
}

#[test]
fn poses_that_are_not_finite_are_posed_without_panic() {
    let body = Body::load().unwrap();
    let shaped = body.shaped(&ShapeRanges::default().sample(&mut stream(0, "knees")));
    for broken in ["LowerBack", "LeftUpLeg", "LeftLeg", "LeftFoot"] {
        let mut pose = shaped.rest_pose();
        let quarter = glam::DQuat::from_rotation_x(1.7);
        for (joint, turn) in [("LeftUpLeg", quarter.inverse()), ("LeftLeg", quarter)] {
            pose.rotations[body.joint(joint).unwrap().index()] = turn;
        }
        pose.rotations[body.joint(broken).unwrap().index()].w = f64::NAN;
        let positions = shaped.pose(&pose);
        assert!(positions.iter().flatten().any(|x| x.is_nan()), "{broken}");
        assert!(
            positions.iter().flatten().any(|x| x.is_finite()),
            "{broken}"
        );
    }
}

//! What every drawn motion guarantees.

use drape_dataset::random::stream;
use drape_sim::body::{Body, Shape};
use drape_sim::garment::fitting_pose;
use drape_sim::motion::{LeadIn, Motion, MotionFamily};
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

//! The profile tells of every effect that ran, of no other, and changes nothing.

use std::time::Duration;

use super::*;
use crate::engine::profile::{Part, Profile, recorded};

fn dressed_ball(effects: &[Effect]) -> Engine {
    let body = Body::ball([0.0; 3], 2.0);
    let garments = [
        sheet(9, 9, 0.25, 0, |x, y| [x - 1.0, y - 0.9, 2.06]),
        sheet(9, 9, 0.25, 1, |x, y| [x - 1.05, y - 0.95, 2.12]),
    ];
    engine(&garments, &body, effects)
}

fn run(effects: &[Effect]) -> Vec<u32> {
    let body = Body::ball([0.0; 3], 2.0);
    let mut engine = dressed_ball(effects);
    for frame in 1..=4 {
        let at = body.moved([0.05 * frame as f32, 0.0, 0.0]);
        engine.advance(&at, wind(100.0), FRAME_S).unwrap();
    }
    bits(&engine)
}

/// Effects that have rows.
fn effects_of(profile: &Profile) -> Vec<Effect> {
    let of = |part: &Part| match *part {
        Part::Effect(e) | Part::Search(e) | Part::Narrow(e) | Part::Solve(e) => Some(e),
        Part::Inertia | Part::Trees | Part::Certificate | Part::Strays | Part::Sides => None,
    };
    let mut effects: Vec<Effect> = profile.parts.keys().filter_map(of).collect();
    effects.sort_unstable();
    effects.dedup();
    effects
}

#[test]
fn every_effect_that_runs_has_its_rows_and_no_other_has() {
    let mut all = [&USUAL[..], &[Effect::Wind]].concat();
    all.sort_unstable();
    let (_, profile) = recorded(|| run(&all));
    assert_eq!(effects_of(&profile), all);
    assert_eq!(profile.frames, 4);
    let table = profile.to_string();
    for part in profile.parts.keys() {
        assert!(
            table.contains(&part.to_string()),
            "{part} is not in {table}"
        );
    }
    for left_out in &all {
        let effects: Vec<Effect> = all.iter().copied().filter(|e| e != left_out).collect();
        let (_, profile) = recorded(|| run(&effects));
        assert_eq!(effects_of(&profile), effects);
    }
}

#[test]
fn parts_and_the_rest_make_up_the_whole() {
    let (_, profile) = recorded(|| run(&USUAL));
    let parts: Duration = profile.parts.values().map(|spent| spent.time).sum();
    assert!(parts <= profile.total, "{parts:?} of {:?}", profile.total);
    assert_eq!(parts + profile.rest(), profile.total);
}

#[test]
fn being_watched_changes_no_bit() {
    let (watched, profile) = recorded(|| run(&USUAL));
    assert!(profile.frames > 0);
    assert_eq!(run(&USUAL), watched);
}

#[test]
fn an_engine_made_outside_a_recording_keeps_no_time() {
    let mut engine = dressed_ball(&USUAL);
    let body = Body::ball([0.0; 3], 2.0);
    let (_, profile) = recorded(|| {
        engine
            .advance(&body.positions, Wind::default(), FRAME_S)
            .unwrap()
    });
    assert_eq!(profile, Profile::default());
}

#[test]
fn recordings_within_recordings_both_get_the_times() {
    let ((_, inner), outer) = recorded(|| recorded(|| run(&USUAL)));
    assert!(inner.frames > 0);
    assert_eq!(inner, outer);
}

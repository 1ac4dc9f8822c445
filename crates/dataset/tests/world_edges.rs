//! World edges: those that looking at all pairs finds, on scenes of the published program.

#[allow(dead_code)]
mod reference;

use std::sync::Arc;

use drape_dataset::sample::{FrameStates, Outfit, StatePair, Step, pair};
use drape_dataset::statistics::StatisticsBuilder;
use drape_dataset::world_edges::{BODY_NEIGHBOURS, Reach, WorldEdges};
use reference::{PATCH_SIZE, Reference};

/// Start state and step of frame `at`.
fn scene(file: &Reference, at: usize) -> (Arc<Outfit>, Vec<StatePair>, Step) {
    let frames = file.frames("00001");
    let states = |f: usize| FrameStates::new(&frames[f], Some(&frames[f - 1]), None);
    let (older, now, next) = (states(at - 1), states(at), states(at + 1));
    let statistics = StatisticsBuilder::default().finish();
    let outfit = Arc::new(Outfit::new(&file.header(), PATCH_SIZE).unwrap());
    let state = now.garments.iter().zip(&older.garments);
    let state = state.map(|(now, older)| pair(now, older)).collect();
    let step = Step::new(&next, &now, &statistics, [0.0; 3]);
    (outfit, state, step)
}

fn distance2(a: &[f32], b: &[f32]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (x * x + y * y) + z * z
}

/// All pairs, one after the other.
fn slow(outfit: &Outfit, state: &[StatePair], step: &Step, reach: Reach) -> [Vec<Vec<u32>>; 2] {
    let near = |d2: f32, radius: f32| d2 == 0.0 || d2 < radius * radius;
    let centres: Vec<_> = outfit.patches.means(state).collect();
    let across = |(p, a): (usize, &StatePair)| {
        let mut seen = Vec::new();
        for (q, b) in centres.iter().enumerate() {
            let joined = outfit.patches.neighbours.row(p).contains(&(q as u32));
            if !joined && near(distance2(a, b), reach.layer) {
                seen.push(q as u32);
            }
        }
        seen
    };
    let nearby = |a: &StatePair| {
        let body = step.body.iter().map(|b| distance2(a, b));
        let mut seen: Vec<_> = (0u32..).zip(body).collect();
        seen.retain(|&(_, d2)| near(d2, reach.body));
        seen.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        seen.truncate(BODY_NEIGHBOURS);
        seen.into_iter().map(|(vertex, _)| vertex).collect()
    };
    [
        centres.iter().enumerate().map(across).collect(),
        centres.iter().map(nearby).collect(),
    ]
}

#[test]
fn edges_are_those_that_all_pairs_give_and_patches_see_each_other_mutually() {
    let file = Reference::read("tiny_preprocess");
    let (mut across, mut nearby) = (0, 0);
    for at in [2, 7] {
        let (outfit, state, step) = scene(&file, at);
        for layer in [0.01, 0.4, 0.6, 50.0] {
            for body in [0.01, 0.4, 0.6, 50.0] {
                let reach = Reach { layer, body };
                let found = WorldEdges::new(&outfit, &state, &step, reach).unwrap();
                let [patches, skin] = slow(&outfit, &state, &step, reach);
                assert!(found.patches.iter().eq(patches.iter()), "{reach:?}");
                assert!(found.body.iter().eq(skin.iter()), "{reach:?}");
                for (p, q) in found.patches.pairs() {
                    assert!(found.patches.row(q as usize).contains(&p), "{p} {q}");
                }
                across += found.patches.items.len();
                nearby += found.body.items.len();
            }
        }
    }
    assert!(across > 0 && nearby > 0, "the scene has edges at all");
}

#[test]
fn reach_ends_at_the_distance_itself_and_a_mesh_edge_is_no_world_edge() {
    let file = Reference::read("tiny_preprocess");
    let (outfit, mut state, mut step) = scene(&file, 7);
    // Garments in two points 0.5 apart, both exact in binary; the body in a third.
    let border = outfit.garment_offsets[1];
    for (vertex, state) in state.iter_mut().enumerate() {
        let x = if vertex < border { 0.0 } else { 0.5 };
        state[..3].copy_from_slice(&[x, 0.0, 0.0]);
    }
    for body in &mut step.body {
        body[..3].copy_from_slice(&[-0.25, 0.0, 0.0]);
    }
    // The mean of equal numbers may be an ulp off them.
    let centre = |patch: usize| outfit.patches.means(&state).nth(patch).unwrap();
    let outer = outfit.patches.of_vertex.row(border)[0];
    let (inner, gap) = (centre(0), centre(outer as usize)[0] - centre(0)[0]);
    assert_eq!(inner[0], 0.0);
    let sees = |layer: f32, body: f32| {
        let edges = WorldEdges::new(&outfit, &state, &step, Reach { layer, body }).unwrap();
        let across = edges.patches.row(0).contains(&outer);
        for p in 0..outfit.patches.count() {
            let row = edges.patches.row(p);
            assert!(
                row.iter()
                    .all(|q| !outfit.patches.neighbours.row(p).contains(q))
            );
            let one_place = edges.body.row(p).iter().copied();
            assert!(
                one_place.eq(0..edges.body.row(p).len() as u32),
                "ties by index"
            );
        }
        (across, edges.body.row(0).len())
    };
    assert_eq!(sees(gap.next_down(), 0.25f32.next_down()), (false, 0));
    assert_eq!(sees(gap, 0.25), (false, 0));
    let found = outfit.body_vertices.min(BODY_NEIGHBOURS);
    assert_eq!(sees(gap.next_up(), 0.25f32.next_up()), (true, found));
}

#[test]
fn what_does_not_fit_the_outfit_is_refused_with_its_place() {
    let file = Reference::read("tiny_preprocess");
    let (outfit, state, step) = scene(&file, 7);
    let refused = |state: &[StatePair], step: &Step, reach: Reach| {
        let refused = WorldEdges::new(&outfit, state, step, reach);
        refused.unwrap_err().to_string()
    };
    let reach = Reach::default();
    let message = refused(&state[1..], &step, reach);
    assert!(
        message.contains("garment state") && message.contains("vertices"),
        "{message}"
    );
    let message = refused(&state, &Step::default(), reach);
    assert!(
        message.contains("body") && message.contains("found 0"),
        "{message}"
    );
    let mut broken = state.clone();
    broken[3][1] = f32::NAN;
    let message = refused(&broken, &step, reach);
    assert!(message.contains("garment state, vertex 3"), "{message}");
    for layer in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let message = refused(&state, &step, Reach { layer, ..reach });
        assert!(message.contains("reach.layer"), "{message}");
    }
}

#[test]
fn without_a_body_nothing_is_near_it() {
    let file = Reference::read("tiny_preprocess");
    let (outfit, state, step) = scene(&file, 7);
    let bare = Outfit {
        body_vertices: 0,
        ..Outfit::clone(&outfit)
    };
    let nobody = Step {
        body: Vec::new(),
        ..step.clone()
    };
    let edges = WorldEdges::new(&bare, &state, &nobody, Reach::default()).unwrap();
    assert_eq!(edges.body.rows(), outfit.patches.count());
    assert!(edges.body.items.is_empty());
    let dressed = WorldEdges::new(&outfit, &state, &step, Reach::default()).unwrap();
    assert_eq!(edges.patches, dressed.patches);
}

//! Drawing samples: each place once an epoch, the same order for the same seed, going
//! on where it was left, and statistics that two passes in f64 confirm.

#[path = "../examples/conformance/cases.rs"]
#[allow(dead_code)]
mod cases;
#[path = "../examples/conformance/json.rs"]
#[allow(dead_code)]
mod json;

use std::collections::BTreeSet;
use std::fs;

use drape_dataset::SequenceReader;
use drape_dataset::order::{FIRST_START, Order, Progress};
use drape_dataset::samples::{SampleOptions, Samples, read_states, statistics_of};
use drape_dataset::sequence::Frame;
use drape_dataset::splits::{DatasetIndex, Split};
use drape_dataset::statistics::StatisticsBuilder;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tempfile::TempDir;

const COUNTS: [usize; 3] = [4, 9, 30];

#[test]
fn every_place_comes_once_an_epoch_and_each_epoch_has_its_own_order() {
    for steps in [1, 2] {
        let counts = COUNTS.map(|count| count + steps);
        let order = Order::new(&counts, steps, 7).unwrap();
        let size = order.places_per_epoch();
        assert_eq!(
            size,
            counts.iter().map(|count| count - 2 - steps).sum::<usize>()
        );
        let drawn: Vec<_> = order.take(3 * size).collect();
        let epochs: Vec<_> = drawn.chunks(size).collect();
        for epoch in &epochs {
            let places: BTreeSet<_> = epoch.iter().collect();
            assert_eq!(places.len(), size, "each once");
            let fits = |p: &drape_dataset::order::Place| {
                p.frame >= 2 && p.frame + steps < counts[p.sequence]
            };
            assert!(epoch.iter().all(fits));
        }
        assert!(epochs[0] != epochs[1] && epochs[1] != epochs[2]);
        let again: Vec<_> = Order::new(&counts, steps, 7)
            .unwrap()
            .take(3 * size)
            .collect();
        assert_eq!(again, drawn, "same seed");
        let other: Vec<_> = Order::new(&counts, steps, 8).unwrap().take(size).collect();
        assert!(other != epochs[0], "another seed");
    }
}

#[test]
fn an_order_goes_on_from_any_place_as_if_it_had_never_stopped() {
    let whole: Vec<_> = Order::new(&COUNTS, 1, 3).unwrap().take(100).collect();
    let mut order = Order::new(&COUNTS, 1, 3).unwrap();
    for taken in 0..80 {
        let kept = serde_json::to_string(&order.progress()).unwrap();
        let mut resumed = Order::new(&COUNTS, 1, 3).unwrap();
        resumed
            .resume(serde_json::from_str(&kept).unwrap())
            .unwrap();
        let rest: Vec<_> = resumed.take(20).collect();
        assert_eq!(rest, whole[taken..taken + 20], "after {taken}");
        order.next();
    }
    let beyond = Progress {
        epoch: 0,
        drawn: 1000,
    };
    let message = order.resume(beyond).unwrap_err().to_string();
    assert!(message.contains("1000"), "{message}");
}

#[test]
fn sequences_that_are_too_short_are_named() {
    let message = Order::new(&[9, 5], 3, 0).unwrap_err().to_string();
    assert!(
        message.contains("sequence 1") && message.contains("at least 6"),
        "{message}"
    );
    assert!(Order::new(&[6], 3, 0).is_ok());
    assert!(Order::new(&[], 1, 0).is_err());
    let message = Order::new(&[9], 0, 0).unwrap_err().to_string();
    assert!(message.contains("steps: expected at least 1"), "{message}");
    // Behind files, by their names.
    let folder = TempDir::new().unwrap();
    let options = SampleOptions {
        steps: 3,
        patch_size_m: 0.4,
        seed: 0,
    };
    let refused = Samples::open(&dataset(&folder), Split::Train, options);
    let message = refused.err().unwrap().to_string();
    assert!(
        message.contains("s0.mcap")
            && message.contains("at least 6")
            && message.contains("found 5"),
        "{message}"
    );
}

/// Frames far from the origin, so that sums of squares would lose all digits.
fn frames(seed: u64, count: usize) -> Vec<Frame> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut place = move || [5e3, -2e4, 3.0].map(|far: f32| far + rng.random_range(-1.0..1.0));
    (0..count)
        .map(|f| {
            let mut frame = cases::two_layers_frames().remove(f % 3);
            frame.body.fill_with(&mut place);
            frame
                .garments
                .iter_mut()
                .for_each(|g| g.fill_with(&mut place));
            frame.root.translation = [f as f32 * 0.5, -1.0, 2.0];
            frame
        })
        .collect()
}

fn dataset(folder: &TempDir) -> DatasetIndex {
    let mut index = DatasetIndex::new(folder.path(), "small");
    for (number, count) in [5, 12, 7].into_iter().enumerate() {
        let file = format!("s{number}.mcap");
        let bytes = cases::written(&cases::two_layers(), &frames(number as u64, count));
        fs::write(folder.path().join(&file), bytes).unwrap();
        index.add(file, Split::Train).unwrap();
    }
    index
}

#[test]
fn statistics_of_one_pass_are_those_of_two_passes_in_f64() {
    let folder = TempDir::new().unwrap();
    let index = dataset(&folder);
    let mut merged = StatisticsBuilder::default();
    // Rows [pos, vel, acc] of every vertex of every frame from 2 on.
    let mut rows: Vec<[f64; 9]> = Vec::new();
    for entry in index.sequences() {
        let reader = index.open(entry).unwrap();
        merged = merged.merge(statistics_of(&reader, FIRST_START).unwrap());
        let states = read_states(&reader, 0..reader.frame_count(), 0.0).unwrap();
        for two in states[1..].windows(2) {
            let now = two[1].garments.iter().chain(&two[1].body);
            for (now, old) in now.zip(two[0].garments.iter().chain(&two[0].body)) {
                let acc = |axis: usize| now[3 + axis] - old[3 + axis];
                let row = [
                    now[0],
                    now[1],
                    now[2],
                    now[3],
                    now[4],
                    now[5],
                    acc(0),
                    acc(1),
                    acc(2),
                ];
                rows.push(row.map(f64::from));
            }
        }
    }
    let found = merged.finish().vertices;
    let count = rows.len() as f64;
    assert_eq!(
        rows.len(),
        (3 + 10 + 5) * 10,
        "frames from 2 on, ten vertices"
    );
    for column in 0..9 {
        let mean = rows.iter().map(|row| row[column]).sum::<f64>() / count;
        let square = rows
            .iter()
            .map(|row| (row[column] - mean).powi(2))
            .sum::<f64>();
        let std = (square / count).sqrt();
        // The tables are f32: half an ulp, 6e-8.
        let close =
            |found: f32, exact: f64, size: f64| (f64::from(found) - exact).abs() <= 1e-7 * size;
        let size = mean.abs().max(std);
        assert!(
            close(found.mean[column], mean, size),
            "mean {column}: {} {mean}",
            found.mean[column]
        );
        assert!(
            close(found.std[column], std, std),
            "std {column}: {} {std}",
            found.std[column]
        );
    }
}

#[test]
fn samples_come_in_the_orders_places_and_resume() {
    let folder = TempDir::new().unwrap();
    let index = dataset(&folder);
    let options = SampleOptions {
        steps: 2,
        seed: 5,
        patch_size_m: 0.4,
    };
    let open = || Samples::open(&index, Split::Train, options).unwrap();
    let order = open().order;
    let all: Vec<_> = open().take(20).map(Result::unwrap).collect();
    for (place, sample) in order.zip(&all) {
        let reader = SequenceReader::open(folder.path().join(format!("s{}.mcap", place.sequence)));
        let states = read_states(&reader.unwrap(), place.frame..place.frame + 3, 0.0).unwrap();
        assert_eq!(sample.steps.len(), 2);
        for (state, vertex) in sample.state.iter().zip(&states[0].garments) {
            assert_eq!(state[..6], vertex[..]);
        }
        assert_eq!(sample.reference[0], states[1].garments);
        assert_eq!(sample.reference[1], states[2].garments);
    }
    let mut left = open();
    assert!(left.by_ref().take(6).all(|sample| sample.is_ok()));
    let mut resumed = open();
    resumed.order.resume(left.order.progress()).unwrap();
    for (at, sample) in resumed.take(14).enumerate() {
        let sample = sample.unwrap();
        assert_eq!(sample.state, all[6 + at].state);
        assert_eq!(sample.steps, all[6 + at].steps);
    }
    assert!(
        Samples::open(&index, Split::Test, options).is_err(),
        "no such split"
    );
}

#[test]
fn held_out_samples_are_normalised_by_the_training_split() {
    let folder = TempDir::new().unwrap();
    let mut index = dataset(&folder);
    let options = SampleOptions {
        patch_size_m: 0.4,
        ..SampleOptions::default()
    };
    let of = |index: &DatasetIndex, split| {
        let samples = Samples::open(index, split, options).unwrap();
        *samples.statistics()
    };
    let training = of(&index, Split::Train);
    let bytes = cases::written(&cases::two_layers(), &frames(9, 8));
    fs::write(folder.path().join("held.mcap"), bytes).unwrap();
    index.add("held.mcap", Split::Test).unwrap();
    assert_eq!(of(&index, Split::Train), training);
    assert_eq!(of(&index, Split::Test), training);
    let held = SequenceReader::open(folder.path().join("held.mcap")).unwrap();
    let own = statistics_of(&held, FIRST_START).unwrap().finish();
    assert_ne!(own, training, "the test can fail");
    assert!(statistics_of(&held, FIRST_START - 1).is_err());

    // Without a training split, statistics must come from elsewhere.
    let mut alone = DatasetIndex::new(folder.path(), "held out");
    alone.add("held.mcap", Split::Test).unwrap();
    let refused = Samples::open(&alone, Split::Test, options).err().unwrap();
    assert!(refused.to_string().contains("split train"), "{refused}");
    let samples = Samples::open_normalised(&alone, Split::Test, options, own).unwrap();
    assert_eq!(*samples.statistics(), own);
}

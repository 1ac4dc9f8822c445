//! Sequences decoded on several threads: the same results in the same order, the
//! first error, and statistics that are the same bits.

#[path = "../examples/conformance/cases.rs"]
#[allow(dead_code)]
mod cases;
#[path = "../examples/conformance/json.rs"]
#[allow(dead_code)]
mod json;

use std::fs;
use std::num::NonZeroUsize;

use drape_dataset::sample::FrameStates;
use drape_dataset::splits::{DatasetIndex, Split};
use drape_dataset::statistics::{Statistics, StatisticsBuilder};
use tempfile::TempDir;

const SEQUENCES: usize = 7;

/// Sequences of different lengths, so that threads finish in another order.
fn dataset(folder: &TempDir) -> DatasetIndex {
    let mut index = DatasetIndex::new(folder.path(), "small");
    for number in 0..SEQUENCES {
        let mut header = cases::two_layers();
        header.name = format!("s{number}");
        let file = format!("s{number}.mcap");
        let mut frames = Vec::new();
        for f in 0..(37 * number) % 23 + 2 {
            let mut frame = cases::two_layers_frames().remove(f % 3);
            // The largest f32 has no finite square.
            frame.garments[0][1][0] = (f * number) as f32 * 0.7;
            frames.push(frame);
        }
        fs::write(folder.path().join(&file), cases::written(&header, &frames)).unwrap();
        index.add(file, Split::Train).unwrap();
    }
    index
}

#[test]
fn any_number_of_threads_gives_the_same_results_in_the_indexes_order() {
    let folder = TempDir::new().unwrap();
    let index = dataset(&folder);
    let entries: Vec<_> = index.sequences().iter().collect();
    let statistics = |threads| -> (Vec<String>, Statistics) {
        let work = |_: &_, reader: drape_dataset::SequenceReader| {
            let frames = reader.read_all()?;
            let mut builder = StatisticsBuilder::default();
            let states: Vec<_> = (0..frames.len())
                .map(|f| {
                    let older = |back: usize| f.checked_sub(back).map(|at| &frames[at]);
                    FrameStates::new(&frames[f], older(1), older(2))
                })
                .collect();
            states
                .windows(2)
                .for_each(|two| two[1].collect(&two[0], &mut builder));
            Ok((reader.header().name.clone(), builder))
        };
        let threads = NonZeroUsize::new(threads).unwrap();
        let parts = index.map(&entries, threads, work).unwrap();
        let (names, builders): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        let whole = builders
            .into_iter()
            .reduce(StatisticsBuilder::merge)
            .unwrap();
        (names, whole.finish())
    };
    let one = statistics(1);
    assert_eq!(
        one.0,
        (0..SEQUENCES).map(|n| format!("s{n}")).collect::<Vec<_>>()
    );
    for threads in [2, 3, 16] {
        assert_eq!(statistics(threads), one, "{threads} threads");
    }
    let none = index.map(&[], NonZeroUsize::MIN, |_, _| Ok(())).unwrap();
    assert!(none.is_empty());
}

#[test]
fn the_error_is_that_of_the_first_sequence_whoever_fails_first() {
    let folder = TempDir::new().unwrap();
    let index = dataset(&folder);
    let entries: Vec<_> = index.sequences().iter().collect();
    for broken in ["s2.mcap", "s5.mcap"] {
        fs::write(folder.path().join(broken), b"no sequence").unwrap();
    }
    for threads in [1, 2, 7] {
        let threads = NonZeroUsize::new(threads).unwrap();
        let error = index.map(&entries, threads, |_, reader| reader.read_all());
        let message = error.unwrap_err().to_string();
        assert!(message.contains("s2.mcap"), "{message}");
    }
}

//! Statistics: equal to the published program's tables, merging exact, constant
//! columns scaled by 1.

#[allow(dead_code)]
mod reference;

use drape_dataset::sample::FrameStates;
use drape_dataset::statistics::{ColumnStatistics, Moments, StatisticsBuilder};
use reference::Reference;

fn builder_of(file: &Reference, sequence: &str) -> StatisticsBuilder {
    let frames = file.frames(sequence);
    let mut builder = StatisticsBuilder::default();
    let mut previous: Option<FrameStates> = None;
    for f in 0..frames.len() {
        let older = |back: usize| f.checked_sub(back).map(|at| &frames[at]);
        let states = FrameStates::new(&frames[f], older(1), older(2));
        states.collect(previous.as_ref().unwrap_or(&states), &mut builder);
        previous = Some(states);
    }
    builder
}

fn compare(found: &ColumnStatistics, table: &[f64]) {
    for column in 0..9 {
        let (mean, std) = (f64::from(found.mean[column]), f64::from(found.std[column]));
        // Positions were rounded to f32; accelerations of 0.005 keep five digits.
        assert!(
            (mean - table[column]).abs() < 1e-6,
            "mean {column}: {mean}, {}",
            table[column]
        );
        assert!(
            (std / table[9 + column] - 1.0).abs() < 1e-5,
            "std {column}: {std}, {}",
            table[9 + column]
        );
    }
}

#[test]
fn tables_are_the_published_ones() {
    let file = Reference::read("tiny_preprocess");
    let both = builder_of(&file, "00001").merge(builder_of(&file, "00002"));
    let statistics = both.finish();
    compare(&statistics.vertices, &file.values("stat"));
    compare(&statistics.root, &file.values("trans_stat"));
}

#[test]
fn merging_equals_taking_all_rows_at_once() {
    let rows: Vec<[f64; 3]> = (0..50)
        .map(|i| [0.7, 1.3, 2.9].map(|k| (k * f64::from(i)).sin() + 1e3 * k))
        .collect();
    let all = Moments::of(rows.iter().copied());
    for split in [0, 1, 25, 49, 50] {
        let (a, b) = rows.split_at(split);
        let merged = Moments::of(a.iter().copied()).merge(Moments::of(b.iter().copied()));
        assert_eq!(merged.count, 50.0);
        for i in 0..3 {
            assert!((merged.mean[i] - all.mean[i]).abs() < 1e-10);
            for j in 0..3 {
                assert!((merged.covariance[i][j] - all.covariance[i][j]).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_constant_column_has_std_1_and_its_neighbour_its_own() {
    let rows = [[2.5, 1.0, 0.0], [2.5, 1.0, 1e-30], [2.5, 3.0, 0.0]];
    let std = Moments::of(rows.into_iter()).std();
    assert_eq!(std[0], 1.0);
    assert!((std[1] - (8.0f64 / 9.0).sqrt()).abs() < 1e-12);
    assert!(
        std[2] > 0.0 && std[2] < 1e-29,
        "nearly constant is not constant"
    );
    assert_eq!(Moments::default().std(), [1.0; 3], "no rows at all");
}

//! The four forms tell the same numbers.

use drape_dataset::registry::GarmentKind;
use serde_json::json;

use super::*;
use crate::{
    metrics::{FrameScore, GarmentScore},
    tally::Tally,
};

fn table() -> Table {
    let mut tally = Tally::default();
    for error_m in [0.01, 0.03] {
        let garment = |kind, inside_inner| GarmentScore {
            kind,
            vertices: 10,
            error_m,
            inside_body: 1,
            inside_inner,
        };
        tally.add(&FrameScore {
            garments: vec![
                garment(GarmentKind::TShirt, None),
                garment(GarmentKind::Jacket, Some(2)),
            ],
        });
    }
    let row = |method: &str, note| Row {
        method: method.to_owned(),
        threads: Some(2),
        ms_per_frame: Some(12.5),
        summary: Some(tally.summary()),
        note,
    };
    Table {
        conditions: Conditions {
            data: "data/default".to_owned(),
            data_hash: "abc".to_owned(),
            split: "test".to_owned(),
            sequences: 1,
            start: 2,
            steps: 35,
            notes: vec!["another reference".to_owned(), "no recipe".to_owned()],
        },
        rows: vec![
            row("LayersNet, small", None),
            row("engine", Some(0)),
            Row {
                threads: None,
                ms_per_frame: None,
                summary: None,
                note: Some(1),
                ..row("none", None)
            },
        ],
    }
}

#[test]
fn a_metre_is_ten_thousand_millimetres_at_the_tenfold_scale() {
    for text in [console(&table()), markdown(&table())] {
        assert!(text.contains("200.0 ± 100.0"), "{text}");
        assert!(text.contains("20.00 ± 10.00"), "{text}");
        assert!(
            text.contains("T-shirt") && text.contains("12.5") && !text.contains("Skirt"),
            "{text}"
        );
        assert!(
            text.contains("engine¹") && text.contains("¹ another reference"),
            "{text}"
        );
        assert!(text.contains("none²") && text.contains('–'), "{text}");
    }
}

#[test]
fn json_holds_every_measure_of_every_kind() {
    let json = json(&table());
    let groups = &json["rows"][0]["groups"];
    assert_eq!(
        groups["overall"]["error_mm_10x"]["mean"]
            .as_f64()
            .unwrap()
            .round(),
        200.0
    );
    assert_eq!(groups["overall"]["l_collision_percent"]["mean"], 10.0);
    assert_eq!(
        groups["overall"]["l_collision_of_outer_percent"]["mean"],
        20.0
    );
    assert_eq!(
        groups["jacket"]["l_collision_of_outer_percent"]["mean"],
        20.0
    );
    assert_eq!(
        groups["t-shirt"]["l_collision_of_outer_percent"],
        json!(null)
    );
    assert_eq!(groups["t-shirt"]["h_collision_percent"]["mean"], 10.0);
    assert_eq!(json["rows"][1]["note"], "another reference");
    assert_eq!(json["conditions"]["steps"], 35);
}

#[test]
fn every_csv_line_has_as_many_fields_as_the_head() {
    let csv = csv(&table());
    let mut lines = csv.lines();
    let head = lines.next().unwrap().split(',').count();
    for line in lines {
        let line = line.replace("\"LayersNet, small\"", "quoted");
        assert_eq!(line.split(',').count(), head, "{line}");
    }
    assert_eq!(csv.lines().count(), 1 + 3 + 3 + 1);
}

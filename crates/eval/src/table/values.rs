//! CSV and JSON: every value with its unit in the name.
//!
//! CSV has one line per method and group (`overall` or a kind); JSON nests
//! groups in methods.

use serde_json::{Map, Value, json};

use super::{MM_10X_PER_METRE, MM_PER_METRE, Row, Table};
use crate::tally::{Measures, Statistic};

/// Group name of all garments together.
const OVERALL: &str = "overall";

/// Columns of one measure, `_mean` and `_std` each.
const MEASURES: [&str; 5] = [
    "error_mm_10x",
    "error_mm_real",
    "h_collision_percent",
    "l_collision_percent",
    "l_collision_of_outer_percent",
];

/// Comma-separated values, one line per method and group.
pub fn csv(table: &Table) -> String {
    let mut lines = vec!["method,threads,ms_per_frame,group,frames".to_owned()];
    for name in MEASURES {
        lines[0] += &format!(",{name}_mean,{name}_std");
    }
    for row in &table.rows {
        let text = |value: Option<String>| value.unwrap_or_default();
        let head = format!(
            "{},{},{}",
            quoted(&row.method),
            text(row.threads.map(|threads| threads.to_string())),
            text(row.ms_per_frame.map(|ms| ms.to_string()))
        );
        let groups = groups(row);
        if groups.is_empty() {
            lines.push(format!("{head},{OVERALL},0{}", ",,".repeat(MEASURES.len())));
        }
        for (group, frames, values) in groups {
            let values: String = values
                .iter()
                .map(|value| {
                    value.map_or(",,".to_owned(), |value| {
                        format!(",{},{}", value.mean, value.std)
                    })
                })
                .collect();
            lines.push(format!("{head},{group},{frames}{values}"));
        }
    }
    lines.join("\n") + "\n"
}

/// Everything as one JSON object.
pub fn json(table: &Table) -> Value {
    let rows: Vec<Value> = table
        .rows
        .iter()
        .map(|row| {
            let groups: Map<String, Value> = groups(row)
                .into_iter()
                .map(|(group, frames, values)| {
                    let mut object = Map::from_iter([("frames".to_owned(), json!(frames))]);
                    for (name, value) in MEASURES.iter().zip(values) {
                        let value =
                            value.map(|value| json!({ "mean": value.mean, "std": value.std }));
                        object.insert((*name).to_owned(), value.unwrap_or(Value::Null));
                    }
                    (group, Value::Object(object))
                })
                .collect();
            json!({
                "method": row.method,
                "threads": row.threads,
                "ms_per_frame": row.ms_per_frame,
                "note": row.note.and_then(|note| table.conditions.notes.get(note)),
                "groups": groups,
            })
        })
        .collect();
    json!({ "conditions": table.conditions, "rows": rows })
}

/// Group name, frames, values in the order of [`MEASURES`].
type Group = (String, usize, [Option<Statistic>; MEASURES.len()]);

fn groups(row: &Row) -> Vec<Group> {
    let Some(summary) = &row.summary else {
        return Vec::new();
    };
    let overall = group(
        OVERALL.to_owned(),
        &summary.overall,
        summary.overall.l_collision,
        summary.l_collision_of_outer,
    );
    // A kind's own L-collision has its own vertices as divisor; the paper's odd divisor exists only overall.
    let kinds = summary.kinds.iter().map(|(kind, measures)| {
        group(kind.name().to_owned(), measures, None, measures.l_collision)
    });
    std::iter::once(overall).chain(kinds).collect()
}

fn group(
    name: String,
    measures: &Measures,
    of_all: Option<Statistic>,
    of_outer: Option<Statistic>,
) -> Group {
    let scaled =
        |value: Option<Statistic>, factor| value.map(|value: Statistic| value.scaled(factor));
    let values = [
        scaled(measures.error_m, MM_10X_PER_METRE),
        scaled(measures.error_m, MM_PER_METRE),
        scaled(measures.h_collision, 100.0),
        scaled(of_all, 100.0),
        scaled(of_outer, 100.0),
    ];
    (
        name,
        measures.error_m.map_or(0, |error| error.frames),
        values,
    )
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

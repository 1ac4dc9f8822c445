//! Console and Markdown.

use std::collections::BTreeSet;

use comfy_table::{CellAlignment, ContentArrangement, Table as Grid, presets};
use drape_dataset::registry::GarmentKind;

use super::{MM_10X_PER_METRE, MM_PER_METRE, Row, Table};
use crate::tally::{Statistic, Summary};

/// What is in the place of a number that does not exist.
const NOTHING: &str = "–";
/// Marks of notes.
const MARKS: [&str; 9] = ["¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"];

/// The table with frames, for a terminal.
pub fn console(table: &Table) -> String {
    let mut grid = grid(table);
    grid.load_style(presets::UTF8_HORIZONTAL_ONLY)
        .set_content_arrangement(ContentArrangement::Dynamic);
    format!("{}\n{grid}\n{}", headline(table), footer(table).join("\n"))
}

/// The table in Markdown.
pub fn markdown(table: &Table) -> String {
    let mut grid = grid(table);
    grid.load_style(presets::ASCII_MARKDOWN)
        .set_content_arrangement(ContentArrangement::Disabled);
    format!(
        "{}\n\n{grid}\n\n{}\n",
        headline(table),
        footer(table).join("\n\n")
    )
}

fn headline(table: &Table) -> String {
    let conditions = &table.conditions;
    format!(
        "Rollouts of {} frames from frame {} on {} sequences of `{}` ({})",
        conditions.steps, conditions.start, conditions.sequences, conditions.split, conditions.data
    )
}

fn footer(table: &Table) -> Vec<String> {
    let mut lines = vec![
        "Errors: mean ± standard deviation over frames, mm at the 10× scale (a tenth of it at real scale); \
         collisions: % of vertices, L inside inner layers (divided by all vertices, as the paper does), \
         H inside the body; ms/frame: batch 1, warm, body motion given."
            .to_owned(),
    ];
    lines.extend(
        table
            .conditions
            .notes
            .iter()
            .enumerate()
            .map(|(index, note)| format!("{} {note}", mark(index))),
    );
    lines
}

fn grid(table: &Table) -> Grid {
    let kinds: BTreeSet<GarmentKind> = table
        .rows
        .iter()
        .filter_map(|row| row.summary.as_ref())
        .flat_map(|summary| summary.kinds.keys())
        .copied()
        .collect();
    let mut grid = Grid::new();
    let head = ["method".to_owned()]
        .into_iter()
        .chain(kinds.iter().map(|kind| kind.to_string()))
        .chain(
            [
                "overall",
                "real mm",
                "L-coll. %",
                "H-coll. %",
                "ms/frame",
                "threads",
            ]
            .map(str::to_owned),
        );
    grid.set_header(head);
    for row in &table.rows {
        grid.add_row(cells(row, &kinds));
    }
    for column in grid.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    grid
}

fn cells(row: &Row, kinds: &BTreeSet<GarmentKind>) -> Vec<String> {
    let summary = row.summary.as_ref();
    let overall = |value: fn(&Summary) -> Option<Statistic>, factor, digits| {
        number(
            summary
                .and_then(value)
                .map(|statistic| statistic.scaled(factor)),
            digits,
        )
    };
    let mut cells = vec![format!("{}{}", row.method, row.note.map_or("", mark))];
    cells.extend(kinds.iter().map(|kind| {
        let error = summary.and_then(|summary| summary.kinds.get(kind)?.error_m);
        number(error.map(|error| error.scaled(MM_10X_PER_METRE)), 1)
    }));
    cells.extend([
        overall(|summary| summary.overall.error_m, MM_10X_PER_METRE, 1),
        overall(|summary| summary.overall.error_m, MM_PER_METRE, 2),
        overall(|summary| summary.overall.l_collision, 100.0, 2),
        overall(|summary| summary.overall.h_collision, 100.0, 2),
        row.ms_per_frame.map_or(NOTHING.to_owned(), milliseconds),
        row.threads
            .map_or(NOTHING.to_owned(), |threads| threads.to_string()),
    ]);
    cells
}

fn number(statistic: Option<Statistic>, digits: usize) -> String {
    statistic.map_or(NOTHING.to_owned(), |s| {
        format!("{:.digits$} ± {:.digits$}", s.mean, s.std)
    })
}

/// Three significant digits: floors take microseconds, engines seconds.
fn milliseconds(ms: f64) -> String {
    match ms {
        ms if ms >= 100.0 => format!("{ms:.0}"),
        ms if ms >= 10.0 => format!("{ms:.1}"),
        ms if ms >= 1.0 => format!("{ms:.2}"),
        ms => format!("{ms:.3}"),
    }
}

fn mark(index: usize) -> &'static str {
    MARKS.get(index).copied().unwrap_or("*")
}

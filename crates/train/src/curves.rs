//! Loss curves of a run, drawn from its log.

use std::path::Path;

use drape_view::plot::{LinePlot, Series, line_plot};

use crate::error::{Result, TrainError};

/// Draws `losses.png` from `log.jsonl` in a run folder.
///
/// # Errors
/// If the log is missing or damaged, or the picture cannot be written.
pub fn draw(folder: &Path) -> Result<()> {
    let path = folder.join("log.jsonl");
    let fail = |cause: String| TrainError::Run {
        path: path.clone(),
        cause,
    };
    let text = std::fs::read_to_string(&path).map_err(|cause| fail(cause.to_string()))?;
    let names = [
        "position",
        "patch",
        "normal",
        "body_collision",
        "layer_collision",
    ];
    let mut series: Vec<Series> = names
        .iter()
        .map(|name| Series {
            name: name.replace('_', " "),
            points: Vec::new(),
        })
        .collect();
    let mut marks: Vec<(f64, &str)> = Vec::new();
    for line in text.lines() {
        let line: serde_json::Value =
            serde_json::from_str(line).map_err(|cause| fail(cause.to_string()))?;
        let update = line["update"].as_f64().unwrap_or(0.0);
        for (series, name) in series.iter_mut().zip(names) {
            series
                .points
                .push((update, line["losses"][name].as_f64().unwrap_or(0.0)));
        }
        if marks.is_empty() && line["phase"] == "collisions" {
            marks.push((update, "collision losses on"));
        }
    }
    series.retain(|series| series.points.iter().any(|&(_, value)| value > 0.0));
    if series.is_empty() {
        return Ok(());
    }
    let plot = LinePlot {
        title: "Losses (weighted)",
        x_label: "update",
        y_label: "loss, units²",
        log_y: true,
        series: &series,
        marks: &marks,
    };
    let draw = || -> Result<(), drape_view::ViewError> {
        line_plot(&plot, 1000, 600)?.write_png(&folder.join("losses.png"))
    };
    draw().map_err(|cause| fail(cause.to_string()))
}

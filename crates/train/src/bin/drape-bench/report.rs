//! The result as JSON and as text.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use crate::measure::CaseResult;

/// Milliseconds of the published program, its allocator tuned: inference, training step.
const PUBLISHED: [(&str, f64, f64); 3] = [
    ("small", 72.0, 267.0),
    ("medium", 532.0, 1812.0),
    ("large", 769.0, 2648.0),
];
/// The 2048³ product on the machine where those were measured.
const PUBLISHED_MATMUL_MS: f64 = 74.0;

/// All that a run measured.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Threads.
    pub threads: usize,
    /// candle's 2048³ f32 product, best of 9.
    pub matmul_2048_ms: f64,
    /// Cases by name.
    pub cases: BTreeMap<String, CaseResult>,
    /// The growth series, smallest first.
    #[serde(default)]
    pub growth: Vec<CaseResult>,
}

impl Report {
    /// An empty report.
    pub fn new(threads: usize, matmul_2048_ms: f64) -> Self {
        Self {
            threads,
            matmul_2048_ms,
            cases: BTreeMap::new(),
            growth: Vec::new(),
        }
    }

    /// An earlier result, if the file is there.
    pub fn load(path: &Path) -> Result<Option<Self>> {
        if !path.exists() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let report = serde_json::from_str(&text)
            .with_context(|| format!("{} is not a result of this command", path.display()))?;
        Ok(Some(report))
    }

    /// Writes the JSON file whole or not at all.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self)? + "\n";
        drape_train::run::write_atomic(path, text.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))
    }

    /// Tables for a terminal.
    pub fn text(&self, previous: Option<&Self>) -> String {
        let mut out = String::new();
        let _ = writeln!(
            out,
            "{} threads; 2048³ product {:.1} ms ({PUBLISHED_MATMUL_MS} ms where the published program was timed)\n",
            self.threads, self.matmul_2048_ms
        );
        let _ = writeln!(
            out,
            "{:<8} {:>8} {:>6} {:>7} | {:>12} {:>12} | {:>12} {:>12} | {:>9} {:>9}",
            "case",
            "vertices",
            "body",
            "patches",
            "inference ms",
            "× published",
            "training ms",
            "× published",
            "peak MiB",
            "inference"
        );
        for (name, case) in &self.cases {
            // Both programs on the scale of the product.
            let scale = self.matmul_2048_ms / PUBLISHED_MATMUL_MS;
            let times = |published: f64, ms: f64| format!("{:.1}", published * scale / ms);
            let (inference, training) =
                PUBLISHED
                    .iter()
                    .find(|row| row.0 == name)
                    .map_or_else(Default::default, |row| {
                        (
                            times(row.1, case.inference_ms),
                            times(row.2, case.train_step_ms),
                        )
                    });
            let _ = writeln!(
                out,
                "{name:<8} {:>8} {:>6} {:>7} | {:>12.1} {inference:>12} | {:>12.1} {training:>12} | {:>9.0} {:>9.0}",
                case.vertices,
                case.body_vertices,
                case.patches,
                case.inference_ms,
                case.train_step_ms,
                case.peak_mib,
                case.inference_peak_mib
            );
        }
        for (name, case) in &self.cases {
            let _ = writeln!(
                out,
                "\n{name}: per patch {:.1} mesh, {:.1} world, {:.1} body entries ({:.1} distinct); {} distinct body vertices",
                case.mesh_entries,
                case.world_entries,
                case.body_entries,
                case.distinct_body_entries,
                case.distinct_body_vertices
            );
            for (stage, ms) in &case.stages {
                let _ = writeln!(out, "  {stage:<32} {ms:>8.2} ms");
            }
            if let Some(before) = previous.and_then(|report| report.cases.get(name)) {
                let _ = writeln!(
                    out,
                    "  before: inference {:.1} ms ({:.2} of it now), training step {:.1} ms ({:.2}), peak {:.0} MiB",
                    before.inference_ms,
                    case.inference_ms / before.inference_ms,
                    before.train_step_ms,
                    case.train_step_ms / before.train_step_ms,
                    before.peak_mib
                );
            }
        }
        if let [first, .., last] = self.growth.as_slice() {
            let _ = writeln!(
                out,
                "\ngrowth   {:>8} {:>7} | {:>12} | {:>12} | {:>9}",
                "vertices", "patches", "inference ms", "training ms", "peak MiB"
            );
            for case in &self.growth {
                let _ = writeln!(
                    out,
                    "         {:>8} {:>7} | {:>12.1} | {:>12.1} | {:>9.0}",
                    case.vertices,
                    case.patches,
                    case.inference_ms,
                    case.train_step_ms,
                    case.peak_mib
                );
            }
            let exponent = |ms: fn(&CaseResult) -> f64| {
                (ms(last) / ms(first)).ln() / (last.vertices as f64 / first.vertices as f64).ln()
            };
            let _ = writeln!(
                out,
                "         time grows as n^{:.2} (inference), n^{:.2} (training step)",
                exponent(|case| case.inference_ms),
                exponent(|case| case.train_step_ms)
            );
        }
        out
    }
}

//! `drape-bench`: how long LayersNet takes for one frame and for one training step.

mod case;
mod measure;
mod report;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::{Parser, ValueEnum};

use crate::case::Shape;
use crate::measure::CaseResult;
use crate::report::Report;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// What can be measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CaseName {
    /// 612 garment and 200 body vertices, 204 patches
    Small,
    /// 2,976 garment and 1,495 body vertices, 1,196 patches
    Medium,
    /// 7,956 garment and 6,887 body vertices, 1,200 patches
    Large,
    /// The medium outfit grown along its axis: 1k to 64k vertices, patches with them
    Growth,
}

/// Measures LayersNet: one frame of inference and one training step.
///
/// Random weights, the `released` preset, two layered garments over a body at the
/// sizes at which the published program was timed. Inference is one frame, state
/// and body positions in, positions out, with everything that changes from frame to
/// frame. A training step is one sample without rollout steps: forward, losses,
/// backward, Adam. Times are medians of warm runs, on as many threads as
/// RAYON_NUM_THREADS says (default: all cores). Each case runs in a process of its
/// own, so that its peak of resident memory is its own.
#[derive(Parser)]
#[command(name = "drape-bench", version)]
struct Cli {
    /// Case to measure; default: all
    #[arg(long = "case", value_enum)]
    cases: Vec<CaseName>,
    /// File for the result as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Earlier result (JSON) to compare with
    #[arg(long, value_name = "FILE", default_value = "experiments/bench.json")]
    previous: PathBuf,
    /// Warm runs whose median is taken, at least 9
    #[arg(long, default_value_t = 15)]
    runs: usize,
    /// Measure one shape in this process and print it as JSON.
    #[arg(long, hide = true, value_name = "VERTICES")]
    alone: Option<usize>,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let cli = Cli::parse();
    if cli.runs < 9 {
        bail!("--runs {}: a median needs at least 9", cli.runs);
    }
    if let Some(vertices) = cli.alone {
        let name = *cli.cases.first().context("--alone needs --case")?;
        let result = measure::measure(&shape(name, vertices), cli.runs)?;
        println!("{}", serde_json::to_string(&result)?);
        return Ok(());
    }
    let previous = Report::load(&cli.previous)?;
    let names: &[CaseName] = if cli.cases.is_empty() {
        CaseName::value_variants()
    } else {
        &cli.cases
    };
    let mut report = Report::new(rayon::current_num_threads(), measure::matmul_2048_ms()?);
    for &name in names {
        if name == CaseName::Growth {
            for vertices in (0..7).map(|doubling| 1000 << doubling) {
                eprintln!("growth, {vertices} vertices …");
                report.growth.push(alone(name, vertices, cli.runs)?);
            }
        } else {
            let key = format!("{name:?}").to_lowercase();
            eprintln!("{key} …");
            report.cases.insert(key, alone(name, 0, cli.runs)?);
        }
    }
    print!("{}", report.text(previous.as_ref()));
    if let Some(path) = &cli.json {
        report.save(path)?;
        println!("written to {}", path.display());
    }
    Ok(())
}

/// Shape of a case; `vertices` counts for the growth series.
fn shape(name: CaseName, vertices: usize) -> Shape {
    match name {
        CaseName::Small => case::SMALL,
        CaseName::Medium => case::MEDIUM,
        CaseName::Large => case::LARGE,
        CaseName::Growth => case::MEDIUM.grown(vertices),
    }
}

/// Measures in a process of its own.
fn alone(name: CaseName, vertices: usize, runs: usize) -> Result<CaseResult> {
    let program = std::env::current_exe().context("cannot find this program")?;
    let value = name.to_possible_value().expect("no case is skipped");
    let output = std::process::Command::new(program)
        .args(["--case", value.get_name()])
        .args([
            "--alone",
            &vertices.to_string(),
            "--runs",
            &runs.to_string(),
        ])
        .stderr(std::process::Stdio::inherit())
        .output()
        .context("cannot start the measuring process")?;
    if !output.status.success() {
        bail!("the measuring process ended with {}", output.status);
    }
    serde_json::from_slice(&output.stdout).context("the measuring process printed no result")
}
